"""
A contact along the arm, told live: onset, place and false alarms, on simulated arms as built.

The monitor's estimates at `force_rate` from 30 frames a second. Touched: the arm rests at a
posture when a force (`point_load`) or a ball (`contact`) begins to push at a place beyond a fifth
of the arm, and moves its markers by up to so much of its length. Free: the arm moves from posture
to posture, rests there, and nothing may be told. `told` is significant, as the topic says it.

example: python benchmarks/bench_contact.py --cases 40 --minutes 30
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from bench_tip_force import NOISE_M, ROBOTS

from tendon_robot_ros.common.errors import NoEquilibriumError
from tendon_robot_ros.common.processes import one_thread
from tendon_robot_ros.data import default_markers
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.monitoring.built_arm import BuiltArm
from tendon_robot_ros.monitoring.contact import ContactObserver
from tendon_robot_ros.monitoring.monitor import FrameMean
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.estimates import INPUT_TOLERANCE, natural_sizes
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

FRAME_S = 1.0 / 30.0  # of the tracker
TENSION_NOISE = 1e-3  # [1] 1 sd of a measured tension
REST_S = 2.0  # before a touch, and at a posture of the free motion
MOVE_S = 2.0  # from posture to posture
WATCHED_S = 2.0  # after the onset
MOVED = 0.03, 0.1, 0.25  # [1] of the length, the marker that moves most
FORCE_TIME_S = 3.0  # the monitor's `force_time`


class Watch:
    """What the monitor does with frames, at its rate."""

    def __init__(self, robot, arm, rate, random):
        self.observer, self.random = ContactObserver(arm), random
        change = INPUT_TOLERANCE * robot.tension_limits[1]
        self.frames = FrameMean(NOISE_M, change, FORCE_TIME_S)
        self.period, self.due = 1.0 / rate, random.uniform(0.0, 1.0 / rate)

    def see(self, at, tensions, markers):
        """Take a frame of true tensions and markers; return an estimate if it is due."""
        noise = self.random.normal(0.0, NOISE_M, markers.shape)
        tensions = tensions * (1.0 + TENSION_NOISE * self.random.normal(size=tensions.shape))
        self.frames.put(at, tensions, markers + noise)
        if at < self.due:
            return None
        self.due += self.period
        tensions, positions, frames = self.frames.take(self.observer.slopes)
        return self.observer.update(tensions, positions, None, frames)


class Case:
    """An arm as it is built, as the monitor has learned it."""

    def __init__(self, robot, seed, level, references):
        self.robot, self.seed, self.work = robot, seed, Workmanship().times(level)
        self.random = np.random.default_rng([seed, 17])
        markers = default_markers(robot)
        self.arcs = np.array([m.arc_length for m in markers])
        self.offsets = np.array([m.offset for m in markers])
        described = robot if level else replace(robot, exact=True)
        self.arm = BuiltArm(described, load_catalogue(), markers, NOISE_M)
        self.free = make_plant(robot, {}, seed=seed, work=self.work)
        if references:
            rows, frames = self.postures(references, 100 + seed), 18
            noise = self.random.normal(0.0, NOISE_M / frames**0.5, (references, len(markers), 3))
            read = rows * (1.0 + TENSION_NOISE * self.random.normal(size=rows.shape))
            self.arm.fit(read, self.markers(self.free, rows) + noise, frames)

    def postures(self, count, seed):
        """Return tensions (count, m) [N]."""
        return np.clip(default_postures(self.robot, count, seed), *self.robot.tension_limits)

    def markers(self, plant, rows):
        """Return true markers (P, J, 3) [m]."""
        return plant.markers(rows, self.arcs, self.offsets)

    def hidden(self, kind, tensions, part):
        """Return markers without and with a push of a size, its values, and its place [m]."""
        place, robot = self.random.uniform(0.2, 1.0) * self.robot.length, self.robot
        shape = self.free.respond(tensions)
        self.free.forget()
        near = np.array([place - 1e-3, place, min(place + 1e-3, robot.length)])
        before, point, behind = shape.markers(near, np.zeros((3, 3)))
        along = (behind - before) / np.linalg.norm(behind - before)
        across = self.random.normal(size=3)
        across -= across @ along * along
        across /= np.linalg.norm(across)
        sized = load_catalogue().sized(natural_sizes(robot))[kind].parameters
        straight = self.markers(self.free, tensions[None])[0]
        small, large, radius = 0.0, None, (part + 1.0 / robot.cells) * robot.length
        size = sized[1].typical if kind == 'point_load' else 0.02 * robot.length
        for _ in range(16):
            if kind == 'point_load':
                axes = zip('xyz', (size * across).tolist(), strict=True)
                values = {'arc_length': place, **{f'force_{k}': v for k, v in axes}}
            else:
                centre = point - (radius - size) * across
                values = ball(centre, radius, 10.0 * sized[0].typical)
            try:
                plant = make_plant(robot, {kind: values}, seed=self.seed, work=self.work)
                seen = self.markers(plant, tensions[None])[0]
                off = float(np.linalg.norm(seen - straight, axis=1).max()) / robot.length
            except NoEquilibriumError:
                off = np.inf
            if abs(off - part) < 0.1 * part:
                if kind == 'contact':  # where it pushes indeed: several ends of cells
                    arm, cells = plant.respond(tensions), plant.model.robot.sections
                    ends = np.cumsum([cell.cell_length for cell in cells])
                    depth = np.clip(
                        radius - np.linalg.norm(arm.positions - centre, axis=1), 0, None
                    )
                    place = float(depth @ ends / depth.sum())
                return (straight, seen), values, place
            small, large = (size, large) if off < part else (small, size)
            size = 2.0 * size if large is None else 0.5 * (small + large)
        return None


def ball(centre, radius, stiffness):
    """Return the parameters of a ball at a centre (3,) [m] beside the base."""
    away = float(np.linalg.norm(centre))
    x, y, z = (-centre / away).tolist()
    where = {'distance': away - radius, 'azimuth': np.arctan2(y, x), 'elevation': np.arcsin(z)}
    return {'stiffness': stiffness, 'curvature': 1.0 / radius, **where}


def touched(robot, seed, level, references, rate, kind):
    """Return the delay [s], the error of the place, whether its interval holds, and times."""
    case, part = Case(robot, seed, level, references), MOVED[seed % len(MOVED)]
    tensions = case.postures(8, seed)[seed % 8]
    made = case.hidden(kind, tensions, part)
    if made is None:
        return None
    shapes, hidden, place = made
    watch = Watch(robot, case.arm, rate, case.random)
    onset = REST_S + case.random.uniform(0.0, 1.0 / rate)
    row = {'part': part, 'false': False, 'delay': np.inf, 'first': np.nan, 'place': np.nan}
    for at in np.arange(0.0, onset + WATCHED_S, FRAME_S):
        begin = time.process_time()
        told = watch.see(at, tensions, shapes[int(at >= onset)])
        spent = 1e3 * (time.process_time() - begin)
        if told is None or not told.acts:
            continue
        if at < onset:
            row['false'] = True
            continue
        off = abs(told.place - place) / robot.length
        row |= {'place': off, 'spent': spent}
        row['whole'] = told.interval == (0.0, robot.length)
        row['width'] = (told.interval[1] - told.interval[0]) / robot.length
        row['holds'] = told.interval[0] <= place <= told.interval[1]
        if kind == 'point_load':
            true = np.array([hidden[f'force_{k}'] for k in 'xyz'])
            row['size'] = abs(np.linalg.norm(told.force) / np.linalg.norm(true) - 1.0)
        if np.isinf(row['delay']):
            row |= {'delay': float(at - onset), 'first': off}
    return row


def free(robot, seed, level, references, rate, minutes):
    """Return how many estimates of a free motion were told as contacts, and their times."""
    case = Case(robot, seed, level, references)
    watch = Watch(robot, case.arm, rate, case.random)
    count = int(np.ceil(60.0 * minutes / (REST_S + MOVE_S))) + 1
    rows, estimates, alarms, spent, told_before = case.postures(count, 500 + seed), 0, 0, [], False
    for k, (start, end) in enumerate(pairwise(rows)):
        for at in np.arange(0.0, REST_S + MOVE_S, FRAME_S):
            now = k * (REST_S + MOVE_S) + at
            due = now >= watch.due
            if at < MOVE_S and not due:
                continue  # of a moving arm one frame counts
            tensions = start + min(at / MOVE_S, 1.0) * (end - start)
            if at < MOVE_S or at < MOVE_S + FRAME_S:
                seen = case.markers(case.free, tensions[None])[0]
            begin = time.process_time()
            told = watch.see(now, tensions, seen)
            if told is not None:
                spent.append(1e3 * (time.process_time() - begin))
                estimates, alarms = estimates + 1, alarms + (told.acts and not told_before)
                told_before = told.acts
        passed = (k + 1) * (REST_S + MOVE_S) / 60.0
        if passed % 1.0 == 0.0:
            print(f'{passed:.0f} min: {alarms} of {estimates}', file=sys.stderr, flush=True)
    return {
        'robot': robot.name,
        'free [min]': minutes,
        'estimates': estimates,
        'false alarms': int(alarms),
        'update, median and 99 % [ms of a processor]': np.quantile(spent, [0.5, 0.99])
        .round(1)
        .tolist(),
    }


def bench(robot, seeds, level, references, rate, kind):
    """Return the figures of the touches of a robot."""
    rows = [touched(robot, seed, level, references, rate, kind) for seed in seeds]
    rows = [row for row in rows if row is not None]
    told = [row for row in rows if np.isfinite(row['delay'])]

    def hundred(values):
        return round(100 * float(np.mean(values)), 1) if len(values) else None

    def quantiles(key, of=told):
        values = [row[key] for row in of if key in row]
        return np.quantile(values, [0.5, 0.9]).round(3).tolist() if values else None

    return {
        'robot': robot.name,
        'level': level,
        'kind': kind,
        'rate [Hz]': rate,
        'touches': len(rows),
        'told [%]': hundred([np.isfinite(row['delay']) for row in rows]),
        'told within 0.3 s [%]': hundred([row['delay'] <= 0.3 for row in rows]),
        'told before the onset': sum(row['false'] for row in rows),
        'delay, median and 90 % [s]': quantiles('delay'),
        'place within 10 % at first [%]': hundred([row['first'] <= 0.1 for row in told]),
        'place within 10 % [%]': hundred([row['place'] <= 0.1 for row in told]),
        'error of the place, median and 90 % [1]': quantiles('place'),
        'width of its interval, median and 90 % [1]': quantiles('width'),
        'intervals of 95 % hold [%]': hundred([row['holds'] for row in told]),
        'error of the size, median and 90 % [1]': quantiles('size'),
        'by size: told within 0.3 s, place within 10 % [%]': {
            str(part): [
                hundred([r['delay'] <= 0.3 for r in rows if r['part'] == part]),
                hundred([r['place'] <= 0.1 for r in rows if r['part'] == part]),
            ]
            for part in MOVED
        },
    }


def main():
    """Print the figures, and write them as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--cases', type=int, default=40)
    parser.add_argument('--first', type=int, default=0, help='seed')
    parser.add_argument('--minutes', type=float, default=30.0, help='of free motion')
    parser.add_argument('--rate', type=float, default=5.0, help='force_rate [Hz]')
    parser.add_argument('--level', type=float, default=1.0, help='workmanship; 0: exact')
    parser.add_argument('--references', type=int, default=30)
    parser.add_argument('--robots', nargs='+', default=ROBOTS)
    parser.add_argument('--kinds', nargs='*', default=['point_load', 'contact'])
    parser.add_argument('--json', type=Path)
    args = parser.parse_args()
    rows, seeds = [], range(args.first, args.first + args.cases)
    for name in args.robots:
        robot, how = load_robot(name), (args.level, args.references, args.rate)
        with one_thread():  # as in the nodes
            for kind in args.kinds if args.cases else ():
                rows.append(bench(robot, seeds, *how, kind))
                print(json.dumps(rows[-1], indent=1), flush=True)
            if args.minutes:
                rows.append(free(robot, args.first, *how, args.minutes))
                print(json.dumps(rows[-1], indent=1), flush=True)
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))


if __name__ == '__main__':
    main()
