"""Trajectories of tensions and of wire pulls, played by the controller without ROS."""

import numpy as np
import pytest
from control_rig import CYCLE, Rig, model, reachable, standing

from tendon_robot_ros.control import Refusal
from tendon_robot_ros.control.inputs import Trajectory
from tendon_robot_ros.control.status import controller_values
from tendon_robot_ros.model.model import Model

LIMITS = np.array([[0.1, 5.0]] * 4)
NAMES = ('prox_left', 'prox_right', 'dist_left', 'dist_right')
END = [1.1, 0.1, 0.1, 0.6]


def trajectory(times, *values, limits=LIMITS):
    return Trajectory.checked(np.array(times, float), np.array(values, float), limits, NAMES)


def test_tensions_follow_the_straight_lines_in_time_and_the_end_is_held():
    rig = standing(rate_limit=10.0)
    rig.core.play(rig.now, trajectory([1.0], END))
    rig.run(0.5)
    assert rig.tensions == pytest.approx([0.6, 0.1, 0.1, 0.35], abs=1e-9)
    assert rig.code() == 'playing'
    said = controller_values(rig.core, rig.now)
    assert (said['trajectory_time (s)'], said['trajectory_duration (s)']) == ('0.500', '1.000')
    rig.run(1.0)
    assert rig.tensions == pytest.approx(END)
    assert rig.code() == 'played'
    steps = np.abs(np.diff([output.tensions for output in rig.outputs], axis=0))
    assert steps.max() == pytest.approx(1.0 * CYCLE)


def test_a_trajectory_that_is_too_fast_arrives_late_at_the_rate_limit():
    rig = standing(rate_limit=0.5)
    rig.core.play(rig.now, trajectory([0.0, 0.1], END, END))
    rig.run(1.0)
    assert rig.code() == 'playing'
    rig.run(1.1)
    assert rig.tensions == pytest.approx(END)
    steps = np.abs(np.diff([output.tensions for output in rig.outputs], axis=0))
    assert steps.max() == pytest.approx(0.5 * CYCLE)


def test_a_target_ends_a_trajectory_and_a_trajectory_ends_a_target():
    rig = standing(rate_limit=10.0)
    rig.core.play(rig.now, trajectory([5.0], END))
    rig.run(0.5)
    rig.core.aim(reachable())
    rig.run(1.0)
    assert rig.code() == 'reached'
    rig.core.play(rig.now, trajectory([1.0], END))
    rig.run(1.2)
    assert rig.tensions == pytest.approx(END)
    rig.core.play(rig.now, None)
    rig.run(0.1)
    assert rig.code() == 'holding'


@pytest.mark.parametrize(
    ('code', 'times', 'values'),
    [
        ('times', [1.0, 1.0], [END, END]),
        ('times', [-1.0], [END]),
        ('not_finite', [1.0], [[np.nan, 0.1, 0.1, 0.1]]),
        ('not_finite', [np.inf], [END]),
        ('limits', [1.0], [[0.1, 0.1, 5.1, 0.1]]),
        ('limits', [1.0], [[0.1, 0.0, 0.1, 0.1]]),
    ],
)
def test_what_cannot_be_played_is_refused_as_a_whole(code, times, values):
    with pytest.raises(Refusal) as refused:
        trajectory(times, *values)
    assert refused.value.code == code


def test_the_refusal_names_point_tendon_and_limits():
    with pytest.raises(Refusal) as refused:
        trajectory([1.0, 2.0], END, [0.1, 0.1, 0.1, 7.0])
    assert str(refused.value) == (
        'tendon_trajectory: point 2: dist_right: expected 0.1 to 5 N, got 7; '
        'nothing of it was played'
    )


def test_a_stop_and_a_lost_driver_end_a_trajectory():
    for event in ('stop', 'lost'):
        rig = standing(rate_limit=10.0)
        rig.core.play(rig.now, trajectory([2.0], END))
        rig.run(0.5)
        if event == 'stop':
            rig.core.latch.stop('test', 'a test')
            assert rig.run(0.1) is None
            continue
        rig.alive = False
        rig.run(1.0)
        measured = rig.tensions.copy()
        assert rig.outputs[-1].tensions[0] < 0.9
        rig.alive = True
        rig.run(1.0)
        assert rig.code() == 'holding'
        assert rig.outputs[-1].tensions == pytest.approx(measured)


def test_the_prediction_of_an_arm_with_friction_follows_played_wire_pulls():
    robot = model().robot.with_effect('friction_memory', {'presliding_length': 5e-4})
    arm, rig, shapes = Model(robot), Rig(pull_mode=True), []
    rig.core.set_model(arm)
    start = arm.shape(rig.tensions)
    goal = arm.follow(start, END).pulls
    for now in np.arange(CYCLE, 2.0, CYCLE):
        played = rig.core.commanded
        nothing = np.full(4, np.nan)  # of the tensions is measured
        rig.core.measured(now, nothing, start.pulls if played is None else played)
        rig.core.step(now)
        if round(now / CYCLE) == 40:
            rig.core.play(now, trajectory([1.0], goal, limits=None))
        if round(now / CYCLE) % 6 == 0:
            rig.core.predict(now, shapes.append)
    there = arm.follow_pulls(start, goal).tip_position
    assert shapes[-1].tip_position == pytest.approx(there, abs=2e-3)
    assert shapes[0].tip_position == pytest.approx([0.0, 0.0, 0.208], abs=2e-3)


def test_wire_pulls_are_commanded_as_they_were_given():
    goal = model().shape(np.array(END)).pulls
    rig = standing(pull_mode=True)
    rig.core.play(rig.now, trajectory([1.0], goal, limits=None))
    rig.run(0.5)
    half = rig.outputs[-1].pulls
    rig.run(1.0)
    assert rig.outputs[-1].pulls == pytest.approx(goal)
    start = rig.outputs[10].pulls
    assert half == pytest.approx(0.5 * (start + goal), abs=1e-4)
    assert rig.code() == 'played'
    held = model().pull_shape(goal).inputs  # loose wires are slack, whatever END was
    assert rig.core.command == pytest.approx(held, abs=1e-3)
