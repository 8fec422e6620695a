"""The commands shape, reach, describe and new-robot, as a user types them."""

import io
import itertools
import json
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import yaml
from source_tree import ROOT

from tendon_robot_ros.cli.main import main
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot, parse_robot
from tendon_robot_ros.robot_urdf import joint_angles, joint_names, urdf

ROBOTS = ROOT / 'config' / 'robots'
KATO = str(ROBOTS / 'kato_10_1.yaml')
GROUPS = str(ROBOTS / 'kato_1_1.yaml')
SPATIAL = str(ROBOTS / 'spatial_6.yaml')

LAW = """
from tendon_robot_ros.effects import Effect, Parameter


def law(tension, share):
    return tension * (1.0 - share)


EFFECT = Effect(name='knot', title='a knot takes a share', stage='actuation', law=law,
                parameters=(Parameter('share', '1', 0.0, 0.9, 0.0, typical=0.1),))
"""


def answer(capsys, *arguments):
    """Run a command that prints JSON; return what it says."""
    assert main([*arguments, '--json']) == 0
    out, err = capsys.readouterr()
    assert 'Traceback' not in err
    return json.loads(out)


def test_shape_has_exactly_the_promised_keys_and_sizes(capsys):
    found = answer(capsys, 'shape', KATO, '--tensions', 'dist_right=0.51,prox_left=0.2')
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
    found = answer(capsys, 'shape', SPATIAL, '--tensions', 'dist_one=0.9,prox_two=1.2')
    shape = Model(load_robot(SPATIAL)).shape({'dist_one': 0.9, 'prox_two': 1.2})
    assert np.array_equal(found['positions'], shape.positions)
    assert list(found['pulls'].values()) == shape.tendon_pulls.tolist()


def test_a_group_is_pulled_by_its_name_and_every_tendon_is_listed(capsys):
    found = answer(capsys, 'shape', GROUPS, '--tensions', 'dist_left=1')
    assert [name for name, along in found['tensions'].items() if along[0] == 1.0] == [
        'dist_left_1',
        'dist_left_2',
        'dist_left_3',
    ]


def test_shape_takes_wire_pulls(capsys):
    found = answer(capsys, 'shape', KATO, '--pulls', 'dist_right=0.006,prox_left=0.001')
    assert found['pulls']['dist_right'] == pytest.approx(0.006, abs=1e-9)
    assert found['pulls']['prox_left'] == pytest.approx(0.001, abs=1e-9)
    assert found['tensions']['dist_left'][0] == 0.0


def test_what_reach_finds_gives_that_tip(capsys):
    target = Model(load_robot(KATO)).shape([0.1, 0.9, 0.7, 0.1])
    found = answer(
        capsys,
        *('reach', KATO, '--position', ','.join(map(repr, target.tip_position.tolist()))),
        *('--direction', ','.join(map(repr, target.tip_direction.tolist()))),
    )
    assert list(found) == ['tensions', 'pulls', 'tip', 'error', 'status']
    assert found['status'] == 'reached'
    assert found['error']['position'] < 1e-5 and found['error']['direction'] < 1e-3
    tensions = ','.join(f'{name}={value!r}' for name, value in found['tensions'].items())
    shape = answer(capsys, 'shape', KATO, '--tensions', tensions)
    assert np.allclose(shape['tip']['position'], target.tip_position, rtol=0, atol=1e-5)
    assert np.allclose(list(shape['pulls'].values()), list(found['pulls'].values()))


def test_reach_says_when_a_target_is_out_of_reach(capsys):
    found = answer(capsys, 'reach', KATO, '--position', '0,0,1')
    assert found['status'] == 'nearest'
    assert found['error']['position'] == pytest.approx(1.0 - 0.208, abs=1e-3)


def test_json_goes_to_a_file_and_the_table_to_the_terminal(capsys, tmp_path):
    out = tmp_path / 'shape.json'
    assert main(['shape', KATO, '--tensions', 'dist_right=0.5', '--json', str(out)]) == 0
    assert capsys.readouterr().out.startswith('tip at (')
    assert 'positions' in json.loads(out.read_text())


def test_an_effect_of_the_users_own_works_on_the_command_line(capsys, tmp_path):
    (tmp_path / 'knot.py').write_text(LAW)
    robot = load_robot(KATO).with_effect('knot', {'share': 0.5})
    from tendon_robot_ros.robot import dump_robot

    (tmp_path / 'arm.yaml').write_text(dump_robot(robot))
    found = answer(
        capsys,
        *('shape', str(tmp_path / 'arm.yaml'), '--tensions', 'dist_right=1'),
        *('--effect-file', str(tmp_path / 'knot.py')),
    )
    half = answer(capsys, 'shape', KATO, '--tensions', 'dist_right=0.5')
    assert found['positions'] == half['positions']


MISTAKES = [
    (['--tensions', 'dist_right=1,foo=2'], "tensions: unknown 'foo'; kato_10_1 has prox_left, "),
    (['--tensions', 'dist_right'], '--tensions: expected NAME=NUMBER,NAME=NUMBER in N, got '),
    (['--tensions', 'dist_right=a'], '--tensions: expected NAME=NUMBER,NAME=NUMBER in N, got '),
    (['--tensions', 'dist_right=1,dist_right=2'], "--tensions: 'dist_right' stands twice"),
    (['--tensions', 'dist_right=nan'], 'tensions: expected 4 finite numbers, got '),
    (['--tensions', 'dist_right=-1'], 'tensions: expected none below 0 N, got '),
    ([], 'one of the arguments --tensions --pulls is required; see '),
    (['--pulls', 'dist_right=inf'], 'pulls: expected 4 lengths [m] (blank: slack), got '),
    (
        ['--pulls', 'dist_right=0.005,dist_left=0.002'],
        'pulls: no tensions give dist_left 2 mm, dist_right 5 mm together (off by ',
    ),
    (
        ['--tensions', 'dist_right=1', '--effect-file', 'no.py'],
        'no.py: expected a Python file with an EFFECT, got No such file',
    ),
]


@pytest.mark.parametrize(('arguments', 'message'), MISTAKES)
def test_a_mistake_in_a_command_is_one_line(arguments, message, capsys):
    assert main(['shape', KATO, *arguments]) == 1
    out, err = capsys.readouterr()
    assert out == '' and message in err and err.count('\n') == 1, err


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ([], 'target: expected --position, --direction, or both, got neither'),
        (['--position', '1,2'], "--position: expected three numbers x,y,z, got '1,2'"),
        (['--position', 'nan,0,0'], 'position: expected 3 finite numbers, got '),
        (['--direction', '0,0,0'], 'direction: expected a vector of some length, got '),
    ],
)
def test_a_mistake_in_a_target_is_one_line(arguments, message, capsys):
    assert main(['reach', KATO, *arguments]) == 1
    out, err = capsys.readouterr()
    assert out == '' and err.startswith(f'error: {message}') and err.count('\n') == 1


def test_describe_names_the_model_and_every_part(capsys):
    assert main(['describe', KATO]) == 0
    out = capsys.readouterr().out
    assert out.startswith('robot kato_10_1: 2 sections, 30 cells, 4 tendons, 208 mm\n')
    assert 'model: FKM (tendon_friction, friction coefficient 0.33)\n' in out
    for name in ('proximal', 'distal', 'prox_left', 'dist_right', '0.1 to 5 N each'):
        assert name in out


def bent(tree, angles):
    """Return the frames (n, 4, 4) of the cells' hinges: what RViz makes of a URDF."""
    angles = dict(zip([j.get('name') for j in tree.iter('joint')], angles, strict=True))
    frame, frames = np.eye(4), []
    for joint in tree.iter('joint'):
        axis = np.array([float(v) for v in joint.find('axis').get('xyz').split()])
        up = np.eye(4)
        up[:3, 3] = [float(v) for v in joint.find('origin').get('xyz').split()]
        cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        angle = angles[joint.get('name')]
        turn = np.eye(4)
        turn[:3, :3] += np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
        frame = frame @ up @ turn
        frames.append(frame)
    return np.array(frames[1::2])


def test_the_urdf_is_a_chain_of_two_joints_per_cell(capsys):
    assert main(['describe', SPATIAL, '--urdf']) == 0
    tree = ElementTree.fromstring(capsys.readouterr().out)
    joints = list(tree.iter('joint'))
    assert [j.get('name') for j in joints] == list(joint_names(load_robot(SPATIAL)))
    assert len(joints) == 2 * 30
    links = [link.get('name') for link in tree.iter('link')]
    assert len(set(links)) == len(links)
    assert {j.find('child').get('link') for j in joints} == set(links) - {'base'}
    for before, joint in itertools.pairwise(joints):
        assert joint.find('parent').get('link') == before.find('child').get('link')


def test_the_urdf_takes_the_shape_of_the_model():
    robot = load_robot(SPATIAL)
    shape = Model(robot).shape([0.1, 1.5, 0.1, 0.1, 0.1, 1.2])
    frames = bent(ElementTree.fromstring(urdf(robot)), joint_angles(shape.frames))
    tips = frames[:, :3, 3] + 0.003 * frames[:, :3, 2]  # from the hinge to the end of the cell
    assert np.allclose(tips, shape.positions, rtol=0, atol=1e-9)
    assert np.allclose(frames[:, :3, 2], shape.frames[:, :, 2], rtol=0, atol=1e-12)


def new_robot(monkeypatch, tmp_path, answers, *arguments):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, 'stdin', io.StringIO(answers))
    return main(['new-robot', *arguments])


def test_new_robot_takes_answers_from_a_pipe_and_draws(monkeypatch, tmp_path, capsys):
    answers = 'my arm\n3\n4\n6\n\nhinge\n3\n5\n\n8\n0.2\nhorizontal\n'
    assert new_robot(monkeypatch, tmp_path, answers) == 0
    robot = load_robot(tmp_path / 'my_arm.yaml')
    assert (robot.name, robot.cells, len(robot.tendons)) == ('my arm', 12, 9)
    assert robot.tension_limits == (0.1, 8.0) and robot.gravity == (9.81, 0.0, 0.0)
    assert {np.hypot(*t.base).round(6) for t in robot.tendons} == {0.005}
    assert robot.effects == {'tendon_friction': {'friction_coefficient': 0.2}}
    assert (tmp_path / 'my_arm.png').read_bytes().startswith(b'\x89PNG')
    assert 'written: my_arm.yaml' in capsys.readouterr().out


def test_new_robot_needs_no_answer_at_all(monkeypatch, tmp_path):
    assert new_robot(monkeypatch, tmp_path, '', '--output', 'arm.yaml') == 0
    robot = load_robot(tmp_path / 'arm.yaml')
    assert robot.inputs == ('proximal_right', 'proximal_left', 'distal_right', 'distal_left')


@pytest.mark.parametrize(
    ('answers', 'message'),
    [
        ('\n0\n', "How many sections: expected a whole number from 1 to 20, got '0'"),
        ('\n\n\n-3\n', "Length of a cell [mm]: expected a number from 0.001 to 10000, got '-3'"),
        ('\n\n\n\n\nbar\n', "Cells bend as: arc, hinge: expected arc or hinge, got 'bar'"),
        ('\n' * 8 + '5\n2\n', "Highest tension [N]: expected a number from 5 to 100000, got '2'"),
    ],
)
def test_a_wrong_answer_from_a_pipe_is_one_line(answers, message, monkeypatch, tmp_path, capsys):
    assert new_robot(monkeypatch, tmp_path, answers) == 1
    assert capsys.readouterr().err.splitlines()[-1].endswith(f'error: {message}')
    assert list(tmp_path.iterdir()) == []


def test_new_robot_replaces_no_file(monkeypatch, tmp_path, capsys):
    (tmp_path / 'arm.yaml').write_text('mine')
    assert new_robot(monkeypatch, tmp_path, '', '--output', 'arm.yaml') == 1
    assert 'arm.yaml: is there already; use --overwrite or another --output' in (
        capsys.readouterr().err
    )
    assert (tmp_path / 'arm.yaml').read_text() == 'mine'


@pytest.mark.parametrize('path', sorted(ROBOTS.glob('*.yaml')), ids=lambda path: path.stem)
def test_every_robot_in_config_loads_bends_and_is_described(path, capsys):
    robot = load_robot(path)
    assert parse_robot(yaml.safe_dump(yaml.safe_load(path.read_text()))).inputs == robot.inputs
    shape = Model(robot).shape(np.full(len(robot.inputs), robot.tension_limits[0]))
    assert np.isfinite(shape.positions).all()
    assert main(['describe', str(path)]) == 0
