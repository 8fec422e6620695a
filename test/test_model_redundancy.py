"""What the freedom of the tensions is used for: stiffness of the tip, distance, keeping out."""

from functools import cache

import numpy as np
import pytest
from arms import planar, spatial, two_sections

from tendon_robot_ros.common.errors import InputError
from tendon_robot_ros.model.derivatives import take_sides, tip_slopes
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.model.redundancy import Balance, broyden
from tendon_robot_ros.model.tip_task import Preferences, TipTask
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.keep_out import KeepOut, Plane, Region, Sphere

FRICTION = {'tendon_friction': {'friction_coefficient': 0.3}}
HELD_N = 3.0  # on every tendon
MEMORY = {**FRICTION, 'friction_memory': {'presliding_length': 2e-4}}


@cache
def arm(kind='planar', remembers=False):
    made = {'planar': two_sections, 'spatial': spatial}[kind](6)
    return Model(added(made, MEMORY if remembers else FRICTION))


def added(robot, effects):
    for name, values in effects.items():
        robot = robot.with_effect(name, values)
    return robot


def test_the_straight_arm_gives_way_as_a_chain_of_hinges():
    robot = planar(cells=6, bends_as='hinge')
    model = Model(robot)
    levers = robot.length - 0.007 * (np.arange(6) + 0.5)
    softness = np.sum(levers**2 / 0.027)
    made = model.tip_stiffness(model.shape([0.0, 0.0]))
    assert made.compliance == pytest.approx(
        np.diag([softness, softness, 0.0]), abs=1e-6 * softness
    )
    assert made.along([0.0, 5.0, 0.0]) == pytest.approx(1.0 / softness, rel=1e-6)
    assert made.softest[0] == pytest.approx(1.0 / softness, rel=1e-6)


@pytest.mark.parametrize('name', ['spatial_3', 'spatial_6'])
def test_tendons_that_pull_against_each_other_soften_a_straight_arm_of_hinges(name):
    # between two guides a tendon is l cos(angle / 2) long: a cell holds k - l T / 4 per radian
    robot, compliance, arc = load_robot(name), 0.0, 0.0
    sections = [section.name for section in robot.sections]
    for i, section in enumerate(robot.sections):
        passing = sum(sections.index(tendon.section) >= i for tendon in robot.tendons)
        for _ in range(section.cells):
            lever = robot.length - arc - 0.5 * section.cell_length
            k = section.bending_stiffness[0] - 0.25 * section.cell_length * passing * HELD_N
            compliance, arc = compliance + lever**2 / k, arc + section.cell_length
    model = Model(robot)
    shape = model.shape(np.full(len(model.inputs), HELD_N))
    for along in ([1, 0, 0], [0, 1, 0], [1, -2, 0]):
        made = model.tip_stiffness(shape).along(along)
        assert made == pytest.approx(1.0 / compliance, rel=1e-5)
    slack = model.tip_stiffness(model.shape(np.full(len(model.inputs), 0.1)))
    assert 1.0 / compliance < 0.7 * slack.along([1, 0, 0])


def test_held_wires_stiffen_in_their_plane_alone():
    model = Model(planar(cells=6))
    shape = model.shape([0.4, 0.2])
    free, held = model.tip_stiffness(shape), model.tip_stiffness(shape, wires_held=True)
    assert held.along([1, 0, 0]) > 1.5 * free.along([1, 0, 0])
    assert held.along([0, 1, 0]) == pytest.approx(free.along([0, 1, 0]), rel=1e-6)


def test_a_force_moves_the_tip_as_the_compliance_says():
    model = arm('spatial')
    tensions, force = np.array([1.0, 0.2, 0.1, 0.3, 0.8, 0.2]), 1e-6
    shape = model.shape(tensions)
    sides = [
        Model(model.robot.with_effect('tip_load', {'force_x': side})).shape(tensions).tip_position
        for side in (force, -force)
    ]
    moved = (sides[0] - sides[1]) / (2.0 * force)
    compliance = model.tip_stiffness(shape).compliance
    assert compliance[:, 0] == pytest.approx(moved, abs=5e-3 * np.abs(moved).max())


def test_a_direction_of_no_length_is_refused():
    made = arm().tip_stiffness(arm().shape([0.5, 0.1, 0.1, 0.5]))
    with pytest.raises(InputError, match='not all 0'):
        made.along([0.0, 0.0, 0.0])


@pytest.mark.parametrize('remembers', [False, True])
@pytest.mark.parametrize('kind', ['planar', 'spatial'])
def test_tensions_for_a_target_begin_where_friction_is_now(kind, remembers):
    model, random = arm(kind, remembers), np.random.default_rng(5)
    low, high = model.limits.T
    here, missed = model.shape(low), []
    for _ in range(4):
        wanted = model.shape(low + 0.3 * random.random(len(low)) * (high - low)).tip_position
        found = model.reach(wanted, guess=here, memory=here.memory)
        missed.append(model.follow(here, model.reach(wanted, guess=here).tensions).tip_position)
        missed[-1] = np.linalg.norm(missed[-1] - wanted)
        here = model.follow(here, found.tensions)
        assert np.linalg.norm(here.tip_position - wanted) < 1e-4
        assert np.all((found.tensions >= low) & (found.tensions <= high))
    assert (max(missed) > 1e-3) == remembers  # without its memory the inverse misses


def test_low_tension_goes_to_the_lowest_that_hold_the_tip():
    model = arm()
    there = model.shape([1.4, 0.8, 0.9, 1.1])
    found = model.reach(there.tip_position, guess=there, preferences=Preferences(low_tension=1.0))
    assert found.status == 'reached'
    assert found.tensions.sum() < 0.6 * there.inputs.sum()
    assert np.sum(found.tensions < 1e-6) >= 2  # as many as the plane leaves free


def test_where_it_is_asked_no_tendon_is_near_slack_or_its_limit():
    model = arm('spatial')
    there = model.shape([1.0, 0.1, 0.1, 0.1, 0.1, 0.8])
    wants = Preferences(low_tension=0.0, slack=1.0, limit=1.0, margin=0.1)
    found = model.reach(there.tip_position, guess=there, preferences=wants)
    assert found.status == 'reached'
    assert there.inputs.min() < 0.2 < 0.49 < found.tensions.min()
    assert found.tensions.max() < 4.51


@pytest.mark.parametrize(
    ('low_tension', 'enough', 'times'), [(0.0, 0.0, (2.0, np.inf)), (0.1, 2.0, (1.99, 2.1))]
)
def test_the_tip_stiffens_twice_and_stays_and_where_that_is_enough_no_more(
    low_tension, enough, times
):
    model, along = arm(remembers=True), (1.0, 0.0, 0.0)
    there = model.shape([0.9, 0.2, 0.2, 0.6])
    before = model.tip_stiffness(there).along(along)
    wants = Preferences(low_tension, 0.1, along, stiffness_enough=enough * before)
    found = model.reach(there.tip_position, guess=there, memory=there.memory, preferences=wants)
    assert times[0] < model.tip_stiffness(found.shape).along(along) / before < times[1]
    assert before > 0.0 and found.position_error < 2e-5


def test_a_wall_at_the_target_keeps_the_tip_at_its_distance():
    model = arm('spatial')
    tip = model.shape([2.0, 0.1, 0.1, 0.1, 0.1, 2.0]).tip_position
    room = KeepOut((Region('lamp', Sphere(tuple(tip), 0.006), margin=0.002),))
    found = model.reach(tip, keep_out=room)
    assert (found.status, found.region) == ('nearest', 'lamp')
    assert found.position_error == pytest.approx(0.008, abs=2e-4)
    assert room.clearance(found.shape.positions).distance > -1e-4
    assert 'kept out of lamp' in repr(found)


def test_freedom_is_used_to_bend_around_a_region():
    model = arm('spatial')
    there = model.shape([2.5, 0.1, 0.1, 0.1, 0.1, 2.5])
    direct = model.reach(there.tip_position)
    middle = direct.shape.positions[5]
    room = KeepOut((Region('post', Sphere(tuple(middle + [0.004, 0.0, 0.004]), 0.006)),))
    assert room.clearance(direct.shape.positions).distance < 0.0
    found = model.reach(there.tip_position, keep_out=room)
    assert room.clearance(found.shape.positions).distance > -1e-4
    assert found.status == 'reached' or found.region == 'post'


def test_a_far_wall_changes_nothing():
    model = arm()
    tip = model.shape([0.9, 0.2, 0.2, 0.6]).tip_position
    room = KeepOut((Region('floor', Plane((0.0, 0.0, -1.0), (0.0, 0.0, 1.0))),))
    wants = Preferences()
    free, kept = (model.reach(tip, preferences=wants, keep_out=k) for k in (None, room))
    assert kept.tensions == pytest.approx(free.tensions, abs=1e-9)
    assert kept.region == ''


def stood(model, count, seed=5):
    """Yield shapes that an arm comes to on a random way, one from another."""
    random, here = np.random.default_rng(seed), None
    low, high = model.limits.T
    for _ in range(count):
        here = model.follow(here, low + 0.3 * random.random(len(low)) * (high - low))
        yield here


@pytest.mark.parametrize('kind', ['planar', 'spatial'])
def test_slopes_on_the_side_to_which_eyelets_slide_are_those_of_the_way_there(kind):
    model, random = arm(kind, remembers=True), np.random.default_rng(2)
    for here in stood(model, 6):
        move = random.normal(size=len(here.inputs)) * 1e-5
        slopes, ways = tip_slopes(model, here, here.memory)
        past = here.memory.copy()
        assert take_sides(model, here, past, move @ ways) > 0
        for _ in range(9):  # which way they slide follows from the slopes, too
            sided, ways = tip_slopes(model, here, past)
            if not take_sides(model, here, past, move @ ways):
                break
        moved = model.follow(here, here.inputs + move).tip_position - here.tip_position
        size = np.linalg.norm(moved)
        assert np.linalg.norm(sided[:3] @ move - moved) < 0.02 * size
        assert np.linalg.norm(slopes[:3] @ move - moved) > 0.05 * size  # the mean of both sides


def test_eyelets_that_have_slid_take_no_side():
    model = arm('spatial', remembers=True)
    begin = model.shape(np.full(6, 1.0))
    here = model.follow(begin, begin.inputs + np.linspace(0.5, 2.0, 6))
    past, ways = begin.memory.copy(), tip_slopes(model, here, begin.memory)[1]
    assert take_sides(model, here, past, np.full(6, -1e-3) @ ways) == 0
    assert np.array_equal(past, begin.memory)


@pytest.mark.parametrize(('kind', 'most'), [('planar', (8e-5, 3e-4)), ('spatial', (6e-5, 1e-4))])
def test_a_step_of_the_program_leaves_the_tip_where_friction_remembers(kind, most):
    model, off = arm(kind, remembers=True), []
    wants = Preferences(low_tension=0.0, slack=1.0, margin=0.3)
    for here in stood(model, 24):
        balance = Balance(TipTask.at(model, here.tip_position, memory=here.memory), wants)
        there = model.follow(here, balance.step(balance.begin(here), 0.02))
        assert np.abs(there.inputs - here.inputs).max() > 0.05
        off.append(np.linalg.norm(there.tip_position - here.tip_position))
    assert np.median(off) < most[0]
    assert np.quantile(off, 0.9) < most[1]


def test_corrected_slopes_say_what_the_step_did_and_else_what_they_said():
    random = np.random.default_rng(1)
    slopes, step, change = random.normal(size=(6, 4)), random.normal(size=4), random.normal(size=6)
    made = broyden(slopes, step, change)
    assert made @ step == pytest.approx(change)
    across = np.linalg.svd(step[None])[2][1:]
    assert made @ across.T == pytest.approx(slopes @ across.T)


@pytest.mark.parametrize(
    'wrong', [{'slack': -1.0}, {'stiffness': np.nan}, {'margin': 0.0}, {'stiffness_enough': -1.0}]
)
def test_a_weight_that_makes_no_sense_is_refused(wrong):
    with pytest.raises(InputError, match='expected'):
        Preferences(**wrong)
