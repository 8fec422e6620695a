"""
95 % intervals of what a fit estimates.

Of parameters from the curvature or by profile likelihood, of a force as people say it (size and
direction), and of the sizes of imperfections.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..common.words import spoken
from ..comparison.predict import FreeParameter, Point, Predictor
from ..comparison.statistics import chi2_isf, chi2_sf, normal_ppf
from .fit import Fit
from .fitter import FAILURES, ROUNDS_MAX, Fitter
from .marginal import NEGLIGIBLE, SIZE_MAX, Likelihood, Prior, RandomEffects
from .result import LoadVector, Value
from .verdict import CORRELATED_FROM, SIGNIFICANCE

QUANTILE = normal_ppf(1.0 - 0.5 * SIGNIFICANCE)  # [1] sd, so that 95 % are inside
CURVATURE_ERROR_MAX = 0.1  # [1] of an end by curvature, else the profile likelihood decides
TOLD_WITHIN_RAD = 0.25 * math.pi  # [rad] half an interval, else the direction would be a guess
NODES = 14  # [1] sizes at which an estimate is known, so that neighbours differ by a factor of 1.7


def intervals(
    fitter: Fitter, fit: Fit, scale: float = 1.0
) -> dict[FreeParameter, tuple[float, float]]:
    """
    Return 95 % intervals of the free parameters of a converged fit.

    An endpoint comes from the curvature at the fit where chi² there is what the curvature says;
    else (bounds, asymmetry, friction's kinks) it is where the profile of chi² has risen by 3.84.
    Of an arm as built the deviance at the estimated sizes of its imperfections says only whether
    the model is straight; how wide the interval is knows how well these sizes are told.

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
    """Where the profile has risen by wide² on one side; the bound where it never does."""
    value, parameter = float(fit.values[i]), fit.frees[i].parameter
    bound = parameter.high if spread > 0.0 else parameter.low
    end = value + wide * spread
    wide *= abs(spread) / math.sqrt(fit.covariance[i, i])  # of what rises at the estimated sizes
    outside = end > parameter.high if spread > 0.0 else end < parameter.low
    profile = _rise if fit.as_built else _profile_rise
    if not outside:
        rise = _rise(fitter, fit, i, end)
        if abs(rise - wide) < CURVATURE_ERROR_MAX * wide:
            return end
    if value == bound:
        return value
    plain, end = end, bound if outside else end
    rise = profile(fitter, fit, i, end)
    if outside and rise < wide:
        return bound
    for _ in range(ROUNDS_MAX):
        if abs(rise - wide) < 0.02 * wide or not np.isfinite(rise):
            break
        stretch = float(np.clip(wide / max(rise, 1e-6), 0.2, 5.0))
        end = float(np.clip(value + (end - value) * stretch, parameter.low, parameter.high))
        rise = profile(fitter, fit, i, end)
        if end == bound and rise < wide:
            break
    return end if np.isfinite(rise) else plain


def _rise(fitter: Fitter, fit: Fit, i: int, end: float) -> float:
    """
    Root of the rise of the deviance where the curvature says the profile runs.

    Of an arm as built all linear parameters go along, but for the sizes of its imperfections. NaN:
    no equilibrium.
    """
    ends, deviances = (float(fit.values[i]), end) if fit.as_built else (end,), []
    for at in ends:
        moved, prior = _along(fit, i, at)
        markers = fitter.predictor.markers(moved)
        if markers is None:
            return float('nan')
        residual = fitter.residual(markers)
        if not fit.as_built:
            return float(np.sqrt(max(float(residual @ residual) + prior - fit.chi2, 0.0)))
        others = np.delete(np.arange(len(fit.all_frees)), i)
        slopes = fit.jacobian[: fitter.whitener.size, others]
        random, sizes = fit.built.random, fit.built.sizes
        work = Likelihood(random.parts, residual, slopes, fit.precisions[others])
        deviances.append(work.deviance(sizes**2) + prior)
    here, there = deviances
    return float(np.sqrt(max(there - here, 0.0)))


def _along(fit: Fit, i: int, end: float) -> tuple[Point, float]:
    """Return the point at which the curvature says the profile runs, and chi² of its priors."""
    share = fit.covariance[:, i] / fit.covariance[i, i]
    moved = (fit.values + np.nan_to_num(share) * (end - fit.values[i]))[: len(fit.all_frees)]
    lows = [f.parameter.low for f in fit.frees] + [-np.inf] * len(fit.nuisances)
    highs = [f.parameter.high for f in fit.frees] + [np.inf] * len(fit.nuisances)
    moved = np.clip(moved, lows, highs)
    prior = [
        (value - n.centre) / n.spread
        for value, n in zip(moved[len(fit.frees) :], fit.nuisances, strict=True)
    ]
    point = dict(zip(fit.all_frees, moved.tolist(), strict=True))
    return point, float(np.sum(np.square(prior)))


def _profile_rise(fitter: Fitter, fit: Fit, i: int, end: float) -> float:
    """Root of the rise of chi² with one parameter put somewhere and all others refitted."""
    free = fit.frees[i]
    pinned = replace(free, parameter=replace(free.parameter, low=end, high=end))
    frees = (*fit.frees[:i], pinned, *fit.frees[i + 1 :])
    start = {key: value for key, value in fit.point.items() if key != free} | {pinned: end}
    fitter.resume(fit)
    try:
        refit = fitter.fit(frees, start, steps=8, sizes=fit.built.sizes)
    except FAILURES:
        return float('inf')
    return float(np.sqrt(max(refit.chi2 - fit.chi2, 0.0)))


def load_of(
    force: npt.ArrayLike,
    covariance: Floats | None = None,
    gravity: Sequence[float] | None = None,
    scale: float = 1.0,
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
    scale : float
        Of the covariance.

    """
    vector = np.asarray(force, dtype=float)
    spread = np.zeros((3, 3)) if covariance is None else scale * np.asarray(covariance)
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
    """Return 1 sd [N] of a force along an axis (3,); of a zero one: along its worst."""
    length = float(np.linalg.norm(axis))
    variance = axis @ spread @ axis / length**2 if length > 0.0 else np.linalg.eigvalsh(spread)[-1]
    return math.sqrt(max(float(variance), 0.0))


def _angle(vector: Floats, spread: Floats, axis: Floats) -> Value | None:
    """Return the angle [rad] to an axis; its interval holds 0 or pi where chance alone may."""
    size = float(np.linalg.norm(vector))
    if size == 0.0:
        return None
    along = float(vector @ axis)
    across = vector - along * axis
    away = across * size**2 - vector * float(across @ vector)  # in which the angle grows
    half = QUANTILE * _sd(spread, away) / size
    if not half < TOLD_WITHIN_RAD:
        return None
    angle = float(np.arctan2(np.linalg.norm(across), along))
    low, high = max(angle - half, 0.0), min(angle + half, math.pi)
    plane = np.linalg.svd(axis[None])[2][1:]  # (2, 3) across the axis
    seen, known = plane @ across, plane @ spread @ plane.T
    by_chance = not seen.any()  # or inside of the 95 % ellipse around nothing
    if known.any():
        by_chance = float(seen @ np.linalg.pinv(known) @ seen) < chi2_isf(SIGNIFICANCE, 2)
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
    made, known = {}, fit.interval_covariance if covariance is None else covariance
    parts = {tuple(part.gravity.tolist()) for part in predictor.parts}
    gravity = next(iter(parts)) if len(parts) == 1 else None  # the same in all postures
    for effect in dict.fromkeys(free.effect for free in fit.frees):
        rows = vector_rows(fit.frees, effect)
        spread = known[np.ix_(rows, rows)]
        if rows and np.isfinite(spread).all():
            made[effect] = load_of(fit.values[rows], spread, gravity, scale)
    return made


def vector_rows(frees: Sequence[FreeParameter], effect: str) -> list[int]:
    """Return which free parameters are x, y and z of the force of an effect; none: it has none."""
    rows = {f.key: i for i, f in enumerate(frees) if (f.effect, f.parameter.unit) == (effect, 'N')}
    stems = [key.removesuffix('_x') for key in rows if key.endswith('_x')]
    return next(
        (
            [rows[f'{stem}_{axis}'] for axis in 'xyz']
            for stem in stems
            if {f'{stem}_y', f'{stem}_z'} <= set(rows)
        ),
        [],
    )


class SizeIntervals:
    """
    How the estimate of the size of each kind is distributed, whatever its true size.

    The estimate of a variance v is spread with the variance 2 / J(v), J the expected information
    that is left of it beside the other kinds and the parameters. It acts as the mean of g squared
    deviations of a variance v + n, of which n is noise, taken off: J = g / (v + n)² (Satterthwaite
    1946, at every v). An interval holds the sizes of which the found one is no rare estimate
    (Neyman 1937): how well a size is told counts where it is tried. At a found size near zero
    noise tells nothing of how far up the true one may be, at the sizes that are tried it does.
    """

    def __init__(
        self,
        random: RandomEffects,
        sizes: Floats,
        slopes: Floats | None = None,
        weights: Floats | None = None,
    ) -> None:
        """
        Take imperfections, and the sizes (K,) at which the other kinds are, each in turn.

        Slopes (N, k) of parameters that go along, and the precision (k,) of their priors, are as
        in `RandomEffects.estimate`.
        """
        rows, parts = len(random.columns), random.parts
        slopes = np.zeros((rows, 0)) if slopes is None else slopes
        if parts.kind is not None and sizes[parts.kind] == 0.0:
            parts = replace(parts, kind=None)
        work = Likelihood(parts, np.zeros(rows), slopes, weights, Prior.NONE)
        usual = np.where(np.isfinite(random.plausible), random.plausible, 0.0)
        others = np.maximum(sizes, 0.1 * NEGLIGIBLE * usual) ** 2
        self._kinds = []
        for k, plausible in enumerate(random.plausible.tolist()):
            shows = np.isfinite(plausible) and bool((random.owners == k).any())
            shares = np.geomspace(NEGLIGIBLE, 2.0 * SIZE_MAX, NODES)
            grid = (shares * plausible) ** 2 if shows else np.zeros(0)
            self._kinds.append(_Estimate.of(work, others, k, grid))

    def ends(self, found: Floats) -> tuple[Floats, Floats]:
        """
        Return the 95 % intervals (K,) of the sizes of which `found` (K,) are the estimates.

        The lower end is zero where a size of `NEGLIGIBLE` of what is plausible is no rare cause;
        the upper one infinite where no size up to twice `SIZE_MAX` is a rare one.
        """
        pairs = [own.ends(value) for own, value in zip(self._kinds, found.tolist(), strict=True)]
        low, high = np.array(pairs).T
        return low, high


class _Estimate:
    """The estimate of one variance: its deviations and its noise, as they go with the true one."""

    def __init__(self, grid: Floats, freedom: Floats, noise: Floats) -> None:
        """Take logarithms of true variances (n,), and those of g (n,) and of the noise (n,)."""
        self.grid, self.freedom, self.noise = grid, freedom, noise

    @classmethod
    def of(cls, work: Likelihood, others: Floats, k: int, grid: Floats) -> _Estimate:
        """Tell how well each variance (n,) of a kind would be told beside the others (K,)."""
        told = np.zeros(len(grid))  # information of its logarithm
        for i, own in enumerate(grid.tolist()):
            v = others.copy()
            v[k] = own
            information = work.slopes(v).information * np.outer(v, v)
            length = np.sqrt(np.maximum(np.diag(information), 0.0))
            if length[k] > 0.0:
                each = np.where(length > 0.0, length, 1.0)
                alike = np.linalg.pinv(information / np.outer(each, each), hermitian=True)
                told[i] = length[k] ** 2 / alike[k, k]
        if not len(grid) or told.min() <= 0.0:
            return cls(np.zeros(0), told, told)
        logs = np.log(grid)
        share = (1.0 - 0.5 * np.gradient(np.log(told), logs)).clip(1e-12, 1.0 - 1e-9)
        return cls(logs, np.log(told / share**2), logs + np.log(1.0 / share - 1.0))

    def chance(self, estimate: float, log: float) -> float:
        """Return the chance of at least an estimated variance where the true one is so."""
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
        """Return the size of which at least such an estimate has a chance; see `ends`."""
        low, high = float(self.grid[0]), float(self.grid[-1])
        if tail < 0.5 and self.chance(estimate, low) > tail:
            return 0.0
        if self.chance(estimate, high) < tail:
            return np.inf if tail > 0.5 else float(np.exp(0.5 * high))
        while high - low > 0.1 * NEGLIGIBLE:
            middle = 0.5 * (low + high)
            if self.chance(estimate, middle) < tail:
                low = middle
            else:
                high = middle
        return float(np.exp(0.25 * (low + high)))


def values_of(
    fit: Fit, scale: float = 1.0, covariance: Floats | None = None
) -> dict[str, dict[str, Value]]:
    """
    Return values with 95 % intervals by effect; `scale` widens them (chi² over freedom).

    `covariance` (default: what the fit tells) is that of the freed parameters, the first ones.
    """
    quantile = QUANTILE * np.sqrt(scale)
    known = fit.interval_covariance if covariance is None else covariance
    spread = np.sqrt(np.maximum(np.diag(known), 0.0))
    values: dict[str, dict[str, Value]] = {}
    for i, free in enumerate(fit.frees):
        value, half = float(fit.values[i]), float(quantile * spread[i])
        low = float(max(value - half, free.parameter.low))
        high = float(min(value + half, free.parameter.high))
        values.setdefault(free.effect, {})[free.key] = Value(
            value, low, high, free.parameter.unit, _note(fit, i, half)
        )
    return values


def values_with_intervals(
    fitter: Fitter, fit: Fit, scale: float = 1.0
) -> dict[str, dict[str, Value]]:
    """Values of effects that are to be added: the profile decides where the curvature does not."""
    values = values_of(fit, scale)
    for free, (low, high) in intervals(fitter, fit, scale).items():
        values[free.effect][free.key] = replace(values[free.effect][free.key], low=low, high=high)
    return values


def _note(fit: Fit, i: int, half: float) -> str:
    parameter = fit.frees[i].parameter
    if not half < (parameter.high - parameter.low):
        return 'not determined by these postures'
    if fit.values[i] in (parameter.low, parameter.high):
        return 'at its bound'
    spread = np.sqrt(np.diag(fit.covariance))
    for j in range(len(fit.frees)):
        if (
            j != i
            and np.isfinite(spread[j])
            and (abs(fit.covariance[i, j]) > CORRELATED_FROM * spread[i] * spread[j] > 0.0)
        ):
            return f'correlated with {spoken(fit.frees[j].key)}'
    return ''
