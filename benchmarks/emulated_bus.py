"""An emulator in a process of its own, and a driver for it; used by the benchmarks here."""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import yaml

from tendon_robot_ros.drivers import make_driver
from tendon_robot_ros.robot import load_robot

ROOT = Path(__file__).resolve().parents[1]
ROBOT = ROOT / 'config' / 'robots' / 'kato_10_1.yaml'  # four inputs


class Emulator:
    """`emulate dynamixel` in another process; `say` obeys its commands."""

    def __init__(self, robot=ROBOT, *arguments):
        self.folder = tempfile.TemporaryDirectory()
        self.config = Path(self.folder.name, 'servos.yaml')
        self.process = subprocess.Popen(
            [sys.executable, '-m', 'tendon_robot_ros', 'emulate', 'dynamixel']
            + ['--robot', str(robot), '--write-config', str(self.config), *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=ROOT,
        )
        self.port = self.process.stdout.readline().strip()

    def say(self, text):
        self.process.stdin.write(text + '\n')
        self.process.stdin.flush()
        return self.process.stdout.readline().strip()

    def state(self):
        return json.loads(self.say('state'))

    def driver(self, mode='tension', **changes):
        content = yaml.safe_load(self.config.read_text())
        return make_driver('dynamixel', load_robot(ROBOT), {**content, **changes}, mode=mode)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.terminate()
        self.process.wait(10)
        self.folder.cleanup()


def every(period, seconds):
    """Yield times on a fixed grid, until the end."""
    due = begin = time.monotonic()
    while due < begin + seconds:
        time.sleep(max(0.0, due - time.monotonic()))
        yield time.monotonic()
        due = max(due + period, time.monotonic())
