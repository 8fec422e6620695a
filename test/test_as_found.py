"""The arm as it was found: values and intervals of an improved description, and its last step."""

from dataclasses import replace

import numpy as np
import pytest
import simulated
from simulated import CATALOGUE, measured

from tendon_robot_ros import improve
from tendon_robot_ros.diagnosis.add import add_effect
from tendon_robot_ros.diagnosis.improve import as_found
from tendon_robot_ros.diagnosis.result import AS_FOUND, total
from tendon_robot_ros.diagnosis.stepwise import State, Stepwise
from tendon_robot_ros.inference.description import PROFILE, blocks_of_the_arm
from tendon_robot_ros.inference.fit import Fit
from tendon_robot_ros.inference.predict import free_parameters
from tendon_robot_ros.report.improvement_page import improvement_lines
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.measurements import simulate
from tendon_robot_ros.simulation.plant import make_plant
from tendon_robot_ros.workspace.postures import default_postures

ROBOT = simulated.robot()
HIDDEN = {'hinge_friction': {'lever': 2e-4}}


def built(robot, hidden, seed, level=1.0, which=0, count=12):
    """Return measurements of an arm that is built as in a laboratory, undeclared."""
    plant = make_plant(robot, hidden, seed=seed, work=Workmanship().times(level))
    return simulate(plant, default_postures(robot, count, which), trials=5, seed=seed + which)


def state_of(search, *names):
    """Return blocks fitted together by a search."""
    blocks = tuple(next(b for b in search.blocks if b.label == name) for name in names)
    start = {free: 0.5 * free.parameter.typical for block in blocks for free in block.frees}
    return search.fitted(blocks, start, search.weights())


@pytest.fixture(scope='module')
def search():
    """Return a search on an arm as it is built that hides a friction."""
    return Stepwise(built(ROBOT, HIDDEN, 4), ROBOT, CATALOGUE)


@pytest.fixture(scope='module')
def found(search):
    return as_found(search, state_of(search, 'hinge_friction'))


def test_values_and_intervals_are_near_those_of_add(search, found):
    """It searched with other weights; what data tell of a value is much the same."""
    added = add_effect(search.dataset, ['hinge_friction'], ROBOT).values
    there, own = added['hinge_friction']['lever'], found.values['hinge_friction']['lever']
    half = 0.5 * (there.high - there.low)
    assert abs(own.value - there.value) < 0.2 * half
    assert 0.9 * half < 0.5 * (own.high - own.low) < 1.5 * half
    of_search = found.values_of_the_search['hinge_friction']['lever']
    assert of_search.value == found.state.fit.values[0] != own.value
    assert of_search.low == min(own.low, of_search.value)
    assert of_search.high == max(own.high, of_search.value)


def test_imperfections_are_as_large_as_is_plausible_at_least(found):
    random, sizes = found.fit.built.random, found.fit.built.sizes
    told = np.isfinite(random.plausible)
    assert (sizes[told] >= random.plausible[told] * (1.0 - 1e-12)).all()


def test_a_load_of_the_search_knows_how_far_it_is_from_the_arm_as_found():
    hidden = {'tip_load': {'force_x': 0.02, 'force_y': 0.0, 'force_z': 0.0}}
    search = Stepwise(built(ROBOT, hidden, 5), ROBOT, CATALOGUE)
    found = as_found(search, state_of(search, 'tip_load'))
    own, moved = found.loads['tip_load'].size, found.loads_of_the_search['tip_load'].size
    assert moved.value == pytest.approx(np.linalg.norm(found.state.fit.values))
    assert moved.high - moved.value >= own.high - own.value
    assert moved.low <= own.value <= moved.high


@pytest.mark.parametrize('off', [0.0, 0.008])
def test_a_frame_that_joined_is_told_with_the_imperfection_that_it_stands_for(off):
    """Off as any tracker's it is an imperfection, further off an effect: the value is the sum."""
    plant = make_plant(ROBOT, HIDDEN, seed=7, work=Workmanship())
    data = simulate(plant, default_postures(ROBOT, 12), trials=5, seed=7)
    data = replace(data, positions=data.positions + [off, 0.0, 0.0])
    search = Stepwise(data, ROBOT, CATALOGUE)
    found = as_found(search, state_of(search, 'hinge_friction', 'base_misalignment'))
    freed = {free.effect for free in found.fit.frees}
    assert freed == ({'hinge_friction', 'base_misalignment'} if off else {'hinge_friction'})
    for axis, true in zip('xyz', plant.built.position + [off, 0.0, 0.0], strict=True):
        value = found.values['base_misalignment'][f'shift_{axis}']
        assert abs(value.value - true) < value.high - value.low < 5e-4
        written = found.robot.effects['base_misalignment'][f'shift_{axis}']
        assert written == pytest.approx(value.value, abs=1e-6)


def test_what_joined_of_the_arm_itself_may_change_with_the_effect(search, found):
    both = as_found(search, state_of(search, 'hinge_friction', PROFILE))
    alone = replace(both, state=replace(both.state, blocks=both.state.blocks[:1]))
    widths = [one.values['hinge_friction']['lever'] for one in (both, alone)]
    assert widths[0].high - widths[0].low > (widths[1].high - widths[1].low)


def test_of_an_exact_arm_values_are_as_wide_as_the_arm_itself_may_change():
    dataset = measured(replace(ROBOT, exact=True), count=4)
    profile = next(blocks_of_the_arm(ROBOT))
    jacobian = np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.1, 1.0]])
    friction = free_parameters(CATALOGUE['hinge_friction'], ROBOT)
    frees = (*friction, *profile.frees[:2])
    fit = Fit(frees, (), np.array([1e-4, 0.0, 0.0]), np.zeros(3), jacobian, dataset.mean)
    known = State((), fit, None, None).effects
    assert known.frees == friction and known.values == [1e-4]
    assert known.covariance[0, 0] == pytest.approx(np.linalg.inv(jacobian.T @ jacobian)[0, 0])


def test_postures_that_are_held_have_no_part_in_the_arm_beside_a_search(search, found):
    held = search.folds[3]
    positions = search.dataset.positions.copy()
    positions[held] += 0.02
    other = Stepwise(replace(search.dataset, positions=positions), ROBOT, CATALOGUE)
    own, moved = (
        found.beside(state_of(one.without(held), 'hinge_friction')) for one in (search, other)
    )
    np.testing.assert_allclose(moved, own, atol=1e-6)
    error, before = (
        np.linalg.norm(search.measured[held] - shown[held], axis=2).max()
        for shown in (own, found.state.fit.markers)
    )
    assert error < 0.7 * before


@pytest.mark.long
def test_the_arm_as_found_is_the_last_step_where_left_out_errors_fall():
    dataset, check = (built(ROBOT, HIDDEN, 8, which=which, count=8) for which in (0, 1))
    found = improve(dataset, check=check)
    before, last = found.steps[found.taken - 1], found.steps[found.taken]
    assert last.joined == AS_FOUND and 'hinge_friction' in before.joined
    assert total(last.left_out) < total(before.left_out) - last.scatter
    assert total(last.check) < total(before.check)
    value = found.values['hinge_friction']['lever']
    assert value.low < HIDDEN['hinge_friction']['lever'] < value.high
    said = '\n'.join(improvement_lines(found))
    assert '+ the arm as it was found' in said and 'the arm as built scatters by' in said
    content = found.to_json()
    assert content['steps'][found.taken]['joined'] == AS_FOUND and content['as_built']['kinds']
    assert found.robot.sections[0].bending_stiffness != ROBOT.sections[0].bending_stiffness


def test_the_arm_as_found_is_not_tried_on_an_exact_one_or_where_noise_remains():
    exact = replace(ROBOT, exact=True)
    assert AS_FOUND not in [s.joined for s in improve(built(exact, HIDDEN, 6, count=4)).steps]
    dataset = measured(ROBOT, HIDDEN, count=6, seed=1)
    assert AS_FOUND not in [s.joined for s in improve(dataset).steps]
