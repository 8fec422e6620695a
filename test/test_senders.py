"""Two senders of one topic: the first is followed until it is gone, the other is named."""

import math
import re
import signal
import sys
import time
from itertools import count
from types import SimpleNamespace

import processes
import pytest

pytest.importorskip('rclpy')

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import QoSProfile
from ros_station import Station, last, point, stamp, start, values
from sensor_msgs.msg import JointState

from tendon_robot_ros.ros.shared.messages import LATCHED
from tendon_robot_ros.ros.shared.senders import GONE_AFTER_S, Received, Senders, signature

NAMED_S = 0.5  # [s] after which all name another who commands
EVERY = QoSProfile(depth=1000)


def numbered(number):
    return Received(None, 0, number)


def test_the_first_is_followed_until_it_is_gone():
    senders = Senders()
    assert senders.first(0.0) == ''
    assert senders.counts(0.0, '/controller', numbered(1))
    assert not senders.counts(0.01, '/intruder', numbered(1))
    assert senders.first(0.02) == '/controller'
    assert senders.others(0.02) == '/intruder'
    assert senders.counts(0.5, '/controller', numbered(2))
    assert not senders.counts(0.5 + GONE_AFTER_S, '/intruder', numbered(2))
    assert senders.counts(0.6 + GONE_AFTER_S, '/intruder', numbered(3))
    assert senders.first(0.6 + GONE_AFTER_S) == '/intruder'
    assert senders.others(0.6 + GONE_AFTER_S) == ''
    assert senders.first(0.7 + 2.0 * GONE_AFTER_S) == ''


def test_senders_without_a_signature_are_told_apart_by_their_numbers():
    senders, one, two = Senders(), count(5000), count(1)
    for cycle in range(100):
        now = 0.005 * cycle
        assert senders.counts(now, '', numbered(next(one)))
        assert not senders.counts(now, '', numbered(next(two)))
    assert senders.others(0.5) == 'one that does not sign'


def test_a_middleware_that_does_not_number_messages_is_no_hindrance():
    senders = Senders()
    assert all(senders.counts(0.01 * i, '', numbered(None)) for i in range(5))


WITHOUT_MAIN = """
import ctypes, threading
from threading import Event
threading.Thread(target=Event().wait).start()
print('on', flush=True)
ctypes.CDLL(None).pthread_exit(None)
"""


def test_a_process_counts_as_dead_when_its_main_thread_is():
    senders = Senders()
    with processes.Process([sys.executable, '-c', WITHOUT_MAIN]) as process:
        own = re.sub(r'process \d+', f'process {process.pid}', machine_signature())
        assert senders.counts(0.0, own, numbered(1))
        end = time.monotonic() + 30.0
        while not senders.died():
            assert time.monotonic() < end
            time.sleep(0.01)
        assert process.poll() is None  # another thread goes on


def test_the_death_of_who_is_followed_is_seen_and_the_next_is_followed_at_once():
    senders = Senders()
    with processes.Process(['sleep', '1000']) as process:
        own = re.sub(r'process \d+', f'process {process.pid}', machine_signature())
        assert senders.counts(0.0, own, numbered(1))
        assert not senders.died()
        process.kill()
        process.wait()
        assert senders.died()
        assert not senders.died()  # said once
    assert senders.counts(0.01, '/next', numbered(1))
    assert not senders.died()


@pytest.mark.parametrize('name', ['', '/x (process 1)', '/x (process 1 @ elsewhere)', '/x (pro'])
def test_who_does_not_say_where_it_runs_is_known_by_its_silence_only(name):
    senders = Senders()
    assert senders.counts(0.0, name, numbered(1))
    assert not senders.died()


def machine_signature():
    return signature(SimpleNamespace(get_fully_qualified_name=lambda: '/controller'))


@pytest.fixture
def robot(request, tmp_path):
    space = '/' + request.node.name[:30]
    station, started = Station(space), []

    def run(name, **known):
        started.append(start(name, space, tmp_path, **known))
        return started[-1]

    station.run = run
    yield station
    for process in started:
        process.end()
    station.close()


def named_at(heard, node, key, name):
    """Return the stamp of the first status in which a node names another [s], or infinity."""
    for _, message in heard:
        names = {f'/{item.name.partition(":")[0]}': values(item) for item in message.status}
        said = names.get(node, {})
        if name in said.get(key, ''):
            return stamp(message)
    return math.inf


def assert_named_soon(robot, said, heard, *named):
    """All name who speaks besides within `NAMED_S` of its first word, whom they know by then."""

    def of_the_second():
        return [stamp(m) for _, m in said if '/second' in m.header.frame_id]

    robot.until(of_the_second, 'a word of the second')
    for node, key, name in named:
        wanted = f'{robot.namespace}/{node}', key, name
        robot.until(lambda wanted=wanted: named_at(heard, *wanted) < math.inf, wanted)
        assert named_at(heard, *wanted) - of_the_second()[0] < NAMED_S


def begin(robot, *transitions):
    """Have the second node, which all others know by now, begin to speak."""
    for transition in transitions:
        request = ChangeState.Request(transition=Transition(id=transition))
        assert robot.call(ChangeState, 'second/change_state', request).success


@pytest.mark.ros
def test_a_second_controller_is_not_followed_until_the_first_is_gone(robot):
    robot.run('driver')
    first = robot.run('controller')
    robot.until_code(robot.controller, 'holding', timeout=120.0)
    robot.go_to_point(0.06, 0.17)
    second = robot.hear(DiagnosticStatus, 'second/status', LATCHED)
    heard = robot.hear(DiagnosticArray, '/diagnostics', EVERY)
    intruder = robot.run('controller', extra=('-r', '__node:=second'), autostart=False)
    robot.until_code(second, 'unconfigured', timeout=120.0)
    robot.until(
        lambda: values(last(robot.controller))['other_controllers'] == f'{robot.namespace}/second',
        'the first to say so',
    )
    begin(robot, Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE)
    robot.until_code(second, 'driver_stopped', timeout=120.0)
    assert f'it follows {robot.namespace}/controller (process' in last(second).message
    robot.until(lambda: '/second (process' in last(robot.driver).message, 'the driver to say so')
    robot.until(
        lambda: values(last(second))['other_controllers'] == f'{robot.namespace}/controller',
        'the second to say so',
    )
    assert_named_soon(
        robot,
        robot.commands,
        heard,
        ('controller', 'other_controllers', '/second'),
        ('driver', 'ignored', '/second'),
        ('second', 'other_controllers', '/controller'),
    )
    robot.send('second/target_point', point(-0.06, 0.17))
    robot.spin(0.5)
    assert robot.tip() == pytest.approx([0.06, 0.0, 0.17], abs=1e-3)
    assert robot.code() == 'reached'
    first.process.send_signal(signal.SIGKILL)
    robot.until(lambda: '/second' in values(last(robot.driver))['follows'], 'the second')
    robot.until_code(second, 'released')
    robot.send('second/target_point', point(-0.06, 0.17))
    robot.until_code(second, 'reached')
    assert intruder.process.poll() is None


def others(heard):
    return heard and values(last(heard)).get('other_drivers')


@pytest.mark.ros
def test_a_second_driver_is_named_by_all(robot):
    robot.run('driver')
    robot.run('controller')
    robot.until_code(robot.controller, 'holding', timeout=120.0)
    second = robot.hear(DiagnosticStatus, 'second/status', LATCHED)
    states = robot.hear(JointState, 'tendon_states', EVERY)
    heard = robot.hear(DiagnosticArray, '/diagnostics', EVERY)
    robot.run('driver', extra=('-r', '__node:=second'), autostart=False)
    own = robot.namespace
    robot.until_code(second, 'unconfigured', timeout=120.0)
    robot.until(lambda: others(robot.driver) == f'{own}/second', 'the first to say so')
    begin(robot, Transition.TRANSITION_CONFIGURE)
    robot.until(lambda: others(second) == f'{own}/driver', 'the second to say so')
    assert f'another publishes tendon_states: {own}/second' in last(robot.driver).message
    robot.until(lambda: '/second (process' in last(robot.controller).message, 'the controller')
    assert robot.code() == 'holding'  # with the first
    assert_named_soon(
        robot,
        states,
        heard,
        ('controller', 'ignored', '/second'),
        ('driver', 'other_drivers', '/second'),
        ('second', 'other_drivers', '/driver'),
    )


@pytest.mark.ros
def test_a_person_at_the_command_line_does_not_take_the_arm(robot):
    robot.run('driver')
    robot.run('controller')
    robot.until_code(robot.controller, 'holding', timeout=120.0)
    robot.go_to_point(0.06, 0.17)
    command = JointState(name=list(last(robot.commands).name), effort=[0.1] * 4)
    for _ in range(100):
        robot.send('tendon_command', command)
        robot.spin(0.005)
    assert 'one that does not sign' in last(robot.driver).message
    assert robot.tip() == pytest.approx([0.06, 0.0, 0.17], abs=1e-3)
