"""Subscriptions and services that whoever needs them asks, in a thread of its own choice."""

from __future__ import annotations

import contextlib
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
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
from .senders import MESSAGE_BYTES_MAX, UNTOLD, Received, Taker, too_long, unreadable


class Inbox[M]:
    """
    Takes messages when it is asked.

    What an executor calls waits for everything else that the executor calls. Commands, states and
    stops do not: the thread that needs them takes them, once per cycle, and no message wakes
    anybody. rclpy's own subscriptions cannot be kept from the executor of their node; this one has
    what is inside them. Publishers of another quality of service are passed over silently: the
    same topic may have another inbox for them.
    """

    def __init__(
        self, node: Node, kind: type, topic: str, qos: QoSProfile, read: Callable[[bytes], M]
    ) -> None:
        """Subscribe; `read` makes of bytes what is taken."""
        check_is_valid_msg_type(kind)
        self.topic = topic
        with node.handle:
            self.handle = _rclpy.Subscription(node.handle, kind, topic, qos.get_c_qos_profile())
        self._take = Taker(self.handle, kind, read)

    def take(self) -> list[Received[M]]:
        """Give the messages that came since the last time, oldest first, that can be read."""
        with self.handle:
            return list(iter(self._take, None))

    def refused(self) -> str:
        """Say why a message since the last time was not read, '' for none."""
        problem, self._take.refused = self._take.refused, ''
        return problem and f'{self.topic}: {problem}'

    def close(self) -> None:
        """Unsubscribe."""
        self._take.close()
        self.handle.destroy_when_not_in_use()


class Service:
    """A service that answers when it is asked to, whatever its node's executor is doing."""

    def __init__(
        self, node: Node, kind: Any, name: str, answer: Callable[[Any, Any], Any]
    ) -> None:
        """Offer the service; `answer` gets request and response, and returns the response."""
        self._kind, self._answer = kind, answer
        check_is_valid_srv_type(kind)
        with node.handle:
            qos = qos_profile_services_default.get_c_qos_profile()
            self.handle = _rclpy.Service(node.handle, kind, name, qos)

    def serve(self) -> None:
        """Answer the requests that came since the last time."""
        while True:
            with self.handle:
                request, header = self.handle.service_take_request(self._kind.Request)
                if header is None:
                    return
                response = self._answer(request, self._kind.Response())
                with contextlib.suppress(_rclpy.RCLError):  # who asked has gone
                    self.handle.service_send_response(response, header.request_id)

    def close(self) -> None:
        """Offer it no more."""
        self.handle.destroy_when_not_in_use()


class LateService(Service):
    """A service whose answer comes when it is known: `answer` gets request and how to send it."""

    def serve(self) -> None:
        """Hand on the requests that came since the last time."""
        while True:
            with self.handle:
                request, header = self.handle.service_take_request(self._kind.Request)
            if header is None:
                return
            self._answer(request, partial(self._send, header.request_id))

    def _send(self, request_id: Any, response: Any) -> None:
        with contextlib.suppress(_rclpy.RCLError, _rclpy.InvalidHandle), self.handle:
            self.handle.service_send_response(response, request_id)


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


# -----------------------------------------------------------------------------
# Messages of any publisher by the executor of a node.

PAIR_S = 1.0  # [s] in which the same message comes by both ways


def hear_anybody[M](
    node: Node,
    kind: type[M],
    topic: str,
    hear: Callable[[M], None],
    refuse: Callable[[str], None],
) -> list[Subscription]:
    """
    Subscribe to publishers of any quality of service; return the subscriptions.

    A best-effort subscription hears everybody, a reliable one loses nothing of who is reliable;
    what comes by both is heard once. What is too long to be read beside the commands is refused.
    """
    waiting: tuple[deque[tuple[float, bytes]], deque[tuple[float, bytes]]] = deque(), deque()

    def come(message: bytes, way: int) -> None:
        now, own, other = time.monotonic(), waiting[way], waiting[1 - way]
        for queue in waiting:
            while queue and now - queue[0][0] > PAIR_S:
                queue.popleft()
        same = next((pair for pair in other if pair[1] == message), None)
        if same is not None:
            other.remove(same)
            return
        own.append((now, message))
        what = topic.removeprefix('~/')
        if len(message) > MESSAGE_BYTES_MAX:
            refuse(f'{what}: {too_long(len(message))}')
            return
        try:
            read = deserialize_message(message, kind)
        except _rclpy.RMWError:
            refuse(f'{what}: {unreadable(kind, len(message))}')
        else:
            hear(read)

    return [
        passing_subscription(node, kind, topic, partial(come, way=way), qos, raw=True)
        for way, qos in enumerate((COMMAND, LISTEN))
    ]


# -----------------------------------------------------------------------------
# The topic `stop`: whoever says true stops the arm; who may say that the cause is gone.

LOOK_PERIOD_S = 0.2  # [s] after which it is looked again whether who said true is still there
PASSED_ON = '_stop_heard'  # hidden, as ROS has it
WORD = re.compile(
    r'(?P<publisher>([0-9a-f]{2}){0,32}) (?P<number>\d{1,20}) (?P<sent>-?\d{1,20}) '
    r'(?P<says>true|false)'
)
STOP_REASON = 'topic stop says true (publish false on it to end that)'


def _passed(word: Received[Bool]) -> String:
    """Write down a word and whose it is."""
    says = 'true' if word.message.data else 'false'
    return String(data=f'{word.publisher.hex()} {word.number} {word.sent} {says}')


def _received(message: String) -> Received[Bool] | None:
    """Read what was written down; None where it is something else."""
    found = WORD.fullmatch(message.data)
    if found is None:
        return None
    number, sent = int(found['number']), int(found['sent'])
    who = bytes.fromhex(found['publisher'])
    return Received(Bool(data=found['says'] == 'true'), sent, number, who)


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
            self._take(self._heard.popleft())
        if self.says and self._denied and time.monotonic() - self._looked > LOOK_PERIOD_S:
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
        read, read_text = (partial(deserialize_message, message_type=m) for m in (Bool, String))
        inboxes = [Inbox(self._node, Bool, 'stop', qos, read) for qos in kinds]
        passed = Inbox(self._node, String, PASSED_ON, COMMAND_ALL, read_text)
        told = String()
        while not self._closed:
            for inbox in inboxes:
                for word in inbox.take():
                    self._heard.append(word)
                    before, told = told, _passed(word)
                    if told != before:
                        self._passing.publish(told)
            self._heard += filter(None, (_received(told.message) for told in passed.take()))
            for service in self._services:
                service.serve()
            self._waiting.wait([*inboxes, passed], self._services)
        for inbox in (*inboxes, passed):
            inbox.close()
        for service in self._services:
            service.close()

    def _take(self, word: Received[Bool]) -> None:
        last = self._last.get(word.publisher)
        if last is not None and word.repeats(last):
            return  # it came by another way before
        self._last[word.publisher] = word
        if word.message.data:
            self.says, self._denied = True, False
            self._stop(STOP_REASON)
        elif self.says:
            self._denied = True
            self._look()

    def _look(self) -> None:
        """Look whether anybody is there who has not taken back a true."""
        self._looked = time.monotonic()
        known = self._node.get_publishers_info_by_topic('stop')
        there = {bytes(one.endpoint_gid) for one in known}
        self._last = {who: word for who, word in self._last.items() if who in there | {UNTOLD}}
        if not any(word.message.data for word in self._last.values()):
            self.says = False
            self._gone()
