"""Robots, configurations and emulated servos for the tests of the Dynamixel driver."""

import time

import numpy as np

from tendon_robot_ros.drivers.dynamixel.tables import MODELS
from tendon_robot_ros.drivers.emulator.arm import SpringArm
from tendon_robot_ros.drivers.emulator.line import Line
from tendon_robot_ros.drivers.emulator.rig import Rig, Wire
from tendon_robot_ros.drivers.emulator.servo import Servo
from tendon_robot_ros.robot import parse_robot

MODEL = 'XL330-M077'
RADIUS = 0.02  # [m]
STIFFNESS = 400.0  # [N/m]

ROBOT = """
name: four
sections:
  - {name: s, cells: 10, cell_length: 0.01, bending_stiffness: 0.02}
tendons:
  - {name: east, offset: [0.005, 0.0], section: s}
  - {name: north, offset: [0.0, 0.005], section: s}
  - {name: west, offset: [-0.005, 0.0], section: s}
  - {name: south, offset: [0.0, -0.005], section: s}
tension_limits: [0.2, 5.0]
effects: {}
"""


def robot():
    return parse_robot(ROBOT, 'four.yaml')


def config(port, **changes):
    """Configuration of four small motors; `changes` go to the top level."""
    motors = {name: {'id': i + 1, 'direction': 1 if i % 2 == 0 else -1}
              for i, name in enumerate(robot().inputs)}
    plain = {'port': port, 'model': MODEL, 'spool_radius': RADIUS, 'pull_limits': [-0.01, 0.03],
             'motors': motors}
    return {**plain, **changes}


def line(model=MODEL, slack=0.004, stiffness=STIFFNESS, firmware=48, arm=None, ids=(1, 2, 3, 4)):
    """Four servos that wind four springs, every second one the other way round."""
    servos = [Servo(MODELS[model], i, firmware=firmware) for i in ids]
    for i, servo in enumerate(servos):
        servo.motion.angle = 0.7 * i
        servo.refresh()
    wires = [Wire(i, RADIUS, 1 if k % 2 == 0 else -1) for k, i in enumerate(ids)]
    many = np.ones(len(ids))
    return Line(Rig(servos, wires, arm or SpringArm(stiffness * many, slack * many)))


def cycle(driver, command, seconds, period=0.01, until=None):
    """Write and read like a node; return the readings, stop early when `until(reading)`."""
    readings = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        driver.write(np.asarray(command, dtype=float))
        readings.append(driver.read())
        if until is not None and until(readings[-1]):
            break
        time.sleep(period)
    return readings


def codes(reading):
    return {fault.code for fault in reading.faults}
