"""
How far the model is from exact rods, how fast it is, and whether `diagnose` sees their twist.

The rods: `rods.csv` (another package's, twenty disks), `rods_20.csv` and `rods_40.csv`
(`exact_rod.py`).
"""

from __future__ import annotations

import argparse
import collections
import csv
import json
import math
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from exact_rod import TIP_FORCE
from machine import machine, tell

from tendon_robot_ros.data import DataSet, default_markers
from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import Robot, Section, Tendon

RODS = Path(__file__).parent / 'rods'
RADIUS, YOUNG, LENGTH, OFFSET = 0.7e-3, 54e9, 0.2, 0.01  # [m], [Pa], [m] per segment, [m]
EI_OVER_GJ = 1.3  # [1] of a round rod, 1 + Poisson's ratio
NOISE, TRIALS = 2e-4, 5  # [m] of a coordinate, and how often each posture is measured
BENDING = YOUNG * math.pi * RADIUS**4 / 4.0  # [N·m²]


def rod(cells: int) -> Robot:
    """Return the rod with a number of cells, half of them per segment; eyelets at their ends."""
    length = 2.0 * LENGTH / cells
    sections = tuple(
        Section(
            name,
            cells // 2,
            length,
            (BENDING / length,) * (cells // 2),
            (1.0,) * (cells // 2),
            'arc',
        )
        for name in ('near', 'far')
    )
    tendons = []
    for j in range(6):
        angle = math.radians((90.0, -30.0, 210.0)[j % 3])
        at = (OFFSET * math.cos(angle), OFFSET * math.sin(angle))
        tendons.append(Tendon(f't{j + 1}', at, at, sections[j // 3].name))
    return Robot(
        'rod', sections, tuple(tendons), (0.0, 10.0), {'straight_tendon': {'fraction': 1.0}}
    )


def table(name: str) -> list[dict[str, float]]:
    """Return the rows of a table of rods."""
    with (RODS / name).open(newline='') as file:
        return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]


def compare(cells: int, torsion: float, name: str) -> dict[str, object]:
    """Distances [mm] of the tip from the exact rod, and CPU time of a cold posture [s]."""
    robot, apart, times = rod(cells), {'without': [], 'with': []}, []
    if torsion:
        robot = robot.with_effect('torsion', {'compliance': torsion})
    for row in table(name):
        force = {f'force_{axis}': row[f'force_{axis}'] for axis in 'xyz'}
        loaded = any(force.values())
        effects = {**robot.effects, 'tip_load': force} if loaded else robot.effects
        model, inputs = Model(replace(robot, effects=effects)), [row[f't{j}'] for j in range(1, 7)]
        model.shape(inputs)
        start = time.thread_time()
        shape = model.shape(inputs)
        times.append(time.thread_time() - start)
        tip = [row[f'tip_{axis}'] for axis in 'xyz']
        apart['with' if loaded else 'without'].append(1e3 * math.dist(shape.tip_position, tip))
    return {
        **{
            f'{key} a force at the tip [mm]': {
                'postures': len(values),
                'median': float(np.median(values)),
                'largest': max(values),
            }
            for key, values in apart.items()
        },
        'median of a cold posture [s]': float(np.median(times)),
    }


def measured(name: str, disks: int, seed: int, exact: bool) -> DataSet:
    """
    Return measurements of exact shapes, the weight at the tip described, torsion not.

    `exact`: the description says that nothing is off, which leaves no place for what a cell of
    finite length is off from a rod; else it is what an owner writes.
    """
    load = dict(zip(('force_x', 'force_y', 'force_z'), TIP_FORCE, strict=True))
    robot = replace(rod(disks), exact=exact, gravity=(9.81, 0.0, 0.0))
    robot = robot.with_effect('tip_load', load)
    rows = table(f'shapes_{name}_{disks}.csv')
    inputs = np.array([[row[f't{j}'] for j in range(1, 7)] for row in rows[::disks]])
    places = np.array([[row[axis] for axis in 'xyz'] for row in rows]).reshape(-1, 1, disks, 3)
    noise = np.random.default_rng(seed).normal(0.0, NOISE, (len(inputs), TRIALS, disks, 3))
    return DataSet(
        name=name,
        robot=robot,
        markers=default_markers(robot),
        postures=tuple(str(p) for p in range(len(inputs))),
        inputs=inputs,
        positions=places + noise,
        position_noise=NOISE,
        gravity=robot.gravity,
    )


def named(name: str, disks: int, seeds: int, exact: bool) -> dict[str, object]:
    """Count what `diagnose` says of exact shapes, and how often the compliance is right."""
    verdicts, torsion, inside, times = collections.Counter[str](), 0, 0, []
    for seed in range(seeds):
        dataset = measured(name, disks, seed, exact)
        start = time.process_time()
        found = diagnose(dataset)
        times.append(time.process_time() - start)
        verdicts[f'{found.verdict}: {" + ".join(effect.name for effect in found.effects)}'] += 1
        for effect in found.effects:
            if effect.name == 'torsion':
                torsion += 1
                inside += all(v.low <= EI_OVER_GJ <= v.high for v in effect.parameters.values())
    return {
        'data sets': seeds,
        'verdicts': dict(verdicts),
        'torsion named': torsion,
        'compliance in its interval': inside,
        'process time of a diagnosis [s]': float(np.median(times)),
    }


def main() -> int:
    """Compare with one cell per disk, and diagnose."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--json', type=Path)
    parser.add_argument('--seeds', type=int, default=10, help='data sets to diagnose; default 10')
    options = parser.parse_args()
    figures: dict[str, object] = {
        '20 disks': compare(20, EI_OVER_GJ, 'rods.csv'),
        '20 disks, without torsion': compare(20, 0.0, 'rods.csv'),
        '20 disks, solved finely': compare(20, EI_OVER_GJ, 'rods_20.csv'),
        '40 disks, solved finely': compare(40, EI_OVER_GJ, 'rods_40.csv'),
        **{
            f'diagnosis of a rod that {what}, {disks} disks, {described}': named(
                name, disks, options.seeds, described == 'exact'
            )
            for described in ('as an owner describes it', 'exact')
            for name, what in (('twisting', 'twists'), ('stiff', 'does not'))
            for disks in (20, 40)
        },
    }
    figures['published'] = json.loads((RODS / 'published.json').read_text())
    tell({'machine': machine(), 'rods': figures}, options.json)
    return 0


if __name__ == '__main__':
    sys.exit(main())
