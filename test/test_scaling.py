"""
A robot ten times as long, or a thousand times as stiff, is the same robot in other units.

Lengths times a and stiffnesses times b make forces times b / a; what a model or a diagnosis says
of the one it must say of the other, its numbers scaled by their units.
"""

from dataclasses import replace

import numpy as np
import pytest
from arms import UNITS, factor, planar, scaled, spatial, two_sections
from simulated import measure, postures

from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.inference.noise import Noise
from tendon_robot_ros.model.derivatives import take_sides, tip_slopes
from tendon_robot_ros.model.inverse import reach
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.model.pulls import pull_shapes
from tendon_robot_ros.model.tip_task import STREAM, Preferences, TipTask
from tendon_robot_ros.robot import Section, load_robot
from tendon_robot_ros.robot.estimates import natural_sizes

SCALES = ((0.1, 1.0), (10.0, 1.0), (1.0, 1e3), (10.0, 1e3))  # of lengths, of stiffness
CATALOGUE = load_catalogue()
FRICTION = {'tendon_friction': {'friction_coefficient': 0.3}}
TENSIONS = np.array([[0.1, 0.9, 0.1, 0.5], [1.2, 0.1, 0.1, 0.4]])


def test_natural_sizes_scale_as_their_units():
    units = {'radius': 'm', 'length': 'm', 'bend': 'rad', 'stiffness': 'N·m/rad'}
    units |= {'tension': 'N', 'force': 'N', 'density': 'kg/m', 'compliance': '1/N', 'give': 'm/N'}
    units |= {'moment': 'N·m', 'tip_stiffness': 'N/m', 'curvature': '1/m'}
    robot = spatial(taper=0.7)
    for length, stiffness in SCALES:
        found = natural_sizes(scaled(robot, length, stiffness))
        for key, value in natural_sizes(robot).items():
            powers = UNITS[units[key]]
            expected = value * length ** powers[0] * (stiffness / length) ** powers[1]
            assert found[key] == pytest.approx(expected, rel=1e-12)


def test_a_limit_below_what_bends_the_arm_is_the_tension_that_counts():
    robot = planar()
    weak = replace(robot, tension_limits=(0.0, 0.01))
    assert natural_sizes(weak)['tension'] == 0.01
    assert natural_sizes(robot)['tension'] == pytest.approx(0.027 / 6 / 0.0055)


def test_sizes_are_those_of_the_cells_that_bend_and_of_the_holes_that_are_listed():
    robot = planar(6)
    plate = Section('plate', 1, 1e-5, (1e6,), (1.0,), 'arc')
    found = natural_sizes(replace(robot, sections=(plate, *robot.sections)))
    for key, value in natural_sizes(robot).items():
        assert found[key] == pytest.approx(value, rel=1e-2)
    holes = ((0.0, 0.0), *[(0.0055, 0.0)] * 4, (0.0, 0.0))
    listed = tuple(replace(t, base=holes[0], end=holes[-1], offsets=holes) for t in robot.tendons)
    found = natural_sizes(replace(robot, tendons=listed))
    assert found['radius'] == 0.0055
    assert found['tension'] == pytest.approx(0.027 / 6 / 0.0055 * 6 / 4)


def loaded(robot):
    """Hang a force that matters across the bend: nothing else twists an arm."""
    sized = CATALOGUE['tip_load'].sized(natural_sizes(robot))
    return robot.with_effect('tip_load', {p.name: p.typical for p in sized.parameters})


def shown(robot, effect, force):
    """Return what an effect of a size that matters shows, in lengths of the robot."""
    base = replace(robot, gravity=(2.0, 0.0, 9.0)) if effect.needs == 'gravity' else robot
    sized = effect.sized(natural_sizes(base))
    base = base.with_effect(effect.name, {p.name: p.typical for p in sized.parameters})
    model = Model(loaded(base) if effect.name == 'torsion' else base)
    if 'pulls' in effect.needs:
        plain = Model(robot).shapes(force * TENSIONS).pulls
        positions = pull_shapes(model, np.where(TENSIONS > 0.15, plain, np.nan)).positions
    elif effect.needs == 'history':
        positions = model.sequence(force * TENSIONS).positions
    else:
        positions = model.shapes(force * TENSIONS).positions
    return model.measured(positions) / robot.length


@pytest.mark.parametrize('effect', CATALOGUE, ids=CATALOGUE.names)
def test_a_size_that_matters_follows_the_robot(effect):
    """It moves robots of all sizes by the same share of their length, and visibly."""
    robot = two_sections(5, dict(FRICTION))
    expected = shown(robot, effect, 1.0)
    base = robot.without_effect(effect.name) if effect.name in robot.effects else robot
    base = replace(base, gravity=None)
    model = Model(loaded(base) if effect.name == 'torsion' else base)
    change = np.abs(expected - model.shapes(TENSIONS).positions / robot.length).max()
    if effect.name not in ('tendon_travel', 'friction_memory', 'contact'):  # that is not touched
        assert 1e-4 < change < 0.5
    for length, stiffness in SCALES:
        found = shown(scaled(robot, length, stiffness), effect, stiffness / length)
        # friction smoothed over 2 um is all that does not scale
        assert np.allclose(found, expected, rtol=0, atol=2e-4 * change + 1e-7)


def alike(robot, length):
    """Return models of a robot and of one so many times as long, which loads bend alike."""
    force = length**2
    return Model(robot), Model(scaled(robot, length, length * force)), force


def noise_of(length):
    """Return the noise of trackers that follow the robot, too."""
    return Noise(2e-4 * length, 0.004, 0.002, np.inf, 'declared')


@pytest.mark.parametrize(
    ('name', 'values', 'kind'),
    [
        ('tip_load', {'force_x': 0.03, 'force_z': 0.1}, 'tension'),
        ('wire_spring', {'compliance': 1e-3}, 'displacement'),
    ],
)
@pytest.mark.long
def test_a_scaled_robot_with_scaled_data_gets_the_same_verdict(name, values, kind):
    # exact: a tracker's millimetre does not scale
    robot = replace(planar(5, dict(FRICTION)), gravity=(0.0, 0.0, 0.0), exact=True)
    inputs = np.array([[0.0, 1.0], [1.4, 0.2], [0.2, 1.8], [2.2, 0.0], [0.2, 0.6], [0.1, 2.5]])
    taut = np.where(inputs > 0.25, Model(robot).shapes(inputs).pulls, np.nan)
    found = []
    for length, stiffness in ((1.0, 1.0), (0.1, 1.0), (10.0, 1e3)):
        force = stiffness / length
        there = scaled(robot, length, stiffness)
        given = force * inputs if kind == 'tension' else length * taut
        hidden = {name: {k: factor(name, k, length, force) * v for k, v in values.items()}}
        noise = noise_of(length)
        data = measure(postures(there, given, 4, noise, input=kind), hidden, noise)
        result = diagnose(data)
        assert [effect.name for effect in result.effects] == [name], result
        parameters = result.effects[0].parameters
        sizes = [parameters[k].value / factor(name, k, length, force) for k in values]
        found.append((result.verdict, result.cannot_tell_apart, result.not_tested, sizes))
    for other in found[1:]:
        assert other[:3] == found[0][:3]
        assert np.allclose(other[3], found[0][3], rtol=0.02)
    assert np.allclose(found[0][3], list(values.values()), rtol=0.2)


@pytest.mark.parametrize('name', ['kato_10_1', 'spatial_3'])
@pytest.mark.parametrize('length', [0.2, 10.0])
def test_a_stream_of_targets_is_followed_alike(name, length):
    small, other, force = alike(load_robot(name), length)
    low, high = small.limits.T
    spread = np.linspace(0.05, 0.12, len(low)) * (high - low)
    way = low + spread * np.linspace(0.5, 1.5, 8)[:, None]
    places = small.shapes(way).tip_position
    here, there = small.shape(way[0]), other.shape(force * way[0])
    near = replace(STREAM, starts=0)
    for place in places:
        here = reach(replace(TipTask.at(small, place), guess=here), near).shape
        there = reach(replace(TipTask.at(other, length * place), guess=there), near).shape
        np.testing.assert_allclose(there.inputs / force, here.inputs, atol=2e-3 * high.max())
    assert np.linalg.norm(here.tip_position - places[-1]) < 1e-3


@pytest.mark.parametrize('length', [0.2, 10.0])
def test_friction_at_rest_takes_the_same_sides(length):
    robot = load_robot('kato_10_1').with_effect('friction_memory', {'presliding_length': 2e-4})
    small, other, force = alike(robot, length)
    found, (low, high) = [], small.limits.T
    for model, scale, pull in ((small, 1.0, 1.0), (other, length, force)):
        here = model.shape(pull * (low + 0.1 * (high - low)))
        past, move = here.memory.copy(), 1e-3 * pull * np.array([1.0, -0.5, 0.3, -1.0])
        turned = take_sides(model, here, past, move @ tip_slopes(model, here, past)[1])
        found.append((turned, tip_slopes(model, here, past)[0][:3] * pull / scale))
    assert found[0][0] == found[1][0] > 0
    np.testing.assert_allclose(found[1][1], found[0][1], atol=1e-4 * np.abs(found[0][1]).max())


@pytest.mark.parametrize('length', [0.2, 10.0])
def test_what_is_preferred_moves_the_tip_of_robots_of_all_sizes_alike(length):
    small, other, force = alike(load_robot('kato_10_1'), length)
    there, wants = small.shape([1.4, 0.8, 0.9, 1.1]), Preferences(low_tension=1.0)
    guess = other.shape(force * there.inputs)
    found = small.reach(there.tip_position, guess=there, preferences=wants)
    grown = other.reach(length * there.tip_position, guess=guess, preferences=wants)
    np.testing.assert_allclose(grown.tensions / force, found.tensions, atol=0.02)
    assert grown.position_error / length == pytest.approx(found.position_error, abs=2e-6)


@pytest.mark.parametrize('name', ['kato_10_1', 'spatial_3'])
@pytest.mark.parametrize('length', [0.2, 10.0])
def test_tensions_for_a_target_are_the_same_for_robots_of_all_sizes(name, length):
    """Loads and stiffness follow the length, so that the arm bends alike."""
    robot = loaded(load_robot(name).without_effect('tendon_friction'))
    small, other, force = alike(robot, length)
    low, high = small.limits.T
    for fractions in np.random.default_rng(2).random((4, len(low))):
        place = small.shape(low + 0.1 * fractions * (high - low)).tip_position
        for wants in (None, Preferences(low_tension=1.0)):
            found = small.reach(place, preferences=wants)
            grown = other.reach(length * place, preferences=wants)
            np.testing.assert_allclose(
                grown.tensions / force, found.tensions, atol=2e-3 * high.max()
            )
            assert max(found.position_error, grown.position_error / length) < 1e-5
