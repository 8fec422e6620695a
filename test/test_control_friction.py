"""Friction that remembers in the controller, ways on which it ends well, regions, preferences."""

import re

import numpy as np
import pytest
from friction_rig import MORE_SIDES, SIDES, TARGETS, from_sides, model, standing
from marks import slow

from tendon_robot_ros.common.errors import NoEquilibriumError
from tendon_robot_ros.control import ControllerCore, Settings, Target, target_search
from tendon_robot_ros.control.inputs import Trajectory
from tendon_robot_ros.control.state import ActingTensions
from tendon_robot_ros.control.status import controller_status, controller_values
from tendon_robot_ros.control.target_search import forgetting_tensions
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.model.tip_task import Preferences
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.robot.keep_out import KeepOut, Region, Sphere

STALLS = SIDES[4]


def missed(order=TARGETS, **settings):
    rig = standing(**settings)
    return max(rig.go(tensions) for tensions in order)


def test_the_tip_is_where_it_should_be_after_loading_and_unloading():
    without = missed(known=False)
    assert without > 2e-3
    assert missed() < 0.05 * without
    assert missed(noise=0.005) < 0.3 * without


def test_also_where_wire_lengths_are_commanded():
    order = TARGETS[:3]  # the fourth takes tensions that no lengths hold
    assert missed(order, pull=True) < 0.01 * missed(order, known=False)


@pytest.mark.long
@pytest.mark.parametrize(
    ('arm', 'memory', 'wires', 'pull', 'built', 'seed', 'count'),
    [
        *((*case, 2, 1) for case in SIDES if case != STALLS),
        (*STALLS, 5, 2),  # by a posture where a search stalls at a kink
        *(slow(*case, 2, 2) for case in (STALLS, *MORE_SIDES)),
    ],
)
def test_a_target_is_the_same_place_from_every_side(arm, memory, wires, pull, built, seed, count):
    spread, off = from_sides(arm, memory, wires, pull, built, seed, count)
    assert 3.0 * max(spread[True]) < max(spread[False])
    assert 3.0 * np.mean(spread[True]) < np.mean(spread[False])
    assert np.mean(off[True]) < np.mean(off[False])


def test_a_stream_of_targets_asks_for_no_newtons_where_three_tendons_hardly_lead_the_tip():
    robot = load_robot('spatial_3')
    way = np.array([(0.3, 0.1 + 0.01 * k, 0.1) for k in range(20)])
    places = Model(robot).shapes(way).tip_position
    arm = Model(robot.with_effect('friction_memory', {'presliding_length': 2e-4}))
    core, here = ControllerCore(arm, Settings()), arm.shape(np.full(3, 0.1))
    for step in range(60):
        core.measured(0.02 * step, here.inputs, here.pulls)
        if step in (1, *range(40, 60)):
            core.aim(Target(places[max(step - 40, 0)]))
        output = core.step(0.02 * step)
        here = here if output is None else arm.follow(here, output.tensions)
        core.predict(0.02 * step, lambda shape: None)
        assert here.inputs.max() < 0.5
    assert np.linalg.norm(here.tip_position - places[-1]) < 2e-3


def test_a_target_of_a_stream_that_has_no_equilibrium_nearby_is_looked_for_everywhere(monkeypatch):
    rig, asked, reach = standing(), [], target_search.reach

    def near_is_none(task, policy, *hears):
        asked.append(policy.starts == 0)
        if policy.starts == 0:
            raise NoEquilibriumError('nearby', (), np.inf)
        return reach(task, policy, *hears)

    rig.go(TARGETS[0])
    monkeypatch.setattr(target_search, 'reach', near_is_none)
    for share in (0.0, 0.01):
        tensions = np.array(TARGETS[0]) + share
        rig.core.aim(Target(model(False).shape(tensions).tip_position))
        rig.run(0.02)
    # the first target everywhere, near that, and everywhere; the second nearby, and everywhere
    assert asked == [False, True, False, True, False]
    assert 'target' not in rig.core.refusals


def test_from_below_ends_at_the_same_place():
    assert missed(TARGETS[:2], approach='from_below') < 2e-4


def test_from_below_the_last_leg_pulls_every_tendon_from_its_lowest():
    rig = standing(known=False, approach='from_below')
    target = Target(model(False).shape(np.array(TARGETS[0])).tip_position)
    rig.core.aim(target)
    rig.run(0.01)
    assert len(rig.core.mode.via) == 2 and rig.core.moving
    assert rig.core.mode.via[1] == pytest.approx(model().limits[:, 0])
    assert np.all(rig.core.mode.via[1] <= rig.core.solution.tensions)
    rig.run(1.0)
    assert not rig.core.mode.via and not rig.core.moving
    assert rig.core.command == pytest.approx(rig.core.solution.tensions)


@pytest.mark.parametrize('name', ['kato_10_1', 'spatial_3'])
def test_from_below_friction_forgets_the_way_though_nobody_knows_its_law(name):
    known = Model(load_robot(name))
    arm = Model(known.robot.with_effect('friction_memory', {'presliding_length': 3e-4}))
    low, high = known.limits.T
    goals = low + 0.12 * (high - low) * np.random.default_rng(4).random((5, len(low)))
    away = []
    for ways in ((), forgetting_tensions(known)):
        ends = [went(arm, low, (before, *ways, goals[0])) for before in goals[1:]]
        away.append(np.std(ends, axis=0).max())
    assert away[0] > 1e-3 and away[1] < 0.1 * away[0]


def went(arm, begin, ways):
    """Return where the tip is after a way in small steps."""
    shape = arm.shape(begin)
    for tensions in ways:
        for step in np.linspace(shape.inputs, tensions, 21)[1:]:
            shape = arm.follow(shape, step)
    return shape.tip_position


def test_noise_does_not_move_the_tensions_that_act():
    acting, random = ActingTensions(), np.random.default_rng(2)
    command, highest = np.full(4, 1.0), np.full(4, 5.0)
    for _ in range(200):
        first = acting.take(command, command + 0.01 * random.normal(size=4), highest)
    seen = [
        acting.take(command, command + 0.01 * random.normal(size=4), highest) for _ in range(50)
    ]
    assert np.std(seen, axis=0).max() < 0.2 * 0.01
    assert first == pytest.approx(command, abs=0.03)
    stuck = np.array([0.5, 1.0, 1.0, 1.0])
    assert acting.take(command, stuck, highest)[0] == pytest.approx(0.5, abs=0.06)


def test_without_measured_tensions_the_correction_stays():
    acting, command, highest = ActingTensions(), np.full(4, 1.0), np.full(4, 5.0)
    for _ in range(100):
        made = acting.take(command, command - 0.1, highest)
    assert made == pytest.approx(command - 0.1, abs=0.01)
    assert acting.take(command + 0.5, None, highest) == pytest.approx(made + 0.5)


def test_a_region_at_the_target_is_named_and_the_arm_stays_out():
    tip = model(False).shape(np.array(TARGETS[0])).tip_position
    room = KeepOut((Region('lamp', Sphere(tuple(tip), 0.01)),))
    rig = standing(remembers=False, keep_out=room)
    rig.go(TARGETS[0])
    assert rig.code() == 'nearest'
    status = controller_status(rig.core, rig.now)
    assert 'kept out of lamp' in status.message
    assert controller_values(rig.core, rig.now)['kept_out_of'] == 'lamp'
    assert room.clearance(rig.shape.positions).distance > -2e-4


def test_a_way_through_a_region_ends_before_it_and_names_it():
    rig = standing(remembers=False)
    found = []
    for tensions in TARGETS[:2] + TARGETS[:1]:
        rig.go(tensions)
        found.append(rig.core.solution.shape)
    half = model(False).shape(0.5 * (found[1].inputs + found[2].inputs)).tip_position
    assert min(np.linalg.norm(half - shape.tip_position) for shape in found) > 0.02
    room = KeepOut((Region('post', Sphere(tuple(half), 0.008)),))
    rig.core.settings = Settings(keep_out=room)
    rig.go(TARGETS[1])
    assert rig.code() == 'nearest' and rig.core.solution.region == 'post'
    assert room.clearance(rig.shape.positions).distance > -2e-4
    assert rig.core.solution.position_error == pytest.approx(
        np.linalg.norm(rig.shape.tip_position - rig.core.target.position), abs=1e-6
    )


@pytest.mark.parametrize('pull', [False, True])
def test_a_played_trajectory_that_would_enter_is_refused_with_its_time(pull):
    arm = model(False)
    ends = [arm.shape(np.array(tensions)) for tensions in ((0.5, 0.1, 0.1, 0.1), TARGETS[1])]
    room = KeepOut((Region('post', Sphere(tuple(ends[1].tip_position), 0.01)),))
    rig = standing(remembers=False, pull=pull, keep_out=room)
    values = np.array([end.pulls if pull else end.inputs for end in ends])
    rig.core.play(rig.now, Trajectory(np.array([1.0, 2.0]), values))
    assert rig.code() == 'refused_keep_out' and rig.core.playing is None
    said = str(rig.core.refusals.pop('target'))
    time = float(re.search(r'at (.*?) s the arm would enter post', said)[1])
    touches = [
        room.clearance((arm.pull_shape(at) if pull else arm.shape(at)).positions).distance < 0.0
        for at in values[0] + np.linspace(0.0, 1.0, 101)[:, None] * (values[1] - values[0])
    ]
    assert time == pytest.approx(1.0 + 0.01 * touches.index(True), abs=0.05)
    rig.core.play(rig.now, Trajectory(np.array([0.5]), values[:1]))
    rig.run(0.7)
    assert rig.code() == 'played'


def test_weights_changed_while_standing_move_tensions_and_not_the_tip():
    rig = standing(remembers=False)
    rig.go(TARGETS[0])
    tip, tensions, away = rig.shape.tip_position, rig.shape.inputs, []
    rig.core.settings = Settings(preferences=Preferences(low_tension=0.0, slack=1.0))
    for _ in range(60):
        rig.run(0.02)
        away.append(np.linalg.norm(rig.shape.tip_position - tip))
    assert tensions.min() < 0.2 and rig.shape.inputs.min() > 0.5
    assert max(away) < 2e-4
    assert float(controller_values(rig.core, rig.now)['tip_stiffness_x (N/m)']) > 0.0
    assert rig.go(TARGETS[1]) < 1e-4  # with other targets, too
    assert rig.shape.inputs.min() > 0.3


def test_the_tip_stiffens_twice_while_it_stands_and_is_kept():
    rig = standing(remembers=False)
    rig.go(TARGETS[2])
    tip, away = rig.shape.tip_position, []
    before = model(False).tip_stiffness(rig.shape).along([1, 0, 0])
    wants = Preferences(low_tension=0.1, stiffness=0.1, stiffness_direction=(1.0, 0.0, 0.0))
    rig.core.settings = Settings(preferences=wants)
    for _ in range(100):
        rig.run(0.02)
        away.append(np.linalg.norm(rig.shape.tip_position - tip))
    assert model(False).tip_stiffness(rig.shape).along([1, 0, 0]) > 2.0 * before > 0.0
    assert max(away) < 2e-4
