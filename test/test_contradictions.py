"""What the other trials of a posture contradict: as rarely by chance as is said, and found."""

from itertools import product

import numpy as np
import pytest
from marks import slow
from source_tree import ROOT

from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference.noise import input_slopes
from tendon_robot_ros.inference.outliers import contradicted, outlier_limits, trial_residuals
from tendon_robot_ros.inference.predict import Predictor
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.workspace.postures import default_postures

NOISE = 2e-4  # [m] of the tracker
TENSIONS = 0.01  # [1] of the inputs, from trial to trial
SETS = 40
POSTURES, MARKERS = 8, 10


@pytest.fixture(scope='module', params=['kato_10_1_single', 'spatial_3'])
def slopes(request):
    """Return what inputs do to the markers of a planar and of a spatial arm, (P, m, J, 3) [m]."""
    robot = load_robot(ROOT / 'config' / 'robots' / f'{request.param}.yaml')
    places = [robot.length * share for share in np.linspace(0.1, 1.0, MARKERS)]
    dataset = simulate(robot, default_postures(robot, POSTURES), trials=1, markers=places)
    return input_slopes(Predictor(dataset, robot, load_catalogue()), {})


def noise(random, slopes, trials, tensions=TENSIONS):
    """Return readings (P, Q, J, 3) [m] that differ by the tracker and by inputs only."""
    P, m, J, _ = slopes.shape
    inputs = tensions * random.normal(size=(P, trials, m))
    tracker = NOISE * random.normal(size=(P, trials, J, 3))
    return np.einsum('pqm,pmjc->pqjc', inputs, slopes) + tracker


@pytest.mark.parametrize('tensions', [0.0, TENSIONS])
@pytest.mark.parametrize('trials', [3, slow(4), slow(5), 10])
def test_noise_contradicts_itself_no_more_often_than_is_said(trials, tensions, slopes):
    """Of 40 sets, one in a thousand by readings and one by trials: two are beyond chance."""
    random = np.random.default_rng(trials)
    found = 0
    for _ in range(SETS):
        moves = noise(random, slopes, trials, tensions)
        found += any(one.any() for one in contradicted(moves, slopes))
    assert found <= 1  # two and more have a chance of 0.3 %


def misread(moves, slopes):
    moves[2, 1, 6] += np.array([10.0, 0.0, 0.0]) * NOISE
    return {(2, 1, 6)}, set()


def exchanged(moves, slopes):
    moves[4, 0, [1, 2]] = moves[4, 0, [2, 1]] + np.array([[3e-3, 0.0, 8e-3], [-3e-3, 0.0, -8e-3]])
    return {(4, 0, 1), (4, 0, 2)}, set()


def wrong_tension(moves, slopes):
    moves[3, 2] += 0.2 * slopes[3, np.argmax(np.abs(slopes[3]).max(axis=(1, 2)))]
    return set(), {(3, 2)}


def slipped(moves, slopes):
    moves[5, 0] += 3e-3 * np.arange(MARKERS)[:, None]
    return set(), {(5, 0)}


@pytest.mark.parametrize('trials', [3, 5])
@pytest.mark.parametrize('happens', [misread, exchanged, wrong_tension, slipped])
def test_what_is_wrong_in_one_trial_is_found_and_nothing_else(happens, trials, slopes):
    random = np.random.default_rng(0)
    for _ in range(5):
        moves = noise(random, slopes, trials)
        readings, runs = happens(moves, slopes)
        found, off = contradicted(moves, slopes)
        assert set(map(tuple, np.argwhere(found).tolist())) == readings
        assert set(map(tuple, np.argwhere(off).tolist())) == runs


@pytest.mark.parametrize(
    ('seed', 'trials', 'half', 'off'),
    [
        *((seed, 4, np.s_[1, :2], 0.02) for seed in range(3)),
        (5, 8, np.s_[1, ::2, 3], 40.0 * NOISE),  # of one marker
    ],
)
def test_half_of_the_readings_against_the_other_half_tell_nothing(seed, trials, half, off, slopes):
    moves = noise(np.random.default_rng(seed), slopes, trials)
    moves[half] += off
    readings, trials = contradicted(moves, slopes)
    assert not readings.any() and not trials.any()


@pytest.mark.parametrize('off', [2, 3])
def test_of_a_marker_of_which_too_few_readings_agree_all_are_left_out(off, slopes):
    random = np.random.default_rng(off)
    moves = noise(random, slopes, 4)
    moves[1, :off, 3] += 30.0 * NOISE * random.normal(size=(off, 3))
    readings, trials = contradicted(moves, slopes)
    assert set(map(tuple, np.argwhere(readings).tolist())) == {(1, q, 3) for q in range(4)}
    assert not trials.any()


def test_a_reading_that_inputs_of_its_trial_could_have_moved_is_told_from_the_others(slopes):
    """Of five markers; where another trial lost one, more could be that trial's inputs."""
    random, told = np.random.default_rng(0), []
    for p, i, j in product(range(POSTURES), range(slopes.shape[1]), (8, 9)):
        if not slopes[p, i, j].any():
            continue
        along = slopes[p, i, j] / np.linalg.norm(slopes[p, i, j])
        aside = np.cross(along, [0.0, 1.0, 0.0])
        moves = noise(random, slopes, 3)
        moves[:, :, 3:7] = moves[p, 1, 17 - j] = np.nan
        moves[p, 0, j] += (40.0 * along + 10.0 * aside) * NOISE
        readings, trials = contradicted(moves, slopes)
        told.append(readings[p, 0, j] and readings.sum() == 1 and not trials.any())
    assert np.mean(told) > {2: 0.8, 3: 0.9}[slopes.shape[1]]


def test_of_two_readings_that_contradict_each_other_none_counts(slopes):
    moves = noise(np.random.default_rng(7), slopes, 3)
    moves[2, 0, 4] = np.nan
    moves[2, 1, 4] += 20.0 * NOISE
    readings, trials = contradicted(moves, slopes)
    assert np.argwhere(readings).tolist() == [[2, 1, 4], [2, 2, 4]] and not trials.any()


def test_inputs_that_hardly_vary_explain_no_wild_reading():
    """Of three markers in a trial six inputs could explain nearly all, if they were far off."""
    random, told = np.random.default_rng(1), []
    slopes = 0.1 * random.normal(size=(POSTURES, 6, 4, 3))
    for p in range(POSTURES):
        moves = noise(random, slopes, 5, 1e-3)
        moves[p, 3, 3] = np.nan
        moves[p, 3, 2] += 20.0 * NOISE * random.choice([-1.0, 1.0], size=3)
        readings, trials = contradicted(moves, slopes)
        told.append(np.argwhere(readings).tolist() == [[p, 3, 2]] and not trials.any())
    assert all(told)


def test_a_reading_that_one_trial_lost_makes_none_of_the_others_stand_out():
    random = np.random.default_rng(3)
    arm, slope = random.normal(size=(8, 3)), random.normal(size=(1, 8, 3))
    trials = arm + np.array([0.0, -2.0, -1.0, 4.0, 6.0])[:, None, None] * slope
    trials[1, 7] = np.nan
    left = trial_residuals(trials, slope)
    assert left.sizes.max() < 1e-9  # their middles are of other trials: 0.5 and more
    assert left.freedom.tolist() == [[3] * 8, [3] * 7 + [0], *[[3] * 8] * 3]


@pytest.mark.parametrize('many', [1, 2, 12, 300])
def test_the_largest_of_few_sizes_is_beyond_its_limit_by_chance_alone(many, monkeypatch):
    """Of 5 % of all sets, where the spread is an estimate of so few sizes."""
    path = 'tendon_robot_ros.inference.outliers.RARE'
    monkeypatch.setattr(path, 0.05)
    random, freedom = np.random.default_rng(many), np.full(many, 3)
    sizes = np.linalg.norm(random.normal(size=(1000, many, 3)), axis=2)
    beyond = sum((one > outlier_limits(one, freedom)).any() for one in sizes)
    assert beyond <= 50 + 3 * 7  # three standard deviations
