"""Frames of a tracker as markers in the base frame; errors of the model as messages."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from geometry_msgs.msg import PoseArray, PoseStamped, Quaternion, Vector3, Vector3Stamped
from rclpy.node import Node
from std_msgs.msg import Float64, Float64MultiArray, Header

from ...common.arrays import Floats
from ...common.errors import InputError
from ...control.inputs import Refusal, check_stamp
from ...data.tracker_faults import is_missing
from ...monitoring import Monitor
from ...monitoring.monitor import Compared
from ..shared.messages import (
    LISTEN,
    STATE,
    Frames,
    matrix,
    points_of,
    pose_array,
    seconds,
    stamp_now,
    time_now,
)
from ..shared.parameters import Parameters, parsed
from ..shared.timing import SILENCE_S, VALUES_PERIOD_S

# [s] between the stamps of markers on topics of their own that belong to one frame: less than a
# period at 30 Hz, else two frames would be merged
FRAME_SPAN_S = 0.02


class MarkerInput:
    """
    Receives the topics of the tracker and passes on frames.

    Parameters
    ----------
    node : Node
    parameters : Parameters
        Of the monitor.
    base : str
        The base frame.
    monitor : Monitor
        poses[i] is its markers[i]; a frame waits for states that are as new as itself.
    take : callable
        Called with the time [s] of the frame and positions (J, 3) [m], nan where missing.

    """

    def __init__(
        self,
        node: Node,
        parameters: Parameters,
        base: str,
        monitor: Monitor,
        take: Callable[[float, Floats], None],
    ) -> None:
        """Create the subscriptions; InputError: a parameter is invalid."""
        self._node, self._parameters, self._taker = node, parameters, take
        self._monitor, self.markers, self.problem = monitor, monitor.markers, ''
        self._waiting: tuple[float, Floats] | None = None
        self._frames = Frames(node, base)
        self._fixed = _transform(parameters['tracker_transform'])
        topics = parsed(parameters['measured_markers'], 'measured_markers', dict)
        self._frame: tuple[float, Floats] | None = None
        if topics:
            indices = {marker.name: index for index, marker in enumerate(self.markers)}
            for name, topic in topics.items():
                if str(name) not in indices:
                    raise InputError(
                        f'measured_markers: expected names of {", ".join(indices)}, got {name!r}'
                    )
                callback = partial(self._marker, indices[str(name)])
                node.create_subscription(PoseStamped, str(topic), callback, LISTEN)
        else:
            node.create_subscription(PoseArray, 'measured_shape', self._shape, LISTEN)
            node.create_subscription(PoseStamped, 'measured_tip', self._tip, LISTEN)
        self._shape_at = -np.inf

    def hand_over(self, late: bool = False) -> None:
        """Pass on the waiting frame if the states are as new, or if it is late."""
        if self._waiting is not None and (late or self._monitor.states.newest >= self._waiting[0]):
            frame, self._waiting = self._waiting, None
            self._taker(*frame)

    def _take(self, at: float, points: Floats) -> None:
        if self._waiting is not None:
            self.hand_over(late=at - self._monitor.states.newest > VALUES_PERIOD_S)
        self._waiting = at, points
        self.hand_over()

    def _shape(self, message: PoseArray) -> None:
        points = points_of(message)
        if len(points) != len(self.markers):
            self.problem = (
                f'measured_shape: expected {len(self.markers)} poses, one for each of the markers '
                f'(nan where it was not seen), got {len(points)}'
            )
            return
        self._shape_at = time_now(self._node)
        self._give(message.header, points, 'measured_shape')

    def _tip(self, message: PoseStamped) -> None:
        if time_now(self._node) - self._shape_at >= SILENCE_S:  # else the shape has more markers
            points = self._only(len(self.markers) - 1, message)
            self._give(message.header, points, 'measured_tip')

    def _marker(self, index: int, message: PoseStamped) -> None:
        """Merge markers on topics of their own into frames."""
        at = self._time(message.header)
        points = self._in_base(message.header, self._only(index, message), 'measured_markers')
        if points is None:
            return
        if self._frame is not None and abs(at - self._frame[0]) > FRAME_SPAN_S:
            self._take(*self._frame)
            self._frame = None
        if self._frame is None:
            self._frame = at, points
        else:
            self._frame[1][index] = points[index]

    def _only(self, index: int, message: PoseStamped) -> Floats:
        """Return positions (J, 3) [m], nan for all markers but one."""
        points = np.full((len(self.markers), 3), np.nan)
        p = message.pose.position
        points[index] = p.x, p.y, p.z
        return points

    def _give(self, header: Header, points: Floats, what: str) -> None:
        placed = self._in_base(header, points, what)
        if placed is not None:
            self._take(self._time(header), placed)

    def _in_base(self, header: Header, points: Floats, what: str) -> Floats | None:
        try:
            tolerance = self._parameters['stamp_tolerance']
            stamp, now = seconds(header.stamp), time_now(self._node)
            check_stamp(stamp, now, tolerance, what)
            rotation, translation = self._fixed or self._frames.to_base(
                header.frame_id, what, stamp, now, tolerance
            )
        except Refusal as refusal:
            self.problem = str(refusal)
            return None
        self.problem = ''
        points = np.where(is_missing(points)[:, None], np.nan, points)
        return points @ rotation.T + translation

    def _time(self, header: Header) -> float:
        return seconds(header.stamp) or time_now(self._node)


def _transform(text: str) -> tuple[Floats, Floats] | None:
    """Parse rotation (3, 3) and translation (3,) [m] from tracker to base; None: no text."""
    if not text.strip():
        return None
    try:
        x, y, z, *q = map(float, text.split())
        norm = float(np.linalg.norm(q))
        rotation = Quaternion(**dict(zip('xyzw', (np.array(q) / norm).tolist(), strict=True)))
    except (ValueError, ZeroDivisionError):
        norm = 0.0
    if not 0.99 < norm < 1.01:
        raise InputError(
            'tracker_transform: expected x y z qx qy qz qw with a quaternion of norm 1, '
            f'got {text!r}'
        )
    return matrix(rotation), np.array([x, y, z])


class MonitorOutput:
    """Publishes errors, and both shapes at the markers."""

    def __init__(self, node: Node) -> None:
        """Create the publishers."""
        self._node, publish = node, node.create_publisher
        self._error = publish(Vector3Stamped, '~/error', STATE)
        self._rolling = publish(Float64, '~/rolling_error', STATE)
        self._per_marker = publish(Float64MultiArray, '~/marker_errors', STATE)
        self._measured = publish(PoseArray, '~/measured', STATE)
        self._predicted = publish(PoseArray, '~/predicted', STATE)

    def publish(self, frame: str, compared: Compared) -> None:
        """Publish a compared frame; markers that are not visible are nan."""
        header = Header(frame_id=frame, stamp=stamp_now(self._node))
        errors = compared.errors
        x, y, z = errors[-1].tolist()
        self._error.publish(Vector3Stamped(header=header, vector=Vector3(x=x, y=y, z=z)))
        self._rolling.publish(Float64(data=compared.rolling))
        self._per_marker.publish(Float64MultiArray(data=np.linalg.norm(errors, axis=1).tolist()))
        self._measured.publish(pose_array(header, compared.measured))
        self._predicted.publish(pose_array(header, compared.predicted))
