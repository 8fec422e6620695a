"""Two senders of one topic: the first is followed until it is gone, the other is named."""

import os
import signal
import sys
import time

import processes
import pytest

pytest.importorskip('rclpy')

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from forked import Forked
from lifecycle_msgs.msg import Transition
from rclpy.signals import SignalHandlerOptions
from ros_station import alone, last, point, values
from sensor_msgs.msg import JointState

from tendon_robot_ros.common.processes import child_environment
from tendon_robot_ros.common.words import LISTED_MAX
from tendon_robot_ros.ros.controller.topics import DriverLink
from tendon_robot_ros.ros.shared.inbox import Received
from tendon_robot_ros.ros.shared.interface import LATCHED
from tendon_robot_ros.ros.shared.senders import (
    OwnPublisher,
    SenderProcess,
    Senders,
    gid_of,
    gid_text,
    process_of,
)
from tendon_robot_ros.ros.shared.timing import SILENCE_S

ONE, TWO, THREE = (bytes([i]) * 16 for i in (1, 2, 3))


def said_by(publisher):
    return Received(None, 0, 0, publisher)


def test_the_first_is_followed_until_it_is_gone():
    senders = Senders(None, 'tendon_command')
    assert senders.first(0.0) is None
    assert senders.counts(0.0, said_by(ONE))
    assert not senders.counts(0.01, said_by(TWO))
    assert senders.first(0.02) == ONE
    assert senders.others(0.02) == [TWO]
    assert senders.counts(0.5, said_by(ONE))
    assert not senders.counts(0.5 + SILENCE_S, said_by(TWO))
    assert senders.counts(0.6 + SILENCE_S, said_by(TWO))
    assert not senders.new, 'it has commanded all the time'
    assert senders.first(0.6 + SILENCE_S) == TWO
    assert senders.others(0.6 + SILENCE_S) == []
    assert senders.first(0.7 + 2.0 * SILENCE_S) is None
    assert senders.counts(1.0 + 2.0 * SILENCE_S, said_by(THREE))
    assert senders.new


def test_who_comes_is_named_in_place_of_those_who_have_gone():
    senders, now = Senders(None, 'tendon_command'), 0.0
    for i in range(3 * LISTED_MAX):  # as many people, each with `ros2 topic pub --once`
        now += 0.5 * SILENCE_S
        assert senders.counts(now, said_by(ONE))
        assert not senders.counts(now, said_by(bytes([100 + i]) * 16))
        assert bytes([100 + i]) * 16 in senders.others(now)


WITHOUT_MAIN = """
import ctypes, threading
from threading import Event
threading.Thread(target=Event().wait).start()
print('on', flush=True)
ctypes.CDLL(None).pthread_exit(None)
"""


def test_a_process_counts_as_dead_when_its_main_thread_is():
    with processes.Process([sys.executable, '-c', WITHOUT_MAIN]) as process:
        seen = SenderProcess(process.pid)
        processes.until(lambda: seen.died)
        assert process.poll() is None  # another thread goes on


PUBLISHES = """
import sys, threading
import rclpy
from std_msgs.msg import Bool
from tendon_robot_ros.ros.shared.senders import OwnPublisher
rclpy.init()
node = rclpy.create_node('someone')
own = OwnPublisher(node, node.create_publisher(Bool, 'word', 1))
print(own.gid.hex(), flush=True)
threading.Event().wait()
"""


def test_the_death_of_who_is_followed_is_seen_and_the_next_is_followed_at_once():
    senders = Senders(None, 'tendon_command')
    pipes = {'stdout': processes.PIPE, 'env': child_environment()}
    with Forked(['-c', PUBLISHES], **pipes) as process:
        publisher = bytes.fromhex(process.stdout.readline())
        assert process_of(publisher) == process.pid
        assert senders.counts(0.0, said_by(publisher))
        assert not senders.died()
        process.kill()
        process.wait()
        assert senders.died()
        assert not senders.died()  # said once
    assert process_of(publisher) == 0
    assert senders.counts(0.01, said_by(TWO))
    assert not senders.died()


def test_who_is_of_another_computer_or_package_is_known_by_its_silence_only():
    senders = Senders(None, 'tendon_command')
    assert senders.counts(0.0, said_by(ONE))
    assert not senders.died()


@pytest.mark.parametrize(
    ('own', 'follows', 'other'),
    [
        ('01.02', '01.02', ''),
        ('01.02', '01.03', 'it follows /controller (process 7)'),  # of the same name
        ('01.02', '', ''),  # nobody yet, or a middleware whose graph does not know it
        ('', '01.03', ''),  # its own is not told
    ],
)
def test_a_controller_knows_by_the_gid_whether_the_driver_follows_it(own, follows, other):
    said = []
    link = DriverLink(None, '', own, lambda *said_: said.append(said_))
    told = {'follows': '/controller (process 7)', 'follows_gid': follows}
    pairs = [KeyValue(key=key, value=value) for key, value in told.items()]
    link.receive(DiagnosticStatus(values=pairs))
    assert said == [('', '', 0, other)]


def test_a_publisher_is_found_by_its_gid_among_those_of_its_topic_with_the_name_of_its_node():
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('one', namespace='/named')
    try:
        publisher = node.create_publisher(JointState, 'tendon_command', 1)
        senders, gid = Senders(node, 'tendon_command'), gid_of(publisher)
        assert gid_text(gid).count('.') == len(gid) - 1
        assert senders.names([]) == ''
        own = OwnPublisher(node, publisher)
        end = time.monotonic() + 30.0
        while senders.names([gid]) != f'/named/one (process {os.getpid()})':
            assert time.monotonic() < end, senders.names([gid])
        own.close()
        assert senders.known(gid)
        assert 'not discovered' in senders.names([TWO])
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


@pytest.fixture
def robot(request, tmp_path):
    with alone('/' + request.node.name[:30], tmp_path) as station:
        yield station


def begin(robot, *transitions):
    """Have the second node, which all others know by now, begin to speak."""
    for transition in transitions:
        assert robot.change('second', transition)


@pytest.mark.ros
def test_a_second_controller_is_not_followed_until_the_first_is_gone(robot):
    robot.run('driver')
    first = robot.run('controller')
    robot.until_code(robot.controller, 'holding', timeout=120.0)
    robot.go_to_point(0.06, 0.17)
    second = robot.hear(DiagnosticStatus, 'second/status', LATCHED)
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
    robot.run('driver', extra=('-r', '__node:=second'), autostart=False)
    own = robot.namespace
    robot.until_code(second, 'unconfigured', timeout=120.0)
    robot.until(lambda: others(robot.driver) == f'{own}/second', 'the first to say so')
    begin(robot, Transition.TRANSITION_CONFIGURE)
    robot.until(lambda: others(second) == f'{own}/driver', 'the second to say so')
    assert f'another publishes tendon_states: {own}/second' in last(robot.driver).message
    robot.until(lambda: '/second (process' in last(robot.controller).message, 'the controller')
    assert robot.code() == 'holding'  # with the first
