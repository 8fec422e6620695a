"""Stop every node that can be stopped, by the services and topics of all namespaces."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field

from rclpy.client import Client
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rclpy.task import Future
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from ...common.local_stop import Stoppable
from ...common.processes import go_realtime
from .interface import LATCHED
from .runtime import ClientNode, ros
from .timing import NEWS_PERIOD_S, STOP_ANSWER_S

TRIGGER, BOOL = 'std_srvs/srv/Trigger', 'std_msgs/msg/Bool'
STATUS = 'diagnostic_msgs/msg/DiagnosticStatus'
# [s] for all nodes to be discovered and to answer (docs/safety.md): on a busy machine some are
# discovered a second after others
STOP_S = 2.0


def stop_nodes(
    ros_arguments: Sequence[str], below: str, local: Mapping[Stoppable, bool]
) -> dict[str, tuple[bool, str]]:
    """
    Stop every node that is discovered, and add the results of the local stop.

    Parameters
    ----------
    ros_arguments : sequence of str
    below : str
        Namespace; only nodes in it or below it are stopped.
    local : mapping
        Node stopped without ROS -> whether it has confirmed the stop.

    Returns
    -------
    dict
        Name of a node -> whether it drives motors, and why it has not stopped ('': it has).

    """
    with ros(ros_arguments), StopClient(below) as client:
        go_realtime()  # discovery, too, on a busy machine
        results = client.stop({who.node for who, stopped in local.items() if stopped})
    for who, stopped in local.items():
        _, why = results.get(who.node, (who.drives, NO_ANSWER))
        results[who.node] = who.drives, '' if stopped else why
    return results


NO_ANSWER = 'does not answer'


@dataclass
class Stopping:
    """A node that can be stopped, and its answers."""

    client: Client
    drives: bool  # whether it drives motors
    requested_at: float = float('-inf')  # [s] when it was last called
    futures: list[Future] = field(default_factory=list)

    @property
    def why(self) -> str:
        """Why it has not stopped, '' if it has confirmed the stop."""
        answers = [future.result() for future in self.futures if future.done()]
        if any(answer.success for answer in answers):
            return ''
        return f'refuses: {answers[-1].message}' if answers else NO_ANSWER

    def ask(self, now: float) -> None:
        """Call its service; repeat the call when the answer is overdue."""
        if self.why and now - self.requested_at > STOP_ANSWER_S and self.client.service_is_ready():
            self.requested_at = now
            self.futures.append(self.client.call_async(Trigger.Request()))


class StopClient(ClientNode):
    """Discovers the nodes that can be stopped, and stops them."""

    def __init__(self, below: str) -> None:
        """Create the node."""
        name = f'stop_{os.getpid()}'
        super().__init__(name, start_parameter_services=False, enable_rosout=False)
        self._below = below.rstrip('/') + '/'
        self._targets: dict[str, Stopping] = {}
        self._topics: dict[str, Publisher] = {}
        self._subscribers: dict[str, int] = {}  # topic -> subscriptions at the last message
        self._began = time.monotonic()

    def stop(self, stopped: Set[str]) -> dict[str, tuple[bool, str]]:
        """
        Stop nodes as soon as they are discovered, for `STOP_S`; `stopped` have confirmed.

        Returns
        -------
        dict
            As of `stop_nodes`.

        """
        while (now := time.monotonic()) - self._began < STOP_S - STOP_ANSWER_S:
            self._discover()
            for one in self._targets.values():
                one.ask(now)
            for topic, publisher in self._topics.items():
                count = publisher.get_subscription_count()
                if count > self._subscribers.get(topic, 0):  # there is a new subscription
                    publisher.publish(Bool(data=True))
                self._subscribers[topic] = count
            self.serve(NEWS_PERIOD_S)
        if not any(one.why for name, one in self._targets.items() if name not in stopped):
            # the services have latched the stop: a false clears the cause of the topic
            for topic, publisher in self._topics.items():
                if self._subscribers.get(topic):
                    publisher.publish(Bool(data=False))
            for publisher in self._topics.values():  # else it is lost with its publisher
                publisher.wait_for_all_acked(Duration(seconds=STOP_ANSWER_S))
        return {name: (one.drives, one.why) for name, one in self._targets.items()}

    def _discover(self) -> None:
        """Discover nodes with the services stop and reset and a status."""
        services = {n for n, kinds in self.get_service_names_and_types() if TRIGGER in kinds}
        topics = dict(self.get_topic_names_and_types())
        for service in services:
            name = service.removesuffix('/stop')
            if name in self._targets or name == service or not service.startswith(self._below):
                continue
            if f'{name}/reset' in services and STATUS in topics.get(f'{name}/status', []):
                client = self.create_client(Trigger, service)
                self._targets[name] = Stopping(client, f'{name}/reboot' in services)
        for name in self._targets:
            for topic in self._stop_topics(name):
                if topic not in self._topics:
                    self._topics[topic] = self.create_publisher(Bool, topic, LATCHED)

    def _stop_topics(self, name: str) -> list[str]:
        """Return the topic `stop` in the namespace of a node, and remapped ones."""
        space, _, node = name.rpartition('/')
        topics = [f'{space}/stop']
        try:
            own = self.get_subscriber_names_and_types_by_node(node, space or '/')
        except Exception:  # rclpy: its name is not known yet, or no longer
            own = []
        return topics + [topic for topic, kinds in own if BOOL in kinds and topic not in topics]
