"""Emulated servos of a robot, and a fixed cycle; used by the benchmarks here."""

import time
from pathlib import Path

from tendon_robot_ros.drivers import make_driver
from tendon_robot_ros.emulator.process import EmulatorProcess
from tendon_robot_ros.robot import load_robot

ROBOTS = Path(__file__).resolve().parents[1] / 'config' / 'robots'
ROBOT = ROBOTS / 'kato_10_1.yaml'


def emulator():
    return EmulatorProcess(ROBOT)


def driver_for(emulated, mode='tension', robot=ROBOT):
    return make_driver('dynamixel', load_robot(robot), emulated.content(), mode=mode)


def every(period, seconds):
    """Yield times on a fixed grid, until the end."""
    due = begin = time.monotonic()
    while due < begin + seconds:
        time.sleep(max(0.0, due - time.monotonic()))
        yield time.monotonic()
        due = max(due + period, time.monotonic())
