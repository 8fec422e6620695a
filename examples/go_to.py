"""
Send the tip somewhere and print where it went.

python examples/go_to.py X Z [ROBOT]   in metres, in the base frame of the robot; needs only rclpy
"""

import sys
import time

import rclpy
from geometry_msgs.msg import PointStamped, PoseStamped
from rclpy.qos import qos_profile_sensor_data

x, z = float(sys.argv[1]), float(sys.argv[2])
robot = sys.argv[3] if len(sys.argv) > 3 else 'kato_10_1'

rclpy.init()
node = rclpy.create_node('go_to')
targets = node.create_publisher(PointStamped, 'controller/target_point', 1)
tips = []
node.create_subscription(PoseStamped, 'measured_tip', tips.append, qos_profile_sensor_data)

deadline = time.monotonic() + 10.0
while not (targets.get_subscription_count() and tips):  # discovery takes a moment
    rclpy.spin_once(node, timeout_sec=0.1)
    if time.monotonic() > deadline:
        sys.exit('no controller or no tracker within 10 s; are the nodes running?')

target = PointStamped()
target.header.frame_id = f'{robot}_base'  # a stamp of zero means now
target.point.x, target.point.z = x, z
targets.publish(target)

end = time.monotonic() + 1.5
while time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.1)
tip = tips[-1].pose.position
print(f'tip at ({1e3 * tip.x:.1f}, {1e3 * tip.y:.1f}, {1e3 * tip.z:.1f}) mm')
rclpy.shutdown()
