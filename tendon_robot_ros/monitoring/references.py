"""
Statistics of the reference postures: sizes of noise, outliers, and widening of variances.

Sizes: linear postures y = C b + e have imperfections b of 1 sd each, and independent errors e with
the covariance S of remainder, tension noise, nonlinearity, and tracker noise. The likelihood is
that of the sequential filter (chain rule).

A reference that was misread by some millimetres (an error of the tracker or of a load cell, a hand
at the arm) biases the estimate and widens the prediction of every later posture. Each reference is
therefore predicted from all others that count, linear around the estimate, y = x + C b + noise
with b ~ N(0, 1),

    nu = y - x - C m,   cov nu = C P C' + S,
    m = P sum C' S^-1 (y - x),   P^-1 = 1 + sum C' S^-1 C,

with sums over the others. The norm of the whitened nu is tested as an outlier against the robust
spread of all norms, so that the contribution of a misread reference to S masks none. For a
description that lacks an effect the norms vary more than by chance; the limit on their logarithms
widens by the same factor, so that errors of the model do not exclude references.
"""

from __future__ import annotations

from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from ..common.arrays import Bools, Floats
from ..common.estimation import kalman_update
from ..data.arrays import SAMPLES_MIN
from ..inference.outliers import outlier_limits

# [1] lengths of batches of successive postures, because correlated innovations appear only in the
# sums
BATCHES = 1, 4, 8


class Reference(NamedTuple):
    """A measured posture, linear in q states of 1 sd each."""

    off: Floats  # (r,) [m] residual of the prediction without imperfections
    columns: Floats  # (r, q) [m per sd]
    scatter: Floats  # (r, r) [m²] covariance of the independent errors


def log_likelihood(references: Sequence[Reference]) -> float:
    """Return the log likelihood of references, each given those before, up to a constant."""
    q, total = references[0].columns.shape[1], 0.0
    mean, covariance = np.zeros(q), np.eye(q)
    for off, columns, scatter in references:
        after = kalman_update(mean, covariance, columns, off - columns @ mean, scatter)
        mean, covariance = after.mean, after.covariance
        total += after.log_likelihood
    return total


def contradicted(references: Sequence[Reference | None], counts: Bools) -> Bools:
    """
    Return which references (P,) the others contradict, including those that do not count.

    Parameters
    ----------
    references : (P,) sequence
        None without a prediction.
    counts : (P,) of bool
        Whether a reference contributes to the predictions.

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
    # outliers; for a model that lacks an effect the norms vary more
    finite, limits = np.isfinite(sizes), outlier_limits(sizes, freedom)
    if finite.sum() < SAMPLES_MIN:
        return np.zeros(len(sizes), dtype=np.bool_)
    apart = np.log(np.where(finite, sizes / limits, 1.0))
    middle = float(np.median(apart[finite]))
    deviation = float(np.median(np.abs(apart[finite] - middle)))
    varies = deviation / NormalDist().inv_cdf(0.75)  # 1 sd of a normal distribution
    expected = float(np.median(np.sqrt(0.5 / freedom[finite])))  # of the logarithm of a norm
    return np.asarray(finite & (apart - middle > -middle * max(1.0, varies / expected)))


def widening(scores: Sequence[tuple[Floats, Floats]]) -> float:
    """
    Return the ratio of the variance of innovations to its prediction, at least 1.

    Batch means: for scores d = sum C' S^-1 nu and their covariance V = sum C' S^-1 C over batches
    of successive postures, the mean of d' (V + 1)^-1 d relative to its expectation
    tr V (V + 1)^-1. Correlated innovations increase it for longer batches. The result is the
    largest upper bound (99 %).
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
