"""Takes the arm through postures and watches, over topics only."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped, Vector3Stamped
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String

from ...common.errors import TendonRobotError
from ...simulation.rehearsal import TourPosture
from ..shared.messages import LATCHED, LATCHED_BY_MANY, LISTEN, STATE, seconds
from ..shared.robot_client import RobotClient
from ..shared.runtime import Ending, NodeProcess

Array = NDArray[np.float64]
STARTING_CODES = (None, 'loading', 'compiling', 'building', 'not_ready')
START_TIMEOUT_S = 600.0  # [s] for all nodes
SETTLE_S = 0.5  # [s] from the end of a way until what is measured counts
MESSAGES_MIN = 15  # of each kind over which a mean is taken: half a second of a tracker
MESSAGES_KEPT = 500
POSTURE_TIMEOUT_S = 20.0  # [s] for a stop
RECORDING_TIMEOUT_S = 15.0  # [s] that a posture may take to be recorded: machines are busy


class Director(RobotClient):
    """Speaks to controller, driver and monitor as any other node could."""

    def __init__(self, namespace: str, base: str, ending: Ending) -> None:
        """Connect."""
        super().__init__('tour', ending, namespace, base, watched=('monitor',))
        self.progress, self.verdict = '', dict[str, Any]()
        self.touring = True  # the page may switch it off
        self._stands_since = np.inf  # [s] by the stamps of messages
        self.nodes: list[NodeProcess] = []  # that were started for it
        self._tips: list[tuple[float, Array]] = []
        self._errors: list[tuple[float, Array]] = []
        self._tensions: list[tuple[float, Array]] = []
        self.create_subscription(PoseStamped, 'measured_tip', self._tip, LISTEN)
        self.create_subscription(Vector3Stamped, 'monitor/error', self._error, LISTEN)
        self.create_subscription(JointState, 'tendon_states', self._states, LISTEN)
        self.create_subscription(String, 'monitor/progress', self._hear_progress, STATE)
        self.create_subscription(String, 'monitor/verdict', self._hear_verdict, LATCHED)
        self.create_subscription(Bool, 'tour', self._hear_tour, LATCHED)

    def print_investigation(self) -> None:
        """Print from now on what an investigation says of each posture, as the page shows it."""

        def heard(message: String) -> None:
            print(json.loads(message.data)['text'], flush=True)

        self.create_subscription(String, 'investigate/progress', heard, LATCHED_BY_MANY)

    def wait_until_up(self) -> None:
        """Wait for all nodes, however slow the computer is, as long as none has ended."""

        def up() -> bool:
            for node in self.nodes:
                if (code := node.process.poll()) is not None:
                    raise TendonRobotError(f'the {node.name} has ended with code {code}')
            starting = self.status.get('code') in STARTING_CODES
            compares = self.statuses['monitor'].get('code') == 'comparing'
            return not starting and compares and bool(self._errors) and self.has_listener

        self.wait(up, START_TIMEOUT_S, 'controller, driver and monitor to start')

    def go(self, stop: TourPosture) -> bool:
        """
        Send a target and wait until the arm has stood there, seen often enough.

        Returns
        -------
        bool
            Whether it did, and was seen; what `tip` and `tensions` say is then of this posture.

        """
        self._stands_since, stamp = np.inf, self.send(stop.position, stop.direction)

        def stood() -> bool:
            now = 1e-9 * self.get_clock().now().nanoseconds
            settled = self.settled(stamp)
            self._stands_since = min(self._stands_since, now + SETTLE_S) if settled else np.inf
            return self._seen() or not self.touring

        return (
            self.wait(stood, POSTURE_TIMEOUT_S, 'the arm to stand', strict=False) and self.touring
        )

    def record(self, stop: TourPosture) -> bool:
        """Go to a posture and wait until the monitor has recorded it; return whether it did."""
        before = self.recorded
        if not self.go(stop):
            return False
        return self.wait(
            lambda: self.recorded > before, RECORDING_TIMEOUT_S, 'a recording', strict=False
        )

    @property
    def recorded(self) -> int:
        """How many postures the monitor has."""
        return int(self.statuses['monitor'].get('postures', '0'))

    def uses(self, effects: Sequence[str]) -> bool:
        """Whether controller and monitor have these effects in their model."""
        models = [values.get('model', '') for values in self.statuses.values()]
        return all(name in model for name in effects for model in models)

    def tip(self) -> Array:
        """Return the mean measured tip (3,) [m] since the arm stands."""
        return self._mean(self._tips)

    def error(self) -> float:
        """Return how far the tip is off [m]: the mean error since the arm stands."""
        return float(np.linalg.norm(self._mean(self._errors)))

    def tensions(self) -> Array:
        """Return the mean measured tensions (m,) [N] since the arm stands."""
        return self._mean(self._tensions)

    def _standing(self, heard: Sequence[tuple[float, Array]]) -> list[Array]:
        """Return what was measured since the arm stands: a busy machine hears late, and less."""
        return [
            value for at, value in heard if at > self._stands_since and np.isfinite(value).all()
        ]

    def _seen(self) -> bool:
        kinds = (self._tips, self._errors, self._tensions)
        return all(len(self._standing(heard)) >= MESSAGES_MIN for heard in kinds)

    def _mean(self, heard: Sequence[tuple[float, Array]]) -> Array:
        values = self._standing(heard)
        return np.array(np.mean(values, axis=0)) if values else np.full(3, np.nan)

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
    del heard[:-MESSAGES_KEPT]
