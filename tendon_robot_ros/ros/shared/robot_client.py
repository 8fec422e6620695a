"""Speaking to a running robot: targets, statuses, waiting; what the arm does meanwhile."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from numpy.typing import NDArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from ...common.errors import InputError, TendonRobotError
from ...common.rotations import towards
from ...control.checks import direction as looks
from ...control.loading import load
from ...control.state import Trajectory
from ...effects import load_catalogue
from ...model.model import Model
from ...robot import load_robot
from ...robot.keep_out import joined, text_of
from .messages import COMMAND, LATCHED, LISTEN, duration, pose_stamped
from .parameters import RemoteText
from .runtime import Ending

Array = NDArray[np.float64]
SETTLED_CODES = ('reached', 'nearest', 'at_limit')
WORKING_CODES = ('holding', 'searching', 'moving', 'playing', 'played', 'jogging', *SETTLED_CODES)
TIP_AVERAGE_S = 0.3  # [s] over which a standing tip is taken
STILL_WITHIN_M, STANDING_TIMEOUT_S = 3e-4, 4.0  # [m] in half of that, [s] at most to wait for it


def add_controller(parser: argparse.ArgumentParser) -> None:
    """Declare the name of the controller node."""
    text = 'of the node (default: controller)'
    parser.add_argument('--controller', default='controller', metavar='NAME', help=text)


class RobotClient(Node):
    """
    A node that speaks to a running robot as any other could: sends targets, reads statuses, waits.

    Parameters
    ----------
    name : str
    ending : Ending
        Tells that a signal came.
    namespace : str, optional
    base : str
        Frame of the targets.
    controller : str
        Name of the controller node.
    watched : sequence of str
        Other nodes whose status is read.

    """

    def __init__(
        self,
        name: str,
        ending: Ending,
        namespace: str | None = None,
        base: str = '',
        controller: str = 'controller',
        watched: Sequence[str] = (),
    ) -> None:
        """Connect."""
        super().__init__(name, namespace=namespace)
        self.ending, self._controller, self.base = ending, controller, base
        self.statuses: dict[str, dict[str, str]] = {node: {} for node in (controller, *watched)}
        self._heard_at = 0.0  # [s] when the controller's status came
        self._poses = self.create_publisher(PoseStamped, f'{controller}/target_pose', COMMAND)
        self._points = self.create_publisher(PointStamped, f'{controller}/target_point', COMMAND)
        for node in self.statuses:
            self.create_subscription(
                DiagnosticStatus, f'{node}/status', self._hear_status(node), LATCHED
            )
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)

    def destroy_node(self) -> None:
        """End the executor first: later it would find ROS shut down."""
        self._executor.shutdown()
        super().destroy_node()

    @property
    def status(self) -> dict[str, str]:
        """What the controller said last: `code`, `message` and its values; empty before."""
        return self.statuses[self._controller]

    @property
    def has_listener(self) -> bool:
        """Whether somebody takes targets."""
        return bool(self._poses.get_subscription_count() and self._points.get_subscription_count())

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

    def settled(self, stamp: str, codes: Sequence[str] = SETTLED_CODES) -> bool:
        """Whether the controller has settled on its answer to what has this stamp."""
        return self.status.get('target_stamp') == stamp and self.status['code'] in codes

    def wait(
        self, condition: Callable[[], object], timeout: float, what: str, strict: bool = True
    ) -> bool:
        """
        Spin until something is true; raise, or return False, when it does not come.

        Raises
        ------
        TendonRobotError
            It did not come; says what the nodes say.
        KeyboardInterrupt
            A signal came.

        """
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > deadline:
                if not strict:
                    return False
                statuses = '; '.join(
                    f'the {node if node != self._controller else "controller"} says: '
                    f'{values.get("message", "nothing")}'
                    for node, values in self.statuses.items()
                )
                raise TendonRobotError(f'waited {timeout:g} s in vain for {what}; {statuses}')
            self.spin_once(0.05)
        return True

    def spin(self, seconds: float) -> None:
        """Listen for a while."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self.spin_once(left)

    def triggered(self, name: str) -> str:
        """Call a Trigger service; return its message, or raise what it refuses."""
        client = self.create_client(Trigger, name)
        self.wait(client.service_is_ready, 20.0, f'the service {name}')
        future = client.call_async(Trigger.Request())
        self.wait(future.done, 20.0, f'an answer of {name}')
        self.destroy_client(client)
        answer = future.result()
        if not answer.success:
            raise TendonRobotError(f'{name}: {answer.message}')
        return str(answer.message)

    def spin_once(self, timeout: float) -> None:
        """Serve one message; raise KeyboardInterrupt when a signal came."""
        if self.ending.signal:
            raise KeyboardInterrupt
        self._executor.spin_once(timeout_sec=timeout)

    def _hear_status(self, node: str) -> Callable[[DiagnosticStatus], None]:
        def hear(message: DiagnosticStatus) -> None:
            values = {item.key: item.value for item in message.values}
            self.statuses[node] = {**values, 'message': message.message}
            if node == self._controller:
                self._heard_at = time.monotonic()

        return hear


class Pilot(RobotClient):
    """One connection to a controller; what was heard since `clear` is kept."""

    def __init__(
        self,
        name: str,
        controller: str,
        ending: Ending,
        namespace: str | None = None,
        watched: Sequence[str] = (),
    ) -> None:
        """Connect."""
        super().__init__(name, ending, namespace, controller=controller, watched=watched)
        self.inputs: tuple[str, ...] = ()
        self.pull = False
        self._since = time.monotonic() + 3600.0  # until `clear`
        self._tips: dict[str, list[tuple[float, Array, Array]]] = {'measured': [], 'predicted': []}
        self._commands: list[tuple[float, Array]] = []
        self._trajectories = self.create_publisher(
            JointTrajectory, f'{controller}/tendon_trajectory', COMMAND
        )
        subscribe = self.create_subscription
        subscribe(PoseStamped, f'{controller}/predicted_tip', self._hear_predicted, LISTEN)
        subscribe(PoseStamped, 'measured_tip', self._hear_measured, LISTEN)
        subscribe(JointState, 'tendon_command', self._hear_command, COMMAND)

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
                and self.has_listener
                and self._trajectories.get_subscription_count()
                # else a tip that the driver measures might be missed
                and self.count_publishers('tendon_states')
            ),
            timeout,
            f'{self.resolve_topic_name(self._controller)} to command; are driver and controller '
            'running, in this namespace and ROS_DOMAIN_ID?',
        )
        self.spin(TIP_AVERAGE_S)
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
        passing = code.startswith('refused_') or code == 'released'
        old = passing and self._heard_at < self._since + TIP_AVERAGE_S
        if code not in WORKING_CODES and not old:
            raise TendonRobotError(f'the controller says {code}: {self.status.get("message")}')

    def model(self) -> Model:
        """Load the model that the controller uses, with its effects."""
        files: list[list[str]] = []
        text, effects = self._text('model'), RemoteText(self, self._controller, 'effects')

        def asked() -> bool:
            effects.ask_list(files.append)
            return bool(files)

        self.wait(asked, 10.0, f'the parameter effects of {self._controller}')
        return load(load_robot(text), load_catalogue(files[0]))

    @contextmanager
    def keeping_out(self, regions: str) -> Iterator[None]:
        """Have the controller keep the arm out of regions, YAML text, besides its own."""
        remote, own = RemoteText(self, self._controller, 'keep_out'), self._text('keep_out')
        self._put(remote, joined(text_of(own), regions))
        try:
            yield
        finally:
            self._put(remote, own)

    def _text(self, parameter: str) -> str:
        """Return a text parameter of the controller."""
        texts: list[str] = []
        remote = RemoteText(self, self._controller, parameter)

        def asked() -> bool:
            remote.ask(texts.append)
            return bool(texts)

        self.wait(asked, 10.0, f'the parameter {parameter} of {self._controller}')
        return texts[0]

    def _put(self, remote: RemoteText, value: str) -> None:
        """Set a parameter of the controller, or raise why it is not taken."""
        answers: list[tuple[bool, str]] = []
        remote.put(value, lambda taken, why: answers.append((taken, why)))
        end = time.monotonic() + 10.0
        while not answers and time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.05)  # also after Ctrl-C
        taken, why = answers[0] if answers else (False, f'{self._controller} does not answer')
        if not taken:
            raise TendonRobotError(f'the regions of {self._controller} were not changed: {why}')

    def play(self, trajectory: Trajectory) -> str:
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

        def done() -> bool:
            self.require_good()
            return self.settled(stamp, (*SETTLED_CODES, 'played'))

        self.wait(done, timeout, what)

    def stand(self) -> None:
        """Wait until the tip has stood a moment, at most a few seconds: motors, trackers lag."""
        end = time.monotonic() + STANDING_TIMEOUT_S
        self.spin(TIP_AVERAGE_S)
        while time.monotonic() < end:
            self.spin(TIP_AVERAGE_S)
            _, times, places, _ = self.tips()
            late, early = times > times[-1] - TIP_AVERAGE_S / 2, times > times[-1] - TIP_AVERAGE_S
            if not (early & ~late).any():
                continue
            moved = places[late].mean(axis=0) - places[early & ~late].mean(axis=0)
            if np.linalg.norm(moved) < STILL_WITHIN_M:
                self.spin(TIP_AVERAGE_S)  # `tip` then takes none of what was still on its way
                return

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
        recent = times > times[-1] - TIP_AVERAGE_S
        along = views[recent].mean(axis=0)
        return places[recent].mean(axis=0), along / np.linalg.norm(along)

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
