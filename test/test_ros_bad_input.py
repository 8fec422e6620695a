"""Bad input: a clear message each, nothing moves for it, and the node goes on."""

import math
import time
from dataclasses import replace
from itertools import pairwise

import pytest

pytest.importorskip('rclpy')

from geometry_msgs.msg import PointStamped, PoseStamped, TwistStamped
from ros_station import BASE, HIGH, LOW, held, last, point, values
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tendon_robot_ros.robot import dump_robot, load_robot
from tendon_robot_ros.ros.shared.interface import COMMAND

pytestmark = pytest.mark.ros
SPACE = '/bad_input'
LONG = 'name: x\n' + 'sections: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]\n' * 25_000


running = held(SPACE)


@pytest.fixture
def station(running):
    """Give every test an arm that stands at a target."""
    running.go_to_point(0.06, 0.17)
    return running


def pose(**changes):
    """Give a good pose with something changed."""
    message = PoseStamped()
    message.header.frame_id = changes.pop('frame', BASE)
    message.header.stamp.sec = changes.pop('sec', 0)
    message.pose.position.z = 0.2
    for key, value in changes.items():
        part = message.pose.position if key in 'xyz' else message.pose.orientation
        setattr(part, key.removeprefix('q'), value)
    return message


def twist(**changes):
    message = TwistStamped()
    message.header.frame_id = changes.pop('frame', BASE)
    message.twist.linear.x = changes.pop('x', 0.0)
    return message


BAD = [
    (pose(x=math.nan), 'refused_not_finite', 'target_pose: expected finite numbers'),
    (pose(z=math.inf), 'refused_not_finite', 'target_pose: expected finite numbers'),
    (pose(x=60.0), 'refused_too_far', 'positions are in metres'),
    (pose(qw=0.0), 'refused_quaternion', 'has norm 0, expected 1'),
    (pose(qw=math.nan), 'refused_not_finite', 'target_pose: expected finite numbers'),
    (pose(frame='map'), 'refused_frame', "frame 'map', expected 'kato_10_1_base'"),
    (pose(frame=''), 'refused_frame', "frame '', expected 'kato_10_1_base'"),
    (pose(sec=1000), 'refused_stale', 'send stamp 0 for now'),
    (pose(sec=2**31 - 1), 'refused_future', 'in the future'),
    (point(math.nan, 0.1), 'refused_not_finite', 'target_point: expected finite numbers'),
    (point(0.0, 0.1, 'odom'), 'refused_frame', "frame 'odom'"),
    (twist(x=math.inf), 'refused_not_finite', 'delta_twist: expected finite numbers'),
    (twist(x=5.0), 'refused_too_fast', 'at most 1 m/s'),
    (twist(frame='map'), 'refused_frame', "expected 'kato_10_1_base' or 'kato_10_1_tip'"),
]
TOPICS = {PoseStamped: 'target_pose', PointStamped: 'target_point', TwistStamped: 'delta_twist'}


@pytest.mark.parametrize(('message', 'code', 'words'), BAD, ids=lambda value: str(value)[:20])
def test_a_bad_target_is_refused_and_the_arm_stays(station, message, code, words):
    before = station.tip()

    def refused():  # twists are heard best effort
        station.send(f'controller/{TOPICS[type(message)]}', message)
        station.spin(0.05)
        return station.code() == code

    station.until(refused, code)
    assert words in last(station.controller).message
    station.spin(0.1)
    assert station.tip() == pytest.approx(before, abs=1e-6)


def state(names, effort, position=None):
    return JointState(name=names, effort=effort, position=position or [0.0] * len(names))


GOOD = ['prox_left', 'prox_right', 'dist_left', 'dist_right']


@pytest.mark.parametrize(
    ('message', 'code', 'words'),
    [
        (state(['thumb'], [1.0]), 'refused_names', 'unknown thumb; expected prox_left'),
        (state(GOOD[:2], [1.0, 1.0]), 'refused_names', 'missing dist_left, dist_right'),
        (state(GOOD, [1.0] * 3), 'refused_length', 'expected 4 values of effort, got 3'),
        (state(GOOD, [math.inf] * 4), 'refused_not_finite', 'effort is infinite'),
        (state(GOOD, [math.nan] * 4, [math.nan] * 4), 'refused_not_finite', 'neither effort nor'),
    ],
    ids=lambda value: str(value)[:20],
)
def test_a_bad_state_is_refused_and_good_ones_go_on(station, message, code, words):
    def refused():
        station.send('tendon_states', message)
        return values(last(station.controller))['code'] == code

    station.until(refused, code)
    assert words in last(station.controller).message
    station.until_code(station.controller, 'reached')


@pytest.mark.parametrize(
    ('message', 'words'),
    [
        (state(['thumb'], [1.0]), 'tendon_command: unknown thumb'),
        (state(GOOD, [math.nan] * 4), 'tendon_command: expected finite numbers'),
        (state(GOOD, []), 'expected 4 values of effort, got 0'),
    ],
    ids=lambda value: str(value)[:20],
)
def test_a_bad_command_is_refused_by_the_driver(station, message, words):
    station.driver.clear()

    def refused():
        station.send('tendon_command', message)
        return any(words in said.message for _, said in station.driver)

    station.until(refused, words)
    station.until_code(station.driver, 'following')


def test_a_command_of_another_sender_is_ignored_and_said_however_large_it_is(station):
    station.driver.clear()
    before = len(station.states)

    def ignored():
        station.send('tendon_command', state(GOOD, [99.0, -5.0, 1.0, 1.0]))
        return any(values(said).get('ignored') for _, said in station.driver)

    station.until(ignored, 'the word ignored')
    efforts = [message.effort.tolist() for _, message in station.states[before:]]
    assert max(map(max, efforts)) <= HIGH
    assert min(map(min, efforts)) >= LOW - 1e-9


HUGE = 300_000


@pytest.mark.parametrize(
    ('topic', 'message', 'says'),
    [
        ('controller/target_pose', pose(frame='x' * HUGE), 'controller'),
        ('controller/tendon_trajectory', JointTrajectory(joint_names=['x' * HUGE]), 'controller'),
        ('tendon_states', JointState(name=['x' * HUGE]), 'controller'),
        ('tendon_command', JointState(name=['x' * HUGE]), 'driver'),
    ],
    ids=['pose', 'trajectory', 'states', 'command'],
)
def test_what_is_too_long_to_be_read_beside_the_commands_is_refused(station, topic, message, says):
    heard = {'controller': station.controller, 'driver': station.driver}[says]
    words = f'{topic.rpartition("/")[2]}: expected at most 250,000 bytes, got 300,'

    def refused():
        return any(
            words in said.message and values(said)['code'] == 'refused_length' for _, said in heard
        )

    station.send_until(topic, message, refused, words)
    there = pytest.approx([0.06, 0.0, 0.17], abs=1e-3)
    station.until(lambda: station.tip() == there, 'the arm where it was')
    station.go_to_point(0.05, 0.18)


@pytest.mark.parametrize(
    ('topic', 'kind', 'says'),
    [
        ('controller/target_pose', PoseStamped, 'controller'),
        ('tendon_states', JointState, 'controller'),
        ('tendon_command', JointState, 'driver'),
        ('stop', Bool, None),
    ],
)
def test_bytes_that_are_no_message_are_refused_and_the_next_one_is_heard(
    station, topic, kind, says
):
    """A program with another definition of the message, or a broken one."""
    cut = station.node.create_publisher(kind, topic, COMMAND)
    heard = {'controller': station.controller, 'driver': station.driver}.get(says, [])
    words = f'{topic.rpartition("/")[2]}: expected a message {kind.__name__}, got 4 bytes'
    try:
        station.until(lambda: cut.get_subscription_count() > 0, f'a subscriber of {topic}')

        def refused():
            cut.publish(b'\x00\x01\x00\x00')
            return says is None or any(words in said.message for _, said in heard)

        station.until(refused, words)
        station.spin(0.2)
    finally:
        station.node.destroy_publisher(cut)
    station.go_to_point(0.05, 0.18)
    station.send_until('stop', Bool(data=True), lambda: station.code() == 'stopped', 'a stop')
    station.send('stop', Bool(data=False))
    station.until(lambda: station.trigger('driver/reset').success, 'a reset of the driver')
    station.until(lambda: station.trigger('controller/reset').success, 'a reset')


@pytest.mark.parametrize(
    ('node', 'name', 'value', 'words'),
    [
        ('controller', 'rate_limit', -1.0, 'rate_limit'),
        ('controller', 'rate_limit', 'fast', "rate_limit: expected a number, got 'fast'"),
        ('controller', 'model', 'nowhere.yaml', 'nowhere.yaml: file: expected a readable YAML'),
        ('controller', 'model', 'spatial_3', 'inputs one, two, three, expected prox_left'),
        ('controller', 'model', 'name: x', 'sections: expected a list'),
        ('driver', 'release_to', 'sleep', 'release_to: expected one of pretension, limp'),
        ('driver', 'mock_fault', 'gremlin', 'expected one of silent, port'),
        ('driver', 'rate', 100.0, 'read-only'),
    ],
)
def test_a_bad_parameter_is_refused_with_its_reason(station, node, name, value, words):
    result = station.set(node, name, value)
    assert not result.successful
    assert words in result.reason


def test_a_description_that_is_too_long_is_refused_at_once(station, tmp_path):
    path = tmp_path / 'long.yaml'
    path.write_text(LONG * 10)
    for text in (LONG * 10, str(path)):
        station.commands.clear()
        result = station.set('controller', 'model', text)
        assert not result.successful
        assert 'expected at most 1,000,000 characters' in result.reason
        station.until(lambda: len(station.commands) > 1, 'further commands')


def test_a_long_description_is_read_beside_the_commands_and_refused_in_the_status(station):
    station.commands.clear()
    began = time.monotonic()
    assert station.set('controller', 'model', LONG[:999_000]).successful
    station.until_code(station.controller, 'refused_model', timeout=120.0)
    took = time.monotonic() - began
    assert 'the old model stays' in last(station.controller).message
    gaps = [b - a for (a, _), (b, _) in pairwise(station.commands)]
    assert max(gaps) < 0.5 * took  # it is read in one piece
    station.go_to_point(0.06, 0.17)


def test_an_unknown_effect_is_refused_with_the_known_ones(station):
    robot = load_robot('kato_10_1').with_effect('magnetism', {'strength': 1.0})
    result = station.set('controller', 'model', dump_robot(robot))
    assert not result.successful
    assert "unknown effect 'magnetism'; known: tendon_friction" in result.reason


def test_another_model_is_taken_without_a_jump(station):
    station.commands.clear()
    robot = load_robot('kato_10_1').with_effect('backbone_stiffness', {'relative_change': 0.2})
    assert station.set('controller', 'model', dump_robot(robot)).successful
    station.until(
        lambda: 'backbone_stiffness' in values(last(station.controller))['model'],
        'the new model',
        timeout=60.0,
    )
    station.until_code(station.controller, 'reached')
    efforts = [message.effort.tolist() for _, message in station.commands]
    steps = [
        max(abs(a - b) for a, b in zip(one, two, strict=True)) for one, two in pairwise(efforts)
    ]
    assert 0.0 < max(steps) <= 10.0 * 0.05  # [N/s] times the longest cycle
    assert max(efforts[-1]) > 1.1 * max(efforts[0])
    assert station.set('controller', 'model', 'kato_10_1').successful


def test_with_a_model_its_name_limits_and_length_change_what_comes_in(station):
    other = replace(load_robot('kato_10_1'), name='other', tension_limits=(0.1, 2.0))
    assert station.set('controller', 'model', dump_robot(other)).successful
    station.until(
        lambda: values(last(station.controller)).get('model', '').startswith('other'),
        'the new model',
        timeout=60.0,
    )
    tips = station.hear(PoseStamped, 'controller/predicted_tip')
    station.until(lambda: tips, 'a prediction')
    assert last(tips).header.frame_id == 'other_base'
    station.send('controller/target_point', point(0.06, 0.17))
    station.until_code(station.controller, 'refused_frame')
    station.go(point(0.06, 0.17, 'other_base'), 'controller/target_point')
    message = JointTrajectory(joint_names=GOOD)
    message.points = [JointTrajectoryPoint(effort=[3.0, 0.1, 0.1, 0.1])]
    message.points[0].time_from_start.sec = 1
    station.send('controller/tendon_trajectory', message)
    station.until_code(station.controller, 'refused_limits')
    assert 'expected 0.1 to 2 N, got 3' in last(station.controller).message
    assert station.set('controller', 'model', 'kato_10_1').successful
