"""Errors at equal inputs, reached in different ways: what no function of the inputs explains."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.arrays import Floats
from ..data import DataSet
from .statistics import normal_ppf

NEIGHBOURS = 10  # [1] nearest repeats of a posture, as is usual for this test (Jones 2004)


@dataclass(frozen=True)
class Repeats:
    """How far errors at equal inputs are apart beyond the noise."""

    apart: float  # [m] rms of the part of an error that differs at equal inputs
    spread: float  # [m²] standard deviation of the square of `apart`
    noise: float  # [m] rms of the noise there

    def is_told(self, level: float) -> bool:
        """Return whether errors differ, at a p-value, and by more than the noise."""
        return self.apart**2 > max(-normal_ppf(level) * self.spread, self.noise**2)


def repeats(dataset: DataSet, errors: Floats, noise: Floats, count: int) -> Repeats | None:
    """
    Compare the errors (P, J, 3) [m] of a sequence where its inputs nearly repeat.

    Half the mean square difference of the errors of k-th neighbours, less that of the noise, grows
    with the square of their distance; at distance zero remains what no smooth function of the
    inputs explains (Gamma test: Stefánsson, Končar & Jones 1997). Neighbours are of another block
    of time, with the same wires slack; of ten times as many postures the `count` with the nearest
    ones are used. The standard deviation is that of a jackknife over blocks. None where the arm
    does not go from one posture to the next, or where there are too few of them.

    Parameters
    ----------
    dataset : DataSet
    errors : (P, J, 3) [m]
    noise : (P,) [m²]
        Expected square of the distance of a marker from its place.
    count : int

    """
    measured = np.flatnonzero(dataset.trials > 0)
    blocks = dataset.groups[measured]
    number = len(np.unique(blocks))
    if dataset.path != 'sequence' or number < 2 or len(measured) < 2 * NEIGHBOURS:
        return None
    slack, errors, noise = np.isnan(dataset.inputs[measured]), errors[measured], noise[measured]
    inputs = np.nan_to_num(dataset.inputs[measured])
    chosen = np.unique(np.linspace(0, len(measured) - 1, 10 * count).round().astype(int))
    squares, halves = (np.empty((len(chosen), NEIGHBOURS)) for _ in range(2))
    for row, i in enumerate(chosen.tolist()):
        far = np.square(inputs - inputs[i]).sum(axis=1)
        far[(blocks == blocks[i]) | (slack != slack[i]).any(axis=1)] = np.inf
        near = np.argpartition(far, NEIGHBOURS)[:NEIGHBOURS]
        near = near[np.argsort(far[near])]
        squares[row] = far[near]
        apart = np.nanmean(np.square(errors[near] - errors[i]).sum(axis=2), axis=1)
        halves[row] = 0.5 * (apart - noise[near] - noise[i])
    known = np.isfinite(squares).all(axis=1) & np.isfinite(halves).all(axis=1)
    kept = np.flatnonzero(known)[np.argsort(squares[known].mean(axis=1))][:count]
    of, squares, halves = blocks[chosen][kept], squares[kept], halves[kept]
    members = [of == block for block in np.unique(of)]
    if len(members) < 2:
        return None

    def at_zero(rows: np.ndarray) -> float:
        x, y = squares[rows].mean(axis=0), halves[rows].mean(axis=0)
        slope = float((x - x.mean()) @ y / max(np.square(x - x.mean()).sum(), 1e-300))
        return float(y.mean() - max(slope, 0.0) * x.mean())

    without = np.array([at_zero(~own) for own in members])
    spread = np.sqrt((len(members) - 1) * np.var(without))
    left = max(at_zero(np.ones(len(of), dtype=bool)), 0.0)
    return Repeats(float(np.sqrt(left)), float(spread), float(np.sqrt(noise.mean())))
