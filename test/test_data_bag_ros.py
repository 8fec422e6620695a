"""Messages of a running ROS system go into a recording as they come."""

import os
import sys
import time

import numpy as np
import pytest

pytest.importorskip('rclpy')
pytest.importorskip('rosbags')
os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)

import rclpy
import rclpy.executors
from geometry_msgs.msg import Pose, PoseArray
from recorded import BENT, SMALL
from sensor_msgs.msg import JointState

from tendon_robot_ros.data.bag_writer import JOINT_STATE, POSE_ARRAY, BagWriter
from tendon_robot_ros.data.loading import import_bag
from tendon_robot_ros.data.still_segments import Rule

pytestmark = pytest.mark.ros


def shape():
    """Make the message of a tracker that sees two of three markers."""
    message = PoseArray(poses=[Pose() for _ in BENT])
    message.header.frame_id = 'base'
    for pose, position in zip(message.poses, BENT, strict=True):
        pose.position.x, pose.position.y, pose.position.z = map(float, position)
    message.poses[1].position.x = float('nan')
    return message


def test_raw_subscriptions_are_recorded_and_imported(tmp_path):
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node('recording', context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    state = JointState(name=['left', 'right'], effort=[1.0, 0.25])  # no position, no velocity
    with BagWriter(tmp_path / 'bag') as writer:
        received = {}
        for topic, kind, name in (
            ('tendon_states', JointState, JOINT_STATE),
            ('measured_shape', PoseArray, POSE_ARRAY),
        ):
            writer.add_topic(f'/{topic}', name)

            def record(data, topic=topic):
                writer.write(f'/{topic}', time.time_ns(), data)
                received[topic] = received.get(topic, 0) + 1

            node.create_subscription(kind, topic, record, 10, raw=True)
        publishers = [
            (node.create_publisher(JointState, 'tendon_states', 10), state),
            (node.create_publisher(PoseArray, 'measured_shape', 10), shape()),
        ]
        end = time.monotonic() + 10.0
        while min(received.get('tendon_states', 0), received.get('measured_shape', 0)) < 40:
            assert time.monotonic() < end, received
            for publisher, message in publishers:
                publisher.publish(message)
            for _ in publishers:
                executor.spin_once(timeout_sec=0.02)
            time.sleep(0.02)
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown(context=context)
    data = import_bag(tmp_path / 'bag', SMALL, Rule(duration=0.3)).dataset
    assert data.inputs.tolist() == [[1.0, 0.25]]
    assert data.positions[0, 0, 0] == pytest.approx(BENT[0])
    assert np.isnan(data.positions[0, 0, 1]).all()
