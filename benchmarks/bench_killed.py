"""
How long driver and controller stand still when another process is killed.

Both run at 200 Hz with the mock arm, each in its own process, as in use. Programs that publish on
a topic of theirs come and are killed (SIGKILL) again and again: once with the transports that the
package chooses, once with those that Fast DDS would use by itself, shared memory among them. The
longest silence of both nodes is read from the stamps of what they sent. Prints JSON.

    python benchmarks/bench_killed.py --rounds 30
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from machine import machine, tell

os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool

from tendon_robot_ros.ros.shared.interface import STATE
from tendon_robot_ros.ros.shared.messages import seconds
from tendon_robot_ros.ros.shared.runtime import TRANSPORTS, NodeProcess, without_shared_memory

ROBOT, VICTIMS, LIFE_S, PAUSE_S = 'kato_10_1', 2, 0.4, 0.5
LONG_S = 0.1  # [s] a silence that counts: no watchdog waits so long
HEARD_S = 20.0  # [s] for a program to be heard


class Listener(Node):
    """Hears what both nodes send, and the programs that are killed."""

    def __init__(self, namespace: str) -> None:
        super().__init__('bench', namespace=namespace)
        self.sent: dict[str, list[float]] = {'tendon_command': [], 'tendon_states': []}
        for topic, times in self.sent.items():
            self.create_subscription(
                JointState,
                topic,
                lambda message, times=times: times.append(seconds(message.header.stamp)),
                QoSProfile(depth=500),
            )
        self.heard = 0.0
        self.create_subscription(Bool, 'stop', self._hear, STATE)
        self.executor_ = SingleThreadedExecutor()
        self.executor_.add_node(self)

    def _hear(self, message: Bool) -> None:
        self.heard = time.monotonic()

    def spin(self, length: float) -> None:
        """Serve callbacks for some seconds."""
        end = time.monotonic() + length
        while (left := end - time.monotonic()) > 0:
            self.executor_.spin_once(timeout_sec=left)


def victim(namespace: str) -> None:
    """Say on the topic `stop` that nobody shall stop, as often as it goes."""
    rclpy.init()
    publisher = Node('victim', namespace=namespace).create_publisher(Bool, 'stop', STATE)
    while True:
        publisher.publish(Bool(data=False))
        time.sleep(0.0003)


def rounds(listener: Listener, namespace: str, count: int) -> dict[str, object]:
    """Start and kill; return how long both nodes were silent."""
    listener.spin(2.0)
    for times in listener.sent.values():
        times.clear()
    for _ in range(count):
        began = time.monotonic()
        command = [sys.executable, __file__, '--victim', namespace]
        victims = [subprocess.Popen(command) for _ in range(VICTIMS)]
        while listener.heard < began and time.monotonic() < began + HEARD_S:
            listener.spin(0.05)
        listener.spin(LIFE_S)
        for one in victims:
            one.kill()
            one.wait()
        listener.spin(PAUSE_S)
    gaps = {topic: np.diff(times) for topic, times in listener.sent.items()}
    return {
        'killed': count * VICTIMS,
        **{f'{topic}_longest_s': round(float(one.max()), 3) for topic, one in gaps.items()},
        **{f'{topic}_over_100_ms': int((one > LONG_S).sum()) for topic, one in gaps.items()},
    }


def measure(transports: str, count: int) -> dict[str, object]:
    """Run both nodes with transports; `transports` empty: as the package chooses."""
    namespace = f'/bench_{os.getpid()}_{transports or "own"}'
    plain = dict(os.environ)
    if transports:
        os.environ[TRANSPORTS] = transports
    try:
        with (
            open(os.devnull, 'w') as quiet,
            NodeProcess('driver', {'robot': ROBOT, 'config': 'mock'}, namespace, quiet),
            NodeProcess('controller', {'model': ROBOT}, namespace, quiet),
        ):
            without_shared_memory()
            rclpy.init()
            listener = Listener(namespace)
            end = time.monotonic() + 120.0
            while not all(listener.sent.values()) and time.monotonic() < end:
                listener.spin(0.1)
            found = rounds(listener, namespace, count)
            listener.destroy_node()
            rclpy.shutdown()
    finally:
        os.environ.clear()
        os.environ.update(plain)
    return found


def main() -> dict[str, object]:
    """Measure both ways; print and return the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rounds', type=int, default=30)
    parser.add_argument('--victim', metavar='NAMESPACE', help=argparse.SUPPRESS)
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    if options.victim:
        victim(options.victim)
    result: dict[str, object] = {**machine(), 'load_before': os.getloadavg()[0]}
    result['own'] = measure('', options.rounds)
    result['fast_dds'] = measure('DEFAULT', options.rounds)
    result['load_after'] = os.getloadavg()[0]
    tell(result, options.json)
    return result


if __name__ == '__main__':
    main()
