"""Controller and mock driver as two processes, driven from a third over topics."""

import math
import time

import numpy as np
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray, PoseStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_station import BASE, HIGH, LOW, Station, held, last, point, values
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from visualization_msgs.msg import MarkerArray

from tendon_robot_ros.ros.shared.interface import LATCHED

pytestmark = pytest.mark.ros
SPACE = '/chain'


running = held(SPACE)


@pytest.fixture
def station(running):
    """Give every test the same nodes, without stops and faults."""
    running.send('stop', Bool(data=False), LATCHED)
    running.set('driver', 'mock_fault', '')
    running.trigger('driver/reset')
    running.until_code(running.driver, 'following')
    running.until(lambda: running.trigger('controller/reset').success, 'a reset')
    running.go_to_point(0.0, 0.2)
    return running


def test_a_point_is_reached_by_the_mock(station):
    station.go_to_point(0.06, 0.17)
    assert station.tip() == pytest.approx([0.06, 0.0, 0.17], abs=1e-4)


def test_a_pose_brings_position_and_direction(station):
    message = PoseStamped()
    message.header.frame_id = BASE
    message.pose.position.x, message.pose.position.z = 0.0930, 0.0617
    message.pose.orientation.x, message.pose.orientation.w = 1.0, 0.0  # looks back
    station.go(message)
    assert station.tip() == pytest.approx([0.0930, 0.0, 0.0617], abs=2e-4)
    q = last(station.tips).pose.orientation
    assert q.x**2 + q.y**2 - q.z**2 - q.w**2 == pytest.approx(1.0, abs=1e-4)


def test_a_twist_moves_the_tip_as_long_as_it_is_sent(station):
    station.go_to_point(0.06, 0.17)
    before, began = station.tip(), time.monotonic()
    for _ in range(25):
        station.twist(0.02)
        station.spin(0.02)
    sent = time.monotonic() - began  # longer on a busy machine
    station.until_code(station.controller, 'holding')
    station.catch_up(0.3)
    moved = station.tip() - before
    assert 0.006 < moved[0] < 0.02 * (sent + 0.5)
    station.catch_up(0.2)
    assert station.tip() - before == pytest.approx(moved, abs=1e-4)
    assert station.code() == 'holding'


def test_predictions_agree_with_the_twin(station):
    shapes = station.hear(PoseArray, 'controller/predicted_shape')
    station.go_to_point(0.06, 0.17)

    def agrees():
        p = last(shapes).poses[-1].position
        return [p.x, p.y, p.z] == pytest.approx(station.tip(), abs=1e-5)

    station.until(lambda: shapes and agrees(), 'the tip where it is predicted')
    assert last(shapes).header.frame_id == BASE
    assert len(last(shapes).poses) == 30


@pytest.mark.parametrize('kind', [ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT])
def test_reliable_and_best_effort_subscribers_hear_everything(station, kind):
    qos = QoSProfile(depth=5, reliability=kind)
    heard = {
        topic: station.hear(message, topic, qos)
        for topic, message in (
            ('tendon_command', JointState),
            ('tendon_states', JointState),
            ('controller/predicted_shape', PoseArray),
            ('controller/predicted_tip', PoseStamped),
            ('controller/markers', MarkerArray),
            ('measured_tip', PoseStamped),
            ('measured_shape', PoseArray),
            ('/diagnostics', DiagnosticArray),
        )
    }
    station.until(lambda: all(heard.values()), f'all of {list(heard)}')


def test_who_comes_late_hears_the_last_status(station):
    late = Station(SPACE)
    late.until(lambda: late.controller and late.driver, 'latched statuses')
    assert values(last(late.driver))['tension_source'] == 'load_cell'
    late.close()


def test_a_stop_of_the_driver_halts_the_controller_and_nothing_moves_after_reset(station):
    station.go_to_point(0.06, 0.17)
    assert station.trigger('driver/stop').success
    station.until_code(station.controller, 'driver_stopped')
    answer = station.trigger('controller/reset')
    assert not answer.success
    assert 'the driver is stopped: stop was called' in answer.message
    station.until(lambda: max(last(station.states).effort) < LOW + 0.01, 'pretension')
    assert station.trigger('driver/reset').success
    station.until_code(station.controller, 'holding')
    station.spin(0.3)
    assert max(last(station.states).effort) < LOW + 0.01


def test_a_stop_of_the_controller_lets_the_driver_release(station):
    station.go_to_point(0.06, 0.17)
    assert station.trigger('controller/stop').success
    station.until_code(station.driver, 'releasing', 'released')
    assert 'the sender of the commands lets go' in last(station.driver).message  # not by silence
    station.until_code(station.controller, 'stopped')
    assert station.trigger('controller/reset').success
    station.until_code(station.controller, 'holding')


def test_a_motor_error_takes_torque_and_is_said_by_both(station):
    station.go_to_point(0.06, 0.17)
    assert station.set('driver', 'mock_fault', 'overload:dist_right').successful
    station.until_code(station.controller, 'driver_stopped')
    assert 'dist_right: overload' in last(station.controller).message
    station.until(
        lambda: values(last(station.driver))['torque_off'] == 'dist_right',
        'the word of the driver, which may come second',
    )
    assert not station.trigger('driver/reset').success
    assert station.set('driver', 'mock_fault', '').successful
    station.until(lambda: station.trigger('driver/reset').success, 'a reset')
    station.until_code(station.controller, 'holding')


def test_lost_motors_are_said_and_found_again(station):
    assert station.set('driver', 'mock_fault', 'silent').successful
    station.until(lambda: 'no answer' in last(station.driver).message, 'the fault')
    assert all(map(math.isnan, last(station.states).effort))
    station.until_code(station.controller, 'no_driver')
    assert station.set('driver', 'mock_fault', '').successful
    station.until_code(station.driver, 'holding', 'released')
    station.until_code(station.controller, 'released')
    station.go_to_point(0.0, 0.2)
    station.until_code(station.driver, 'following')


def test_commands_stay_within_limits_whatever_is_sent(station):
    random = np.random.default_rng(0)
    odd = [math.nan, math.inf, -math.inf, 1e308, 0.0, -1.0]
    message, state = PoseStamped(), JointState(name=list('abcd'))
    station.commands.clear()
    station.states.clear()
    for _ in range(150):
        numbers = [
            float(random.choice(odd)) if random.random() < 0.1 else random.normal(0.0, 0.1)
            for _ in range(7)
        ]
        p, q = message.pose.position, message.pose.orientation
        p.x, p.y, p.z, q.x, q.y, q.z, q.w = numbers
        message.header.frame_id = str(random.choice([BASE, BASE, BASE, 'map', '']))
        message.header.stamp.sec = int(random.choice([0, 0, 0, 1, 2**31 - 1]))
        station.send('controller/target_pose', message)
        station.send('controller/target_point', point(numbers[0], numbers[1]))
        station.twist(numbers[2], str(random.choice([BASE, 'kato_10_1_tip', 'map'])))
        state.effort = numbers[:4]
        station.send('tendon_states', state)
        station.send('tendon_command', state)
        station.spin(0.005)
    efforts = np.array(
        [message.effort.tolist() for _, message in station.commands if message.name[0] != 'a']
    )
    assert len(efforts) > 20
    assert efforts.min() >= LOW
    assert efforts.max() <= HIGH
    measured = [m.effort.tolist() for _, m in station.states if m.name[0] != 'a']
    assert np.max(measured) <= HIGH
    station.spin(0.5)  # twists still on their way would end the target
    station.go_to_point(0.06, 0.17)
