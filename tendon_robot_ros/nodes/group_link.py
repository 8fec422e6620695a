"""Topics of ros2_control: commands of a group controller, states of the joints."""

from __future__ import annotations

import time
from collections.abc import Mapping

from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from .qos import COMMAND, JOINTS

State = tuple[float, float, float]


class GroupLink:
    """Publishes std_msgs/Float64MultiArray, hears sensor_msgs/JointState."""

    def __init__(self, node: Node, command_topic: str, state_topic: str) -> None:
        """Begin to listen."""
        self._node, self._heard = node, dict[str, State]()
        self._commands = node.create_publisher(Float64MultiArray, command_topic, COMMAND)
        self._states = node.create_subscription(JointState, state_topic, self._hear, JOINTS)

    def send(self, values: list[float]) -> None:
        """Send one value per joint, in the order of the controller."""
        self._commands.publish(Float64MultiArray(data=values))

    def states(self) -> Mapping[str, State]:
        """Return joint -> (monotonic time [s], position, effort), the newest of each."""
        return self._heard

    def close(self) -> None:
        """Stop to listen."""
        self._node.destroy_subscription(self._states)
        self._node.destroy_publisher(self._commands)

    def _hear(self, message: JointState) -> None:
        now, heard = time.monotonic(), dict(self._heard)
        for i, name in enumerate(message.name):
            position = message.position[i] if i < len(message.position) else float('nan')
            effort = message.effort[i] if i < len(message.effort) else float('nan')
            heard[name] = now, position, effort
        self._heard = heard  # the bus thread reads the old one or the new one, never half
