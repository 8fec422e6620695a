"""The inverse: what the model can reach is found, within limits, with an honest status."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arms import scaled
from hypothesis import given, settings
from hypothesis import strategies as st

from tendon_robot_ros.common.errors import InputError
from tendon_robot_ros.model.derivatives import tip_slopes
from tendon_robot_ros.model.inverse import reach
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.model.tip_task import COLD, STREAM, TRACK, Patience, Policy, TipTask
from tendon_robot_ros.robot import load_robot

NEAR = Policy()  # from a guess, as `Model.reach` does
ROBOTS = Path(__file__).parent.parent / 'config' / 'robots'


@pytest.fixture(scope='module', params=['kato_10_1', 'spatial_6'])
def model(request):
    return Model(load_robot(ROBOTS / f'{request.param}.yaml'))


def found_from(model, guess, place, policy=NEAR, by_pulls=False, **hears):
    task = replace(TipTask.at(model, place), guess=guess, by_pulls=by_pulls)
    return reach(task, policy, **hears)


def tips(model, count, seed=0):
    """Shapes under random tensions that bend the arm by no more than about a turn."""
    low, high = model.limits.T
    top = np.minimum(high, low + 0.3 * model.library.inputs.max(axis=0))
    random = np.random.default_rng(seed).random((count, len(low)))
    return model.shapes(low + random * (top - low))


def test_tips_of_random_tensions_are_found_to_ten_micrometres_and_a_milliradian(model):
    shapes = tips(model, 40)
    for position, direction in zip(shapes.tip_position, shapes.tip_direction, strict=True):
        found = model.reach(position, direction)
        assert found.status == 'reached'
        assert found.position_error < 1e-5 and found.direction_error < 1e-3


def test_the_shape_of_a_solution_is_the_model_s_own_under_its_tensions(model):
    shapes = tips(model, 3)
    found = model.reach(shapes.tip_position[0])
    again = model.shape(found.tensions)
    assert again.tip_position == pytest.approx(found.shape.tip_position, abs=1e-8)
    assert again.pulls == pytest.approx(found.pulls, abs=1e-9)


@settings(max_examples=30)
@given(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3))
def test_tensions_stay_within_limits_wherever_the_target_is(target):
    model = Model(load_robot(ROBOTS / 'kato_10_1.yaml'))
    found = model.reach(target)
    assert (found.tensions >= model.limits[:, 0]).all()
    assert (found.tensions <= model.limits[:, 1]).all()


def test_a_target_beyond_the_arm_s_length_is_nearest_and_says_how_far(model):
    length = model.robot.length
    found = model.reach([0.0, 0.0, 1.5 * length])
    assert found.status == 'nearest'
    assert found.position_error == pytest.approx(0.5 * length, rel=0.1)


def test_a_target_that_more_tension_would_reach_names_the_input_at_its_limit():
    robot = load_robot(ROBOTS / 'kato_10_1_single.yaml')
    model = Model(robot)
    model.limits[:, 1] = 0.3
    strong = Model(robot).shape([0.6, model.limits[1, 0]])
    found = model.reach(strong.tip_position)
    assert found.status == 'at_limit'
    assert found.at_limit == (model.inputs[0],)


def test_a_warm_start_stays_in_the_branch_it_is_in(model):
    shape = tips(model, 1, seed=3)
    found = model.reach(shape.tip_position[0], shape.tip_direction[0])
    near = model.reach(found.shape.tip_position, found.shape.tip_direction, guess=found.shape)
    assert near.tensions == pytest.approx(found.tensions, abs=1e-2)


@pytest.mark.parametrize(
    ('position', 'direction'), [(None, None), ([0, 0, np.nan], None), (None, [0, 0, 0])]
)
def test_what_is_no_target_is_refused(model, position, direction):
    with pytest.raises(InputError):
        model.reach(position, direction)


def test_a_search_without_a_place_to_start_from_is_refused(model):
    with pytest.raises(InputError, match='starts: expected a whole number from 1 on, got 0'):
        model.reach([0.0, 0.0, 0.1], starts=0)


def test_a_shape_of_another_robot_is_refused_wherever_one_is_taken(model):
    tensions = model.limits[:, 0]
    other = Model(load_robot(ROBOTS / 'kato_10_1_single.yaml')).shape([0.1, 0.2])
    for call in (
        lambda: model.reach([0.0, 0.0, 0.1], guess=other),
        lambda: model.pull_shape(0.0 * tensions, other),
        lambda: model.follow_pulls(other, 0.0 * tensions),
        lambda: model.follow(other, tensions),
        lambda: model.tip_stiffness(other),
    ):
        with pytest.raises(InputError, match=r'(guess|last|shape): expected a Shape of this'):
            call()
    with pytest.raises(InputError, match='guess: expected the bends or the state of 30 cells'):
        model.shape(tensions, other.state)


def test_by_pulls_the_tensions_are_those_that_lengths_hold():
    """What comes back is where an arm goes whose wires have these lengths."""
    model = Model(load_robot(ROBOTS / 'kato_10_1.yaml'))
    random = np.random.default_rng(4)
    for _ in range(6):
        wanted = model.pull_shape(model.shape(random.uniform(0.1, 1.2, 4)).pulls)
        found = model.reach(wanted.tip_position, wanted.tip_direction, by_pulls=True)
        arm = model.pull_shape(found.pulls)
        assert found.status == 'reached'
        assert np.allclose(arm.tip_position, wanted.tip_position, rtol=0.0, atol=1e-4)
        assert np.allclose(arm.inputs, found.tensions, rtol=0.0, atol=1e-3)


@pytest.mark.parametrize('robot', ['kato_10_1', 'kato_1_1', 'spatial_6'])
def test_of_the_ways_to_a_target_one_of_low_tension_is_taken(robot):
    """A straight arm needs next to no tension, though any amount holds it straight."""
    model = Model(load_robot(ROBOTS / f'{robot}.yaml'))
    straight = [0.0, 0.0, 0.95 * model.robot.length]
    much = np.linspace(2.0, 2.5, len(model.inputs))
    squeezed = model.reach(straight, guess=model.shape(much))
    low = model.reach(straight)
    again = found_from(model, squeezed.shape, straight, COLD)
    assert squeezed.status == low.status == again.status == 'reached'
    assert again.tensions.sum() < 0.7 * much.sum()
    assert low.tensions.sum() < 0.7 * much.sum()


def test_the_papers_highest_posture_needs_one_tendon_of_each_section():
    model = Model(load_robot(ROBOTS / 'kato_10_1.yaml'))
    wanted = model.shape([1.6, 0.1, 0.1, 2.0])
    found = model.reach(wanted.tip_position, wanted.tip_direction)
    assert found.tensions == pytest.approx([1.6, 0.1, 0.1, 2.0], abs=1e-3)


def test_a_search_that_is_given_up_returns_the_best_found_so_far():
    model = Model(load_robot(ROBOTS / 'kato_10_1.yaml'))
    far = [0.15, 0.0, 0.25]  # [m] out of reach: every start is tried
    asked = []
    here = model.shape([0.1] * 4)
    found = found_from(model, here, far, give_up=lambda: not asked.append(1))
    assert len(asked) == 3  # after the first start, before the best is improved, and the limits
    assert found.status == 'nearest'
    assert found.position_error < 0.15


@pytest.mark.parametrize('robot', ['kato_10_1', 'spatial_6'])
def test_a_search_ends_between_its_steps_when_its_patience_does(robot):
    model = Model(load_robot(ROBOTS / f'{robot}.yaml'))
    low = model.limits[:, 0]
    here, there = model.shape(low + 0.3), model.shape(low + 0.3 + 0.1 * np.arange(len(low)))
    over = Patience()
    over.end()
    found = found_from(model, here, there.tip_position, give_up=over)
    assert np.array_equal(found.tensions, here.inputs)  # not a step
    assert found.status == 'nearest'
    assert found_from(model, here, there.tip_position, give_up=Patience()).status == 'reached'


def test_what_is_told_on_the_way_comes_nearer_every_time_and_ends_at_what_is_returned(model):
    shapes = tips(model, 12)
    for tensions, target in zip(shapes.inputs[:-1], shapes.tip_position[1:], strict=True):
        told, guess = [], model.shape(tensions)
        found = found_from(model, guess, target, report=told.append)
        away = [np.linalg.norm(shape.tip_position - target)
                for shape in (guess, *(one.shape for one in told))]  # fmt: skip
        assert np.all(np.diff(away) < 0.0)
        assert found.position_error <= away[-1] + 1e-9
        assert found.status == 'reached'
        for step in told:
            same = model.shape(step.tensions, step.shape.state).tip_position
            assert same == pytest.approx(step.shape.tip_position, abs=1e-9)


def test_from_a_far_tip_where_tendons_stick_a_short_step_towards_the_target_is_told():
    model = Model(load_robot(ROBOTS / 'spatial_3.yaml'))
    told, shapes = [], tips(model, 11)
    for tensions, target in zip(shapes.inputs[:-1], shapes.tip_position[1:], strict=True):
        here, steps = model.shape(tensions), []
        found_from(model, here, target, TRACK, report=steps.append)
        away = np.linalg.norm(target - here.tip_position)
        for step in steps:
            moved = step.shape.tip_position - here.tip_position
            assert 0.0 < away - np.linalg.norm(target - step.shape.tip_position) <= 5.01e-3
            assert away < 0.01 or moved @ (target - here.tip_position) > 0.0
        told += steps[:1]
    assert len(told) >= 8


def test_a_search_for_a_far_tip_whose_time_is_over_tells_where_the_arm_may_set_out():
    model = Model(load_robot(ROBOTS / 'spatial_6.yaml'))
    low = model.limits[:, 0]
    tensions = low + np.random.default_rng(4).random((8, len(low))) * (4.0 - low)
    shapes, over = model.shapes(tensions), Patience()
    over.end()
    for here, target in zip(tensions[:-1], shapes.tip_position[1:], strict=True):
        told, guess = [], model.shape(here)
        found = found_from(model, guess, target, give_up=over, report=told.append)
        away = [np.linalg.norm(one.shape.tip_position - target) for one in (told[0], found)]
        assert away[0] < 0.5 * np.linalg.norm(guess.tip_position - target)
        assert away[1] == away[0]
        same = model.shape(told[0].tensions).tip_position
        assert same == pytest.approx(told[0].shape.tip_position, abs=1e-8)  # an equilibrium


def test_a_direction_alone_is_met_by_a_gentle_bend_and_no_curl():
    """The cells turn in one plane and one way: their bends add up to the angle asked for."""
    model = Model(load_robot(ROBOTS / 'spatial_6.yaml'))
    for angle, azimuth in ((0.3, 0.0), (0.9, 2.0), (1.6, 4.5)):
        across = np.sin(angle)
        direction = [across * np.cos(azimuth), across * np.sin(azimuth), np.cos(angle)]
        found = model.reach(direction=direction)
        assert found.status == 'reached'
        assert np.linalg.norm(found.shape.bend, axis=1).sum() < 1.05 * angle


def test_a_target_of_a_stream_is_not_gone_to_by_newtons_of_all_tendons_against_each_other():
    """Three tendons lead the tip hardly along one direction; the arm would be on its way long."""
    arm = Model(load_robot(ROBOTS / 'spatial_3.yaml'))
    here = arm.shape(np.array([0.3, 0.1, 0.12]))
    hardly = np.linalg.svd(tip_slopes(arm, here, here.memory)[0][:3])[0][:, 2]
    hardly *= np.sign(hardly @ here.tip_direction)
    for sign in (-1.0, 1.0):
        place = here.tip_position + sign * 3e-3 * hardly
        full, most = arm.shape(arm.limits[:, 1]), arm.limits[:, 1] - here.inputs
        for policy in (STREAM, COLD):
            found = found_from(arm, here, place, policy)
            assert found.position_error < np.linalg.norm(full.tip_position - place) + 1e-3
            way = np.linalg.norm(found.tensions - here.inputs)
            assert way < 0.25 * np.linalg.norm(most)


def test_a_target_of_a_stream_that_is_near_is_met_as_any_other():
    arm = Model(load_robot(ROBOTS / 'spatial_3.yaml'))
    here = arm.shape(np.array([0.7, 0.3, 0.1]))
    place = arm.shape(np.array([0.75, 0.4, 0.15])).tip_position
    assert found_from(arm, here, place, STREAM).position_error < 1e-5


@pytest.mark.parametrize('name', ['spatial_3', 'kato_10_1'])
@pytest.mark.parametrize('by_pulls', [False, True])
def test_what_is_beyond_reach_is_worth_no_tension_against_tension(name, by_pulls):
    """All tendons at their limit come nearer by hundredths of the error: it is left."""
    arm = Model(load_robot(ROBOTS / f'{name}.yaml'))
    low, high = arm.limits.T
    for share, angle in ((1.2, 0.1), (1.3, 0.3), (1.2, 0.5), (3.0, 0.0)):
        place = share * arm.robot.length * np.array([np.sin(angle), 0.0, np.cos(angle)])
        straight, tense = (arm.shape(low + share * (high - low)) for share in (0.0, 0.5))
        told = []
        there = found_from(arm, straight, place, by_pulls=by_pulls, report=told.append)
        back = arm.reach(place, guess=tense, by_pulls=by_pulls)
        for found in (arm.reach(place, by_pulls=by_pulls), there, back, *told):
            shares = (found.tensions - low) / (high - low)
            assert found.status == 'nearest' and shares.mean() < 0.06
            assert shares.min() < (0.1 if found in told else 0.01)
            full = np.linalg.norm(arm.shape(high).tip_position - place)
            assert found.position_error < 1.15 * full


STREAMS = [  # tensions of a tip, and where from there [1] of the length
    ('spatial_3', (0.72, 0.1, 0.1), (0.37, 0.0, 0.335)),
    ('kato_10_1', (0.85, 1.5, 0.1, 1.49), (0.5, 0.0, 0.04)),
]


@pytest.mark.parametrize(('name', 'tensions', 'out'), STREAMS)
@pytest.mark.parametrize('by_pulls', [False, True])
def test_tensions_of_a_stream_that_goes_out_of_reach_and_back_have_no_jump(
    name, tensions, out, by_pulls
):
    """A step of a tension that is long is short again between targets that are nearer."""
    arm = Model(load_robot(ROBOTS / f'{name}.yaml'))
    low, high = arm.limits.T
    found = arm.reach(arm.shape(tensions).tip_position, by_pulls=by_pulls)
    begin, way = found.shape.tip_position, arm.robot.length * np.array(out)

    def follow(before, share):
        place, last = begin + share * way, before.shape
        made = found_from(arm, last, place, STREAM, by_pulls)
        return made, np.abs((made.tensions - before.tensions) / (high - low)).max()

    line, last, beyond = np.linspace(0.0, 1.0, 25), 0.0, 0
    for share in (*line, *line[::-1]):
        before, (found, step) = found, follow(found, share)
        beyond += found.status != 'reached'
        if step > 0.1 and 'reached' not in (before.status, found.status):
            finer = before
            for between in np.linspace(last, share, 17)[1:]:
                finer, step = follow(finer, between)
                assert step < 0.1, (share, before, found)
        last = share
    assert beyond > 10 and found.status == 'reached'


def test_a_solution_whose_equilibrium_is_not_found_again_is_no_solution():
    """One of the starts ends where friction that sticks has another equilibrium."""
    model = Model(scaled(load_robot(ROBOTS / 'spatial_6.yaml'), 10.0, 1e3))
    found = model.reach([-0.963701677993166, 1.2582409581020078, 0.8407603638192915])
    again = model.shape(found.tensions, guess=found.shape.state)
    assert np.allclose(again.tip_position, found.shape.tip_position, rtol=0, atol=1e-6)
    assert found.status == 'nearest'
    assert found.position_error < 0.02
