"""
The force at the tip from measured shape and tensions, on simulated arms as they are built.

Error against the force that bends the straight arm by a quarter of its length, how often the 95 %
intervals hold, how often a touch elsewhere is told, and the processor time of an update. The bound
is that of Cramer and Rao for these frames of an arm that is known exactly: no estimate without
bias is better in that direction. `--lacks EFFECT`: the arm has an effect that its description
lacks; with and without the `model_error` that this makes at sixty free postures.

example: python benchmarks/bench_tip_force.py --cases 60 --as-built
example: python benchmarks/bench_tip_force.py --cases 20 --lacks hinge_friction
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from tendon_robot_ros.common.errors import NoEquilibriumError
from tendon_robot_ros.common.processes import one_thread
from tendon_robot_ros.data import default_markers
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.monitoring.built_arm import BuiltArm
from tendon_robot_ros.monitoring.contact import ContactObserver
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.estimates import natural_sizes
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

NOISE_M = 2e-4
ROBOTS = 'kato_10_1', 'spatial_3'
CHI2_3 = 7.815  # 95 % of three degrees of freedom


def quarter_force(robot):
    """Return the force [N] across the straight arm that moves its tip by a quarter of it."""
    low = np.full(len(robot.inputs), robot.tension_limits[0])
    straight = Model(robot).shape(low).tip_position
    small, large = 1e-5, 100.0
    for _ in range(40):
        force = float(np.sqrt(small * large))
        try:
            tip = Model(robot.with_effect('tip_load', {'force_x': force})).shape(low).tip_position
            bent = np.linalg.norm(tip - straight) > 0.25 * robot.length
        except NoEquilibriumError:  # far too much
            bent = True
        small, large = (small, force) if bent else (force, large)
    return small


def lacking(robot, effect):
    """Return the values of an effect of half the typical size; none for no effect."""
    if not effect:
        return {}
    sized = load_catalogue().sized(natural_sizes(robot))[effect]
    return {effect: {p.name: p.neutral + 0.5 * p.typical for p in sized.parameters}}


def knowing(robot, hidden):
    """Return a description that knows how far off it is of an arm with something hidden."""
    markers = default_markers(robot)
    arcs, offsets = (np.array([getattr(m, k) for m in markers]) for k in ('arc_length', 'offset'))
    rows = np.clip(default_postures(robot, 60, 99), *robot.tension_limits)
    exact = Workmanship().times(0.0)
    is_, said = (
        make_plant(robot, h, work=exact).markers(rows, arcs, offsets) for h in (hidden, {})
    )
    height, square = arcs / robot.length, ((is_ - said) ** 2).sum(axis=2).mean(axis=0)
    return replace(robot, model_error=float(np.sqrt(square @ height / (height @ height))))


def watched(robot, seed, level, references, frames, lacks):
    """Return a plant maker, and the arm as it is known from free reference postures."""
    markers = default_markers(robot)
    arm = BuiltArm(robot, load_catalogue(), markers, NOISE_M, max(level, 0.3))
    free = make_plant(robot, lacks, seed=seed, work=Workmanship().times(level))
    rows = np.clip(default_postures(robot, max(references, 1), 100 + seed), *robot.tension_limits)
    seen = looked(free, rows, markers, np.random.default_rng([seed, 6]), frames)
    if references:
        arm.fit(rows, seen, frames)
    return arm, markers


def looked(plant, rows, markers, random, frames=1):
    """Return what a tracker sees of postures (P, J, 3) [m]: the mean of so many frames."""
    arcs = np.array([m.arc_length for m in markers])
    offsets = np.array([m.offset for m in markers])
    seen = plant.markers(rows, arcs, offsets)
    return seen + random.normal(0.0, NOISE_M / frames**0.5, seen.shape)


def case(robot, full, seed, level, references, frames, where='tip', lacks=None):
    """Return error over the quarter force, whether three intervals hold, time, place."""
    random = np.random.default_rng([seed, 5])
    direction = random.normal(size=3)
    force = full * random.uniform(0.1, 1.0) * direction / np.linalg.norm(direction)
    hidden = {
        'tip_load': dict(zip(('force_x', 'force_y', 'force_z'), force.tolist(), strict=True))
    }
    if where != 'tip':
        middle = (robot.cells // 2 - 0.5) / robot.cells * robot.length
        force = np.array([full * (1 + seed % 3), 0.0, 0.0])
        hidden = {'point_load': {'arc_length': middle, 'force_x': float(force[0])}}
    hidden |= (lacks := lacks or {})
    plant = make_plant(robot, hidden, seed=seed, work=Workmanship().times(level))
    arm, markers = watched(robot, seed, level, references, frames, lacks)
    rows = np.clip(default_postures(robot, 8, seed), *robot.tension_limits)
    tensions = rows[seed % 8]
    try:
        seen = looked(plant, tensions[None], markers, random, frames)[0]
    except NoEquilibriumError:
        return None
    observer = ContactObserver(arm)
    spent, found = [], None
    for _ in range(2):  # at a posture that is new to it, then once more
        begin = time.process_time()
        found = observer.update(tensions, seen, None, frames)
        spent.append(1e3 * (time.process_time() - begin))
    if found is None:
        return None
    off = found.force - force
    inside = np.abs(off) <= 1.96 * np.sqrt(np.diag(found.covariance))
    values, along = np.linalg.eigh(found.covariance)  # the best told direction first
    return {
        'bound': bound(observer, tensions, force) / full / frames**0.5,
        'sd': np.sqrt(values) / full,
        'ellipsoid': float(off @ np.linalg.solve(found.covariance, off)) <= CHI2_3,
        'error': float(np.linalg.norm(off)) / full,
        'sorted': np.abs(along.T @ off) / full,
        'holds': inside,
        'ms': spent,
        'place': found.place / robot.length,
        'acts': found.acts,
    }


def bound(observer, tensions, force):
    """Return the least 1 sd [N] along the axes, best told first, of one frame and a known arm."""
    inputs, step = np.maximum(tensions, 0.0)[None], observer.step
    try:
        here, *columns = (
            observer.predicted(force + step * axis, inputs, True, observer.tip)
            for axis in np.eye(4, 3, -1)
        )
    except NoEquilibriumError:
        return np.full(3, np.nan)
    slopes = np.array([column - here for column in columns]).T / step
    return NOISE_M / np.linalg.svd(slopes)[1]


def bench(robot, seeds, level, references, frames, lacks):
    """Return the figures of a robot."""
    full, half = quarter_force(robot), robot.cells // 2
    both = {'tip': [], 'side': []}
    for where, seed in product(both, seeds):
        found = case(robot, full, seed, level, references, frames, where, lacks)
        if found is not None:
            both[where].append(found)
    tips, sides = both['tip'], both['side']
    middle = (half - 0.5) / robot.cells
    near = [c['acts'] and abs(c['place'] - middle) <= 1.0 / 6.0 for c in sides]
    return {
        'robot': robot.name,
        'lacks': lacks,
        'model_error [mm]': robot.model_error and round(1e3 * robot.model_error, 2),
        'level': level,
        'reference postures': references,
        'frames': frames,
        'quarter force [N]': full,
        'solved': f'{len(tips)} of {len(seeds)}',
        'error, median [%]': round(100 * float(np.median([c['error'] for c in tips])), 2),
        **along_axes(tips),
        'ellipsoids of 95 % hold [%]': percent([c['ellipsoid'] for c in tips]),
        'intervals hold [%]': percent([c['holds'] for c in tips]),
        'told below nine tenths of the arm [%]': percent([c['place'] < 0.9 for c in tips]),
        'ellipsoids of a touch at the middle hold [%]': percent([c['ellipsoid'] for c in sides]),
        'touch elsewhere told [%]': percent([c['place'] < 0.9 for c in sides]),
        'within a sixth of the arm [%]': percent(near),
        'update at a new posture, and again, median [ms of a processor]': medians(
            np.array([c['ms'] for c in tips])
        ),
    }


def along_axes(tips):
    """Return the figures along the axes of the covariance, best told first."""
    told = np.array([1.96 * c['sd'] < 0.03 for c in tips])
    errors, bounds = (100 * np.array([c[key] for c in tips]) for key in ('sorted', 'bound'))
    return {
        'error along its axes, best told first, median [%]': medians(errors),
        'bound along its axes, median [%]': medians(bounds),
        'axes that are told to 3 % (1.96 sd) [%]': percent(told),
        'error along these: median, nine in ten below [%]': [
            round(float(np.quantile(errors[told], q)), 2) for q in (0.5, 0.9) if told.any()
        ],
    }


def medians(rows):
    """Return the median of every column."""
    return np.nanmedian(rows, axis=0).round(2).tolist()


def percent(values):
    """Return how many are true, in hundred."""
    return round(100 * float(np.mean(values)), 1)


def main():
    """Print the figures, and write them as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--cases', type=int, default=60)
    parser.add_argument('--first', type=int, default=0, help='seed')
    parser.add_argument('--robots', nargs='+', default=ROBOTS)
    parser.add_argument('--as-built', action='store_true', help='with twenty references alone')
    parser.add_argument('--lacks', metavar='EFFECT', help='half its typical size, not described')
    parser.add_argument('--frames', type=int, default=1, help='averaged, in every posture')
    parser.add_argument('--json', type=Path)
    args = parser.parse_args()
    if args.frames < 1:
        parser.error(f'--frames: expected 1 or more, got {args.frames}')
    rows, seeds = [], range(args.first, args.first + args.cases)
    levels = ((0.0, 20), (1.0, 0), (1.0, 20))[2 if args.as_built else int(bool(args.lacks)) :]
    for (level, references), name in product(levels, args.robots):
        robot = load_robot(f'config/robots/{name}.yaml')
        lacks = lacking(robot, args.lacks)
        for described in (robot, knowing(robot, lacks))[: 1 + bool(lacks)]:
            with one_thread():  # as in the nodes
                rows.append(bench(described, seeds, level, references, args.frames, lacks))
            print(json.dumps(rows[-1], indent=1), flush=True)
    if args.json:
        args.json.write_text(json.dumps(rows, indent=1))


if __name__ == '__main__':
    main()
