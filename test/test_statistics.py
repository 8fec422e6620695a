"""Means, intervals and paired tests, against scipy."""

import numpy as np
import pytest
from scipy import stats

from tendon_robot_ros.comparison.statistics import estimate, half_width, paired_t


def test_intervals_and_tests_are_those_of_scipy():
    random = np.random.default_rng(0)
    a, b = random.normal(3.0, 1.0, 12), random.normal(2.0, 1.0, 12)
    interval = stats.ttest_1samp(a, 0.0).confidence_interval(0.95)
    made = estimate([*a, np.nan])
    assert (made.low, made.high, made.n) == pytest.approx((interval.low, interval.high, 12))
    assert half_width(a, 'sem') == pytest.approx(stats.sem(a))
    expected = stats.ttest_rel(a, b)
    test = paired_t(('a', 'b'), a, b, None)
    limits = expected.confidence_interval(0.95)
    assert (test.t, test.p, test.n) == pytest.approx((expected.statistic, expected.pvalue, 12))
    assert (test.low, test.high) == pytest.approx((limits.low, limits.high))
    assert paired_t(('a', 'b'), a[:1], b[:1], None) is None
    same = paired_t(('a', 'b'), a, a, None)
    assert (same.t, same.p) == (0.0, 1.0)
