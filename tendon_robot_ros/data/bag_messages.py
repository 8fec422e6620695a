"""The messages of a measurement, built for and taken from recordings without ROS."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .dataset import FloatArray

STRING = 'std_msgs/msg/String'
JOINT_STATE = 'sensor_msgs/msg/JointState'
POSE_ARRAY = 'geometry_msgs/msg/PoseArray'
POSE_STAMPED = 'geometry_msgs/msg/PoseStamped'


class Builder:
    """Build messages of the types that a `BagWriter` knows."""

    def __init__(self, types: Any, frame: str = 'base') -> None:
        """Take the writer's types and the frame in which shapes are measured."""
        self._types, self._frame = types.types, frame

    def string(self, text: str) -> object:
        """Build a std_msgs/String."""
        return self._types[STRING](data=text)

    def joint_state(
        self, time: int, names: Sequence[str], pull: FloatArray, tension: FloatArray
    ) -> object:
        """Build a JointState: wire pulls [m] as positions, tensions [N] as efforts; time [ns]."""
        return self._types[JOINT_STATE](
            header=self._header(time),
            name=list(names),
            position=np.asarray(pull, dtype=float),
            velocity=np.zeros(0),
            effort=np.asarray(tension, dtype=float),
        )

    def pose_array(self, time: int, positions: FloatArray, turned: FloatArray) -> object:
        """Build a PoseArray from positions (J, 3) [m] and quaternions (J, 4); time [ns]."""
        poses = [self._pose(*pair) for pair in zip(positions, turned, strict=True)]
        return self._types[POSE_ARRAY](header=self._header(time), poses=poses)

    def _pose(self, position: FloatArray, turned: FloatArray) -> object:
        types = self._types
        return types['geometry_msgs/msg/Pose'](
            position=types['geometry_msgs/msg/Point'](*map(float, position)),
            orientation=types['geometry_msgs/msg/Quaternion'](*map(float, turned)),
        )

    def _header(self, time: int) -> object:
        stamp = self._types['builtin_interfaces/msg/Time'](sec=time // 10**9, nanosec=time % 10**9)
        return self._types['std_msgs/msg/Header'](stamp=stamp, frame_id=self._frame)


def poses_of(message: Any) -> tuple[str, FloatArray]:
    """Take the frame and x, y, z [m], qx, qy, qz, qw of a PoseStamped, (1, 7)."""
    p, q = message.pose.position, message.pose.orientation
    return message.header.frame_id, np.array([[p.x, p.y, p.z, q.x, q.y, q.z, q.w]])


def parse_pose_array(data: bytes) -> tuple[str, FloatArray]:
    """
    Take the frame and the poses (J, 7) from the bytes of a PoseArray.

    Ten minutes of thirty markers at 100 Hz are two million poses: as objects they take half a
    minute, so that the one message that holds many numbers is read here.

    Raises
    ------
    ValueError
        The bytes are no PoseArray.

    """
    order = '<' if data[1] == 1 else '>'  # CDR: four bytes that say how, then aligned fields
    body = memoryview(data)[4:]

    def count(place: int) -> int:
        return int(np.frombuffer(body, f'{order}u4', 1, place)[0])

    size = count(8)  # after the stamp
    frame = bytes(body[12 : 12 + size]).rstrip(b'\0').decode()
    place = -(-(12 + size) // 4) * 4
    number = count(place)
    place = -(-(place + 4) // 8) * 8
    values = np.frombuffer(body, f'{order}f8', 7 * number, place) if number else np.zeros(0)
    return frame, values.reshape(number, 7).astype(float)


def joints_of(message: Any, names: Sequence[str]) -> tuple[list[float], list[float]]:
    """Take pulls [m] and tensions [N] of the named tendons of a JointState; NaN = not there."""
    places = {name: place for place, name in enumerate(message.name)}

    def pick(values: Sequence[float]) -> list[float]:
        found = (places.get(name, len(values)) for name in names)
        return [float(values[i]) if i < len(values) else float('nan') for i in found]

    return pick(message.position), pick(message.effort)
