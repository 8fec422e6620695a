"""
How far the model is from exact rods under their weight and two wrenches, and how fast it is.

The folder is that of the rods of opencr-mujoco (data/reference/sorosim, made with SoRoSim): a
clamped rod of spring steel of 0.6 m, gravity in any direction, one wrench in its middle and one at
its tip, 14 stations. What is said of the rod stands in its repository; options say another rod.
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
import time
from pathlib import Path

import numpy as np
from machine import machine, tell

from tendon_robot_ros.common.errors import NoEquilibriumError
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import Robot, Section, Tendon

LENGTH = 0.6  # [m]
AXES = [1, 2, 0]  # x, y, z of the model in the axes of the file, whose rods lie along x


def read(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the arc lengths (14,) [m], and angles and places (rods, 6, 17) with the loads."""
    (path,) = folder.glob('*Statics.csv')
    with path.open(newline='') as file:
        _, shares, *rows = csv.reader(file)
    half, stations = 0.5 * LENGTH, np.array(shares[4:], dtype=float)
    stations = half * (stations + np.repeat([0.0, 1.0], stations.size // 2))
    numbers = np.array([row[1:] for row in rows], dtype=float)
    return stations, numbers.reshape(-1, 6, numbers.shape[1])


def wrench(rod: np.ndarray, column: int) -> dict[str, float]:
    """Return the wrench of a column of a rod (6, 17), in axes of the base that do not turn."""
    moment, force = rod[:3, column][AXES], rod[3:, column][AXES]
    return {
        f'{stem}_{axis}': float(value)
        for stem, values in (('force', force), ('moment', moment))
        for axis, value in zip('xyz', values, strict=True)
    }


def loaded(rod: np.ndarray, cells: int, options: argparse.Namespace) -> Robot:
    """Return a rod (6, 17) as an arm without a tendon that pulls."""
    area, length = math.pi * options.radius**2, LENGTH / cells
    bending = options.young * math.pi * options.radius**4 / 4.0
    effects = {
        'torsion': {'compliance': (1.0 + options.poisson,)},
        'gravity': {'linear_density': options.density * area},
        'point_load': {'arc_length': 0.5 * LENGTH, **wrench(rod, 1)},
        'tip_load': wrench(rod, 2),
    }
    section = Section('rod', cells, length, (bending / length,) * cells, (1.0,) * cells, 'arc')
    slack = Tendon('slack', (options.radius, 0.0), (options.radius, 0.0), 'rod')
    gravity = tuple(rod[3:, 0][AXES].tolist())
    return Robot('rod', (section,), (slack,), (0.0, 1.0), effects, gravity=gravity)


def compare(cells: int, options: argparse.Namespace) -> dict[str, object]:
    """Return distances from the exact rods over their length [1], and the time of a shape [s]."""
    stations, rods = read(options.folder)
    errors, times, failed = [], [], []
    for number, rod in enumerate(rods, 1):
        model = Model(loaded(rod, cells, options))
        start = time.process_time()
        try:
            shape = model.shape([0.0])
        except NoEquilibriumError as error:
            failed.append(f'rod {number}: {error}')
            continue
        times.append(time.process_time() - start)
        places = shape.batch.markers(stations, np.zeros((len(stations), 3)))[0]
        exact = rod[3:, 3:][AXES].T
        errors.append(np.linalg.norm(places - exact, axis=1) / LENGTH)
    apart = np.array(errors)
    return {
        'rods': len(apart),
        'median of all stations [% of the length]': 100.0 * float(np.median(apart)),
        'median of the worst station of a rod [%]': 100.0 * float(np.median(apart.max(axis=1))),
        'worst of all [%]': 100.0 * float(apart.max()),
        'median time of a cold shape [ms]': 1e3 * float(np.median(times)),
        'no equilibrium': failed,
    }


def main() -> int:
    """Compare rods of several numbers of cells."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('folder', type=Path, help='that of *Statics.csv')
    parser.add_argument('--cells', type=int, nargs='+', default=[10, 20, 40])
    parser.add_argument('--radius', type=float, default=0.8e-3, help='[m]')
    parser.add_argument('--young', type=float, default=200e9, help='[Pa]')
    parser.add_argument('--density', type=float, default=7870.0, help='[kg/m³]')
    parser.add_argument('--poisson', type=float, default=0.33)
    parser.add_argument('--json', type=Path)
    options = parser.parse_args()
    figures = {f'{cells} cells': compare(cells, options) for cells in options.cells}
    tell(figures | {'machine': machine()}, options.json)
    return 0


if __name__ == '__main__':
    sys.exit(main())
