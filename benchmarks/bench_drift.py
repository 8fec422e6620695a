"""
How soon a change of a simulated arm is told, what it is taken for, and how often without one.

A posture is the mean of thirty frames with 0.2 mm of noise each, as the monitor takes it, and
every tension is read 0.1 % wrong. The arm learns so many free postures; then it changes (or not)
and stands at random postures. Told means an alarm within 20 postures. Then it is looked after:
the postures that separate what it may be are chosen, until one change is likely enough or twelve
are over; named: the right change is the likeliest one then (of a cell: that one or one within two
of it). Every draw is a line of FILE; begun again with the same FILE it goes on.

`--misread S`: a reference posture is off by S mm in some direction (the tracker wrong for once).
`--quiet N` lets an arm stand for N postures instead, one every four seconds; `--loaded`: with a
payload, which its description knows; `--exact`: built exactly as described; `--lacks EFFECT`: the
arm has half the usual size of an effect that its description lacks, with the `model_error` that
this makes.

example: python benchmarks/bench_drift.py --output drift.jsonl --cases 20
example: python benchmarks/bench_drift.py --output quiet.jsonl --robot spatial_3 --quiet 21600
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from bench_tip_force import knowing, lacking

from tendon_robot_ros.common.processes import one_thread
from tendon_robot_ros.data import default_markers
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.monitoring.built_arm import BuiltArm
from tendon_robot_ros.monitoring.change import TRACKER
from tendon_robot_ros.monitoring.watch import DriftAlarm
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.estimates import natural_sizes
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import SimulatedNoise
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

NOISE = SimulatedNoise(position=2e-4, setting=0.0, trial=0.001)
FRAMES = 30  # of the tracker, while the arm stands for half a second
REFERENCES, WITHIN, ASKED_MAX, OFFERED = 60, 20, 12, 40
DAY_POSTURES = 24 * 900
HOURS = 1.0 / 900.0  # of a posture: one every four seconds
LOAD_SHARE = 0.3  # of a force across the tip that bends the arm by a radian: the payload
TOLD_EVERY = 100  # postures of an arm that does not change, between two lines


class Watch:
    """A simulated arm that is watched."""

    def __init__(self, name, seed, loaded=False, misread=0.0, exact=False, lacks=None):
        """Let it learn its reference postures; one is off by so much [m]."""
        self.robot, self.seed = load_robot(f'config/robots/{name}.yaml'), seed
        self.robot, self.work = replace(self.robot, exact=exact), Workmanship().times(not exact)
        if loaded:
            force = LOAD_SHARE * natural_sizes(self.robot)['force']
            self.robot = self.robot.with_effect('tip_load', {'force_x': force})
        self.lacks = lacking(self.robot, lacks)
        if lacks:
            self.robot = knowing(self.robot, self.lacks)
        self.random = np.random.default_rng([seed, 3])
        self.markers = default_markers(self.robot)
        self.plant = self.made({})
        self.arm = BuiltArm(self.robot, load_catalogue(), self.markers, NOISE.position)
        read, seen = self.looked(self.plant, self.postures(REFERENCES, 1))
        wrong = np.random.default_rng([seed, 5])
        direction = wrong.normal(size=3)
        seen[wrong.integers(REFERENCES)] += misread * direction / np.linalg.norm(direction)
        self.arm.fit(read, seen, FRAMES)
        self.known = self.arm.mean.copy(), self.arm.covariance.copy()

    def made(self, hidden):
        """Return this arm with something hidden."""
        return make_plant(self.robot, self.lacks | hidden, seed=self.seed, work=self.work)

    def alarm(self):
        """Return an alarm that knows the reference postures."""
        return DriftAlarm(self.arm.as_known(*self.known), DAY_POSTURES)

    def postures(self, count, which):
        """Return tensions (count, m) [N]."""
        rows = default_postures(self.robot, count, 1000 * which + self.seed)
        return np.clip(rows, *self.robot.tension_limits)

    def looked(self, plant, rows):
        """Return tensions (P, m) as read and markers (P, J, 3) as seen."""
        arcs = np.array([m.arc_length for m in self.markers])
        offsets = np.array([m.offset for m in self.markers])
        seen = plant.markers(rows, arcs, offsets)
        read = rows * (1.0 + NOISE.trial * self.random.normal(size=rows.shape))
        return read, seen + self.random.normal(0.0, NOISE.position / FRAMES**0.5, seen.shape)

    def stand(self, alarm, plant, rows):
        """Stand at postures until there is an alarm; return after how many (None)."""
        for i, (tensions, seen) in enumerate(zip(*self.looked(plant, rows), strict=True)):
            if alarm.update(tensions, seen, FRAMES).alarm:
                return i + 1
        return None

    def look_after(self, finder, plant):
        """Ask the postures that separate the suspects; return the suspects, and how many asked."""
        suspects, offered = finder.suspects(), self.postures(OFFERED, 4)
        for asked in range(ASKED_MAX):
            best = finder.most_informative(offered)
            if best is None:
                return suspects, asked
            read, seen = self.looked(plant, offered[best : best + 1])
            finder.take(read[0], seen[0], FRAMES)
            suspects = finder.suspects()
        return suspects, ASKED_MAX


def changes(watch):
    """Yield what happens: name, the changed arm, names that are right."""
    robot, draw = watch.robot, np.random.default_rng([watch.seed, 9])
    cell = int(draw.integers(3, robot.cells - 1))
    soft = watch.made({'soft_cell': {'cell': cell, 'factor': 0.95}})
    yield 'a cell 5 % softer', soft, [f'stiffness of cell {cell + i}' for i in (-2, -1, 0, 1, 2)]
    for size in (0.02, 0.002):
        sign = float(draw.choice([-1.0, 1.0]))
        loaded = watch.made({'tip_load': {'force_x': sign * size}})
        yield f'{1e3 * size:g} mN at the tip', loaded, ['tip_load']
    gained, channel = watch.made({}), int(draw.integers(len(robot.inputs)))
    gained.built.gain[channel] += 0.02 * float(draw.choice([-1.0, 1.0]))
    yield 'a gain 2 % off', gained, [f'gain of {robot.inputs[channel]}']
    bumped = watch.made({})
    direction = draw.normal(size=3)
    bumped.built.position[:] += 1e-3 * direction / np.linalg.norm(direction)
    yield 'the tracker 1 mm off', bumped, [TRACKER]


def told(name, seed, have, misread, lacks):
    """Yield a row for every change of one arm that is not there yet."""
    watch = Watch(name, seed, misread=misread, lacks=lacks)
    for what, plant, right in changes(watch):
        if (name, seed, what) in have:
            continue
        begin, alarm = time.process_time(), watch.alarm()
        after = watch.stand(alarm, plant, watch.postures(WITHIN, 2))
        row = {
            'robot': name, 'seed': seed, 'change': what, 'told after': after,
            'widening': watch.arm.widening, 'left out': watch.arm.excluded,
        }  # fmt: skip
        if alarm.finder is not None:
            first = alarm.state.suspects[0].name
            suspects, asked = watch.look_after(alarm.finder, plant)
            row |= {
                'at once': first, 'at once right': first in right, 'asked': asked,
                'taken for': [[s.name, round(s.probability, 3)] for s in suspects[:3]],
                'right': suspects[0].name in right,
            }  # fmt: skip
        yield row | {'s': round(time.process_time() - begin, 2)}


def summary(rows):
    """Return a row for every robot and change."""
    made = []
    for key in dict.fromkeys((row['robot'], row['change']) for row in rows):
        own = [row for row in rows if (row['robot'], row['change']) == key]
        heard = [row for row in own if row['told after'] is not None]
        made.append({
            'robot': key[0], 'change': key[1],
            f'told within {WITHIN} postures': f'{len(heard)} of {len(own)}',
            'references left out': sum(len(row['left out']) for row in own),
            'widening, median': float(np.median([row['widening'] for row in own])),
            'after, median': float(np.median([r['told after'] for r in heard] or [np.nan])),
            'named at the alarm': sum(r['at once right'] for r in heard),
            'named after looking': sum(r['right'] for r in heard),
            'postures asked, median': float(np.median([r['asked'] for r in heard] or [np.nan])),
            'else taken for': sorted({r['taken for'][0][0] for r in heard if not r['right']}),
        })  # fmt: skip
    return made


def quiet(name, seed, loaded, exact, lacks, postures, path):
    """Let an arm stand that does not change; write how it goes."""
    watch, begin, alarms = Watch(name, seed, loaded, 0.0, exact, lacks), time.process_time(), 0
    alarm = watch.alarm()
    for done in range(0, postures, TOLD_EVERY):
        rows = watch.postures(TOLD_EVERY, 10 + done)
        while (after := watch.stand(alarm, watch.plant, rows)) is not None:
            alarms, rows = alarms + 1, rows[after:]
            alarm.restart()
        count = done + TOLD_EVERY
        row = {
            'robot': name, 'seed': seed, 'loaded': loaded, 'exact': exact, 'lacks': lacks,
            'model_error [mm]': 1e3 * (watch.robot.model_error or 0.0), 'postures': count,
            'simulated hours': count * HOURS, 'false alarms': alarms,
            'ms of a processor per posture': 1e3 * (time.process_time() - begin) / count,
        }  # fmt: skip
        write(path, row)
    print(json.dumps(row), flush=True)


def write(path, row):
    """Append a line."""
    with path.open('a') as file:
        file.write(json.dumps(row) + '\n')


def main():
    """Run what the file lacks, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--output', type=Path, required=True, metavar='FILE')
    parser.add_argument('--robot', nargs='+', default=['kato_10_1', 'spatial_3'])
    parser.add_argument('--cases', type=int, default=20, help='of each robot')
    parser.add_argument('--first', type=int, default=0, help='seed')
    parser.add_argument('--misread', type=float, default=0.0, metavar='MM', help='of a reference')
    parser.add_argument('--quiet', type=int, default=0, metavar='N', help='postures, no change')
    parser.add_argument('--loaded', action='store_true', help='with a payload that is known')
    parser.add_argument('--exact', action='store_true', help='an arm exactly as described')
    parser.add_argument('--lacks', metavar='EFFECT', help='of the arm, not of its description')
    args = parser.parse_args()
    with one_thread():
        if args.quiet:
            for name in args.robot:
                quiet(
                    name, args.first, args.loaded, args.exact, args.lacks, args.quiet, args.output
                )
            return
        lines = args.output.read_text().splitlines() if args.output.exists() else []
        rows = [json.loads(line) for line in lines]
        have = {(row['robot'], row['seed'], row['change']) for row in rows}
        for seed in range(args.first, args.first + args.cases):
            for name in args.robot:
                if sum(key[:2] == (name, seed) for key in have) == 5:
                    continue
                for row in told(name, seed, have, 1e-3 * args.misread, args.lacks):
                    rows.append(row)
                    write(args.output, row)
                    print(json.dumps(row), flush=True)
    print(json.dumps(summary(rows), indent=1))


if __name__ == '__main__':
    main()
