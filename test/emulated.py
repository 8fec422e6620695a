"""Robots, configurations and emulated servos for the tests of the Dynamixel driver."""

import contextlib
import os
import time
from pathlib import Path

import numpy as np
import processes
import pytest
import yaml
from forked import Forked

from tendon_robot_ros.common.errors import DriverError
from tendon_robot_ros.drivers import make_driver
from tendon_robot_ros.drivers.dynamixel.control_table import MODELS
from tendon_robot_ros.drivers.interface import CYCLE_S
from tendon_robot_ros.drivers.serial_board.link import BoardLink
from tendon_robot_ros.emulator.bus import EmulatedBus
from tendon_robot_ros.emulator.port import EmulatorProcess
from tendon_robot_ros.emulator.rig import Rig, SpringArm, Wire
from tendon_robot_ros.emulator.servo import Servo
from tendon_robot_ros.robot import parse_robot

HERE = Path(__file__).resolve().parent
MODEL = 'XL330-M077'
RADIUS = 0.02  # [m]
STIFFNESS = 400.0  # [N/m]
TENSION = np.array([2.0, 1.0, 0.5, 0.5])
PULL = np.array([0.006, 0.003, 0.0, 0.0])
SOON = 30.0  # [s], a generous end of every wait
# [s]; the bytes of a pseudo-terminal wait for a thread of the kernel that has no priority: between
# two processes on a busy machine for 75 ms. The bus is silent meanwhile
LATE = {'answer_time': 0.1, 'watchdog': 2.0}

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

SHARED = {  # the motors of `antagonists`
    'east': {'id': 1},
    'west': {'id': 1, 'direction': -1},
    'north': {'id': 2},
    'south': {'id': 2, 'direction': -1},
}


def robot():
    return parse_robot(ROBOT, 'four.yaml')


def config(port, /, **changes):
    """Make a configuration of four small motors; `changes` go to the top level."""
    motors = {
        name: {'id': i + 1, 'direction': 1 if i % 2 == 0 else -1}
        for i, name in enumerate(robot().inputs)
    }
    plain = {
        'port': port,
        'model': MODEL,
        'spool_radius': RADIUS,
        'answer_time': 0.03,  # [s]; the machine that tests is busy
        'watchdog': 2.0,  # as above; a test of what it does says how soon
        'pull_limits': [-0.01, 0.03],
        'motors': motors,
    }
    return {**plain, **changes}


def line(
    model=MODEL,
    slack=0.004,
    stiffness=STIFFNESS,
    firmware=48,
    arm=None,
    ids=(1, 2, 3, 4),
    radius=RADIUS,
    kind=None,
):
    """Four servos that wind four springs, every second one the other way round."""
    servos = [Servo(MODELS[model], i, firmware=firmware) for i in ids]
    for i, servo in enumerate(servos):
        servo.motion.angle = 0.7 * i
        servo.refresh()
    wires = [Wire(i, radius, 1 if k % 2 == 0 else -1) for k, i in enumerate(ids)]
    many = np.ones(len(ids))
    return started(Rig(servos, wires, arm or SpringArm(stiffness * many, slack * many)), kind)


def stepped(**changes):
    """Return a line for which time passes only while a motion of the driver sleeps."""
    return line(**changes, kind=SteppedLine)


def antagonists(slack):
    """Two servos with two springs each, one on either side of the spool."""
    servos = [Servo(MODELS[MODEL], i) for i in (1, 2)]
    wires = [Wire(1, RADIUS), Wire(2, RADIUS), Wire(1, RADIUS, -1), Wire(2, RADIUS, -1)]
    return started(Rig(servos, wires, SpringArm(np.full(4, STIFFNESS), np.full(4, slack))))


class OwnTime:
    """
    By whose own time a driver waits for answers.

    A busy machine that does not let this process run makes no motor silent.
    """

    def __enter__(self):
        self.wait_by(lambda: self.lived)
        return super().__enter__()

    def __exit__(self, *_):
        super().__exit__()
        self.wait_by(time.monotonic)

    @staticmethod
    def wait_by(clock):
        BoardLink.clock = staticmethod(clock)
        with contextlib.suppress(ModuleNotFoundError):  # tests of boards need no SDK
            from tendon_robot_ros.drivers.dynamixel.bus import Port

            Port.clock = staticmethod(clock)


class Line(OwnTime, EmulatedBus):
    """Emulated servos."""


class SteppedLine(Line):
    """Servos for which time passes only while a motion of the driver sleeps: nobody is late."""

    now = 0.0  # [s]

    def __enter__(self):
        self.keep_time(self)
        return super().__enter__()

    def __exit__(self, *_):
        super().__exit__()
        self.keep_time(time)

    @staticmethod
    def keep_time(clock):
        from tendon_robot_ros.drivers.dynamixel import motions

        motions.time = clock

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        with self._lock:
            for _ in range(steps := max(1, round(seconds / CYCLE_S))):
                super().advance(seconds / steps)
        self.now += seconds

    def advance(self, passed):
        """Let no time pass while the bus is served."""


def started(rig, kind=None):
    """Line with the servos; it remembers where they were at the start."""
    made = (kind or Line)(rig)
    made.start_ticks = [servo.motion.ticks for servo in rig.servos.values()]
    return made


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


class ForkedEmulator(EmulatorProcess):
    """Emulated motors that start without the cost of imports; who drives servos is patient."""

    def __init__(self, *arguments, kind='dynamixel'):
        super().__init__(*arguments, kind=kind)
        if kind == 'dynamixel':
            self.config.write_text(yaml.safe_dump({**self.content(), **LATE}))

    def start(self, command):
        process = Forked(command, stdin=processes.PIPE, stdout=processes.PIPE)
        processes.started.remove(process)  # it may outlive the test that starts it
        return process


def codes(reading):
    return {fault.code for fault in reading.faults}


def environment():
    """Environment of a child that imports this folder and the package."""
    paths = [str(HERE), str(HERE.parent), os.environ.get('PYTHONPATH', '')]
    return {**os.environ, 'PYTHONPATH': os.pathsep.join(filter(None, paths))}


def driver_for(line, mode='tension', **changes):
    quick = {'home_speed': 0.04, 'tension_rate': 20.0, 'pull_rate': 0.04}
    plain = config(line.port, **{**quick, **changes})
    return make_driver('dynamixel', robot(), plain, mode=mode, source='arm.yaml')


def running(line, mode='tension', maker=driver_for, seconds=0.25, **changes):
    """Give a driver that follows a command, and the command."""
    driver = maker(line, mode, **changes)
    driver.open()
    driver.enable()
    command = TENSION if mode == 'tension' else PULL
    cycle(driver, command, seconds)
    return driver, command


def refused(line, driver, words, kind=DriverError):
    """Check that the torque is refused in these words, and off."""
    with pytest.raises(kind, match=words):
        driver.enable()
    assert not any(servo.torque for servo in line.rig.servos.values())


def arm_in(mode, **changes):
    with line(slack=0.0) as made:  # the search for slack: test_dynamixel_start.py
        driver, command = running(made, mode, zero='here', **changes)
        yield driver, made, command
        driver.close()


def until(driver, command, wanted, seconds=SOON):
    """Cycle until the reading is as wanted; return it."""
    found = []
    readings = cycle(driver, command, seconds, until=lambda r: wanted(r) and not found.append(r))
    assert found, readings[-1]
    return found[0]


def watchdogs_trip(line):
    """Wait until nothing that came over the bus for too long has stopped every motor."""
    processes.until(lambda: all(servo.tripped for servo in line.rig.servos.values()))


def settled(driver, command):
    """Cycle until the arm stands still; return the last reading."""
    readings = [driver.read()]

    def still(reading):
        readings.append(reading)
        return (
            len(readings) > 20 and np.ptp([r.pulls for r in readings[-20:]], axis=0).max() < 1e-4
        )

    return until(driver, command, still)


def healthy(reading):
    return not reading.faults and np.isfinite(reading.pulls).all()


def arrive(driver, command, part):
    """Cycle until the arm is where it is told to be, up to a part of the largest command."""

    def there(reading):
        value = reading.tensions if driver.mode == 'tension' else reading.pulls
        return healthy(reading) and np.allclose(value, command, rtol=0.0, atol=part * max(command))

    until(driver, command, there)


def goals(line, name, since):
    return {
        i: [
            value
            for when, who, what, value in line.accepted
            if who == i and what == name and when >= since
        ]
        for i in (1, 2, 3, 4)
    }


def steps_are_small(line, driver, since):
    """Whether no goal jumped up further than the rates allow in 0.1 s, also across a fault."""
    name = 'goal_current' if driver.mode == 'tension' else 'goal_position'
    spool = driver.config.motors[0]
    if driver.mode == 'tension':
        most = 0.1 * driver.rates[0] * spool.calibration.mean.slope / spool.model.current_unit
    else:
        most = 0.1 * abs(spool.spool.ticks(driver.rates[0]))
    return all(
        np.diff(driver.motors[i].wires[0].spool.direction * np.array(values)).max(initial=0)
        <= most + 2
        for i, values in goals(line, name, since).items()
    )
