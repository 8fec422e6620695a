"""
The arm as it is built: the imperfections that nobody declares, and how they move the markers.

Every arm has them: cells whose stiffness scatters or that are kinked at rest, tensions and holes
that are a little off, a tracker whose frame is. They are the same in every posture. One cell (or
tendon) is one column: the derivative of all markers by its imperfection.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..comparison.predict import CELLS, Predictor
from ..robot import Robot

Floats = npt.NDArray[np.float64]
KINK, ACROSS, GAIN, HOLE = 'cell_kink', 'cell_kink_across', 'channel_gain', 'hole_radius'
ZERO, POSITION, ROTATION = 'pull_zero', 'position', 'rotation'
REMAINDER = 'remainder'  # what no imperfection explains: another one in every posture
KINDS_WITH_FEW_MEMBERS = (GAIN, HOLE, ZERO, POSITION, ROTATION)  # kinds with few members
REMAINDER_SHAPES = 4  # shapes along the arm that a remainder may have
# Kind -> (unit, 1 sd that is plausible where nothing is declared, step of its derivative)
PLAUSIBLE_SIZES: dict[str, tuple[str, float, float]] = {
    CELLS: ('1', 0.03, 0.01),
    KINK: ('rad', math.radians(0.1), 1e-3),
    ACROSS: ('rad', math.radians(0.1), 1e-3),
    GAIN: ('1', 0.01, 5e-3),
    HOLE: ('1', 0.01, 1e-2),
    ZERO: ('m', 2e-4, 1e-4),
    POSITION: ('m', 5e-4, 1e-3),
    ROTATION: ('rad', math.radians(0.3), 1e-3),
}
PLAUSIBLE_LENGTH = 0.2  # [m] of the arm up to which plausible lengths are these; then they grow


@dataclass(frozen=True)
class Kind:
    """One kind of imperfection; its members share one standard deviation."""

    name: str
    unit: str
    plausible: float  # scale of the half-normal prior of that standard deviation [unit]
    members: tuple[str, ...]

    def __len__(self) -> int:
        """Return how many members it has."""
        return len(self.members)


Members = Mapping[str, Floats]  # kind -> size of each of its members


@dataclass(frozen=True)
class Imperfections:
    """The kinds that a data set may show, and what a unit of each member does to the markers."""

    kinds: tuple[Kind, ...]
    moves: Floats  # (q, P, J, 3) [m per unit], the members of all kinds one after the other

    @cached_property
    def owners(self) -> npt.NDArray[np.int64]:
        """Index (q,) of the kind that each column belongs to."""
        return np.repeat(np.arange(len(self.kinds)), [len(kind) for kind in self.kinds])

    def moved(self, members: Members) -> Floats | float:
        """Return what members do to the markers (P, J, 3) [m] by these slopes."""
        if not members:
            return 0.0
        own = [kind for kind in self.kinds if kind.name != REMAINDER]  # it is the last
        sizes = np.concatenate([members.get(kind.name, np.zeros(len(kind))) for kind in own])
        return np.asarray(np.tensordot(sizes, self.moves[: len(sizes)], 1))


def remainders(predictor: Predictor) -> Floats:
    """
    Return columns (q, P, J, 3) of a remainder of 1 m sd at the tip, posture by posture.

    The error of an arm that bends a little otherwise, at random along its length: twice
    integrated white noise, its `REMAINDER_SHAPES` largest shapes in each direction.
    """
    dataset = predictor.dataset
    share = dataset.arc_lengths / predictor.robot.length
    low, high = np.minimum.outer(share, share), np.maximum.outer(share, share)
    values, shapes = np.linalg.eigh(low**2 * (3.0 * high - low) / 2.0)
    shapes = (shapes * np.sqrt(np.maximum(values, 0.0)))[:, ::-1][:, :REMAINDER_SHAPES]
    P, J, q = len(dataset.postures), shapes.shape[0], shapes.shape[1]
    columns = np.zeros((P, q, 3, P, J, 3))
    for p in np.flatnonzero(dataset.trials > 0):
        for xyz in range(3):
            columns[p, :, xyz, p, :, xyz] = shapes.T
    return columns[dataset.trials > 0].reshape(-1, P, J, 3)


def planar_axis(robot: Robot) -> int | None:
    """Axis (0: x, 1: y) towards which an arm bends whose tendons all lie in one plane."""
    offsets = np.array([end for tendon in robot.tendons for end in (tendon.base, tendon.end)])
    flat = np.abs(offsets).max(axis=0) < 1e-6
    return 0 if flat[1] else 1 if flat[0] else None
