"""Derivatives of the equilibrium: against differences, for every effect and for all together."""

from dataclasses import replace

import numpy as np
import pytest
from arms import GRAVITY, TYPICAL, section, spatial, wound
from reference import Reference
from test_effects_contract import EFFECTS, VALUES

from tendon_robot_ros.common.errors import EffectError, InputError
from tendon_robot_ros.effects import Parameter, load_catalogue
from tendon_robot_ros.model import derivatives
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot

TENSIONS = np.array([[0.3, 0.5, 1.1, 0.5, 0.4, 0.2], [0.0, 1.3, 0.2, 0.0, 0.9, 0.4]])
FRICTION = ('tendon_friction', 'tendon_travel', 'eyelet_wrap')


def arm(names, bends_as='hinge', cells=3):
    """Return a spatial arm with these effects at a size that matters."""
    effects = {name: VALUES[name] for name in names}
    return replace(spatial(cells, effects, bends_as), gravity=GRAVITY)


def unknowns(model):
    """Entries of a state that count: two bends per cell, and a twist where cells twist."""
    return (3 if model.arrays.twists else 2) * model.robot.cells


def residuals(model, inputs, states):
    """States (b, 3n) minus what their moments ask for, (b, 3n) [rad]."""
    plain = derivatives.variants(model, inputs, [])
    return derivatives.off_balance(model, *plain, states, model.arrays.fresh_memory())[0][0]


@pytest.mark.parametrize('bends_as', ['arc', 'hinge'])
@pytest.mark.parametrize(
    'names',
    [*([name] for name in EFFECTS), *([*FRICTION, name] for name in EFFECTS), list(TYPICAL)],
    ids=lambda names: '+'.join(names) if len(names) < 5 else 'all',
)
def test_the_elimination_solves_the_equations_of_the_differences(names, bends_as):
    """Away from an equilibrium, at any bends: the Jacobian times the way is minus the rate."""
    robot = arm(dict.fromkeys(names), bends_as)
    model = Model(wound(robot) if 'torsion' in names else robot)
    random = np.random.default_rng(4)
    count, size, step = unknowns(model), 3 * model.robot.cells, 1e-6
    state = random.normal(0.0, 0.1, size)
    inputs = np.tile(TENSIONS[0], (count, 1))
    up, down = (
        residuals(model, inputs, state + side * step * np.eye(count, size)) for side in (1.0, -1.0)
    )
    jacobian = (up - down)[:, :count].T / (2.0 * step)
    rates = random.normal(size=(1, 4, size))
    past = model.arrays.fresh_memory()
    ways = derivatives.responses(model, TENSIONS[:1], state[None], past, rates)[0]
    assert np.allclose(jacobian @ ways[:, :count].T, -rates[0, :, :count].T, rtol=0, atol=1e-5)
    assert not ways[:, count:].any()


@pytest.mark.parametrize('spatially', [False, True])
def test_a_row_of_residuals_is_as_wide_as_a_state_whatever_acts(spatially):
    """What is written lies where it belongs, and nothing behind the array is written."""
    robot = arm({'tendon_friction': None}) if spatially else load_robot('kato_10_1')
    model, random = Model(robot), np.random.default_rng(6)
    b, n, m = 3, robot.cells, len(model.inputs)
    inputs, states = random.uniform(0.1, 0.9, (b, m)), random.normal(0.0, 0.05, (b, 3 * n))
    states[:, 2 * n :] = 0.0
    rows = []
    for twists in (False, True):
        if twists:
            model.arrays.act('torsion')
        model.arrays.link()
        held = np.full((b + 2, 3 * n), 7.0)  # a row before and behind
        past, part = model.arrays.fresh_memory(), model.arrays.part('shape')
        _, changes = derivatives.variants(model, inputs, [])
        block, _, _ = model.form.filled(inputs, states)
        part.variants(model.arrays.address, block, past, model.scratch, *changes, held[1:-1], 0)
        assert (held[[0, -1]] == 7.0).all()
        rows.append(held[1:-1])
    assert np.allclose(*rows, rtol=0, atol=1e-12)
    assert rows[0][:, : 2 * n].all() and not rows[0][:, 2 * n :].any()


def test_the_residual_is_what_the_plain_model_says():
    model, random = Model(arm(TYPICAL)), np.random.default_rng(5)
    states = random.normal(0.0, 0.1, (2, 3 * model.robot.cells))
    reference = Reference(model.robot)
    for row, state, told in zip(TENSIONS, states, residuals(model, TENSIONS, states), strict=True):
        assert np.allclose(told, state - reference.implied(row, state), rtol=0, atol=1e-7)


def test_markers_inside_a_cell_by_tensions_and_by_parameters():
    model = Model(arm(TYPICAL))
    places = np.array([0.0081, 0.0333]), np.array([[0.0, 0.01, 0.0], [0.002, 0.0, 0.001]])

    measured = np.zeros((len(TENSIONS), 2, 3))  # of each posture

    def seen(batch):
        return model.measured(batch.markers(*places)) - measured

    columns = ['near_1', ('tendon_friction', 'friction_coefficient'), ('tip_load', 'force_y')]
    columns.append(('section_stiffness', 'relative_change', 1))
    found = model.derivatives(model.shapes(TENSIONS), columns, seen)
    assert found.shape == (2, 2, 3, 4)
    for q, (column, step) in enumerate(zip(columns, (1e-4, 1e-4, 1e-5, 1e-3), strict=True)):
        sides = []
        for side in (step, -step):
            moved, inputs = Model(model.robot), TENSIONS.copy()
            if isinstance(column, str):
                inputs[:, 1] += side
            else:
                own = column[2] if len(column) == 3 else None
                here = moved.arrays.get(*column[:2], own)
                moved.arrays.set(*column[:2], own, here + side)
            sides.append(moved.measured(moved.shapes(inputs).markers(*places)))
        expected = (sides[0] - sides[1]) / (2.0 * step)
        assert np.allclose(found[..., q], expected, rtol=1e-4, atol=2e-7)


def test_of_a_parameter_that_is_described_beyond_the_bounds_of_a_fit():
    arm, inputs = load_robot('kato_10_1'), [[0.6, 0.1, 0.2, 0.1]]
    value, step = 0.6 * 0.0055, 1e-7

    def with_clearance(size):
        return Model(arm.with_effect('eyelet_clearance', {'clearance': size}))

    model = with_clearance(value)
    assert value > model.catalogue['eyelet_clearance'].parameters[0].high
    found = model.derivatives(model.shapes(inputs), [('eyelet_clearance', 'clearance')])[..., 0]
    up, down = (with_clearance(value + h).shapes(inputs).positions for h in (step, -step))
    assert np.allclose(found, (up - down) / (2.0 * step), rtol=1e-4, atol=1e-5)


def test_every_tendon_has_its_own_tension_before_the_base():
    model = Model(arm(['tendon_friction', 'straight_tendon', 'tendon_travel']))
    model.arrays.set('transmission_loss', 'fraction', 1, 0.25)
    inputs = np.full(len(model.inputs), 0.5)
    expected = np.where(np.arange(len(model.robot.tendons)) == 1, 0.375, 0.5)
    assert np.allclose(model.shape(inputs).tendon_tensions[0], expected, rtol=0, atol=1e-15)
    found, step = model.jacobian(inputs)[:3], 1e-4 * np.eye(len(inputs))
    sides = [model.shapes(inputs + side * step).tip_position for side in (1.0, -1.0)]
    assert np.allclose(found, (sides[0] - sides[1]).T / 2e-4, rtol=1e-4, atol=1e-6)


def test_by_stiffness_of_cells_that_bow_under_a_load():
    arm = load_robot('spatial_3').with_effect('tip_load', {'force_x': 0.05, 'force_y': 0.02})
    sections = tuple(section(s.name, 2, 0.08, 0.05) for s in arm.sections)
    robot = replace(arm, sections=sections, effects={'tip_load': arm.effects['tip_load']})
    model, inputs, step = Model(robot), [[0.3, 0.1, 0.1]], 1e-4
    shapes = model.shapes(inputs)
    found = model.derivatives(shapes, [('backbone_stiffness', 'relative_change')])[..., 0]
    up, down = (
        Model(robot.with_effect('backbone_stiffness', {'relative_change': h})).shapes(inputs)
        for h in (step, -step)
    )
    expected = (up.positions - down.positions) / (2.0 * step)
    assert np.allclose(found, expected, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize('friction', [[], ['tendon_friction', 'straight_tendon']])
def test_of_a_slack_tendon_whose_reading_has_an_offset_they_are_those_of_a_pulled_one(friction):
    """An offset is that of tendons that are pulled: at zero the law jumps."""
    model = Model(arm(friction).with_effect('tension_offset', {'offset': 1e-3}))
    slack, step = TENSIONS[1], 1e-5 * np.eye(6)
    pulled = model.shapes(slack + 2.0 * step).tip - model.shapes(slack + step).tip
    by_all = model.derivatives(model.shapes(slack[None]), model.inputs, lambda batch: batch.tip)
    for found in (model.jacobian(slack), by_all[0]):
        assert np.abs(found - pulled.T / 1e-5).max() < 5e-3 * np.abs(found).max()


def test_of_no_posture_there_are_none():
    model = Model(arm(['gravity']))
    columns = ['near_0', ('gravity', 'linear_density')]
    found = model.derivatives(model.shapes(TENSIONS[:0]), columns)
    assert found.shape == (0, model.robot.cells, 3, 2)


def test_of_a_quantity_that_does_not_exist():
    model = Model(arm(['gravity']))
    shapes = model.shapes(TENSIONS)
    with pytest.raises(InputError, match="unknown input 'left'; known: near_0, near_1"):
        model.derivatives(shapes, ['left'])
    with pytest.raises(InputError, match="gravity: unknown parameter 'mass'; known: linear_dens"):
        model.derivatives(shapes, [('gravity', 'mass')])
    with pytest.raises(EffectError, match="unknown effect 'weight'"):
        model.derivatives(shapes, [('weight', 'mass')])


def test_the_model_is_as_before_after_its_derivatives():
    model = Model(arm(['gravity']))
    values, on = model.arrays.values.copy(), model.arrays.on.copy()
    columns = [(e.name, p.name) for e in load_catalogue() for p in e.parameters]
    model.derivatives(model.shapes(TENSIONS), columns)
    assert np.array_equal(values, model.arrays.values) and np.array_equal(on, model.arrays.on)


@pytest.mark.parametrize('name', ['spatial_3', 'spatial_6'])
@pytest.mark.long
def test_every_posture_of_a_spatial_arm_has_its_equilibrium(name, request):
    """Tendons pull against each other, and half of the eyelets stick."""
    robot = load_robot(request.config.rootpath / f'config/robots/{name}.yaml')
    model, random = Model(robot), np.random.default_rng(1)
    low, high = model.limits.T
    inputs = low + random.random((100, len(low))) * (np.minimum(high, 4.0) - low)
    shapes, changes = model.solve(inputs)
    assert (changes < 1e-10).all()
    assert np.abs(shapes.bend).max() < 0.9  # [rad] beyond it eyelets would pass each other
    reference = Reference(robot)
    for b in range(0, 100, 20):
        implied = reference.implied(inputs[b], shapes.state[b])
        assert np.abs(implied - shapes.state[b]).max() < 1e-6
    near, changes = model.solve(inputs * 1.01, shapes.state)
    assert (changes < 1e-10).all()
    cold, _ = model.solve(inputs * 1.01)
    apart = np.linalg.norm(near.tip_position - cold.tip_position, axis=1)
    assert np.median(apart) < 1e-9


@pytest.mark.parametrize('name', ['spatial_3', 'spatial_6'])
def test_without_tendon_travel_every_posture_settles_too(name, request):
    """The sign of friction then turns with the last digit of a bend: cell after cell it is met."""
    robot = load_robot(request.config.rootpath / f'config/robots/{name}.yaml')
    model, random = Model(robot.without_effect('tendon_travel')), np.random.default_rng(2)
    low, high = model.limits.T
    inputs = low + random.random((100, len(low))) * (np.minimum(high, 5.0) - low)
    shapes, changes = model.solve(inputs)
    assert (changes < 1e-10).all()
    assert np.abs(residuals(model, inputs, np.ascontiguousarray(shapes.state))).max() < 1e-10


@pytest.mark.parametrize('name', EFFECTS)
def test_tensions_that_come_in_at_the_base_are_those_of_the_differences(name):
    """The elimination says how the bends follow a tension without any right-hand side."""
    model = Model(arm(dict.fromkeys([*FRICTION, name])))
    shapes = model.shapes(TENSIONS[:1])  # at no tension differences are one-sided
    slopes = model.derivatives(shapes, list(model.inputs), lambda batch: batch.tip)[0]
    assert np.allclose(model.jacobian(TENSIONS[0]), slopes, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize(
    ('value', 'down', 'up'),
    [(0.4, -0.4, 0.4), (1.0, -1.0, 0.0), (5.0, -5.0, 0.0), (-5.0, 0.0, 5.0), (0.0, 0.0, 0.1)],
)
def test_a_parameter_moves_by_a_small_step_also_from_where_no_fit_goes(value, down, up):
    ends = derivatives.ends_of(Parameter('share', '1', 0.0, 1.0, 0.0, typical=0.1), value)
    assert ends == pytest.approx(np.array([down, up]) * derivatives.DIFFERENCE_STEP, abs=1e-12)
