"""The bridge to ros2_control, over topics, against a group controller and a broadcaster."""

import time

import numpy as np
import pytest
import yaml

pytest.importorskip('rclpy')

from group_station import JOINTS, Group
from ros_station import HIGH, INPUTS, LOW, Station, last, point, start, values
from source_tree import ROOT

from tendon_robot_ros.common.errors import DriverError
from tendon_robot_ros.drivers import make_driver
from tendon_robot_ros.robot import load_robot

CONFIG = yaml.safe_load((ROOT / 'config/ros2_control.yaml').read_text())
SIGNS, RADIUS = np.array([1, -1, 1, -1]), CONFIG['spool_radius']
ROBOT = load_robot(ROOT / 'config/robots/kato_10_1.yaml')


def test_the_two_example_files_fit_each_other():
    other = yaml.safe_load((ROOT / 'config/ros2_controllers.yaml').read_text())
    types = other['controller_manager']['ros__parameters']
    name = CONFIG['command_topic'].split('/')[1]
    assert types[name]['type'] == 'effort_controllers/JointGroupEffortController'
    for controller in ('tendon_effort_controller', 'tendon_position_controller'):
        assert other[controller]['ros__parameters']['joints'] == CONFIG['joints'] == list(JOINTS)


class Wire:
    """Four springs behind the driver, without ROS."""

    def __init__(self, command_topic, state_topic):
        self.topics, self.sent, self.silent = (command_topic, state_topic), [], False

    def send(self, values):
        self.sent.append(values)

    def states(self):
        if self.silent:
            return {}
        torque = np.array(self.sent[-1] if self.sent else [0.0] * 4)
        return {n: (time.monotonic(), t / 0.05, t) for n, t in zip(JOINTS, torque, strict=True)}

    def close(self):
        pass


def driver(mode='tension', **changes):
    made = make_driver('ros2_control', ROBOT, CONFIG | changes, mode=mode, link=Wire)
    made.open()
    return made


def test_tensions_become_efforts_in_the_order_of_the_controller():
    order = ['motor_3', 'motor_1', 'motor_2', 'motor_4']
    made = driver(joints=order)
    made.enable()
    for _ in range(100):
        made._written -= 0.02
        made.write(np.array([1.0, 0.2, 0.3, 0.4]))
    expected = np.array([0.3, 1.0, -0.2, -0.4]) * RADIUS
    assert made.link.sent[-1] == pytest.approx(expected)


def test_pulls_become_positions_from_their_zero():
    tendons = {name: {**CONFIG['tendons'][name], 'zero': 0.5} for name in INPUTS}
    made = driver('pull', tendons=tendons)
    made._goal, made._on[:] = np.zeros(4), True
    for _ in range(100):
        made._written = -np.inf
        made.write(np.array([0.01, -0.01, 0.0, 0.02]))
    assert made.link.sent[-1] == pytest.approx([1.5, 1.5, 0.5, -1.5])


def test_disabling_leaves_no_effort_on_the_named_tendon():
    made = driver()
    made.enable()
    for _ in range(100):
        made._written -= 0.02
        made.write(np.full(4, 1.0))
    made.disable(['prox_left'])
    made.write(np.full(4, 1.0))
    assert made.link.sent[-1] == pytest.approx([0.0, -RADIUS, RADIUS, -RADIUS])


def test_disabling_in_pull_mode_moves_no_joint():
    made = driver('pull')
    made.link.silent = True
    with pytest.raises(DriverError, match='is joint_state_broadcaster active'), made:
        made.enable()
    assert made.link.sent == []


def test_silent_joints_are_named_and_torque_is_refused():
    made = driver()
    made.link.silent = True
    reading = made.read()
    assert np.isnan(reading.tensions).all()
    assert reading.faults[0].code == 'silent'
    with pytest.raises(DriverError, match='is joint_state_broadcaster active'):
        made.enable()


@pytest.mark.parametrize(('mode', 'what'), [('tension', 'effort'), ('pull', 'position')])
def test_joints_without_a_state_of_the_mode_are_refused(monkeypatch, mode, what):
    made = driver(mode)
    monkeypatch.setattr(
        made.link, 'states', lambda: {n: (time.monotonic(), np.nan, np.nan) for n in JOINTS}
    )
    with pytest.raises(DriverError, match=f'{what} is not there: .* in {mode} mode'):
        made.enable()


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        (
            {
                'joints': ['motor_1'] * 4,
                'tendons': {name: {'joint': 'motor_1'} for name in INPUTS},
            },
            "tendons: expected names that differ, got 'motor_1'",
        ),
        ({'joints': ['motor_1']}, 'joints: expected the joints of the tendons, motor_1, motor_2'),
        ({'tendons': {'prox_left': {'joint': 'a'}}}, 'none for prox_right, dist_left, dist_right'),
        ({'spool_radius': 10}, 'spool_radius: expected a finite number from 0.0005 to 0.2 [m]'),
        ({'rate': 1}, 'rate'),
        ({'tension_source': 'guess'}, 'tension_source: expected one of load_cell, current'),
    ],
)
def test_a_configuration_is_refused_by_key(changes, message):
    with pytest.raises(DriverError) as refused:
        driver(**changes)
    assert message in str(refused.value)


@pytest.fixture(params=['tension', 'pull'])
def bridge(request, tmp_path):
    space, mode = f'/bridge_{request.param}', request.param
    config = {**CONFIG, 'timeout': 2.0}  # [s]; the motors are in this process, which may be late
    config['command_topic'] = (
        f'/tendon_{"effort" if mode == "tension" else "position"}_controller/commands'
    )
    options = {'backend': 'ros2_control', 'config': yaml.safe_dump(config), 'command_mode': mode}
    station = Station(space)
    group = Group(station.node, mode)
    with (
        start('driver', space, tmp_path, **options),
        start('controller', space, tmp_path, command_mode=mode),
    ):
        station.until_code(station.controller, 'holding', timeout=120.0)
        yield station, group
        station.close()


@pytest.mark.ros
def test_the_robot_moves_through_ros2_control_and_is_released_when_it_goes_silent(bridge):
    station, group = bridge

    message = point(0.06, 0.17)
    message.header.stamp = station.node.get_clock().now().to_msg()
    station.send('controller/target_point', message)
    station.until_code(station.controller, 'reached')
    moves = 0.3 if group.mode == 'tension' else 0.002  # [N], [m]

    def arrived():
        """Whether the last command is at the motors, and what they do in the states."""
        command, states = last(station.commands), last(station.states)
        if group.mode == 'tension':
            values, units = np.array(command.effort), RADIUS * SIGNS
            there = states.effort == pytest.approx(values, abs=0.02)
        else:
            values, units = np.array(command.position), SIGNS / RADIUS
            there = True
        got = group.received and group.received[-1] == pytest.approx(values * units, abs=1e-6)
        return np.abs(values).max() > moves and got and there

    station.until(arrived, 'the command at the motors')
    assert group.refused == 0
    assert tuple(last(station.states).name) == INPUTS
    if group.mode == 'tension':
        sent = np.array(group.received) * SIGNS / RADIUS
        assert sent.min() >= -1e-9
        assert sent.max() <= HIGH + 1e-9
        assert sent[-1].min() >= LOW - 1e-9
    assert values(last(station.driver))['tension_source'] == 'current'
    group.alive = False
    station.until(
        lambda: 'is joint_state_broadcaster active?' in last(station.driver).message, 'a fault'
    )
    station.until_code(station.driver, 'releasing', 'released')
    station.until(lambda: np.abs(group.received[-1]).max() <= 0.11 * RADIUS, 'the release')
    group.alive = True
    station.until(lambda: not values(last(station.driver))['faults'], 'joints that are heard')
    assert values(last(station.driver))['code'] in ('released', 'holding')
    assert station.trigger('driver/resume').success
    station.until_code(station.driver, 'following')
