"""
Processor time of controller and driver while nothing happens, and releases on a busy machine.

Both run at 200 Hz with the mock arm, each in its own process, as in use. First they stand idle and
their processor time is read from /proc. Then a command runs beside them, and every release of the
driver is counted: nobody asked for one; with each, the longest silence of both nodes just before,
by the stamps of what they sent: who was late. Prints JSON. Linux only.

    python benchmarks/bench_idle.py --minutes 10 --load 'make test'
"""

from __future__ import annotations

import argparse
import os
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from machine import machine, stolen, tell

os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

from tendon_robot_ros.common.processes import go_realtime
from tendon_robot_ros.ros.shared.interface import STATE
from tendon_robot_ros.ros.shared.messages import seconds
from tendon_robot_ros.ros.shared.runtime import NodeProcess

RATE, LIMIT = 200.0, 0.15  # [Hz], of a core
EAR = 2  # priority of who listens: no part of what is measured
ROBOT = 'kato_10_1'
TICKS = os.sysconf('SC_CLK_TCK')


class Watcher(Node):
    """Hears the statuses; counts how often the driver let go."""

    def __init__(self, namespace: str) -> None:
        super().__init__('bench', namespace=namespace)
        self.codes = {'driver': '', 'controller': ''}
        self.left: list[tuple[float, str]] = []  # when [s] the driver let go, and why
        self.sent: dict[str, list[float]] = {'tendon_command': [], 'tendon_states': []}  # [s]
        self.create_subscription(DiagnosticArray, '/diagnostics', self._hear, STATE)
        self.executor_ = SingleThreadedExecutor()
        self.executor_.add_node(self)

    def _hear(self, message: DiagnosticArray) -> None:
        for status in message.status:
            space, _, name = status.name.partition(':')[0].rpartition('/')
            if f'/{space}' != self.get_namespace() or name not in self.codes:
                continue
            code = next(item.value for item in status.values if item.key == 'code')
            if name == 'driver' and self.codes[name] == 'following' != code:
                self.left.append((seconds(message.header.stamp), status.message))
            self.codes[name] = code

    def spin(self, seconds: float) -> None:
        """Serve callbacks for some seconds."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            self.executor_.spin_once(timeout_sec=left)

    def listen(self) -> None:
        """Note when commands and states are sent; while the nodes stand idle nobody hears them."""
        for topic, stamps in self.sent.items():
            self.create_subscription(
                JointState,
                topic,
                lambda m, stamps=stamps: stamps.append(seconds(m.header.stamp)),
                QoSProfile(depth=500),
            )

    def silences(self, at: float) -> dict[str, float]:
        """Return the longest silence [ms] on both topics in the second before a time [s]."""
        found = {}
        for topic, stamps in self.sent.items():
            lately = np.array([stamp for stamp in stamps if at - 1.0 < stamp < at])
            found[f'{topic}_ms'] = round(1e3 * float(np.diff(lately).max(initial=0.0)), 1)
        return found


def fields(process: NodeProcess) -> list[str]:
    """Return what the kernel counts of a process, from its state on (man proc_pid_stat)."""
    return Path(f'/proc/{process.process.pid}/stat').read_text().rpartition(')')[2].split()


def used(process: NodeProcess) -> float:
    """Return the processor time of a process so far [s]."""
    return sum(map(int, fields(process)[11:13])) / TICKS


def read_again(process: NodeProcess) -> int:
    """Return how many pages it had to wait for because the machine had put them away."""
    return int(fields(process)[9])


def idle(watcher: Watcher, nodes: list[NodeProcess], seconds: float) -> dict[str, float]:
    """Return the share of a core that each node takes while nothing happens."""
    before, began = [used(node) for node in nodes], time.monotonic()
    time.sleep(seconds)  # the statuses wait
    passed = time.monotonic() - began
    shares = [(used(node) - b) / passed for node, b in zip(nodes, before, strict=True)]
    watcher.spin(0.5)
    return {f'idle_{n.name}': round(s, 3) for n, s in zip(nodes, shares, strict=True)}


def beside(
    watcher: Watcher, nodes: list[NodeProcess], command: str, minutes: float
) -> dict[str, object]:
    """Count releases while a command runs beside, again and again for some minutes."""
    watcher.left.clear()
    watcher.listen()
    go_realtime(EAR)
    before, pages = stolen(), [read_again(node) for node in nodes]
    began, until = time.time(), time.monotonic() + 60.0 * minutes
    load: subprocess.Popen[bytes] | None = None
    loads = []
    while time.monotonic() < until:
        if command and (load is None or load.poll() is not None):
            load = subprocess.Popen(
                shlex.split(command),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # it is ended with all that it started
            )
        watcher.spin(min(2.0, until - time.monotonic()))
        loads.append(os.getloadavg()[0])
    if load is not None and load.poll() is None:
        os.killpg(load.pid, signal.SIGTERM)
        load.wait()
    return {
        'load': command,
        'minutes': minutes,
        'load_average': [round(min(loads), 1), round(max(loads), 1)],
        'stolen_ms': round(1e3 * (stolen() - before)),  # by other virtual machines
        'pages_read_again': [read_again(n) - p for n, p in zip(nodes, pages, strict=True)],
        'longest_silence_ms': {
            topic: round(1e3 * float(np.diff(stamps).max(initial=0.0)), 1)
            for topic, stamps in watcher.sent.items()
        },
        'releases': len(watcher.left),
        'reasons': [
            {'at_s': round(at - began, 1), 'why': why, **watcher.silences(at)}
            for at, why in watcher.left
        ],
    }


def main() -> dict[str, object]:
    """Measure, print and return the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=20.0, help='of standing idle')
    parser.add_argument('--minutes', type=float, default=0.0, help='beside the load')
    parser.add_argument('--load', default='', help='a command that runs beside')
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    namespace = f'/bench_{os.getpid()}'
    result: dict[str, object] = {**machine(), 'rate_hz': RATE, 'limit_idle': LIMIT}
    rclpy.init()
    watcher = Watcher(namespace)
    with (
        tempfile.TemporaryFile('w+') as log,
        NodeProcess('driver', {'robot': ROBOT, 'config': 'mock'}, namespace, log) as driver,
        NodeProcess('controller', {'model': ROBOT}, namespace, log) as controller,
    ):
        until = time.monotonic() + 300.0
        while watcher.codes != {'driver': 'following', 'controller': 'holding'}:
            watcher.spin(0.1)
            if time.monotonic() > until:
                sys.exit(f'the nodes did not start: {watcher.codes}')
        watcher.spin(3.0)
        result |= {'load_average_before': round(os.getloadavg()[0], 1)}
        result |= idle(watcher, [driver, controller], options.seconds)
        if options.minutes:
            result |= beside(watcher, [driver, controller], options.load, options.minutes)
    watcher.destroy_node()
    rclpy.shutdown()
    tell(result, options.json)
    return result


if __name__ == '__main__':
    main()
