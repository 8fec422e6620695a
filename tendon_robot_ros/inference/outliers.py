"""
Readings and trials of a posture that contradict its other trials.

A trial measures y = c + G u + e, where c are the true places of the markers, u the errors of the
inputs, which displace the markers along the known columns of G, and e the noise of the tracker
with variance s². Least squares over the trials of a posture, with inputs that vary by as little as
usual, gives the residual M y with covariance s² M. The deleted residual r of reading i has the
squared norm d = r' M_ii^-1 r, distributed as s² chi² with rank(M_ii) degrees of freedom (Cook and
Weisberg 1982, 2.2): with fewer trials, or where inputs explain more of a reading, both its
residual and its expectation are smaller. s² is the median of all d over the median of chi², which
outliers hardly change, and the F distribution gives the limit of d. A trial is tested by the
squared norm of G u, relative to the mean of the other trials: a sum of chi² with weights s² + t²
g², where g are the singular values of G, times what the fit keeps of them, bounded by the largest
weight times chi². The variance t² of the inputs follows from the median of all trials.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ..common.arrays import RESOLUTION, Bools, Floats, Ints
from ..common.errors import NoEquilibriumError
from ..common.words import listed
from ..data import DataSet
from .noise import NEGLIGIBLE, input_slopes
from .predict import Point, Predictor
from .statistics import RARE, chi2_isf, f_isf

# [1] trials of a posture, and readings of a marker that agree, because of two that do not nobody
# knows which one is off
TRIALS_MIN = 3
# [1] of what the slopes of inputs explain, by which they may be wrong, because the model that they
# come from may lack an effect
SLOPES_OFF_FRACTION = 0.3
# [1] efficiency of the median of squared normal values as an estimate of their variance, because
# 8 m² f² = 0.3675 with the median m of chi² of one degree of freedom and its density f there
MEDIAN_EFFICIENCY = 0.37


def contradicted(moves: Floats, slopes: Floats) -> tuple[Bools, Bools]:
    """
    Return which readings (P, Q, J) and trials (P, Q) are contradicted by the other trials.

    In every posture the reading, or the trial, that is farthest beyond its limit is removed, and
    the others are tested again without it, because it biased what was expected of them. Where half
    of the trials of a posture, or of the readings of a marker, are off, none is left out: their
    scatter is that large. Where fewer than `TRIALS_MIN` readings of a marker agree, all are.

    Parameters
    ----------
    moves : (P, Q, J, 3) [m]
        How far readings are from some place of their marker; NaN where nothing was seen.
    slopes : (P, m, J, 3) [m]
        What inputs do, relative.

    """
    visible = np.isfinite(moves).all(axis=3)
    counts, runs = visible.sum(axis=2), visible.any(axis=2).sum(axis=1)
    still = np.nanmax(np.abs(moves), axis=(0, 1, 2), initial=0.0) < RESOLUTION  # never measured
    out, trials = np.zeros_like(visible), np.zeros(visible.shape[:2], dtype=bool)
    stale = np.flatnonzero(runs >= TRIALS_MIN).tolist()
    measured = np.where(still, np.nan, moves)
    residuals = {p: trial_residuals(measured[p], slopes[p]) for p in stale}
    ratio = _beyond(residuals)[2] if stale else 0.0
    while stale:
        for p in stale:
            kept = np.where(out[p, ..., None], np.nan, measured[p])
            residuals[p] = trial_residuals(kept, slopes[p], ratio)
        stale = []
        beyond = _beyond(residuals)[:2]
        for p, of_readings, of_trials in zip(residuals, *beyond, strict=True):
            if max(of_readings.max(), of_trials.max()) <= 1.0:
                continue
            if of_trials.max() >= of_readings.max():
                trials[p, int(of_trials.argmax())] = True
            else:
                q, j = divmod(int(of_readings.argmax()), visible.shape[2])
                out[p, q, j] = True
                trials[p, q] |= out[p, q].sum() > max(0.5 * counts[p, q], 1)  # most of it
            out[p] |= trials[p, :, None]
            stale.append(p)
    seen, agree = visible.sum(axis=1), (visible & ~out).sum(axis=1)  # (P, J)
    half = agree <= 0.5 * seen
    none = half & (agree < TRIALS_MIN) & (seen > 0)
    none &= (none.sum(axis=1) <= 0.5 * (seen > 0).sum(axis=1))[:, None]  # else it is the trials
    trials &= (trials.sum(axis=1) < 0.5 * runs)[:, None]
    out = np.where(half[:, None], none[:, None], out)
    return out & visible & ~trials[..., None], trials


def outlier_limits(sizes: Floats, freedom: Ints) -> Floats:
    """
    Return the sizes (...) beyond which one is an outlier, from the robust spread of all.

    Each is the norm of `freedom` values of the same spread; NaN and 0 values do not count. The
    largest of all is beyond its limit by chance with `RARE`.
    """
    valid = np.isfinite(sizes) & (freedom > 0)
    limits = np.sqrt(_squared_limits(np.where(valid, freedom, 0)))
    limits[valid] *= _spread(sizes, freedom)
    return limits


def _squared_limits(freedom: Ints) -> Floats:
    """Return the limits (...) of sums of squares of unit spread; infinite for no freedom."""
    limits, known = np.full(freedom.shape, np.inf), freedom[freedom > 0]
    for k in np.unique(known).tolist():
        p = RARE / len(known)
        limits[freedom == k] = k * f_isf(p, k, MEDIAN_EFFICIENCY * int(known.sum()))
    return limits


def _spread(sizes: Floats, freedom: Ints) -> float:
    """Return the spread of one value, of which sizes are the norms of `freedom` each."""
    valid = np.isfinite(sizes) & (freedom > 0)
    known, which = np.unique(freedom[valid], return_inverse=True)
    usual = np.sqrt([chi2_isf(0.5, k) for k in known.tolist()])
    return float(np.median(sizes[valid] / usual[which])) if valid.any() else 0.0


@dataclass(frozen=True)
class _Deviations:
    """Residuals of the fit of a posture; 0 degrees of freedom where there is no information."""

    sizes: Floats  # (Q, J) [m] roots of d
    freedom: Ints  # (Q, J)
    surely: Floats  # (Q, J) [1] fraction of a size that remains if the slopes are wrong
    moved: Floats  # (Q,) [m²] square of what inputs do, from the mean of the others
    strengths: Floats  # (Q, m) [m²] squares g²; 0: unknown
    shares: Floats  # (Q, m) [1] of the squares along these directions that the fit keeps


def trial_residuals(moves: Floats, slopes: Floats, ratio: float = 0.0) -> _Deviations:
    """
    Fit places and inputs to the trials (Q, J, 3) [m] of a posture; NaN was not seen.

    `ratio` [m²] is the variance of the tracker over that of the inputs; 0: these are unknown.
    """
    Q, J, _ = moves.shape
    g = slopes.reshape(len(slopes), -1).T  # (3 J, m)
    _, strong, directions = np.linalg.svd(g, full_matrices=False)
    g = g @ directions[strong > NEGLIGIBLE * strong.max(initial=RESOLUTION)].T  # (3 J, r)
    visible = np.isfinite(moves.reshape(Q, -1))
    a = visible[..., None] * g
    if ratio > 0.0:
        turned = a.swapaxes(1, 2)
        fit = np.linalg.solve(turned @ a + ratio * np.eye(a.shape[2]), turned)  # (Q, r, 3 J)
    else:
        fit = np.linalg.pinv(a, rcond=NEGLIGIBLE)
    across = visible[..., None] * np.eye(3 * J) - a @ fit  # (Q, 3 J, 3 J): s² over the covariance
    inverse = np.linalg.pinv(across.sum(axis=0), rcond=NEGLIGIBLE, hermitian=True)
    y = np.where(visible, moves.reshape(Q, -1), 0.0)
    y = np.where(visible, y - inverse @ np.einsum('qij,qj->i', across, y), 0.0)
    residual = np.einsum('qij,qj->qi', across, y).reshape(Q, J, 3)
    own = np.einsum('qjajb->qjab', (across - across @ inverse @ across).reshape(Q, J, 3, J, 3))
    values, axes = np.linalg.eigh(own)
    known = values > NEGLIGIBLE
    squares = np.einsum('qjab,qja->qjb', axes, residual) ** 2 / np.where(known, values, np.inf)
    measured = visible.reshape(Q, J, 3).any(axis=2)
    enough = measured & (measured.sum(axis=0) > 1)

    trials, u = measured.any(axis=1), np.einsum('qrj,qj->qr', fit, y)
    n = int(trials.sum())
    u = u - trials / max(n, 1) @ u
    by_inputs = (a @ u[..., None]).reshape(Q, J, 3)
    ratios = np.linalg.norm(by_inputs, axis=2) / np.maximum(
        np.linalg.norm(residual, axis=2), RESOLUTION
    )
    strengths = np.zeros((Q, len(slopes)))
    if n >= TRIALS_MIN:
        strengths[trials, : a.shape[2]] = np.linalg.svd(a[trials], compute_uv=False) ** 2
    shares = (strengths / np.maximum(strengths + ratio, RESOLUTION**2)) ** 2
    return _Deviations(
        np.sqrt(squares.sum(axis=2)),
        np.where(enough, known.sum(axis=2), 0),
        np.maximum(1.0 - SLOPES_OFF_FRACTION * ratios, 0.0),
        (by_inputs**2).sum(axis=(1, 2)) * n / max(n - 1, 1),
        strengths,
        shares,
    )


def _beyond(residuals: dict[int, _Deviations]) -> tuple[Floats, Floats, float]:
    """
    Return the deviations of readings (P, Q, J) and trials (P, Q), over their chance limits.

    A reading counts in full only if it is beyond its limit even where the slopes are wrong. Last
    is the variance of the tracker over that of the inputs [m²], from the medians of all.
    """
    sizes, freedom, surely, moved, strengths, shares = (
        np.stack([getattr(one, field.name) for one in residuals.values()])
        for field in fields(_Deviations)
    )
    sizes = np.maximum(sizes, RESOLUTION)
    readings = sizes / outlier_limits(sizes, freedom)
    readings = np.where(surely * readings > 1.0, readings, surely * readings)
    noise = max(_spread(sizes, freedom), RESOLUTION) ** 2
    variance = _input_variance(moved, strengths, shares, noise)
    weights = shares * (noise + variance * strengths)
    many = (strengths > 0.0).sum(axis=2)
    limits = _squared_limits(many) * np.where(many > 0, weights.max(axis=2), 1.0)
    return readings, np.sqrt(moved / limits), noise / max(variance, RESOLUTION**2)


def _input_variance(moved: Floats, strengths: Floats, shares: Floats, noise: float) -> float:
    """Return the variance [1] of the inputs by which squares (P, Q) [m²] have their median."""
    known = strengths > 0.0
    judged = known.any(axis=2)
    if not judged.any():
        return 0.0

    def usual(variance: float) -> float:
        """Return the median square over what it is expected to be (Satterthwaite 1946)."""
        weights = (shares * (noise + variance * strengths))[judged]
        total = weights.sum(axis=1)
        freedom = total**2 / (weights**2).sum(axis=1)
        median = total * (1.0 - 2.0 / (9.0 * freedom)) ** 3  # Wilson and Hilferty 1931
        return float(np.median(moved[judged] / median))

    low, high = 0.0, 1.0 if usual(0.0) > 1.0 else 0.0  # 1: an input that is off by itself
    while low < (variance := 0.5 * (low + high)) < high:
        low, high = (variance, high) if usual(variance) > 1.0 else (low, variance)
    return low


# [1] of the postures in which a description may have no equilibrium, else it is refused, because
# it is not that of the arm that was measured
UNSETTLED_FRACTION_MAX = 0.25


@dataclass(frozen=True)
class Outliers:
    """Readings and trials that the other trials contradict."""

    readings: Bools  # (P, Q, J) single marker readings
    trials: Bools  # (P, Q) whole trials
    distance: Floats  # (P, Q, J) [m] from the prediction by the other trials

    @property
    def any(self) -> bool:
        """Whether there are some."""
        return bool(self.readings.any() or self.trials.any())

    def rows(self, dataset: DataSet) -> list[dict[str, Any]]:
        """Name them: posture, trial and marker, None for the whole trial, and distance [m]."""

        def named(p: int, q: int, **more: Any) -> dict[str, Any]:
            return {'posture': dataset.postures[p], 'trial': dataset.trial_names[q], **more}

        rows = [named(p, q, marker=None) for p, q in np.argwhere(self.trials)]
        for p, q, j in np.argwhere(self.readings):
            distance = float(self.distance[p, q, j])
            rows.append(named(p, q, marker=dataset.markers[j].name, distance=distance))
        return rows

    def without(self, dataset: DataSet) -> DataSet:
        """Return the data set without them; a posture keeps at least one trial."""
        if not self.any:
            return dataset
        out = self.readings | self.trials[..., None]
        positions = np.where(out[..., None], np.nan, dataset.positions)
        return replace(dataset, positions=positions)


def find_outliers(predictor: Predictor, point: Point) -> Outliers:
    """Find readings and trials that the others of their posture contradict."""
    dataset = predictor.dataset
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', RuntimeWarning)  # a marker that no trial saw
        moves = dataset.positions - np.nanmedian(dataset.positions, axis=1, keepdims=True)
    distance = np.linalg.norm(moves, axis=-1)
    if not (dataset.trials >= TRIALS_MIN).any():
        nothing = np.zeros(dataset.mask.shape, dtype=bool)
        return Outliers(nothing, nothing.any(axis=2), distance)
    return Outliers(*contradicted(moves, input_slopes(predictor, point)), distance)


def without_unsettled(predictor: Predictor) -> tuple[DataSet, tuple[str, ...]]:
    """
    Leave out the few postures in which the description has no equilibrium, and name them.

    Raises
    ------
    NoEquilibriumError
        They are many, or one of a sequence, in which the next one needs it.

    """
    dataset = predictor.dataset
    if predictor.markers({}) is not None:
        return dataset, ()
    names = predictor.unsettled()
    few = 0 < len(names) <= UNSETTLED_FRACTION_MAX * len(dataset.postures)
    if not few or dataset.path != 'from_straight':
        where = listed(f'posture {name}' for name in names) or 'a posture on the way'
        effects = predictor.model.implicit_effects
        raise NoEquilibriumError(f'{where} of {dataset.name}', effects, np.inf)
    return dataset.select(set(dataset.postures) - set(names)), names
