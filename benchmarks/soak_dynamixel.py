"""
Run the Dynamixel driver at 100 Hz for a long time while the emulated bus keeps breaking.

    python benchmarks/soak_dynamixel.py [--minutes 30] [--seed 1] [--mode tension] [--at-limit]

Supervisor, motor loop and driver are those of the driver node; servos run in another process.
With `--at-limit` one wire after the other is commanded to its tension limit, or 20 mm in pull
mode, where the motors then hold at their current; how often a motor is at its largest current,
and a wire pulls more than that and dry friction hold (docs/dynamixel.md), is counted. `--robot`
takes another arm. Targets: it follows at least half the time; no current is ever above its limit,
and no wire pulls more than that holds, but for the drag of a motor that it turns; nothing crashes;
no thread, file descriptor or memory is lost.
"""

import argparse
import collections
import json
import math
import os
import random
import sys
import threading
import time
from pathlib import Path

import numpy as np
from bench_dynamixel import rules
from emulated_bus import ROBOT, Passings, driver_for, emulator, strongest

from tendon_robot_ros.common.errors import DriverError
from tendon_robot_ros.drivers.safety import FOLLOWING, Supervisor
from tendon_robot_ros.drivers.serial_port import PortLink
from tendon_robot_ros.robot.estimates import SAME_TENSION_N
from tendon_robot_ros.ros.driver.motor_loop import MotorLoop

PERIOD = 0.01  # [s]
BETWEEN = 5.0  # [s] from fault to fault, on average
BACK = 2.0  # [s] in which the driver takes a port that is there again
NEAR = 0.1  # of the range of the command: what counts as following
SETTLED = 20.0  # [s] before memory is looked at
HARD_PULL_M = 0.02  # [m] of wire that no arm here gives below its limit
MORE_MEMORY = 20.0  # [MB] that may come and go


def resident():
    """Return the memory of this process [MB]."""
    with open('/proc/self/statm', encoding='ascii') as file:
        return int(file.read().split()[1]) * os.sysconf('SC_PAGE_SIZE') / 1e6


def resources():
    return {'threads': threading.active_count(), 'files': len(os.listdir('/proc/self/fd'))}


class Breaker:
    """Breaks something at random, and mends it."""

    def __init__(self, servos, bus, seed):
        self.servos, self.bus, self.random = servos, bus, random.Random(seed)
        self.done = collections.Counter()
        self.ids = sorted({motor['id'] for motor in servos.content()['motors'].values()})
        self.gone = 0.0  # [s] until when the driver may be without its port

    def wait(self):
        time.sleep(self.random.uniform(0.05, 1.5))

    def strike(self):
        name = self.random.choice(sorted(KINDS))
        self.done[name] += 1
        KINDS[name](self, self.random.choice(self.ids))

    def for_a_while(self, broken, mended):
        unplugs = broken == 'unplug'
        self.gone = math.inf if unplugs else self.gone
        self.servos.say(broken)
        self.wait()
        self.servos.say(mended)
        self.gone = time.monotonic() + BACK if unplugs else self.gone

    def second(self, _):
        link = PortLink(self.servos.port, 1_000_000)
        try:
            link.open()
        except DriverError:
            return
        link.close()
        if time.monotonic() > self.gone:
            raise AssertionError('a second user got the port')


def _say(pattern):
    return lambda breaker, i: breaker.servos.say(
        pattern.format(i=i, n=breaker.random.randint(1, 30))
    )


def _pair(broken, mended):
    def break_(breaker, i):
        every = ' '.join(map(str, breaker.ids))
        breaker.for_a_while(broken.format(i=i, all=every), mended.format(i=i, all=every))

    return break_


KINDS = {
    'silent': _pair('silent {i}', 'hear {i}'),
    'all silent': _pair('silent {all}', 'hear {all}'),
    'spoilt': _say('spoil {n}'),
    'cut': _say('cut {n}'),
    'doubled': _say('double {n}'),
    'slow': _pair('slow 0.03', 'slow 0'),
    'unplugged': _pair('unplug', 'plug'),
    'overload': _say('overload {i}'),
    'overheating': _say('overheating {i}'),
    'hot': _pair('hot {i} 67', 'hot {i} 30'),
    'low voltage': _pair('volts 2.9', 'volts 5'),
    'power lost': _say('restart {i}'),
    'tripped': _say('trip {i}'),
    'busy process': lambda breaker, i: breaker.bus.call(lambda: time.sleep(0.3)),
    'second process': Breaker.second,
}


class Watcher:
    """Counts the cycles in which the arm follows."""

    def __init__(self, driver, at_limit=False):
        self.driver, self.at_limit = driver, at_limit
        self.cycles = self.following = 0
        self.command = self.wave(0.0)

    def wave(self, now):
        """Return tensions [N] about a quarter of the limit, or pulls [m] of antagonists."""
        if self.at_limit:
            return self.pull_hard(now)
        wires = np.arange(len(self.driver.inputs))  # two by two on the two sides
        phase = 2.0 * np.pi * (0.2 * now + 0.25 * (wires // 2))
        side = 1.0 - 2.0 * (wires % 2)
        if self.driver.mode == 'pull':
            self.command = 0.008 * np.sin(phase) * side
        else:
            self.command = 0.25 * self.driver.limits[:, 1] * (1.0 + 0.15 * side * np.sin(phase))
        return self.command

    def pull_hard(self, now):
        """Command one wire after the other to the limit, for two seconds each."""
        chosen = int(0.5 * now) % len(self.driver.inputs)
        low, high = self.driver.limits.T
        if self.driver.mode == 'pull':
            low, high = np.zeros_like(high), np.minimum(high, HARD_PULL_M)
        self.command = np.where(np.arange(len(low)) == chosen, high, low)
        return self.command

    def __call__(self, cycle):
        self.cycles += 1
        reading = cycle.reading
        measured = reading.tensions if self.driver.mode == 'tension' else reading.pulls
        near = np.nanmax(np.abs(measured - self.command), initial=0.0)
        near = near < NEAR * np.ptp(self.driver.limits[0]) and np.isfinite(measured).all()
        self.following += bool(cycle.decision.state == FOLLOWING and near)


def operate(bus):
    """Do what a person does with a released arm: reboot what reports an error, then reset."""
    faults = bus._last.faults
    broken = [n for f in faults if f.hardware and f.code != 'restarted' for n in f.inputs]
    try:
        if broken:
            bus.call(lambda: bus.driver.reboot(broken))
        bus.call(bus.supervisor.reset)
    except DriverError:
        pass  # the cause is still there


def run(args):
    with emulator(args.robot) as servos:
        driver = driver_for(servos, args.mode, args.robot)
        passings = Passings(servos, driver)
        before = resources()
        driver.open()
        watcher = Watcher(driver, args.at_limit)
        bus = MotorLoop(driver, Supervisor(rules(driver)), PERIOD, watcher)
        bus.start()
        bus.call(lambda: None)
        bus.call(bus._enable, 60.0)
        breaker = Breaker(servos, bus, args.seed)
        begin = time.monotonic()
        memory = []
        strike = threading.Thread(target=lambda: None)
        due = begin + breaker.random.expovariate(1.0 / BETWEEN)
        while (now := time.monotonic()) < begin + 60.0 * args.minutes and bus.crashed is None:
            bus.put(watcher.wave(now))
            if now > due and not strike.is_alive():
                strike = threading.Thread(target=breaker.strike)
                strike.start()
                due = now + breaker.random.expovariate(1.0 / BETWEEN)
            let_go = bus.supervisor.latch or bus.supervisor.held
            if let_go and watcher.cycles % 10 == 0:
                operate(bus)
            passings.look(now)
            if now - begin > SETTLED and watcher.cycles % 100 == 0:
                memory.append(resident())
            time.sleep(PERIOD)
        strike.join()
        passings.look()
        found = {**judge(servos, bus, watcher, breaker, memory), **passings.told()}
        bus.close()
        after = resources()
        found['lost'] = {name: after[name] - before[name] for name in before}
    return found


def too_strong(state, driver):
    """Return goal currents beyond what the driver may give, and wires beyond what that holds."""
    beyond, most = [], strongest(driver)
    if max(state['held']) > most + SAME_TENSION_N:
        beyond.append(f'{max(state["held"]):.3f} N held, motors hold {most:.3f} N')
    for key, (low, high) in state['extremes'].items():
        identity, register = key.split()
        most = driver.motors[int(identity)].strongest
        if register == 'goal_current' and not -most <= low <= high <= most:
            beyond.append(f'{key}: {low} to {high}')
    return beyond


def judge(servos, bus, watcher, breaker, memory):
    driver = bus.driver
    name = 'goal_current' if driver.mode == 'tension' else 'goal_position'
    state = servos.ask('state')
    beyond = too_strong(state, driver)
    for key, (low, high) in state['extremes'].items():
        identity, register = key.split()
        motor = driver.motors[int(identity)]
        if register == name == 'goal_position' and motor.zero is not None:
            least, most = motor.position_bounds
            slack = motor.wires[0].spool.ticks(driver.config.home_travel)
            if not least - abs(slack) <= low <= high <= most + abs(slack):
                beyond.append(f'{key}: {low} to {high}')
    quarter = max(1, len(memory) // 4)
    grown = np.median(memory[-quarter:]) - np.median(memory[:quarter]) if memory else 0.0
    return {
        'following': watcher.following / max(1, watcher.cycles),
        'cycles': watcher.cycles,
        'faults': dict(breaker.done),
        'beyond limits': beyond,
        'held by the motors [N]': round(max(state['held']), 3),
        'crashed': repr(bus.crashed) if bus.crashed else None,
        'emulator crashed': servos.process.poll() is not None,
        'memory grown [MB]': float(grown),
    }


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--minutes', type=float, default=30.0)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--mode', choices=('tension', 'pull'), default='tension')
    parser.add_argument('--robot', type=Path, default=ROBOT)
    parser.add_argument('--at-limit', action='store_true')
    parser.add_argument('--json', metavar='FILE')
    args = parser.parse_args(arguments)
    found = run(args)
    text = json.dumps(found, indent=1)
    print(text)
    if args.json:
        with open(args.json, 'w', encoding='utf-8') as file:
            file.write(text)
    good = (
        (found['following'] >= 0.5 or args.at_limit)  # a wire at its limit is near no command
        and not found['beyond limits']
        and not found['crashed']
        and not found['emulator crashed']
        and not any(found['lost'].values())
        and found['memory grown [MB]'] < MORE_MEMORY
    )
    return 0 if good else 1


if __name__ == '__main__':
    sys.exit(main())
