"""
Which readings and trials of a posture its other trials contradict.

A trial reads y = c + G u + e: c where the markers of the posture are, u how far its inputs were
off, which moves markers along the known columns of G, and e the tracker, of one variance s². The
least squares of a posture leave M y, of covariance s² M. What they leave of a reading i, deleted
from the others, has the squared norm d = r' M_ii^-1 r, which is s² chi² of as many degrees of
freedom as M_ii has rank (Cook and Weisberg 1982, 2.2): the fewer trials there are, and the more
of the reading inputs explain, the less is left of it, and the less is expected. s² is the median
of all d over that of chi², so that outliers do not count for it, and d is beyond chance by the F
distribution. Inputs are judged alike: the covariance of u is that of the fit and a variance that
all trials share.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .statistics import chi2_isf, f_isf

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Counts = npt.NDArray[np.int64]
FALSE_OUTLIER_PROBABILITY = 1e-3  # for the most extreme of all readings, or of all trials
TRIALS_MIN = 3  # trials of a posture, and readings of a marker: two can contradict one
OFF_SHARE = 0.5  # of markers beyond which their trial is off, of trials beyond which all may be
SLOPES_OFF_SHARE = 0.3  # of what slopes took off; the model that they are of may lack something
MEDIAN_EFFICIENCY = 0.37  # of a median as a variance, at least: that of squared normal values
NOTHING = 1e-3  # [1] of the strongest input or of a whole reading: no more than rounding
RESOLUTION = 1e-9  # [m] of positions: smaller moves are rounding


def contradicted(moves: Floats, slopes: Floats, share: Floats) -> tuple[Bools, Bools]:
    """
    Tell which readings (P, Q, J) and which trials (P, Q) the other trials contradict.

    The largest reading of a posture that is beyond chance is left out and the others are looked
    at again without it, as it moved what was expected of them; then the trials are, alike.

    Parameters
    ----------
    moves : (P, Q, J, 3) [m]
        How far readings are from some place of their marker; NaN where nothing was seen.
    slopes : (P, m, J, 3) [m]
        What inputs do, relative.
    share : (P, Q, J, 3) [m]
        What the measured inputs of each trial explain.

    """
    seen = np.isfinite(moves).all(axis=3)
    counts, runs = seen.sum(axis=2), seen.any(axis=2).sum(axis=1)
    still = np.nanmax(np.abs(moves), axis=(0, 1, 2), initial=0.0) < RESOLUTION  # never measured
    out, trials = np.zeros_like(seen), np.zeros(seen.shape[:2], dtype=bool)
    left = dict[int, _Left]()
    stale = np.flatnonzero(runs >= TRIALS_MIN)
    while len(stale):
        for p in stale.tolist():
            kept = np.where(out[p, ..., None] | still, np.nan, moves[p])
            left[p] = _left(kept, slopes[p], share[p])
        odd, spread = _odd_readings(left)
        if odd:
            for p, q, j in odd:
                out[p, q, j] = True
                trials[p, q] |= out[p, q].sum() > max(OFF_SHARE * counts[p, q], 1)
        else:
            odd = [(p, q, 0) for p, q in _odd_inputs(left, spread)]
            for p, q, _ in odd:
                trials[p, q] = True
        out |= trials[..., None]
        stale = np.array([p for p, *_ in odd], dtype=np.int64)
    trials &= (trials.sum(axis=1) < OFF_SHARE * runs)[:, None]
    out &= (out.sum(axis=1) < OFF_SHARE * seen.sum(axis=1))[:, None]
    return out & seen & ~trials[..., None], trials


def outlier_limits(sizes: Floats, freedom: Counts) -> Floats:
    """
    Return the sizes (...) beyond which one is an outlier, from the robust spread of all.

    Each is the norm of `freedom` values of the same spread; NaN and 0 values tell nothing. The
    largest of all is beyond its limit by chance with `FALSE_OUTLIER_PROBABILITY`.
    """
    told = np.isfinite(sizes) & (freedom > 0)
    limits = np.full(sizes.shape, np.inf)
    if told.any():
        p, known = FALSE_OUTLIER_PROBABILITY / int(told.sum()), int(freedom[told].sum())
        for k in np.unique(freedom[told]).tolist():
            factor = np.sqrt(k * f_isf(p, k, MEDIAN_EFFICIENCY * known))
            limits[freedom == k] = factor * _spread(sizes, freedom)
    return limits


def _spread(sizes: Floats, freedom: Counts) -> float:
    """Return the spread of one value, of which sizes are the norms of `freedom` each."""
    told = np.isfinite(sizes) & (freedom > 0)
    known, which = np.unique(freedom[told], return_inverse=True)
    usual = np.sqrt([chi2_isf(0.5, k) for k in known.tolist()])
    return float(np.median(sizes[told] / usual[which])) if told.any() else 0.0


@dataclass(frozen=True)
class _Left:
    """What the fit of a posture leaves; where nothing is told, of 0 degrees of freedom."""

    sizes: Floats  # (Q, J) [m] roots of d
    freedom: Counts  # (Q, J)
    surely: Floats  # (Q, J) [1] share of a size that is left if the slopes are wrong
    inputs: Floats  # (Q, m) [1] squares of inputs from their mean, along their own axes
    blurred: Floats  # (Q, m) [1/m²] what s² adds to the variance of each; NaN: not told


def _left(moves: Floats, slopes: Floats, share: Floats) -> _Left:
    """Fit places and inputs to the trials (Q, J, 3) [m] of a posture; NaN was not seen."""
    Q, J, _ = moves.shape
    g = slopes.reshape(len(slopes), -1).T  # (3 J, m)
    _, strong, ways = np.linalg.svd(g, full_matrices=False)
    g = g @ ways[strong > NOTHING * strong.max(initial=RESOLUTION)].T  # (3 J, r)
    seen = np.isfinite(moves.reshape(Q, -1))
    a = seen[..., None] * g
    fit = np.linalg.pinv(a, rcond=NOTHING)  # (Q, r, 3 J)
    across = seen[..., None] * np.eye(3 * J) - a @ fit  # (Q, 3 J, 3 J): what inputs cannot do
    inverse = np.linalg.pinv(across.sum(axis=0), rcond=NOTHING, hermitian=True)
    y = np.where(seen, (moves - share).reshape(Q, -1), 0.0)
    y = np.where(seen, y - inverse @ np.einsum('qij,qj->i', across, y), 0.0)
    left = np.einsum('qij,qj->qi', across, y).reshape(Q, J, 3)
    own = np.einsum('qjajb->qjab', (across - across @ inverse @ across).reshape(Q, J, 3, J, 3))
    values, axes = np.linalg.eigh(own)
    told = values > NOTHING
    squares = np.einsum('qjab,qja->qjb', axes, left) ** 2 / np.where(told, values, np.inf)
    here = seen.reshape(Q, J, 3).any(axis=2)
    enough = here & (here.sum(axis=0) >= TRIALS_MIN)

    trials, u = here.any(axis=1), np.einsum('qrj,qj->qr', fit, y)
    n = int(trials.sum())
    u = u - u[trials].mean(axis=0) if n else u
    taken = (a @ u[..., None]).reshape(Q, J, 3) + share - share[trials].mean(axis=0)
    shares = np.linalg.norm(taken, axis=2) / np.maximum(np.linalg.norm(left, axis=2), RESOLUTION)
    blurred, along = np.linalg.eigh(fit @ fit.swapaxes(1, 2))
    inputs = np.einsum('qrs,qr->qs', along, u) ** 2 * n / max(n - 1, 1)
    none = ((0, 0), (0, len(slopes) - g.shape[1]))
    return _Left(
        np.sqrt(squares.sum(axis=2)),
        np.where(enough, told.sum(axis=2), 0),
        np.maximum(1.0 - SLOPES_OFF_SHARE * shares, 0.0),
        np.pad(inputs, none),
        np.pad(
            np.where(trials[:, None] & (n >= TRIALS_MIN), blurred, np.nan),
            none,
            constant_values=np.nan,
        ),
    )


def _odd_readings(left: dict[int, _Left]) -> tuple[list[tuple[int, int, int]], float]:
    """Return the worst outlier (p, q, j) of every posture that has some, and the spread [m]."""
    sizes = np.stack([np.maximum(one.sizes, RESOLUTION) for one in left.values()])
    freedom = np.stack([one.freedom for one in left.values()])
    surely = np.stack([one.surely for one in left.values()])
    beyond = surely * sizes / outlier_limits(sizes, freedom)
    worst = [np.unravel_index(int(np.argmax(one)), one.shape) for one in beyond]
    odd = [
        (p, int(q), int(j))
        for p, one, (q, j) in zip(left, beyond, worst, strict=True)
        if one[q, j] > 1.0
    ]
    return odd, max(_spread(sizes, freedom), RESOLUTION)


def _odd_inputs(left: dict[int, _Left], spread: float) -> list[tuple[int, int]]:
    """Return the worst trial (p, q) by its inputs of every posture that has some."""
    squares = np.stack([one.inputs for one in left.values()])  # (P, Q, m)
    blurred = spread**2 * np.stack([one.blurred for one in left.values()])
    freedom = np.isfinite(blurred).sum(axis=2)

    def sizes(variance: float) -> Floats:
        return np.asarray(np.sqrt(np.nansum(squares / (variance + blurred), axis=2)))

    low, high = 0.0, float(squares.max(initial=0.0))
    if _spread(sizes(0.0), freedom) > 1.0:
        while low < (variance := 0.5 * (low + high)) < high:
            more = _spread(sizes(variance), freedom) > 1.0
            low, high = (variance, high) if more else (low, variance)
    beyond = sizes(low) / outlier_limits(sizes(low), freedom)
    worst = beyond.argmax(axis=1)
    return [(p, int(q)) for p, one, q in zip(left, beyond, worst, strict=True) if one[q] > 1.0]
