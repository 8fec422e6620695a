"""
95 % intervals of what a fit estimates.

Of parameters from the curvature or by profile likelihood, of the size and direction of a force,
and of the sizes of imperfections.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from ..common.arrays import Floats
from ..common.words import spoken
from .fit import Fit
from .fitter import FAILURES, Fitter
from .imperfections import Members
from .marginal import NEGLIGIBLE, SIZE_MAX, Likelihood, Prior, RandomEffects
from .predict import FreeParameter, Point, Predictor
from .statistics import QUANTILE, SIGNIFICANCE, chi2_isf, chi2_sf

RISE_ERROR_MAX = 0.02  # [1] of a rise of the profile, because nobody reads more of an end
CURVATURE_ERROR_MAX = 0.1  # [1] of an end by curvature, else the profile likelihood decides
DIRECTION_TOLERANCE_RAD = 0.25 * math.pi  # [rad] half an interval, else it would be a guess
CORRELATED_FROM = 0.98  # [1] correlation of two values; else an interval would be 5 times as wide
NODES = 14  # [1] sizes at which an estimate is known, so that neighbours differ by a factor of 1.7
UNDETERMINED = 'not determined by these postures'


@dataclass(frozen=True)
class Value:
    """A fitted parameter with its 95 % interval [unit]."""

    value: float
    low: float
    high: float
    unit: str
    note: str = ''  # 'at its bound', `UNDETERMINED`, 'correlated with ...'

    def spanning(self, other: Value) -> Value:
        """Return the value with an interval that holds that of another one, too."""
        return replace(self, low=min(self.low, other.low), high=max(self.high, other.high))


Values = dict[str, dict[str, Value]]  # effect -> parameter -> its value


@dataclass(frozen=True)
class LoadVector:
    """
    Size and direction of a force at an arm, with 95 % intervals.

    Attributes
    ----------
    size : Value
        [N]
    from_axis : Value, optional
        [rad] from the axis of the straight arm (+z of its base); None where undetermined.
    around_axis : float
        [rad] about that axis, from x towards y.
    from_gravity : Value, optional
        [rad] from the direction in which weights pull; None where undetermined or gravity is not
        known.

    """

    size: Value
    from_axis: Value | None
    around_axis: float
    from_gravity: Value | None = None

    def spanning(self, other: LoadVector) -> LoadVector:
        """Return the load with intervals that hold those of another one, too."""

        def both(own: Value | None, more: Value | None) -> Value | None:
            return own.spanning(more) if own and more else own

        return LoadVector(
            self.size.spanning(other.size),
            both(self.from_axis, other.from_axis),
            self.around_axis,
            both(self.from_gravity, other.from_gravity),
        )


def intervals(
    fitter: Fitter, fit: Fit, scale: float = 1.0
) -> dict[FreeParameter, tuple[float, float]]:
    """
    Return 95 % intervals of the free parameters of a converged fit.

    An endpoint comes from the curvature at the fit where chi² at the endpoint agrees with it; else
    (bounds, asymmetry, reversals of friction) it is where the profile of chi² has risen by 3.84.
    Of an arm as built the deviance only tests whether the model is linear enough; the width comes
    from `Fit.interval_covariance`, which includes the uncertainty of the sizes of imperfections.

    Parameters
    ----------
    fitter : Fitter
        The one of the fit.
    fit : Fit
    scale : float
        Chi² over freedom where the fit is not adequate: intervals widen by its root.

    """
    wide = QUANTILE * math.sqrt(scale)
    fitter.resume(fit)
    ends = {}
    for i, free in enumerate(fit.frees):
        spread = float(np.sqrt(max(fit.interval_covariance[i, i], 0.0)))
        if not np.isfinite(spread):
            ends[free] = (free.parameter.low, free.parameter.high)
            continue
        low, high = (_endpoint(fitter, fit, i, side * spread, wide) for side in (-1.0, 1.0))
        ends[free] = (low, high)
    return ends


def _endpoint(fitter: Fitter, fit: Fit, i: int, spread: float, wide: float) -> float:
    """Return where the profile has risen by wide² on one side; the bound if it never does."""
    value, parameter = float(fit.values[i]), fit.frees[i].parameter
    bound = parameter.high if spread > 0.0 else parameter.low
    end = value + wide * spread
    wide *= abs(spread) / math.sqrt(fit.covariance[i, i])  # rise at the estimated sizes
    outside = end > parameter.high if spread > 0.0 else end < parameter.low
    if not outside:
        rise = _rise(fitter, fit, i, end)
        if abs(rise - wide) < CURVATURE_ERROR_MAX * wide:
            return end
    if value == bound:
        return value
    near, end = value, bound if outside else end
    profile = cache(lambda end: _profile(fitter, fit, i, end, wide))

    def beyond(end: float) -> float:
        rise = np.sqrt(max(profile(end) - profile(value), 0.0))
        off = float(min(rise, 2.0 * wide)) - wide  # bounded: it may have no equilibrium
        return off if abs(off) > RISE_ERROR_MAX * wide else 0.0

    while beyond(end) < 0.0:
        if end == bound:
            return bound
        near, end = end, float(np.clip(2.0 * end - value, parameter.low, parameter.high))
    # much finer, so that it only ends the search at a jump of the profile
    finest = RISE_ERROR_MAX**2 * abs(end - value)
    return float(brentq(beyond, near, end, xtol=finest))


def _rise(fitter: Fitter, fit: Fit, i: int, end: float) -> float:
    """
    Root of the rise of the deviance along the profile that the curvature predicts.

    Of an arm as built its imperfections move along, because an effect that acts as they do is one
    with them where both are taken from the model; all linear parameters are adjusted, except the
    sizes. Nan without equilibrium.
    """
    ends, deviances = (float(fit.values[i]), end) if fit.as_built else (end,), []
    for at in ends:
        moved, members, prior = _along(fit, i, at)
        fitter.linearise_around(members)
        markers = fitter.predictor.markers(moved, near=fit.settled)
        if markers is None:
            return float('nan')
        residual = fitter.residual(markers)
        if not fit.as_built:
            return float(np.sqrt(max(float(residual @ residual) + prior - fit.chi2, 0.0)))
        others = np.delete(np.arange(len(fit.all_frees)), i)
        slopes = fit.jacobian[: fitter.whitener.size, others]
        random, sizes = fit.built.random, fit.built.sizes
        work = Likelihood(random, residual, slopes, fit.precisions[others])
        deviances.append(work.deviance(sizes**2) + prior)
    at_fit, at_end = deviances
    return float(np.sqrt(max(at_end - at_fit, 0.0)))


def _along(fit: Fit, i: int, end: float) -> tuple[Point, Members, float]:
    """
    Return the point of the profile that the curvature predicts, and chi² of its priors.

    With the imperfections there.
    """
    rates, q = fit.covariance[:, i] / fit.covariance[i, i], len(fit.all_frees)
    moved, units = np.split(fit.values + np.nan_to_num(rates) * (end - fit.values[i]), [q])
    point = dict(zip(fit.all_frees, moved.tolist(), strict=True))
    point |= {free: free.clip(point[free]) for free in fit.frees}
    prior = [(point[n.free] - n.centre) / n.spread for n in fit.nuisances]
    members = fit.built.random.named(units, fit.built.sizes)
    return point, members, float(np.sum(np.square(prior)))


def _profile(fitter: Fitter, fit: Fit, i: int, end: float, wide: float) -> float:
    """
    Chi² with one parameter fixed at `end` and all others refitted.

    As accurate as a comparison of the root of its rise with `wide` asks for.
    """
    free = fit.frees[i]
    pinned = replace(free, parameter=replace(free.parameter, low=end, high=end))
    frees = (*fit.frees[:i], pinned, *fit.frees[i + 1 :])
    point, members, _ = _along(fit, i, end)
    start = {**point, pinned: end}
    fitter.linearise_around(members)
    try:
        search = fitter.search(frees, start, fit.built.sizes, fit.settled)
        search.gain_min = RISE_ERROR_MAX * wide**2
        search.run(8)
    except FAILURES:
        return float('inf')
    return float(search.r @ search.r)


def load_of(
    force: npt.ArrayLike, covariance: Floats | None = None, gravity: Sequence[float] | None = None
) -> LoadVector:
    """
    Return size and direction of a force, with 95 % intervals.

    Parameters
    ----------
    force : (3,) [N]
        In the base frame.
    covariance : (3, 3) [N²], optional
        Default: it is known exactly.
    gravity : (3,) [m/s²], optional
        In the base frame.

    """
    vector = np.asarray(force, dtype=float)
    spread = np.zeros((3, 3)) if covariance is None else covariance
    size = float(np.linalg.norm(vector))
    half = QUANTILE * _sd(spread, vector)
    down = None if gravity is None or not np.any(gravity) else np.array(gravity, dtype=float)
    return LoadVector(
        Value(size, max(size - half, 0.0), size + half, 'N'),
        _angle(vector, spread, np.eye(3)[2]),
        float(np.arctan2(vector[1], vector[0])),
        None if down is None else _angle(vector, spread, down / np.linalg.norm(down)),
    )


def _sd(spread: Floats, axis: Floats) -> float:
    """Return 1 sd [N] of a force along an axis (3,); along the worst where the axis is zero."""
    length = float(np.linalg.norm(axis))
    variance = axis @ spread @ axis / length**2 if length > 0.0 else np.linalg.eigvalsh(spread)[-1]
    return math.sqrt(max(float(variance), 0.0))


def _angle(vector: Floats, spread: Floats, axis: Floats) -> Value | None:
    """Return the angle [rad] to an axis; None where it is not determined."""
    size = float(np.linalg.norm(vector))
    if size == 0.0:
        return None
    along = float(vector @ axis)
    across = vector - along * axis
    steepest = across * size**2 - vector * float(across @ vector)  # of the angle
    half = QUANTILE * _sd(spread, steepest) / size
    if not half < DIRECTION_TOLERANCE_RAD:
        return None
    angle = float(np.arctan2(np.linalg.norm(across), along))
    low, high = max(angle - half, 0.0), min(angle + half, math.pi)
    plane = np.linalg.svd(axis[None])[2][1:]  # (2, 3) across the axis
    offset, known = plane @ across, plane @ spread @ plane.T
    by_chance = not offset.any()  # or inside of the 95 % ellipse around nothing
    if known.any():
        by_chance = float(offset @ np.linalg.pinv(known) @ offset) < chi2_isf(SIGNIFICANCE, 2)
    if by_chance:
        low, high = (0.0, high) if along > 0.0 else (low, math.pi)
    return Value(angle, low, high, 'rad')


def loads_of(
    fit: Fit, predictor: Predictor, scale: float = 1.0, covariance: Floats | None = None
) -> dict[str, LoadVector]:
    """
    Return the load of every effect of a fit that is a force.

    `scale` is of the covariance; default: the fit's.
    """
    loads, known = {}, fit.interval_covariance if covariance is None else covariance
    parts = {tuple(part.gravity.tolist()) for part in predictor.parts}
    gravity = next(iter(parts)) if len(parts) == 1 else None  # the same in all postures
    for effect in dict.fromkeys(free.effect for free in fit.frees):
        rows = vector_rows(fit.frees, effect)
        spread = scale * known[np.ix_(rows, rows)]
        if rows and np.isfinite(spread).all():
            loads[effect] = load_of(fit.values[rows], spread, gravity)
    return loads


def vector_rows(frees: Sequence[FreeParameter], effect: str) -> list[int]:
    """Return which free parameters are x, y and z of the force of an effect; none: it has none."""
    rows = {f.key: i for i, f in enumerate(frees) if (f.effect, f.parameter.unit) == (effect, 'N')}
    stems = [key.removesuffix('_x') for key in rows if key.endswith('_x')]
    for stem in stems:
        if {f'{stem}_y', f'{stem}_z'} <= set(rows):
            return [rows[f'{stem}_{axis}'] for axis in 'xyz']
    return []


class SizeIntervals:
    """
    Sampling distribution of the estimated size of each kind, at every true size.

    The estimate of a variance v has the variance 2 / J(v), J the expected information about it
    beside the other kinds and the parameters. It is distributed like the mean of g squared
    deviations of variance v + n minus n, the part of the noise: J = g / (v + n)² (Satterthwaite
    1946, at every v). An interval holds the sizes of which the estimate is not unlikely (Neyman
    1937). Evaluated at the tested sizes J limits the interval upwards even if the estimate is near
    zero, where J itself would not.
    """

    def __init__(
        self,
        random: RandomEffects,
        sizes: Floats,
        slopes: Floats | None = None,
        weights: Floats | None = None,
    ) -> None:
        """
        Take imperfections, and the sizes (K,) of the respective other kinds.

        Slopes (N, k) of parameters that are fitted along, and the precision (k,) of their priors,
        are as in `RandomEffects.estimate`.
        """
        residual = np.zeros(len(random.columns))
        slopes = np.zeros((len(residual), 0)) if slopes is None else slopes
        remainder = random.remainder is not None and sizes[random.remainder] > 0.0
        work = Likelihood(random, residual, slopes, weights, Prior.NONE, remainder)
        usual = np.where(np.isfinite(random.plausible), random.plausible, 0.0)
        others = np.maximum(sizes, 0.1 * NEGLIGIBLE * usual) ** 2
        self._kinds = []
        for k, plausible in enumerate(random.plausible.tolist()):
            shows = np.isfinite(plausible) and bool((random.owners == k).any())
            relative = np.geomspace(NEGLIGIBLE, 2.0 * SIZE_MAX, NODES)
            grid = (relative * plausible) ** 2 if shows else np.zeros(0)
            self._kinds.append(_Estimate.of(work, others, k, grid))

    def ends(self, estimates: Floats) -> tuple[Floats, Floats]:
        """
        Return the 95 % intervals (K,) of the sizes of which `found` (K,) are the estimates.

        The lower end is zero where `NEGLIGIBLE` of the plausible size is not excluded, the upper
        one infinite where twice `SIZE_MAX` of it is not.
        """
        pairs = [own.ends(one) for own, one in zip(self._kinds, estimates.tolist(), strict=True)]
        low, high = np.array(pairs).T
        return low, high


@dataclass(frozen=True)
class _Estimate:
    """Distribution of an estimated variance: freedom and noise as functions of the true one."""

    grid: Floats  # (n,) logarithms of true variances
    freedom: Floats  # (n,) logarithms of g
    noise: Floats  # (n,) logarithms

    @classmethod
    def of(cls, work: Likelihood, others: Floats, k: int, grid: Floats) -> _Estimate:
        """Return the distribution for variances (n,) of a kind, the others (K,) being known."""
        precision = np.zeros(len(grid))  # information of its logarithm
        for i, own in enumerate(grid.tolist()):
            v = others.copy()
            v[k] = own
            information = work.slopes(v).information * np.outer(v, v)
            length = np.sqrt(np.maximum(np.diag(information), 0.0))
            if length[k] > 0.0:
                each = np.where(length > 0.0, length, 1.0)
                alike = np.linalg.pinv(information / np.outer(each, each), hermitian=True)
                precision[i] = length[k] ** 2 / alike[k, k]
        if not len(grid) or precision.min() <= 0.0:
            return cls(np.zeros(0), precision, precision)
        logs = np.log(grid)
        fraction = (1.0 - 0.5 * np.gradient(np.log(precision), logs)).clip(1e-12, 1.0 - 1e-9)
        return cls(logs, np.log(precision / fraction**2), logs + np.log(1.0 / fraction - 1.0))

    def chance(self, estimate: float, log: float) -> float:
        """Return the probability of at least an estimated variance, given the true one's log."""
        true, freedom, noise = np.exp(
            [log, np.interp(log, self.grid, self.freedom), np.interp(log, self.grid, self.noise)]
        ).tolist()
        return chi2_sf(freedom * (estimate + noise) / (true + noise), freedom)

    def ends(self, size: float) -> tuple[float, float]:
        """Return the interval of the size whose estimate is `size`."""
        if not len(self.grid):
            return 0.0, np.inf
        tail = 0.5 * SIGNIFICANCE
        return self._size(size**2, tail), self._size(size**2, 1.0 - tail)

    def _size(self, estimate: float, tail: float) -> float:
        """Return the size at which at least such an estimate has the probability `tail`."""
        low, high = float(self.grid[0]), float(self.grid[-1])
        if self.chance(estimate, low) > tail:
            return 0.0 if tail < 0.5 else math.exp(0.5 * low)
        if self.chance(estimate, high) < tail:
            return math.inf if tail > 0.5 else math.exp(0.5 * high)

        def above(log: float) -> float:
            return self.chance(estimate, log) - tail

        return math.exp(0.5 * float(brentq(above, low, high, xtol=0.1 * NEGLIGIBLE)))


def values_of(fit: Fit, scale: float = 1.0, covariance: Floats | None = None) -> Values:
    """
    Return values with 95 % intervals by effect; `scale` widens them (chi² over freedom).

    `covariance` (default: `Fit.interval_covariance`) is that of the freed parameters.
    """
    quantile = QUANTILE * np.sqrt(scale)
    known = fit.interval_covariance if covariance is None else covariance
    spread = np.sqrt(np.maximum(np.diag(known), 0.0))
    values = Values()
    for i, free in enumerate(fit.frees):
        value, half = float(fit.values[i]), float(quantile * spread[i])
        low = float(max(value - half, free.parameter.low))
        high = float(min(value + half, free.parameter.high))
        values.setdefault(free.effect, {})[free.key] = Value(
            value, low, high, free.parameter.unit, _note(fit, i, half)
        )
    return values


def values_with_intervals(fitter: Fitter, fit: Fit, scale: float = 1.0) -> Values:
    """Return values of effects to add, with intervals by curvature or profile: `intervals`."""
    values = values_of(fit, scale)
    for free, (low, high) in intervals(fitter, fit, scale).items():
        known, parameter = values[free.effect][free.key], free.parameter
        # slopes that are alike for two parameters determine neither, but their bounds may
        told = known.note == UNDETERMINED and high - low < parameter.high - parameter.low
        note = '' if told else known.note
        values[free.effect][free.key] = replace(known, low=low, high=high, note=note)
    return values


def _note(fit: Fit, i: int, half: float) -> str:
    parameter = fit.frees[i].parameter
    if not half < (parameter.high - parameter.low):
        return UNDETERMINED
    if fit.values[i] in (parameter.low, parameter.high):
        return 'at its bound'
    spread = np.sqrt(np.diag(fit.covariance))
    for j, free in enumerate(fit.frees):
        alike = CORRELATED_FROM * spread[i] * spread[j]
        if j != i and abs(fit.covariance[i, j]) > alike > 0.0:
            return f'correlated with {spoken(free.key)}'
    return ''
