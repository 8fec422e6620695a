"""Lost motion between motor and wire: the play operator on commanded pulls, and its inverse."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from arms import misses, spatial, two_sections
from reference import Reference

from tendon_robot_ros.effects import load_catalogue
from tendon_robot_ros.model.derivatives import path_near
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.model.pulls import command, pull_shapes, transmitted
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.simulation.plant import make_plant

WIDTH, NAN = 1e-3, np.nan
SPRINGS = {'wire_spring': {'compliance': 2e-3}}
PLAY = SPRINGS | {'backlash': {'width': WIDTH}}
HELD = {'bending_hysteresis': {'lag': 0.03, 'presliding': 2.0}}
LAW = load_catalogue()['backlash'].law
ARMS = {'planar': two_sections(4, PLAY), 'spatial': spatial(3, PLAY)}


def commanded(robot, count=8, seed=5):
    """Return wire pulls (count, m) [m] that go up and down, and let one wire slack at times."""
    random = np.random.default_rng(seed)
    pulls = random.uniform(0.0, 4e-3, (count, len(robot.inputs)))
    pulls[count // 2 :: 3, 0] = NAN
    return pulls


def without(robot, effect='backlash'):
    return Model(robot.without_effect(effect))


def test_the_wire_follows_half_a_play_behind_and_rests_while_the_motor_turns_back():
    for pull, before, after in (
        (3.0, 0.0, 2.5),
        (2.5, 2.5, 2.5),
        (2.0, 2.5, 2.5),
        (1.5, 2.5, 2.0),
        (-3.0, 2.0, -2.5),
        (0.4, 0.0, 0.0),
    ):
        assert LAW(pull, before, 1.0) == after
        assert LAW(pull, before, 0.0) == pull
    # going on in one direction in two steps is going there in one
    for pull, before in np.random.default_rng(1).uniform(-2.0, 2.0, (40, 2)):
        assert LAW(pull, LAW(0.5 * (pull + before), before, 1.0), 1.0) == LAW(pull, before, 1.0)


@pytest.mark.parametrize('more', [{}, HELD], ids=['alone', 'with hysteresis'])
@pytest.mark.parametrize('robot', ARMS.values(), ids=ARMS)
def test_an_arm_with_play_is_one_without_under_the_pulls_that_pass(robot, more):
    robot = replace(robot, effects=robot.effects | more)
    model, bare, pulls = Model(robot), without(robot), commanded(robot)
    passed = Reference(robot).passed(pulls)
    assert np.nanmax(np.abs(pulls - passed)) == pytest.approx(0.5 * WIDTH, rel=1e-9)
    expected = pull_shapes(bare, passed, memory=bare.arrays.fresh_memory())
    batch = pull_shapes(model, pulls, memory=model.arrays.fresh_memory())
    assert np.allclose(batch.positions, expected.positions, rtol=0, atol=1e-7)
    taut = (batch.inputs > 1e-3) & np.isfinite(pulls)
    assert np.allclose(batch.pulls[taut], pulls[taut], rtol=0, atol=1e-7), 'as commanded'
    last = None
    for row, place in zip(pulls, batch.positions, strict=True):
        last = model.follow_pulls(last, row)
        assert np.allclose(last.positions, place, rtol=0, atol=1e-6)
    tensions = np.nan_to_num(300.0 * pulls)
    for one, other in ((model.sequence, bare.sequence), (model.shapes, bare.shapes)):
        assert np.array_equal(one(tensions).positions, other(tensions).positions)
    assert np.array_equal(model.shapes(tensions).pulls, bare.shapes(tensions).pulls)


def test_tendons_of_one_motor_have_a_play_each_and_count_by_their_mean():
    robot = two_sections(4, SPRINGS | {'backlash': {'width': (2e-3, 1e-3, 1e-3, 1e-3)}})
    first, second, third, fourth = robot.tendons
    tendons = (replace(first, group='pair'), second, replace(third, group='pair'), fourth)
    model = Model(replace(robot, tendons=tendons))
    shape = model.follow_pulls(None, [3e-3, NAN, -1e-3])
    assert shape.memory[-4:] == pytest.approx([2e-3, 0.0, 2.5e-3, -0.5e-3], abs=1e-15)
    for down in (0.2e-3, 1.1e-3, 4e-3):  # neither, one, both slide: the command finds the mean
        wanted = model.follow_pulls(shape, [3e-3 - down, NAN, 0.0])
        passed = transmitted(model, wanted.pulls[None], shape.memory.copy())
        other = model.shape(wanted.inputs, wanted.state, shape.memory)
        command(model, other, shape.memory)
        again = transmitted(model, other.pulls[None], shape.memory.copy())
        assert again[0, [0, 2]] == pytest.approx(passed[0, [0, 2]], abs=1e-5)


@pytest.mark.parametrize('more', [{}, HELD], ids=['alone', 'with hysteresis'])
@pytest.mark.parametrize('robot', ARMS.values(), ids=ARMS)
def test_derivatives_along_a_path_are_those_of_differences(robot, more):
    robot = replace(robot, effects=robot.effects | more | {'tip_load': {'force_x': 0.01}})
    model, pulls = Model(robot), commanded(robot)

    def solved(near=None):
        start = () if near is None else (near.inputs, near.state)
        return pull_shapes(model, pulls, *start, memory=model.arrays.fresh_memory())

    base = solved()
    path = path_near(model, base.inputs, base.state, True)
    assert np.allclose(path(pulls).positions, base.positions, rtol=0, atol=1e-8)
    moved = [('backlash', 'width', 1e-7), ('pull_zero', 'offset', 1e-7)]
    moved += [('backbone_stiffness', 'relative_change', 1e-4)]
    for error, size in misses(model, moved, lambda: path(pulls), lambda: solved(base)):
        assert error < 2e-3 * size + 1e-9


@pytest.mark.parametrize(('name', 'size'), [('kato_10_1', 0.8), ('spatial_3', 0.6)])
def test_a_target_is_reached_from_any_side(name, size):
    """The command takes up the play, where an inverse without it ends half a play off."""
    robot = load_robot(name)
    robot = robot.with_effect('wire_spring', {'compliance': 2e-3})
    arm, forgets = Model(robot.with_effect('backlash', {'width': WIDTH})), Model(robot)
    low, random = np.full(len(robot.inputs), 0.1), np.random.default_rng(2)
    target = forgets.shape(low + size * random.uniform(0.0, 0.6, len(low))).tip_position
    spread = {}
    for model in (arm, forgets):
        tips = []
        for side in size * random.uniform(0.0, 1.0, (4, len(low))):
            start = arm.follow_pulls(None, forgets.shape(low + side).pulls)
            memory = start.memory if model is arm else None
            guess = start if model is arm else forgets.shape(start.inputs)
            reach = model.reach(target, guess=guess, memory=memory, by_pulls=True)
            assert reach.status == 'reached'
            end = arm.follow_pulls(start, reach.pulls)
            if model is arm:
                assert np.allclose(end.memory[-len(low) :], reach.shape.memory[-len(low) :])
            tips.append(end.tip_position)
        spread[model is arm] = np.ptp(tips, axis=0).max()
    assert 3.0 * spread[True] < spread[False]


@pytest.mark.parametrize('name', ARMS)
def test_hidden_in_a_plant_it_rests_where_the_model_says(name):
    owner = replace(ARMS[name], effects=SPRINGS)
    real = make_plant(owner, {'backlash': {'width': WIDTH}}, scatter=0.0, capstan=False)
    model, tips = Model(ARMS[name]), []
    up, there = np.outer([5e-3, 3e-3], [1.0, NAN] + [0.4] * (len(owner.inputs) - 2))
    for start, by_rows in product((0.4 * there, up), (False, True)):
        real.forget()
        expected = model.follow_pulls(model.follow_pulls(None, start), there)
        if by_rows:
            tip = real.shapes([start, there], sequence=True, displacement=True).tip_position[1]
        else:
            real.respond_to_pulls(start)
            shape = real.respond_to_pulls(there)
            tip = shape.tip_position
            assert shape.pulls[0] == pytest.approx(there[0], abs=1e-6), 'as the motor reads it'
        assert np.allclose(tip, expected.tip_position, rtol=0, atol=1e-5)
        tips.append(tip)
    assert np.linalg.norm(tips[0] - tips[2]) > 1e-3
