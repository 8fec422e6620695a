"""Joint messages from their bytes: what is laid out as the last one is not read anew."""

from __future__ import annotations

import struct
import sys
from collections.abc import Sequence
from typing import NamedTuple

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from .messages import seconds

PLAIN = b'\x00\x01'  # little-endian CDR, as every middleware of this kind of computer writes it
STAMP, COUNT = struct.Struct('<iI'), struct.Struct('<I')
PLAIN_MASK = b'\xff\xff'
HEAD = 4  # bytes; values are aligned from there on
UNKNOWN = -1


class Joints(NamedTuple):
    """What counts of a sensor_msgs/JointState."""

    stamp: float  # [s]
    names: Sequence[str]
    position: Sequence[float]
    effort: Sequence[float]


class JointReader:
    """
    Reads joint messages.

    rclpy makes every message anew, with all its names: a third of what a controller does that
    stands idle. Where a message has the length of one that rclpy has read, and the same bytes but
    for stamp, values and what fills gaps, it is laid out alike: the values stand where they stood.
    """

    def __init__(self) -> None:
        """Know of no message."""
        self._length, self._mask, self._same = UNKNOWN, 0, 0
        self._last = Joints(0.0, (), (), ())
        self._values: list[tuple[struct.Struct, int]] = []  # of positions, velocities, efforts

    def __call__(self, data: bytes) -> Joints:
        """Read a message; raises what rclpy raises where it is none."""
        alike = len(data) == self._length
        if not alike or int.from_bytes(data, 'little') & self._mask != self._same:
            message = deserialize_message(data, JointState)
            values = message.position, message.effort
            self._last = Joints(seconds(message.header.stamp), message.name, *values)
            self._learn(data, message)
            return self._last
        sec, nanosec = STAMP.unpack_from(data, HEAD)
        (position, at), _, (effort, behind) = self._values
        return Joints(
            sec + 1e-9 * nanosec,
            self._last.names,
            position.unpack_from(data, at),
            effort.unpack_from(data, behind),
        )

    def _learn(self, data: bytes, message: JointState) -> None:
        """Learn where the values of a message stand, if all stands where it should."""
        self._length, self._values = UNKNOWN, []
        if sys.byteorder != 'little' or data[:2] != PLAIN:
            return
        fixed, at = bytearray(len(data)), HEAD + STAMP.size

        def stands(part: bytes, size: int, same: bool = True) -> bool:
            nonlocal at
            at += -(at - HEAD) % size
            if same:
                fixed[at : at + len(part)] = b'\xff' * len(part)
            at += len(part)
            return data[at - len(part) : at] == part

        texts = [one.encode() + b'\x00' for one in (message.header.frame_id, *message.name)]
        parts = [COUNT.pack(len(text)) + text for text in texts]
        for part in (parts[0], COUNT.pack(len(message.name)), *parts[1:]):
            if not stands(part, COUNT.size):
                return
        for values in (message.position, message.velocity, message.effort):
            form = struct.Struct(f'<{len(values)}d')
            counted = stands(COUNT.pack(len(values)), COUNT.size)
            if not (counted and stands(form.pack(*values), 8 if values else 1, same=False)):
                return
            self._values.append((form, at - form.size))
        self._length = len(data)
        self._mask = int.from_bytes(PLAIN_MASK + fixed[2:], 'little')
        self._same = int.from_bytes(data, 'little') & self._mask
