"""The commands shape and reach, as a user types them."""

import json

import numpy as np
import pytest
from source_tree import ROOT

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot

ROBOTS = ROOT / 'config' / 'robots'
KATO = str(ROBOTS / 'kato_10_1.yaml')
GROUPS = str(ROBOTS / 'kato_1_1.yaml')
SPATIAL = str(ROBOTS / 'spatial_6.yaml')

PULLEY = ROOT / 'examples' / 'soft_pulley.py'


def answer(capsys, *arguments):
    """Run a command that prints JSON; return what it says."""
    assert main([*arguments, '--json']) == 0
    out, err = capsys.readouterr()
    assert 'Traceback' not in err
    return json.loads(out)


def test_shape_has_exactly_the_promised_keys_and_sizes(capsys):
    found = answer(capsys, 'model', 'shape', KATO, '--tensions', 'dist_right=0.51,prox_left=0.2')
    assert list(found) == ['positions', 'bend', 'tensions', 'pulls', 'tip']
    assert np.shape(found['positions']) == (30, 3) and np.shape(found['bend']) == (30, 2)
    assert list(found['tip']) == ['position', 'direction']
    assert found['tip']['position'] == found['positions'][-1]
    tendons = ['prox_left', 'prox_right', 'dist_left', 'dist_right']
    assert list(found['tensions']) == list(found['pulls']) == tendons
    assert found['tensions']['prox_left'][0] == 0.2
    assert found['tensions']['prox_left'][15:] == [0.0] * 15
    assert min(found['tensions']['dist_right']) > 0.0


def test_shape_says_what_the_model_says(capsys):
    found = answer(capsys, 'model', 'shape', SPATIAL, '--tensions', 'dist_one=0.9,prox_two=1.2')
    shape = Model(load_robot(SPATIAL)).shape({'dist_one': 0.9, 'prox_two': 1.2})
    assert np.array_equal(found['positions'], shape.positions)
    assert list(found['pulls'].values()) == shape.tendon_pulls.tolist()


def test_a_group_is_pulled_by_its_name_and_every_tendon_is_listed(capsys):
    found = answer(capsys, 'model', 'shape', GROUPS, '--tensions', 'dist_left=1')
    pulled = [name for name, along in found['tensions'].items() if along[0] == 1.0]
    assert pulled == ['dist_left_1', 'dist_left_2', 'dist_left_3']


def test_shape_takes_wire_pulls(capsys):
    found = answer(capsys, 'model', 'shape', KATO, '--pulls', 'dist_right=6,prox_left=0.001m')
    assert found['pulls']['dist_right'] == pytest.approx(0.006, abs=1e-9)
    assert found['pulls']['prox_left'] == pytest.approx(0.001, abs=1e-9)
    assert found['tensions']['dist_left'][0] == 0.0


def test_tensions_beyond_the_limits_are_shown_when_asked_for(capsys):
    found = answer(capsys, 'model', 'shape', KATO, '--tensions', 'dist_right=7', '--beyond-limits')
    assert found['tensions']['dist_right'][0] == 7.0


def test_lengths_are_millimetres_unless_they_say_otherwise(capsys):
    mm = answer(capsys, 'model', 'reach', KATO, '--position', '60,0,150')
    for other in (('60mm,0,0.15m',), ('6,0,15', '--unit', 'cm'), ('0.06,0,0.15', '--unit', 'm')):
        again = answer(capsys, 'model', 'reach', KATO, '--position', *other)
        assert again['tip']['position'] == pytest.approx(mm['tip']['position'], abs=1e-9)
    assert mm['tip']['position'] == pytest.approx([0.06, 0.0, 0.15], abs=1e-4)


def test_what_reach_finds_gives_that_tip(capsys):
    target = Model(load_robot(KATO)).shape([0.1, 0.9, 0.7, 0.1])
    place = ','.join(f'{1e3 * x!r}' for x in target.tip_position.tolist())
    along = ','.join(map(repr, target.tip_direction.tolist()))
    asked = '--position', place, '--direction', along
    found = answer(capsys, 'model', 'reach', KATO, *asked)
    keys = 'tensions', 'pulls', 'tip', 'error', 'status', 'region', 'tip_stiffness'
    assert tuple(found) == keys
    assert found['status'] == 'reached'
    assert found['error']['position'] < 1e-5 and found['error']['direction'] < 1e-3
    tensions = ','.join(f'{name}={value!r}' for name, value in found['tensions'].items())
    shape = answer(capsys, 'model', 'shape', KATO, '--tensions', tensions)
    assert np.allclose(shape['tip']['position'], target.tip_position, rtol=0, atol=1e-5)
    assert np.allclose(list(shape['pulls'].values()), list(found['pulls'].values()))


def test_reach_says_when_a_target_is_out_of_reach(capsys):
    found = answer(capsys, 'model', 'reach', KATO, '--position', '0,0,1000')
    assert found['status'] == 'nearest'
    assert found['error']['position'] == pytest.approx(1.0 - 0.208, abs=1e-3)


def test_json_goes_to_a_file_and_the_table_to_the_terminal(capsys, tmp_path):
    out = tmp_path / 'shape.json'
    assert main(['model', 'shape', KATO, '--tensions', 'dist_right=0.5', '--json', str(out)]) == 0
    assert capsys.readouterr().out.startswith('tip at (')
    assert 'positions' in json.loads(out.read_text())


def test_an_effect_of_the_users_own_works_on_the_command_line(capsys, tmp_path):
    robot = load_robot(KATO).with_effect('soft_pulley', {'loss': 0.1})
    from tendon_robot_ros.robot import dump_robot

    (tmp_path / 'arm.yaml').write_text(dump_robot(robot))
    found = answer(
        capsys,
        *('model', 'shape', str(tmp_path / 'arm.yaml'), '--tensions', 'dist_right=2'),
        *('--effect-file', str(PULLEY)),
    )
    less = answer(capsys, 'model', 'shape', KATO, '--tensions', 'dist_right=1.6')
    assert found['positions'] == less['positions']


MISTAKES = {
    'shape': [
        (['--tensions', 'dist_right=1,foo=2'], "unknown 'foo'; kato_10_1 has prox_left, "),
        (['--tensions', 'dist_right'], 'expected NAME=NUMBER,NAME=NUMBER in N, got '),
        (['--tensions', 'dist_right=a'], 'expected NAME=NUMBER,NAME=NUMBER in N, got '),
        (['--tensions', 'dist_right=1,dist_right=2'], "--tensions: 'dist_right' stands twice"),
        (['--tensions', 'dist_right=nan'], 'tensions: expected 4 finite numbers, got '),
        (['--tensions', 'dist_right=-1'], 'dist_right: expected a finite tension not below 0 N, '),
        ([], 'one of the arguments --tensions --pulls is required; see '),
        (['--pulls', 'dist_right=inf'], "expected a number with a unit such as mm, got 'inf'"),
        (['--pulls', 'dist_right=0.006'], 'if m is meant, say --unit m'),
        (['--pulls', 'dist_right=6', '--unit', 'm'], 'if mm is meant, say --unit mm'),
        (['--pulls', 'dist_right'], '--pulls: expected NAME=LENGTH,NAME=LENGTH in mm, got '),
        (['--tensions', 'dist_right=7'], 'dist_right is 7 N, above the limit of 5 N in '),
        (['--pulls', 'dist_right=5,dist_left=2'], 'dist_left 2 mm, dist_right 5 mm together (off'),
        (['--tensions', 'dist_right=1', '--effect-file', 'no.py'], 'EFFECT, got No such file'),
    ],
    'reach': [
        ([], 'target: expected --position, --direction, or both, got neither'),
        (['--position', '1,2'], "--position: expected three lengths x,y,z, got '1,2'"),
        (['--position', '0.06,0,0.15'], '0.06,0,0.15 mm is 0.1616 mm from the base of an '),
        (['--position', '0.06m,0,15m'], ': 0.06m,0,15m is 15000 mm from the base of an arm of '),
        (['--position', '60,0,150', '--unit', 'm'], '60,0,150 m is 161600 mm from the'),
        (['--position', 'nan,0,0'], "expected a number with a unit such as mm, got 'nan'"),
        (['--direction', '0,0,0'], 'direction: expected a vector of some length, got '),
    ],
    'workspace': [
        (['--view', angle], f'--view: expected an angle of 0° or more, got {angle}')
        for angle in ('nan', 'inf', '-1')
    ],
}


@pytest.mark.parametrize(
    ('command', 'arguments', 'message'),
    [(command, *mistake) for command, mistakes in MISTAKES.items() for mistake in mistakes],
)
def test_a_mistake_in_a_command_is_one_line(command, arguments, message, capsys):
    assert main(['model', command, KATO, *arguments]) == 1
    out, err = capsys.readouterr()
    assert out == '' and err.startswith('error: ') and message in err and err.count('\n') == 1, err
