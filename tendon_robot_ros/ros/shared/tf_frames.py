"""Frames of incoming messages: the robot's own, or another one through TF where that exists."""

from __future__ import annotations

import importlib.util
from typing import Any

import numpy as np
from geometry_msgs.msg import Quaternion
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.time import Time

from ...common.rotations import from_quaternion
from ...control.checks import Refusal, check_frame

Array = NDArray[np.float64]


class Frames:
    """Brings positions and directions into the base frame."""

    def __init__(self, node: Node, base: str) -> None:
        """Listen to TF where tf2_ros is installed (the wheels of rclpy do not have it)."""
        self.base = base
        self._buffer: Any = None
        if importlib.util.find_spec('tf2_ros') is not None:
            from tf2_ros import Buffer, TransformListener

            self._buffer = Buffer()
            self._listener = TransformListener(self._buffer, node)

    def to_base(self, frame: str, what: str) -> tuple[Array, Array]:
        """
        Return rotation (3, 3) and shift (3,) [m] from a frame to the base frame.

        Raises
        ------
        Refusal
            No transform between the two is known.

        """
        if frame == self.base:
            return np.eye(3), np.zeros(3)
        try:
            transform = self._buffer.lookup_transform(self.base, frame, Time()).transform
        except Exception:  # no buffer, or whatever tf2 raises: no transform
            check_frame(frame, [self.base], what)
            raise Refusal('frame', f'{what}: frame {frame!r} is not usable') from None
        return matrix(transform.rotation), np.array(
            [transform.translation.x, transform.translation.y, transform.translation.z]
        )


def matrix(message: Quaternion) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion message."""
    return from_quaternion((message.x, message.y, message.z, message.w))
