"""
The longest silence of the controller under targets that its model takes long to solve.

Controller and mock driver run as in use, each in its own process; targets, near and far, in reach
and out of it, come at a steady rate. Prints JSON: the gaps between commands, how many of
the targets were answered, and the load of the machine before and after.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

import numpy as np
from machine import machine, stolen, tell

os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PointStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.ros.shared.interface import COMMAND, LATCHED
from tendon_robot_ros.ros.shared.runtime import NodeProcess

LIMIT_MS = 20.0


class Watcher(Node):
    """Sends targets; notes when commands came, by their stamps, and what the status said."""

    def __init__(self, namespace: str) -> None:
        super().__init__('bench', namespace=namespace)
        self.sent: list[float] = []
        self.heard: list[float] = []
        self.codes: dict[str, int] = {}
        self.code = ''
        self.points = self.create_publisher(PointStamped, 'controller/target_point', COMMAND)
        self.create_subscription(JointState, 'tendon_command', self._hear, QoSProfile(depth=500))
        self.create_subscription(DiagnosticStatus, 'controller/status', self._status, LATCHED)
        self.executor_ = SingleThreadedExecutor()
        self.executor_.add_node(self)

    def _hear(self, message: JointState) -> None:
        stamp = message.header.stamp
        self.sent.append(stamp.sec + 1e-9 * stamp.nanosec)
        self.heard.append(time.monotonic())

    def _status(self, message: DiagnosticStatus) -> None:
        self.code = next(item.value for item in message.values if item.key == 'code')
        self.codes[self.code] = self.codes.get(self.code, 0) + 1

    def spin(self, until: float) -> None:
        """Serve callbacks until a time."""
        while (left := until - time.monotonic()) > 0:
            self.executor_.spin_once(timeout_sec=left)


def targets(robot: str, count: int) -> np.ndarray:
    """Return random points [m] in the half space of the arm, a third of them out of reach."""
    random, length = np.random.default_rng(5), load_robot(robot).length
    along = random.normal(size=(count, 3))
    along[:, 2] = np.abs(along[:, 2])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return along * (length * random.uniform(0.4, 1.3, (count, 1)))


def measure(watcher: Watcher, robot: str, count: int, rate: float) -> dict[str, object]:
    """Send the targets; return the gaps."""
    message = PointStamped()
    message.header.frame_id = f'{robot}_base'
    watcher.spin(time.monotonic() + 1.0)
    watcher.sent.clear()
    watcher.heard.clear()
    watcher.codes.clear()
    due, before = time.monotonic(), stolen()
    for point in targets(robot, count):
        message.point.x, message.point.y, message.point.z = map(float, point)
        watcher.points.publish(message)
        due += 1.0 / rate
        watcher.spin(due)
    sent = 1e3 * np.diff(watcher.sent)
    return {
        'robot': robot,
        'targets': count,
        'targets_per_s': rate,
        'commands': len(watcher.sent),
        'gap_p50_ms': round(float(np.median(sent)), 2),
        'gap_p99_ms': round(float(np.percentile(sent, 99)), 2),
        'longest_silence_ms': round(float(sent.max()), 2),
        'longest_as_heard_here_ms': round(1e3 * float(np.diff(watcher.heard).max()), 2),
        'limit_ms': LIMIT_MS,
        'over_10_ms': int(np.sum(sent > 10.0)),
        'stolen_ms': round(1e3 * (stolen() - before)),  # by other virtual machines
        'statuses': watcher.codes,
    }


def main() -> dict[str, object]:
    """Measure, print and return the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--robot', default='spatial_6')
    parser.add_argument('--mode', default='tension', choices=('tension', 'pull'))
    parser.add_argument('--targets', type=int, default=100)
    parser.add_argument('--rate', type=float, default=2.0, help='targets per second')
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    namespace = f'/bench_{os.getpid()}'
    result: dict[str, object] = {**machine(), 'mode': options.mode}
    result['load_before'] = os.getloadavg()[0]
    rclpy.init()
    watcher = Watcher(namespace)
    driver = {'robot': options.robot, 'config': 'mock_twin', 'command_mode': options.mode}
    controller = {'model': options.robot, 'command_mode': options.mode}
    with (
        open(os.devnull, 'w') as quiet,
        NodeProcess('driver', driver, namespace, quiet),
        NodeProcess('controller', controller, namespace, quiet),
    ):
        end = time.monotonic() + 600.0
        while watcher.code != 'holding' and time.monotonic() < end:
            watcher.executor_.spin_once(timeout_sec=0.1)
        result |= measure(watcher, options.robot, options.targets, options.rate)
    result['load_after'] = os.getloadavg()[0]
    watcher.destroy_node()
    rclpy.shutdown()
    tell(result, options.json)
    return result


if __name__ == '__main__':
    main()
