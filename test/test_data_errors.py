"""Bad files: one clear error each, and nothing is written."""

import bad_csv_files
import bad_descriptions
import pytest
from small_dataset import write

from tendon_robot_ros.common.errors import DataSetError
from tendon_robot_ros.data import load_dataset

BAD = bad_csv_files.BAD | bad_descriptions.BAD
TURNED = 'posture,trial,marker,x,y,z,qx,qy,qz,qw\n0,0,1,0,0,0,{}\n1,0,1,0,0,0,0,0,0,1\n'


def error_of(folder, monkeypatch, **changed):
    """Write a data set, read it, and return what is said about it."""
    monkeypatch.chdir(folder)
    write(folder / 'd', **changed)
    before = {path: path.read_bytes() for path in folder.rglob('*') if path.is_file()}
    with pytest.raises(DataSetError) as caught:
        load_dataset('d')
    assert {path: path.read_bytes() for path in folder.rglob('*') if path.is_file()} == before
    return str(caught.value)


@pytest.mark.parametrize('case', BAD.values(), ids=BAD)
def test_a_bad_file_gets_one_line_with_file_row_and_remedy(case, tmp_path, monkeypatch):
    name, content, problem, remedy = case
    assert error_of(tmp_path, monkeypatch, **{name: content}) == f'd/{problem}; {remedy}'


@pytest.mark.parametrize(
    ('quaternion', 'problem'),
    [
        ('0,0,0,0', 'the quaternion is zero; leave it empty where it is unknown'),
        ('0,0,0,90', 'the quaternion is not of length 1; write qx, qy, qz, qw of a unit '
         'quaternion, in this order'),
        ('0,0,,1', 'only part of the quaternion is there; write qx, qy, qz and qw, or leave all '
         'four empty'),
    ],
)  # fmt: skip
def test_a_bad_quaternion_is_refused(quaternion, problem, tmp_path, monkeypatch):
    shapes = TURNED.format(quaternion)
    assert error_of(tmp_path, monkeypatch, shapes=shapes) == f'd/shapes.csv, row 2: {problem}'


def test_an_orientation_needs_a_position(tmp_path, monkeypatch):
    shapes = TURNED.format('0,0,0,1').replace('0,0,1,0,0,0,', '0,0,2,0,0,0,,,,\n0,0,1,,,,', 1)
    message = error_of(tmp_path, monkeypatch, shapes=shapes)
    assert message.startswith('d/shapes.csv, row 3: an orientation without a position; write')


def test_a_tendon_is_slack_in_all_trials_of_a_posture_or_in_none(tmp_path, monkeypatch):
    inputs = 'posture,trial,left,right\n0,0,0.001,\n0,1,0.001,0.001\n1,0,0,0\n'
    dataset = 'input: displacement'
    assert error_of(tmp_path, monkeypatch, dataset=dataset, inputs=inputs) == (
        "d/inputs.csv, row 2: a tendon is slack here and pulled in other trials of posture '0'; "
        'give postures of different inputs different names'
    )


def test_a_declared_marker_must_be_seen(tmp_path, monkeypatch):
    dataset = 'markers: [{name: 1, arc_length: 0.01}, {name: tip, arc_length: 0.03}]'
    shapes = 'posture,trial,marker,x,y,z\n0,0,1,0,0,0\n1,0,1,0,0,0\n1,0,tip,,,\n'
    assert error_of(tmp_path, monkeypatch, dataset=dataset, shapes=shapes) == (
        "d/dataset.yaml: markers: 'tip' was never seen in shapes.csv; correct the name or remove "
        'the marker'
    )


def test_a_trial_needs_inputs_where_these_are_given_per_trial(tmp_path, monkeypatch):
    inputs = 'posture,trial,left,right\n0,0,1,1\n1,0,1,1\n'
    assert error_of(tmp_path, monkeypatch, inputs=inputs) == (
        "d/shapes.csv, row 5: posture '0', trial '1': inputs.csv has no row for this trial; add "
        'its inputs there or remove its rows here'
    )


def test_trials_counted_through_all_postures_are_not_a_table(tmp_path, monkeypatch):
    rows = range(8000)
    inputs = 'posture,left,right\n' + ''.join(f'{i},1,1\n' for i in rows)
    shapes = 'posture,trial,marker,x,y,z\n' + ''.join(f'{i},{i},1,0,0,0\n' for i in rows)
    assert error_of(tmp_path, monkeypatch, inputs=inputs, shapes=shapes) == (
        'd/shapes.csv: 8000 postures x 8000 trials x 3 markers are too many; count the trials of '
        'every posture from 0'
    )


def test_an_error_deep_in_a_long_file_names_its_row(tmp_path, monkeypatch):
    rows = [f'{i},0,1,0.001,0,0.01' for i in range(60_000)]
    rows[54_321] = '54321,0,1,0.001,none,0.01'
    inputs = 'posture,left,right\n' + ''.join(f'{i},1,1\n' for i in range(60_000))
    shapes = '\n'.join(['posture,trial,marker,x,y,z', *rows])
    assert error_of(tmp_path, monkeypatch, inputs=inputs, shapes=shapes) == (
        "d/shapes.csv, row 54323: y is 'none'; leave the cell empty where the marker was not seen"
    )


def test_long_lists_of_names_are_cut(tmp_path, monkeypatch):
    inputs = 'posture,left,right\n' + ''.join(f'{i},1,1\n' for i in range(100))
    message = error_of(tmp_path, monkeypatch, inputs=inputs, shapes='posture,trial,marker,x,y,z\n'
                       'x,0,1,0,0,0\n')  # fmt: skip
    assert message.endswith('use one of 0, 1, 2, 3, 4, 5, ..., 97, 98, 99')


def test_a_file_that_may_not_be_read_is_named(tmp_path, monkeypatch):
    (tmp_path / 'd').mkdir()
    (tmp_path / 'd' / 'shapes.csv').mkdir()
    message = error_of(tmp_path, monkeypatch, shapes=None)
    assert message == (
        'd/shapes.csv: cannot be read (Is a directory); every data set needs this file'
    )
