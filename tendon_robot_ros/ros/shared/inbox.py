"""
Subscriptions and services that are polled, from a thread of the caller's choice.

Every message comes with the gid of its publisher (rmw: globally unique identifier). rclpy drops
it; the C library below does not.
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
from std_srvs.srv import Trigger

from ...control.inputs import Refusal
from . import interface
from .messages import passing_subscription
from .timing import SILENCE_S, VALUES_PERIOD_S

# [B] of a message that is parsed between commands: measured, 10 MB take seconds
MESSAGE_BYTES_MAX = 250_000
# [B] behind each structure, because a newer library may write a longer one
SPARE_BYTES = 256


@dataclass(frozen=True)
class Received[M]:
    """A message and its metadata from the middleware."""

    message: M
    sent: int  # [ns] clock of the publisher
    number: int  # sequence number of its publisher; 0 where the middleware has none
    publisher: bytes  # gid, as `endpoint_gid` of rclpy's endpoint information

    def repeats(self, last: Received[M]) -> bool:
        """Return whether it is no newer than the last message of the same publisher."""
        if self.number:
            return self.number <= last.number
        return self.sent == last.sent


class _Allocator(ctypes.Structure):
    """rcutils_allocator_t."""

    _fields_ = tuple(
        (name, ctypes.c_void_p) for name in ('give', 'take', 'change', 'zero', 'state')
    )


def structure(name: str, **fields: Any) -> type[ctypes.Structure]:
    """Return a structure of C with these fields in their order, and spare bytes behind them."""
    content = [*fields.items(), ('spare', ctypes.c_uint8 * SPARE_BYTES)]
    return type(name, (ctypes.Structure,), {'_fields_': content})


Gid = ctypes.c_uint8 * 16  # of a publisher: rmw/types.h
_Bytes = structure(
    'rcutils_uint8_array_t',
    buffer=ctypes.c_void_p,
    length=ctypes.c_size_t,
    capacity=ctypes.c_size_t,
    allocator=_Allocator,
)
_Info = structure(
    'rmw_message_info_t',
    sent=ctypes.c_int64,
    received=ctypes.c_int64,
    number=ctypes.c_int64,  # -1 where the middleware does not count: rmw/types.h
    received_number=ctypes.c_int64,
    middleware=ctypes.c_char_p,
    publisher=Gid,
)


def polled(node: Node, kind: type, topic: str, qos: QoSProfile) -> Any:
    """Subscribe to a topic; return the handle, from which the caller takes the messages."""
    check_is_valid_msg_type(kind)
    with node.handle:
        return _rclpy.Subscription(node.handle, kind, topic, qos.get_c_qos_profile())


class Inbox[M]:
    """
    A subscription that is polled.

    A callback of an executor waits for all its other callbacks. Commands, states and stops must
    not wait: the thread that needs them polls them once per cycle, and no message wakes a thread.
    The executor of a node serves all subscriptions of rclpy; this class holds the handle inside
    such a subscription instead. Publishers with an incompatible quality of service are ignored
    silently: the same topic may have another inbox for them.
    """

    def __init__(self, node: Node, kind: type[M], topic: str, qos: QoSProfile) -> None:
        """Subscribe."""
        self._topic, self._kind = topic, kind
        self._refusal: Refusal | None = None  # of the last message that could not be read
        self.handle = polled(node, kind, topic, qos)
        self._info = _Info()  # of the last message
        self._take_bytes = ctypes.CDLL('librcl.so').rcl_take_serialized_message
        utilities = ctypes.CDLL('librcutils.so')
        self._free = utilities.rcutils_uint8_array_fini
        allocator = utilities.rcutils_get_default_allocator
        allocator.restype = _Allocator
        self._bytes = _Bytes(allocator=allocator())
        with self.handle:
            pointer = ctypes.c_void_p(self.handle.pointer)
        self._arguments = pointer, ctypes.byref(self._bytes), ctypes.byref(self._info), None

    def take(self) -> list[Received[M]]:
        """Return the valid messages since the last call, oldest first."""
        messages: list[Received[M]] = []
        with self.handle:
            while not self._take_bytes(*self._arguments):  # it fails when there is none
                data = ctypes.string_at(self._bytes.buffer, self._bytes.length)
                message = _read(data, self._kind, self._topic)
                if isinstance(message, Refusal):
                    self._refusal = message
                    continue
                info = self._info
                gid = bytes(info.publisher)
                messages.append(Received(message, info.sent, max(info.number, 0), gid))
        return messages

    def refused(self) -> Refusal | None:
        """Return why a message since the last call was invalid, None for none."""
        refusal, self._refusal = self._refusal, None
        return refusal

    def close(self) -> None:
        """Unsubscribe."""
        self._free(ctypes.byref(self._bytes))
        self.handle.destroy_when_not_in_use()


def _read[M](data: bytes, kind: type[M], what: str) -> M | Refusal:
    """Return the message in bytes, or why they are none."""
    name, size = kind.__name__, len(data)
    problem = f'{what}: expected at most {MESSAGE_BYTES_MAX:,} bytes, got {size:,}'
    if size <= MESSAGE_BYTES_MAX:
        try:
            return deserialize_message(data, kind)
        except _rclpy.RMWError:
            problem = f'{what}: expected a message {name}, got {size:,} bytes that are none'
    return Refusal('length', problem)


Answer = Callable[[bool, str], None]


class Service:
    """
    A Trigger service that is served by `serve`, independently of the executor of its node.

    Parameters
    ----------
    answer : callable
        Called at a request, with a function that sends success and message, at once or later.

    """

    def __init__(self, node: Node, name: str, answer: Callable[[Answer], object]) -> None:
        """Offer the service."""
        self._answer = answer
        check_is_valid_srv_type(Trigger)
        with node.handle:
            qos = qos_profile_services_default.get_c_qos_profile()
            self.handle = _rclpy.Service(node.handle, Trigger, name, qos)

    def serve(self) -> None:
        """Answer the requests since the last call."""
        while True:
            with self.handle:
                _, header = self.handle.service_take_request(Trigger.Request)
            if header is None:
                return
            self._answer(partial(self._send, header.request_id))

    def _send(self, request_id: Any, success: bool, message: str) -> None:
        """Send a response, unless the client or this service has been destroyed."""
        response = Trigger.Response(success=success, message=message)
        with contextlib.suppress(_rclpy.RCLError, _rclpy.InvalidHandle), self.handle:
            self.handle.service_send_response(response, request_id)

    def close(self) -> None:
        """Destroy the service."""
        self.handle.destroy_when_not_in_use()


def subscribe_any_qos[M](
    node: Node, kind: type[M], topic: str, handle: Callable[[M | Refusal], None]
) -> list[Subscription]:
    """
    Subscribe to publishers of any quality of service; return the subscriptions.

    A best-effort subscription matches all publishers, a reliable one loses no message of those
    that are reliable; a message that arrives by both is handled once. In place of a message that
    is too long to be parsed between commands, its refusal is handled.
    """
    # compared by their bytes, because the executor of events of rclpy 7.1.6 fails where a callback
    # takes the sequence number, too
    waiting: deque[tuple[float, int, bytes]] = deque()

    def receive(message: bytes, path: int) -> None:
        now = time.monotonic()
        while waiting and now - waiting[0][0] > SILENCE_S:
            waiting.popleft()
        same = next((one for one in waiting if one[1:] == (1 - path, message)), None)
        if same is not None:
            waiting.remove(same)
            return
        waiting.append((now, path, message))
        handle(_read(message, kind, topic.removeprefix('~/')))

    return [
        passing_subscription(node, kind, topic, partial(receive, path=path), qos, raw=True)
        for path, qos in enumerate((interface.COMMAND, interface.LISTEN))
    ]


FORWARDED = '_stop_heard'  # a hidden topic: its name begins with _
FORWARDED_MESSAGE = re.compile(
    r'(?P<publisher>([0-9a-f]{2}){0,32}) (?P<number>\d{1,20}) (?P<sent>-?\d{1,20}) '
    r'(?P<value>true|false)'
)


def _parse_forwarded(message: String) -> Received[Bool] | None:
    """Parse a forwarded message; None where the text is invalid."""
    match = FORWARDED_MESSAGE.fullmatch(message.data)
    if match is None:
        return None
    number, sent = int(match['number']), int(match['sent'])
    gid = bytes.fromhex(match['publisher'])
    return Received(Bool(data=match['value'] == 'true'), sent, number, gid)


class StopTopic:
    """
    Receives std_msgs/Bool of the topic `stop` from publishers of any quality of service.

    A best-effort subscription matches all publishers; a reliable one loses no message of those
    that are reliable, and a latched one receives earlier messages, too. A message that arrives
    twice counts once.

    A true stops at once. A false only clears the cause: the arm goes on after a `reset`. It does
    not count for another publisher: after a false, the cause is cleared when no publisher that
    still exists has sent true last.

    A publisher that sends and leaves may be gone before all nodes have discovered it (`ros2 topic
    pub --once` waits for one of them): a node that has received the message forwards it, on a
    topic that all nodes keep open.

    Parameters
    ----------
    node : Node
    stop : callable
        Called at every true.
    cleared : callable
        Called when the cause is cleared.
    *services : Service
        Answered in the thread that receives the topic.

    """

    def __init__(
        self, node: Node, stop: Callable[[], None], cleared: Callable[[], None], *services: Service
    ) -> None:
        """Subscribe, and receive messages in a thread of its own."""
        self._node, self._stop, self._cleared, self._services = node, stop, cleared, services
        self.active = False
        self._denied = False  # a false was received since the last true
        self._checked_at = float('-inf')  # [s]
        self._last: dict[bytes, Received[Bool]] = {}  # message of every publisher
        self._queue: deque[Received[Bool]] = deque()
        self._forwarding = node.create_publisher(String, FORWARDED, interface.COMMAND_ALL)
        self._closed = False
        self._closing = GuardCondition(None, None, node.context)
        self._thread = threading.Thread(target=self._listen, name='stop', daemon=True)
        self._thread.start()

    def poll(self) -> None:
        """Act on the messages since the last call, in the thread of the caller."""
        while self._queue:
            received = self._queue.popleft()
            last = self._last.get(received.publisher)
            if last is not None and received.repeats(last):
                continue  # another subscription has received it before
            self._last[received.publisher] = received
            if received.message.data:
                self.active, self._denied = True, False
                self._stop()
            elif self.active:
                self._denied = True
                self._check_publishers()
        if self.active and self._denied and time.monotonic() - self._checked_at > VALUES_PERIOD_S:
            self._check_publishers()

    def close(self) -> None:
        """End the thread and destroy the subscriptions."""
        self._closed = True
        self._closing.trigger()
        self._thread.join()
        self._closing.destroy()

    def _listen(self) -> None:
        """
        Take every message as soon as it arrives.

        Fast DDS drops a message that was not taken when its publisher leaves.
        """
        kinds = interface.LISTEN_ALL, interface.COMMAND_ALL, interface.LATCHED_BY_MANY
        inboxes = [Inbox(self._node, *interface.topic('stop')[:2], qos) for qos in kinds]
        forwarded = Inbox(self._node, String, FORWARDED, interface.COMMAND_ALL)
        last_text = ''
        while not self._closed:
            for inbox in inboxes:
                for received in inbox.take():
                    self._queue.append(received)
                    value = 'true' if received.message.data else 'false'
                    text = f'{received.publisher.hex()} {received.number} {received.sent} {value}'
                    if text != last_text:
                        last_text = text
                        self._forwarding.publish(String(data=text))
            parsed = (_parse_forwarded(received.message) for received in forwarded.take())
            self._queue += filter(None, parsed)
            for service in self._services:
                service.serve()
            self._wait([*inboxes, forwarded])
        for inbox in (*inboxes, forwarded):
            inbox.close()
        for service in self._services:
            service.close()

    def _wait(self, inboxes: Sequence[Inbox[Any]]) -> None:
        """Block until a message, a request or the end has come."""
        services, context = self._services, self._node.context.handle
        waits = _rclpy.WaitSet(len(inboxes), 1, 0, 0, len(services), 0, context)
        with waits:
            waits.clear_entities()
            for inbox in inboxes:
                waits.add_subscription(inbox.handle)
            for service in services:
                waits.add_service(service.handle)
            waits.add_guard_condition(self._closing.handle)
            waits.wait(-1)

    def _check_publishers(self) -> None:
        """Clear the cause unless an existing publisher has sent true last."""
        self._checked_at = time.monotonic()
        known = self._node.get_publishers_info_by_topic('stop')
        existing = {bytes(one.endpoint_gid) for one in known}
        self._last = {gid: last for gid, last in self._last.items() if gid in existing}
        if not any(last.message.data for last in self._last.values()):
            self.active = False
            self._cleared()
