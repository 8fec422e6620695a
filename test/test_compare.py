"""Comparing models with measurements: errors, angles, noise floor, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
import scipy  # which imports its parts when they are asked for
from measurements import blind
from source_tree import ROOT

from tendon_robot_ros.common.errors import InputError, NoEquilibriumError, TendonRobotError
from tendon_robot_ros.comparison.compare import bending_axes, cell_rotations, compare
from tendon_robot_ros.data import Marker, load_dataset
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.report.comparison import where_worst
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.simulation.hidden import Damage
from tendon_robot_ros.simulation.measurements import SimulatedNoise, simulate
from tendon_robot_ros.simulation.plant import Plant
from tendon_robot_ros.workspace.postures import default_postures

KATO = ROOT / 'config' / 'robots' / 'kato_10_1.yaml'
SPATIAL = ROOT / 'config' / 'robots' / 'spatial_3.yaml'
QUIET = SimulatedNoise(0.0, 0.0, 0.0)


def twin(robot):
    """Return a plant that is its owner's model to the last digit."""
    return Plant(robot, Model(robot), 1, Damage(robot, 0))


def perfect(robot, postures=6, seed=0, **options):
    """Measure a robot that does just what its description says."""
    return simulate(twin(robot), default_postures(robot, postures), seed=seed, **options)


@pytest.fixture(scope='module')
def kato():
    return load_robot(KATO)


@pytest.fixture(scope='module')
def hinges():
    return load_dataset(blind('b') / 'fit')


def test_every_error_is_the_distance_from_the_trial_mean(hinges):
    model = compare(hinges).models[0]
    own = Model(hinges.robot).shapes(hinges.inputs).markers(hinges.arc_lengths, hinges.offsets)
    distance = np.linalg.norm(own - hinges.positions.mean(axis=1), axis=2)
    np.testing.assert_allclose(model.distance, distance, atol=1e-12)
    assert model.rms == pytest.approx(np.sqrt((distance**2).mean()))
    assert model.per_marker_rms[-1] == pytest.approx(np.sqrt((distance[:, -1] ** 2).mean()))
    assert model.tip_error().mean == pytest.approx(model.tip_errors.mean())
    assert model.max == pytest.approx(distance.max())
    np.testing.assert_allclose(model.per_marker_rms, np.sqrt((distance**2).mean(axis=0)))
    tips = np.linalg.norm(own[:, None, -1] - hinges.positions[:, :, -1], axis=2)
    np.testing.assert_allclose(model.tip_errors, tips, atol=1e-12)


def test_missing_markers_and_trials_do_not_count(kato):
    data = perfect(kato, noise=QUIET, trials=3)
    positions = np.array(data.positions)
    positions[:, 2, -1] = np.nan  # no tip in the third trials
    positions[1, :, 4] = np.nan
    noise = np.random.default_rng(0).normal(0.0, 1e-4, positions.shape)
    found = compare(replace(data, positions=positions))
    model = found.models[0]
    assert model.rms < 1e-9
    assert np.isnan(model.distance[1, 4])
    assert np.isfinite(np.delete(model.distance.ravel(), 30 + 4)).all()
    assert model.tip_error_of(0).n == 2
    floor = compare(replace(data, positions=positions + noise)).measured.floor
    np.testing.assert_allclose(floor[0, [0, -1]], 3e-8 / np.array([3, 2]), rtol=0.1)


@pytest.mark.parametrize(
    ('path', 'noise'),
    [
        (KATO, SimulatedNoise(position=2e-4, setting=0.0, trial=0.0)),
        (KATO, SimulatedNoise(position=2e-4, setting=0.004, trial=0.006)),
        (SPATIAL, SimulatedNoise(position=1e-4, setting=0.01, trial=0.0)),
    ],
    ids=['tracker', 'tensions', 'spatial'],
)
def test_the_noise_floor_is_what_a_perfect_model_shows(path, noise):
    robot = load_robot(path)
    postures = default_postures(robot, 8)
    own = twin(robot)
    floors, errors = [], []
    for seed in range(200):
        data = simulate(own, postures, noise=noise, trials=4, seed=seed)
        errors.append(np.linalg.norm(own.shapes(postures).positions - data.mean, axis=2))
        if seed < 8:
            floors.append(compare(data).noise_floor)
    expected = np.sqrt(np.mean(np.square(errors)))
    assert np.mean(floors) == pytest.approx(expected, rel=0.04)
    np.testing.assert_allclose(floors, expected, rtol=0.12)


def test_with_one_trial_the_declared_noise_is_the_floor(kato):
    data = perfect(kato, trials=1, noise=SimulatedNoise(3e-4, 0.0, 0.0))
    assert compare(data).noise_floor == pytest.approx(np.sqrt(3.0) * 3e-4)
    unknown = compare(replace(data, position_noise=None))
    assert unknown.noise_floor is None
    assert unknown.grows_from(unknown.models[0]) is None


def test_the_error_grows_from_the_cell_that_is_wrong(kato):
    data = perfect(kato, noise=SimulatedNoise(1e-4, 0.0, 0.0))
    first, *others = kato.sections
    softer = tuple(0.6 * k if i == 8 else k for i, k in enumerate(first.bending_stiffness))
    wrong = replace(kato, sections=(replace(first, bending_stiffness=softer), *others))
    found = compare(data, [('wrong', wrong), ('right', kato)])
    assert found.best.name == 'right'
    assert found.grows_from(found.models[0]) in (8, 9)
    assert found.grows_from(found.models[1]) is None


def test_angular_displacement_is_the_turn_from_chord_to_chord(kato):
    plain = replace(kato, effects={})
    shapes = Model(plain).shapes([[0.5, 0.0, 0.0, 0.9], [0.0, 0.3, 0.0, 0.0]])
    bend = shapes.bend[..., 0]
    turned = cell_rotations(shapes.positions)
    np.testing.assert_allclose(turned[:, 0, 1], bend[:, 0] / 2, atol=1e-12)
    np.testing.assert_allclose(turned[:, 1:, 1], (bend[:, :-1] + bend[:, 1:]) / 2, atol=1e-12)
    np.testing.assert_allclose(turned[..., [0, 2]], 0.0, atol=1e-12)
    np.testing.assert_allclose(bending_axes(shapes.positions), [[0.0, 1.0, 0.0]] * 2)
    data = perfect(plain, noise=QUIET, trials=2)
    found = compare(data)
    mean, half = found.angle_bands()
    np.testing.assert_allclose(mean, found.models[0].angles, atol=1e-9)
    np.testing.assert_allclose(half, 0.0, atol=1e-9)


def test_in_space_angles_count_in_the_plane_of_bending():
    robot = replace(load_robot(SPATIAL), effects={})
    for tensions in ([[0.8, 0.0, 0.0]], [[0.1, 0.6, 0.3]]):
        shapes = Model(robot).shapes(tensions)
        axes = bending_axes(shapes.positions)
        turned = (cell_rotations(shapes.positions) * axes[:, None]).sum(axis=2)
        size = np.linalg.norm(shapes.bend[0, 0])
        np.testing.assert_allclose(np.abs(turned[0, 1:]), size, atol=1e-9)


def test_markers_beside_the_centreline_tell_no_angles(kato):
    beside = [Marker('a', 0.1, (0.01, 0.0, 0.0)), Marker('b', 0.2)]
    assert compare(perfect(kato, markers=beside)).measured.angles is None


def test_the_centreline_is_drawn_where_a_posture_has_fewer_trials(kato):
    """A table has no inputs where a trial was not measured."""
    data = perfect(kato, trials=2, markers=[Marker('a', 0.0), Marker('b', 0.2)])
    positions, inputs = np.array(data.positions), np.repeat(data.inputs[:, None], 2, axis=1)
    positions[1, 1], inputs[1, 1] = np.nan, np.nan
    found = compare(replace(data, positions=positions, trial_inputs=inputs))
    assert np.isfinite(found.models[0].centreline).all()


def test_models_are_tested_against_each_other(hinges):
    pcca = replace(hinges.robot, effects={})
    found = compare(hinges, [('FKM', hinges.robot), ('PCCA', pcca)])
    overall, *each = found.paired_t
    expected = scipy.stats.ttest_rel(*(m.tip_errors.mean(axis=1) for m in found.models))
    assert (overall.models, overall.posture, overall.n) == (('FKM', 'PCCA'), None, 12)
    assert overall.p == pytest.approx(expected.pvalue)
    assert [test.posture for test in each] == list(hinges.postures)
    assert {test.n for test in each} == {5}


@pytest.mark.parametrize('letter', 'abcdefghijkl')
def test_every_blind_case_compares(letter):
    found = compare(load_dataset(blind(letter) / 'fit'))
    ratio = found.models[0].rms / found.noise_floor
    assert ratio < 1.3 if letter == 'a' else ratio > 1.3


def test_the_tentacle_compares():
    found = compare(load_dataset(ROOT / 'data' / 'tentacle'))
    assert found.measured.angles is None
    assert np.isfinite(found.models[0].rms)
    assert np.isnan(found.models[0].tip_error_of(0).half)


def test_pulled_by_displacement(kato):
    pulls = default_postures(kato, 4, input='displacement')
    data = simulate(twin(kato), pulls, trials=3, input='displacement', noise=SimulatedNoise(1e-4))
    found = compare(data)
    assert found.models[0].rms < 1.5 * found.noise_floor


def test_another_robot_is_refused(hinges, kato):
    with pytest.raises(
        InputError, match=r'model kato: expected the inputs left, right of .*prox_'
    ):
        compare(hinges, [('kato', kato)])
    with pytest.raises(InputError, match="error: expected one of ci, sem, got 'sd'"):
        compare(hinges, error='sd')


def test_an_error_that_begins_at_the_first_marker_is_told_at_both_ends(hinges):
    found = compare(hinges)
    object.__setattr__(found, 'grows_from', lambda model: 0)
    first, last = 1e3 * found.best.per_marker_rms[[0, -1]]
    said = where_worst(found)
    assert said.endswith(f'first marker is off by {first:.3f} mm rms, the last by {last:.2f} mm.')


def test_of_a_single_marker_nothing_is_told_along_the_arm(hinges):
    tip = replace(hinges, markers=hinges.markers[-1:], positions=hinges.positions[:, :, -1:])
    found = compare(tip)
    assert found.grows_from(found.best) == 0
    rms = 1e3 * found.best.per_posture_rms.max()
    assert where_worst(found).endswith(f'), rms {rms:.2f} mm.')


def test_models_are_robots_or_pairs_with_a_name(hinges):
    robot = hinges.robot
    found = compare(hinges, [robot, replace(robot, effects={}), ('bare', robot)])
    assert [model.name for model in found.models] == [robot.name, f'{robot.name} (2)', 'bare']
    assert compare(hinges, robot).models[0].rms == found.models[2].rms != found.models[1].rms
    for wrong in (['robot.yaml'], [('name', 'robot.yaml')], [3], 3, robot.name):
        with pytest.raises(TendonRobotError, match='expected'):
            compare(hinges, wrong)


def test_a_model_without_equilibrium_is_named(hinges):
    softens = hinges.robot.with_effect('nonlinear_stiffness', {'cubic': -0.5})
    weak = softens.with_effect('backbone_stiffness', {'relative_change': -0.8})
    with pytest.raises(NoEquilibriumError, match=r'posture \d+ \(left .* N, right .* N\)'):
        compare(hinges, [('weak', weak)])
