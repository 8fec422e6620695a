"""
Control at 200 Hz beside monitor and viewer, and frames of the page with 60 cells.

First from target to command as in bench_controller.py, with a tracker, the monitor and the viewer
running. Then an arm of twice as many cells goes to and fro: how often the viewer draws it, by its
own count, without and with a headless browser that looks. Prints JSON. Run alone; the load of the
machine is printed beside the figures.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import IO

import yaml

os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))

import bench_controller
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from live_browser import Browser
from machine import machine, tell

from tendon_robot_ros.ros.shared.interface import LATCHED
from tendon_robot_ros.ros.shared.runtime import NodeProcess

ROOT = Path(__file__).resolve().parents[1]
TRACKER = 'plant: {twin: true}\ntracker: {rate: 30.0, noise: 2.0e-4}\n'
PORT, CELLS, SECONDS = 8096, 60, 10.0
COUNT = """window.drawn = 0;
  const count = () => { drawn += 1; requestAnimationFrame(count); }; count();"""
LIMITS = {'limit_p99_ms': 10.0, 'limit_frames_per_second': 20.0}


def twice_the_cells() -> str:
    """Return the paper's arm with half as long cells, as YAML."""
    content = yaml.safe_load((ROOT / 'config/robots/kato_10_1.yaml').read_text())
    for section in content['sections']:
        section['cells'] = CELLS // len(content['sections'])
        section['cell_length'] /= 2.0
        section['bending_stiffness'] *= 2.0
    return yaml.safe_dump(content)


class Watcher(bench_controller.Sender):
    """A sender that hears what viewer and monitor say of themselves."""

    def __init__(self, namespace: str) -> None:
        super().__init__(namespace)
        self.said: dict[str, dict[str, str]] = {}
        for name in ('viewer', 'monitor', 'controller'):
            self.create_subscription(
                DiagnosticStatus, f'{name}/status', self._status(name), LATCHED
            )

    def _status(self, name: str):
        def hear(message: DiagnosticStatus) -> None:
            self.said[name] = {item.key: item.value for item in message.values}

        return hear

    def wait(self) -> None:
        """Wait until the monitor compares."""
        end = time.monotonic() + 300.0
        while self.said.get('monitor', {}).get('code') != 'comparing':
            if time.monotonic() > end:
                raise SystemExit(f'the nodes do not start: {self.said}')
            self.spin(time.monotonic() + 0.1)

    def frames(self) -> float:
        """Move the arm to and fro for a while; return the frames per second at the end."""
        end = time.monotonic() + SECONDS
        step = 0
        while time.monotonic() < end:
            self.send(step)
            step += 7
            self.spin(time.monotonic() + 0.3)
        return float(self.said['viewer']['frames (Hz)'])


def nodes(
    stack: ExitStack, output: IO[str], namespace: str, robot: str, **controller: object
) -> None:
    """Start what `make live` starts."""
    for name, parameters in (
        ('driver', {'robot': robot, 'config': TRACKER}),
        ('controller', {'model': robot, **controller}),
        ('monitor', {}),
        ('viewer', {'port': float(PORT)}),
    ):
        stack.enter_context(NodeProcess(name, parameters, namespace, output))


def looked_at(watcher: Watcher) -> dict[str, float]:
    """Return the frames per second while a browser shows them, and its own."""
    with tempfile.TemporaryDirectory() as folder:
        browser = Browser(Path(folder))
        try:
            browser.open(f'http://127.0.0.1:{PORT}')
            browser.until(lambda: 'Record' in browser.text(), 'the page', 120.0)
            browser.run(COUNT)
            began = time.monotonic()
            sent = watcher.frames()
            shown = browser.run('window.drawn') / (time.monotonic() - began)
        finally:
            browser.close()
    return {'frames_per_second_looked_at': sent, 'browser_frames_per_second': round(shown, 1)}


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--targets', type=int, default=4000)
    parser.add_argument('--no-browser', action='store_true')
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    found: dict[str, object] = {**machine(), **LIMITS, 'load_before': os.getloadavg()[0]}
    rclpy.init()
    for part, robot in (('control', bench_controller.ROBOT), ('page', twice_the_cells())):
        watcher = Watcher(f'/rates_{part}_{os.getpid()}')
        with open(os.devnull, 'w') as quiet, ExitStack() as stack:
            nodes(stack, quiet, watcher.get_namespace(), robot, rate_limit=1000.0)
            watcher.wait()
            if part == 'control':
                found |= bench_controller.latencies(watcher, options.targets) | LIMITS
            else:
                found['cells'] = CELLS
                found['frames_per_second'] = watcher.frames()
                if not options.no_browser:
                    found |= looked_at(watcher)
        watcher.destroy_node()
    rclpy.shutdown()
    found['load_after'] = os.getloadavg()[0]
    tell(found, options.json)
    return 0


if __name__ == '__main__':
    sys.exit(main())
