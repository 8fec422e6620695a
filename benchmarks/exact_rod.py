"""
Exact rods of any number of disks, by a method of their own: finite differences between the disks.

The rods in rods.csv have twenty disks, and one cell per disk is twenty cells. This solves the
Cosserat equations of the same rod (no shear, no extension) with several pieces between two disks,
balances them by Newton on all pieces, and takes the limit of short pieces from two lengths
(Richardson). It shares no code with the package. It repeats the postures of rods.csv and
writes rods_20.csv, the same as found here, rods_40.csv, with forty disks, and the shapes in
which `diagnose` looks for the twist (`bench_rods.py`, `test/test_rods.py`).
"""

from __future__ import annotations

import argparse
import csv
import math
import sys
from pathlib import Path

import numpy as np
from numba import njit
from scipy.linalg import lu_factor, lu_solve

RODS = Path(__file__).parent / 'rods'
LENGTH, OFFSET, EI, EI_OVER_GJ = 0.4, 0.01, 54e9 * math.pi * 0.7e-3**4 / 4.0, 1.3
TENDONS = 6
ANGLES = np.radians([90.0, -30.0, 210.0] * 2)
HOLES = OFFSET * np.stack([np.cos(ANGLES), np.sin(ANGLES), np.zeros(TENDONS)], axis=1)
SETTLED = 1e-8  # [1/m] of a curvature
DIFFERENCE = 1e-6  # [1/m]
LOAD_STEPS, TURNS_MAX = 2, 60
SHAPES, TIP_FORCE = 12, (0.03, 0.0, 0.0)  # postures for `diagnose`, and the weight there [N]


@njit(cache=False)
def rotation(x: float, y: float, z: float) -> np.ndarray:
    """Return the rotation matrix (3, 3) of a rotation vector [rad] (Rodrigues)."""
    square = x * x + y * y + z * z
    angle = math.sqrt(square)
    first = math.sin(angle) / angle if angle > 1e-9 else 1.0
    second = (1.0 - math.cos(angle)) / square if angle > 1e-5 else 0.5
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + first * cross + second * (cross @ cross)


@njit(cache=False)
def place(
    strains: np.ndarray, disks: int, points: np.ndarray, holes: np.ndarray, inside: np.ndarray
) -> np.ndarray:
    """
    Place a rod of pieces of constant strain (count, 3) [1/m]; return the middles (count, 3) [m].

    Parameters
    ----------
    points : ndarray, shape (disks + 1, 3)
        Takes the disks [m], the base first.
    holes : ndarray, shape (disks + 1, tendons, 3)
        Takes the holes in them [m].
    inside : ndarray, shape (count, 3, 3)
        Takes the frames in the middles.

    """
    count = len(strains)
    pieces, step = count // disks, LENGTH / count
    frame, point, middles = np.eye(3), np.zeros(3), np.empty((count, 3))
    points[0], holes[0] = point, HOLES
    for i in range(count):
        x, y, z = 0.5 * step * strains[i]
        half = rotation(x, y, z)
        inside[i] = frame @ half
        bend = math.sqrt(x * x + y * y)
        chord = step * (math.sin(bend) / bend if bend > 1e-9 else 1.0)
        move = chord * np.ascontiguousarray(inside[i, :, 2])
        middles[i] = point + 0.5 * move
        frame, point = inside[i] @ half, point + move
        if (i + 1) % pieces == 0:
            disk = (i + 1) // pieces
            points[disk] = point
            for j in range(TENDONS):
                holes[disk, j] = point + frame @ HOLES[j]
    return middles


@njit(cache=False)
def imbalance(
    strains: np.ndarray, tensions: np.ndarray, force: np.ndarray, disks: int, twist: float
) -> np.ndarray:
    """Strains (count, 3) minus those that the moments beyond every piece ask for [1/m]."""
    count = len(strains)
    pieces = count // disks
    points, holes = np.empty((disks + 1, 3)), np.empty((disks + 1, TENDONS, 3))
    inside = np.empty((count, 3, 3))
    middles = place(strains, disks, points, holes, inside)
    forces, moments = np.zeros((disks + 1, 3)), np.zeros((disks + 1, 3))
    for disk in range(disks):
        for j in range(TENDONS):
            if disk < (disks // 2 if j < 3 else disks):
                chord = holes[disk, j] - holes[disk + 1, j]
                pull = tensions[j] / math.sqrt((chord**2).sum()) * chord
                forces[disk + 1] += pull
                forces[disk] -= pull
                moments[disk + 1] += np.cross(holes[disk + 1, j], pull)
                moments[disk] -= np.cross(holes[disk, j], pull)
    forces[disks] += force
    moments[disks] += np.cross(points[disks], force)
    left, beyond, about = np.empty((count, 3)), np.zeros(3), np.zeros(3)
    for i in range(count - 1, -1, -1):
        if (i + 1) % pieces == 0:
            beyond, about = beyond + forces[(i + 1) // pieces], about + moments[(i + 1) // pieces]
        here = about - np.cross(middles[i], beyond)
        for c in range(3):
            moment = 0.0
            for r in range(3):
                moment += inside[i, r, c] * here[r]
            left[i, c] = strains[i, c] - (twist if c == 2 else 1.0) / EI * moment
    return left


@njit(cache=False)
def jacobian(
    strains: np.ndarray, tensions: np.ndarray, force: np.ndarray, disks: int, twist: float
) -> np.ndarray:
    """Return the derivative of `imbalance` by the strains, (3 count, 3 count), by differences."""
    size, here = strains.size, imbalance(strains, tensions, force, disks, twist)
    slopes, moved = np.empty((size, size)), strains.copy()
    for q in range(size):
        i, c = q // 3, q % 3
        moved[i, c] = strains[i, c] + DIFFERENCE
        there = imbalance(moved, tensions, force, disks, twist)
        moved[i, c] = strains[i, c]
        slopes[:, q] = ((there - here) / DIFFERENCE).reshape(-1)
    return slopes


def solve(
    disks: int, pieces: int, tensions: np.ndarray, force: np.ndarray, twist: float
) -> np.ndarray:
    """Return the disks (disks, 3) [m] under tensions (6,) [N] and a force at the tip (3,) [N]."""
    strains = np.zeros((disks * pieces, 3))
    for share in np.arange(1, LOAD_STEPS + 1) / LOAD_STEPS:
        given = share * tensions, share * force, disks, twist
        last, factors = math.inf, None
        for _ in range(TURNS_MAX):
            gap = imbalance(strains, *given)
            size = np.abs(gap).max()
            if size < SETTLED:
                break
            if factors is None or size > 0.2 * last:  # the old slopes lead no further
                factors = lu_factor(jacobian(strains, *given))
            last = size
            strains = strains - lu_solve(factors, gap.ravel()).reshape(-1, 3)
        else:
            raise RuntimeError(f'no equilibrium under {tensions} N and {force} N')
    points, inside = np.empty((disks + 1, 3)), np.empty((disks * pieces, 3, 3))
    place(strains, disks, points, np.empty((disks + 1, TENDONS, 3)), inside)
    return points[1:]


def limit(
    disks: int, tensions: np.ndarray, force: np.ndarray, twist: float = EI_OVER_GJ
) -> np.ndarray:
    """Return the disks (disks, 3) [m] for ever shorter pieces: errors fall with their square."""
    long, short = (
        solve(disks, count, tensions, force, twist) for count in (40 // disks, 80 // disks)
    )
    return short + (short - long) / 3.0


def tips(rows: list[dict[str, float]]) -> np.ndarray:
    """Return the tips (rows, 3) [m] of a table."""
    return np.array([[row[f'tip_{axis}'] for axis in 'xyz'] for row in rows])


def again(rows: list[dict[str, float]]) -> None:
    """Repeat the postures of rods.csv; write them as found here, with twenty and forty disks."""
    for disks in (20, 40):
        found = []
        for row in rows:
            tensions = np.array([row[f't{j}'] for j in range(1, 7)])
            force = np.array([row[f'force_{axis}'] for axis in 'xyz'])
            placed = limit(disks, tensions, force)
            places = {
                f'{name}_{axis}': round(float(x), 7)
                for name, at in (('mid', placed[disks // 2 - 1]), ('tip', placed[-1]))
                for axis, x in zip('xyz', at, strict=True)
            }
            found.append({**row, **places})
            print(f'{disks} disks: {len(found)} of {len(rows)}', file=sys.stderr)
        write(f'rods_{disks}.csv', found)
        apart = 1e3 * np.linalg.norm(tips(found) - tips(rows), axis=1)
        print(f'{disks} disks: {np.median(apart):.4f} mm from rods.csv, {apart.max():.4f} at most')


def shapes(disks: int) -> None:
    """Write the shapes of a rod that twists and of one that does not."""
    for name, twist in (('twisting', EI_OVER_GJ), ('stiff', 0.0)):
        random, rows = np.random.default_rng(5), []
        for posture in range(SHAPES):
            tensions = np.zeros(TENDONS)
            tensions[random.integers(3)] = random.uniform(0.2, 1.5)
            tensions[3 + random.integers(3)] = random.uniform(0.2, 1.2)
            for disk, at in enumerate(limit(disks, tensions, np.array(TIP_FORCE), twist)):
                row = {'posture': posture, 'disk': disk + 1}
                row |= {f't{j + 1}': round(float(t), 6) for j, t in enumerate(tensions)}
                row |= {axis: round(float(x), 7) for axis, x in zip('xyz', at, strict=True)}
                rows.append(row)
        write(f'shapes_{name}_{disks}.csv', rows)


def write(name: str, rows: list[dict[str, float]]) -> None:
    """Write a table beside rods.csv."""
    with (RODS / name).open('w', newline='') as file:
        writer = csv.DictWriter(file, rows[0].keys(), lineterminator='\n')
        writer.writeheader()
        writer.writerows(rows)


def main() -> int:
    """Repeat rods.csv, write what follows from it."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    with (RODS / 'rods.csv').open(newline='') as file:
        again([{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)])
    for disks in (20, 40):
        shapes(disks)
    return 0


if __name__ == '__main__':
    sys.exit(main())
