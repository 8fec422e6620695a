"""Speaks to a running controller: sends targets and trajectories, hears what the arm does."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from numpy.typing import NDArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ..control.checks import direction as looks
from ..control.loading import load
from ..control.playing import Playing
from ..effects import load_catalogue
from ..exceptions import InputError, TendonRobotError
from ..model.model import Model
from .messages import duration, pose_stamped, towards
from .qos import COMMAND, LATCHED, LISTEN
from .remote_parameters import RemoteText
from .runtime import Ending
from .shared import read_robot

Array = NDArray[np.float64]
SETTLED = ('reached', 'nearest', 'at_limit')
GOOD = ('holding', 'moving', 'playing', 'played', 'jogging', *SETTLED)
AVERAGE = 0.3  # [s] over which a standing tip is taken
STILL, STANDING = 3e-4, 4.0  # [m] in half of that, [s] at most to wait for it


def add_controller(parser: argparse.ArgumentParser) -> None:
    """Declare the name of the controller node."""
    text = 'of the node (default: controller)'
    parser.add_argument('--controller', default='controller', metavar='NAME', help=text)


class Pilot(Node):
    """One connection to a controller; what was heard since `clear` is kept."""

    def __init__(self, name: str, controller: str, ending: Ending) -> None:
        """Connect."""
        super().__init__(name)
        self._ending, self._controller = ending, controller
        self.status: dict[str, str] = {}
        self.inputs: tuple[str, ...] = ()
        self.base, self.pull = '', False
        self._heard_at, self._since = 0.0, time.monotonic() + 3600.0  # until `clear`
        self._tips: dict[str, list[tuple[float, Array, Array]]] = {'measured': [], 'predicted': []}
        self._commands: list[tuple[float, Array]] = []
        topic = f'{controller}/{{}}'.format
        self._poses = self.create_publisher(PoseStamped, topic('target_pose'), COMMAND)
        self._points = self.create_publisher(PointStamped, topic('target_point'), COMMAND)
        self._trajectories = self.create_publisher(
            JointTrajectory, topic('tendon_trajectory'), COMMAND
        )
        subscribe = self.create_subscription
        subscribe(DiagnosticStatus, topic('status'), self._hear_status, LATCHED)
        subscribe(PoseStamped, topic('predicted_tip'), self._hear_predicted, LISTEN)
        subscribe(PoseStamped, 'measured_tip', self._hear_measured, LISTEN)
        subscribe(JointState, 'tendon_command', self._hear_command, COMMAND)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)

    def destroy_node(self) -> None:
        """End the executor first: later it would find ROS shut down."""
        self._executor.shutdown()
        super().destroy_node()

    def connect(self, timeout: float = 15.0) -> None:
        """
        Wait for the controller.

        Raises
        ------
        TendonRobotError
            It does not come, or takes no targets now.

        """
        self.wait(
            lambda: (
                self._commands
                and self._tips['predicted']
                and self.status
                and self._poses.get_subscription_count()
                and self._points.get_subscription_count()
                and self._trajectories.get_subscription_count()
            ),
            timeout,
            f'{self.resolve_topic_name(self._controller)} to command; are driver and controller '
            'running, in this namespace and ROS_DOMAIN_ID?',
        )
        self.spin(AVERAGE)
        for topic in ('tendon_command', 'tendon_states'):
            if (count := self.count_publishers(topic)) > 1:
                raise TendonRobotError(
                    f'{count} nodes publish {self.resolve_topic_name(topic)}: another robot runs '
                    'here; give each its own namespace or ROS_DOMAIN_ID'
                )
        self.require_good()

    def require_good(self) -> None:
        """Raise what the controller says when it does not follow; old refusals do not count."""
        code = self.status.get('code', '')
        old = code.startswith('refused_') and self._heard_at < self._since + AVERAGE
        if code not in GOOD and not old:
            raise TendonRobotError(f'the controller says {code}: {self.status.get("message")}')

    def model(self) -> Model:
        """Load the model that the controller uses."""
        told: list[str] = []
        remote = RemoteText(self, self._controller, 'model')

        def asked() -> bool:
            remote.ask(told.append)
            return bool(told)

        self.wait(asked, 10.0, f'the parameter model of {self._controller}')
        return load(read_robot(told[0]), load_catalogue())

    def send(self, position: Array, direction: Array | None) -> str:
        """Send a target; return the stamp by which the controller names it."""
        header = PoseStamped().header
        header.frame_id, header.stamp = self.base, self.get_clock().now().to_msg()
        if direction is None:
            point = PointStamped(header=header)
            point.point.x, point.point.y, point.point.z = map(float, position)
            self._points.publish(point)
        else:
            self._poses.publish(pose_stamped(header, position, towards(direction)))
        return f'{header.stamp.sec}.{header.stamp.nanosec:09d}'

    def play(self, trajectory: Playing) -> str:
        """Send a trajectory of the tendons; return its stamp."""
        message = JointTrajectory(joint_names=list(self.inputs))
        message.header.stamp = stamp = self.get_clock().now().to_msg()
        field = 'positions' if self.pull else 'effort'
        for at, values in zip(trajectory.times, trajectory.values, strict=True):
            point = JointTrajectoryPoint(time_from_start=duration(at))
            setattr(point, field, values.tolist())
            message.points.append(point)
        self._trajectories.publish(message)
        return f'{stamp.sec}.{stamp.nanosec:09d}'

    def settle(self, stamp: str, timeout: float, what: str) -> None:
        """Wait until the controller has settled on its answer to a target or a trajectory."""

        def settled() -> bool:
            self.require_good()
            mine = self.status.get('target_stamp') == stamp
            return mine and self.status['code'] in (*SETTLED, 'played')

        self.wait(settled, timeout, what)

    def wait(self, condition: Callable[[], object], timeout: float, what: str) -> None:
        """Spin until something is true; raise when it does not come, or on Ctrl-C."""
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > deadline:
                said = self.status.get('message', 'nothing')
                raise TendonRobotError(
                    f'waited {timeout:g} s in vain for {what}; the controller says: {said}'
                )
            self.spin_once(0.05)

    def stand(self) -> None:
        """Wait until the tip stands, at most a few seconds: motors and trackers lag."""
        end = time.monotonic() + STANDING
        self.spin(AVERAGE)
        while time.monotonic() < end:
            self.spin(AVERAGE)
            _, times, places, _ = self.tips()
            late, early = times > times[-1] - AVERAGE / 2, times > times[-1] - AVERAGE
            if not (early & ~late).any():
                continue
            moved = places[late].mean(axis=0) - places[early & ~late].mean(axis=0)
            if np.linalg.norm(moved) < STILL:
                return

    def spin(self, seconds: float) -> None:
        """Listen for a while."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self.spin_once(left)

    def spin_once(self, timeout: float) -> None:
        """Serve one message; raise KeyboardInterrupt when a signal came."""
        if self._ending.signal:
            raise KeyboardInterrupt
        self._executor.spin_once(timeout_sec=timeout)

    def clear(self) -> None:
        """Forget what was heard of tips and commands."""
        for heard in self._tips.values():
            del heard[:-1]
        del self._commands[:-1]
        self._since = time.monotonic()

    def tips(self) -> tuple[bool, Array, Array, Array]:
        """Return whether a tracker measures, and times (T,), positions, directions (T, 3)."""
        measured = len(self._tips['measured']) > 1
        heard = self._tips['measured' if measured else 'predicted']
        times, places, views = zip(*heard, strict=True)
        return measured, np.array(times), np.array(places), np.array(views)

    def commands(self) -> tuple[Array, Array]:
        """Return times (C,) and commands (C, m) [N] or [m]."""
        times, values = zip(*self._commands, strict=True)
        return np.array(times), np.array(values)

    def tip(self) -> tuple[Array, Array]:
        """Return the mean position [m] and the direction of the tip over the last moment."""
        _, times, places, views = self.tips()
        recent = times > times[-1] - AVERAGE
        along = views[recent].mean(axis=0)
        return places[recent].mean(axis=0), along / np.linalg.norm(along)

    def _hear_status(self, message: DiagnosticStatus) -> None:
        self.status = {item.key: item.value for item in message.values}
        self.status['message'] = message.message
        self._heard_at = time.monotonic()

    def _hear_predicted(self, message: PoseStamped) -> None:
        self.base = message.header.frame_id
        self._keep('predicted', message)

    def _hear_measured(self, message: PoseStamped) -> None:
        if message.header.frame_id == self.base:
            self._keep('measured', message)

    def _keep(self, which: str, message: PoseStamped) -> None:
        p, q = message.pose.position, message.pose.orientation
        try:
            view = looks([q.x, q.y, q.z, q.w], which)
        except InputError:
            return
        self._tips[which].append((time.monotonic(), np.array([p.x, p.y, p.z]), view))

    def _hear_command(self, message: JointState) -> None:
        self.inputs, self.pull = tuple(message.name), not message.effort
        values = message.position if self.pull else message.effort
        self._commands.append((time.monotonic(), np.array(values)))
