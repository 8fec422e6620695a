"""A node of the tests, and nodes of the package as processes of their own."""

import contextlib
import math
import os
import sys
import time

os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)

import numpy as np
import processes
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from forked import Forked
from geometry_msgs.msg import PointStamped, PoseStamped, TwistStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from tendon_robot_ros.common.processes import child_environment
from tendon_robot_ros.ros.shared.interface import COMMAND, LATCHED, LISTEN
from tendon_robot_ros.ros.shared.runtime import NodeProcess, ros_arguments, without_shared_memory

without_shared_memory()  # as the nodes: a process that a test kills would hold up the station

DISCOVERY = 30.0  # [s] for anything to happen, on a busy machine
UNHEARD = 5.0  # [s] after which a target is sent again: who was there to hear it may have died
MATCHED = 0.2  # [s] until both sides of a topic know each other
# A busy machine is late: no watchdog but the one that a test is about may act on that. An eighth
# of the usual rate leaves more time for the other tests.
PATIENT = {
    'driver': {'command_timeout': 0.5, 'stamp_tolerance': 5.0, 'rate': 25.0},
    'controller': {'state_timeout': 1.0, 'stamp_tolerance': 5.0, 'rate': 25.0},
}
INPUTS = ('prox_left', 'prox_right', 'dist_left', 'dist_right')
AGAIN = 'send it again later'  # what a status says that refuses a target for now
SETTLED = ('reached', 'nearest', 'at_limit')
LOW, HIGH = 0.1, 5.0  # [N]
BASE = 'kato_10_1_base'
OWN_EFFECT = """
from tendon_robot_ros.effects.effect import Effect, Parameter

def law(stiffness, tendons, change):
    return stiffness * (1.0 + change)

EFFECT = Effect('own', 'stiffness', 'stiffness', (Parameter('change', '1', -0.5, 0.5, 0.0, 0.1),),
                law)
"""


class Station:
    """Hears everything that controller and driver of a namespace say."""

    def __init__(self, namespace):
        if not rclpy.ok():
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.namespace = namespace
        self.node = Node('station', namespace=namespace)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.commands = self.hear(JointState, 'tendon_command', COMMAND)
        self.states = self.hear(JointState, 'tendon_states')
        self.tips = self.hear(PoseStamped, 'measured_tip')
        self.controller = self.hear(DiagnosticStatus, 'controller/status', LATCHED)
        self.driver = self.hear(DiagnosticStatus, 'driver/status', LATCHED)
        self._publishers = {}

    def hear(self, kind, topic, qos=LISTEN):
        """Subscribe; return the list to which (time, message) is appended."""
        heard = []
        self.node.create_subscription(
            kind, topic, lambda message: heard.append((time.monotonic(), message)), qos
        )
        return heard

    def send(self, topic, message, qos=COMMAND):
        """Publish once, as soon as somebody listens."""
        key = topic, type(message)
        new = key not in self._publishers
        if new:
            self._publishers[key] = self.node.create_publisher(type(message), topic, qos)
        publisher = self._publishers[key]
        self.until(lambda: publisher.get_subscription_count() > 0, f'a subscriber of {topic}')
        if new:  # the subscriber may know the publisher later than it is known
            self.spin(MATCHED)
        publisher.publish(message)

    def send_until(self, topic, message, condition, what):
        """Publish every second, as a person would, until something holds."""
        self.repeat(lambda: self.send(topic, message), 1.0, condition, what)

    def repeat(self, act, period, condition, what, timeout=DISCOVERY):
        """Act, and again after every period [s], until something holds."""
        acted = -math.inf

        def held():
            nonlocal acted
            if time.monotonic() > acted + period:
                acted = time.monotonic()
                act()
            return condition()

        self.until(held, what, timeout)

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self.executor.spin_once(timeout_sec=left)

    def catch_up(self, seconds=0.0):
        """Wait until what is heard was measured so long after now."""
        then = self.now() + seconds

        def late(heard):
            return heard and stamp(last(heard)) >= then

        self.until(lambda: late(self.states) and late(self.tips), 'states and tips of the driver')

    def now(self):
        return 1e-9 * self.node.get_clock().now().nanoseconds

    def until(self, condition, what, timeout=DISCOVERY):
        end = time.monotonic() + timeout
        while not condition():
            said = [last(heard).message for heard in (self.controller, self.driver) if heard]
            assert time.monotonic() < end, f'waited {timeout} s for {what}; statuses: {said}'
            self.executor.spin_once(timeout_sec=0.05)

    def go(self, message, topic='controller/target_pose'):
        """Send a target to who hears the driver, and wait until the mock arm is still there."""
        self.until(lambda: self.controller and self.code() != 'no_driver', 'a driver')

        def sent():
            message.header.stamp = self.node.get_clock().now().to_msg()
            self.send(topic, message)
            return (
                f'{message.header.stamp.sec}.{message.header.stamp.nanosec:09d}',
                time.monotonic(),
            )

        given, at = sent()

        def arrived():
            nonlocal given, at
            status = last(self.controller)
            said, passed = values(status), time.monotonic() - at
            late = AGAIN in status.message or said['code'].startswith('refused')
            asked = late and passed > 1.0  # the driver was, or an older message that is refused
            if asked or (said.get('target_stamp') != given and passed > UNHEARD):
                given, at = sent()
            return said.get('target_stamp') == given and said['code'] in SETTLED

        self.until(arrived, f'the arm at {message}')
        self.catch_up(0.3)

    def until_code(self, heard, *codes, timeout=DISCOVERY):
        self.until(lambda: heard and values(last(heard))['code'] in codes, f'{codes}', timeout)

    def call(self, kind, name, request=None):
        client = self.node.create_client(kind, name)
        self.until(client.service_is_ready, f'service {name}')
        asked, request = [], request or kind.Request()
        self.repeat(
            lambda: asked.append(client.call_async(request)),
            DISCOVERY / 3.0,  # so late nobody is busy: who was there has died
            lambda: any(future.done() for future in asked),
            f'an answer of {name}',
        )
        self.node.destroy_client(client)
        return next(future.result() for future in asked if future.done())

    def trigger(self, name):
        return self.call(Trigger, name)

    def change(self, node, transition):
        """Ask a node for a transition; return whether it was taken."""
        request = ChangeState.Request(transition=Transition(id=transition))
        return self.call(ChangeState, f'{node}/change_state', request).success

    def set(self, node, name, value):
        """Set a parameter; return the result with its reason."""
        given = Parameter(name, value=value).to_parameter_msg()
        request = SetParametersAtomically.Request(parameters=[given])
        return self.call(
            SetParametersAtomically, f'{node}/set_parameters_atomically', request
        ).result

    def text(self, node, name):
        """Return a parameter that is a text."""
        request = GetParameters.Request(names=[name])
        return self.call(GetParameters, f'{node}/get_parameters', request).values[0].string_value

    def begin(self, folder, *arguments):
        """Start a command of the package in the namespace."""
        return Forked(
            [*arguments, '--ros-args', '-r', f'__ns:={self.namespace}'],
            cwd=folder,
            stdout=processes.PIPE,
            stderr=processes.PIPE,
        )

    def finish(self, process, timeout=300.0):
        """Listen until a command has ended; return its code and what it printed."""
        self.until(lambda: process.poll() is not None, f'the end of {process.args[0]}', timeout)
        said = process.communicate()
        return processes.CompletedProcess(process.args, process.returncode, *said)

    def go_to_point(self, x, z):
        self.go(point(x, z), 'controller/target_point')

    def twist(self, x, frame=BASE):
        message = TwistStamped()
        message.header.frame_id = frame
        message.twist.linear.x = float(x)
        self.send('controller/delta_twist', message)

    def tip(self):
        p = last(self.tips).pose.position
        return np.array([p.x, p.y, p.z])

    def code(self):
        return values(last(self.controller))['code']

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()


def point(x, z, frame=BASE):
    message = PointStamped()
    message.header.frame_id = frame
    message.point.x, message.point.z = float(x), float(z)
    return message


def last(heard):
    return heard[-1][1]


def stamp(message):
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def values(status):
    return {item.key: item.value for item in status.values}


class ForkedNode(NodeProcess):
    """A node as a process of its own, that starts without the cost of its imports."""

    def __init__(self, name, parameters, namespace='/', output=None, extra=(), own=()):
        self.name = name
        self.process = Forked(
            [name, *own, *ros_arguments(parameters, namespace), *extra],
            stdin=processes.DEVNULL,
            stdout=output,
            stderr=output,
            env=child_environment(),
        )
        processes.started.remove(self.process)  # a node may outlive the test that starts it


def start(name, namespace, output, extra=(), **parameters):
    """Start a node as a process, with patience; its messages go to a file."""
    defaults = {
        'driver': {'robot': 'kato_10_1', 'config': 'mock_twin', **PATIENT['driver']},
        'controller': {'model': 'kato_10_1', **PATIENT['controller']},
    }
    known = {**defaults.get(name, {}), **parameters}
    with open(output / f'{name}_{time.monotonic_ns()}.log', 'w', encoding='utf-8') as log:
        return ForkedNode(name, known, namespace, log, extra)


@contextlib.contextmanager
def alone(space, logs):
    """Give a station in a namespace whose `run` starts nodes there, and end what was started."""
    station, started = Station(space), []

    def run(name, **known):
        started.append(start(name, space, logs, **known))
        return started[-1]

    station.run = run
    yield station
    for process in started:
        process.end()
    station.close()


@contextlib.contextmanager
def holding(space, logs, timeout=120.0, driver=(), controller=()):
    """Start both nodes with parameters, and wait until the arm holds; a station beside them."""
    with (
        start('driver', space, logs, **dict(driver)),
        start('controller', space, logs, **dict(controller)) as running,
    ):
        station = Station(space)
        station.controlling = running
        station.until_code(station.controller, 'holding', timeout=timeout)  # compiles when cold
        station.until_code(station.driver, 'following', 'released')
        with contextlib.closing(station):
            yield station


def held(space):
    """Make a fixture of a module: both nodes hold an arm in a namespace, with a station."""

    @pytest.fixture(scope='module')
    def running(tmp_path_factory):
        with holding(space, tmp_path_factory.mktemp('logs')) as station:
            yield station

    return running
