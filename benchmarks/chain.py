"""
The whole chain for the benchmarks: emulated servos, driver, controller, and a user beside them.

Nodes are forked from a process that has loaded everything: hundreds of them start and die in a
short time, each a process of its own with signals and DDS of its own.
"""

import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')

import numpy as np
import rclpy
import yaml
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticStatus
from emulated_bus import ROBOT
from geometry_msgs.msg import PointStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from tendon_robot_ros.emulator.port import EmulatorProcess
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.ros.shared.interface import COMMAND, LATCHED, LISTEN
from tendon_robot_ros.ros.shared.runtime import ros_arguments, without_shared_memory

ANSWER = 0.03  # [s]; emulated servos are late when the machine is busy
LONG = 4.0  # [s] off: it does not activate itself
PLANAR = ((0.06, 0.17), (-0.12, 0.08), (0.11, 0.05), (0.08, 0.15), (-0.1, 0.0))  # [m]
PULLED = 2.0  # [N] by one wire of a spatial arm at each of its targets


class Nodes:
    """Starts nodes by `chain_nodes.py`."""

    def __init__(self, robot):
        script = Path(__file__).with_name('chain_nodes.py')
        self.process = subprocess.Popen(
            [sys.executable, str(script), str(robot)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, 'OPENBLAS_NUM_THREADS': '1'},  # a fork takes no threads along
        )
        self.process.stdout.readline()

    def ask(self, **question):
        self.process.stdin.write(json.dumps(question) + '\n')
        self.process.stdin.flush()
        return json.loads(self.process.stdout.readline())

    def end(self):
        self.process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(10.0)
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()


class Forked:
    """A node that was started so; `code` is its exit code, None while it runs."""

    def __init__(self, nodes, name, arguments, log):
        self._nodes, self._code = nodes, None
        self.pid = nodes.ask(start=name, arguments=arguments, log=log)

    @property
    def code(self):
        if self._code is None:
            self._code = self._nodes.ask(code=self.pid)
        return self._code

    @property
    def runs(self):
        return self.code is None


class Load:
    """Processes that keep the processor busy."""

    def __init__(self, count):
        until_orphaned = f'import os\nwhile os.getppid() == {os.getpid()}: pass'
        busy = [sys.executable, '-c', until_orphaned]
        self.processes = [subprocess.Popen(busy) for _ in range(count)]

    def end(self):
        for process in self.processes:
            process.kill()
            process.wait()


class User(Node):
    """What a person has beside the robot: statuses, states, targets, services."""

    def __init__(self, namespace, base, mode):
        super().__init__('user', namespace=namespace)
        self.base, self.mode = base, mode  # frame of the targets
        self.said = {'driver': None, 'controller': None}
        self.state = None
        self.heard = 0  # commands of the controller
        self._points = self.create_publisher(PointStamped, 'controller/target_point', COMMAND)
        self._plays = self.create_publisher(
            JointTrajectory, 'controller/tendon_trajectory', COMMAND
        )
        for name in self.said:
            self.create_subscription(
                DiagnosticStatus, f'{name}/status', lambda m, n=name: self._status(n, m), LATCHED
            )
        self.create_subscription(JointState, 'tendon_states', self._states, LISTEN)
        self.triggers = {}
        self.executor_ = SingleThreadedExecutor()
        self.executor_.add_node(self)

    def _status(self, name, message):
        self.said[name] = message

    def _states(self, message):
        self.state = message

    def values(self):
        """Return the measured tensions [N] or wire pulls [m], none before the first."""
        if self.state is None:
            return []
        return self.state.effort if self.mode == 'tension' else self.state.position

    def code(self, name):
        said = self.said[name]
        return '' if said is None else next(v.value for v in said.values if v.key == 'code')

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self.executor_.spin_once(timeout_sec=left)

    def until(self, condition, seconds):
        end = time.monotonic() + seconds
        while not (met := condition()) and time.monotonic() < end:
            self.executor_.spin_once(timeout_sec=0.01)
        return met

    def aim(self, x, y, z):
        """Send a new target: one that repeats what was said goes on after no release."""
        message = PointStamped()
        message.header.frame_id = self.base
        message.header.stamp = self.get_clock().now().to_msg()
        message.point.x, message.point.y, message.point.z = float(x), float(y), float(z)
        self._points.publish(message)

    def play(self, names, values, seconds):
        """Send a trajectory to tensions [N] or pulls [m] of tendons, over a time."""
        values = [float(value) for value in values]
        nanoseconds = round(1e9 * seconds)
        point = JointTrajectoryPoint(
            time_from_start=Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        )
        setattr(point, 'effort' if self.mode == 'tension' else 'positions', values)
        message = JointTrajectory(joint_names=list(names), points=[point])
        message.header.stamp = self.get_clock().now().to_msg()
        self._plays.publish(message)

    def ready(self, name, seconds=10.0):
        """Return the client of a service that is there, or None."""
        client = self.triggers.setdefault(name, self.create_client(Trigger, name))
        return client if self.until(client.service_is_ready, seconds) else None

    def call(self, name, seconds=10.0):
        """Call a service; return whether it did what it was asked."""
        client = self.ready(name, seconds)
        if client is None:
            return False
        future = client.call_async(Trigger.Request())
        self.until(future.done, seconds)
        return future.done() and future.result().success

    def activate(self, name, seconds=60.0):
        """Activate a lifecycle node that is inactive."""
        client = self.create_client(ChangeState, f'{name}/change_state')
        if self.until(client.service_is_ready, 3.0):
            wanted = Transition(id=Transition.TRANSITION_ACTIVATE)
            future = client.call_async(ChangeState.Request(transition=wanted))
            self.until(future.done, seconds)
        self.destroy_client(client)


def targets(robot):
    """Return tips [m] that take a strong pull: of kato_10_1, or with one wire after the other."""
    if robot == ROBOT:
        return [(x, 0.0, z) for x, z in PLANAR]
    model = Model(load_robot(robot))
    rest = np.full(len(model.inputs), model.robot.tension_limits[0])
    return [model.shape(np.maximum(rest, PULLED * row)).tip_position for row in np.eye(len(rest))]


class Chain:
    """Emulated servos, driver and controller, and a user."""

    def __init__(self, logs, mode='tension', arm='plant', servos=None, robot=ROBOT, **parameters):
        """
        Start all; `servos` changes their configuration, `parameters` the driver's.

        A value of `servos` may be a function of the configuration.
        """
        self.mode, self.logs, self.robot = mode, Path(logs), Path(robot)
        self.logs.mkdir(parents=True, exist_ok=True)
        self.targets = targets(self.robot)
        self.space = f'/chain_{os.getpid()}'
        self._forks = Nodes(self.robot)
        self.servos = EmulatorProcess(self.robot, '--arm', arm)
        plain = {**self.servos.content(), 'answer_time': ANSWER}
        del plain['watchdog']  # the emulator runs at once: the driver's default holds
        for key, value in (servos or {}).items():
            plain[key] = value(plain) if callable(value) else value
        self.config = plain
        common = {'command_mode': mode}
        robot = str(self.robot)
        motors = {'backend': 'dynamixel', 'config': yaml.safe_dump(self.config)}
        self._given = {
            'driver': {'robot': robot, **motors, **common, **parameters},
            'controller': {'model': robot, **common},
        }
        self.nodes = {}
        self._off_since = time.monotonic()
        self.died = []  # nodes that ended although nobody had told them to
        without_shared_memory()  # as the nodes: who is killed holds nobody up
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        self.user = User(self.space, f'{self.robot.stem}_base', mode)
        for name in self._given:
            self.start(name)

    def start(self, name):
        arguments = ros_arguments(self._given[name], self.space)
        log = str(self.logs / f'{name}.log')
        self.user.said[name] = None
        self.nodes[name] = Forked(self._forks, name, arguments, log)

    def signal(self, name, number):
        os.kill(self.nodes[name].pid, number)

    def again(self, name, code=0, seconds=30.0):
        """Wait until a node that was told to end has ended with a code; start it anew."""
        node = self.nodes[name]
        self.user.until(lambda: not node.runs, seconds)
        if node.runs:
            self.died.append(f'{name}: did not end within {seconds:g} s')
            os.kill(node.pid, signal.SIGKILL)
        elif node.code != code:
            self.died.append(f'{name}: exit code {node.code} instead of {code}')
        self.start(name)

    def look(self):
        """Start anew what died by itself, and note it."""
        for name, node in list(self.nodes.items()):
            if not node.runs:
                self.died.append(f'{name}: exit code {node.code}')
                self.start(name)
        if self.servos.process.poll() is not None:
            raise RuntimeError('the emulator died')

    def mend(self):
        """Do what a person does with an arm that has stopped: reboot, reset, activate."""
        said = self.user.said['driver']
        if self.user.code('driver') != 'off':
            self._off_since = time.monotonic()
        elif time.monotonic() - self._off_since > LONG:
            self._off_since = time.monotonic()
            self.user.activate('driver')
        if self.user.code('driver') == 'stopped':
            if said is not None and ('reboot' in said.message or 'lost its power' in said.message):
                self.user.call('driver/reboot', 3.0)
            self.user.call('driver/reset', 3.0)
        if self.user.code('controller') == 'stopped':
            self.user.call('controller/reset', 3.0)

    def up(self, target, least, seconds=60.0):
        """Bring the arm to a target; return whether a tension [N] or pull [m] is reached."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.look()
            self.mend()
            self.user.aim(*target)
            if self.user.until(lambda: self._works(least), 0.25):
                return True
        return False

    def _works(self, least):
        if self.user.code('driver') != 'following':
            return False
        values = self.user.values()
        return bool(values) and max(v if math.isfinite(v) else 0.0 for v in values) > least

    def close(self):
        for node in self.nodes.values():
            if node.runs:
                os.kill(node.pid, signal.SIGTERM)
        self.user.until(lambda: not any(node.runs for node in self.nodes.values()), 10.0)
        self._forks.end()
        self.user.executor_.shutdown()
        self.user.destroy_node()
        rclpy.shutdown()
        self.servos.end()
