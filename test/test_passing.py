"""Topics that come and go while a node goes on."""

import time

import processes
import pytest

pytest.importorskip('rclpy')

import rclpy
import ros_station  # noqa: F401  (prepares the environment for rclpy)
from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from tendon_robot_ros.ros.shared.inbox import subscribe_any_qos
from tendon_robot_ros.ros.shared.interface import COMMAND, LISTEN
from tendon_robot_ros.ros.shared.messages import passing_publisher, passing_subscription
from tendon_robot_ros.ros.shared.runtime import make_executor

pytestmark = pytest.mark.ros
TOPICS = 'target', 'twist'


def test_what_is_destroyed_while_an_event_of_the_middleware_waits_ends_nobody():
    """As when a model is unloaded that somebody asked for with another quality of service."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    executor, node, person = make_executor(), Node('node'), Node('person')
    executor.add_node(node)
    for _ in range(3):
        ears = [
            *subscribe_any_qos(node, PointStamped, 'target', print),
            passing_subscription(node, PointStamped, 'twist', print, COMMAND),
        ]
        said = passing_publisher(node, PointStamped, 'tip', LISTEN)
        others = [person.create_publisher(PointStamped, name, LISTEN) for name in TOPICS]
        asked = person.create_subscription(PointStamped, 'tip', print, COMMAND)
        processes.until(lambda: all(map(node.count_publishers, TOPICS)))
        time.sleep(0.2)  # what the middleware says of it comes by another way

        def gone(ears=ears, said=said):
            for ear in ears:
                node.destroy_subscription(ear)
            node.destroy_publisher(said)

        executor.create_task(gone)
        for _ in range(20):
            executor.spin_once(timeout_sec=0.01)
        for other in others:
            person.destroy_publisher(other)
        person.destroy_subscription(asked)
    executor.remove_node(node)
    executor.shutdown(timeout_sec=1.0)
    node.destroy_node()
    person.destroy_node()
