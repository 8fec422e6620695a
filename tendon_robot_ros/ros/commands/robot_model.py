"""
The arm for RViz and Foxglove: its URDF, its joints, and its frames where tf2_ros is installed.

Topics: controller/predicted_shape (subscribed); robot_description (latched), cell_joint_states,
/tf (published). Parameters and units: ros/parameters.yaml.

example: python -m tendon_robot_ros robot-model --ros-args -r __ns:=/left_arm
"""

from __future__ import annotations

import importlib.util
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseArray, TransformStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from ...common.arrays import Floats
from ...robot import Robot, load_robot
from ...robot.urdf import joint_angles, joint_names, transforms, urdf
from ..shared import interface
from ..shared.messages import matrix, quaternion, refilled
from ..shared.parameters import ParameterNode, watch_robot
from ..shared.runtime import run

HELP = 'show RViz and Foxglove the robot: URDF, joints, frames'


class RobotModelNode(ParameterNode):
    """Converts predicted shapes to joints and frames of the URDF."""

    def __init__(self) -> None:
        """Read the robot of the parameter, or request that of the controller."""
        super().__init__('robot_model')
        controller = self.parameters['controller']
        self._robot: Robot | None = None
        self._prefix = ''
        self._description = self.create_publisher(*interface.topic('robot_description'))
        self._joints = self.create_publisher(*interface.topic('cell_joint_states'))
        self._broadcaster: Any = None
        if self.parameters['publish_tf'] and importlib.util.find_spec('tf2_ros') is not None:
            from tf2_ros import TransformBroadcaster

            self._broadcaster = TransformBroadcaster(self)
        else:
            self.get_logger().info('no tf2_ros, or publish_tf is false: frames are not published')
        interface.subscribe(self, 'controller/predicted_shape', self._shape, controller)
        if self.parameters['robot']:
            self._take(load_robot(self.parameters['robot']))
        else:
            watch_robot(self, controller, self._take)

    def _take(self, robot: Robot) -> None:
        """Use a robot, the first one: its cells do not change at run time."""
        if self._robot is None:
            self._robot, self._prefix = robot, f'{self.parameters["frame_prefix"]}{robot.name}_'
            self._description.publish(String(data=urdf(robot, self._prefix)))

    def _shape(self, message: PoseArray) -> None:
        robot = self._robot
        if robot is None or len(message.poses) != robot.cells:
            return
        frames = np.array([matrix(pose.orientation) for pose in message.poses])
        angles = joint_angles(robot, frames)
        stamp = message.header.stamp
        self._joints.publish(refilled(JointState(name=joint_names(robot)), stamp, angles, None))
        if self._broadcaster is not None:
            self._broadcaster.sendTransform(stamped(robot, angles, self._prefix, stamp))


def stamped(robot: Robot, angles: Floats, prefix: str, stamp: object) -> list[TransformStamped]:
    """Return the frames of all links as messages."""
    messages = []
    for parent, child, rotation, up in transforms(robot, angles, prefix):
        message = TransformStamped(child_frame_id=child)
        message.header.frame_id, message.header.stamp = parent, stamp
        message.transform.rotation = quaternion(rotation)
        message.transform.translation.z = up
        messages.append(message)
    return messages


main = partial(run, RobotModelNode)  # until a signal comes
