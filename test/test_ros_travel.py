"""A search for slack that was refused is not begun again by the node; a person resets it."""

import time

import numpy as np
import pytest
import yaml

pytest.importorskip('rclpy')
pytest.importorskip('dynamixel_sdk')

from emulated import ForkedEmulator
from lifecycle_msgs.msg import Transition
from ros_station import Station, last, start, values
from std_msgs.msg import Bool

from tendon_robot_ros.common.files import shared_file
from tendon_robot_ros.ros.shared.timing import RETRY_PERIOD_S

pytestmark = pytest.mark.ros
ROBOT = 'kato_10_1'
TRAVEL, MORE = 0.01, 0.002  # [m]
RETRIED = 1.5 * RETRY_PERIOD_S  # [s]; the autostart would have begun again


@pytest.fixture
def free(request, tmp_path):
    """Start a driver node on motors whose wires meet no resistance, for so much [m] of wire."""
    robot = shared_file(f'config/robots/{ROBOT}.yaml')
    with ForkedEmulator(robot, '--arm', 'weights') as servos:
        content = {
            **servos.content(),
            'home_travel': getattr(request, 'param', TRAVEL),
            'home_speed': 0.01,
        }
        given = {
            'robot': ROBOT,
            'backend': 'dynamixel',
            'config': yaml.safe_dump(content),
            'command_mode': 'pull',
        }
        station = Station('/travel')
        with start('driver', '/travel', tmp_path, **given):
            yield station, servos
        station.close()


@pytest.fixture
def searching(free):
    """Wait until the motors wind."""
    station, servos = free
    begin = wound(servos)
    station.until(lambda: np.abs(wound(servos) - begin).max() > 0.003, 'a search', timeout=60.0)
    return station, servos, begin


def wound(servos):
    return np.array(servos.ask('state')['wound'])


def test_a_refused_search_is_not_begun_again_by_itself(free):
    station, servos = free
    begin = wound(servos)
    station.until_code(station.driver, 'stopped', timeout=60.0)
    refused = wound(servos) - begin
    assert 0.5 * TRAVEL < np.abs(refused).max() < TRAVEL + MORE
    station.spin(RETRIED)
    np.testing.assert_allclose(wound(servos) - begin, refused, atol=5e-4)
    said = last(station.driver)
    assert values(said)['code'] == 'stopped'
    assert 'no resistance within home_travel' in said.message
    assert 'call reset, then activate again' in said.message

    # by hand, but nobody has reset
    assert not station.change('driver', Transition.TRANSITION_ACTIVATE)
    assert station.change('driver', Transition.TRANSITION_CLEANUP)
    assert station.change('driver', Transition.TRANSITION_CONFIGURE)  # another driver object
    assert not station.change('driver', Transition.TRANSITION_ACTIVATE)
    assert np.abs(wound(servos) - begin).max() < TRAVEL + MORE

    answer = station.trigger('driver/reset')
    assert (answer.success, answer.message) == (True, 'activate it next')
    began = time.monotonic()
    station.until_code(station.driver, 'off')
    station.spin(max(0.0, RETRIED - (time.monotonic() - began)))
    assert np.abs(wound(servos) - begin).max() < TRAVEL + MORE  # a reset moves nothing
    assert not station.change('driver', Transition.TRANSITION_ACTIVATE)
    assert np.abs(wound(servos) - begin).max() > 1.5 * TRAVEL


def call_stop(station):
    assert station.trigger('driver/stop').success
    return 'stop was called'


def say_stop(station):
    station.send('stop', Bool(data=True))
    return 'topic stop says true'


@pytest.mark.parametrize('free', [0.3], indirect=True)
@pytest.mark.parametrize('stop', [call_stop, say_stop])
def test_a_stop_ends_a_search(searching, stop):
    station, servos, begin = searching
    reason = stop(station)
    station.until_code(station.driver, 'stopped')
    said = last(station.driver).message
    assert reason in said
    assert 'looking for slack was cancelled; torque is off' in said
    assert not any(s['torque_enable'] for s in servos.ask('state')['servos'].values())
    ended = wound(servos)
    assert np.abs(ended - begin).max() < 0.2
    station.spin(RETRIED)
    np.testing.assert_allclose(wound(servos), ended, atol=5e-4)
