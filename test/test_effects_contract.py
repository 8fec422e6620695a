"""What every effect of the catalogue promises, whoever wrote it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from arms import GRAVITY, TYPICAL, planar, spatial, turned, two_sections

from tendon_robot_ros.common.rotations import about
from tendon_robot_ros.effects import BUILT_IN, STAGES, load_catalogue
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.model.pulls import pull_shapes
from tendon_robot_ros.robot.estimates import natural_sizes

CATALOGUE = load_catalogue().sized(natural_sizes(two_sections()))
EFFECTS = [effect.name for effect in CATALOGUE]
MEMORY = {'friction_memory': {'presliding_length': 1e-4}}
SHIFTED = {'shift_x': 1e-3, 'shift_y': -2e-3, 'shift_z': 5e-4}
SHIFTED |= {'rotation_x': 0.02, 'rotation_y': 0.01, 'rotation_z': -0.03}
VALUES = TYPICAL | MEMORY | {'base_misalignment': SHIFTED}
FRICTION = {'tendon_friction': {'friction_coefficient': 0.3}}
INPUTS = np.array([[0.0, 0.9], [0.6, 0.2], [1.4, 1.1]])
SPATIAL_INPUTS = np.array([[0.3, 0.0, 1.1, 0.5, 0.0, 0.2], [0.0, 1.3, 0.2, 0.0, 0.9, 0.4]])


def with_effects(robot, *names):
    """
    Return the robot under gravity with friction and these effects at a size that matters.

    Nothing twists an arm whose tendons run along it, unless there is a load.
    """
    names += ('tip_load',) * ('torsion' in names)
    effects = FRICTION | {name: VALUES[name] for name in names}
    sections = len(robot.sections)
    if 'section_stiffness' in effects:
        change = (0.2, -0.1)[:sections]
        effects = effects | {'section_stiffness': {'relative_change': change}}
    return replace(robot, effects=effects, gravity=GRAVITY)


def seen(model, inputs):
    """Everything that a posture shows, one row per posture."""
    batch = model.sequence(inputs) if model.remembers else model.shapes(inputs)
    told = (batch.bend, batch.positions, batch.frames, batch.tendon_tensions, batch.pulls)
    told += (model.measured(batch.positions),)
    return np.concatenate([array.reshape(len(inputs), -1) for array in told], axis=1)


def seen_by_pulls(model, inputs):
    """Positions under pulls that a posture has, those of its slack wires left free."""
    pulls = np.where(inputs > 0.0, model.shapes(inputs).pulls, np.nan)
    return pull_shapes(model, pulls).positions


@pytest.mark.parametrize('name', EFFECTS)
def test_an_effect_alone_answers_all_that_is_asked_of_a_model(name):
    """Explicit models are compiled without the solvers: what asks for these must link them."""
    effects = {name: {'relative_change': (0.1,)} if name == 'section_stiffness' else VALUES[name]}
    model = Model(replace(planar(3, effects), gravity=GRAVITY))
    shape = model.shape([0.3, 0.5])
    assert np.isfinite(model.jacobian([0.3, 0.5])).all()
    assert model.reach(shape.tip_position, guess=shape, starts=1).position_error < 1e-6
    assert np.isfinite(model.pull_shape(shape.pulls).positions).all()
    assert np.isfinite(model.derivatives(shape.batch, model.inputs)).all()


def test_an_effect_that_scales_all_bends_alike_says_so():
    """In an arm of one section without friction: one factor over cells and postures, not one."""
    robot = planar()
    bare = Model(robot).shapes(INPUTS).bend[..., 0]
    scaling = []
    for name in EFFECTS:
        values = {'relative_change': (0.1,)} if name == 'section_stiffness' else VALUES[name]
        ratio = Model(robot.with_effect(name, values)).shapes(INPUTS).bend[..., 0] / bare
        scaling += [name] if np.ptp(ratio) < 1e-9 < abs(ratio[0, 0] - 1.0) else []
    assert scaling == [effect.name for effect in CATALOGUE if effect.scales_bends]


def test_the_catalogue_is_that_of_the_design_and_every_effect_stands_in_the_tests():
    assert tuple(EFFECTS) == BUILT_IN
    assert set(EFFECTS) == set(VALUES)


@pytest.mark.parametrize('effect', CATALOGUE, ids=EFFECTS)
def test_units_bounds_and_neutral_values_exist(effect):
    assert effect.stage in STAGES and effect.title and effect.law.__doc__
    for parameter in effect.parameters:
        assert parameter.unit
        assert -math.inf < parameter.low <= parameter.neutral <= parameter.high < math.inf
        assert 0.0 < parameter.typical <= parameter.high - parameter.low


@pytest.mark.parametrize('effect', EFFECTS)
def test_an_effect_changes_something(effect):
    changed = with_effects(two_sections(bends_as='hinge'), effect)
    base = changed.without_effect(effect)
    s_shape = np.array([[1.2, 0.0, 0.0, 0.5], [0.2, 0.1, 0.1, 0.4]])
    seen_of = seen_by_pulls if CATALOGUE[effect].stage == 'transmission' else seen
    assert np.abs(seen_of(Model(changed), s_shape) - seen_of(Model(base), s_shape)).max() > 1e-6


@pytest.mark.parametrize('effect', [e for e in CATALOGUE if not e.always_on], ids=lambda e: e.name)
def test_neutral_is_exactly_off(effect):
    base = with_effects(planar(), 'gravity', 'straight_tendon')
    base = base.without_effect(effect.name) if effect.name in base.effects else base
    neutral = {parameter.name: parameter.neutral for parameter in effect.parameters}
    listed = base.with_effect(effect.name, neutral)
    model = Model(listed)
    assert not model.acts(effect.name)
    assert np.array_equal(seen(model, INPUTS), seen(Model(base), INPUTS))
    # nor does it matter while its law runs
    model.arrays.act(effect.name)
    assert np.allclose(seen(model, INPUTS), seen(Model(base), INPUTS), rtol=0, atol=1e-9)


@pytest.mark.parametrize('effect', [e for e in CATALOGUE if e.acts_on], ids=lambda e: e.name)
def test_what_shapes_friction_does_nothing_without_it(effect):
    base = planar()
    listed = base.with_effect(effect.name, VALUES[effect.name])
    assert not Model(listed).implicit
    assert np.array_equal(seen(Model(listed), INPUTS), seen(Model(base), INPUTS))


@pytest.mark.parametrize('effect', EFFECTS)
def test_a_batch_equals_single_postures(effect):
    model = Model(with_effects(two_sections(), effect))
    inputs = np.random.default_rng(0).uniform(0.0, 1.2, (130, 4))  # enough for two threads
    batch = model.shapes(inputs)
    for b in (0, 64, 65, 129):
        single = model.shape(inputs[b])
        for name in ('bend', 'positions', 'frames', 'tendon_tensions', 'pulls', 'tendon_pulls'):
            assert np.array_equal(getattr(single, name), getattr(batch, name)[b]), name


def leaves_the_plane(parameter):
    """Tell whether a parameter acts across the plane of x and z: a moment by its x and z."""
    axes = 'xz' if parameter.unit == 'N·m' else 'y'
    own = 'follows', 'azimuth', 'axis'  # a frame that turns with the arm, angles of a surface
    return parameter.name in own or parameter.name[-2:] in {f'_{axis}' for axis in axes}


@pytest.mark.parametrize('effect', [name for name in EFFECTS if name != 'base_misalignment'])
@pytest.mark.parametrize('bends_as', ['arc', 'hinge'])
def test_a_robot_turned_about_z_moves_the_same_way(effect, bends_as):
    """A planar robot is nothing special: in a plane at 40 degrees all is as in that of x and z."""
    angle = np.deg2rad(40.0)
    turn = about(2, angle)
    robot = replace(with_effects(planar(bends_as=bends_as), effect), gravity=(2.0, 0.0, 9.0))
    for name in robot.effects:
        beside = {p.name for p in CATALOGUE[name].parameters if leaves_the_plane(p)}
        robot = robot.with_effect(name, robot.effects[name] | dict.fromkeys(beside, 0.0))
    for row in INPUTS:
        one, other = Model(robot).shape(row), Model(turned(robot, angle)).shape(row)
        assert np.array_equal(one.bend[:, 1], np.zeros(robot.cells))
        assert np.allclose(other.bend, one.bend @ turn[:2, :2].T, rtol=0, atol=3e-10)
        assert np.allclose(other.positions, one.positions @ turn.T, rtol=0, atol=1e-11)
        assert np.allclose(other.pulls, one.pulls, rtol=0, atol=1e-11)


@pytest.mark.parametrize('effect', [name for name in EFFECTS if name != 'base_misalignment'])
def test_a_spatial_robot_turned_about_z_moves_the_same_way(effect):
    robot = with_effects(spatial(), effect)
    if effect == 'point_load':  # axes of the arm's frames do not turn with it
        robot = robot.with_effect(effect, VALUES[effect] | {'follows': 0.0})
    angle = 1.1
    turn = about(2, angle)
    for row in SPATIAL_INPUTS:
        one, other = Model(robot).shape(row), Model(turned(robot, angle)).shape(row)
        assert np.allclose(other.positions, one.positions @ turn.T, rtol=0, atol=1e-10)


def slope(at, step):
    """Fourth-order difference of a function of how far something is moved."""
    sides = ((1, 8.0), (-1, -8.0), (2, -1.0), (-2, 1.0))
    return sum(weight * at(count * step) for count, weight in sides) / (12.0 * step)


@pytest.mark.parametrize(
    ('effect', 'parameter'),
    [(e.name, p.name) for e in CATALOGUE for p in e.parameters if e.name not in MEMORY],
)
def test_the_derivative_by_a_parameter_equals_the_difference(effect, parameter):
    model = Model(with_effects(two_sections(3, bends_as='hinge'), effect))
    tensions = np.array([[0.1, 0.7, 0.9, 0.2]])
    found = model.derivatives(model.shapes(tensions), [(effect, parameter)])[..., 0]
    typical = {p.name: p.typical for p in CATALOGUE[effect].parameters}[parameter]
    row = model.arrays.layout.rows[effect, parameter]
    here = model.arrays.values[row].copy()  # of every section: they move together

    def moved(step):  # solved from straight
        model.arrays.values[row] = here + step
        return model.measured(model.shapes(tensions).positions)

    expected = slope(moved, 0.01 * typical)
    assert np.allclose(found * typical, expected * typical, rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize('effect', EFFECTS)
def test_the_jacobian_equals_the_difference(effect):
    model = Model(with_effects(spatial(3), effect))
    tensions = np.array([0.3, 0.5, 1.1, 0.5, 0.4, 0.2])
    found = model.jacobian(tensions)
    for column, one in zip(found.T, np.eye(6), strict=True):
        expected = slope(lambda step, one=one: model.shape(tensions + step * one).tip, 3e-5)
        assert np.allclose(column[:3], expected[:3], rtol=1e-4, atol=1e-7)
        assert np.allclose(column[3:], expected[3:], rtol=1e-4, atol=1e-6)
