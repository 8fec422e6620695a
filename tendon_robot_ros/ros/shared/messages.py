"""ROS messages to arrays and back, their frames, and the quality of service of every topic."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, Pose, PoseArray, PoseStamped, Quaternion
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.time import Time as ClockTime
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from ...common.arrays import Floats
from ...common.colours import rgb
from ...common.rotations import from_quaternion, quaternions
from ...control.inputs import Refusal, by_name, check_frame, cut


def seconds(stamp: Time) -> float:
    """Return a stamp in seconds."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def stamp_text(stamp: Time) -> str:
    """Return a stamp as text, as in a status: seconds with nine decimals."""
    return f'{stamp.sec}.{stamp.nanosec:09d}'


def nanoseconds_now(node: Node) -> int:
    """Return the time of a node's clock [ns]; the Time object of rclpy costs more."""
    clock = node.get_clock().handle
    with clock:
        return int(clock.get_now().nanoseconds)


def time_now(node: Node) -> float:
    """Return the time of a node's clock [s]."""
    return 1e-9 * nanoseconds_now(node)


def stamp_now(node: Node) -> Time:
    """Return the time of a node's clock as a stamp."""
    now = nanoseconds_now(node)
    return Time(sec=now // 10**9, nanosec=now % 10**9)


def duration(time: float) -> Duration:
    """Return a time [s] as a message."""
    nanoseconds = round(1e9 * time)
    return Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def quaternion(rotation: Floats) -> Quaternion:
    """Return the quaternion of a rotation matrix, shape (3, 3)."""
    x, y, z, w = quaternions(rotation[None])[0].tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def matrix(message: Quaternion) -> Floats:
    """Return the rotation matrix (3, 3) of a quaternion message."""
    return from_quaternion((message.x, message.y, message.z, message.w))


def pose(position: Floats, rotation: Floats) -> Pose:
    """Return a pose."""
    x, y, z = np.asarray(position).tolist()
    return Pose(position=Point(x=x, y=y, z=z), orientation=quaternion(rotation))


def pose_array(header: Header, positions: Floats, rotations: Floats | None = None) -> PoseArray:
    """Return poses of positions (n, 3) [m] and rotation matrices (n, 3, 3); None: unrotated."""
    unrotated = np.tile([0.0, 0.0, 0.0, 1.0], (len(positions), 1))
    orientations = unrotated if rotations is None else quaternions(rotations)
    poses = [
        Pose(
            position=Point(x=p[0], y=p[1], z=p[2]),
            orientation=Quaternion(x=q[0], y=q[1], z=q[2], w=q[3]),
        )
        for p, q in zip(positions.tolist(), orientations.tolist(), strict=True)
    ]
    return PoseArray(header=header, poses=poses)


def points_of(message: PoseArray) -> Floats:
    """Return the positions (n, 3) [m] of poses."""
    points = [[p.position.x, p.position.y, p.position.z] for p in message.poses]
    return np.array(points, dtype=float).reshape(-1, 3)


def pose_stamped(header: Header, position: Floats, rotation: Floats) -> PoseStamped:
    """Return a stamped pose."""
    return PoseStamped(header=header, pose=pose(position, rotation))


def joint_state(
    stamp: Time, names: Sequence[str], position: Floats | None = None, effort: Floats | None = None
) -> JointState:
    """Return a joint message: position = wire pull [m], effort = tension [N]."""
    return refilled(JointState(name=list(names)), stamp, position, effort)


def refilled(
    message: JointState, stamp: Time, position: Floats | None, effort: Floats | None
) -> JointState:
    """Fill a joint message with new values and return it: cheaper than a new message."""
    message.header.stamp = stamp
    message.position = () if position is None else position.tolist()
    message.effort = () if effort is None else effort.tolist()
    return message


def tensions_and_pulls(message: JointState, inputs: Sequence[str]) -> tuple[Floats, Floats]:
    """
    Return tensions (m,) [N] and wire pulls (m,) [m] in the order of the inputs.

    Missing values are nan. Refusal: other names, or another number of values.
    """
    names, blank = message.name, [math.nan] * len(message.name)
    what = 'tendon_states'
    return (
        by_name(names, message.effort or blank, inputs, what, 'effort'),
        by_name(names, message.position or blank, inputs, what, 'position'),
    )


def status_values(message: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a status by their keys."""
    return {item.key: item.value for item in message.values}


def arm_markers(
    header: Header, positions: Floats, thickness: float, color: str, name: str
) -> MarkerArray:
    """Return a line from the base through positions (n, 3) [m], and a ball at the tip."""
    points = [Point(), *(Point(x=p[0], y=p[1], z=p[2]) for p in positions.tolist())]
    red, green, blue = (level / 255.0 for level in rgb(color))
    both = {'header': header, 'ns': name, 'action': Marker.ADD}
    both['color'] = ColorRGBA(r=red, g=green, b=blue, a=1.0)
    line = Marker(id=0, type=Marker.LINE_STRIP, points=points, **both)
    line.pose.orientation.w = 1.0
    line.scale.x = thickness
    tip = Marker(id=1, type=Marker.SPHERE, **both)
    tip.pose.position, tip.pose.orientation.w = points[-1], 1.0
    tip.scale.x = tip.scale.y = tip.scale.z = 2.0 * thickness
    return MarkerArray(markers=[line, tip])


# [1] queued messages of a topic, so that a subscriber that is late by two cycles of the fastest
# node, or receives joints in a message each, loses none
DEPTH = 10
# [1] where every message of several publishers counts: as many for each of five, else those of
# the first would be lost
DEPTH_ALL = 5 * DEPTH


def quality(depth: int = 1, *, reliable: bool = True, latched: bool = False) -> QoSProfile:
    """Keep the last `depth` messages; a latched topic keeps them for later subscribers."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


# commands and setpoints: none may be lost, only the newest counts
COMMAND = quality()
# states, shapes and markers as published: suits reliable and best-effort subscribers
STATE = quality(DEPTH)
# states of joints that may come in several messages: from reliable publishers, too
JOINTS = quality(DEPTH, reliable=False)
# states, trackers and velocities as subscribed: matches reliable and best-effort publishers
LISTEN = quality(reliable=False)
# statuses: a later subscriber gets the last one
LATCHED = quality(latched=True)
# every message of several publishers counts
COMMAND_ALL = quality(DEPTH_ALL)
LISTEN_ALL = quality(DEPTH_ALL, reliable=False)
# the last messages of several publishers, for later subscribers
LATCHED_BY_MANY = quality(DEPTH_ALL, latched=True)


class Frames:
    """Transforms from the frames of messages to the base frame, by TF."""

    def __init__(self, node: Node, base: str) -> None:
        """Listen to TF where tf2_ros is installed (the wheels of rclpy do not have it)."""
        self.base = base
        self._buffer: Any = None
        if importlib.util.find_spec('tf2_ros') is not None:
            from tf2_ros import Buffer, TransformListener

            self._buffer = Buffer()
            self._listener = TransformListener(self._buffer, node)

    def to_base(
        self, frame: str, what: str, stamp: float = 0.0, now: float = 0.0, tolerance: float = 0.5
    ) -> tuple[Floats, Floats]:
        """
        Return rotation (3, 3) and translation (3,) [m] from a frame to the base frame.

        Parameters
        ----------
        frame, what : str
            The frame, and the name of the message.
        stamp : float
            Time of the message [s]; 0: now.
        now : float
            Time of the clock of the node [s].
        tolerance : float
            Largest age of a transform [s]; a static one has no age.

        Raises
        ------
        Refusal
            There is no transform between the two frames, or none of that time.

        """
        if frame == self.base:
            return np.eye(3), np.zeros(3)
        try:
            newest = self._buffer.lookup_transform(self.base, frame, ClockTime())
            at = seconds(newest.header.stamp)
            if 0.0 < stamp < at:
                of_then = ClockTime(nanoseconds=round(1e9 * stamp))
                newest = self._buffer.lookup_transform(self.base, frame, of_then)
            transform = newest.transform
        except Exception:  # no buffer, or whatever tf2 raises: no transform
            check_frame(frame, [self.base], what)
            raise Refusal('frame', f'{what}: frame {cut(frame)!r} is not usable') from None
        age = (stamp or now) - at
        if at > 0.0 and age > tolerance:
            raise Refusal(
                'stale',
                f'{what}: the newest transform from {cut(frame)!r} to {self.base!r} is '
                f'{age:.3g} s old, expected at most {tolerance:g} s; does its publisher run?',
            )
        return matrix(transform.rotation), np.array(
            [transform.translation.x, transform.translation.y, transform.translation.z]
        )


def passing_publisher(node: Node, kind: Any, topic: str, qos: QoSProfile) -> Publisher:
    """
    Create a publisher that may be destroyed while its node runs.

    It has no callbacks for events of the middleware: if one is pending (an endpoint with another
    quality of service or type) when it is destroyed, rclpy's executor of events ends or crashes.
    """
    quiet = PublisherEventCallbacks(use_default_callbacks=False)
    return node.create_publisher(kind, topic, qos, event_callbacks=quiet)


def passing_subscription(
    node: Node,
    kind: Any,
    topic: str,
    callback: Callable[[Any], None],
    qos: QoSProfile,
    raw: bool = False,
) -> Subscription:
    """Create a subscription that may be destroyed while its node runs, as a publisher."""
    quiet = SubscriptionEventCallbacks(use_default_callbacks=False)
    return node.create_subscription(kind, topic, callback, qos, raw=raw, event_callbacks=quiet)
