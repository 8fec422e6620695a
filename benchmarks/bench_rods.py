"""How far the model is from exact rods, and how long a posture takes."""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from machine import machine, tell

from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import Robot, Section, Tendon

RODS = Path(__file__).parent / 'rods'
RADIUS, YOUNG, LENGTH, OFFSET = 0.7e-3, 54e9, 0.2, 0.01  # [m], [Pa], [m] per segment, [m]
EI_OVER_GJ = 1.3  # [1] of a round rod, 1 + Poisson's ratio
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


def compare(cells: int, torsion: float) -> dict[str, object]:
    """Distances [mm] of the tip from the exact rod, and CPU time of a cold posture [s]."""
    robot, apart, times = rod(cells), {'without': [], 'with': []}, []
    if torsion:
        robot = robot.with_effect('torsion', {'compliance': torsion})
    with (RODS / 'rods.csv').open(newline='') as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    for row in rows:
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


def main() -> int:
    """Compare with one cell per disk."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    figures = {
        'one cell per disk': compare(20, EI_OVER_GJ),
        'one cell per disk, without torsion': compare(20, 0.0),
    }
    figures['published'] = json.loads((RODS / 'published.json').read_text())
    tell({'machine': machine(), 'rods': figures}, options.json)
    return 0


if __name__ == '__main__':
    sys.exit(main())
