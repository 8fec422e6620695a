"""What the monitor publishes for every frame of the tracker."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import PoseArray, Vector3, Vector3Stamped
from rclpy.node import Node
from std_msgs.msg import Float64, Float64MultiArray, Header

from ..monitoring.core import Compared
from .messages import pose_array
from .qos import STATE


class MonitorOutput:
    """Errors, and both shapes at the markers."""

    def __init__(self, node: Node) -> None:
        """Make the publishers."""
        self._node, publish = node, node.create_publisher
        self._error = publish(Vector3Stamped, '~/error', STATE)
        self._rolling = publish(Float64, '~/rolling_error', STATE)
        self._per_marker = publish(Float64MultiArray, '~/marker_errors', STATE)
        self._measured = publish(PoseArray, '~/measured', STATE)
        self._predicted = publish(PoseArray, '~/predicted', STATE)

    def publish(self, frame: str, compared: Compared) -> None:
        """Publish a frame; what was not seen is nan."""
        header = Header(frame_id=frame, stamp=self._node.get_clock().now().to_msg())
        errors = compared.errors
        x, y, z = errors[-1].tolist()
        self._error.publish(Vector3Stamped(header=header, vector=Vector3(x=x, y=y, z=z)))
        self._rolling.publish(Float64(data=compared.rolling))
        self._per_marker.publish(Float64MultiArray(data=np.linalg.norm(errors, axis=1).tolist()))
        turns = np.tile(np.eye(3), (len(errors), 1, 1))
        self._measured.publish(pose_array(header, compared.measured, turns))
        self._predicted.publish(pose_array(header, compared.predicted, turns))
