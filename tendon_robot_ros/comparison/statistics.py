"""
Tails of distributions, the minimum of a curve, means with intervals, the paired t-test.

scipy has the distributions; importing it costs more than a fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

FRACTION_FLOOR = 1e-300
SERIES_TERMS_MAX = 10_000  # of a series; large arguments take about the root of them


def chi2_sf(x: float, freedom: float) -> float:
    """Chance that chi² with so many degrees of freedom exceeds x."""
    if not x > 0.0 or freedom <= 0.0:
        return 1.0
    return _gamma_q(0.5 * freedom, 0.5 * x)


@cache
def chi2_isf(p: float, freedom: float) -> float:
    """Chi² that is exceeded with probability p (between 1e-290 and 1)."""
    return _exceeded(partial(chi2_sf, freedom=freedom), p)


@cache
def f_isf(p: float, upper: float, lower: float) -> float:
    """F with (upper, lower) degrees of freedom that is exceeded with probability p."""
    return _exceeded(partial(f_sf, upper=upper, lower=lower), p)


def _exceeded(tail: Callable[[float], float], p: float) -> float:
    """Return the positive number that is exceeded with probability p, by halving."""
    low, high = 0.0, 1.0
    while tail(high) > p:
        low, high = high, 2.0 * high
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if tail(middle) > p else (low, middle)
    return middle


def f_sf(x: float, upper: float, lower: float) -> float:
    """Chance that F with (upper, lower) degrees of freedom exceeds x."""
    if not x > 0.0 or min(upper, lower) <= 0.0:
        return 1.0
    return _beta_i(0.5 * lower, 0.5 * upper, lower / (lower + upper * x))


def t_sf(t: float, freedom: float) -> float:
    """Chance that Student's t exceeds a number."""
    half = 0.5 * _beta_i(0.5 * freedom, 0.5, freedom / (freedom + t * t))
    return half if t >= 0.0 else 1.0 - half


def t_ppf(p: float, freedom: float) -> float:
    """
    Quantile of Student's t.

    The tail is convex, and that of the normal distribution below it: Newton's method starts there
    and never passes by.
    """
    if p < 0.5:
        return -t_ppf(1.0 - p, freedom)
    log = math.lgamma(0.5 * freedom + 0.5) - math.lgamma(0.5 * freedom)
    log -= 0.5 * math.log(freedom * math.pi)
    t = normal_ppf(p)
    for _ in range(200):
        density = math.exp(log - (0.5 * freedom + 0.5) * math.log1p(t * t / freedom))
        step = (t_sf(t, freedom) - (1.0 - p)) / density
        t += step
        if step <= 1e-14 * t:
            break
    return t


def normal_ppf(p: float) -> float:
    """Quantile of the normal distribution."""
    return NormalDist().inv_cdf(p)


def false_discovery_control(p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """
    Adjust p-values (n,) so that those below q have a false discovery rate of at most q.

    Benjamini and Hochberg 1995, for independent or positively dependent tests.
    """
    order = np.argsort(p)
    steps = p[order] * len(p) / np.arange(1, len(p) + 1)
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(np.minimum.accumulate(steps[::-1])[::-1], 1.0)
    return adjusted


def minimum(
    cost: Callable[[float], float], low: float, high: float, precision: float
) -> tuple[float, float]:
    """Return where a curve with one valley is lowest between two ends, and how low (golden)."""
    golden = 0.5 * (math.sqrt(5.0) - 1.0)
    left, right = high - golden * (high - low), low + golden * (high - low)
    at_left, at_right = cost(left), cost(right)
    while high - low > precision:
        if at_left <= at_right:
            high, right, at_right = right, left, at_left
            left = high - golden * (high - low)
            at_left = cost(left)
        else:
            low, left, at_left = left, right, at_right
            right = low + golden * (high - low)
            at_right = cost(right)
    return (left, at_left) if at_left <= at_right else (right, at_right)


def _gamma_q(a: float, x: float) -> float:
    """Regularised upper incomplete gamma function (series, or Lentz's continued fraction)."""
    front = math.exp(max(a * math.log(x) - x - math.lgamma(a), -745.0))
    if x < a + 1.0:
        term = total = 1.0 / a
        for n in range(1, SERIES_TERMS_MAX):
            term *= x / (a + n)
            total += term
            if term < total * 1e-16:
                break
        return max(1.0 - front * total, 0.0)

    def step(n: int) -> tuple[float, float]:
        return (-n * (n - a), x + 2.0 * n + 1.0 - a)

    return front / _fraction(x + 1.0 - a, step)


def _beta_i(a: float, b: float, x: float) -> float:
    """Regularised incomplete beta function."""
    if x <= 0.0 or x >= 1.0:
        return float(x >= 1.0)
    if x > (a + 1.0) / (a + b + 2.0):
        return 1.0 - _beta_i(b, a, 1.0 - x)
    log = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)
    log += a * math.log(x) + b * math.log1p(-x)

    def step(n: int) -> tuple[float, float]:
        m = n // 2
        if n % 2:
            return (-(a + m) * (a + b + m) * x / ((a + n - 1) * (a + n)), 1.0)
        return (m * (b - m) * x / ((a + n - 1) * (a + n)), 1.0)

    return math.exp(max(log, -745.0)) / (a * _fraction(1.0, step))


def _fraction(first: float, step: Callable[[int], tuple[float, float]]) -> float:
    """Continued fraction first + n1 / (d1 + n2 / (d2 + ...)) by Lentz's method."""
    value = c = first or FRACTION_FLOOR
    d = 0.0
    for n in range(1, SERIES_TERMS_MAX):
        numerator, denominator = step(n)
        d = 1.0 / ((denominator + numerator * d) or FRACTION_FLOOR)
        c = (denominator + numerator / c) or FRACTION_FLOOR
        value *= c * d
        if abs(c * d - 1.0) < 1e-15:
            break
    return value


# -----------------------------------------------------------------------------
# Means with intervals, and the paired t-test, as Kato et al. 2015 use them (sections IV.C, D).

Floats = npt.NDArray[np.float64]
ERRORS = ('ci', 'sem')  # 95 % t-interval of the mean, or its standard error


@dataclass(frozen=True)
class Estimate:
    """A mean and how well it is known, in the unit of the values; NaN where nothing tells."""

    mean: float
    half: float  # half the width of the 95 % t-interval, or the standard error
    n: int

    @property
    def low(self) -> float:
        """Lower end."""
        return self.mean - self.half

    @property
    def high(self) -> float:
        """Upper end."""
        return self.mean + self.half


@dataclass(frozen=True)
class PairedT:
    """Paired t-test of two models' tip errors; `difference` is the first minus the second [m]."""

    models: tuple[str, str]
    difference: float
    low: float  # 95 %
    high: float
    t: float
    p: float  # two-sided
    n: int  # pairs
    posture: str | None  # the pairs are the trials of this posture; None: the postures


def half_width(values: Floats, error: str = 'ci') -> Floats:
    """
    Half the width of the interval of a mean.

    Parameters
    ----------
    values : (q, ...)
        Trials along the first axis, NaN = missing.
    error : str
        'ci' for the 95 % t-interval, 'sem' for the standard error.

    Returns
    -------
    (...)
        NaN where there are fewer than two values.

    """
    n = np.isfinite(values).sum(axis=0)
    enough = np.maximum(n, 2)
    mean = np.nansum(values, axis=0) / np.maximum(n, 1)
    spread = np.sqrt(np.nansum((values - mean) ** 2, axis=0) / (enough - 1) / enough)
    factor = quantiles(enough - 1) if error == 'ci' else 1.0
    return np.asarray(np.where(n > 1, factor * spread, np.nan))


def quantiles(freedom: npt.NDArray[np.int64]) -> Floats:
    """Return what a standard error is multiplied by to make half of a 95 % interval."""
    known, where = np.unique(freedom, return_inverse=True)
    return np.array([_quantile(int(one)) for one in known])[where].reshape(np.shape(freedom))


@cache
def _quantile(freedom: int) -> float:
    return t_ppf(0.975, freedom)


def estimate(values: npt.ArrayLike, error: str = 'ci') -> Estimate:
    """Mean of numbers (n,) with its interval; NaN = missing."""
    seen = np.asarray(values, dtype=float).ravel()
    seen = seen[np.isfinite(seen)]
    if not len(seen):
        return Estimate(np.nan, np.nan, 0)
    return Estimate(float(seen.mean()), float(half_width(seen, error)), len(seen))


def paired_t(
    models: tuple[str, str], first: npt.ArrayLike, second: npt.ArrayLike, posture: str | None
) -> PairedT | None:
    """Test whether two models err alike (n,) [m]; None with fewer than two pairs."""
    differences = np.asarray(first, dtype=float) - np.asarray(second, dtype=float)
    differences = differences[np.isfinite(differences)]
    if len(differences) < 2:
        return None
    mean = estimate(differences)
    error = half_width(differences, 'sem')
    t = 0.0 if mean.mean == 0.0 else float(np.divide(mean.mean, error)) if error > 0.0 else np.inf
    p = float(2.0 * t_sf(abs(t), len(differences) - 1))
    return PairedT(models, mean.mean, mean.low, mean.high, t, p, len(differences), posture)
