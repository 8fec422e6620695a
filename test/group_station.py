"""A controller_manager as the tests see it: a group controller and a joint_state_broadcaster."""

import numpy as np
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

JOINTS = ('motor_1', 'motor_2', 'motor_3', 'motor_4')
STIFFNESS = 0.05  # [N·m/rad] of the spring behind every motor
LAG = 0.3  # share of the way to a command per cycle


class Group:
    """Behaves as JointGroupEffortController or JointGroupPositionController over springs."""

    def __init__(self, node, mode):
        self.node, self.mode, self.alive = node, mode, True
        self.command = np.zeros(4) if mode == 'tension' else None
        self.position, self.effort = np.zeros(4), np.zeros(4)
        self.refused, self.received = 0, []
        kind = 'effort' if mode == 'tension' else 'position'
        node.create_subscription(
            Float64MultiArray, f'/tendon_{kind}_controller/commands', self._hear, 10
        )
        self._states = node.create_publisher(JointState, '/joint_states', QoSProfile(depth=10))
        self._timer = node.create_timer(0.01, self._cycle)

    def _hear(self, message):
        if len(message.data) != len(JOINTS):  # as the real one: dropped with an error in the log
            self.refused += 1
            return
        self.command = np.array(message.data)
        self.received.append(self.command)

    def _cycle(self):
        if self.command is not None:
            if self.mode == 'tension':
                self.effort = self.effort + LAG * (self.command - self.effort)
                self.position = self.effort / STIFFNESS
            else:
                self.position = self.position + LAG * (self.command - self.position)
                self.effort = np.maximum(self.position * STIFFNESS, 0.0)
        if not self.alive:
            return
        order = [2, 0, 3, 1]  # the broadcaster sorts as it likes, and has other joints, too
        message = JointState(name=['gripper', *(JOINTS[i] for i in order)])
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.position = [0.5, *self.position[order].tolist()]
        message.velocity = [0.0] * 5
        message.effort = [float('nan'), *self.effort[order].tolist()]
        self._states.publish(message)
