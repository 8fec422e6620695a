"""
Subscriptions and services that whoever needs them asks, in a thread of its own choice.

Every message comes with the gid of its publisher (rmw: globally unique identifier). rclpy does not
hand it on, the C library below it does.
"""

from __future__ import annotations

import contextlib
import ctypes
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_services_default
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.type_support import check_is_valid_msg_type, check_is_valid_srv_type
from std_msgs.msg import Bool, String

from .messages import (
    COMMAND,
    COMMAND_ALL,
    LATCHED_BY_MANY,
    LISTEN,
    LISTEN_ALL,
    passing_subscription,
)
from .timing import SILENCE_S, VALUES_PERIOD_S

UNTOLD = b''  # publisher of a message where the middleware does not say
# [B] of a message that is read beside the commands: measured, 10 MB take seconds
MESSAGE_BYTES_MAX = 250_000
# [1] manual of rmw, rmw/types.h: RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED
NOT_COUNTED = 2**64 - 1
# [B] behind each structure, because a newer library may write a longer one
SPARE_BYTES = 256


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
        ('spare', ctypes.c_uint8 * SPARE_BYTES),
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
        ('spare', ctypes.c_uint8 * SPARE_BYTES),
    )


class Inbox[M]:
    """
    Takes messages when it is asked.

    What an executor calls waits for everything else that the executor calls. Commands, states and
    stops do not: the thread that needs them takes them, once per cycle, and no message wakes
    anybody. rclpy's own subscriptions cannot be kept from the executor of their node; this one has
    what is inside them. Publishers of another quality of service are passed over silently: the
    same topic may have another inbox for them.
    """

    def __init__(self, node: Node, kind: type[M], topic: str, qos: QoSProfile) -> None:
        """Subscribe."""
        check_is_valid_msg_type(kind)
        self.topic, self._kind, self._problem = topic, kind, ''
        with node.handle:
            self.handle = _rclpy.Subscription(node.handle, kind, topic, qos.get_c_qos_profile())
        self._info = _Info()  # of the last message
        try:
            self._take_bytes = ctypes.CDLL('librcl.so').rcl_take_serialized_message
            self._free = ctypes.CDLL('librcutils.so').rcutils_uint8_array_fini
            allocator = ctypes.CDLL('librcutils.so').rcutils_get_default_allocator
            allocator.restype = _Allocator
            self._bytes: _Bytes | None = _Bytes(allocator=allocator())
        except (OSError, AttributeError):  # messages then come without their publisher
            self._bytes = None

    def take(self) -> list[Received[M]]:
        """Give the messages that came since the last time, oldest first, that can be read."""
        taken: list[Received[M]] = []
        with self.handle:
            while (raw := self._next()) is not None:
                problem, message = _read(raw[0], self._kind)
                if problem:
                    self._problem = problem
                else:
                    taken.append(Received(message, *raw[1:]))
        return taken

    def _next(self) -> tuple[bytes, int, int, bytes] | None:
        """Return the next message as bytes, sent, number, publisher; in the entered handle."""
        if self._bytes is None:
            taken = self.handle.take_message(self._kind, True)
            if taken is None:
                return None
            data, about = taken
            number = about['publication_sequence_number'] or 0
            return data, about['source_timestamp'], number, UNTOLD
        info, pointer = self._info, ctypes.c_void_p(self.handle.pointer)
        failed = self._take_bytes(pointer, ctypes.byref(self._bytes), ctypes.byref(info), None)
        if failed:  # there is none
            return None
        data = ctypes.string_at(self._bytes.buffer, self._bytes.length)
        number = info.number if info.number < NOT_COUNTED else 0
        return data, info.sent, number, bytes(info.publisher)

    def refused(self) -> str:
        """Say why a message since the last time was not read, '' for none."""
        problem, self._problem = self._problem, ''
        return problem and f'{self.topic}: {problem}'

    def close(self) -> None:
        """Unsubscribe."""
        if self._bytes is not None:
            self._free(ctypes.byref(self._bytes))
            self._bytes = None
        self.handle.destroy_when_not_in_use()


def _read(data: bytes, kind: type) -> tuple[str, Any]:
    """Return why bytes are not read as a message, '' if they are, and the message."""
    if len(data) > MESSAGE_BYTES_MAX:
        return f'expected at most {MESSAGE_BYTES_MAX:,} bytes, got {len(data):,}', None
    try:
        return '', deserialize_message(data, kind)
    except _rclpy.RMWError:
        name = kind.__name__
        return f'expected a message {name}, got {len(data):,} bytes that are none', None


Answer = Callable[[object], None]


class Service:
    """
    A service that answers when it is asked to, whatever its node's executor is doing.

    Parameters
    ----------
    answer : callable
        Gets a request, and a function that sends the response, now or when it is known.

    """

    def __init__(
        self, node: Node, kind: Any, name: str, answer: Callable[[Any, Answer], object]
    ) -> None:
        """Offer the service."""
        self._kind, self._answer = kind, answer
        check_is_valid_srv_type(kind)
        with node.handle:
            qos = qos_profile_services_default.get_c_qos_profile()
            self.handle = _rclpy.Service(node.handle, kind, name, qos)

    def serve(self) -> None:
        """Hand on the requests that came since the last time."""
        while True:
            with self.handle:
                request, header = self.handle.service_take_request(self._kind.Request)
            if header is None:
                return
            self._answer(request, partial(self._send, header.request_id))

    def _send(self, request_id: Any, response: object) -> None:
        """Send a response, unless who asked, or this service, has gone."""
        with contextlib.suppress(_rclpy.RCLError, _rclpy.InvalidHandle), self.handle:
            self.handle.service_send_response(response, request_id)

    def close(self) -> None:
        """Offer it no more."""
        self.handle.destroy_when_not_in_use()


class Waiting:
    """Sleeps until an inbox has a message or a service a request, or until it is woken."""

    def __init__(self, node: Node) -> None:
        """Wait in the context of a node."""
        self._context = node.context
        self._guard = GuardCondition(None, None, node.context)

    def wait(self, inboxes: Sequence[Inbox[Any]], services: Sequence[Service] = ()) -> None:
        """Sleep."""
        waits = _rclpy.WaitSet(len(inboxes), 1, 0, 0, len(services), 0, self._context.handle)
        with waits:
            waits.clear_entities()
            for inbox in inboxes:
                waits.add_subscription(inbox.handle)
            for service in services:
                waits.add_service(service.handle)
            waits.add_guard_condition(self._guard.handle)
            waits.wait(-1)

    def wake(self) -> None:
        """End a sleep, also one that has not begun."""
        self._guard.trigger()

    def close(self) -> None:
        """Give back what wakes."""
        self._guard.destroy()


def hear_anybody[M](
    node: Node, kind: type[M], topic: str, hear: Callable[[M], None], refuse: Callable[[str], None]
) -> list[Subscription]:
    """
    Subscribe to publishers of any quality of service; return the subscriptions.

    A best-effort subscription hears everybody, a reliable one loses nothing of who is reliable;
    what comes by both is heard once. What is too long to be read beside the commands is refused.
    """
    waiting: tuple[deque[tuple[float, bytes]], deque[tuple[float, bytes]]] = deque(), deque()

    def come(message: bytes, path: int) -> None:
        now, own, other = time.monotonic(), waiting[path], waiting[1 - path]
        for queue in waiting:
            while queue and now - queue[0][0] > SILENCE_S:
                queue.popleft()
        same = next((pair for pair in other if pair[1] == message), None)
        if same is not None:
            other.remove(same)
            return
        own.append((now, message))
        problem, read = _read(message, kind)
        if problem:
            refuse(f'{topic.removeprefix("~/")}: {problem}')
        else:
            hear(read)

    return [
        passing_subscription(node, kind, topic, partial(come, path=path), qos, raw=True)
        for path, qos in enumerate((COMMAND, LISTEN))
    ]


PASSED_ON = '_stop_heard'  # hidden, as ROS has it
WORD = re.compile(
    r'(?P<publisher>([0-9a-f]{2}){0,32}) (?P<number>\d{1,20}) (?P<sent>-?\d{1,20}) '
    r'(?P<says>true|false)'
)
STOP_REASON = 'topic stop says true (publish false on it to end that)'


def _received(message: String) -> Received[Bool] | None:
    """Read what was written down; None where it is something else."""
    word = WORD.fullmatch(message.data)
    if word is None:
        return None
    number, sent = int(word['number']), int(word['sent'])
    who = bytes.fromhex(word['publisher'])
    return Received(Bool(data=word['says'] == 'true'), sent, number, who)


class StopTopic:
    """
    Hears std_msgs/Bool of any publisher, whatever its quality of service.

    A best-effort subscription hears everybody; a reliable one loses nothing of those who are
    reliable, and a latched one hears what was said before. A word heard twice counts once.

    A true stops at once. A false only tells that the cause is gone: the arm goes on after a
    `reset`. It does not speak for another publisher: after a false, the cause is gone when
    nobody who is still there has said true last.

    A publisher that speaks and leaves may be gone before all have found it (`ros2 topic pub
    --once` waits for one of them): who has heard it passes it on, on a topic that all keep open.

    Parameters
    ----------
    node : Node
    stop : callable
        Called with why, at every true.
    gone : callable
        Called when the cause is gone.
    services : sequence of Service
        Answered in the thread that hears the topic.

    """

    def __init__(
        self,
        node: Node,
        stop: Callable[[str], None],
        gone: Callable[[], None],
        services: Sequence[Service] = (),
    ) -> None:
        """Subscribe, and wait for words in a thread that does nothing else."""
        self._node, self._stop, self._gone, self._services = node, stop, gone, services
        self.says = False
        self._denied = False  # somebody has said false since the last true
        self._looked = float('-inf')  # [s]
        self._last: dict[bytes, Received[Bool]] = {}  # of every publisher
        self._heard: deque[Received[Bool]] = deque()
        self._passing = node.create_publisher(String, PASSED_ON, COMMAND_ALL)
        self._closed = False
        self._waiting = Waiting(node)
        self._thread = threading.Thread(target=self._listen, name='stop', daemon=True)
        self._thread.start()

    def poll(self) -> None:
        """Act on what was said since the last time, in the thread of the caller."""
        while self._heard:
            word = self._heard.popleft()
            last = self._last.get(word.publisher)
            if last is not None and word.repeats(last):
                continue  # it came by another subscription before
            self._last[word.publisher] = word
            if word.message.data:
                self.says, self._denied = True, False
                self._stop(STOP_REASON)
            elif self.says:
                self._denied = True
                self._look()
        if self.says and self._denied and time.monotonic() - self._looked > VALUES_PERIOD_S:
            self._look()

    def close(self) -> None:
        """Hear no more."""
        self._closed = True
        self._waiting.wake()
        self._thread.join()
        self._waiting.close()

    def _listen(self) -> None:
        """
        Take every word as soon as it comes.

        A word that waits is lost when its publisher leaves: Fast DDS takes it back.
        """
        kinds = LISTEN_ALL, COMMAND_ALL, LATCHED_BY_MANY
        inboxes = [Inbox(self._node, Bool, 'stop', qos) for qos in kinds]
        passed = Inbox(self._node, String, PASSED_ON, COMMAND_ALL)
        told = ''
        while not self._closed:
            for inbox in inboxes:
                for word in inbox.take():
                    self._heard.append(word)
                    says = 'true' if word.message.data else 'false'
                    text = f'{word.publisher.hex()} {word.number} {word.sent} {says}'
                    if text != told:
                        told = text
                        self._passing.publish(String(data=text))
            self._heard += filter(None, (_received(word.message) for word in passed.take()))
            for service in self._services:
                service.serve()
            self._waiting.wait([*inboxes, passed], self._services)
        for inbox in (*inboxes, passed):
            inbox.close()
        for service in self._services:
            service.close()

    def _look(self) -> None:
        """Look whether anybody is there who has not taken back a true."""
        self._looked = time.monotonic()
        known = self._node.get_publishers_info_by_topic('stop')
        there = {bytes(one.endpoint_gid) for one in known}
        self._last = {who: word for who, word in self._last.items() if who in there | {UNTOLD}}
        if not any(word.message.data for word in self._last.values()):
            self.says = False
            self._gone()
