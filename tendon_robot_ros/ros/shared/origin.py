"""Who sent a message: rclpy does not say, the C library below it does."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any

from rclpy.serialization import deserialize_message

UNKNOWN = b''  # publisher of a message where the middleware does not say
TAKEN, NOT_COUNTED = 0, 2**64 - 1  # RCL_RET_OK, RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED
SPARE = 256  # bytes behind the structures: newer ones may be longer


class _Allocator(ctypes.Structure):
    """rcutils_allocator_t."""

    _fields_ = tuple(
        (name, ctypes.c_void_p) for name in ('give', 'take', 'change', 'zero', 'state')
    )


class _Bytes(ctypes.Structure):
    """rcutils_uint8_array_t."""

    _fields_ = (
        ('buffer', ctypes.c_void_p),
        ('length', ctypes.c_size_t),
        ('capacity', ctypes.c_size_t),
        ('allocator', _Allocator),
        ('spare', ctypes.c_uint8 * SPARE),
    )


class _Info(ctypes.Structure):
    """rmw_message_info_t."""

    _fields_ = (
        ('sent', ctypes.c_int64),
        ('received', ctypes.c_int64),
        ('number', ctypes.c_uint64),
        ('received_number', ctypes.c_uint64),
        ('middleware', ctypes.c_char_p),
        ('publisher', ctypes.c_uint8 * 16),
        ('spare', ctypes.c_uint8 * SPARE),
    )


@dataclass(frozen=True)
class Received[M]:
    """A message, and what the middleware says of it."""

    message: M
    sent: int  # [ns] clock of the publisher
    number: int  # counts the messages of its publisher; 0 where the middleware does not
    publisher: bytes = UNKNOWN  # as `endpoint_gid` in what a node knows of the publishers

    def repeats(self, last: Received[M]) -> bool:
        """Whether it is no newer than the last one of the same publisher."""
        if self.number:
            return self.number <= last.number
        return self.sent == last.sent


class Taker[M]:
    """Takes messages with the identity of their publisher; without it where it is not told."""

    def __init__(self, handle: Any, kind: type[M]) -> None:
        """Take the subscription of rclpy's C++ part and the kind of its messages."""
        self._handle, self._kind = handle, kind
        try:
            self._take = ctypes.CDLL('librcl.so').rcl_take_serialized_message
            self._free = ctypes.CDLL('librcutils.so').rcutils_uint8_array_fini
            allocator = ctypes.CDLL('librcutils.so').rcutils_get_default_allocator
            allocator.restype = _Allocator
            self._bytes: _Bytes | None = _Bytes(allocator=allocator())
        except (OSError, AttributeError):
            self._bytes = None

    def __call__(self) -> Received[M] | None:
        """Return the next message, None where there is none; the handle must be entered."""
        if self._bytes is None:
            return self._plain()
        info = _Info()
        pointer = ctypes.c_void_p(self._handle.pointer)
        if self._take(pointer, ctypes.byref(self._bytes), ctypes.byref(info), None) != TAKEN:
            return None
        data = ctypes.string_at(self._bytes.buffer, self._bytes.length)
        message = deserialize_message(data, self._kind)
        number = info.number if info.number < NOT_COUNTED else 0
        return Received(message, info.sent, number, bytes(info.publisher))

    def _plain(self) -> Received[M] | None:
        taken = self._handle.take_message(self._kind, False)
        if taken is None:
            return None
        message, info = taken
        return Received(
            message, info['source_timestamp'], info['publication_sequence_number'] or 0
        )

    def close(self) -> None:
        """Give the memory back."""
        if self._bytes is not None:
            self._free(ctypes.byref(self._bytes))
            self._bytes = None
