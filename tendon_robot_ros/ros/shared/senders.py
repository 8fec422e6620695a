"""
Who sent a message, and several publishers of a topic: one is followed until it is gone.

rclpy does not say who sent a message, the C library below it does. The first publisher is
followed; the others are named.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher

UNTOLD = b''  # publisher of a message where the middleware does not say
MESSAGE_BYTES_MAX = 250_000  # bytes of a message that is read: 10 MB take seconds
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
    publisher: bytes = UNTOLD  # as `endpoint_gid` in what a node knows of the publishers

    def repeats(self, last: Received[M]) -> bool:
        """Whether it is no newer than the last one of the same publisher."""
        if self.number:
            return self.number <= last.number
        return self.sent == last.sent


class Taker[M]:
    """Takes messages with the identity of their publisher; without it where it is not told."""

    def __init__(self, handle: Any, kind: type, read: Callable[[bytes], M]) -> None:
        """Take the subscription of rclpy's C++ part, the kind of its messages, who reads them."""
        self._handle, self._kind, self._read = handle, kind, read
        self.refused = ''  # why the last message that was not read
        self._info = _Info()  # of the last message
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
        while (taken := self._next()) is not None:
            data, sent, number, publisher = taken
            if len(data) > MESSAGE_BYTES_MAX:
                self.refused = too_long(len(data))
                continue
            try:
                return Received(self._read(data), sent, number, publisher)
            except _rclpy.RMWError:
                self.refused = unreadable(self._kind, len(data))
        return None

    def _next(self) -> tuple[bytes, int, int, bytes] | None:
        """Return the next message as bytes, and what is known of it."""
        if self._bytes is None:
            return self._plain()
        info, pointer = self._info, ctypes.c_void_p(self._handle.pointer)
        if self._take(pointer, ctypes.byref(self._bytes), ctypes.byref(info), None) != TAKEN:
            return None
        data = ctypes.string_at(self._bytes.buffer, self._bytes.length)
        number = info.number if info.number < NOT_COUNTED else 0
        return data, info.sent, number, bytes(info.publisher)

    def _plain(self) -> tuple[bytes, int, int, bytes] | None:
        taken = self._handle.take_message(self._kind, True)
        if taken is None:
            return None
        data, info = taken
        number = info['publication_sequence_number'] or 0
        return data, info['source_timestamp'], number, UNTOLD

    def close(self) -> None:
        """Give the memory back."""
        if self._bytes is not None:
            self._free(ctypes.byref(self._bytes))
            self._bytes = None


def too_long(size: int) -> str:
    """Say that a message of so many bytes is not read."""
    return f'expected at most {MESSAGE_BYTES_MAX:,} bytes, got {size:,}'


def unreadable(kind: type, size: int) -> str:
    """Say that so many bytes are no message."""
    return f'expected a message {kind.__name__}, got {size:,} bytes that are none'


GONE_AFTER_S = 1.0  # [s] of silence; a shorter one may be a busy machine
UNDISCOVERED = '_NODE_NAME_UNKNOWN_'  # of rmw, while discovery is under way
UNSIGNED = 'one that does not sign'
SIGNATURE_LENGTH_MAX, NAMED_MAX = 200, 8  # anybody may send anything
LOOK_PERIOD_S = 0.1  # [s]
PF_EXITING = 0x4  # of the kernel, include/linux/sched.h
PROCESS = re.compile(r'\(process (?P<process>\d{1,9}) @ (?P<machine>\w+)\)$')


def signature(node: Node) -> str:
    """Return what a node signs its messages with, in their frame_id: name, process, machine."""
    return f'{node.get_fully_qualified_name()} (process {os.getpid()} @ {_machine()})'


@cache
def _machine() -> str:
    """Return what two processes have in common that know each other by their numbers."""
    try:
        boot = Path('/proc/sys/kernel/random/boot_id').read_text()
        return hashlib.sha256((boot + os.readlink('/proc/self/ns/pid')).encode()).hexdigest()[:8]
    except OSError:
        return 'unknown'


class SenderProcess:
    """
    The process behind a signature, if it runs on this machine: its death is seen at once.

    Silence alone would tell only after its time-out, and a pidfd when all its threads have had
    processor time to die and its memory is given back, which takes long on a busy machine. That
    its main thread is exiting is seen before: proc(5), state and flags.
    """

    def __init__(self, name: str) -> None:
        """Look for it."""
        self._file: int | None = None
        found = PROCESS.search(name)
        if found is not None and found['machine'] == _machine() != 'unknown':
            with contextlib.suppress(OSError):
                # of its main thread: the kernel need not add up those of all
                number = found['process']
                self._file = os.open(f'/proc/{number}/task/{number}/stat', os.O_RDONLY)

    @property
    def died(self) -> bool:
        """Whether it has ended since."""
        if self._file is None:
            return False
        try:
            said = os.pread(self._file, 1024, 0).rpartition(b') ')[2].split()
        except ProcessLookupError:
            return True
        return said[0] in (b'Z', b'X') or bool(int(said[6]) & PF_EXITING)

    def close(self) -> None:
        """Look no more."""
        if self._file is not None:
            os.close(self._file)
            self._file = None


class Senders:
    """
    Tells whose messages count.

    A message tells its sender by its signature. Programs of others leave it empty: they are told
    apart by the numbers that the middleware gives to the messages of a publisher, which grow.
    """

    def __init__(self) -> None:
        """Nobody was heard."""
        self._first: str | None = None
        self._number = 0
        self._heard_at = float('-inf')
        self._others: dict[str, float] = {}  # signature -> when it was heard [s]
        self._process = SenderProcess('')
        self._publisher = UNTOLD
        self.new = False  # whether the last message that counts was the first of its sender

    def counts(self, now: float, name: str, heard: Received[Any]) -> bool:
        """Whether a message is of the one to follow; the first to come is followed."""
        name = name[:SIGNATURE_LENGTH_MAX]
        known = now - self._heard_at <= GONE_AFTER_S
        number = heard.number or 0  # 0 where the middleware does not count
        if known and (name != self._first or 0 < number <= self._number):
            if name in self._others or len(self._others) < NAMED_MAX:
                self._others[name] = now
            return False
        same = (name, heard.publisher) == (self._first, self._publisher)
        self.new = not same and name not in self._others
        if name != self._first or not known:
            self._others = {}
            self._process.close()
            self._process = SenderProcess(name)
        self._first, self._number, self._heard_at = name, number, now
        self._publisher = heard.publisher
        return True

    def died(self) -> bool:
        """Whether the process of the one who is followed has just ended; said once."""
        died = self._process.died
        if died:
            self._heard_at = float('-inf')  # the next to come is followed
            self._process.close()
        return died

    def first(self, now: float) -> str:
        """Return who is followed, '' while there is nobody."""
        gone = self._first is None or now - self._heard_at > GONE_AFTER_S
        return '' if gone else self._first or UNSIGNED

    def others(self, now: float) -> str:
        """Name who is heard besides, '' for nobody."""
        names = [name for name, at in list(self._others.items()) if now - at <= GONE_AFTER_S]
        return ', '.join(sorted(name or UNSIGNED for name in names))


class OtherPublishers:
    """Names the nodes that publish what this node publishes, before they have said anything."""

    def __init__(self, node: Node, publisher: Publisher) -> None:
        """Look for other publishers of the topic of this one."""
        self._node, self._topic = node, publisher.topic_name
        self._names, self._looked = '', float('-inf')

    def names(self, now: float) -> str:
        """Return who is there, '' for nobody; looked up ten times a second."""
        if now - self._looked >= LOOK_PERIOD_S:
            self._looked, self._names = now, self._look()
        return self._names

    def _look(self) -> str:
        if self._node.count_publishers(self._topic) < 2:
            return ''
        publishers = self._node.get_publishers_info_by_topic(self._topic)
        names = sorted(
            f'{one.node_namespace.rstrip("/")}/{one.node_name}'
            for one in publishers
            if one.node_name != UNDISCOVERED  # a moment later it is known
        )
        own = self._node.get_fully_qualified_name()
        if own in names:  # once: another process may have the same name
            names.remove(own)
        return ', '.join(names[:NAMED_MAX])
