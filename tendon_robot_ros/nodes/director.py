"""Takes the arm through postures and watches, over topics only."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped, Vector3Stamped
from numpy.typing import NDArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from ..exceptions import TendonRobotError
from ..monitoring.rehearsal import Stop
from .messages import pose_stamped, seconds, towards
from .qos import COMMAND, LATCHED, LISTEN, STATE
from .runtime import Ending

Array = NDArray[np.float64]
SETTLED = ('reached', 'nearest', 'at_limit')
STANDING = 1.0  # [s] at a stop
AVERAGE = 0.5  # [s] over which the tip is taken there
FEWEST = 5  # messages in that time
LONGEST = 20.0  # [s] for a stop
RECORDING = 6.0  # [s] that a posture may take to be recorded: machines are busy


class Director(Node):
    """Speaks to controller, driver and monitor as any other node could."""

    def __init__(self, namespace: str, base: str, ending: Ending) -> None:
        """Connect."""
        super().__init__('tour', namespace=namespace)
        self._ending, self._base = ending, base
        self.status: dict[str, dict[str, str]] = {'controller': {}, 'monitor': {}}
        self.progress, self.verdict = '', dict[str, Any]()
        self.touring = True  # the page may switch it off
        self._tips: list[tuple[float, Array]] = []
        self._errors: list[tuple[float, Array]] = []
        self._tensions: list[tuple[float, Array]] = []
        self._poses = self.create_publisher(PoseStamped, 'controller/target_pose', COMMAND)
        self._points = self.create_publisher(PointStamped, 'controller/target_point', COMMAND)
        for name in self.status:
            self.create_subscription(
                DiagnosticStatus, f'{name}/status', self._hear_status(name), LATCHED
            )
        self.create_subscription(PoseStamped, 'measured_tip', self._tip, LISTEN)
        self.create_subscription(Vector3Stamped, 'monitor/error', self._error, LISTEN)
        self.create_subscription(JointState, 'tendon_states', self._states, LISTEN)
        self.create_subscription(String, 'monitor/progress', self._hear_progress, STATE)
        self.create_subscription(String, 'monitor/verdict', self._hear_verdict, LATCHED)
        self.create_subscription(Bool, 'tour', self._hear_tour, LATCHED)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)

    def wait(
        self, condition: Callable[[], object], timeout: float, what: str, strict: bool = True
    ) -> bool:
        """Spin until something is true; raise, or return False, when it does not come."""
        deadline = time.monotonic() + timeout
        while not condition():
            if self._ending.signal:
                raise KeyboardInterrupt
            if time.monotonic() > deadline:
                if not strict:
                    return False
                said = {name: values.get('message') for name, values in self.status.items()}
                raise TendonRobotError(f'waited {timeout:g} s in vain for {what}; {said}')
            self._executor.spin_once(timeout_sec=0.05)
        return True

    def wait_until_up(self) -> None:
        """Wait for all nodes."""
        self.wait(
            lambda: (
                self.status['controller'].get('code') not in (None, 'compiling', 'not_ready')
                and self.status['monitor'].get('code') == 'comparing'
                and self._errors
                and self._points.get_subscription_count()
                and self._poses.get_subscription_count()
            ),
            120.0,
            'controller, driver and monitor to start',
        )

    def go(self, stop: Stop) -> bool:
        """
        Send a target and wait until the arm has stood there for a while.

        Returns
        -------
        bool
            Whether it did, and was seen; what `tip` and `tensions` say is then of this posture.

        """
        stamp = self.get_clock().now().to_msg()
        if stop.direction is None:
            point = PointStamped()
            point.header.frame_id, point.header.stamp = self._base, stamp
            point.point.x, point.point.y, point.point.z = stop.position.tolist()
            self._points.publish(point)
        else:
            header = PoseStamped().header
            header.frame_id, header.stamp = self._base, stamp
            turn = towards(stop.direction)
            self._poses.publish(pose_stamped(header, stop.position, turn))
        mine, since = f'{stamp.sec}.{stamp.nanosec:09d}', [np.inf]

        def stood() -> bool:
            said = self.status['controller']
            settled = said.get('target_stamp') == mine and said['code'] in SETTLED
            since[0] = min(since[0], time.monotonic()) if settled else np.inf
            standing = time.monotonic() - since[0] > STANDING and self._seen()
            return standing or not self.touring

        return self.wait(stood, LONGEST, 'the arm to stand', strict=False) and self.touring

    def record(self, stop: Stop) -> bool:
        """Go to a posture and wait until the monitor has recorded it; return whether it did."""
        before = self.recorded
        if not self.go(stop):
            return False
        return self.wait(lambda: self.recorded > before, RECORDING, 'a recording', strict=False)

    @property
    def recorded(self) -> int:
        """How many postures the monitor has."""
        return int(self.status['monitor'].get('postures', '0'))

    def uses(self, effects: Sequence[str]) -> bool:
        """Whether controller and monitor have these effects in their model."""
        models = [values.get('model', '') for values in self.status.values()]
        return all(name in model for name in effects for model in models)

    def tip(self) -> Array:
        """Return the mean measured tip (3,) [m] over the last moment."""
        return self._mean(self._tips)

    def error(self) -> float:
        """Return how far the tip is off [m]: the mean error over the last moment."""
        return float(np.linalg.norm(self._mean(self._errors)))

    def tensions(self) -> Array:
        """Return the mean measured tensions (m,) [N] over the last moment."""
        return self._mean(self._tensions)

    def call(self, name: str) -> str:
        """Call a Trigger service; raise what it refuses."""
        client = self.create_client(Trigger, name)
        self.wait(client.service_is_ready, 20.0, f'the service {name}')
        future = client.call_async(Trigger.Request())
        self.wait(future.done, 20.0, f'an answer of {name}')
        self.destroy_client(client)
        answer = future.result()
        if not answer.success:
            raise TendonRobotError(f'{name}: {answer.message}')
        return str(answer.message)

    def spin(self, seconds: float) -> None:
        """Listen for a while."""
        end = time.monotonic() + seconds
        self.wait(lambda: time.monotonic() > end, seconds + 1.0, 'nothing')

    def _recent(self, heard: Sequence[tuple[float, Array]]) -> list[Array]:
        """Return what was measured lately, by stamps: a busy machine hears late."""
        now = 1e-9 * self.get_clock().now().nanoseconds
        recent = [value for at, value in heard if now - at < AVERAGE]
        return [value for value in recent if np.isfinite(value).all()]

    def _seen(self) -> bool:
        kinds = (self._tips, self._errors, self._tensions)
        return all(len(self._recent(heard)) >= FEWEST for heard in kinds)

    def _mean(self, heard: Sequence[tuple[float, Array]]) -> Array:
        recent = self._recent(heard)
        return np.array(np.mean(recent, axis=0)) if recent else np.full(3, np.nan)

    def _hear_status(self, name: str) -> Callable[[DiagnosticStatus], None]:
        def hear(message: DiagnosticStatus) -> None:
            values = {item.key: item.value for item in message.values}
            self.status[name] = {**values, 'message': message.message}

        return hear

    def _tip(self, message: PoseStamped) -> None:
        p = message.pose.position
        _keep(self._tips, seconds(message.header.stamp), np.array([p.x, p.y, p.z]))

    def _error(self, message: Vector3Stamped) -> None:
        v = message.vector
        _keep(self._errors, seconds(message.header.stamp), np.array([v.x, v.y, v.z]))

    def _states(self, message: JointState) -> None:
        _keep(self._tensions, seconds(message.header.stamp), np.array(message.effort))

    def _hear_progress(self, message: String) -> None:
        self.progress = message.data

    def _hear_verdict(self, message: String) -> None:
        self.verdict = json.loads(message.data)

    def _hear_tour(self, message: Bool) -> None:
        self.touring = message.data


def _keep(heard: list[tuple[float, Array]], at: float, value: Array) -> None:
    heard.append((at, value))
    while heard[0][0] < at - 2.0 * AVERAGE:
        heard.pop(0)
