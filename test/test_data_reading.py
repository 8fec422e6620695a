"""What a folder may look like, and what is read from it."""

from dataclasses import replace

import numpy as np
import pytest
from measurements import TENTACLE
from numpy.testing import assert_array_equal
from small_dataset import INPUTS, ROBOT, SHAPES, write

from tendon_robot_ros.common.errors import DataSetError, InputError, RobotDescriptionError
from tendon_robot_ros.data import Marker, default_markers, load_dataset, save_dataset
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot, parse_robot


def test_a_folder_is_read_with_missing_values_as_nan(tmp_path):
    data = load_dataset(write(tmp_path / 'small'))
    assert data.postures == ('0', '1')
    assert data.trial_names == ('0', '1')
    assert data.input_names == ('left', 'right')
    assert_array_equal(data.inputs, [[0.5, 0.0], [1.0, 0.25]])
    assert data.positions.shape == (2, 2, 3, 3)
    assert_array_equal(data.positions[1, 0, 2], [0.006, 0.0, 0.028])
    assert np.isnan(data.positions[1, 0, 1]).all()
    assert np.isnan(data.positions[1, 1]).all()
    assert (data.path, data.gravity, data.accuracy) == ('from_straight', None, None)
    assert (data.setting_noise, data.trial_noise, data.position_noise) == (0.0, 0.0, None)
    assert data.robot.source == str(tmp_path / 'small' / 'robot.yaml')


def test_without_markers_there_is_one_at_the_end_of_every_cell(tmp_path):
    data = load_dataset(write(tmp_path / 'small'))
    assert [marker.name for marker in data.markers] == ['1', '2', '3']
    assert data.arc_lengths == pytest.approx([0.01, 0.02, 0.03])
    assert_array_equal(data.offsets, np.zeros((3, 3)))


def test_cells_that_were_never_measured_are_no_markers(tmp_path):
    shapes = ''.join(line for line in SHAPES.splitlines(True) if ',3,' not in line)
    data = load_dataset(write(tmp_path / 'small', shapes=shapes))
    assert [marker.name for marker in data.markers] == ['1', '2']
    assert data.positions.shape == (2, 2, 2, 3)


def test_everything_that_dataset_yaml_can_say_is_read(tmp_path):
    text = """\
robot: robot.yaml
input: displacement
path: sequence
gravity: [0, 0, 0]
position_noise: 2e-4
tension_noise: {setting: 0.002, trial: 0.004}
accuracy: 1.0e-3
markers:
- {name: 1, arc_length: 0.005}
- {name: '2', arc_length: 0.03, offset: [0, 0.01, 0]}
- {name: 3, arc_length: 0.03}
"""
    inputs = 'posture,left,right\n0,0.001,\n1,0.002,-0.001\n'
    data = load_dataset(write(tmp_path / 'small', dataset=text, inputs=inputs))
    assert (data.input, data.path, data.gravity) == ('displacement', 'sequence', (0.0, 0.0, 0.0))
    assert (data.position_noise, data.accuracy) == (2e-4, 1e-3)
    assert (data.setting_noise, data.trial_noise) == (0.002, 0.004)
    assert data.markers[1] == Marker('2', 0.03, (0.0, 0.01, 0.0))
    assert_array_equal(data.inputs, [[0.001, np.nan], [0.002, -0.001]])


SAME = {
    'byte order mark': b'\xef\xbb\xbf' + SHAPES.encode(),
    'Windows line ends': SHAPES.replace('\n', '\r\n'),
    'no line end at the end': SHAPES.removesuffix('\n'),
    'blank lines at the end': SHAPES + '\n  \n\n',
    'quotation marks': SHAPES.replace('0,0,1,', '"0","0","1",'),
    'spaces around cells': SHAPES.replace(',', ' , '),
    'empty cells': SHAPES.replace('1,0,3', '1,0,2,,,\n1,0,3'),
    'spaces in empty cells': SHAPES.replace('1,0,3', '1,0,2, , ,\n1,0,3'),
    'exponents': SHAPES.replace('0.001', '1e-3'),
    'other order of rows': '\n'.join([SHAPES.split('\n')[0], *SHAPES.split('\n')[:0:-1][1:]]),
}


@pytest.mark.parametrize('shapes', SAME.values(), ids=SAME)
def test_what_editors_and_spreadsheets_do_to_a_file_does_not_matter(shapes, tmp_path):
    expected = load_dataset(write(tmp_path / 'as_written'))
    data = load_dataset(write(tmp_path / 'edited', shapes=shapes))
    assert_array_equal(data.positions, expected.positions)


def test_columns_may_stand_in_any_order(tmp_path):
    inputs = 'right,posture,left\n0.0,0,0.5\n0.25,1,1.0\n'
    data = load_dataset(write(tmp_path / 'small', inputs=inputs))
    assert_array_equal(data.inputs, [[0.5, 0.0], [1.0, 0.25]])


def test_a_group_of_tendons_has_one_column(tmp_path):
    robot = ROBOT.replace('section: bending}\n- {', 'section: bending, group: both}\n- {')
    inputs = 'posture,both,right\n0,0.5,0\n1,1,0\n'
    data = load_dataset(write(tmp_path / 'small', robot=robot, inputs=inputs))
    assert data.input_names == ('both', 'right')


DRUM = ROBOT.replace('section: bending}\n- {', 'section: bending, drum: m1}\n- {').replace(
    'section: bending}\nten', 'section: bending, drum: m1, winding: -1}\nten'
)
PULLS = 'input: displacement\n'


def test_what_a_drum_winds_of_one_wire_it_pays_out_of_the_other(tmp_path):
    inputs = 'posture,m1\n0,0.001\n1,-0.0005\n'
    data = load_dataset(write(tmp_path / 'small', robot=DRUM, dataset=PULLS, inputs=inputs))
    assert data.input_names == ('left', 'right')
    assert_array_equal(data.inputs, [[0.001, -0.001], [-0.0005, 0.0005]])
    again = load_dataset(save_dataset(data, tmp_path / 'again'))
    assert_array_equal(again.inputs, data.inputs)
    assert again.robot.drums == {'m1': {'left': 1, 'right': -1}}
    apart = 'posture,left,right\n0,0.001,\n1,0.0005,0.0005\n'
    data = load_dataset(write(tmp_path / 'small', robot=DRUM, dataset=PULLS, inputs=apart))
    assert_array_equal(data.inputs, [[0.001, np.nan], [0.0005, 0.0005]])


def test_a_drum_is_commanded_by_name_where_pulls_are(tmp_path):
    robot = replace(parse_robot(DRUM), exact=True)
    turned = Model(robot).pull_shape({'m1': 0.0006})
    with pytest.raises(InputError, match="drum 'm1' and its wire 'left': name one of them"):
        Model(robot).pull_shape({'m1': 0.0006, 'left': 0.001})
    wires = Model(robot).pull_shape([0.0006, -0.0006])
    assert turned.tip_position == pytest.approx(wires.tip_position, abs=1e-15)
    opposite = Model(robot).pull_shape({'m1': -0.0006})
    assert opposite.tip_position[0] == pytest.approx(-turned.tip_position[0], rel=1e-6)


WRONG_DRUMS = {
    'both': (
        'posture,m1,left\n0,0,0\n',
        PULLS,
        "drum 'm1' and its wire 'left' both have a column",
    ),
    'half': ('posture,left\n0,0\n', PULLS, "'right' is missing; add it to the header, or with in"),
    'slack': ('posture,m1\n0,\n1,0\n', PULLS, 'row 2: m1 is empty; a drum is never slack'),
    'tension': ('posture,m1\n0,0\n', '', "column 'm1' is unknown"),
}


@pytest.mark.parametrize(('inputs', 'dataset', 'message'), WRONG_DRUMS.values(), ids=WRONG_DRUMS)
def test_columns_of_drums_that_do_not_fit_are_refused(tmp_path, inputs, dataset, message):
    with pytest.raises(DataSetError) as error:
        load_dataset(write(tmp_path / 'small', robot=DRUM, dataset=dataset, inputs=inputs))
    assert message in str(error.value)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (('drum: m1, winding', 'winding'), 'expected the drum that winds the wire, too'),
        (('winding: -1', 'winding: 0'), 'expected 1, or -1 for a wire'),
        (('drum: m1, winding: -1', 'drum: m1, group: a'), 'expected a drum or a group, not both'),
        (('drum: m1', 'drum: left'), 'expected drums with names of their own'),
    ],
)
def test_drums_that_make_no_sense_are_refused(change, message):
    with pytest.raises(RobotDescriptionError) as error:
        parse_robot(DRUM.replace(*change))
    assert message in str(error.value)


def test_names_of_trials_are_sorted_if_they_are_numbers(tmp_path):
    shapes = 'posture,trial,marker,x,y,z\n0,10,1,0,0,0.01\n1,9,1,0,0,0.01\n'
    data = load_dataset(write(tmp_path / 'small', shapes=shapes))
    assert data.trial_names == ('9', '10')
    assert_array_equal(data.trial_mask, [[False, True], [True, False]])
    assert_array_equal(data.trials, [1, 1])


def test_inputs_can_be_measured_in_every_trial(tmp_path):
    inputs = 'posture,trial,left,right\n0,0,0.5,0\n0,1,0.7,0\n1,0,1,0.25\n'
    data = load_dataset(write(tmp_path / 'small', inputs=inputs))
    assert data.inputs == pytest.approx(np.array([[0.6, 0.0], [1.0, 0.25]]))
    assert_array_equal(data.trial_inputs[0, 1], [0.7, 0.0])
    assert np.isnan(data.trial_inputs[1, 1]).all()


def test_in_a_sequence_a_posture_may_stand_without_a_measurement(tmp_path):
    inputs = INPUTS.replace('1,1.0', 'turn,2,2\n1,1.0')
    dataset = 'path: sequence\n'
    data = load_dataset(write(tmp_path / 'small', dataset=dataset, inputs=inputs))
    assert data.postures == ('0', 'turn', '1')
    assert_array_equal(data.trials, [2, 0, 1])


def test_orientations_are_read_as_unit_quaternions(tmp_path):
    shapes = (
        'posture,trial,marker,x,y,z,qx,qy,qz,qw\n'
        '0,0,1,0,0,0.01,0,0.6001,0,0.8\n'
        '1,0,1,0,0,0.01,,,,\n'
    )
    data = load_dataset(write(tmp_path / 'small', shapes=shapes))
    assert np.linalg.norm(data.orientations[0, 0, 0]) == pytest.approx(1.0, abs=1e-15)
    assert np.isnan(data.orientations[1, 0, 0]).all()


@pytest.mark.parametrize('kind', [str, load_robot])
def test_another_robot_can_be_named(kind, tmp_path):
    folder = write(tmp_path / 'small', robot=None)
    other = tmp_path / 'other.yaml'
    other.write_text(ROBOT.replace('name: small', 'name: other'))
    assert load_dataset(folder, robot=kind(other)).robot.name == 'other'


def test_an_error_in_the_robot_description_names_that_file(tmp_path):
    folder = write(tmp_path / 'small', robot=ROBOT.replace('cells: 3', 'cells: 0'))
    with pytest.raises(
        RobotDescriptionError, match=r'robot\.yaml: sections\[0\]\.cells: expected'
    ):
        load_dataset(folder)


def test_a_data_set_executes_nothing(tmp_path):
    trap = tmp_path / 'executed'
    text = f'robot: !!python/object/apply:pathlib.Path.touch [{trap}]\n'
    with pytest.raises(DataSetError, match='is no valid YAML'):
        load_dataset(write(tmp_path / 'small', dataset=text))
    assert not trap.exists()


def test_the_tentacle_loads():
    data = load_dataset(TENTACLE)
    assert data.positions.shape == (16, 1, 4, 3)
    assert data.postures[0] == 'm1_u01'
    assert data.robot.length == pytest.approx(0.36)
    assert data.markers[3] == Marker('p4', 0.36, (0.0, 0.0, 0.008))


def test_default_markers_follow_the_lengths_of_the_sections():
    text = ROBOT.replace(']\nten', ', {name: b, cells: 1, cell_length: 0.02, '
                         'bending_stiffness: 1}]\nten')  # fmt: skip
    lengths = [marker.arc_length for marker in default_markers(parse_robot(text))]
    assert lengths == pytest.approx([0.01, 0.02, 0.03, 0.05])
