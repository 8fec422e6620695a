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


MANY = 'posture,left,right\n' + ''.join(f'{i},1,1\n' for i in range(8000))
DEEP = [f'{i},0,1,0.001,0,0.01' for i in range(60_000)]
DEEP[54_321] = '54321,0,1,0.001,none,0.01'
MORE = {
    'an orientation without a position': (
        {'shapes': 'posture,trial,marker,x,y,z,qx,qy,qz,qw\n0,0,2,0,0,0,,,,\n'
         '0,0,1,,,,0,0,0,1\n1,0,1,0,0,0,0,0,0,1\n'},
        'shapes.csv, row 3: an orientation without a position; write x, y, z too, or leave the '
        'quaternion empty',
    ),
    'slack in some trials': (
        {'dataset': 'input: displacement',
         'inputs': 'posture,trial,left,right\n0,0,0.001,\n0,1,0.001,0.001\n1,0,0,0\n'},
        "inputs.csv: posture '0': an input is nan (slack) in some of its trials and a number in "
        'others; give postures of different inputs different names',
    ),
    'a declared marker that is never seen': (
        {'dataset': 'markers: [{name: 1, arc_length: 0.01}, {name: tip, arc_length: 0.03}]',
         'shapes': 'posture,trial,marker,x,y,z\n0,0,1,0,0,0\n1,0,1,0,0,0\n1,0,tip,,,\n'},
        "dataset.yaml: markers: 'tip' was never seen in shapes.csv; correct the name or remove "
        'the marker',
    ),
    'a trial without inputs': (
        {'inputs': 'posture,trial,left,right\n0,0,1,1\n1,0,1,1\n'},
        "shapes.csv, row 5: posture '0', trial '1': inputs.csv has no row for this trial; add "
        'its inputs there or remove its rows here',
    ),
    'trials counted through all postures': (
        {'inputs': MANY, 'shapes': 'posture,trial,marker,x,y,z\n'
         + ''.join(f'{i},{i},1,0,0,0\n' for i in range(8000))},
        'shapes.csv: 8000 postures x 8000 trials x 3 markers are too many; count the trials of '
        'every posture from 0',
    ),
    'deep in a long file': (
        {'inputs': MANY, 'shapes': '\n'.join(['posture,trial,marker,x,y,z', *DEEP])},
        "shapes.csv, row 54323: y is 'none'; leave the cell empty where the marker was not seen",
    ),
}  # fmt: skip


@pytest.mark.parametrize(('changed', 'problem'), MORE.values(), ids=MORE)
def test_files_that_do_not_fit_each_other_are_refused(changed, problem, tmp_path, monkeypatch):
    assert error_of(tmp_path, monkeypatch, **changed) == f'd/{problem}'


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
