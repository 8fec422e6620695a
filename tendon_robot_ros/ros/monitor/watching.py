"""Drift and tip force of the monitor: what it publishes of them, and when."""

from __future__ import annotations

import json
import time
from typing import Any

import numpy as np
from geometry_msgs.msg import Vector3, WrenchStamped
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray, Header, String

from ...diagnosis.intervals import load_of
from ...model.model import Model
from ...monitoring import Monitor, StillMeasurement
from ...monitoring.monitor import FrameMean
from ...monitoring.tip_force import TipForce
from ...monitoring.watch import ArmWatch
from ...report.sentences import load_words
from ..shared.messages import LATCHED, STATE
from ..shared.parameters import Parameters
from .parameters import watched

Array = NDArray[np.float64]
SAME_TENSION_SHARE = 0.01  # of the largest: frames under tensions that differ by less are averaged


class Watching:
    """Hands postures and frames of a monitor to the watch, and publishes what it says."""

    def __init__(self, node: Node, parameters: Parameters, monitor: Monitor) -> None:
        """Begin to learn the arm."""
        self._node, self._monitor = node, monitor
        self.watch = ArmWatch(monitor.model, monitor.markers, watched(parameters))
        self._drift = parameters['reference_postures'] > 0.0
        rate = parameters['force_rate']
        self._period = 1.0 / rate if rate > 0.0 else np.inf
        self._due, self.force = 0.0, None
        high = monitor.model.robot.tension_limits[1]
        self._frames = FrameMean(
            parameters['tracker_noise'], SAME_TENSION_SHARE * high, parameters['force_time']
        )
        publish = node.create_publisher
        self._wrench = publish(WrenchStamped, '~/tip_force', STATE)
        self._covariance = publish(Float64MultiArray, '~/tip_force_covariance', STATE)
        self._state = publish(String, '~/drift', LATCHED)
        self._told = ''

    force: TipForce | None

    @classmethod
    def wanted(cls, node: Node, parameters: Parameters, monitor: Monitor) -> Watching | None:
        """Return what watches a monitor; None where nothing is to be watched."""
        if parameters['force_rate'] > 0.0 or parameters['reference_postures'] > 0.0:
            return cls(node, parameters, monitor)
        return None

    def set_model(self, model: Model) -> None:
        """Learn the arm anew, with another description."""
        self.watch = ArmWatch(model, self.watch.markers, self.watch.settings)

    @property
    def drifted(self) -> bool:
        """Whether there is an alarm."""
        state = self.watch.state
        return state is not None and state.alarm

    def values(self) -> dict[str, str]:
        """Return what the status says."""
        said = {} if not self._drift else {'drift': str(self.drifted).lower(),
                                           'watch': self.watch.text}  # fmt: skip
        if self.force is not None:
            gravity = self.watch.model.robot.gravity
            load = load_of(self.force.force, self.force.covariance, gravity)
            said['tip_force'] = load_words(load)
            said['tip_force (N)'] = f'{float(np.linalg.norm(self.force.force)):.4g}'
            said['touched_at_cell'] = str(self.force.cell or '')
        return said

    def frame(
        self, at: float, positions: Array, base: str, stood: StillMeasurement | None
    ) -> None:
        """Take a frame of the tracker, and the posture if the arm has come to stand."""
        if self._drift and stood is not None:
            self.watch.stands(stood.inputs, stood.positions, stood.frames)
            self._tell()
        state = self._monitor.states.at(at)
        if state is None or not np.isfinite(self._period):
            return
        tensions, _ = np.split(state, 2)
        self._frames.put(at, tensions, positions)
        if self._is_due():
            self._publish(base, tensions, *self._frames.take(self.watch.slopes), None)

    def blind(self, base: str) -> None:
        """Without the tracker: wire pulls and tensions tell the force where both are measured."""
        states = self._monitor.states
        state = states.at(states.newest)
        if state is not None and self._is_due():
            tensions, pulls = np.split(state, 2)
            self._publish(base, tensions, None, 1, pulls)

    def _is_due(self) -> bool:
        now = time.monotonic()
        if now < self._due:
            return False
        self._due = now + self._period
        return bool(np.isfinite(self._period))

    def _publish(
        self,
        base: str,
        tensions: Array,
        positions: Array | None,
        frames: int,
        pulls: Array | None,
    ) -> None:
        if not np.isfinite(tensions).all():
            return
        self.force = self.watch.force(tensions, positions, pulls, frames)
        if self.force is None:
            return
        header = Header(frame_id=base, stamp=self._node.get_clock().now().to_msg())
        x, y, z = self.force.force.tolist()
        message = WrenchStamped(header=header)
        message.wrench.force = Vector3(x=x, y=y, z=z)
        self._wrench.publish(message)
        self._covariance.publish(Float64MultiArray(data=self.force.covariance.ravel().tolist()))

    def _tell(self) -> None:
        """Publish the state of the alarm when it has changed."""
        state = self.watch.state
        content: dict[str, Any] = {'text': self.watch.text, 'alarm': self.drifted}
        if state is not None and state.alarm:
            content |= {
                'postures': state.postures,
                'suspects': [vars(suspect) for suspect in state.suspects],
            }
        text = json.dumps(content)
        if text != self._told:
            self._told = text
            self._state.publish(String(data=text))
