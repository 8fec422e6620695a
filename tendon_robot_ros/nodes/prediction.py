"""Publishing the arm as the model sees it."""

from __future__ import annotations

from geometry_msgs.msg import PoseArray, PoseStamped
from rclpy.node import Node
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from ..model.model import Model
from ..model.shape import Shape
from .messages import PREDICTED, arm_markers, pose_array, pose_stamped
from .qos import STATE


class Prediction:
    """Shape, tip and markers of the predicted arm."""

    def __init__(self, node: Node, frame: str, model: Model) -> None:
        """Make the publishers."""
        self._node, self._frame = node, frame
        offsets = [abs(value) for t in model.robot.tendons for value in (*t.base, *t.end)]
        self._thickness = 2.0 * max(offsets)
        self._shape = node.create_publisher(PoseArray, '~/predicted_shape', STATE)
        self._tip = node.create_publisher(PoseStamped, '~/predicted_tip', STATE)
        self._markers = node.create_publisher(MarkerArray, '~/markers', STATE)

    def publish(self, shape: Shape | None) -> None:
        """Publish a shape; poses are the distal ends of the cells."""
        if shape is None:
            return
        header = Header(frame_id=self._frame, stamp=self._node.get_clock().now().to_msg())
        self._shape.publish(pose_array(header, shape.positions, shape.frames))
        self._tip.publish(pose_stamped(header, shape.tip_position, shape.frames[-1]))
        if self._markers.get_subscription_count():
            self._markers.publish(
                arm_markers(header, shape.positions, self._thickness, PREDICTED, 'predicted')
            )

    def close(self) -> None:
        """Stop to publish."""
        for publisher in (self._shape, self._tip, self._markers):
            self._node.destroy_publisher(publisher)
