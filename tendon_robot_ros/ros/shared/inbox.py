"""Subscriptions and services that whoever needs them asks, in a thread of its own choice."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.guard_condition import GuardCondition
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_services_default
from rclpy.type_support import check_is_valid_msg_type, check_is_valid_srv_type
from std_msgs.msg import Bool

from .messages import COMMAND, LATCHED_BY_MANY, LISTEN


@dataclass(frozen=True)
class Received[M]:
    """A message, and what the middleware says of it."""

    message: M
    sent: int  # [ns] clock of the publisher
    number: int  # counts the messages of its publisher


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
        self._kind = kind
        check_is_valid_msg_type(kind)
        with node.handle:
            self.handle = _rclpy.Subscription(node.handle, kind, topic, qos.get_c_qos_profile())

    def take(self) -> list[Received[M]]:
        """Give the messages that came since the last time, oldest first."""
        heard = []
        with self.handle:
            while (taken := self.handle.take_message(self._kind, False)) is not None:
                message, info = taken
                number = info['publication_sequence_number']
                heard.append(Received(message, info['source_timestamp'], number))
        return heard

    def close(self) -> None:
        """Unsubscribe."""
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
# The topic `stop`: whoever says true stops the arm; who may say that the cause is gone.

LATCHED_WAIT_S = 0.3  # [s] latched words of others take a few milliseconds to come again
STOP_REASON = 'topic stop says true (publish false on it to end that)'


class StopTopic:
    """
    Hears std_msgs/Bool of any publisher, whatever its quality of service.

    A best-effort subscription hears everybody; a reliable one loses nothing of those who are
    reliable, and a latched one hears what was said before. The same word heard twice does no harm.

    A true stops at once. A false only tells that the cause is gone: the arm goes on after a
    `reset`. While there are several publishers, one of them saying false does not speak for the
    others: the latched words of all are asked for again, and the cause is gone when none of them
    says true.

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
        self._asked = float('nan')  # [s] when the latched words were asked for again
        self._words: list[Received[Bool]] = []  # the latched ones that came since
        self._heard: deque[tuple[bool, Received[Bool]]] = deque()
        self._again = self._closed = False
        self._waiting = Waiting(node)
        self._thread = threading.Thread(target=self._listen, name='stop', daemon=True)
        self._thread.start()

    def poll(self) -> None:
        """Act on what was said since the last time, in the thread of the caller."""
        while self._heard:
            latched, word = self._heard.popleft()
            if latched and self._asking:
                self._words.append(word)
            else:
                self._take(word.message.data)
        if self._asking and time.monotonic() - self._asked > LATCHED_WAIT_S:
            self._conclude()

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
        volatile = [Inbox(self._node, Bool, 'stop', qos) for qos in (LISTEN, COMMAND)]
        latched = Inbox(self._node, Bool, 'stop', LATCHED_BY_MANY)
        while not self._closed:
            for inbox in (*volatile, latched):
                self._heard += [(inbox is latched, word) for word in inbox.take()]
            if self._again:
                latched.close()
                latched = Inbox(self._node, Bool, 'stop', LATCHED_BY_MANY)
                self._again = False
            for service in self._services:
                service.serve()
            self._waiting.wait([*volatile, latched], self._services)
        for inbox in (*volatile, latched):
            inbox.close()
        for service in self._services:
            service.close()

    @property
    def _asking(self) -> bool:
        return self._asked == self._asked

    @property
    def _publishers(self) -> int:
        return int(self._node.count_publishers('stop'))

    def _take(self, says: bool) -> None:
        if says:
            self._say_stop()
        elif self.says and not self._asking:
            if self._publishers > 1:
                self._ask()
            else:
                self._say_gone()

    def _ask(self) -> None:
        """Have the publishers that are still there repeat their last latched word."""
        self._asked, self._words = time.monotonic(), []
        self._again = True
        self._waiting.wake()

    def _conclude(self) -> None:
        self._asked = float('nan')
        if any(word.message.data for word in self._last_words()):
            self._say_stop()
        else:
            self._say_gone()

    def _last_words(self) -> list[Received[Bool]]:
        """Leave out what its publisher took back, where one kept more than its last word."""
        if len(self._words) <= self._publishers:
            return self._words
        numbers = {(word.number, word.message.data) for word in self._words}
        return [word for word in self._words if (word.number + 1, False) not in numbers]

    def _say_stop(self) -> None:
        self.says, self._asked = True, float('nan')
        self._stop(STOP_REASON)

    def _say_gone(self) -> None:
        self.says = False
        self._gone()
