"""Gaussian estimates: linear updates are least squares; a curved model is followed to its fit."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from tendon_robot_ros.common.errors import NoEquilibriumError
from tendon_robot_ros.common.estimation import gauss_newton, kalman_update
from tendon_robot_ros.model.program import bounded_least_squares


def test_updates_one_after_the_other_are_least_squares_with_the_prior():
    random = np.random.default_rng(1)
    columns, truth = random.normal(size=(6, 2, 3)), random.normal(size=(3, 2))
    noise = np.array([[0.04, 0.01], [0.01, 0.09]])
    mean, covariance, likelihood = np.zeros((3, 2)), np.eye(3), 0.0
    told, seen = np.eye(3), np.zeros((3, 2))
    for own in columns:
        measured = own @ truth + 0.1 * random.normal(size=(2, 2))
        after = kalman_update(mean, covariance, own, measured - own @ mean, noise)
        spread = own @ covariance @ own.T + noise
        off = measured - own @ mean
        chi2 = np.trace(off.T @ np.linalg.solve(spread, off))
        assert after.chi2 == pytest.approx(chi2)
        likelihood = -0.5 * (chi2 + np.linalg.slogdet(spread)[1])
        assert after.log_likelihood == pytest.approx(likelihood)
        mean, covariance = after.mean, after.covariance
        told += own.T @ np.linalg.solve(noise, own)
        seen += own.T @ np.linalg.solve(noise, measured)
    np.testing.assert_allclose(mean, np.linalg.solve(told, seen), atol=1e-12)
    np.testing.assert_allclose(covariance, np.linalg.inv(told), atol=1e-12)


def fit(start, bounds=(-np.inf, np.inf), known=np.inf):
    """Fit y = exp(x) for y = 5, of 1 sd 0.01; without a model beyond a value."""

    def left(x):
        if abs(x[0]) > known:
            raise NoEquilibriumError('a value beyond', (), np.inf)
        return 100.0 * (5.0 - np.exp(x))

    def columns(x, off):
        return 100.0 * np.exp(x)[:, None]

    return gauss_newton(np.array([start]), 1e-6 * np.eye(1), left, columns, bounds)


@pytest.mark.parametrize('start', [-1.0, 0.0, 4.0])
def test_a_curved_model_is_fitted_from_far_away_by_shorter_steps(start):
    values, off, columns = fit(start)
    assert values == pytest.approx([np.log(5.0)], abs=2e-4)
    assert off == pytest.approx(0.0, abs=0.1) and columns == pytest.approx(500.0, rel=1e-2)


def test_a_fit_stays_within_bounds_and_says_where_there_is_no_model():
    assert fit(0.0, (-1.0, 1.0))[0] == pytest.approx([1.0])
    with pytest.raises(NoEquilibriumError):
        fit(2.0, known=1.0)
    assert fit(0.5, known=1.0)[0] <= 1.0  # steps beyond are shortened


@pytest.mark.parametrize('seed', range(5))
def test_bounded_least_squares_is_that_of_scipy(seed):
    random = np.random.default_rng(seed)
    matrix, wanted = random.normal(size=(5, 3)), 2.0 * random.normal(size=5)
    low, high = -random.random(3), random.random(3)
    found = bounded_least_squares(matrix, wanted, low, high)
    np.testing.assert_allclose(found, lsq_linear(matrix, wanted, (low, high)).x, atol=1e-6)
