"""Paths in CSV files: read strictly, every refusal names row and remedy."""

import numpy as np
import pytest

from tendon_robot_ros.common.errors import DataSetError
from tendon_robot_ros.data.path_files import TendonRows, TipRows, read_path, write_path

NAMES = ('left', 'right')


def read(folder, text):
    path = folder / 'path.csv'
    path.write_text(text)
    return read_path(path, NAMES)


def test_positions_alone(tmp_path):
    rows = read(tmp_path, 'x,y,z\n0,0,0.2\n0.05,0,0.18\n')
    assert rows.times is None
    assert rows.positions.tolist() == [[0, 0, 0.2], [0.05, 0, 0.18]]
    assert np.isnan(rows.directions).all()


def test_time_and_directions_of_any_length_or_none(tmp_path):
    rows = read(tmp_path, 'time,x,y,z,dx,dy,dz\n5,0,0,0.2,0,0,3\n7,0.05,0,0.18,,,\n')
    assert rows.times.tolist() == [0, 2]
    assert rows.directions[0].tolist() == [0, 0, 1]
    assert np.isnan(rows.directions[1]).all()


def test_tendons(tmp_path):
    rows = read(tmp_path, 'time,right,left\n0,1,2\n1,3,4\n')
    assert isinstance(rows, TendonRows)
    assert rows.values.tolist() == [[2, 1], [4, 3]]


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('x,y\n1,2\n', "row 1: column 'z' is missing; add it to the header"),
        ('x,y,z\n1,,2\n', 'row 2: a cell is empty; write a number'),
        ('time,x,y,z\n0,0,0,1\n0,0,0,1\n', 'row 3: time does not grow'),
        ('x,y,z,dx,dy,dz\n0,0,1,0,0,0\n', 'row 2: the direction is zero'),
        ('x,y,z,dx,dy,dz\n0,0,1,1,,0\n', 'row 2: half a direction'),
        ('x,y,z,dx\n0,0,1,1\n', 'a direction needs dx, dy and dz; add the columns'),
        ('left,right\n1,2\n', "row 1: column 'time' is missing"),
        ('time,left\n1,2\n', "row 1: column 'right' is missing"),
        ('time,left,right,x\n1,2,3,4\n', "row 1: column 'x' is unknown"),
        ('x;y;z\n', 'columns are separated by semicolons'),
        ('x,y,z\n0,0,nan\n', 'row 2: z is'),
        ('', 'is empty'),
    ],
)
def test_every_refusal_says_where_and_what_to_do(tmp_path, text, message):
    with pytest.raises(DataSetError) as refused:
        read(tmp_path, text)
    assert message in str(refused.value)
    assert 'path.csv' in str(refused.value)


def test_what_is_written_is_read_again(tmp_path):
    tips = TipRows(
        np.array([0.0, 1.5]),
        np.array([[0.01, -0.02, 0.2], [0.0, 0.0, 0.1]]),
        np.array([[0.0, 0.6, 0.8], [np.nan] * 3]),
    )
    write_path(tmp_path / 'tips.csv', tips, NAMES)
    again = read_path(tmp_path / 'tips.csv', NAMES)
    for name in ('times', 'positions', 'directions'):
        np.testing.assert_allclose(getattr(again, name), getattr(tips, name), atol=1e-9)
    tendons = TendonRows(np.array([0.0, 1.0]), np.array([[0.1, 5.0], [2.25, 0.1]]))
    write_path(tmp_path / 'tendons.csv', tendons, NAMES)
    assert read_path(tmp_path / 'tendons.csv', NAMES).values == pytest.approx(tendons.values)
