"""
How soon a stop acts on the motors, whatever it is that stops: worst of many trials.

    python benchmarks/bench_stop.py [--trials 200] [--busy 0] [--resume FILE] [--json FILE]

Real controller and driver, each a process, on emulated servos in another one; a target bends the
arm, then something stops it. The emulator tells when which motor got which current and what the
wires carried.

- `sent_ms`: until the cause has been sent: part of all that follows;
- `begun_ms`: from the cause until the first motor gets less current;
- `rest_ms`: until the current of every motor is that of pretension;
- `ended_ms`: until the process is gone that was asked to end;
- `unheard`: publishers whose `false` after the trial was not heard;
- `late`: trials with a motor above pretension after 100 ms;
- `failed`: stop commands that ended with another exit code than 0, or left a node that does not
  say `stopped`;
- `rise`: by how much a wire was tighter after the cause than at it [N];
- `stop command`: `python -m tendon_robot_ros stop` in a process of its own, from its start, while
  another process listens to the topic `stop`; it counts as late after 1 s;
- `stolen_ms`: processor time that other virtual machines had of this one meanwhile.

Motors whose port is gone get no command: they wait for their watchdog, then have no current, in
pull mode they hold (docs/dynamixel.md): no figure then but `rise`. The watchdog is short where the
driver runs in real time: not under `nice`. The wires pull springs: the model of
the mock arm (`--arm plant`) holds up the emulated servos now and then, which no motor does. A run
that was broken off goes on with the `--resume FILE` that it was given. One at a time: several
chains in real time on two cores are in each other's way.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from chain import Chain, Load
from emulated_bus import ROBOTS, driver_for
from machine import machine, stolen, tell
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool

from tendon_robot_ros.common.processes import go_realtime

FINGER = 2  # priority of the person who stops: no part of what is measured
SOON = 0.1  # [s]
COMMAND_LATE = 1.0  # [s] a process starts
COMMAND_S = 30.0  # [s] that it may take to end
LISTENER = """
import sys, rclpy
from std_msgs.msg import Bool
rclpy.init()
node = rclpy.create_node('listener', namespace=sys.argv[1])
node.create_subscription(Bool, 'stop', lambda _: None, 10)
rclpy.spin(node)
"""
LEAST = {'tension': 0.8, 'pull': 0.0045}  # [N], [m] before a stop
BEFORE = 0.1  # [s] of the trace before the cause
AFTER = 0.45  # [s] of the trace after the cause
ENDED = 2.0  # [s] that a process may take to end
TRIES = 3
ARMS = 'kato_10_1', 'spatial_3', 'spatial_6'
SETTLE = 0.3  # [s] in which it must have stood still before a stop
STILL = {'tension': 0.05, 'pull': 2e-4}  # [N], [m]
SETTLED = 5.0  # [s] that it may take to stand still
FALLEN = 0.97  # of the current before: the release has begun
SEEN = 0.02  # [s] at least so often
NEAR = 0.03  # [N], four counts of current: at pretension
FIGURES = 'from', 'sent_ms', 'begun_ms', 'rest_ms', 'rise', 'ended_ms', 'stolen_ms'


class Stops:
    """The causes; each method stops the arm and returns when it did [s], its undoing is beside."""

    def __init__(self, chain):
        self.chain, self.user = chain, chain.user
        kinds = [(r, d) for r in ReliabilityPolicy for d in DurabilityPolicy]
        wanted = ('RELIABLE', 'BEST_EFFORT'), ('VOLATILE', 'TRANSIENT_LOCAL')
        self.publishers = {
            f'{r.name} {d.name}': self.user.create_publisher(
                Bool, 'stop', QoSProfile(depth=1, reliability=r, durability=d)
            )
            for r, d in kinds
            if r.name in wanted[0] and d.name in wanted[1]
        }
        self.listener, self.failed = None, []
        self.turn, self.unheard = -1, []  # kinds of publishers whose false was not heard at once

    def topic(self):
        self.turn += 1
        publisher = list(self.publishers.values())[self.turn % 4]
        now = time.monotonic()
        publisher.publish(Bool(data=True))
        return now

    def topic_off(self):
        """Take it back, as often as it takes: of best effort a word may be lost."""
        for _ in range(TRIES):
            for publisher in self.publishers.values():
                publisher.publish(Bool(data=False))
            if self.user.until(lambda: self.user.call('driver/reset', 3.0), 1.0):
                return
            self.unheard.append(list(self.publishers)[self.turn % 4])

    def _service(self, name):
        client = self.user.ready(name)
        now = time.monotonic()
        client.call_async(client.srv_type.Request())
        return now

    def service_of_driver(self):
        return self._service('driver/stop')

    def service_of_controller(self):
        return self._service('controller/stop')

    def _signal(self, name, number):
        now = time.monotonic()
        self.chain.signal(name, number)
        return now

    def sigint(self):
        return self._signal('driver', signal.SIGINT)

    def sigterm(self):
        return self._signal('driver', signal.SIGTERM)

    def driver_again(self):
        self.chain.again('driver')

    def ended_controller(self):
        return self._signal('controller', signal.SIGINT)

    def controller_after_end(self):
        self.chain.again('controller')

    def killed_controller(self):
        return self._signal('controller', signal.SIGKILL)

    def controller_again(self):
        self.chain.again('controller', -signal.SIGKILL)

    def pulled_port(self):
        now = time.monotonic()
        self.chain.servos.say('unplug')
        return now

    def plug(self):
        self.chain.servos.say('plug')

    def stop_command(self):
        """Have a process of its own stop the arm, and wait for its end."""
        if self.listener is None:
            self.listener = subprocess.Popen([sys.executable, '-c', LISTENER, self.chain.space])
        now = time.monotonic()
        command = [sys.executable, '-m', 'tendon_robot_ros', 'stop']
        said = subprocess.Popen(
            [*command, '--namespace', self.chain.space],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.user.until(lambda: said.poll() is not None, COMMAND_S)
        text = said.communicate()[0].strip()
        codes = {name: self.user.code(name) for name in ('driver', 'controller')}
        listens = self.listener.poll() is None
        if said.returncode or set(codes.values()) != {'stopped'} or not listens:
            self.failed.append(f'exit code {said.returncode}, {codes}: {text}')
        return now

    def close(self):
        if self.listener is not None:
            self.listener.kill()
            self.listener.wait()

    def nothing(self):
        """Services need no undoing but a reset."""


KINDS = {
    'any publisher': (Stops.topic, Stops.topic_off),
    'service of the driver': (Stops.service_of_driver, Stops.nothing),
    'service of the controller': (Stops.service_of_controller, Stops.nothing),
    'SIGINT of the driver': (Stops.sigint, Stops.driver_again),
    'SIGTERM of the driver': (Stops.sigterm, Stops.driver_again),
    'SIGINT of the controller': (Stops.ended_controller, Stops.controller_after_end),
    'killed controller': (Stops.killed_controller, Stops.controller_again),
    'pulled port': (Stops.pulled_port, Stops.plug),
    'stop command': (Stops.stop_command, Stops.nothing),
}
LATE = {'stop command': COMMAND_LATE}  # [s] instead of `SOON`
ENDS = {'SIGINT of the driver': 'driver', 'SIGTERM of the driver': 'driver',
        'SIGINT of the controller': 'controller'}  # fmt: skip


class Scale:
    """Turns the currents of the motors into the tensions that the driver means by them."""

    def __init__(self, chain):
        driver = driver_for(chain.servos, chain.mode, chain.robot)
        wires = driver.config.motors
        self.lines = [(wire.calibration.mean, wire.spool.direction) for wire in wires]
        self.rest = driver.robot.tension_limits[0]

    def __call__(self, currents):
        rows = [
            (way * currents[:, i] - line.intercept) / line.slope
            for i, (line, way) in enumerate(self.lines)
        ]
        return np.array(rows).T


def judge(trace, cause, scale):
    """Return the figures of one trial; None: not held when it was stopped, or not well seen."""
    if not trace:
        return None
    times = np.array([moment[0] for moment in trace]) - cause
    tensions = scale(np.array([moment[1] for moment in trace]))
    wires = np.array([moment[2] for moment in trace])
    before = tensions[times <= 0.0]
    if (
        not len(before)
        or before[-1].max() < LEAST['tension']
        or np.ptp(before, axis=0).max() > 0.2
    ):
        return None
    start = before[-1]
    pulling = start > scale.rest + 5.0 * NEAR
    later = times > 0.0
    if not later.any() or np.diff(times[times > -SEEN]).max() > SEEN or times[-1] < SOON:
        return None
    fallen = later & np.any(tensions[:, pulling] < FALLEN * start[pulling], axis=1)
    high = later & np.any(tensions > scale.rest + NEAR, axis=1)
    return {
        'from': float(start.max()),
        'begun_ms': 1e3 * float(times[fallen][0]) if fallen.any() else np.inf,
        'rest_ms': np.inf if high[-1] else 1e3 * float(times[high].max(initial=0.0)),
        'rise': float((wires[later].max(axis=0) - wires[~later][-1]).max()),
    }


def settled(user, within):
    """Wait until the arm stands: with wire lengths that takes longer than with tensions."""
    end = time.monotonic() + SETTLED
    while time.monotonic() < end:
        before = user.values()
        user.spin(SETTLE)
        if np.abs(np.subtract(user.values(), before)).max() < within:
            return True
    return False


def trial(chain, stops, kind, scale, number):
    """Bend the arm, stop it, look; return the figures or None."""
    stop, undo = KINDS[kind]
    held = chain.up(chain.targets[number % len(chain.targets)], LEAST[chain.mode])
    held = held and settled(chain.user, STILL[chain.mode])
    before = stolen()
    cause = stop(stops)
    sent, ended = time.monotonic() - cause, np.nan
    if kind in ENDS:
        chain.user.until(lambda: not chain.nodes[ENDS[kind]].runs, ENDED)
        ended = 1e3 * (time.monotonic() - cause)
    chain.user.spin(max(0.0, cause + AFTER - time.monotonic()))
    trace = chain.servos.ask(f'trace {time.monotonic() - cause + BEFORE}')
    lost = 1e3 * (stolen() - before)
    undo(stops)
    if not held:
        return None
    found = judge(trace, cause, scale)
    if found is None:
        return None
    if found['rest_ms'] > 1e3 * LATE.get(kind, SOON):  # to find out why: [ms] and currents [A]
        found['trace'] = [[round(1e3 * (at - cause), 1), amperes] for at, amperes, *_ in trace]
    return {**found, 'sent_ms': 1e3 * sent, 'ended_ms': ended, 'stolen_ms': lost}


def measure(args, rows):
    """Make all trials that are not there yet; kinds take turns: each meets the same machine."""
    skipped = dict.fromkeys(args.kinds, 0)
    load = Load(args.busy)
    servos = {} if args.watchdog is None else {'watchdog': args.watchdog}
    chain = Chain(
        args.logs, args.mode, args.arm, servos, args.robot, stop_time=args.stop_time,
        command_timeout=args.command_timeout,
    )  # fmt: skip
    go_realtime(FINGER)
    try:
        stops, scale = Stops(chain), Scale(chain)
        end = time.monotonic() + 60.0 * args.minutes
        for number in range(args.trials):
            for kind in args.kinds:
                if rows.has(kind, number) or time.monotonic() > end:
                    continue
                got = several(chain, stops, kind, scale, number)
                if got is None:
                    skipped[kind] += 1
                else:
                    rows.add({'kind': kind, 'number': number, **got})
        return skipped, {
            'died': chain.died,
            'unheard': stops.unheard,
            'failed': stops.failed,
        }
    finally:
        stops.close()
        load.end()
        chain.close()


def several(chain, stops, kind, scale, number):
    """Try until the arm was held when it was stopped, and seen."""
    for _ in range(TRIES):
        got = trial(chain, stops, kind, scale, number)
        if got is not None:
            return got
    return None


class Rows:
    """Trials, each a line of JSON in a file; those of an earlier run count."""

    def __init__(self, file):
        self.file = file
        file.parent.mkdir(parents=True, exist_ok=True)
        lines = file.read_text().splitlines() if file.exists() else []
        self.rows = [json.loads(line) for line in lines]

    def has(self, kind, number):
        return any(row['kind'] == kind and row['number'] == number for row in self.rows)

    def add(self, row):
        self.rows.append(row)
        with self.file.open('a') as file:
            file.write(json.dumps(row) + '\n')

    def of(self, kind):
        return [row for row in self.rows if row['kind'] == kind]


def summary(rows, holds=False, late=SOON):
    if not rows:
        return {'trials': 0, 'late': 0}
    columns = {key: np.array([row.get(key, np.nan) for row in rows]) for key in FIGURES}
    figures = {'trials': len(rows), 'highest': round(float(columns['from'].max()), 2)}
    for key in ('sent_ms', 'stolen_ms') if holds else FIGURES[1:4] + FIGURES[5:]:
        values = columns[key][~np.isnan(columns[key])]
        if len(values):
            p50, p99, worst = np.percentile(values, [50, 99, 100], method='higher')
            figures |= {
                key: {'p50': round(p50, 1), 'p99': round(p99, 1), 'worst': round(worst, 1)}
            }
    figures['late'] = 0 if holds else int(np.sum(columns['rest_ms'] > 1e3 * late))
    figures['rise'] = round(float(columns['rise'].max()), 3)
    return figures


def table(found):
    """Return the figures as a short table: at pretension after so many milliseconds."""
    lines = [f'{"what stops":27s} trials   half    p99  worst  late']
    for kind, figures in found.items():
        if 'rest_ms' in figures:
            rest = '{p50:7.1f}{p99:7.1f}{worst:7.1f}'.format(**figures['rest_ms'])
            lines.append(f'{kind:27s}{figures["trials"]:7d}{rest}{figures["late"]:6d}')
    return '\n'.join(lines)


def read_arguments():
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--trials', type=int, default=200)
    parser.add_argument('--minutes', type=float, default=1e6, help='stop after so long')
    parser.add_argument('--busy', type=int, default=0, help='busy processes beside it')
    parser.add_argument('--stop-time', type=float, default=0.06, help='[s]')
    parser.add_argument('--mode', default='tension', choices=tuple(LEAST))
    parser.add_argument('--robot', default='kato_10_1', choices=ARMS)
    parser.add_argument('--arm', default='springs', choices=('plant', 'springs'))
    parser.add_argument('--command-timeout', type=float, default=0.1, help='[s]')
    parser.add_argument('--watchdog', type=float, help="[s] of the motors; default: the driver's")
    parser.add_argument('--kinds', nargs='+', default=list(KINDS), choices=list(KINDS))
    parser.add_argument('--logs', type=Path, default=Path(tempfile.gettempdir(), 'bench_stop'))
    parser.add_argument('--resume', type=Path, help='file of trials: read first, then added to')
    parser.add_argument('--json', type=Path)
    args = parser.parse_args()
    args.robot = ROBOTS / f'{args.robot}.yaml'
    args.rows = args.resume or args.logs / f'trials_{os.getpid()}.jsonl'
    return args


def main():
    args = read_arguments()
    begun, rows = os.getloadavg(), Rows(args.rows)
    skipped, other = measure(args, rows)
    holds = {'pulled port'} if args.mode == 'pull' else ()
    found = {
        kind: summary(rows.of(kind), kind in holds, LATE.get(kind, SOON)) for kind in args.kinds
    }
    result = {
        **machine(),
        'load_average': [round(begun[0], 1), round(os.getloadavg()[1], 1)],
        'busy processes': args.busy,
        'stop_time': args.stop_time,
        'robot': args.robot.stem,
        'mode': args.mode,
        'arm': args.arm,
        'command_timeout': args.command_timeout,
        'watchdog': args.watchdog or 'default',
        **other,
        **{kind: {**figures, 'not held': skipped[kind]} for kind, figures in found.items()},
    }
    tell(result, args.json)
    print(table(found))
    return (
        1
        if other['died'] or other['failed'] or any(figures['late'] for figures in found.values())
        else 0
    )


if __name__ == '__main__':
    raise SystemExit(main())
