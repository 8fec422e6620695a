"""
What reference postures say: sizes of what is new in each, which are misread, how alike they err.

Sizes: linear postures y = C b + e have imperfections b of 1 sd each, and e that is new in every
posture, with the covariance r^2 R + s^2 G G' + B B' + n^2 I of remainder, tensions as read, what
is not linear, and noise. A filter that learns posture by posture would find the same likelihood
(chain rule); in one batch what a size has no part in is worked out once.

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
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..comparison.outliers import outlier_limits

Bools = npt.NDArray[np.bool_]
# C (n, q), y (n,), B (n, k), and of R (n, n) eigenvalues (n,) and eigenvectors (n, n)
Posture = tuple[Floats, Floats, Floats, tuple[Floats, Floats]]
# [1] postures in a row whose innovations are added up, because those that hang together show only
# so
BATCHES = 1, 4, 8
# [1] references; fewer would not tell how much a model that is wrong makes them vary
USUAL_MIN = 10


def log_likelihoods(
    postures: Sequence[Posture],
    gains: npt.NDArray[np.intp],
    noise: float,
    remainders: Sequence[float],
    settings: Sequence[float],
) -> Floats:
    """
    Return the log likelihood for every remainder and setting, up to a constant.

    Parameters
    ----------
    postures : sequence of (C, y, B, R)
        As above, in [m] where they are seen; R, as its eigenvalues and vectors, of 1 m.
    gains : (m,) of int
        Columns of C that are gains: G, a tension that is read wrongly is as one.
    noise : float
        1 sd of a coordinate [m].
    remainders, settings : sequence of float
        Sizes r [m] and s, 1 sd each.

    Returns
    -------
    ndarray, shape (remainders, settings)

    """
    turned = []  # to where R is diagonal: that diagonal, [C y] and [G B]
    for columns, off, bent, (sizes, axes) in postures:
        beside = np.column_stack([columns[:, gains], bent])
        known = axes.T @ np.column_stack([columns, off])
        turned.append((sizes.clip(0.0), known, axes.T @ beside))
    likely = np.empty((len(remainders), len(settings)))
    for i, remainder in enumerate(remainders):
        both, spread, parts = np.zeros(()), 0.0, []
        for sizes, known, beside in turned:
            variance = remainder**2 * sizes + noise**2
            weighted = beside / variance[:, None]
            both = both + known.T @ (known / variance[:, None])  # (q + 1, q + 1)
            spread += float(np.log(variance).sum())
            parts.append((weighted.T @ known, weighted.T @ beside))
        for j, setting in enumerate(settings):
            likely[i, j] = _likelihood(both, spread, parts, setting, gains)
    return likely


def _likelihood(
    both: Floats,
    spread: float,
    beside: Sequence[tuple[Floats, Floats]],
    setting: float,
    gains: npt.NDArray[np.intp],
) -> float:
    """Take tensions as read and what is not linear into account (Woodbury), then b's own size."""
    taken = []
    for known, itself in beside:
        scale = np.ones(len(itself))
        scale[: len(gains)] = setting
        root = np.linalg.cholesky(np.eye(len(itself)) + scale[:, None] * itself * scale)
        spread += 2.0 * float(np.log(np.diag(root)).sum())
        taken.append(np.linalg.solve(root, scale[:, None] * known))
    stacked = np.vstack(taken)
    left = both - stacked.T @ stacked
    information, gradient = np.eye(len(left) - 1) + left[:-1, :-1], left[:-1, -1]
    spread += float(np.linalg.slogdet(information)[1])
    return -0.5 * float(left[-1, -1] - gradient @ np.linalg.solve(information, gradient) + spread)


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
            both = np.column_stack([one.columns, one.off])
            parts[i] = one, counts[i] * (one.columns.T @ np.linalg.solve(one.scatter, both))
    total = sum(sums for _, sums in parts.values())
    for i, (one, sums) in parts.items():
        others = total - sums
        known = np.linalg.inv(np.eye(len(others)) + others[:, :-1])
        off = one.off - one.columns @ known @ others[:, -1]
        spread = one.columns @ known @ one.columns.T + one.scatter
        sizes[i], freedom[i] = np.sqrt(off @ np.linalg.solve(spread, off)), len(off)
    # outliers, though of a model that lacks something sizes vary more
    seen, limits = np.isfinite(sizes), outlier_limits(sizes, freedom)
    if seen.sum() < USUAL_MIN:
        return np.zeros(len(sizes), dtype=np.bool_)
    apart = np.log(np.where(seen, sizes / limits, 1.0))
    middle = float(np.median(apart[seen]))
    deviation = float(np.median(np.abs(apart[seen] - middle)))
    varies = deviation / NormalDist().inv_cdf(0.75)  # 1 sd of a normal distribution
    expected = float(np.median(np.sqrt(0.5 / freedom[seen])))  # of the logarithm of a norm
    return np.asarray(seen & (apart - middle > -middle * max(1.0, varies / expected)))


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
            score = np.sum([d for d, _ in batch], axis=0)
            covariance = np.sum([v for _, v in batch], axis=0)
            both = np.linalg.solve(
                covariance + np.eye(len(score)), np.column_stack([score, covariance])
            )
            mean = float(np.trace(both[:, 1:]))
            if mean > 0.0:
                ratios.append(float(score @ both[:, 0]) / mean)
        if len(ratios) > 2:
            error = np.std(ratios, ddof=1) / np.sqrt(len(ratios))
            upper = np.mean(ratios) + NormalDist().inv_cdf(0.99) * error
            worst = max(worst, float(upper))
    return worst
