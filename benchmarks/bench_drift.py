"""
How soon a change of a simulated arm is told, what it is taken for, and how often without one.

A posture is the mean of thirty frames with 0.2 mm of noise each, as the monitor takes it, and
every tension is read 0.1 % wrong. The arm learns so many free postures; then it changes (or not)
and stands at random postures. Told means an alarm within 20 postures; named: the right change is
the most likely one then. The second part lets the arm stand for a simulated day, a posture every
four seconds.

example: python benchmarks/bench_drift.py --cases 20 --postures 2000
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from tendon_robot_ros.data import default_markers
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.monitoring.built_arm import BuiltArm
from tendon_robot_ros.monitoring.drift import DriftAlarm
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.simulation.imperfect import Workmanship
from tendon_robot_ros.simulation.measurements import SimulatedNoise
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

NOISE = SimulatedNoise(position=2e-4, setting=0.0, trial=0.001)
FRAMES = 30  # of the tracker, while the arm stands for half a second
REFERENCES, WITHIN = 60, 20
DAY_POSTURES = 24 * 900
HOURS = 1.0 / 900.0  # of a posture: one every four seconds


class Watch:
    """A simulated arm that is watched."""

    def __init__(self, name, seed):
        """Let it learn its reference postures."""
        self.robot, self.seed = load_robot(f'config/robots/{name}.yaml'), seed
        self.random = np.random.default_rng([seed, 3])
        self.markers = default_markers(self.robot)
        self.plant = self.made({})
        arm = BuiltArm(self.robot, load_catalogue(), self.markers, NOISE.position)
        self.remainder = arm.fit(*self.looked(self.plant, REFERENCES, 1), FRAMES)
        self.alarm = DriftAlarm(arm, DAY_POSTURES)

    def made(self, hidden):
        """Return this arm with something hidden."""
        return make_plant(self.robot, hidden, seed=self.seed, work=Workmanship())

    def looked(self, plant, count, which):
        """Return tensions (P, m) as read and markers (P, J, 3) as seen."""
        rows = default_postures(self.robot, count, 1000 * which + self.seed)
        rows = np.clip(rows, *self.robot.tension_limits)
        arcs = np.array([m.arc_length for m in self.markers])
        offsets = np.array([m.offset for m in self.markers])
        seen = plant.markers(rows, arcs, offsets)
        read = rows * (1.0 + NOISE.trial * self.random.normal(size=rows.shape))
        return read, seen + self.random.normal(0.0, NOISE.position / FRAMES**0.5, seen.shape)

    def stand(self, plant, count, which=2):
        """Stand at postures; return after how many there was an alarm (None), and the suspects."""
        first = None
        for i, (tensions, seen) in enumerate(zip(*self.looked(plant, count, which), strict=True)):
            state = self.alarm.update(tensions, seen, FRAMES)
            if state.alarm and first is None:
                first = i + 1
        return first, self.alarm.state.suspects


def changes(watch):
    """Yield what happens: name, the changed arm, names that are right."""
    robot = watch.robot
    cell = 1 + (2 * robot.cells) // 3 - watch.seed % 5
    soft = watch.made({'soft_cell': {'cell': cell, 'factor': 0.95}})
    yield 'a cell 5 % softer', soft, [f'stiffness of cell {cell + i}' for i in (-2, -1, 0, 1, 2)]
    yield '20 mN at the tip', watch.made({'tip_load': {'force_x': 0.02}}), ['tip_load']
    yield '2 mN at the tip', watch.made({'tip_load': {'force_x': 0.002}}), ['tip_load']
    gained = watch.made({})
    channel = watch.seed % len(robot.inputs)
    gained.built.gain[channel] += 0.02
    yield 'a gain 2 % off', gained, [f'gain of {robot.inputs[channel]}']
    bumped = watch.made({})
    bumped.built.position[0] += 1e-3
    yield 'the tracker 1 mm off', bumped, ['the tracker', 'base_misalignment']


def told(robot, cases):
    """Return a row for every change."""
    seen = {}
    for seed in range(cases):
        for name, plant, right in changes(Watch(robot, seed)):
            after, suspects = Watch(robot, seed).stand(plant, WITHIN)
            top = suspects[0].name if suspects else 'nothing'
            seen.setdefault(name, []).append((after, top, top in right))
    rows = []
    for name, all_ in seen.items():
        after = [a for a, *_ in all_ if a is not None]
        rows.append(
            {
                'change': name,
                f'told within {WITHIN} postures': f'{len(after)} of {len(all_)}',
                'postures, median of those told': float(np.median(after or [np.nan])),
                f'the likeliest after {WITHIN} is right': f'{sum(r for *_, r in all_)} of {cases}',
                'taken for': sorted({top for _, top, _ in all_}),
            }
        )
    return rows


def quiet(robot, postures):
    """Return the row of an arm that does not change."""
    watch, begin, alarms, left = Watch(robot, 0), time.process_time(), 0, postures
    while left > 0:
        count = min(left, 200)
        after, _ = watch.stand(watch.plant, count, 3 + left)
        left -= count
        if after is not None:
            alarms += 1
            watch.alarm.restart()
    return {
        'change': 'none',
        'simulated hours': postures * HOURS,
        'false alarms': alarms,
        'ms of a processor per posture': 1e3 * (time.process_time() - begin) / postures,
    }


def main():
    """Print the figures, and write them as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--robot', default='kato_10_1')
    parser.add_argument('--cases', type=int, default=20)
    parser.add_argument('--postures', type=int, default=DAY_POSTURES)
    parser.add_argument('--json', type=Path)
    args = parser.parse_args()
    rows = [*told(args.robot, args.cases), quiet(args.robot, args.postures)]
    print(json.dumps(rows, indent=1))
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))


if __name__ == '__main__':
    main()
