"""Emulated servos of a robot, and a fixed cycle; used by the benchmarks here."""

import math
import time
from pathlib import Path

import numpy as np

from tendon_robot_ros.drivers import make_driver
from tendon_robot_ros.emulator.port import EmulatorProcess
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.estimates import SAME_TENSION_N

ROBOTS = Path(__file__).resolve().parents[1] / 'config' / 'robots'
ROBOT = ROBOTS / 'kato_10_1.yaml'


def emulator(robot=ROBOT):
    return EmulatorProcess(robot)


def strongest(driver):
    """Return what a wire pulls at most before it turns its motor [N]: its current and friction."""
    return max(motor.strength(wire)[1] for motor in driver.motors.values() for wire in motor.wires)


class Passings:
    """How often motors are at their limits, and wires pull more than they hold; from traces."""

    PERIOD = 20.0  # [s] between two looks; the emulator remembers more

    def __init__(self, servos, driver):
        self.servos = servos
        self.limit, self.holds = driver.robot.tension_limits[1], strongest(driver)  # [N]
        self.currents = 0.95 * np.array(
            [motor.strongest * motor.model.current_unit for motor in driver.motors.values()]
        )  # [A] from which on a motor counts as one at its limit
        self.last, self.samples, self.beyond, self.times = time.monotonic(), 0, 0, 0
        self.most, self.at_limit = 0.0, 0
        self._before = None

    def look(self, now=math.inf):
        """Count what has been since the last look, once a period."""
        if now < self.last + self.PERIOD:
            return
        trace = [moment for moment in self.servos.ask(f'trace {2.0 * self.PERIOD}')
                 if moment[0] > self.last]  # fmt: skip
        if not trace:
            return
        self.last = trace[-1][0]
        tensions = np.array([moment[2] for moment in trace])
        above = tensions > self.holds + SAME_TENSION_N
        before = np.zeros_like(above[0]) if self._before is None else self._before
        self._before = above[-1]
        self.times += int(np.sum(above & ~np.vstack([before, above[:-1]])))
        self.beyond += int(above.any(axis=1).sum())
        currents = np.abs([moment[1] for moment in trace])
        self.at_limit += int((currents > self.currents).any(axis=1).sum())
        self.samples += len(trace)
        self.most = max(self.most, float(tensions.max()))

    def told(self):
        share = 1.0 / max(1, self.samples)
        return {
            'tension limit [N]': self.limit,
            'motors hold at most [N]': round(self.holds, 3),
            'share of the time with a motor at its limit': round(self.at_limit * share, 4),
            'share of the time beyond what motors hold': round(self.beyond * share, 5),
            'times beyond what motors hold': self.times,
            'highest tension [N]': round(self.most, 3),
        }


def driver_for(emulated, mode='tension', robot=ROBOT):
    return make_driver('dynamixel', load_robot(robot), emulated.content(), mode=mode)


def every(period, seconds):
    """Yield times on a fixed grid, until the end."""
    due = begin = time.monotonic()
    while due < begin + seconds:
        time.sleep(max(0.0, due - time.monotonic()))
        yield time.monotonic()
        due = max(due + period, time.monotonic())
