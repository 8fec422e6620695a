"""Whatever a file holds: it is read, or refused in one line; what is written is read back."""

import csv
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_array_equal
from small_dataset import ROBOT, TEXTS, write

from tendon_robot_ros.common.errors import DataSetError, TendonRobotError
from tendon_robot_ros.data import DataSet, Marker, load_dataset, save_dataset
from tendon_robot_ros.data.csv_file import CsvFile
from tendon_robot_ros.robot import parse_robot

PIECES = [b',', b'\n', b'"', b';', b'nan', b'inf', b'-', b'e9', b'\0', b'\xff', b'\r', b'', b' ',
          b'0', b'1e999', b'[', b'{', b':', b'&a', b'*a', b'!!', b'\t', b'9' * 99, '½'.encode(),
          b'\n\n', b'posture', b'\xef\xbb\xbf', b'#', b'\x0b', b'\x85', b'_']  # fmt: skip


@st.composite
def damaged(draw):
    """Pick a file of the data set and damage it in one to three places."""
    name = draw(st.sampled_from(sorted(TEXTS)))
    data = TEXTS[name].encode()
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, len(data)))
        length = draw(st.integers(0, 6))
        piece = draw(st.sampled_from(PIECES) | st.binary(max_size=4))
        data = data[:start] + piece + data[start + length :]
    return name.partition('.')[0], data


@settings(max_examples=100)
@given(damaged())
@example(('dataset', b'a: ' + b'[' * 3000))
@example(('dataset', b'gravity: 2000-99-99'))
@example(('dataset', b'robot: ' + b'9' * 300 + b'.yaml'))
@example(('dataset', b'? {a: b}\n: c'))
@example(('robot', b'sections: [{n\n\n bending, cells: 3}]'))
@example(('shapes', b'posture,trial,marker,x,y,z\n' + b'0,' * 100_000))
@example(('shapes', b'posture,trial,marker,x,y,z\n"' + b'0' * 200_000 + b'"'))
def test_a_damaged_file_is_read_or_refused_in_one_line(file):
    name, content = file
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder), **{name: content})
        try:
            data = load_dataset(folder)
        except TendonRobotError as error:
            message = str(error)
            assert '\n' not in message
            assert len(message) < 600
            assert f'{folder}/' in message
        else:
            assert np.isfinite(data.inputs).all()
            assert np.isfinite(data.positions[data.mask]).all()
            assert data.trials.min() > 0
        assert sorted(path.name for path in Path(folder).iterdir()) == sorted(TEXTS)


NUMBERS = ['1', ' 2 ', '', '"3"', '-1e-3', ' ', '+4', '.5']
CELL = st.sampled_from([*NUMBERS, 'nan', 'x', '0x1', '1_0'])
NAME = st.sampled_from(['a', ' a', 'é', '"q"', '', 'nan'])


@settings(max_examples=150)
@given(st.lists(st.tuples(NAME, CELL, CELL), min_size=1, max_size=6))
def test_a_table_holds_what_its_cells_say_one_by_one(rows):
    """However it is parsed: whole blocks at once, or cell by cell where something is odd."""
    text = 'name,x,y\n' + ''.join(','.join(row) + '\n' for row in rows)
    blank = any(not ''.join(row).strip() for row in rows)
    refused = blank or any(cell not in NUMBERS for _, *cells in rows for cell in cells)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'f.csv'
        path.write_text(text, encoding='utf-8')
        file = CsvFile(path, ('name',), ('name', 'x', 'y'), '')
        if refused:
            with pytest.raises(DataSetError, match=r'f\.csv, row \d+: '):
                file.read((), ('name',))
            return
        table = file.read((), ('name',))
    names, *numbers = zip(*csv.reader(text.splitlines()[1:]), strict=True)
    labels = table.labels['name']
    assert [labels[code] for code in table.codes['name']] == [name.strip() for name in names]
    for key, cells in zip('xy', numbers, strict=True):
        assert_array_equal(table.numbers[key], [float(cell.strip() or 'nan') for cell in cells])


NAMES = st.text(st.characters(codec='utf-8', exclude_categories=['C', 'Z']), min_size=1,
                max_size=6)  # fmt: skip


@st.composite
def datasets(draw):
    """Make a data set of any size whose every posture was measured."""
    robot = parse_robot(ROBOT)
    markers = draw(st.lists(NAMES, min_size=1, max_size=4, unique=True).filter(
        lambda names: not any(c in name for name in names for c in ',=')))  # fmt: skip
    postures = draw(st.lists(NAMES, min_size=1, max_size=4, unique=True))
    trials = draw(st.integers(1, 3))
    shape = (len(postures), trials, len(markers))
    positions = draw(arrays(float, (*shape, 3), elements=st.floats(-0.09, 0.09)))
    seen = draw(arrays(bool, shape))
    seen[:, 0, :] = True
    positions[~seen] = np.nan
    tensions = st.floats(0, 5)
    inputs = draw(arrays(float, (len(postures), 2), elements=tensions))
    return DataSet(
        name='drawn',
        robot=robot,
        markers=tuple(Marker(name, draw(st.floats(0, 0.03))) for name in markers),
        postures=tuple(postures),
        inputs=inputs,
        positions=positions,
        gravity=draw(st.none() | st.just((0.0, 1.5, 0.0))),
        accuracy=draw(st.none() | st.floats(1e-6, 0.01)),
        trial_noise=draw(st.floats(0, 0.4)),
    )


@settings(max_examples=50)
@given(datasets())
@pytest.mark.long
def test_what_is_written_is_read_back_exactly(data):
    with tempfile.TemporaryDirectory() as folder:
        again = load_dataset(save_dataset(data, Path(folder) / 'new'))
    assert again.postures == data.postures
    assert again.markers == data.markers
    assert_array_equal(again.inputs, data.inputs)
    seen = data.trial_mask.any(axis=0)  # a trial in which no posture saw anything has no rows
    assert_array_equal(again.positions, data.positions[:, seen])
    for key in ('gravity', 'accuracy', 'trial_noise', 'setting_noise', 'input', 'path'):
        assert getattr(again, key) == getattr(data, key)


@pytest.mark.parametrize('text', ['posture', 'x' * 70_000])
def test_names_may_be_anything_that_is_text(text, tmp_path):
    inputs = f'posture,left,right\n{text},1,1\n'
    shapes = f'posture,trial,marker,x,y,z\n{text},0,1,0,0,0\n'
    assert load_dataset(write(tmp_path, inputs=inputs, shapes=shapes)).postures == (text,)
