"""Means with intervals, and the paired t-test, as Kato et al. 2015 use them (sections IV.C, D)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from .probability import t_ppf, t_sf

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
