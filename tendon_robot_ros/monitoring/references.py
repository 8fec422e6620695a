"""
What reference postures say of each other: which are misread, and how alike they err.

A reference that was misread by some millimetres (the tracker wrong for once, a tension read
wrongly, a hand at the arm) shifts what is learned, and widens what is expected of every posture
after it. Each reference is therefore predicted from all others that count: linear around what is
known, y = x + C b + noise with b ~ N(0, 1),

    nu = y - x - C m,   cov nu = C P C' + S,
    m = P sum C' S^-1 (y - x),   P^-1 = 1 + sum C' S^-1 C,

the sums over the others. The norm of nu, whitened, is judged by the test for outliers of the
diagnosis: against the robust spread of all, so that what a wrong reference adds to S hides none.
Of a description that lacks an effect the norms vary more than chance has it, by a factor on their
logarithms; the limit is then as much farther: a model that is wrong here and there makes no
reference a misread one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..comparison.outliers import outlier_limits

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
BATCHES = 1, 4, 8  # postures in a row whose innovations are added up
MAD_SD = 1.4826  # 1 sd of a normal distribution over its median absolute deviation
USUAL_MIN = 10  # references that tell how much a model that is wrong makes them vary
UPPER_SD = 2.33  # of the mean of batches: 99 %


@dataclass(frozen=True)
class Reference:
    """A posture as it was seen, linear in q imperfections of 1 sd each."""

    off: Floats  # (r,) [m] from what is expected without imperfections
    columns: Floats  # (r, q) [m per sd]
    scatter: Floats  # (r, r) [m²] covariance of what is new in every posture


def contradicted(references: Sequence[Reference | None], counts: Bools) -> Bools:
    """
    Tell which references (P,) the others contradict, those too that do not count.

    Parameters
    ----------
    references : (P,) sequence
        None where nothing was expected.
    counts : (P,) of bool
        Whose say counts.

    """
    sizes, freedom = np.full(len(references), np.nan), np.ones(len(references), dtype=np.int64)
    parts = dict[int, tuple[Reference, Floats]]()
    for i, one in enumerate(references):
        if one is not None and len(one.off):
            parts[i] = one, counts[i] * _told(one)
    all_of_it = sum(told for _, told in parts.values())
    for i, (one, told) in parts.items():
        others = all_of_it - told
        known = np.linalg.inv(np.eye(len(others)) + others[:, :-1])
        off = one.off - one.columns @ known @ others[:, -1]
        spread = one.columns @ known @ one.columns.T + one.scatter
        sizes[i], freedom[i] = np.sqrt(off @ np.linalg.solve(spread, off)), len(off)
    return _beyond(sizes, freedom)


def _beyond(sizes: Floats, freedom: npt.NDArray[np.int64]) -> Bools:
    """Tell which sizes are outliers, though of a model that lacks something they vary more."""
    seen, limits = np.isfinite(sizes), outlier_limits(sizes, freedom)
    if seen.sum() < USUAL_MIN:
        return np.zeros(len(sizes), dtype=np.bool_)
    apart = np.log(np.where(seen, sizes / limits, 1.0))
    middle = float(np.median(apart[seen]))
    varies = MAD_SD * float(np.median(np.abs(apart[seen] - middle)))
    expected = float(np.median(np.sqrt(0.5 / freedom[seen])))  # of the logarithm of a norm
    return np.asarray(seen & (apart - middle > -middle * max(1.0, varies / expected)))


def _told(one: Reference) -> Floats:
    """Return C' S^-1 (C, y - x) of a reference (q, q + 1)."""
    both = np.column_stack([one.columns, one.off])
    return np.asarray(one.columns.T @ np.linalg.solve(one.scatter, both))


def widening(scores: Sequence[tuple[Floats, Floats]]) -> float:
    """
    Return by how much the variance of innovations exceeds what is expected of it, 1 at least.

    Batch means: for scores d = sum C' S^-1 nu and their covariance V = sum C' S^-1 C over so many
    postures in a row, d' (V + 1)^-1 d against its mean, tr V (V + 1)^-1. Innovations that hang
    together make it larger for longer batches. The largest upper bound (99 %) counts.
    """
    worst = 1.0
    for length in BATCHES:
        ratios = []
        for i in range(0, len(scores) - length + 1, length):
            batch = scores[i : i + length]
            seen = np.sum([d for d, _ in batch], axis=0)
            told = np.sum([v for _, v in batch], axis=0)
            both = np.linalg.solve(told + np.eye(len(seen)), np.column_stack([seen, told]))
            mean = float(np.trace(both[:, 1:]))
            if mean > 0.0:
                ratios.append(float(seen @ both[:, 0]) / mean)
        if len(ratios) > 2:
            upper = np.mean(ratios) + UPPER_SD * np.std(ratios, ddof=1) / np.sqrt(len(ratios))
            worst = max(worst, float(upper))
    return worst
