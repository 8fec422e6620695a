"""Launch and parameter files name only what the nodes know, and start what they say."""

import contextlib
import importlib.util
import os

import pytest
import yaml
from launch_stand_in import in_place, launch, load
from source_tree import ROOT

pytest.importorskip('rclpy')

from tendon_robot_ros.cli.main import COMMANDS
from tendon_robot_ros.common.processes import PARENT
from tendon_robot_ros.ros.shared.parameters import declared

LAUNCH = sorted((ROOT / 'launch').glob('*.launch.py'))
SHARES = {'tendon_robot_ros': ROOT}


@pytest.fixture
def started(tmp_path):
    """Give what a launch file starts: its processes by executable."""

    def start(name, **arguments):
        processes = launch(ROOT / 'launch' / f'{name}.launch.py', tmp_path, SHARES, **arguments)
        return {process.executable: process for process in processes}

    return start


@pytest.mark.parametrize('name', ['controller', 'driver'])
def test_a_parameter_file_holds_the_defaults(name):
    content = yaml.safe_load((ROOT / 'config' / f'{name}.yaml').read_text())
    specs = declared()[name]
    for key, value in content['/**']['ros__parameters'].items():
        assert specs[key].checked(value) == specs[key].default


@pytest.mark.parametrize('name', ['controller', 'driver'])
def test_every_parameter_says_what_it_is(name):
    for spec in declared()[name].values():
        assert spec.text
        assert spec.checked(spec.default) is not None
        assert type(spec.default) is not float or spec.unit


@pytest.mark.parametrize('path', LAUNCH, ids=lambda path: path.name)
def test_every_argument_says_what_it_is(path):
    worlds = [in_place()]
    if importlib.util.find_spec('launch_ros') is not None:
        worlds.append(contextlib.nullcontext())  # the real one as well
    for world in worlds:
        with world:
            entities = load(path).generate_launch_description().entities
        arguments = [one for one in entities if type(one).__name__ == 'DeclareLaunchArgument']
        assert len(arguments) > 2
        assert all(one.description for one in arguments)


@pytest.mark.parametrize('space', ['', 'left_arm', '/left_arm'])
@pytest.mark.parametrize('path', LAUNCH, ids=lambda path: path.name)
def test_nodes_of_this_package_get_parameters_that_they_know(path, space, started):
    own = [
        process
        for process in started(path.name.split('.')[0], namespace=space).values()
        if process.package == 'tendon_robot_ros'
    ]
    for process in own:
        assert process.executable in COMMANDS
        name = process.executable.replace('-', '_')
        specs = declared()[name]
        assert f'__node:={name}' in process.arguments
        assert f'__ns:=/{space.strip("/")}' in process.arguments
        given = process.parameters(f'/left_arm/{name}' if space else f'/{name}')
        assert given
        for key, value in given.items():
            specs[key].checked(value)


def test_without_arguments_it_is_the_paper_s_robot_on_the_mock(started):
    nodes = started('robot')
    assert list(nodes) == ['driver', 'controller']
    told = nodes['driver'].parameters('/driver')
    assert (told['robot'], told['config'], told['rate']) == ('kato_10_1', 'mock', 200.0)
    assert nodes['controller'].parameters('/controller')['model'] == 'kato_10_1'


def test_a_backend_is_not_told_the_configuration_of_the_mock(started):
    told = started('robot', backend='dynamixel')['driver'].parameters('/driver')
    assert told['backend'] == 'dynamixel'
    assert 'config' not in told
    told = started('robot', backend='mock')['driver'].parameters('/driver')
    assert told['config'] == 'mock'


def test_a_params_file_counts_more_than_the_defaults_and_less_than_arguments(started, tmp_path):
    mine = {'robot': 'mine', 'model': 'mine', 'backend': 'serial', 'config': 'm', 'rate': 100.0}
    (tmp_path / 'mine.yaml').write_text(yaml.dump({'/**': {'ros__parameters': mine}}))
    file = str(tmp_path / 'mine.yaml')
    nodes = started('robot', params_file=file)
    told = nodes['driver'].parameters('/driver')
    assert {key: told[key] for key in mine} == mine
    assert nodes['controller'].parameters('/controller')['model'] == 'mine'
    nodes = started('robot', params_file=file, robot='10', namespace='left')
    told = nodes['driver'].parameters('/left/driver')
    assert (told['robot'], told['backend']) == ('10', 'serial')
    assert nodes['controller'].parameters('/left/controller')['model'] == '10'


def test_a_params_file_that_is_not_there_is_refused(started):
    with pytest.raises(RuntimeError, match=r'params_file: none.yaml: no such file'):
        started('robot', params_file='none.yaml')


def test_the_driver_is_never_restarted_and_nothing_outlives_it(started):
    for respawn in ('false', 'true'):
        nodes = started('robot', respawn=respawn)
        assert nodes['driver'].ends_all
        assert 'respawn' not in nodes['driver'].settings
    assert nodes['controller'].settings['respawn'] is True
    assert not nodes['controller'].ends_all
    assert started('robot')['controller'].ends_all
    with pytest.raises(RuntimeError, match='respawn'):
        started('robot', respawn='yes')


def test_a_node_ends_when_launch_is_killed(started):
    for process in started('robot').values():
        assert process.settings['additional_env'] == {PARENT: str(os.getpid())}
    debugged = started('robot', **{'launch-prefix': 'gdb -ex run --args'})
    assert all('additional_env' not in process.settings for process in debugged.values())


def test_the_driver_has_time_for_its_release(started):
    assert started('robot')['driver'].settings['sigterm_timeout'] == '60'
    assert started('robot', sigterm_timeout='90')['driver'].settings['sigterm_timeout'] == '90'


def test_the_log_level_is_passed_on(started):
    for process in started('robot', log_level='debug').values():
        at = process.arguments.index('--log-level')
        assert process.arguments[at - 1 : at + 2] == ['--ros-args', '--log-level', 'debug']


@pytest.mark.parametrize(
    ('device', 'reader', 'joy'),
    [('gamepad', 'joy_node', 'joy'), ('spacemouse', 'spacenav_node', 'spacenav/joy')],
)
def test_a_stick_is_read_and_drives_the_controller(started, device, reader, joy):
    nodes = started('joystick', device=device, controller='mine', frame='10')
    assert list(nodes) == [reader, 'teleop_node']
    arguments = nodes['teleop_node'].arguments
    assert f'joy:={joy}' in arguments
    assert 'cmd_vel:=mine/delta_twist' in arguments
    assert str(ROOT / 'config' / f'teleop_{device}.yaml') in arguments
    assert nodes['teleop_node'].parameters('/teleop_node')['frame'] == '10'
    assert all(process.ends_all for process in nodes.values())


def test_an_unknown_stick_is_refused(started):
    with pytest.raises(RuntimeError, match='device: wheel'):
        started('joystick', device='wheel')


def test_robot_model_does_not_outlive_rviz(started):
    nodes = started('view', fixed_frame='mine_base', controller='mine')
    assert list(nodes) == ['rviz2', 'robot-model']  # where RViz is missing, nothing is started
    assert nodes['rviz2'].ends_all
    assert nodes['rviz2'].arguments[:4] == [
        '-d', str(ROOT / 'config' / 'robot.rviz'), '-f', 'mine_base',
    ]  # fmt: skip
    told = nodes['robot-model'].parameters('/robot_model')
    assert told == {'controller': 'mine'}
