"""Means, intervals, paired tests, tails and quantiles, against scipy."""

import math

import numpy as np
import pytest
import scipy  # which imports its parts when they are asked for

from tendon_robot_ros.inference import statistics as probability
from tendon_robot_ros.inference.statistics import estimate, half_width, paired_t

RANDOM = np.random.default_rng(0)
CASES = np.exp(RANDOM.uniform(0.0, 8.0, (60, 2)))
AT = np.exp(RANDOM.normal(0.0, 0.7, 60))


def test_intervals_and_tests_are_those_of_scipy():
    random = np.random.default_rng(0)
    a, b = random.normal(3.0, 1.0, 12), random.normal(2.0, 1.0, 12)
    interval = scipy.stats.ttest_1samp(a, 0.0).confidence_interval(0.95)
    made = estimate([*a, np.nan])
    assert (made.low, made.high, made.n) == pytest.approx((interval.low, interval.high, 12))
    assert half_width(a, 'sem') == pytest.approx(scipy.stats.sem(a))
    expected = scipy.stats.ttest_rel(a, b)
    test = paired_t(('a', 'b'), a, b, None)
    limits = expected.confidence_interval(0.95)
    assert (test.t, test.p, test.n) == pytest.approx((expected.statistic, expected.pvalue, 12))
    assert (test.low, test.high) == pytest.approx((limits.low, limits.high))
    assert paired_t(('a', 'b'), a[:1], b[:1], None) is None
    assert paired_t(('a', 'b'), [1.0, 1.0], [2.0, 2.0], None).t == -np.inf
    same = paired_t(('a', 'b'), a, a, None)
    assert (same.t, same.p) == (0.0, 1.0)


@pytest.mark.parametrize(('freedoms', 'x'), list(zip(CASES.tolist(), AT.tolist(), strict=True)))
def test_tails_agree_with_scipy(freedoms, x):
    k, d = freedoms
    close = {'rel': 1e-9, 'abs': 1e-290}
    assert probability.chi2_sf(k * x, k) == pytest.approx(scipy.stats.chi2.sf(k * x, k), **close)
    assert probability.f_sf(x, k, d) == pytest.approx(scipy.stats.f.sf(x, k, d), **close)
    t = math.log(x) * 4.0
    assert probability.t_sf(t, k) == pytest.approx(scipy.stats.t.sf(t, k), **close)


@pytest.mark.parametrize('freedom', [1.0, 2.5, 30.0, 900.0])
@pytest.mark.parametrize('p', [1e-12, 1e-4, 0.05, 0.7])
def test_quantiles_agree_with_scipy(freedom, p):
    expected = scipy.stats.chi2.isf(p, freedom)
    assert probability.chi2_isf(p, freedom) == pytest.approx(expected, rel=1e-9)
    quantile = scipy.stats.norm.ppf(p)
    assert probability.normal_ppf(p) == pytest.approx(quantile, rel=1e-9)
    assert probability.normal_cdf(quantile) == pytest.approx(p, rel=1e-9)


def test_nothing_to_judge_by_is_no_alarm():
    assert probability.chi2_sf(5.0, 0.0) == 1.0
    assert probability.chi2_sf(-1.0, 3.0) == 1.0
    assert probability.f_sf(0.0, 3.0, 5.0) == 1.0


def test_a_minimum_is_found_to_the_precision():
    where, low = probability.minimum(lambda x: (x - 0.3) ** 2 + 2.0, -1.0, 4.0, 1e-4)
    assert where == pytest.approx(0.3, abs=1e-4)
    assert low == pytest.approx(2.0, abs=1e-7)
    assert probability.minimum(lambda x: x, 0.0, 1.0, 1e-3)[0] < 1e-3
