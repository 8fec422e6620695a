"""
From target to command, between processes over DDS, and from start to the first command.

The sender streams the points of a small circle at 200 Hz and waits for the command that belongs to
each; controller and mock driver run as in use, each in its own process. The rate limit is lifted
so that a target changes the command at once; the model tells which target a command is for.
Prints JSON. Run alone: two cores are just enough for the three processes.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from machine import machine, tell

os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')

import rclpy
from geometry_msgs.msg import PointStamped
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from tendon_robot_ros.model.model import Model
from tendon_robot_ros.ros.shared.files import read_robot
from tendon_robot_ros.ros.shared.messages import COMMAND
from tendon_robot_ros.ros.shared.runtime import NodeProcess

RATE, LIMIT_MS, START_LIMIT_S = 200.0, 5.0, 5.0
ROBOT = 'kato_10_1'
POINTS = 40  # of the circle: a command is told from others up to 0.2 s late


class Sender(Node):
    """Sends targets and hears commands."""

    def __init__(self, namespace: str) -> None:
        super().__init__('bench', namespace=namespace)
        self.changes: list[tuple[float, list[float]]] = []  # commands unlike the one before
        self.first: float | None = None
        self.last: list[float] = []
        self._points = self.create_publisher(PointStamped, 'controller/target_point', COMMAND)
        self.create_subscription(JointState, 'tendon_command', self._hear, QoSProfile(depth=50))
        self.executor_ = SingleThreadedExecutor()
        self.executor_.add_node(self)

    def _hear(self, message: JointState) -> None:
        now, command = time.monotonic(), message.effort.tolist()
        self.first = self.first or now
        if command != self.last:
            self.changes.append((now, command))
        self.last = command

    def spin(self, until: float) -> None:
        """Serve callbacks until a time."""
        while (left := until - time.monotonic()) > 0:
            self.executor_.spin_once(timeout_sec=left)

    def send(self, step: int) -> float:
        """Send a point of the circle; return when."""
        message = PointStamped()
        message.header.frame_id = f'{ROBOT}_base'
        message.point.x, message.point.z = circle(step)
        now = time.monotonic()
        self._points.publish(message)
        return now


def circle(step: int) -> tuple[float, float]:
    """Return x and z of a target [m]."""
    angle = 2.0 * np.pi * step / POINTS
    return 0.06 + 0.005 * float(np.cos(angle)), 0.17 + 0.005 * float(np.sin(angle))


def first_command(sender: Sender, namespace: str, model: str, quiet) -> tuple[NodeProcess, float]:
    """Start a controller; return it and the time to its first command."""
    sender.spin(time.monotonic() + 0.5)  # the last words of the one before
    sender.first = None
    began = time.monotonic()
    controller = NodeProcess(
        'controller', {'model': model, 'rate_limit': 1000.0}, namespace, quiet
    )
    while sender.first is None and time.monotonic() - began < 300.0:
        sender.executor_.spin_once(timeout_sec=0.1)
    return controller, (sender.first or np.inf) - began


def latencies(sender: Sender, count: int) -> dict[str, object]:
    """Stream targets; return percentiles of the time until their command."""
    sender.spin(time.monotonic() + 1.0)
    sender.send(0.0)
    sender.spin(time.monotonic() + 0.5)
    sender.changes.clear()
    sent, due = [], time.monotonic()
    for step in range(count):
        sent.append(sender.send(step))
        due += 1.0 / RATE
        sender.spin(due)
    sender.spin(time.monotonic() + 0.5)
    model = Model(read_robot(ROBOT))
    points = np.array([circle(step) for step in range(POINTS)])
    taken: dict[int, float] = {}
    for at, command in sender.changes:
        away = np.linalg.norm(points - model.shape(command).tip_position[[0, 2]], axis=1)
        if away.min() > 1e-4:
            continue  # still on its way: the rate limit held it
        point = int(np.argmin(away))
        earlier = [step for step in range(point, count, POINTS) if sent[step] < at]
        if earlier and at - sent[earlier[-1]] < POINTS / RATE:
            taken.setdefault(earlier[-1], at - sent[earlier[-1]])
    p50, p90, p99, worst = np.percentile(1e3 * np.array(list(taken.values())), [50, 90, 99, 100])
    return {
        'targets': count,
        'answered': len(taken),
        'p50_ms': round(p50, 2),
        'p90_ms': round(p90, 2),
        'p99_ms': round(p99, 2),
        'max_ms': round(worst, 2),
        'limit_p99_ms': LIMIT_MS,
    }


def main() -> dict[str, object]:
    """Measure, print and return the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--targets', type=int, default=4000)
    parser.add_argument('--cold', action='store_true', help='also start with an empty cache')
    parser.add_argument('--model', default=ROBOT)
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    namespace = f'/bench_{os.getpid()}'
    result: dict[str, object] = {**machine(), 'rate_hz': RATE, 'model': options.model}
    rclpy.init()
    sender = Sender(namespace)
    with (
        open(os.devnull, 'w') as quiet,
        NodeProcess('driver', {'robot': ROBOT, 'config': 'mock_twin'}, namespace, quiet),
    ):
        controller, _ = first_command(sender, namespace, options.model, quiet)
        controller.end()
        controller, warm = first_command(sender, namespace, options.model, quiet)
        result |= {'start_warm_s': round(warm, 2), 'limit_start_warm_s': START_LIMIT_S}
        result |= latencies(sender, options.targets)
        controller.end()
        if options.cold:
            with tempfile.TemporaryDirectory() as cache:
                os.environ['NUMBA_CACHE_DIR'] = str(Path(cache).resolve())
                controller, cold = first_command(sender, namespace, options.model, quiet)
                controller.end()
            result['start_cold_s'] = round(cold, 1)
    sender.destroy_node()
    rclpy.shutdown()
    tell(result, options.json)
    return result


if __name__ == '__main__':
    main()
