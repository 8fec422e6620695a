"""The files for teleop_twist_joy: its parameters, and what they make the arm do."""

import time

import pytest
import yaml
from source_tree import ROOT

pytest.importorskip('rclpy')

from geometry_msgs.msg import TwistStamped
from ros_station import DISCOVERY, holding
from sensor_msgs.msg import Joy

# README of teleop_twist_joy 2.6; axis_... and scale_... hold x, y, z or roll, pitch, yaw
KNOWN = {'publish_stamped_twist', 'frame', 'require_enable_button', 'enable_button',
         'enable_turbo_button', 'inverted_reverse'}  # fmt: skip
LINEAR, ANGULAR = {'x', 'y', 'z'}, {'roll', 'pitch', 'yaw'}
FILES = {name: f'teleop_{name}.yaml' for name in ('gamepad', 'spacemouse')}
SPACE = '/joystick'
HELD_UNTIL = 0.01  # [m] the tip has gone by then


def parameters(name):
    return yaml.safe_load((ROOT / 'config' / FILES[name]).read_text())['/**']['ros__parameters']


def as_teleop_twist_joy(told, joy):
    """Turn a Joy into a TwistStamped as its source does; None while its button is up."""
    if told['require_enable_button'] and not joy.buttons[told['enable_button']]:
        return None
    message = TwistStamped()
    message.header.frame_id, message.header.stamp = told['frame'], joy.header.stamp
    for part, names in (('linear', 'x y z'), ('angular', 'roll pitch yaw')):
        for field, name in zip('xyz', names.split(), strict=True):
            axis = told[f'axis_{part}'][name]
            value = joy.axes[axis] * told[f'scale_{part}'][name] if axis >= 0 else 0.0
            setattr(getattr(message.twist, part), field, float(value))
    return message


@pytest.mark.parametrize('name', FILES)
def test_every_parameter_is_one_of_teleop_twist_joy(name):
    told = parameters(name)
    maps = {'axis_linear': LINEAR, 'scale_linear': LINEAR, 'scale_linear_turbo': LINEAR,
            'axis_angular': ANGULAR, 'scale_angular': ANGULAR,
            'scale_angular_turbo': ANGULAR}  # fmt: skip
    assert set(told) <= KNOWN | set(maps)
    assert told['publish_stamped_twist'] is True
    for key in set(told) & set(maps):
        assert set(told[key]) == maps[key]
        kind = int if key.startswith('axis') else float
        assert all(type(value) is kind for value in told[key].values())


@pytest.fixture(scope='module')
def station(tmp_path_factory):
    logs = tmp_path_factory.mktemp('logs')
    with holding(SPACE, logs, controller={'twist_timeout': 0.3}) as station:
        yield station


@pytest.mark.ros
@pytest.mark.parametrize(('name', 'axis', 'sign'), [('gamepad', 0, -1), ('spacemouse', 0, 1)])
def test_the_tip_follows_the_stick_and_stops_with_it(station, name, axis, sign):
    told = parameters(name)
    station.go_to_point(0.03, 0.19)
    before = station.tip()

    def joy(value, button=1):
        message = Joy(axes=[0.0] * 6, buttons=[0] * 11)
        message.axes[axis] = value
        message.buttons[4] = button
        message.header.stamp = station.node.get_clock().now().to_msg()
        twist = as_teleop_twist_joy(told, message)
        if twist is not None:
            station.send('controller/delta_twist', twist)
        station.spin(0.02)

    for _ in range(25):  # at rest it takes no target away
        joy(0.0)
    assert station.code() == 'reached'
    began = time.monotonic()
    while sign * (station.tip() - before)[0] < HELD_UNTIL:
        assert time.monotonic() - began < DISCOVERY, station.tip()
        joy(1.0)
    joy(0.0)
    station.until_code(station.controller, 'holding')
    driven = time.monotonic() - began  # longer on a busy machine
    station.catch_up(0.5)
    moved = station.tip()[0] - before[0]
    assert HELD_UNTIL <= sign * moved < abs(told['scale_linear']['x']) * driven
