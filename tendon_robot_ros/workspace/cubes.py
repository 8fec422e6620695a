"""
The cubes of space that hold a tip, the posture of least tension in each, where it looks.

What every posture goes through is compiled: whether the arm runs into itself, and its cube.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from ..robot import Robot

Floats = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]
compiled: Any = njit(cache=True, nogil=True)
# A line that turns by less than an angle in all has ends farther apart than cos(angle / 2) of its
# length (Schur): up to here more than 2/pi of it, also where bent cells are a tenth shorter.
TURNED_MIN_RAD = 0.5 * math.pi
HEIGHTS, TURNS = 6, 8  # equal areas of the sphere of directions: by height, and around the base
LOOKS = HEIGHTS * TURNS


@dataclass(frozen=True, eq=False)
class Reached:
    """The cubes of space that hold a tip, with the posture of least tension in each."""

    robot: Robot
    edge: float  # [m] of a cube
    cells: Numbers  # (c, 3) cube i spans i to i + 1 edges along x, y, z
    tensions: Floats  # (c, m) [N] of the posture with the lowest highest tension
    tips: Floats  # (c, 3) [m] of that posture
    directions: Floats  # (c, 3) its approach direction
    looks: Numbers  # (c,) into how many of the `LOOKS` equal parts of the sphere its tips look
    lows: Floats  # (3,) [m] the least coordinate of all tips
    highs: Floats  # (3,) [m] the greatest
    postures: int  # that are in it

    def __len__(self) -> int:
        """Count the cubes."""
        return len(self.cells)

    @property
    def is_flat(self) -> bool:
        """Whether all tips lie in the x-z plane."""
        return bool(len(self)) and bool(np.abs([self.lows[1], self.highs[1]]).max() < 1e-9)

    @property
    def size(self) -> float:
        """
        Volume [m³] of the tips; of a flat arm the area [m²].

        Counted are the corners of cubes with tips in all cubes around: of a convex body the mean
        number of grid points inside, however the grid lies. A surface or a curve has none.
        """
        return float(
            _inner_corners(self.cells, self.is_flat) * self.edge ** (2 + (not self.is_flat))
        )

    @cached_property
    def hull(self) -> tuple[Floats, Numbers, float]:
        """
        Vertices (v, 3) [m] of the convex hull of the tips, its faces, and its size.

        Faces (f, 3) are triangles between vertices, for a flat arm (f, 2) edges; the size is a
        volume [m³] or an area [m²], 0 where the tips span none.
        """
        from scipy.spatial import ConvexHull, QhullError

        points = self.tips[:, [0, 2]] if self.is_flat else self.tips
        try:
            found = ConvexHull(points)
        except (QhullError, ValueError):  # too few, or all on a line or in a plane
            return self.tips[:0], np.zeros((0, points.shape[1]), dtype=np.int64), 0.0
        names = np.full(len(points), -1)
        names[found.vertices] = np.arange(len(found.vertices))
        return self.tips[found.vertices], names[found.simplices], float(found.volume)

    @cached_property
    def outside(self) -> npt.NDArray[np.bool_]:
        """Which cubes (c,) have a free neighbour, (c,)."""
        return np.asarray(neighbours(self.cells, self.is_flat) < (8 if self.is_flat else 26))

    def to_json(self) -> dict[str, Any]:
        """Return plain data, in m, m² or m³."""
        return {
            'postures': self.postures,
            'cubes': len(self),
            'edge': self.edge,
            'is_flat': self.is_flat,
            'size': self.size,
            'hull': self.hull[2],
            'low': self.lows.tolist(),
            'high': self.highs.tolist(),
            'looks_mean': float(self.looks.mean()) if len(self) else 0.0,
        }


class Cubes:
    """Space around the base in cubes; memory is that of the cubes, however many postures come."""

    def __init__(self, robot: Robot, edge: float) -> None:
        self.robot, self.edge = robot, edge
        self.lengths = np.concatenate([[s.cell_length] * s.cells for s in robot.sections])
        self.half = int(np.ceil(1.05 * robot.length / edge))  # an arm may stretch a little
        self.side = 2 * self.half
        self.rows = np.full(self.side**3, -1, dtype=np.int32)  # which row holds a cube
        self.used = self.postures = 0
        self.where = np.zeros(0, dtype=np.int64)  # (rows,) which cube a row is
        self.best = np.zeros((0, len(robot.inputs) + 6))  # (rows, m + 6) tensions, tip, direction
        self.seen = np.zeros(0, dtype=np.int64)  # (rows,) a bit per part of all directions
        self.lows, self.highs = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, tensions: Floats, tips: Floats, directions: Floats) -> None:
        """Keep the posture of least tension in every cube, and where all of them look."""
        cells = np.floor(tips / self.edge + 1e-9).astype(np.int64) + self.half
        inside = ((cells >= 0) & (cells < self.side)).all(axis=1)
        if not inside.all():
            cells, tips = cells[inside], tips[inside]
            tensions, directions = tensions[inside], directions[inside]
        if not len(cells):
            return
        self.postures += len(cells)
        self.lows = np.minimum(self.lows, tips.min(axis=0))
        self.highs = np.maximum(self.highs, tips.max(axis=0))
        flat = (cells[:, 0] * self.side + cells[:, 1]) * self.side + cells[:, 2]
        looks = np.int64(1) << sphere_part(directions, 1)
        self._keep(flat, looks, np.concatenate([tensions, tips, directions], axis=1))

    def _keep(self, flat: Numbers, looks: Numbers, content: Floats) -> None:
        """Put postures, or the best ones of other cubes, into the cubes that they are in."""
        end = self.used + len(flat)
        if end > len(self.where):
            more = max(end, 2 * len(self.where), 1024) - len(self.where)
            self.where = np.concatenate([self.where, np.zeros(more, np.int64)])
            self.seen = np.concatenate([self.seen, np.zeros(more, np.int64)])
            self.best = np.concatenate([self.best, np.full((more, self.best.shape[1]), np.nan)])
        m = len(self.robot.inputs)
        self.used = keep_least(
            flat, looks, content, m, self.rows, self.where, self.best, self.seen, self.used
        )

    def packed(self) -> dict[str, npt.NDArray[Any]]:
        """Return what is known as arrays, without the empty cubes."""
        return {
            'where': self.where[: self.used],
            'seen': self.seen[: self.used],
            'best': self.best[: self.used],
            'span': np.array([self.lows, self.highs]),
            'postures': np.array(self.postures),
        }

    def merge(self, other: Mapping[str, npt.NDArray[Any]]) -> None:
        """Add what other cubes have packed; the order of several does not matter."""
        self._keep(other['where'], other['seen'], other['best'])
        self.lows = np.minimum(self.lows, other['span'][0])
        self.highs = np.maximum(self.highs, other['span'][1])
        self.postures += int(other['postures'])

    def clear(self) -> None:
        """Empty all cubes."""
        self.rows[self.where[: self.used]] = -1
        self.used = self.postures = 0
        self.lows, self.highs = np.full(3, np.inf), np.full(3, -np.inf)

    def cells(self) -> Numbers:
        """Return the cubes (c, 3), counted from the base."""
        found = np.unravel_index(self.where[: self.used], (self.side,) * 3)
        return np.stack(found, axis=1) - self.half

    def edge_tensions(self) -> Floats:
        """Return the tensions (c, m) [N] of cubes with few neighbours."""
        around = neighbours(self.cells(), bool(np.abs([self.lows[1], self.highs[1]]).max() < 1e-9))
        chosen = around <= np.median(around)
        tensions = self.best[: self.used][chosen, : len(self.robot.inputs)]
        return np.asarray(tensions[np.argsort(self.where[: self.used][chosen])])

    def reached(self) -> Reached:
        """Return what is known."""
        order = np.argsort(self.where[: self.used])
        m, best = len(self.robot.inputs), self.best[: self.used][order]
        empty = not self.used
        return Reached(
            robot=self.robot,
            edge=self.edge,
            cells=self.cells()[order],
            tensions=best[:, :m],
            tips=best[:, m : m + 3],
            directions=best[:, m + 3 :],
            looks=np.bitwise_count(self.seen[: self.used][order]).astype(np.int64),
            lows=np.zeros(3) if empty else self.lows,
            highs=np.zeros(3) if empty else self.highs,
            postures=self.postures,
        )


def sphere_part(directions: Floats, finer: int) -> Numbers:
    """Return in which of HEIGHTS x TURNS x finer² equal parts of the sphere directions lie."""
    heights, turns = HEIGHTS * finer, TURNS * finer
    up = np.clip(0.5 * (directions[:, 2] + 1.0) * heights, 0, heights - 1).astype(np.int64)
    turn = np.arctan2(directions[:, 1], directions[:, 0]) / (2.0 * np.pi) + 0.5
    return up * turns + np.clip(turn * turns, 0, turns - 1).astype(np.int64)


def beyond(cells: Numbers, known: Numbers) -> npt.NDArray[np.bool_]:
    """Tell which cubes (c, 3) are not among the known ones (k, 3), nor beside one of them."""
    if not len(known):
        return np.ones(len(cells), dtype=bool)
    low = np.minimum(cells.min(axis=0), known.min(axis=0)) - 1
    near = np.zeros(np.maximum(cells.max(axis=0), known.max(axis=0)) - low + 2, dtype=bool)
    for step in np.ndindex(3, 3, 3):
        near[tuple((known - low + step - 1).T)] = True
    known_or_beside: npt.NDArray[np.bool_] = near[tuple((cells - low).T)]
    return ~known_or_beside


def neighbours(cells: Numbers, is_flat: bool) -> Numbers:
    """Count the neighbours (c,) of every cube, up to 26, or 8 in the x-z plane."""
    full, shifted = _grid(cells)
    count = np.full(len(cells), -1)  # it is none of its own
    for step in np.ndindex(3, 1 if is_flat else 3, 3):
        count += full[tuple((shifted + step - (1, 0 if is_flat else 1, 1)).T)]
    return count


def _inner_corners(cells: Numbers, is_flat: bool) -> int:
    """Count the corners with a cube on all sides; in the x-z plane those with four squares."""
    full, shifted = _grid(cells)
    inner = np.ones(len(cells), dtype=bool)
    for step in np.ndindex(2, 1 if is_flat else 2, 2):
        inner &= full[tuple((shifted + step).T)]
    return int(inner.sum())


def _grid(cells: Numbers) -> tuple[npt.NDArray[np.bool_], Numbers]:
    """Return which cubes of a box are taken, with a free layer around, and their places in it."""
    shifted = cells - cells.min(axis=0, initial=np.iinfo(np.int64).max >> 1) + 1
    full = np.zeros(shifted.max(axis=0, initial=1) + 2, dtype=bool)
    full[tuple(shifted.T)] = True
    return full, shifted


def folds(positions: Floats, thickness: Floats, lengths: Floats) -> npt.NDArray[np.bool_]:
    """
    Tell which arms (b,) run into themselves.

    Two places of the backbone are nearer than the tendons beside them need, although the arm
    between them is long enough to turn round; or a cell bends until its holes meet.

    Parameters
    ----------
    positions : (b, n, 3) [m]
        Ends of the cells.
    thickness : (n,) [m]
        Farthest tendon from the backbone, in every cell.
    lengths : (n,) [m]
        Of the cells.

    """
    hit = np.zeros(len(positions), dtype=np.bool_)
    _folds(positions, thickness, np.cumsum(lengths) - 0.5 * lengths, hit)
    return hit


@compiled
def _folds(positions, thickness, along, hit):  # type: ignore[no-untyped-def]
    b, n = positions.shape[0], positions.shape[1]
    middles = np.empty((n, 3))
    for p in range(b):
        if _turn(positions[p]) < TURNED_MIN_RAD:
            continue
        for i in range(n):
            for axis in range(3):
                before = positions[p, i - 1, axis] if i else 0.0
                middles[i, axis] = 0.5 * (positions[p, i, axis] + before)
        hit[p] = _touches(middles, thickness, along)


@compiled
def _turn(ends):  # type: ignore[no-untyped-def]
    """Angle [rad] by which the straight pieces between the ends of cells turn, in all."""
    turned = 0.0
    for i in range(1, ends.shape[0]):
        dot = first = second = 0.0
        for axis in range(3):
            before = ends[i - 1, axis] - (ends[i - 2, axis] if i > 1 else 0.0)
            after = ends[i, axis] - ends[i - 1, axis]
            dot += before * after
            first += before * before
            second += after * after
        turned += math.acos(min(max(dot / math.sqrt(first * second), -1.0), 1.0))
    return turned


@compiled
def _touches(middles, thickness, along):  # type: ignore[no-untyped-def]
    n = middles.shape[0]
    for i in range(n):
        j = i + 1
        while j < n:
            apart = thickness[i] + thickness[j]
            if along[j] - along[i] <= 0.5 * math.pi * apart:
                j += 1
                continue
            x = middles[j, 0] - middles[i, 0]
            y = middles[j, 1] - middles[i, 1]
            z = middles[j, 2] - middles[i, 2]
            if x * x + y * y + z * z < apart * apart:
                return True
            j += 1
    return False


@compiled
def keep_least(flat, looks, content, m, rows, where, best, seen, used):  # type: ignore[no-untyped-def]
    """
    Put postures into cubes; return how many cubes are in use.

    Of every cube the posture of the lowest highest tension stays, of equal ones that of the least
    sum, so that the order in which they come does not matter.

    Parameters
    ----------
    flat : (b,)
        Cubes of the postures.
    looks : (b,)
        Bits of the parts of all directions.
    content : (b, m + 6)
        Tensions, tips, directions.
    m : int
    rows : (cubes,)
        Which row holds a cube; -1: none.
    where : (r,)
        Which cube a row is.
    best : (r, m + 6)
    seen : (r,)
    used : int
        Rows in use; there is room for b more.

    """
    for p in range(len(flat)):
        row = rows[flat[p]]
        if row < 0:
            row = used
            rows[flat[p]] = row
            where[row] = flat[p]
            seen[row] = looks[p]
            best[row] = content[p]
            used += 1
            continue
        seen[row] |= looks[p]
        if _is_less(content[p], best[row], m):
            best[row] = content[p]
    return used


@compiled
def _is_less(one, other, m):  # type: ignore[no-untyped-def]
    high = old_high = total = old_total = 0.0
    for j in range(m):
        high, old_high = max(high, one[j]), max(old_high, other[j])
        total, old_total = total + one[j], old_total + other[j]
    if high != old_high:
        return high < old_high
    if total != old_total:
        return total < old_total
    for j in range(len(one)):
        if one[j] != other[j]:
            return one[j] < other[j]
    return False
