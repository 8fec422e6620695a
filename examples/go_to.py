"""
Send the tip somewhere and print where it went.

python examples/go_to.py X Z [ROBOT]   in mm, in the base frame of the robot; needs only rclpy

Where the tip went is what a tracker says (measured_tip), else what the model says.
"""

import math
import sys
import time

import rclpy
from geometry_msgs.msg import PointStamped, PoseStamped
from rclpy.qos import qos_profile_sensor_data

x, z = 1e-3 * float(sys.argv[1]), 1e-3 * float(sys.argv[2])  # [m], as ROS has it
robot = sys.argv[3] if len(sys.argv) > 3 else 'kato_10_1'

rclpy.init()
node = rclpy.create_node('go_to')
targets = node.create_publisher(PointStamped, 'controller/target_point', 1)
tips, predicted = [], []
node.create_subscription(PoseStamped, 'measured_tip', tips.append, qos_profile_sensor_data)
node.create_subscription(
    PoseStamped, 'controller/predicted_tip', predicted.append, qos_profile_sensor_data
)

deadline = time.monotonic() + 10.0
while not (targets.get_subscription_count() and predicted):  # discovery takes a moment
    rclpy.spin_once(node, timeout_sec=0.1)
    if time.monotonic() > deadline:
        sys.exit('no controller that hears a driver within 10 s; are the nodes running?')

listened = time.monotonic() + 5.0  # a tracker may be discovered later than the controller
while not tips and time.monotonic() < listened:
    rclpy.spin_once(node, timeout_sec=0.1)

target = PointStamped()
target.header.frame_id = f'{robot}_base'  # a stamp of zero means now
target.point.x, target.point.z = x, z
targets.publish(target)

here, moved = (0.0, 0.0, 0.0), 1.0
while moved > 5e-4 and time.monotonic() < deadline + 15.0:  # until it stands still
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.1)
    tip = (tips or predicted)[-1].pose.position
    here, moved = (tip.x, tip.y, tip.z), math.dist(here, (tip.x, tip.y, tip.z))
source = '' if tips else ', as the model predicts'
print(f'tip at ({1e3 * tip.x:.1f}, {1e3 * tip.y:.1f}, {1e3 * tip.z:.1f}) mm{source}')
rclpy.shutdown()
