"""The cubes of space that hold a tip, the posture of least tension in each, where it looks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..common.arrays import Bools, Floats, Ints
from ..robot import Robot

# [1] equal areas of the sphere of directions, by height and around the base: 48, so that a bit for
# each fits into 64
SPHERE_PARTS = (6, 8)
SPHERE_PART_COUNT = math.prod(SPHERE_PARTS)


class Reached:
    """The cubes of space that hold a tip, with the posture of least tension in each."""

    def __init__(self, cubes: Cubes) -> None:
        rows, m = cubes.sorted(), len(cubes.robot.inputs)
        self.robot, self.postures = cubes.robot, cubes.postures  # that were added
        self.edge = cubes.edge  # [m] of a cube
        # (c, 3) cube i spans i to i + 1 edges along x, y, z
        cells = np.unravel_index(rows.where, (cubes.side,) * 3)
        self.cells = np.stack(cells, axis=1) - cubes.half
        # (c, m) [N] of the posture with the lowest highest tension, (c, 3) [m] and its direction
        self.tensions, self.tips, self.directions = np.split(rows.best, [m, m + 3], axis=1)
        # (c,) how many equal parts of the sphere hold approach directions
        self.looks = np.bitwise_count(rows.seen).astype(np.int64)
        empty = not len(rows.where)
        self.lows = np.zeros(3) if empty else cubes.lows  # (3,) [m] of the coordinates of all tips
        self.highs = np.zeros(3) if empty else cubes.highs  # (3,) [m]

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
        full, shifted = _grid(self.cells)
        inner = np.ones(len(self), dtype=bool)
        for step in np.ndindex(2, 1 if self.is_flat else 2, 2):
            inner &= full[tuple((shifted + step).T)]
        return float(inner.sum() * self.edge ** (2 if self.is_flat else 3))

    @cached_property
    def hull(self) -> tuple[Floats, Ints, float]:
        """
        Vertices (v, 3) [m] of the convex hull of the tips, its faces, and its size.

        Faces (f, 3) are triangles between vertices, for a flat arm (f, 2) edges; the size is a
        volume [m³] or an area [m²], 0 where the tips span none.
        """
        from scipy.spatial import ConvexHull, QhullError

        points = self.tips[:, [0, 2]] if self.is_flat else self.tips
        try:
            hull = ConvexHull(points)
        except (QhullError, ValueError):  # too few, or all on a line or in a plane
            return self.tips[:0], np.zeros((0, points.shape[1]), dtype=np.int64), 0.0
        names = np.full(len(points), -1)
        names[hull.vertices] = np.arange(len(hull.vertices))
        return self.tips[hull.vertices], names[hull.simplices], float(hull.volume)

    @cached_property
    def outside(self) -> Bools:
        """Which cubes (c,) have a free neighbour, (c,)."""
        return np.asarray(self.neighbours < (8 if self.is_flat else 26))

    @cached_property
    def neighbours(self) -> Ints:
        """How many cubes (c,) lie around each, up to 26, or 8 in the x-z plane."""
        full, shifted = _grid(self.cells)
        count = np.full(len(self), -1)  # it is none of its own
        for step in np.ndindex(3, 1 if self.is_flat else 3, 3):
            count += full[tuple((shifted + step - (1, 0 if self.is_flat else 1, 1)).T)]
        return count

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
        # loads may stretch an arm, but never to twice its length
        self.half = 2 * int(np.ceil(robot.length / edge))
        self.side = 2 * self.half
        self.postures = 0
        self.lows, self.highs = np.full(3, np.inf), np.full(3, -np.inf)
        none = np.zeros(0, dtype=np.int64)
        self._known = Rows(none, none, np.zeros((0, len(robot.inputs) + 6)))
        self._coming: list[Rows] = []

    def add(self, tensions: Floats, tips: Floats, directions: Floats) -> None:
        """Keep the posture of least tension in every cube, and the directions of all."""
        cells = np.floor(tips / self.edge + 1e-9).astype(np.int64) + self.half
        inside = ((cells >= 0) & (cells < self.side)).all(axis=1)
        content = np.concatenate([tensions, tips, directions], axis=1)[inside]
        where = np.ravel_multi_index(tuple(cells[inside].T), (self.side,) * 3)
        bits = np.int64(1) << sphere_part(directions[inside], 1)
        at = tips[inside]
        span = at.min(axis=0, initial=np.inf), at.max(axis=0, initial=-np.inf)
        self._put(Rows(where, bits, content), span, len(where))

    def _put(self, rows: Rows, span: npt.ArrayLike, postures: int) -> None:
        """Keep rows; sort them in when they are as many as what is known."""
        low, high = np.asarray(span)
        self.lows, self.highs = np.minimum(self.lows, low), np.maximum(self.highs, high)
        self.postures += postures
        self._coming.append(rows)
        if sum(len(one.where) for one in self._coming) > len(self._known.where):
            self.sorted()

    def sorted(self) -> Rows:
        """Return the row of every cube, in the order of the cubes."""
        if self._coming:
            parts = zip(self._known, *self._coming, strict=True)
            rows = Rows(*map(np.concatenate, parts))
            self._known, self._coming = rows.lowest_tension(len(self.robot.inputs)), []
        return self._known

    def packed(self) -> dict[str, npt.NDArray[Any]]:
        """Return the content as arrays."""
        span = np.array([self.lows, self.highs])
        return {**self.sorted()._asdict(), 'span': span, 'postures': np.array(self.postures)}

    def merge(self, other: Mapping[str, npt.NDArray[Any]]) -> None:
        """Add what other cubes have packed; the order of several does not matter."""
        rows = Rows(other['where'], other['seen'], other['best'])
        self._put(rows, other['span'], int(other['postures']))

    def __len__(self) -> int:
        """Count the cubes that hold a tip."""
        return len(self.sorted().where)


class Rows(NamedTuple):
    """Cubes, and of each a posture."""

    where: Ints  # (r,) which cube: its place in the box of all
    seen: Ints  # (r,) a bit for every part of the sphere that holds a direction
    best: Floats  # (r, m + 6) tensions, tip, direction

    def lowest_tension(self, inputs: int) -> Rows:
        """
        Return a row for every cube: the posture of the lowest highest tension of so many inputs.

        Of equal ones that of the least sum, then of the least numbers, so that the order in which
        they came does not matter.
        """
        tensions = self.best[:, :inputs]
        keys = (*self.best.T[::-1], tensions.sum(axis=1), tensions.max(axis=1), self.where)
        order = np.lexsort(keys)
        first = np.flatnonzero(np.diff(self.where[order], prepend=-1))
        visible = np.bitwise_or.reduceat(self.seen[order], first)
        kept = order[first]
        return Rows(self.where[kept], visible, self.best[kept])


def sphere_part(directions: Floats, finer: int) -> Ints:
    """Return the index (b,) of the part of the sphere of directions (b, 3), finer² as many."""
    heights, sectors = (finer * count for count in SPHERE_PARTS)
    up = np.clip(0.5 * (directions[:, 2] + 1.0) * heights, 0, heights - 1).astype(np.int64)
    fraction = np.arctan2(directions[:, 1], directions[:, 0]) / (2.0 * np.pi) + 0.5
    return up * sectors + np.clip(fraction * sectors, 0, sectors - 1).astype(np.int64)


def beyond(cells: Ints, known: Ints) -> Bools:
    """Tell which cubes (c, 3) are not among the known ones (k, 3), nor beside one of them."""
    if not len(known):
        return np.ones(len(cells), dtype=bool)
    low = np.minimum(cells.min(axis=0), known.min(axis=0)) - 1
    near = np.zeros(np.maximum(cells.max(axis=0), known.max(axis=0)) - low + 2, dtype=bool)
    for step in np.ndindex(3, 3, 3):
        near[tuple((known - low + step - 1).T)] = True
    return np.asarray(~near[tuple((cells - low).T)])


def _grid(cells: Ints) -> tuple[Bools, Ints]:
    """Return the occupancy of a box of cubes with a free layer around, and their indices in it."""
    shifted = cells - cells.min(axis=0, initial=np.iinfo(np.int64).max >> 1) + 1
    full = np.zeros(shifted.max(axis=0, initial=1) + 2, dtype=bool)
    full[tuple(shifted.T)] = True
    return full, shifted


def folds(positions: Floats, thickness: Floats, lengths: Floats) -> Bools:
    """
    Return which arms (b,) collide with themselves.

    Two places of the backbone are nearer than the tendons beside them need, although the arm
    between them is long enough to turn round. How far a single cell bends does not count.

    Parameters
    ----------
    positions : (b, n, 3) [m]
        Ends of the cells.
    thickness : (n,) [m]
        Farthest tendon from the backbone, in every cell.
    lengths : (n,) [m]
        Of the cells.

    """
    ends = np.concatenate([np.zeros_like(positions[:, :1]), positions], axis=1)
    pieces = np.diff(ends, axis=1)
    sizes = np.sqrt(np.einsum('bnx,bnx->bn', pieces, pieces))
    products = np.einsum('bnx,bnx->bn', pieces[:, :-1], pieces[:, 1:])
    cosines = products / (sizes[:, :-1] * sizes[:, 1:])
    turned = np.arccos(np.clip(cosines, -1.0, 1.0)).sum(axis=1)
    along = np.cumsum(lengths) - 0.5 * lengths
    apart = np.add.outer(thickness, thickness)
    can_touch = np.subtract.outer(along, along) > 0.5 * math.pi * apart
    hit = np.zeros(len(positions), dtype=np.bool_)
    limit = np.where(can_touch, apart**2, -1.0)  # (n, n) [m²]
    # A line that turns by less than an angle in all has ends farther apart than cos(angle / 2) of
    # its length (Schur 1921): up to a quarter turn that is more than the 2/pi of it at which
    # places may touch, also where bent cells are a tenth shorter.
    bent = np.flatnonzero(turned >= 0.5 * math.pi)
    for part in np.array_split(bent, len(lengths)):  # small enough to stay in the cache
        middles = 0.5 * (ends[part, :-1] + ends[part, 1:])
        squares = np.einsum('bnx,bnx->bn', middles, middles)[:, :, None]
        ones = np.ones_like(squares)
        # |a|² - 2 a·b + |b|² of all pairs is one product of matrices
        a = np.concatenate([-2.0 * middles, squares, ones], axis=2)
        b = np.concatenate([middles, ones, squares], axis=2)
        hit[part] = (a @ b.transpose(0, 2, 1) < limit).any(axis=(1, 2))
    return hit
