"""
Who sent a message, and several publishers of a topic: one is followed until it is gone.

Every message comes with the gid of its publisher (rmw: globally unique identifier), which a node
also knows of all publishers of a topic, with the names of their nodes. rclpy hands on the latter,
the C library below it the former. The first publisher is followed; the others are named.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import socket
import struct
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.topic_endpoint_info import TopicEndpointInfo

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


class _Gid(ctypes.Structure):
    """rmw_gid_t."""

    _fields_ = (
        ('middleware', ctypes.c_char_p),
        ('publisher', ctypes.c_uint8 * 16),
        ('spare', ctypes.c_uint8 * SPARE),
    )


def gid_of(publisher: Publisher) -> bytes:
    """Return the gid of a publisher of this process, `UNTOLD` where it is not told."""
    gid = _Gid()
    try:
        library = ctypes.CDLL('librcl.so')  # symbols of the middleware below it are found, too
        find, tell = library.rcl_publisher_get_rmw_handle, library.rmw_get_gid_for_publisher
    except (OSError, AttributeError):
        return UNTOLD
    find.restype = ctypes.c_void_p
    with publisher.handle:
        found = ctypes.c_void_p(find(ctypes.c_void_p(publisher.handle.pointer)))
        told = tell(found, ctypes.byref(gid)) == TAKEN
    return bytes(gid.publisher) if told else UNTOLD


def gid_text(gid: bytes) -> str:
    """Write a gid as `ros2 topic info --verbose` does."""
    return gid.hex('.')


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
UNKNOWN = 'a node that is not discovered'
NAMED_MAX = 8  # anybody may send anything
LOOK_PERIOD_S = 0.1  # [s]
PF_EXITING = 0x4  # of the kernel, include/linux/sched.h
CREDENTIALS = struct.Struct('3i')  # struct ucred of unix(7): process, user, group


class PublisherSocket:
    """
    A socket with the name of a publisher, which leads to its process: unix(7), abstract.

    Its name is the kernel's: it needs no file, is gone with its process, and is found by processes
    of the same computer (of the same network namespace) alone.
    """

    def __init__(self, publisher: Publisher) -> None:
        """Offer it, on Linux, where the publisher has a gid."""
        self._socket: socket.socket | None = None
        gid = gid_of(publisher)
        if gid != UNTOLD:
            with contextlib.suppress(OSError):  # no Linux
                made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
                made.bind(_socket_name(gid))
                # who connects asks the kernel, not this process: nobody accepts. The queue holds
                # as many as the kernel lets it, one for each who has looked since the start
                made.listen(socket.SOMAXCONN)
                self._socket = made

    def close(self) -> None:
        """Be found no more."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def _socket_name(gid: bytes) -> str:
    return f'\0tendon_robot_ros.publisher.{gid.hex()}'


def process_of(gid: bytes) -> int:
    """Return the number of the process of a publisher; 0: not on this computer, or not told."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
            asking.setblocking(False)
            asking.connect(_socket_name(gid))
            said = asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, CREDENTIALS.size)
    except OSError:
        return 0
    return int(CREDENTIALS.unpack(said)[0])


class SenderProcess:
    """
    The process of a publisher, if it is known: its death is seen at once.

    Silence alone would tell only after its time-out, and a pidfd when all its threads have had
    processor time to die and its memory is given back, which takes long on a busy machine. That
    its main thread is exiting is seen before: proc(5), state and flags.
    """

    def __init__(self, number: int) -> None:
        """Look at a process; 0: at none."""
        self._file: int | None = None
        if number:
            with contextlib.suppress(OSError):
                # of its main thread: the kernel need not add up those of all
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

    A message tells its publisher. Where the middleware does not say it, publishers are told apart
    by the numbers that it gives to the messages of each, which grow.
    """

    def __init__(self) -> None:
        """Nobody was heard."""
        self._first: bytes | None = None
        self._number = 0
        self._heard_at = float('-inf')
        self._others: dict[bytes, float] = {}  # publisher -> when it was heard [s]
        self._process = SenderProcess(0)
        self.new = False  # whether the last message that counts was the first of its publisher

    def counts(self, now: float, heard: Received[Any]) -> bool:
        """Whether a message is of the one to follow; the first to come is followed."""
        publisher = heard.publisher
        number = heard.number or 0  # 0 where the middleware does not count
        known = now - self._heard_at <= GONE_AFTER_S
        if known and (publisher != self._first or 0 < number <= self._number):
            self._note(now, publisher)
            return False
        self.new = publisher != self._first and publisher not in self._others
        if publisher != self._first or not known:
            self._others = {}
            self._process.close()
            self._process = SenderProcess(process_of(publisher))
        self._first, self._number, self._heard_at = publisher, number, now
        return True

    def _note(self, now: float, publisher: bytes) -> None:
        """Note that another one was heard, in place of those who are silent."""
        if publisher not in self._others:
            heard = list(self._others.items())
            self._others = {one: at for one, at in heard if now - at <= GONE_AFTER_S}
        if publisher in self._others or len(self._others) < NAMED_MAX:
            self._others[publisher] = now

    def died(self) -> bool:
        """Whether the process of the one who is followed has just ended; said once."""
        died = self._process.died
        if died:
            self._heard_at = float('-inf')  # the next to come is followed
            self._process.close()
        return died

    def first(self, now: float) -> bytes | None:
        """Return who is followed, None while there is nobody."""
        return None if now - self._heard_at > GONE_AFTER_S else self._first

    def others(self, now: float) -> list[bytes]:
        """Return who is heard besides."""
        return [one for one, at in list(self._others.items()) if now - at <= GONE_AFTER_S]


class PublisherNames:
    """Names the publishers of a topic: node, and process where that is of this computer."""

    def __init__(self, node: Node, topic: str) -> None:
        """Know of nobody."""
        self._node, self._topic = node, topic
        self._known: dict[bytes, str] = {}
        self._looked = float('-inf')

    def known(self, publisher: bytes) -> bool:
        """Whether it has been named."""
        return publisher in self._known

    def of(self, publishers: Collection[bytes]) -> str:
        """Return the names of publishers, '' for none; looked up ten times a second at most."""
        now = time.monotonic()
        if now - self._looked >= LOOK_PERIOD_S and not self._known.keys() >= set(publishers):
            self._looked = now
            asked = {one: name for one, name in self._known.items() if one in publishers}
            self._known = self._look() | asked
        return ', '.join(sorted(self._known.get(one, UNKNOWN) for one in publishers))

    def _look(self) -> dict[bytes, str]:
        found = {}
        for one in self._node.get_publishers_info_by_topic(self._topic):
            if one.node_name != UNDISCOVERED:
                gid = bytes(one.endpoint_gid)
                process = process_of(gid)
                where = f' (process {process})' if process else ''
                found[gid] = _full_name(one) + where
        return found


def _full_name(publisher: TopicEndpointInfo) -> str:
    return f'{publisher.node_namespace.rstrip("/")}/{publisher.node_name}'


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
            _full_name(one)
            for one in publishers
            if one.node_name != UNDISCOVERED  # a moment later it is known
        )
        own = self._node.get_fully_qualified_name()
        if own in names:  # once: another process may have the same name
            names.remove(own)
        return ', '.join(names[:NAMED_MAX])
