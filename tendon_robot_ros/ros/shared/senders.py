"""
Several publishers of a topic: one is followed until it is gone, the others are named.

Every message comes with the gid of its publisher, which a node also knows of all publishers of a
topic, with the names of their nodes.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import socket
import struct
import time
from collections.abc import Collection
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher

from .inbox import SPARE_BYTES, UNTOLD, Received
from .timing import SILENCE_S, VALUES_PERIOD_S

UNDISCOVERED = '_NODE_NAME_UNKNOWN_'  # of rmw, while discovery is under way
# [1] publishers that are named, because anybody may publish anything, and more do not fit a status
NAMED_MAX = 8
PF_EXITING = 0x4  # [1] flag of a process, manual of proc(5): include/linux/sched.h
CREDENTIALS = struct.Struct('3i')  # struct ucred of unix(7): process, user, group


class _Gid(ctypes.Structure):
    """rmw_gid_t."""

    _fields_ = (
        ('middleware', ctypes.c_char_p),
        ('publisher', ctypes.c_uint8 * 16),
        ('spare', ctypes.c_uint8 * SPARE_BYTES),
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
        handle = ctypes.c_void_p(find(ctypes.c_void_p(publisher.handle.pointer)))
        failed = tell(handle, ctypes.byref(gid))
    return UNTOLD if failed else bytes(gid.publisher)


def gid_text(gid: bytes) -> str:
    """Write a gid as `ros2 topic info --verbose` does."""
    return gid.hex('.')


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
        known = now - self._heard_at <= SILENCE_S
        if known and (publisher != self._first or 0 < number <= self._number):
            if publisher not in self._others:  # takes the place of those who are silent
                self._others = {one: self._others[one] for one in self.others(now)}
            if publisher in self._others or len(self._others) < NAMED_MAX:
                self._others[publisher] = now
            return False
        self.new = publisher != self._first and publisher not in self._others
        if publisher != self._first or not known:
            self._others = {}
            self._process.close()
            self._process = SenderProcess(process_of(publisher))
        self._first, self._number, self._heard_at = publisher, number, now
        return True

    def died(self) -> bool:
        """Whether the process of the one who is followed has just ended; said once."""
        died = self._process.died
        if died:
            self._heard_at = float('-inf')  # the next to come is followed
            self._process.close()
        return died

    def first(self, now: float) -> bytes | None:
        """Return who is followed, None while there is nobody."""
        return None if now - self._heard_at > SILENCE_S else self._first

    def others(self, now: float) -> list[bytes]:
        """Return who is heard besides."""
        return [one for one, at in list(self._others.items()) if now - at <= SILENCE_S]


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
        if now - self._looked >= VALUES_PERIOD_S and not self._known.keys() >= set(publishers):
            self._looked = now
            there = _discovered(self._node, self._topic)
            for gid, name in there.items():
                process = process_of(gid)
                there[gid] = f'{name} (process {process})' if process else name
            self._known = there | {k: v for k, v in self._known.items() if k in publishers}
        unknown = 'a node that is not discovered'
        return ', '.join(sorted(self._known.get(one, unknown) for one in publishers))


def _discovered(node: Node, topic: str) -> dict[bytes, str]:
    """Return the gid of every publisher of a topic with the full name of its node."""
    return {
        bytes(one.endpoint_gid): f'{one.node_namespace.rstrip("/")}/{one.node_name}'
        for one in node.get_publishers_info_by_topic(topic)
        if one.node_name != UNDISCOVERED  # a moment later it is known
    }


class OwnPublisher:
    """
    What a node offers of its publisher, and asks of the others of the same topic.

    It offers a socket whose name leads to its process: unix(7), abstract. That name is the
    kernel's: it needs no file, is gone with its process, and is found by processes of the same
    computer (of the same network namespace) alone.
    """

    def __init__(self, node: Node, publisher: Publisher) -> None:
        """Offer the socket, on Linux, where the publisher has a gid."""
        self._node, self._topic = node, publisher.topic_name
        self._names, self._looked = '', float('-inf')
        self.gid = gid_of(publisher)
        self._socket: socket.socket | None = None
        if self.gid != UNTOLD:
            with contextlib.suppress(OSError):  # no Linux
                made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
                made.bind(_socket_name(self.gid))
                # who connects asks the kernel, not this process: nobody accepts. The queue holds
                # as many as the kernel lets it, one for each who has looked since the start
                made.listen(socket.SOMAXCONN)
                self._socket = made

    def others(self, now: float) -> str:
        """Return the nodes that publish the same, before they have said anything; '': none."""
        if now - self._looked >= VALUES_PERIOD_S:
            self._looked, names = now, list[str]()
            if self._node.count_publishers(self._topic) > 1:
                names = sorted(_discovered(self._node, self._topic).values())
            own = self._node.get_fully_qualified_name()
            if own in names:  # once: another process may have the same name
                names.remove(own)
            self._names = ', '.join(names[:NAMED_MAX])
        return self._names

    def close(self) -> None:
        """Be found no more."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
