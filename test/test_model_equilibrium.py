"""Loads that buckle or crush the arm: an equilibrium that is one, or a clear refusal."""

from dataclasses import replace

import numpy as np
import pytest
import simulated
from arms import GRAVITY, TYPICAL, planar, spatial, two_sections
from reference import Reference
from scipy.optimize import brentq
from scipy.special import ellipk

from tendon_robot_ros.common.errors import NoEquilibriumError
from tendon_robot_ros.model.model import Model

K, L = 0.027, 0.007


def settled(robot, inputs):
    """Solve; tell whether there is an equilibrium, and fail if what came is none."""
    try:
        shape = Model(robot).shape(inputs)
    except NoEquilibriumError:
        return False
    gap = np.abs(Reference(robot).implied(np.asarray(inputs), shape.state) - shape.state).max()
    assert gap < 1e-6, f'returned a shape that is off by {gap:.2g} rad'
    return True


def pressed(force, side=1e-4, bends_as='arc'):
    """Return an arm of 15 cells pressed along its axis."""
    effects = {'tip_load': {'force_x': side, 'force_y': 0.0, 'force_z': -force}}
    return planar(15, effects, bends_as)


EULER = np.pi**2 * K * L / (4.0 * (15 * L) ** 2)  # [N] EI = K L, one end free


@pytest.mark.parametrize('bends_as', ['arc', 'hinge'])
@pytest.mark.parametrize('times', [0.5, 0.95, 1.05, 1.5, 3.0, 10.0])
def test_an_arm_pressed_past_its_buckling_load(times, bends_as):
    assert settled(pressed(times * EULER, bends_as=bends_as), [0.0, 0.0])


@pytest.mark.parametrize('bends_as', ['arc', 'hinge'])
def test_below_the_buckling_load_the_arm_hardly_bends_above_it_much(bends_as):
    small, large = (
        Model(pressed(times * EULER, bends_as=bends_as)).shape([0.0, 0.0]).bend.sum(axis=0)
        for times in (0.8, 1.2)
    )
    assert 0.0 < small[0] < 0.05 and large[0] > 0.5
    assert abs(large[1]) < 1e-6


@pytest.mark.parametrize('side', [1e-4, -1e-4, 0.0])
@pytest.mark.parametrize('times', [1.2, 2.0, 3.0])
def test_above_the_buckling_load_the_arm_is_an_elastica_to_the_side_it_is_pushed_to(times, side):
    total = Model(pressed(times * EULER, side)).shape([0.0, 0.0]).bend.sum(axis=0)
    half = brentq(lambda half: ellipk(np.sin(half) ** 2) - 0.5 * np.pi * np.sqrt(times), 0.1, 1.56)
    assert np.linalg.norm(total) == pytest.approx(2.0 * half, rel=0.01)
    if side:
        assert np.sign(side) * total[0] > 0.999 * np.linalg.norm(total)


def test_a_tendon_decides_the_side_of_an_arm_that_buckles():
    for inputs, sign in (([0.02, 0.0], -1.0), ([0.0, 0.02], 1.0)):
        bend = Model(pressed(1.5 * EULER, 0.0)).shape(inputs).bend.sum(axis=0)
        assert sign * bend[0] > 1.0


@pytest.mark.long
def test_ten_times_the_normal_loads_and_tensions():
    random, found = np.random.default_rng(5), []
    effects = {name: TYPICAL[name] for name in TYPICAL if name != 'section_stiffness'}
    for times in (1.0, 3.0, 10.0):
        scaled = dict(effects)
        for name in ('gravity', 'tip_load'):
            scaled[name] = {key: times * value for key, value in effects[name].items()}
        for make, bends_as in ((two_sections, 'arc'), (spatial, 'hinge')):
            robot = replace(make(6, scaled, bends_as), gravity=GRAVITY)
            for _ in range(5):
                inputs = random.uniform(0.0, 0.5 * times, len(robot.inputs))
                found.append((times, settled(robot, inputs)))
    assert all(good for times, good in found if times < 10.0)
    assert sum(good for _, good in found) >= 0.9 * len(found)


def test_a_spring_that_gives_way_has_no_equilibrium_and_says_so():
    robot = planar(3, {'nonlinear_stiffness': {'cubic': -0.5}})  # at most K (2/3)^1.5 of moment
    top = K * (2.0 / 3.0) ** 1.5 / 0.0055
    assert settled(robot, [0.0, 0.99 * top])
    with pytest.raises(NoEquilibriumError) as caught:
        Model(robot).shape([0.0, 1.01 * top])
    assert str(caught.value).startswith('no equilibrium for left 0 N, right 2.69889 N with ')
    assert caught.value.effects == ()
    with pytest.raises(NoEquilibriumError, match=r'for posture 1 \(left 0 N, right'):
        Model(robot).shapes([[0.0, 1.0], [0.0, 3.0]])
    # `solve` marks them and keeps the others
    batch, changes = Model(robot).solve(np.array([[0.0, 1.0], [0.0, 3.0], [0.0, 0.5]]))
    assert (changes < 1e-10).tolist() == [True, False, True]
    assert np.isfinite(batch.positions[[0, 2]]).all()


@pytest.mark.parametrize('bends_as', ['arc', 'hinge'])
@pytest.mark.long
def test_a_tendon_that_hardly_slides_is_solved(bends_as):
    """A tendon across the plane of bending is nearly neutral: plain repetition never settles."""
    names = ('tendon_friction', 'tendon_travel', 'eyelet_wrap')
    effects = {name: dict.fromkeys(TYPICAL[name], 1.0) for name in names}
    effects['tendon_friction'] = {'friction_coefficient': 0.4}
    random = np.random.default_rng(8)
    robot = spatial(6, effects, bends_as)
    for _ in range(12):
        strong = random.uniform(0.0, 1.0, 6)
        strong[1] = strong[2]  # symmetric: tendon 0 of the near section stays in the plane
        assert settled(robot, strong)


@pytest.mark.parametrize(('name', 'count'), [('kato_10_1_single', 400), ('spatial_6', 150)])
def test_cells_that_hardly_leave_the_dead_zone_of_their_hinge_are_solved(name, count):
    """Slopes across the kink are those of neither side: Newton stalled at 1e-9 rad beside it."""
    robot = simulated.robot(name)
    robot = robot.with_effect('hinge_friction', {'lever': 2e-4})
    robot = robot.with_effect('pre_curvature', {'angle_x': 0.01})
    random = np.random.default_rng(0)
    _, changes = Model(robot).solve(random.uniform(0.0, 1.6, (count, len(robot.inputs))))
    assert (changes < 1e-10).all(), f'{(changes >= 1e-10).sum()} of {count} unsolved'
    if name == 'kato_10_1_single':
        assert all(settled(robot, [0.39587582 + e, 0.36640375]) for e in (-4e-4, 0.0, 4e-4))


def test_the_guess_does_not_decide_the_answer():
    robot = replace(two_sections(6, {'gravity': {'linear_density': 0.3}}), gravity=GRAVITY)
    robot = robot.with_effect('straight_tendon', {'fraction': 1.0})
    model, random = Model(robot), np.random.default_rng(9)
    here = model.shape([0.2, 0.9, 0.1, 0.4])
    for _ in range(5):
        guess = here.bend + random.normal(0.0, 0.05, here.bend.shape)
        again = model.shape([0.2, 0.9, 0.1, 0.4], guess=guess)
        assert np.allclose(again.positions, here.positions, rtol=0, atol=1e-10)


@pytest.mark.parametrize('bends_as', ['arc', 'hinge'])
def test_an_arm_in_a_plane_is_that_in_space_without_a_force_across_it(bends_as):
    """Loads in the plane have formulas of their own; a hair of a force asks for those of space."""
    load = {'force_x': 0.02, 'force_z': -0.01}
    effects = {'gravity': {'linear_density': 0.3}, 'tip_load': load}
    robot = replace(planar(6, effects, bends_as), gravity=(6.0, 0.0, -7.0))
    for inputs in ([0.0] * len(robot.inputs), [0.9] + [0.1] * (len(robot.inputs) - 1)):
        flat = Model(robot).shape(inputs)
        spatial_too = robot.with_effect('tip_load', {**load, 'force_y': 1e-13})
        whole = Model(spatial_too).shape(inputs)
        assert np.abs(flat.bend).max() > 1e-3
        assert np.allclose(flat.state, whole.state, rtol=0, atol=1e-10)
