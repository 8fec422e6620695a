"""
Cells whose stiffness scatters: one declared tolerance, a parameter with a prior in every cell.

Their slopes are taken once per set of weights: they are small, and there are many of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ..comparison.noise import Whitener
from ..comparison.predict import CELLS, FreeParameter, Point, Predictor
from ..effects import Parameter
from ..robot import Robot
from .fit import Fit, Nuisance

Floats = npt.NDArray[np.float64]
CELL_STIFFNESS = Parameter('relative_change', '1', -0.95, 20.0, 0.0, 0.05)
STIFFNESS_STEP = 0.01  # relative change of a stiffness for its slope


def cell_nuisances(robot: Robot, spread: float) -> list[Nuisance]:
    """Return a parameter for the stiffness of every cell; `spread` is its relative 1 sd."""
    cells = [
        FreeParameter(CELLS, CELL_STIFFNESS, i, name) for i, name in enumerate(robot.cell_names)
    ]
    return [Nuisance(CELLS, free, 0.0, spread) for free in cells]


def cell_slopes(
    predictor: Predictor, nuisances: Sequence[Nuisance], point: Point
) -> dict[FreeParameter, Floats]:
    """Return the derivatives (P, J, 3) [m] of the markers by the cells' stiffness at a point."""
    frees = [n.free for n in nuisances if n.free.effect == CELLS]
    here = predictor.markers(point) if frees else None
    if here is None:
        return {}
    near, slopes = predictor.settled, {}
    for free in frees:
        moved = predictor.markers(
            {**point, free: point.get(free, 0.0) + STIFFNESS_STEP}, near=near
        )
        slopes[free] = np.zeros_like(here) if moved is None else (moved - here) / STIFFNESS_STEP
    return slopes


class CellRelief:
    """
    What the tolerance of the cells takes off a whitened residual when it is free to do so.

    For patterns that are fitted on top of a settled fit: its cells give way to the pattern.
    Without such a tolerance nothing changes.
    """

    def __init__(self, fit: Fit, whitener: Whitener) -> None:
        """Take the slopes and the values of the cells at a fit."""
        count, size = len(fit.frees), whitener.size
        own = [i for i, n in enumerate(fit.nuisances) if n.quantity == CELLS]
        spread = np.array([fit.nuisances[i].spread for i in own])
        columns = fit.jacobian[:size, [count + i for i in own]]
        self._shift = columns @ fit.values[[count + i for i in own]]
        self._columns = columns * spread
        self._normal = np.eye(len(own)) + self._columns.T @ self._columns

    def residual(self, white: Floats) -> Floats:
        """Return a residual (N,), taken at the fit's cells, with the best ones; they follow it."""
        return self.apply(white - self._shift)

    def apply(self, white: Floats) -> Floats:
        """Return (N + cells, ...) of whitened changes (N, ...) of the markers."""
        best = -np.linalg.solve(self._normal, self._columns.T @ white)
        return np.concatenate([white + self._columns @ best, best])
