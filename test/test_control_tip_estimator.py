"""What is estimated of the tip's bias, and of how tensions change it."""

from dataclasses import replace

import numpy as np
import pytest

from tendon_robot_ros.control.tip_estimator import TipEstimate

LIMITS, SLOPE_SD = np.array([[0.1, 5.0]] * 3), np.full(3, 0.05)
HERE, SHARE = np.full(3, 1.0), 1.0 - np.exp(-0.1)  # [N]; [1] of a gain of 5 /s at 50 Hz


def begin():
    return TipEstimate.begin(HERE, LIMITS, SLOPE_SD)


def test_bias_and_slopes_of_a_linear_error_are_estimated():
    random = np.random.default_rng(3)
    bias, slopes = np.array([0.02, 0.0, -0.01]), 0.03 * random.normal(size=(3, 3))
    known = begin()
    for _ in range(1000):
        tensions = 1.0 + 0.8 * random.random(3)
        residual = bias + slopes @ ((tensions - 1.0) / 4.9)
        known = known.about(tensions).updated(residual, SHARE, SLOPE_SD)
    assert known.about(HERE).bias == pytest.approx(bias, abs=1e-3)
    assert known.bias_at(HERE) == pytest.approx(known.about(HERE).bias)
    assert known.slopes == pytest.approx(slopes, abs=3e-3)
    assert np.all(np.linalg.eigvalsh(known.covariance) > 0.0)


def test_of_a_standing_arm_a_share_of_a_new_bias_is_taken_over_and_no_slope():
    known = begin()
    for _ in range(500):
        known = known.updated(np.zeros(3), SHARE, SLOPE_SD)
    after = known.updated(np.array([1e-3, 0.0, 0.0]), SHARE, SLOPE_SD)
    assert after.bias[0] == pytest.approx(1e-3 * SHARE, rel=0.02)
    assert np.abs(after.slopes).max() < 1e-9


def test_the_noise_of_the_tracker_is_told_and_a_jump_is_none():
    random, noise, known = np.random.default_rng(5), 2e-4, begin()
    for step in range(300):
        jump = (step > 200) * np.array([5e-3, 0.0, 0.0])
        known = known.updated(noise * random.normal(size=3) + jump, SHARE, SLOPE_SD)
        if step in (200, 205):
            assert known.noise == pytest.approx(np.sqrt(3.0) * noise, rel=0.25)
    away = known.bias - [5e-3, 0.0, 0.0]
    assert np.linalg.norm(away) < 2.0 * known.rest < 4e-4


def test_slopes_are_forgotten_along_the_path_of_the_tip():
    slopes = np.array([[0.05, 0.0, 0.0], [0.0, 0.05, 0.0], [0.0, 0.0, 0.0]])
    known = replace(begin().about(HERE + 0.5), slopes=slopes)
    for _ in range(20):
        known = known.updated(known.bias, SHARE, SLOPE_SD)
    stood = known
    for _ in range(500):
        stood = stood.updated(stood.bias, SHARE, SLOPE_SD, 0.0, 0.2)
    assert stood.slopes == pytest.approx(slopes)
    assert np.all(np.diag(stood.covariance)[1:] <= np.diag(known.covariance)[1:] + 1e-9)
    went = known.updated(known.bias, SHARE, SLOPE_SD, 0.1, 0.2)
    assert np.linalg.norm(went.slopes) < 0.05 * np.linalg.norm(slopes)
    first = np.diag(begin().covariance)[1:]
    assert np.diag(went.covariance)[1:] == pytest.approx(first, rel=1e-2)


def test_a_slope_along_one_direction_is_known_from_motion_along_it_and_others_are_not():
    direction, known = np.array([1.0, 1.0, 0.0]), begin()
    for step in range(50):
        tensions = HERE + 0.01 * step * direction * 4.9
        known = known.about(tensions).updated(0.01 * step * np.full(3, 0.08), SHARE, SLOPE_SD)
    assert known.slopes @ direction == pytest.approx(np.full(3, 0.08), rel=0.02)
    doubts = [known.slope_sd(one) for one in (direction, np.array([1.0, -1.0, 0.0]))]
    assert doubts[0] < 0.2 * doubts[1]


def test_slopes_are_believed_to_no_more_than_half_of_the_models():
    model = 0.1 * np.eye(3)
    large, small = (replace(begin(), slopes=share * model) for share in (2.0, 0.3))
    assert large.within(model).slopes == pytest.approx(0.5 * model)
    assert small.within(model).slopes == pytest.approx(0.3 * model)
