"""The noise comes from the trials, whatever the model; weights make residuals white."""

from dataclasses import replace

import numpy as np
import pytest
import simulated
from arms import planar
from simulated import CATALOGUE, NOISE, measured

from tendon_robot_ros.inference.noise import Noise, Whitener, estimate_noise, input_slopes
from tendon_robot_ros.inference.outliers import find_outliers
from tendon_robot_ros.inference.predict import Predictor
from tendon_robot_ros.inference.repeats import repeats
from tendon_robot_ros.inference.statistics import rms

HIDDEN = {'hinge_friction': {'lever': 4e-4}}
ROBOT = simulated.robot()


def slopes_of(dataset):
    return input_slopes(Predictor(dataset, dataset.robot, CATALOGUE), {})


def estimates(noise, hidden=None, runs=12):
    """Return the estimated noise of several simulated data sets (runs, 2)."""
    found = []
    for seed in range(runs):
        dataset = measured(ROBOT, hidden, seed=seed, noise=noise)
        one = estimate_noise(dataset, slopes_of(dataset))
        found.append((one.position, one.trial))
    return np.array(found)


@pytest.mark.parametrize('trial', [0.001, 0.004, 0.02])
def test_the_trials_tell_position_and_trial_noise(trial):
    position, spread = estimates(replace(NOISE, trial=trial)).mean(axis=0)
    assert position == pytest.approx(NOISE.position, rel=0.02)
    assert spread == pytest.approx(trial, rel=0.15)


def test_without_trial_noise_none_is_found():
    assert estimates(replace(NOISE, trial=0.0))[:, 1].mean() < 5e-4


def test_model_error_does_not_leak_into_the_noise():
    clean, off = estimates(NOISE), estimates(NOISE, HIDDEN)
    dataset = measured(ROBOT, HIDDEN)
    error = rms(dataset.mean - Predictor(dataset, ROBOT, CATALOGUE).markers({}))
    assert error > 2e-3, 'the hidden effect is meant to be large'
    np.testing.assert_allclose(off.mean(axis=0)[0], clean.mean(axis=0)[0], rtol=0.03)
    np.testing.assert_allclose(off.mean(axis=0)[1], clean.mean(axis=0)[1], rtol=0.3)


def test_one_trial_is_judged_by_what_was_declared():
    dataset = measured(ROBOT, trials=1)
    slopes = slopes_of(dataset)
    found = estimate_noise(dataset, slopes)
    assert (found.source, found.position, found.trial) == ('declared', 2e-4, 0.004)
    assert np.isinf(found.freedom)
    assert estimate_noise(replace(dataset, position_noise=None), slopes) is None


def test_measurements_without_any_noise_are_as_good_as_they_are_rounded():
    dataset = measured(ROBOT, trials=1)
    again = np.repeat(dataset.positions, 9, axis=1)
    alike = replace(dataset, positions=again, trial_names=(), position_noise=None)
    for perfect in (replace(dataset, position_noise=0.0), alike):
        slopes = slopes_of(perfect)
        noise = estimate_noise(perfect, slopes)
        assert noise.position == pytest.approx(1e-9)
        assert np.isfinite(Whitener(perfect, noise, slopes).white(dataset.mean)).all()


def test_measured_differences_between_trials_are_no_noise():
    dataset = measured(ROBOT, noise=replace(NOISE, trial=0.02), seed=3)
    quiet = replace(NOISE, trial=0.0, setting=0.0)
    factors = 1.0 + 0.02 * np.random.default_rng(1).normal(size=(8, 5, 2))
    known = replace(dataset, trial_inputs=dataset.inputs[:, None] * factors)
    known = simulated.measure(known, noise=quiet)
    found = estimate_noise(known, slopes_of(known))
    assert found.trial < 0.002
    blind = replace(known, trial_inputs=None)
    assert estimate_noise(blind, slopes_of(blind)).trial == pytest.approx(0.02, rel=0.3)


def test_wires_that_are_let_out_more_in_a_trial_are_no_noise():
    robot = planar(effects={'wire_spring': {'compliance': 1e-3}, 'pull_zero': {'offset': 2e-3}})
    pulls = [[pull, -share * pull] for pull in (1e-3, 2e-3, 3e-3, 4e-3) for share in (0.9, 1.0)]
    blank = simulated.postures(robot, pulls, input='displacement')
    factors = 1.0 + 0.02 * np.random.default_rng(1).normal(size=(8, 5, 2))
    known = replace(blank, trial_inputs=blank.inputs[:, None] * factors)
    known = simulated.measure(known, noise=replace(NOISE, trial=0.0, setting=0.0))
    slopes = input_slopes(Predictor(known, robot, CATALOGUE), {})
    assert estimate_noise(known, slopes).trial < 0.002


def test_wires_have_as_much_play_where_they_are_not_pulled():
    robot = planar(effects={'wire_spring': {'compliance': 1e-3}, 'pull_zero': {'offset': 2e-3}})
    pulls = [[0.0, 0.0], *([pull, -pull] for pull in (-4e-3, -2e-3, 2e-3, 4e-3))]
    blank = simulated.postures(robot, pulls, trials=12, input='displacement')
    found, spreads = [], []
    for seed in range(8):
        dataset = simulated.measure(blank, noise=replace(NOISE, trial=0.02), seed=seed)
        predictor = Predictor(dataset, robot, CATALOGUE)
        found.append(estimate_noise(dataset, input_slopes(predictor, {})).trial)
        spreads.append(dataset.positions[:, :, -1, 0].std(axis=1, ddof=1))
        assert not find_outliers(predictor, {}).any
    assert np.mean(found) == pytest.approx(0.02, rel=0.1)
    at_rest, *bent = np.sqrt(np.square(spreads).mean(axis=0))
    assert at_rest == pytest.approx(np.mean(bent), rel=0.25)


def whitened(runs=40, **changes):
    """Whitened residuals (runs, N) of perfect data, and the floor and rms of each."""
    rows, floors, errors = [], [], []
    noise = replace(NOISE, **changes)
    for seed in range(runs):
        dataset = measured(ROBOT, seed=seed, noise=noise)
        predictor = Predictor(dataset, ROBOT, CATALOGUE)
        whitener = Whitener(dataset, noise, input_slopes(predictor, {}))
        difference = dataset.mean - predictor.markers({})
        rows.append(whitener.white(difference))
        floors.append(whitener.floor())
        errors.append(rms(difference))
    return np.array(rows), np.array(floors), np.array(errors)


@pytest.mark.parametrize('setting', [0.0, 0.002, 0.01])
def test_perfect_data_is_white_and_the_floor_is_its_rms(setting):
    rows, floors, errors = whitened(setting=setting)
    assert (rows**2).mean() == pytest.approx(1.0, abs=0.04)
    assert abs(rows.mean()) < 0.05
    assert np.sqrt((errors**2).mean()) == pytest.approx(floors.mean(), rel=0.08)


def test_without_the_setting_noise_perfect_data_looks_wrong():
    dataset = measured(ROBOT, noise=replace(NOISE, setting=0.01))
    slopes = slopes_of(dataset)
    left = dataset.mean - Predictor(dataset, ROBOT, CATALOGUE).markers({})
    ignorant = Whitener(dataset, replace(NOISE, setting=0.0), slopes).white(left)
    assert (ignorant**2).mean() > 1.5


def test_a_missing_marker_leaves_the_rest_in_place():
    dataset = measured(ROBOT)
    positions = dataset.positions.copy()
    positions[2, :, 4] = np.nan
    positions[3, 1:, 7] = np.nan
    partial = replace(dataset, positions=positions)
    noise = Noise(1e-4, 0.0, 0.0, np.inf, 'declared')
    slopes = slopes_of(dataset)
    whitener = Whitener(partial, noise, slopes)
    assert whitener.size == dataset.mean.size - 3
    white = whitener.white(partial.mean)
    assert np.isfinite(white).all()
    assert (whitener.owners == 2).sum() == dataset.mean[2].size - 3
    per_coordinate = Whitener(dataset, noise, slopes).floor() / np.sqrt(3.0)
    assert per_coordinate == pytest.approx(1e-4 / np.sqrt(5.0))
    assert whitener.floor() > Whitener(dataset, noise, slopes).floor()


def root_of(whitener, dataset, p):
    """Return W (n, n) of a posture, of which all markers were seen, by whitening unit vectors."""
    units = np.zeros((3 * len(dataset.markers), *dataset.mean.shape))
    units[:, p] = np.eye(len(units)).reshape(len(units), -1, 3)
    return whitener.white(units)[:, whitener.owners == p].T


@pytest.mark.parametrize(
    'noise',
    [
        Noise(2e-4, 0.02, 0.005, np.inf, 'declared'),
        Noise(2e-4, 0.0, 0.0, np.inf, 'declared', shift=3e-4),
    ],
    ids=['inputs', 'shift'],
)
def test_the_mean_of_a_marker_that_a_trial_lost_has_what_the_others_share(noise):
    dataset, random = measured(ROBOT), np.random.default_rng(2)
    positions, slopes = dataset.positions.copy(), slopes_of(dataset)
    positions[random.random(positions.shape[:3]) < 0.1] = np.nan
    if noise.trial:
        positions[4, 3] = np.nan
    dataset = replace(dataset, positions=positions)
    whitener = Whitener(dataset, noise, slopes)
    for p in range(len(positions)):
        moved = [noise.setting * one for one in slopes[p]]
        of_a_trial = [*(noise.trial * slopes[p]), *(noise.shift * np.eye(3))]
        for trial in range(positions.shape[1]):  # what it does to the means, trial by trial
            for one in of_a_trial:
                there = positions.copy()
                there[p, trial] += one
                moved.append((replace(dataset, positions=there).mean - dataset.mean)[p])
        g = np.array(moved).reshape(len(moved), -1)
        own = noise.position**2 / np.repeat(dataset.counts[p], 3)
        root = root_of(whitener, dataset, p)
        white = root @ (np.diag(own) + g.T @ g) @ root.T
        np.testing.assert_allclose(white, np.eye(len(white)), atol=1e-8)


def test_a_noisy_marker_counts_though_a_trial_of_every_posture_lost_it():
    quiet = replace(NOISE, trial=0.0, setting=0.0)
    dataset, random = measured(ROBOT, trials=20, noise=quiet), np.random.default_rng(5)
    markers, positions = dataset.markers[4::5], dataset.positions[:, :, 4::5].copy()
    positions[:, :, -1] += random.normal(0.0, 1e-3, positions[:, :, -1].shape)
    positions[np.arange(8), random.integers(0, 20, 8), -1] = np.nan
    lossy = replace(dataset, markers=markers, positions=positions)
    estimate = estimate_noise(lossy, np.zeros_like(slopes_of(lossy)))  # inputs are exact
    truth = np.sqrt(NOISE.position**2 + 1e-3**2 / len(markers))
    assert np.hypot(estimate.position, estimate.shift) == pytest.approx(truth, rel=0.05)


def shifted(dataset, size, seed=0):
    """Return the data set with all markers of a trial moved alike, 1 sd per coordinate [m]."""
    P, Q = dataset.positions.shape[:2]
    moves = np.random.default_rng(seed).normal(0.0, size, (P, Q, 1, 3))
    return replace(dataset, positions=dataset.positions + moves)


@pytest.mark.parametrize('trial', [0.0, 0.004])
def test_a_shift_of_all_markers_of_a_trial_is_told_apart(trial):
    found = []
    for seed in range(12):
        steady = measured(ROBOT, seed=seed, noise=replace(NOISE, trial=trial))
        dataset = shifted(steady, 3e-4, seed)
        found.append(estimate_noise(dataset, slopes_of(dataset)))
    assert np.mean([one.shift for one in found]) == pytest.approx(3e-4, rel=0.05)
    assert np.mean([one.position for one in found]) == pytest.approx(NOISE.position, rel=0.02)
    assert np.mean([one.trial for one in found]) == pytest.approx(trial, rel=0.2, abs=1e-3)


def test_where_nothing_shifts_no_shift_is_believed():
    for seed in range(12):
        dataset = measured(ROBOT, seed=seed)
        assert estimate_noise(dataset, slopes_of(dataset)).shift == 0.0


def test_what_shifts_with_the_trials_is_white_and_no_error_of_the_model():
    rows, ignorant = [], []
    for seed in range(20):
        steady = measured(ROBOT, seed=seed, noise=replace(NOISE, setting=0.0))
        dataset = shifted(steady, 3e-4, seed)
        predictor = Predictor(dataset, ROBOT, CATALOGUE)
        slopes, left = input_slopes(predictor, {}), dataset.mean - predictor.markers({})
        noise = estimate_noise(dataset, slopes)
        rows.append(Whitener(dataset, noise, slopes).white(left))
        ignorant.append(Whitener(dataset, replace(noise, shift=0.0), slopes).white(left))
    assert (np.array(rows) ** 2).mean() == pytest.approx(1.0, abs=0.06)
    assert (np.array(ignorant) ** 2).mean() > 1.5


def test_of_what_nobody_saw_there_is_no_error_and_no_warning():
    difference = np.full((2, 3, 3), np.nan)
    assert np.isnan(rms(difference))
    difference[1, 2] = 3.0, 0.0, 4.0
    assert rms(difference) == 5.0


@pytest.mark.parametrize('sigma', [1e-4, 1e-3])
@pytest.mark.parametrize('apart', [0.0, 3e-3])
def test_what_no_function_of_inputs_explains_is_told_from_noise_and_a_wrong_model(apart, sigma):
    """Errors: a smooth function, a part that depends on the input before, and noise."""
    random = np.random.default_rng(4)
    inputs = random.uniform(0.0, 1.0, (600, len(ROBOT.inputs)))
    dataset = simulated.postures(ROBOT, inputs, trials=1, path='sequence')
    smooth = 0.02 * np.sin(inputs.sum(axis=1)) + 0.01 * inputs[:, 0] ** 2
    side = np.sign(np.diff(inputs[:, 0], prepend=0.0))
    errors = np.zeros((len(inputs), len(dataset.markers), 3))
    errors += random.normal(0.0, sigma / np.sqrt(3.0), errors.shape)
    errors[..., 0] += (smooth + apart * side)[:, None]
    found = repeats(dataset, errors, np.full(len(inputs), sigma**2), 100)
    assert found.is_told(0.005) == (apart > 0.0)
    if apart:  # the chance of a side is the input, so that 4 u (1 - u) is its variance
        assert found.apart == pytest.approx(np.sqrt(2.0 / 3.0) * apart, rel=0.2)


def test_nothing_is_told_of_repeats_where_no_posture_was_reached_in_different_ways():
    dataset = simulated.postures(ROBOT, np.ones((600, len(ROBOT.inputs))), trials=1)
    errors = np.zeros((600, len(dataset.markers), 3))
    assert repeats(dataset, errors, np.zeros(600), 100) is None


def test_a_slack_wire_is_not_one_that_is_held_at_zero():
    """Errors of a model that differ because wires are let go are no memory."""
    random = np.random.default_rng(5)
    inputs = random.uniform(0.0, 0.01, (600, len(ROBOT.inputs)))
    inputs[:, 0] = np.where(random.random(600) < 0.5, np.nan, 0.0)
    dataset = simulated.postures(ROBOT, inputs, trials=1, path='sequence', input='displacement')
    errors = random.normal(0.0, 1e-4, (600, len(dataset.markers), 3))
    errors[..., 0] += np.where(np.isnan(inputs[:, 0]), 3e-3, 0.0)[:, None]
    assert not repeats(dataset, errors, np.full(600, 3e-8), 100).is_told(0.005)
