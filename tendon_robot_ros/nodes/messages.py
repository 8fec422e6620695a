"""ROS messages to arrays and back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, Pose, PoseArray, PoseStamped, Quaternion
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

Array = NDArray[np.float64]
PREDICTED = (0.0, 0.447, 0.698)  # a blue that colour-blind people tell from the measured orange
MEASURED = (0.835, 0.369, 0.0)


def seconds(stamp: Time) -> float:
    """Return a stamp in seconds."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def duration(time: float) -> Duration:
    """Return a time [s] as a message."""
    nanoseconds = round(1e9 * time)
    return Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def quaternion(rotation: Array) -> Quaternion:
    """Return the quaternion of a rotation matrix, shape (3, 3)."""
    x, y, z, w = quaternions(rotation[None])[0].tolist()
    return Quaternion(x=x, y=y, z=z, w=w)


def quaternions(rotations: Array) -> Array:
    """Return quaternions (n, 4) x, y, z, w of rotation matrices (n, 3, 3)."""
    r = rotations
    # four times the square of each component; the largest one is safe to divide by
    squares = np.stack(
        [
            1 + r[:, 0, 0] - r[:, 1, 1] - r[:, 2, 2],
            1 - r[:, 0, 0] + r[:, 1, 1] - r[:, 2, 2],
            1 - r[:, 0, 0] - r[:, 1, 1] + r[:, 2, 2],
            1 + r[:, 0, 0] + r[:, 1, 1] + r[:, 2, 2],
        ],
        1,
    )
    a, b, c = r[:, 2, 1], r[:, 0, 2], r[:, 1, 0]
    d, e, f = r[:, 1, 2], r[:, 2, 0], r[:, 0, 1]
    rows = np.stack(
        [
            np.stack([squares[:, 0], c + f, b + e, a - d], 1),
            np.stack([c + f, squares[:, 1], a + d, b - e], 1),
            np.stack([b + e, a + d, squares[:, 2], c - f], 1),
            np.stack([a - d, b - e, c - f, squares[:, 3]], 1),
        ],
        1,
    )
    best = rows[np.arange(len(r)), np.argmax(squares, 1)]
    return best / np.linalg.norm(best, axis=1, keepdims=True)


def towards(direction: Array) -> Array:
    """Return a rotation matrix whose z axis is a unit vector, turned there the shortest way."""
    x, y, z = direction
    across = x * x + y * y
    if z < 0.0 and across < 1e-24:
        return np.diag([1.0, -1.0, -1.0])
    k = 1.0 / (1.0 + z) if z >= 0.0 else (1.0 - z) / across  # the same, without cancellation
    return np.array([[1 - k * x * x, -k * x * y, x], [-k * x * y, 1 - k * y * y, y], [-x, -y, z]])


def pose(position: Array, rotation: Array) -> Pose:
    """Return a pose."""
    x, y, z = np.asarray(position).tolist()
    return Pose(position=Point(x=x, y=y, z=z), orientation=quaternion(rotation))


def pose_array(header: Header, positions: Array, rotations: Array) -> PoseArray:
    """Return poses of positions (n, 3) [m] and rotation matrices (n, 3, 3)."""
    poses = [
        Pose(
            position=Point(x=p[0], y=p[1], z=p[2]),
            orientation=Quaternion(x=q[0], y=q[1], z=q[2], w=q[3]),
        )
        for p, q in zip(positions.tolist(), quaternions(rotations).tolist(), strict=True)
    ]
    return PoseArray(header=header, poses=poses)


def pose_stamped(header: Header, position: Array, rotation: Array) -> PoseStamped:
    """Return a stamped pose."""
    return PoseStamped(header=header, pose=pose(position, rotation))


def joint_state(
    stamp: Time, names: Sequence[str], position: Array | None = None, effort: Array | None = None
) -> JointState:
    """Return a joint message: position = wire pull [m], effort = tension [N]."""
    message = JointState(name=list(names))
    message.header.stamp = stamp
    if position is not None:
        message.position = position.tolist()
    if effort is not None:
        message.effort = effort.tolist()
    return message


def arm_markers(
    header: Header,
    positions: Array,
    thickness: float,
    color: tuple[float, float, float],
    name: str,
) -> MarkerArray:
    """Return a line from the base through positions (n, 3) [m], and a ball at the tip."""
    points = [Point(), *(Point(x=p[0], y=p[1], z=p[2]) for p in positions.tolist())]
    rgba = ColorRGBA(r=color[0], g=color[1], b=color[2], a=1.0)
    line = Marker(
        header=header,
        ns=name,
        id=0,
        type=Marker.LINE_STRIP,
        action=Marker.ADD,
        points=points,
        color=rgba,
    )
    line.pose.orientation.w = 1.0
    line.scale.x = thickness
    tip = Marker(header=header, ns=name, id=1, type=Marker.SPHERE, action=Marker.ADD, color=rgba)
    tip.pose.position, tip.pose.orientation.w = points[-1], 1.0
    tip.scale.x = tip.scale.y = tip.scale.z = 2.0 * thickness
    return MarkerArray(markers=[line, tip])
