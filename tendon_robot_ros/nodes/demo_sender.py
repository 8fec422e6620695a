"""The third process of the demo: sends targets and watches what the arm does."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState

from ..control.checks import direction
from ..control.postures import Posture
from ..exceptions import TendonRobotError
from ..model.model import Model
from .messages import pose_stamped, towards
from .qos import COMMAND, LATCHED, LISTEN
from .runtime import Ending

Array = NDArray[np.float64]
STILL = 1e-6  # [m] the tip has arrived when it moves no more than this in a fifth of a second
SETTLED = ('reached', 'nearest', 'at_limit')


@dataclass(frozen=True)
class Outcome:
    """Where the arm went."""

    position: Array  # (3,) [m] of the mock's tip
    miss: float  # [m]
    turn: float  # [rad] between the directions
    tensions: Array  # (m,) [N] commanded
    status: str
    at_limit: tuple[str, ...]
    latency: float  # [s] from sending the target to the first command that differs

    @property
    def reachable(self) -> bool:
        """Whether the controller said that the target can be reached."""
        return self.status == 'reached'


class Sender(Node):
    """Speaks to controller and driver only over topics."""

    def __init__(self, namespace: str, model: Model, ending: Ending) -> None:
        """Connect."""
        super().__init__('sender', namespace=namespace)
        self._ending, self._frame = ending, f'{model.robot.name}_base'
        self._status: dict[str, str] = {}
        self._command: Array | None = None
        self._changed = np.inf
        self._tips: list[tuple[float, PoseStamped]] = []
        self._targets = self.create_publisher(PoseStamped, 'controller/target_pose', COMMAND)
        self.create_subscription(JointState, 'tendon_command', self._hear_command, COMMAND)
        self.create_subscription(PoseStamped, 'measured_tip', self._hear_tip, LISTEN)
        self.create_subscription(DiagnosticStatus, 'controller/status', self._hear_status, LATCHED)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)

    def wait_until_up(self) -> None:
        """Wait for controller and driver."""
        self._wait(
            lambda: bool(self._status.get('code') == 'holding' and self._tips),
            30.0,
            'controller and driver to start',
        )

    def go(self, posture: Posture) -> Outcome:
        """Send a target and wait until the arm is still."""
        message = pose_stamped(self._header(), posture.position, towards(posture.direction))
        self._changed = np.inf
        stamp = f'{message.header.stamp.sec}.{message.header.stamp.nanosec:09d}'
        self._tips.clear()
        sent = time.monotonic()
        self._targets.publish(message)
        self._wait(
            lambda: self._settled(stamp),
            10.0,
            f'the arm at {posture.name!r}',
        )
        last = self._tips[-1][1].pose
        p, q = last.position, last.orientation
        place, along = np.array([p.x, p.y, p.z]), direction([q.x, q.y, q.z, q.w], 'measured_tip')
        assert self._command is not None
        return Outcome(
            position=place,
            miss=float(np.linalg.norm(place - posture.position)),
            turn=float(np.arccos(np.clip(along @ posture.direction, -1.0, 1.0))),
            tensions=self._command,
            status=self._status['code'],
            at_limit=tuple(filter(None, self._status['at_limit'].split(', '))),
            latency=self._changed - sent,
        )

    def _header(self) -> object:
        message = PoseStamped()
        message.header.frame_id = self._frame
        message.header.stamp = self.get_clock().now().to_msg()
        return message.header

    def _wait(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        deadline = time.monotonic() + timeout
        while not condition():
            if self._ending.signal:
                raise KeyboardInterrupt
            if time.monotonic() > deadline:
                raise TendonRobotError(
                    f'waited {timeout:g} s in vain for {what}; the controller '
                    f'says: {self._status.get("message", "nothing")}'
                )
            self._executor.spin_once(timeout_sec=0.05)

    def _settled(self, stamp: str) -> bool:
        mine = self._status.get('target_stamp') == stamp
        return mine and self._status['code'] in SETTLED and self._still()

    def _still(self) -> bool:
        now = time.monotonic()
        recent = [tip.pose.position for at, tip in self._tips if now - at < 0.25]
        if len(recent) < 5 or now - self._tips[0][0] < 0.3:
            return False
        places = np.array([[p.x, p.y, p.z] for p in recent])
        return bool(np.ptp(places, axis=0).max() < STILL)

    def _hear_command(self, message: JointState) -> None:
        now, command = time.monotonic(), np.array(message.effort)
        if self._command is not None and not np.array_equal(command, self._command):
            self._changed = min(self._changed, now)
        self._command = command

    def _hear_tip(self, message: PoseStamped) -> None:
        self._tips.append((time.monotonic(), message))

    def _hear_status(self, message: DiagnosticStatus) -> None:
        self._status = {item.key: item.value for item in message.values}
        self._status['message'] = message.message
