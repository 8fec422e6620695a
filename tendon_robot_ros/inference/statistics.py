"""
Tails of distributions, the minimum of a curve, means with intervals, the paired t-test.

Intervals and tests of two models are those of Kato et al. 2015 (sections IV.C, D).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt
from scipy import special
from scipy.optimize import minimize_scalar

from ..common.arrays import Floats

SIGNIFICANCE = 0.05  # [1] 1 of 20 by chance: of 95 % intervals, and of what is named
RARE = 1e-3  # [1] 1 of 1000 by chance: of what is left out, or rejected, without being asked for
TIE_SCORE = 0.5  # [1] of deviance + 2 k: below it twins would be ordered by rounding
ERRORS = ('ci', 'sem')  # 95 % t-interval of the mean, or its standard error


class Scored(Protocol):
    """What is compared by deviance plus twice the number of parameters."""

    @property
    def score(self) -> float:
        """Smaller is better."""


def first_of_best[S: Scored](ranked: Sequence[S]) -> S:
    """Return the best by score; within a tie the first."""
    top = min(one.score for one in ranked)
    return next(one for one in ranked if one.score <= top + TIE_SCORE)


def chi2_sf(x: float, freedom: float) -> float:
    """Probability that chi² of some degrees of freedom exceeds x; 1 for zero degrees."""
    return float(special.chdtrc(freedom, x)) if x > 0.0 and freedom > 0.0 else 1.0


def chi2_isf(p: float, freedom: float) -> float:
    """Chi² that is exceeded with probability p."""
    return float(special.chdtri(freedom, p))


def chi2_noncentrality(power: float, p: float, freedom: float) -> float:
    """Noncentrality at which chi² exceeds the value of probability p with that power."""
    return float(special.chndtrinc(chi2_isf(p, freedom), freedom, 1.0 - power))


def f_sf(x: float, upper: float, lower: float) -> float:
    """Probability that F with (upper, lower) degrees of freedom exceeds x; 1 without any."""
    return float(special.fdtrc(upper, lower, x)) if x > 0.0 and min(upper, lower) > 0.0 else 1.0


def beta_cdf(x: float, a: float, b: float) -> float:
    """Probability that a variable of the beta distribution with parameters a, b is below x."""
    return float(special.betainc(a, b, x))


def misfit_p_value(chi2: float, freedom: float, noise_freedom: float) -> float:
    """Probability of a larger chi², the noise in it estimated with some degrees of freedom."""
    if not np.isfinite(noise_freedom):
        return chi2_sf(chi2, freedom)
    return f_sf(chi2 / max(freedom, 1), freedom, noise_freedom)


def f_isf(p: float, upper: float, lower: float) -> float:
    """F with (upper, lower) degrees of freedom that is exceeded with probability p."""
    return float(1.0 / special.fdtri(lower, upper, p))  # of 1 / F; 1 - p would lose digits


def t_sf(t: float, freedom: float) -> float:
    """Probability that Student's t exceeds a number."""
    return float(special.stdtr(freedom, -t))


def normal_cdf(x: Floats) -> Floats:
    """Probabilities that a standard normal deviate is below these."""
    return np.asarray(special.ndtr(x))


def normal_ppf(p: float) -> float:
    """Quantile of the normal distribution."""
    return float(special.ndtri(p))


def half_width_sd(p: float) -> float:
    """Half of an interval [1 sd] that a normal value misses with probability p."""
    return normal_ppf(1.0 - 0.5 * p)


QUANTILE = half_width_sd(SIGNIFICANCE)


def false_discovery_control(p: Floats) -> Floats:
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
    """Return the minimiser and minimum of a unimodal function between two bounds (Brent)."""
    found = minimize_scalar(
        cost, bounds=(low, high), method='bounded', options={'xatol': precision}
    )
    return float(found.x), float(found.fun)


@dataclass(frozen=True)
class Estimate:
    """A mean and its interval, in the unit of the values; NaN where it is unknown."""

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


def mean_over(values: Floats, axis: int | None) -> Floats:
    """Mean along an axis; NaN = missing, and where all is missing."""
    seen = np.isfinite(values)
    count, total = seen.sum(axis=axis), np.where(seen, values, 0.0).sum(axis=axis)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def root_mean(squares: Floats) -> float:
    """Root of the mean of squares; NaN = missing, and where all is missing."""
    return float(np.sqrt(mean_over(squares, None)))


def rms(difference: Floats) -> float:
    """Root mean square distance [m] over visible markers (..., 3); nan without any."""
    return root_mean((difference**2).sum(axis=-1))


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
    factor = special.stdtrit(enough - 1, 0.975) if error == 'ci' else 1.0
    return np.asarray(np.where(n > 1, factor * spread, np.nan))


def estimate(values: npt.ArrayLike, error: str = 'ci') -> Estimate:
    """Mean of numbers (n,) with its interval; NaN = missing."""
    known = np.asarray(values, dtype=float).ravel()
    known = known[np.isfinite(known)]
    if not len(known):
        return Estimate(np.nan, np.nan, 0)
    return Estimate(float(known.mean()), float(half_width(known, error)), len(known))


def paired_t(
    models: tuple[str, str], first: npt.ArrayLike, second: npt.ArrayLike, posture: str | None
) -> PairedT | None:
    """Compare errors (n,) [m] of two models (paired t-test); None with fewer than two pairs."""
    differences = np.asarray(first, dtype=float) - np.asarray(second, dtype=float)
    differences = differences[np.isfinite(differences)]
    if len(differences) < 2:
        return None
    mean = estimate(differences)
    error = half_width(differences, 'sem')
    t = float(mean.mean / error) if error > 0.0 else math.copysign(math.inf, mean.mean)
    t = t if mean.mean else 0.0
    p = float(2.0 * t_sf(abs(t), len(differences) - 1))
    return PairedT(models, mean.mean, mean.low, mean.high, t, p, len(differences), posture)
