"""A mock arm that is the controller's own model, and a tracker that sees it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseArray, PoseStamped
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import Header

from ...common.errors import InputError
from ...common.rotations import towards
from ...drivers.mock import MockDriver
from ...model.model import Model
from ...model.shape import Shape
from ...robot import Robot
from ..shared.messages import STATE, pose_array, pose_stamped
from ..shared.parameters import Parameters
from ..shared.runtime import repeat

Array = NDArray[np.float64]


class Twin:
    """The plant of `make demo`; friction remembers what the arm went through."""

    def __init__(self, robot: Robot) -> None:
        """Begin straight and slack."""
        self._model = Model(robot)
        self._last: Shape | None = None

    def respond(self, tensions: Array) -> Shape:
        """Return the shape under tensions (m,) [N]."""
        self._last = self._model.follow(self._last, tensions)
        return self._last

    def respond_to_pulls(self, pulls: Array) -> Shape:
        """Return the shape under wire pulls (m,) [m], nan = slack."""
        self._last = self._model.pull_shape(pulls, self._last)
        return self._last


# -----------------------------------------------------------------------------
# A tracker for the mock arm: its tip and its shape as cameras would see them.

# rate [Hz], noise [m] 1 sd; shares [1] of markers and of whole frames that are not seen
DEFAULTS = {'rate': 30.0, 'noise': 0.0, 'seed': 0, 'missing': 0.0, 'lost': 0.0}
DIRECTION_POINT_AHEAD_M = 1e-3  # [m] from the tip to the point that tells its direction


class MockTracker:
    """Publishes measured_tip and measured_shape: one marker at the end of every cell."""

    def __init__(
        self, node: Node, driver: MockDriver, config: Mapping[str, Any], parameters: Parameters
    ) -> None:
        """Begin to publish."""
        for key in config:
            if key not in DEFAULTS:
                raise InputError(f'config: tracker: expected {", ".join(DEFAULTS)}, got {key!r}')
        options = {**DEFAULTS, **config}
        self._node, self._driver, self._noise = node, driver, float(options['noise'])
        self._missing, self._lost = float(options['missing']), float(options['lost'])
        self._random = np.random.default_rng(options['seed'])
        robot = driver.robot
        self._frame = parameters['frame_prefix'] + (
            parameters['base_frame'] or f'{robot.name}_base'
        )
        lengths = [section.cell_length for section in robot.sections for _ in range(section.cells)]
        self._arc_lengths = np.cumsum(lengths)
        self._tip = node.create_publisher(PoseStamped, 'measured_tip', STATE)
        self._shape = node.create_publisher(PoseArray, 'measured_shape', STATE)
        self._timer = repeat(node, 1.0 / float(options['rate']), self._publish)

    def close(self) -> None:
        """Stop to publish."""
        for publisher in (self._tip, self._shape):
            self._node.destroy_publisher(publisher)
        self._node.destroy_timer(self._timer)

    def _publish(self) -> None:
        arm: Any = self._driver.truth
        tip_heard = self._tip.get_subscription_count() > 0
        shape_heard = self._shape.get_subscription_count() > 0
        if arm is None or not (tip_heard or shape_heard) or self._random.random() < self._lost:
            return
        header = Header(frame_id=self._frame, stamp=self._node.get_clock().now().to_msg())
        n = len(self._arc_lengths)
        points = arm.markers(self._arc_lengths, np.zeros((n, 3)))  # a plant's: as it is tracked
        tip = arm.tip_position
        ahead = self._seen(
            np.stack([tip, tip + DIRECTION_POINT_AHEAD_M * arm.tip_direction]), arm.inputs
        )
        along = (ahead[1] - ahead[0]) / DIRECTION_POINT_AHEAD_M
        positions = points + self._random.normal(0.0, self._noise, (n, 3))
        positions[self._random.random(n) < self._missing] = np.nan
        if shape_heard:
            rotations = np.tile(np.eye(3), (n, 1, 1))  # markers are points
            self._shape.publish(pose_array(header, positions, rotations))
        if tip_heard and np.isfinite(positions[-1]).all():
            along /= np.linalg.norm(along)
            self._tip.publish(pose_stamped(header, positions[-1], towards(along)))

    def _seen(self, points: Any, inputs: Any) -> Any:
        """Return points (n, 3) [m] in the frame of the tracker, which may be turned."""
        tracked = getattr(self._driver.plant, 'tracked', None)
        return points if tracked is None else tracked(points[None], inputs[None])[0]
