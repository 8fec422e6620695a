"""Takes the arm through postures and watches, over topics only."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from numpy.typing import NDArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from ..exceptions import TendonRobotError
from ..monitoring.rehearsal import Stop
from .messages import pose_stamped, towards
from .qos import COMMAND, LATCHED, LISTEN, STATE
from .runtime import Ending

Array = NDArray[np.float64]
SETTLED = ('reached', 'nearest', 'at_limit')
STANDING = 1.2  # [s] at a stop, so that it is recorded
AVERAGE = 0.5  # [s] over which the tip is taken there
LONGEST = 20.0  # [s] for a stop


class Director(Node):
    """Speaks to controller, driver and monitor as any other node could."""

    def __init__(self, namespace: str, base: str, ending: Ending) -> None:
        """Connect."""
        super().__init__('tour', namespace=namespace)
        self._ending, self._base = ending, base
        self.status: dict[str, dict[str, str]] = {'controller': {}, 'monitor': {}}
        self.progress, self.verdict = '', dict[str, Any]()
        self.touring = True  # the page may switch it off
        self._tips: dict[str, list[tuple[float, Array]]] = {'measured': [], 'predicted': []}
        self._tensions: list[tuple[float, Array]] = []
        self._poses = self.create_publisher(PoseStamped, 'controller/target_pose', COMMAND)
        self._points = self.create_publisher(PointStamped, 'controller/target_point', COMMAND)
        for name in self.status:
            self.create_subscription(
                DiagnosticStatus, f'{name}/status', self._hear_status(name), LATCHED
            )
        self.create_subscription(PoseStamped, 'measured_tip', self._tip('measured'), LISTEN)
        self.create_subscription(
            PoseStamped, 'controller/predicted_tip', self._tip('predicted'), LISTEN
        )
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
                and self._tips['predicted']
                and self._points.get_subscription_count()
                and self._poses.get_subscription_count()
            ),
            120.0,
            'controller, driver and monitor to start',
        )

    def go(self, stop: Stop) -> None:
        """Send a target and wait until the arm has stood there for a while."""
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
            return time.monotonic() - since[0] > STANDING or not self.touring

        self.wait(stood, LONGEST, f'the arm at {stop.position.round(4).tolist()}', strict=False)

    def tip(self, which: str) -> Array:
        """Return the mean tip [m], 'measured' or 'predicted', over the last moment."""
        return self._mean(self._tips[which])

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

    def _mean(self, heard: Sequence[tuple[float, Array]]) -> Array:
        now = time.monotonic()
        recent = [value for at, value in heard if now - at < AVERAGE]
        if not recent:
            return np.full(3, np.nan)
        return np.array(np.mean(recent, axis=0))

    def _hear_status(self, name: str) -> Callable[[DiagnosticStatus], None]:
        def hear(message: DiagnosticStatus) -> None:
            values = {item.key: item.value for item in message.values}
            self.status[name] = {**values, 'message': message.message}

        return hear

    def _tip(self, which: str) -> Callable[[PoseStamped], None]:
        def hear(message: PoseStamped) -> None:
            p = message.pose.position
            _keep(self._tips[which], np.array([p.x, p.y, p.z]))

        return hear

    def _states(self, message: JointState) -> None:
        _keep(self._tensions, np.array(message.effort))

    def _hear_progress(self, message: String) -> None:
        self.progress = message.data

    def _hear_verdict(self, message: String) -> None:
        self.verdict = json.loads(message.data)

    def _hear_tour(self, message: Bool) -> None:
        self.touring = message.data


def _keep(heard: list[tuple[float, Array]], value: Array) -> None:
    now = time.monotonic()
    heard.append((now, value))
    while heard[0][0] < now - 2.0 * AVERAGE:
        heard.pop(0)
