"""
From target to command, between processes over DDS, and from start to the first command.

The sender streams targets and waits for the command that belongs to each; controller and mock
driver run as in use, each in its own process. The rate limit is lifted so that a target changes
the command at once; the model tells which target a command is for. A planar arm gets the points of
a small circle at 200 Hz; `--robot spatial_6` a path round its base at 20 Hz, and tips all over
its workspace at 2 Hz. Told are the command that has the tip at the target, and the first one after
it that has the tip nearer. The sender runs in real time where that is allowed, so that on a busy
machine the controller is measured and not who measures. Prints JSON, with the load of the machine.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from dataclasses import dataclass
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

from tendon_robot_ros.common.processes import Realtime, go_realtime, in_realtime
from tendon_robot_ros.model.compile import BEND_TOLERANCE
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.ros.shared.interface import COMMAND
from tendon_robot_ros.ros.shared.runtime import NodeProcess

START_LIMIT_S = 5.0
ROBOT = 'kato_10_1'
LARGEST_N = 4.0  # [N] of the tensions whose tips are targets all over the workspace
RANDOM_TARGETS = 200
NEAR_M = 1e-4  # [m] of a tip and the target that it is for


@dataclass(frozen=True)
class Stream:
    """Targets that come round again: a command is told from others up to one round late."""

    points: np.ndarray  # (K, 3) [m]
    rate: float  # [Hz]
    limit: float  # [ms] of 99 % from target to command


class Sender(Node):
    """Sends targets and hears commands."""

    def __init__(self, namespace: str, robot: str = ROBOT) -> None:
        super().__init__('bench', namespace=namespace)
        self.frame, self.stream = f'{robot}_base', circle()
        self.changes: list[tuple[float, list[float]]] = []  # commands unlike the one before
        self.released = 0  # commands without tendons: the driver lets go
        self.first: float | None = None
        self.last: list[float] = []
        self._points = self.create_publisher(PointStamped, 'controller/target_point', COMMAND)
        self.create_subscription(JointState, 'tendon_command', self._hear, QoSProfile(depth=50))
        self.executor_ = SingleThreadedExecutor()
        self.executor_.add_node(self)

    def _hear(self, message: JointState) -> None:
        now, command = time.monotonic(), message.effort.tolist()
        self.first = self.first or now
        if not command:
            self.released += 1
        elif command != self.last:
            self.changes.append((now, command))
        self.last = command

    def spin(self, until: float) -> None:
        """Serve callbacks until a time."""
        while (left := until - time.monotonic()) > 0:
            self.executor_.spin_once(timeout_sec=left)

    def send(self, step: int) -> float:
        """Send a target of the stream; return when."""
        message = PointStamped()
        message.header.frame_id = self.frame
        place = self.stream.points[step % len(self.stream.points)]
        message.point.x, message.point.y, message.point.z = place.tolist()
        now = time.monotonic()
        self._points.publish(message)
        return now


def circle(count: int = 40) -> Stream:
    """Return a small circle in the plane of the paper's arm."""
    angle = 2.0 * np.pi * np.arange(count) / count
    x, z = 0.06 + 0.005 * np.cos(angle), 0.17 + 0.005 * np.sin(angle)
    return Stream(np.stack([x, np.zeros(count), z], axis=1), 200.0, 5.0)


def round_the_base(model: Model, count: int = 60) -> Stream:
    """Return the tips of a bend that goes round the base in three seconds."""
    angle = 2.0 * np.pi * np.arange(count) / count
    places = np.array([tendon.end for tendon in model.robot.tendons])
    own = np.arctan2(places[:, 1], places[:, 0])
    tensions = model.limits[:, 0] + 0.8 + 0.6 * np.cos(angle[:, None] - own)
    return Stream(model.shapes(tensions).tip_position, 20.0, 10.0)


def all_over(model: Model, count: int) -> Stream:
    """Return the tips of random tensions."""
    low, high = model.limits.T
    share = np.random.default_rng(1).random((count, len(low)))
    shapes, changes = model.solve(low + share * (np.minimum(high, LARGEST_N) - low))
    return Stream(shapes.tip_position[changes < BEND_TOLERANCE], 2.0, 10.0)


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


def latencies(
    sender: Sender, count: int, stream: Stream | None = None, robot: str = ROBOT
) -> dict[str, object]:
    """Stream targets; return percentiles of the time until their command."""
    stream = sender.stream = stream or circle()
    sender.spin(time.monotonic() + 1.0)
    sender.send(-1)
    sender.spin(time.monotonic() + 0.5)
    sender.changes.clear()
    sender.released, sent, due = 0, [], time.monotonic()
    for step in range(count):
        sent.append(sender.send(step))
        due += 1.0 / stream.rate
        sender.spin(due)
    sender.spin(time.monotonic() + 0.5)
    model = Model(load_robot(robot))
    tips = [model.shape(command).tip_position for _, command in sender.changes]
    tips = np.array(tips).reshape(-1, 3)
    return {
        'rate_hz': stream.rate,
        'targets': count,
        'released': sender.released,
        'limit_p99_ms': stream.limit,
        **_percentiles('', list(_answers(sender, np.array(sent), tips).values())),
        **_percentiles('towards it ', _turns(sender, sent, tips)),
    }


def _percentiles(name: str, taken: list[float]) -> dict[str, object]:
    """Count and percentiles [ms] of times [s]."""
    shares = {'p50': 50.0, 'p90': 90.0, 'p99': 99.0, 'max': 100.0}
    times = 1e3 * np.array(taken or [np.nan])
    return {
        f'{name}answered': len(taken),
        **{
            f'{name}{of}_ms': round(np.percentile(times, share), 2) for of, share in shares.items()
        },
    }


def _turns(sender: Sender, sent: list[float], tips: np.ndarray) -> list[float]:
    """
    Return the time [s] until a command brings the tip nearer to each target than the one before.

    Tips (changes, 3) [m] are those of the commands; the next target ends the wait for one.
    """
    times = np.array([at for at, _ in sender.changes])
    points, taken = sender.stream.points, []
    for step, began in enumerate(sent):
        end = sent[step + 1] if step + 1 < len(sent) else np.inf
        away = np.linalg.norm(tips - points[step % len(points)], axis=1)
        rows = np.flatnonzero((times > began) & (times < end))
        nearer = [row for row in rows if row == 0 or away[row] < away[row - 1]]
        if nearer:
            taken.append(times[nearer[0]] - began)
    return taken


def _answers(sender: Sender, sent: np.ndarray, tips: np.ndarray) -> dict[int, float]:
    """Return the time [s] until the first command of every target that has its tip there."""
    points, rate = sender.stream.points, sender.stream.rate
    taken: dict[int, float] = {}
    for (at, _), tip in zip(sender.changes, tips, strict=True):
        away = np.linalg.norm(points - tip, axis=1)
        if away.min() > NEAR_M:
            continue  # still on its way: the rate limit held it
        point = int(np.argmin(away))
        earlier = [step for step in range(point, len(sent), len(points)) if sent[step] < at]
        if earlier and at - sent[earlier[-1]] < len(points) / rate:
            taken.setdefault(earlier[-1], at - sent[earlier[-1]])
    return taken


def streams(sender: Sender, robot: str, count: int) -> dict[str, object]:
    """Measure the targets that belong to a robot."""
    if robot == ROBOT:
        return latencies(sender, count)
    own, fewer = Model(load_robot(robot)), min(count, RANDOM_TARGETS)
    return {
        'path': latencies(sender, count, round_the_base(own), robot),
        'all over': latencies(sender, fewer, all_over(own, fewer), robot),
    }


def main() -> dict[str, object]:
    """Measure, print and return the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--targets', type=int, default=4000)
    parser.add_argument('--cold', action='store_true', help='also start with an empty cache')
    parser.add_argument('--robot', default=ROBOT)
    parser.add_argument('--model', help='of the controller; default: that of the robot')
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    namespace, robot = f'/bench_{os.getpid()}', options.robot
    model = options.model or robot
    result: dict[str, object] = {**machine(), 'robot': robot, 'model': model}
    rclpy.init()
    sender = Sender(namespace, robot)
    go_realtime(Realtime.MOCK_DRIVER)
    result['sender_in_realtime'] = in_realtime()
    with (
        open(os.devnull, 'w') as quiet,
        NodeProcess('driver', {'robot': robot, 'config': 'mock_twin'}, namespace, quiet),
    ):
        controller, _ = first_command(sender, namespace, model, quiet)
        controller.end()
        controller, warm = first_command(sender, namespace, model, quiet)
        result |= {'start_warm_s': round(warm, 2), 'limit_start_warm_s': START_LIMIT_S}
        result |= streams(sender, robot, options.targets)
        controller.end()
        if options.cold:
            with tempfile.TemporaryDirectory() as cache:
                os.environ['NUMBA_CACHE_DIR'] = str(Path(cache).resolve())
                controller, cold = first_command(sender, namespace, model, quiet)
                controller.end()
            result['start_cold_s'] = round(cold, 1)
    sender.destroy_node()
    rclpy.shutdown()
    result['load'] = round(os.getloadavg()[0], 1)
    tell(result, options.json)
    return result


if __name__ == '__main__':
    main()
