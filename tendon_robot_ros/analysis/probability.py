"""
Tails of the chi², F, t and normal distributions, and the minimum of a curve.

scipy has all of them; importing it costs more than a fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from statistics import NormalDist

TINY = 1e-300
STEPS = 10_000  # of a series; large arguments take about the root of them


def chi2_sf(x: float, freedom: float) -> float:
    """Chance that chi² with so many degrees of freedom exceeds x."""
    if not x > 0.0 or freedom <= 0.0:
        return 1.0
    return _gamma_q(0.5 * freedom, 0.5 * x)


def chi2_isf(p: float, freedom: float) -> float:
    """Chi² that is exceeded with probability p (between 1e-290 and 1)."""
    high = max(freedom, 1.0)
    while chi2_sf(high, freedom) > p:
        high *= 2.0
    low = 0.0
    for _ in range(200):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        low, high = (middle, high) if chi2_sf(middle, freedom) > p else (low, middle)
    return 0.5 * (low + high)


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
    """Quantile of Student's t."""
    low, high = -1.0, 1.0
    while t_sf(high, freedom) > 1.0 - p:
        high *= 2.0
    while t_sf(low, freedom) < 1.0 - p:
        low *= 2.0
    for _ in range(200):
        middle = 0.5 * (low + high)
        if middle in (low, high):
            break
        low, high = (middle, high) if t_sf(middle, freedom) > 1.0 - p else (low, middle)
    return 0.5 * (low + high)


def normal_ppf(p: float) -> float:
    """Quantile of the normal distribution."""
    return NormalDist().inv_cdf(p)


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
        for n in range(1, STEPS):
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
    value = c = first or TINY
    d = 0.0
    for n in range(1, STEPS):
        numerator, denominator = step(n)
        d = 1.0 / ((denominator + numerator * d) or TINY)
        c = (denominator + numerator / c) or TINY
        value *= c * d
        if abs(c * d - 1.0) < 1e-15:
            break
    return value
