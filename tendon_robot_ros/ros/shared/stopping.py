"""Stopping every node that can be stopped, through ROS: services and topics of all namespaces."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field

from rclpy.client import Client
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from ...common.local_stop import Stoppable
from ...common.processes import go_realtime
from .runtime import ros
from .timing import NEWS_PERIOD_S, STOP_ANSWER_S

# [1] the last message, also for who comes later: matches subscribers of every kind, without a
# warning; not from messages.py, because that takes 0.9 s to import (measured)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TRIGGER, BOOL = 'std_srvs/srv/Trigger', 'std_msgs/msg/Bool'
STATUS = 'diagnostic_msgs/msg/DiagnosticStatus'
# [s] for all to be found and to answer, as docs/safety.md says: on a busy machine some are found a
# second after others
STOP_S = 2.0
# [s] of that for all who hear the topic to acknowledge that the cause is gone, so that no false is
# lost when its publisher leaves: forty cycles at the default rate
ACKNOWLEDGE_S = 0.1 * STOP_S


def stop_found(
    ros_arguments: Sequence[str], below: str, local: Mapping[Stoppable, bool]
) -> dict[str, tuple[bool, str]]:
    """
    Stop all that is found, besides what was stopped past ROS.

    Parameters
    ----------
    ros_arguments : sequence of str
    below : str
        Namespace: only nodes in it and below it.
    local : mapping
        Who was told past ROS, and whether it has said that it is stopped.

    Returns
    -------
    dict
        Of every node, whether it drives motors, and why it has not stopped, '' if it has.

    """
    with ros(ros_arguments):
        person = Person(below)
        go_realtime()  # discovery, too, on a busy machine
        try:
            person.stop({who.node for who, stopped in local.items() if stopped})
            found = person.said()
        finally:
            person.close()
    for who, stopped in local.items():
        _, why = found.get(who.node, (who.drives, NO_ANSWER))
        found[who.node] = who.drives, '' if stopped else why
    return found


NO_ANSWER = 'does not answer'


@dataclass
class Stopping:
    """A node that can be stopped, and what it has said to it."""

    client: Client
    drives: bool  # motors
    asked: float = float('-inf')  # [s]
    futures: list[Future] = field(default_factory=list)

    @property
    def why(self) -> str:
        """Why it has not stopped, '' if it has said so."""
        answers = [future.result() for future in self.futures if future.done()]
        if any(answer.success for answer in answers):
            return ''
        return f'refuses: {answers[-1].message}' if answers else NO_ANSWER

    def ask(self, now: float) -> None:
        """Call its service, again where the answer is overdue."""
        if self.why and now - self.asked > STOP_ANSWER_S and self.client.service_is_ready():
            self.asked = now
            self.futures.append(self.client.call_async(Trigger.Request()))


class Person(Node):
    """Finds what can be stopped, and stops it."""

    def __init__(self, below: str) -> None:
        """Join the network."""
        name = f'stop_{os.getpid()}'
        super().__init__(name, start_parameter_services=False, enable_rosout=False)
        self._below = below.rstrip('/') + '/'
        self._found: dict[str, Stopping] = {}
        self._topics: dict[str, Publisher] = {}
        self._heard: dict[str, int] = {}  # topic -> how many listened when it was last said
        self._began = time.monotonic()
        self._spinning = SingleThreadedExecutor()
        self._spinning.add_node(self)

    def stop(self, stopped: Set[str]) -> None:
        """Stop what is found as soon as it is found, until the time is over; some have said so."""
        while (now := time.monotonic()) - self._began < STOP_S - ACKNOWLEDGE_S:
            self._look()
            for one in self._found.values():
                one.ask(now)
            for topic, publisher in self._topics.items():
                count = publisher.get_subscription_count()
                if count > self._heard.get(topic, 0):  # somebody new listens
                    publisher.publish(Bool(data=True))
                self._heard[topic] = count
            self._spinning.spin_once(timeout_sec=NEWS_PERIOD_S)
        if not any(one.why for name, one in self._found.items() if name not in stopped):
            # the services have latched the stop: the cause is gone, as the topics say then
            for topic, publisher in self._topics.items():
                if self._heard.get(topic):
                    publisher.publish(Bool(data=False))
            for publisher in self._topics.values():
                publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_S))

    def said(self) -> dict[str, tuple[bool, str]]:
        """Return of every node whether it drives, and why it has not stopped."""
        return {name: (one.drives, one.why) for name, one in self._found.items()}

    def close(self) -> None:
        """Leave."""
        self._spinning.shutdown()
        self.destroy_node()

    def _look(self) -> None:
        """Look for nodes with services stop and reset and a status."""
        services = {n for n, kinds in self.get_service_names_and_types() if TRIGGER in kinds}
        topics = dict(self.get_topic_names_and_types())
        for service in services:
            name = service.removesuffix('/stop')
            if name in self._found or name == service or not service.startswith(self._below):
                continue
            if f'{name}/reset' in services and STATUS in topics.get(f'{name}/status', []):
                client = self.create_client(Trigger, service)
                self._found[name] = Stopping(client, f'{name}/reboot' in services)
        for name in self._found:
            for topic in self._stop_topics(name):
                if topic not in self._topics:
                    self._topics[topic] = self.create_publisher(Bool, topic, LATCHED)

    def _stop_topics(self, name: str) -> list[str]:
        """Return the topic `stop` beside a node, and those of its own that are remapped."""
        space, _, node = name.rpartition('/')
        topics = [f'{space}/stop']
        try:
            heard = self.get_subscriber_names_and_types_by_node(node, space or '/')
        except Exception:  # rclpy: its name is not known yet, or no longer
            heard = []
        return topics + [topic for topic, kinds in heard if BOOL in kinds and topic not in topics]
