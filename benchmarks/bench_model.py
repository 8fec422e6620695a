"""
Speed of the model: forward, implicit, inverse, the sweep of section IV.B, compile and load.

Times are those of the processor, so that other work on the machine counts little.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from machine import machine, tell

from tendon_robot_ros.common.errors import NoEquilibriumError
from tendon_robot_ros.model.compile import BEND_TOLERANCE
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import Robot, Section, Tendon, load_robot

ROBOTS = Path(__file__).parent.parent / 'config' / 'robots'
SHAPING = {name: {'fraction': 1.0} for name in ('eyelet_wrap', 'straight_tendon', 'tendon_travel')}


def sixty_cells() -> Robot:
    """Return two sections of thirty cells with four tendons."""
    robot = load_robot(ROBOTS / 'kato_1_1.yaml')
    tendons = tuple(
        Tendon(f'{section.name}_{side}', offset, offset, section.name)
        for section in robot.sections
        for side, offset in (('left', (1.95e-3, 0.0)), ('right', (-1.95e-3, 0.0)))
    )
    return replace(robot, tendons=tendons, gravity=(9.81, 0.0, 0.0))


def per_call(run, postures: int, repeats: int = 200, clock=time.thread_time) -> dict[str, float]:
    """Least and median time of one posture [s] over short runs."""
    run()
    times = []
    for _ in range(repeats):
        start = clock()
        run()
        times.append((clock() - start) / postures)
    return {'least': min(times), 'median': float(np.median(times))}


def forward(robot: Robot, tensions: np.ndarray, batch: int = 32) -> dict[str, dict[str, float]]:
    """
    Time a posture on one core, all results of every cell included.

    `one call` is `Model.shape` from Python, `in a batch` a posture of `Model.shapes`.
    """
    model = Model(robot)
    inputs = np.tile(tensions, (batch, 1))
    return {
        'one call': per_call(lambda: model.shape(tensions), 1, 5000),
        'in a batch': per_call(lambda: model.shapes(inputs), batch),
    }


def disks() -> Robot:
    """Return the like-for-like case: twenty disks, no friction, a force at the tip."""
    section = Section('arm', 20, 0.01, (0.05,) * 20, (1.0,) * 20, 'arc')
    tendons = tuple(
        Tendon(f't{i}', offset, offset, 'arm')
        for i, offset in enumerate(((0.008, 0.0), (-0.004, 0.0069), (-0.004, -0.0069)))
    )
    effects = {'tip_load': {'force_x': 0.1, 'force_y': 0.05, 'force_z': -0.1}}
    return Robot('disks', (section,), tendons, (0.0, 20.0), effects)


def summary(name: str, times: list[float]) -> dict[str, float]:
    """Median, 95 % and 99 % of times [s]."""
    shares = {'median': 50.0, 'p95': 95.0, 'p99': 99.0}
    return {f'{name} {of}': float(np.percentile(times, share)) for of, share in shares.items()}


def spatial(name: str, largest: float, postures: int = 1000) -> dict[str, float]:
    """
    Time postures of a spatial arm under random tensions from the lower limit to `largest` [N].

    Cold, warm (each tension within 0.01 N of the one before), and the tip Jacobian with its shape.
    """
    model, random = Model(load_robot(ROBOTS / f'{name}.yaml')), np.random.default_rng(3)
    low = model.limits[:, 0]
    tensions = low + random.random((postures, len(low))) * (largest - low)
    model.jacobian(tensions[0])
    cold, warm, jacobian, lost = [], [], [], 0
    for row in tensions:
        start = time.thread_time()
        try:
            shape = model.shape(row)
        except NoEquilibriumError:
            lost += 1
            continue
        finally:
            cold.append(time.thread_time() - start)
        near = np.maximum(row + random.uniform(-0.01, 0.01, len(row)), low)
        start = time.thread_time()
        model.shape(near, shape.state)
        warm.append(time.thread_time() - start)
        start = time.thread_time()
        model.jacobian(row)
        jacobian.append(time.thread_time() - start)
    return {
        **summary('cold', cold),
        **summary('warm', warm),
        **summary('shape and tip Jacobian', jacobian),
        'without an answer': lost,
    }


def none_there(postures: int = 100) -> dict[str, float]:
    """Time until a spatial arm of softening cells says that there is no equilibrium."""
    robot = load_robot(ROBOTS / 'spatial_6.yaml')
    softening = {'nonlinear_stiffness': {'cubic': -0.5}}
    model = Model(replace(robot, effects={**robot.effects, **softening}))
    random = np.random.default_rng(4)
    low, high = model.limits.T
    times, tensions = [], low + random.random((postures, len(low))) * (high - low)
    model.solve(tensions[:1])
    for row in tensions:
        start = time.thread_time()
        change = model.solve(row[None])[1][0]
        if not change < BEND_TOLERANCE:
            times.append(time.thread_time() - start)
    return {'postures without one': len(times), **(summary('said', times) if times else {})}


def inverse(name: str, targets: int, largest: float) -> dict[str, object]:
    """
    Time cold and warm searches for tips that random tensions give; count the found.

    Every tendon's tension is drawn evenly from its lower limit to `largest` [N], so that most
    postures hold tension against tension. Found: within 10 µm and 1 mrad.
    """
    model, random = Model(load_robot(ROBOTS / f'{name}.yaml')), np.random.default_rng(1)
    low, high = model.limits.T
    tensions = low + random.random((targets, len(low))) * (np.minimum(high, largest) - low)
    shapes, changes = model.solve(tensions)
    good = np.flatnonzero(changes < 1e-10)
    _ = model.library
    cold, warm, found = [], [], 0
    for count, i in enumerate(good):
        position, direction = shapes.tip_position[i], shapes.tip_direction[i]
        start = time.thread_time()
        reach = model.reach(position, direction)
        cold.append(time.thread_time() - start)
        found += reach.position_error < 1e-5 and reach.direction_error < 1e-3
        if count % 10 == 0:
            near = model.shape(np.clip(reach.tensions + 0.002, low, high), reach.shape.bend)
            start = time.thread_time()
            model.reach(near.tip_position, near.tip_direction, guess=reach.shape)
            warm.append(time.thread_time() - start)
    return {
        'tensions drawn [N]': [float(low.min()), float(np.minimum(high, largest).max())],
        'targets': len(good),
        'tensions without an equilibrium': targets - len(good),
        'found share': found / len(good),
        **summary('cold', cold),
        **summary('warm', warm),
    }


def section_iv_b(robot: Robot) -> dict[str, float]:
    """CPU time of all pairs (proxL, distR), (proxR, distL) to 5 N by 0.1 N: 5,000 shapes [s]."""
    model = Model(robot)
    steps = np.arange(0.1, 5.05, 0.1)
    first, second = (grid.ravel() for grid in np.meshgrid(steps, steps))
    pretension = np.full_like(first, 0.1)
    pairs = np.concatenate(
        [
            np.stack(columns, axis=1)
            for columns in (
                (first, pretension, pretension, second),
                (pretension, first, second, pretension),
            )
        ]
    )
    return per_call(lambda: model.shapes(pairs), 1, 20, time.process_time)  # on both cores


def of_children() -> float:
    """Return the processor time of the processes that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def starts(name: str) -> dict[str, float]:
    """Processor time of a process that makes one shape: compiled anew, and from the cache."""
    code = (
        'from tendon_robot_ros.robot import load_robot\n'
        'from tendon_robot_ros.model.model import Model\n'
        f'model = Model(load_robot({str(ROBOTS / name)!r} + ".yaml"))\n'
        'model.shape(model.limits[:, 0] + 0.1)'
    )
    made = {}
    with tempfile.TemporaryDirectory() as folder:
        for kind in ('compile', 'load'):
            start = of_children()
            subprocess.run(
                [sys.executable, '-c', code],
                check=True,
                env={**os.environ, 'NUMBA_CACHE_DIR': folder},
            )
            made[f'{kind} and first shape'] = of_children() - start
    return made


def main() -> int:
    """Measure all of it; times in seconds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        '--targets', type=int, default=10_000, help='for the inverse; default 10000'
    )
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    robot = sixty_cells()
    tensions = np.array([0.5, 0.1, 0.1, 1.0])
    friction = replace(robot, effects={'tendon_friction': {'friction_coefficient': 0.31}})
    five = replace(
        robot, effects={**friction.effects, **SHAPING, 'gravity': {'linear_density': 0.005}}
    )
    figures = {
        'FKM, 60 cells, 4 tendons': forward(friction, tensions),
        'five effects, implicit': forward(five, tensions),
        '20 disks, tip load, no friction': forward(disks(), np.array([4.0, 1.0, 0.0])),
        'section IV.B': section_iv_b(friction),
        'inverse, kato_10_1, two sections': inverse('kato_10_1', options.targets, 5.0),
        'inverse, kato_1_1, 12 tendons': inverse('kato_1_1', max(options.targets // 10, 10), 5.0),
        'inverse, spatial_6, to 4 N': inverse('spatial_6', max(options.targets // 10, 10), 4.0),
        'spatial_3, to 4 N': spatial('spatial_3', 4.0),
        'spatial_6, to 1 N': spatial('spatial_6', 1.0),
        'spatial_6, to 4 N': spatial('spatial_6', 4.0),
        'no equilibrium, spatial_6': none_there(),
        'start, kato_10_1': starts('kato_10_1'),
        'start, spatial_6': starts('spatial_6'),
    }
    tell({'machine': machine(), 'seconds': figures}, options.json)
    return 0


if __name__ == '__main__':
    sys.exit(main())
