"""
Try what other programs leave in motors, on the port and on the bus: and count what is mastered.

    python benchmarks/bench_registers.py [--trials 200] [--first 0] [--seed 1] [--json FILE]

Emulated servos of a planar arm with four wires and of a spatial one with six, on springs, in
tension and in pull mode, in turn. Each trial draws its values at random, from the seed and its
own number (`--first` goes on from there), and counts as good when what the table below says came
true. A trial that does not says what was seen instead. Target: all of them.
"""

import argparse
import collections
import json
import os
import random
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
from emulated_bus import ROBOTS
from machine import machine, tell

from tendon_robot_ros.common.errors import DriverError
from tendon_robot_ros.drivers import make_driver
from tendon_robot_ros.drivers.dynamixel.bus import Port
from tendon_robot_ros.drivers.dynamixel.control_table import GAINS, MODELS, REGISTERS
from tendon_robot_ros.drivers.dynamixel.servos import SETTINGS
from tendon_robot_ros.emulator.bus import EmulatedBus, status
from tendon_robot_ros.emulator.rig import Rig, SpringArm, Wire
from tendon_robot_ros.emulator.servo import Servo
from tendon_robot_ros.robot import load_robot

ARMS = {'planar': 'kato_10_1', 'spatial': 'spatial_6'}
MODEL, RADIUS, STIFFNESS = 'XL330-M077', 0.02, 400.0  # spools [m], springs [N/m]
WOUND_ON_M = 5e-4  # [m] of wire that a motor without power may turn by itself
SETTLED_S = 1.0  # [s] in which a wire has been wound as far as its motor can
SEEN_S = 20.0  # [s], a generous end of every wait
SHARE = 0.1  # of the command limit that the wires are under


class Trial:
    """One emulated arm, and what is done to it."""

    def __init__(self, arm, mode, draw):
        robot, self.mode, self.draw = load_robot(ROBOTS / f'{ARMS[arm]}.yaml'), mode, draw
        ids = range(1, len(robot.inputs) + 1)
        springs = SpringArm(np.full(len(ids), STIFFNESS), np.full(len(ids), 1e-3))
        self.line = EmulatedBus(
            Rig([Servo(MODELS[MODEL], i) for i in ids], [Wire(i, RADIUS) for i in ids], springs)
        )
        self.config = {
            'port': self.line.port,
            'model': MODEL,
            'spool_radius': RADIUS,
            'answer_time': 0.05,
            'watchdog': 2.0,
            'zero': 'here',
            'home_speed': 0.04,
            'pull_limits': [-0.01, 0.02],
            'motors': {name: {'id': i} for name, i in zip(robot.inputs, ids, strict=True)},
        }
        self.robot, self.one = robot, draw.choice(list(ids))
        self.seen = ''  # the last message or measurement: tells why a trial is not good

    def driver(self, **changes):
        return make_driver('dynamixel', self.robot, {**self.config, **changes}, mode=self.mode)

    def leave(self):
        """Write random values into all registers that the driver sets, of every motor."""
        for servo in self.line.rig.servos.values():
            for setting in SETTINGS:
                if not setting.refused:
                    top = min(2 ** (8 * REGISTERS[setting.name].size), 1000)
                    servo.put(setting.name, self.draw.randrange(top))
            for name in GAINS:
                servo.put(name, self.draw.randrange(1000))

    def registers(self):
        """All are as they must be, and wires follow as if nothing had been there."""
        self.leave()
        with self.driver() as driver:
            driver.enable()
            return self.follows(driver) and all(
                servo.get(s.name) == s.value
                for servo in self.line.rig.servos.values()
                for s in SETTINGS
                if s.value is not None and s.name != 'bus_watchdog'
            )

    def refused(self):
        """Refuse a setting that is the person's, by name."""
        setting = self.draw.choice([s for s in SETTINGS if s.refused])
        self.line.servo(self.one).put(setting.name, self.draw.choice([1, 4, 8, 5]))
        words = setting.name.replace('_', ' '), f'(id {self.one})'
        return all(word in self.refusal() for word in words)

    def power_cut(self):
        """Switch a motor off that comes back with its torque on, before it winds anything on."""
        self.leave()
        with self.driver() as driver:
            driver.enable()
            if not self.follows(driver):
                return False
            settled = time.monotonic() + SETTLED_S
            self.cycle(driver, lambda _: time.monotonic() > settled)
            servo, place = self.line.servo(self.one), self.one - 1
            servo.put('startup_configuration', 1)
            before, rig = self.line.rig.wound[place], self.line.rig
            rig.most[:] = rig.wound
            with self.line._lock:
                self.line.booting[self.one] = time.monotonic() + self.draw.random()
                rig.rebooted(self.one)
            said = self.cycle(driver, lambda r: any(f.code == 'restarted' for f in r.faults))
            return said and not servo.torque and rig.most[place] < before + WOUND_ON_M

    def held_port(self):
        """Another program that has the port open is named."""
        with open(self.line.port, 'rb', buffering=0) as port:
            holder = subprocess.Popen(['sleep', '60'], stdin=port)
        told = self.refusal()
        holder.kill()
        holder.wait()
        return f'(process {holder.pid}: sleep' in told

    def second_talker(self):
        """Answers that nobody asked for are blamed, not the servo that is not there."""
        ending = threading.Event()

        def chatter():
            while not ending.wait(self.draw.uniform(0.005, 0.05)):
                with self.line._lock:
                    os.write(self.line._master, status(200, 0, bytes(4)))

        talker = threading.Thread(target=chatter)
        talker.start()
        self.line.silent.add(self.one)
        told = self.refusal()
        ending.set()
        talker.join()
        return 'bytes come that nobody here has asked for' in told

    def held_back(self):
        """Find no zero where something else than its wire holds a motor back."""
        name, value = self.draw.choice(
            [('goal_pwm', 20), ('position_p_gain', 0), ('profile_velocity', 1)]
        )
        with self.driver(zero='find') as driver:
            driver.cancelled = lambda: self.line.servo(self.one).put(name, value)
            try:
                driver.enable()
            except DriverError as error:
                self.seen = f'{name} {value} of id {self.one}: {error}'
                return driver.motors[self.one].zero is None and f'(id {self.one})' in str(error)
            self.seen = f'{name} {value} of id {self.one}: a zero was found'
            return False

    def follows(self, driver):
        return self.cycle(driver, self.near)

    def near(self, reading):
        values = reading.tensions if self.mode == 'tension' else reading.pulls
        return not reading.faults and np.allclose(values, self.command, atol=SHARE * self.high)

    def cycle(self, driver, until):
        self.high = driver.limits[0, 1]
        self.command = np.full(len(driver.inputs), 0.4 * self.high)
        end = time.monotonic() + SEEN_S
        while time.monotonic() < end:
            driver.write(self.command)
            reading = driver.read()
            if until(reading):
                return True
            time.sleep(0.005)
        values = reading.tensions if self.mode == 'tension' else reading.pulls
        faults = '; '.join(fault.message for fault in reading.faults)
        self.seen = f'commanded {self.command[0]:g}, measured {values.round(4)}; {faults}'
        return False

    def refusal(self, **changes):
        driver = self.driver(**changes)
        try:
            driver.open()
        except DriverError as error:
            self.seen = str(error)
            return self.seen
        driver.close()
        return ''


CASES = {
    'registers left': Trial.registers,
    'settings refused': Trial.refused,
    'power cut, torque on after it': Trial.power_cut,
    'port held by another program': Trial.held_port,
    'second talker on the bus': Trial.second_talker,
    'held back while looking for slack': Trial.held_back,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--trials', type=int, default=200)
    parser.add_argument('--first', type=int, default=0)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--json', type=Path)
    args = parser.parse_args()
    good, all_ = collections.Counter(), collections.Counter()
    kinds = [(case, arm, mode) for case in CASES for arm in ARMS for mode in ('tension', 'pull')]
    kinds = [kind for kind in kinds if kind[0] != list(CASES)[-1] or kind[2] == 'pull']
    for number in range(args.first, args.first + args.trials):
        kind = kinds[number % len(kinds)]
        trial = Trial(kind[1], kind[2], random.Random(f'{args.seed} {number}'))
        Port.clock = staticmethod(lambda line=trial.line: line.lived)  # its own time
        with trial.line:
            mastered = CASES[kind[0]](trial)
        all_[kind] += 1
        good[kind] += mastered
        if not mastered:
            print(f'trial {number}: {", ".join(kind)}: {trial.seen}', flush=True)
    rows = {', '.join(kind): f'{good[kind]} of {all_[kind]}' for kind in kinds}
    given = {'trials': args.trials, 'first': args.first, 'seed': args.seed}
    tell({**machine(), **given, **rows}, args.json)
    print(json.dumps({case: f'{sum(good[k] for k in kinds if k[0] == case)} of '
                            f'{sum(all_[k] for k in kinds if k[0] == case)}' for case in CASES},
                     indent=1))  # fmt: skip
    return 0 if good == all_ else 1


if __name__ == '__main__':
    raise SystemExit(main())
