"""Frames of the tracker are averaged while nothing changes, and not longer."""

from itertools import pairwise

import numpy as np
import pytest

from tendon_robot_ros.monitoring.measurement import FrameMean

NOISE, J = 2e-4, 20
SHAPE = np.random.default_rng(0).normal(0.0, 0.1, (J, 3))
TENSIONS = np.array([0.5, 0.5])
SLOPES = np.random.default_rng(1).normal(0.0, 1.0, (3 * J, 3))


def fed(made, random, count, shape=SHAPE, tensions=TENSIONS, begin=0.0, batch=6, slopes=SLOPES):
    """Take so many batches at five a second; return what each was averaged with."""
    taken = []
    for number in range(count):
        for k in range(batch):
            at = begin + 0.2 * number + 0.2 * k / batch
            made.put(at, tensions, shape + random.normal(0.0, NOISE, shape.shape))
        taken.append(made.take(slopes))
    return taken


def test_an_arm_that_stands_is_averaged_over_all_its_frames_and_seldom_begun_anew():
    random, made = np.random.default_rng(2), FrameMean(NOISE, 0.01, 1e9)
    taken = fed(made, random, 400)
    counts = [frames for _, frames in taken]
    restarts = sum(after < before for before, after in pairwise(counts))
    assert restarts <= 4, 'two tests of 0.1 % each: 0.8 are expected'
    mean, frames = taken[-1]
    off = (mean - SHAPE).ravel()
    assert np.sqrt(np.mean(off**2)) == pytest.approx(NOISE / np.sqrt(frames), rel=0.3)


def test_it_forgets_what_is_older_than_it_may_be():
    made = FrameMean(NOISE, 0.01, 1.0)
    taken = fed(made, np.random.default_rng(3), 30)
    assert max(frames for _, frames in taken) == 36
    assert taken[-1][1] == 36


def test_a_small_force_that_hides_in_the_noise_of_a_frame_is_a_change():
    """Five batches' deviations along what a force does: 0.6 of the noise of a coordinate."""
    random, made = np.random.default_rng(4), FrameMean(NOISE, 0.01, 1e9)
    fed(made, random, 5)
    along = np.linalg.qr(SLOPES)[0][:, 0].reshape(J, 3)
    pushed = SHAPE + 6.0 * NOISE / np.sqrt(6.0) * along
    assert np.abs(pushed - SHAPE).max() < 1.5 * NOISE
    ((mean, frames),) = fed(made, random, 1, pushed, begin=1.0)
    assert frames == 6
    assert abs(np.sum((mean - pushed) * along)) < 4.0 * NOISE / np.sqrt(6.0)


def test_other_tensions_and_frames_without_the_arm_begin_anew():
    random, made = np.random.default_rng(5), FrameMean(NOISE, 0.01, 1e9)
    assert fed(made, random, 3)[-1][1] == 18
    assert fed(made, random, 1, tensions=TENSIONS + 0.02, begin=1.0)[-1][1] == 6
    lost = np.full((J, 3), np.nan)
    lost[0] = SHAPE[0]
    mean, frames = fed(made, random, 1, lost, tensions=TENSIONS + 0.02, begin=2.0)[-1]
    assert frames == 12
    assert np.isfinite(mean).all(), 'what was seen before counts'
    made.put(3.0, TENSIONS, np.full((J, 3), np.nan))
    mean, _ = made.take(None)
    assert np.isnan(mean).all()
