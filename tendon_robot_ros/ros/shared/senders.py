"""
Several publishers of a topic: one is followed until it is gone, the others are reported.

Every message comes with the gid of its publisher. A node knows the gids of all publishers of a
topic, and the names of their nodes.
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

from ...common.processes import Linux
from ...common.words import LISTED_MAX
from .inbox import Gid, Received, structure
from .timing import SILENCE_S, VALUES_PERIOD_S

UNDISCOVERED = '_NODE_NAME_UNKNOWN_'  # the name that rmw gives until discovery has ended
_Gid = structure('rmw_gid_t', middleware=ctypes.c_char_p, publisher=Gid)
CREDENTIALS = struct.Struct('3i')  # struct ucred of unix(7): process, user, group


def gid_of(publisher: Publisher) -> bytes:
    """Return the gid of a publisher of this process."""
    gid, library = _Gid(), ctypes.CDLL('librcl.so')  # also resolves the symbols of the middleware
    get_handle = library.rcl_publisher_get_rmw_handle
    get_handle.restype = ctypes.c_void_p
    with publisher.handle:
        handle = ctypes.c_void_p(get_handle(ctypes.c_void_p(publisher.handle.pointer)))
        library.rmw_get_gid_for_publisher(handle, ctypes.byref(gid))
    return bytes(gid.publisher)


def gid_text(gid: bytes) -> str:
    """Write a gid as `ros2 topic info --verbose` does."""
    return gid.hex('.')


def _socket_name(gid: bytes) -> str:
    return f'\0tendon_robot_ros.publisher.{gid.hex()}'


def process_of(gid: bytes) -> int:
    """Return the process id of a publisher; 0: on another computer, or unknown."""
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.setblocking(False)
            connection.connect(_socket_name(gid))
            level, option = socket.SOL_SOCKET, socket.SO_PEERCRED
            credentials = connection.getsockopt(level, option, CREDENTIALS.size)
    except OSError:
        return 0
    return int(CREDENTIALS.unpack(credentials)[0])


class SenderProcess:
    """
    The process of a publisher, if it is known; its death is detected at once.

    Silence shows a death only after its time-out, and a pidfd only when all its threads have
    ended and its memory is released, which takes long on a busy machine. The state and flags of
    its main thread show earlier that it is exiting: proc(5).
    """

    def __init__(self, number: int) -> None:
        """Open the state of a process by its id; 0: of none."""
        self._file: int | None = None
        if number:
            with contextlib.suppress(OSError):
                # of its main thread: the kernel then adds up no times of the others
                self._file = os.open(f'/proc/{number}/task/{number}/stat', os.O_RDONLY)

    @property
    def died(self) -> bool:
        """Whether the process has ended."""
        if self._file is None:
            return False
        try:
            fields = os.pread(self._file, 1024, 0).rpartition(b') ')[2].split()
        except ProcessLookupError:
            return True
        return fields[0] in (b'Z', b'X') or bool(int(fields[6]) & Linux.PF_EXITING)

    def close(self) -> None:
        """Close the file of its state."""
        if self._file is not None:
            os.close(self._file)
            self._file = None


class Senders:
    """
    Selects the publisher of a topic whose messages count, by the gid that a message carries.

    Also names publishers: node, and process if it is on this computer.
    """

    def __init__(self, node: Node, topic: str) -> None:
        """Start without a publisher."""
        self._node, self._topic = node, topic
        self._known: dict[bytes, str] = {}  # gid -> name
        self._checked_at = float('-inf')
        self._first: bytes | None = None
        self._received_at = float('-inf')
        self._others: dict[bytes, float] = {}  # gid -> when its last message came [s]
        self._process = SenderProcess(0)
        self.new = False  # whether the last message that counts was the first of its publisher

    def counts(self, now: float, received: Received[Any]) -> bool:
        """Return whether a message is of the publisher that is followed: the first that sends."""
        publisher = received.publisher
        known = now - self._received_at <= SILENCE_S
        if known and publisher != self._first:
            if publisher not in self._others:  # it replaces those that are silent
                self._others = {one: self._others[one] for one in self.others(now)}
            if publisher in self._others or len(self._others) < LISTED_MAX:
                self._others[publisher] = now
            return False
        self.new = publisher != self._first and publisher not in self._others
        if publisher != self._first or not known:
            self._others = {}
            self._process.close()
            self._process = SenderProcess(process_of(publisher))
        self._first, self._received_at = publisher, now
        return True

    def died(self) -> bool:
        """Return, once, whether the process of the followed publisher has ended."""
        died = self._process.died
        if died:
            self._received_at = float('-inf')  # the next publisher that sends is followed
            self._process.close()
        return died

    def first(self, now: float) -> bytes | None:
        """Return the gid of the followed publisher, None while there is none."""
        return None if now - self._received_at > SILENCE_S else self._first

    def others(self, now: float) -> list[bytes]:
        """Return the gids of the other publishers that have sent within `SILENCE_S`."""
        return [one for one, at in list(self._others.items()) if now - at <= SILENCE_S]

    def known(self, publisher: bytes) -> bool:
        """Return whether a gid has a name."""
        return publisher in self._known

    def names(self, publishers: Collection[bytes]) -> str:
        """Return the names of publishers, '' for none; checked at most ten times a second."""
        now = time.monotonic()
        if now - self._checked_at >= VALUES_PERIOD_S and not self._known.keys() >= set(publishers):
            self._checked_at = now
            discovered = _discovered(self._node, self._topic)
            for gid, name in discovered.items():
                process = process_of(gid)
                discovered[gid] = f'{name} (process {process})' if process else name
            self._known = discovered | {k: v for k, v in self._known.items() if k in publishers}
        unknown = 'a node that is not discovered'
        return ', '.join(sorted(self._known.get(one, unknown) for one in publishers))


def _discovered(node: Node, topic: str) -> dict[bytes, str]:
    """Return the gid of every publisher of a topic with the full name of its node."""
    return {
        bytes(one.endpoint_gid): f'{one.node_namespace.rstrip("/")}/{one.node_name}'
        for one in node.get_publishers_info_by_topic(topic)
        if one.node_name != UNDISCOVERED  # its name is known a moment later
    }


class OwnPublisher:
    """
    Makes the process of a publisher known to other nodes, and lists the other publishers.

    A socket in the abstract namespace of unix(7) leads to its process: such a name needs no file,
    ends with its process, and is visible to processes of the same computer (of the same network
    namespace) alone.
    """

    def __init__(self, node: Node, publisher: Publisher) -> None:
        """Open the socket; where a sandbox refuses its name, the process stays unknown."""
        self._node, self._topic = node, publisher.topic_name
        self._names, self._checked_at = '', float('-inf')
        self.gid = gid_of(publisher)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        with contextlib.suppress(OSError):
            self._socket.bind(_socket_name(self.gid))
            # the kernel answers a client, so that no connection is accepted. The queue is as long
            # as the kernel allows: one entry for each client since the start
            self._socket.listen(socket.SOMAXCONN)

    def others(self, now: float) -> str:
        """Return the other nodes that publish the topic, even before they send; '': none."""
        if now - self._checked_at >= VALUES_PERIOD_S:
            self._checked_at, names = now, list[str]()
            if self._node.count_publishers(self._topic) > 1:
                names = sorted(_discovered(self._node, self._topic).values())
            own = self._node.get_fully_qualified_name()
            if own in names:  # only once: another process may have the same name
                names.remove(own)
            self._names = ', '.join(names[:LISTED_MAX])
        return self._names

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
