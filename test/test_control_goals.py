"""Goals of actions, without ROS: steps, progress, outcome, cancel."""

from dataclasses import replace

import numpy as np
import pytest
from control_rig import CYCLE, Rig, reachable

from tendon_robot_ros.control import Refusal, Target
from tendon_robot_ros.control.inputs import Trajectory
from tendon_robot_ros.control.status import MotionGoal, Tolerance, followed

END = np.array([1.1, 0.1, 0.1, 0.6])
NEAR, FAR = (0.5, 0.1, 0.1, 0.9), (0.1, 1.0, 0.8, 0.1)


def targets(*tensions):
    return [replace(reachable(one), stamp=f'goal/{i}') for i, one in enumerate(tensions)]


def trajectory(seconds=1.0):
    return Trajectory(np.array([seconds]), END[None], stamp='goal/0')


def pursue(rig, goal, seconds=5.0, before=None):
    """Run until the goal ends; return how."""
    ends = []

    def look(rig):
        if not ends and (outcome := goal.update(rig.core, rig.now)) is not None:
            ends.append(outcome)
        if before is not None:
            before(rig)

    rig.run(0.1)
    goal.begin(rig.core, rig.now)
    rig.run(seconds, look)
    return ends[0] if ends else None


def test_poses_are_reached_one_after_the_other():
    rig, goal, reached = Rig(rate_limit=2.0), MotionGoal(targets(NEAR, FAR, NEAR)), []

    def look(rig):
        if not reached or reached[-1][0] != goal.reached:
            reached.append((goal.reached, rig.tensions))

    assert pursue(rig, goal, before=look).code == ''
    assert [step for step, _ in reached] == [0, 1, 2]
    where = [step.position for step in goal.steps]
    for (_, tensions), place in zip(reached[1:], where, strict=False):
        assert rig.core.model.shape(tensions).tip_position == pytest.approx(place, abs=1e-4)


def test_with_a_tracker_too_a_pose_is_reached_before_the_next_is_asked_for():
    rig, steps = Rig(tip_gain=2.0), [replace(one, direction=None) for one in targets(NEAR, FAR)]
    goal, shift = MotionGoal(steps), np.array([0.003, 0.0, 0.001])  # [m] of the arm from its model

    def tip():
        return rig.core.model.shape(rig.tensions).tip_position + shift

    def look(rig):
        if round(rig.now / CYCLE) % 6 == 0:
            rig.core.tip_measured(rig.now, tip())

    rig.run(0.1, look)
    goal.begin(rig.core, rig.now)
    for step in steps:
        before, outcome = goal.reached, None
        while goal.reached == before and outcome is None and rig.now < 20.0:
            rig.run(CYCLE, look)
            outcome = goal.update(rig.core, rig.now)
        assert tip() == pytest.approx(step.position, abs=3e-4)
    assert outcome.code == ''


def test_a_pose_that_is_not_reached_ends_the_goal_and_says_which():
    rig = Rig()
    far = Target(np.array([0.0, 0.0, 0.29]), stamp='goal/far')
    outcome = pursue(rig, MotionGoal([targets(NEAR)[0], far, targets(FAR)[0]]))
    assert outcome.code in ('nearest', 'at_limit')
    assert outcome.message.startswith('pose 2 of 3: as near as it can, 82')


def test_progress_tells_distance_and_time_that_are_left():
    rig, goal, told = Rig(rate_limit=1.0), MotionGoal(targets(NEAR)), []
    pursue(rig, goal, 0.6, lambda rig: told.append(goal.progress(rig.core, rig.now)))
    rig.core.predict(rig.now, lambda shape: told.append(goal.progress(rig.core, rig.now)))
    assert told[-1].passed == pytest.approx(0.6)
    assert 0.0 < told[-1].remaining < 0.8
    assert told[-1].steps_remaining == 1
    way = np.linalg.norm(goal.step.position - [0.0, 0.0, 0.208])
    assert 0.1 * way < told[-1].distance < 0.9 * way


def test_a_trajectory_tells_where_the_tendons_are_and_when_cancelled_holds_them_there():
    rig, goal = Rig(rate_limit=10.0), MotionGoal([trajectory()])
    pursue(rig, goal, 0.5)
    progress = goal.progress(rig.core, rig.now)
    assert progress.desired == pytest.approx([0.6, 0.1, 0.1, 0.35], abs=1e-9)
    assert progress.actual == pytest.approx(progress.desired, abs=0.01)
    assert progress.remaining == pytest.approx(0.5)
    goal.cancel(rig.core, rig.now)
    held = rig.tensions
    rig.run(1.0)
    assert held == pytest.approx(progress.desired, abs=0.01)
    assert rig.tensions == pytest.approx(held)
    assert rig.code() == 'holding'


def test_a_goal_is_cancelled_before_the_driver_is_heard_and_in_the_cycle_of_a_stop():
    rig, goal = Rig(resume=True, rate_limit=0.5), MotionGoal(targets(NEAR))
    rig.alive = False
    assert pursue(rig, goal, 0.2) is None  # it waits for the driver
    goal.cancel(rig.core, rig.now)
    rig.alive = True
    rig.run(1.0)
    assert rig.code() == 'holding'
    assert pursue(rig, goal, 0.2) is None
    rig.core.latch.stop('stop', 'stop was called')  # by another thread
    goal.cancel(rig.core, rig.now)
    rig.run(0.1)
    assert rig.code() == 'stopped'


def test_a_goal_that_waits_for_a_released_driver_is_not_reached_by_the_target_before():
    rig, goal = Rig(resume=True), MotionGoal(targets(NEAR))
    rig.run(0.1)
    rig.core.driver_reports('', '', 0)
    rig.core.aim(reachable((0.1, 0.1, 0.1, 0.1)))
    rig.run(1.0)
    rig.core.driver_reports('', 'no command', 1)
    assert pursue(rig, goal, 0.2) is None
    rig.core.resumed()
    rig.run(1.0)
    assert goal.update(rig.core, rig.now).code == ''
    assert rig.tensions == pytest.approx(NEAR, abs=1e-3)


def stop(core, now):
    core.latch.stop('stop', 'stop was called')
    core.step(now)


@pytest.mark.parametrize(
    ('intrude', 'code', 'says'),
    [
        (lambda core, now: core.aim(reachable()), 'ended', 'a newer target'),
        (lambda core, now: core.play(now, None), 'ended', 'a newer target'),
        (stop, 'ended', 'stop was called'),
        (lambda core, now: core.driver_reports('cable torn'), 'ended', 'cable torn'),
    ],
)
@pytest.mark.parametrize('steps', [targets(NEAR, FAR), [trajectory(1.5)]])
def test_what_takes_the_place_of_a_goal_ends_it_and_is_not_cancelled_with_it(
    intrude, code, says, steps
):
    rig, goal = Rig(rate_limit=0.5), MotionGoal(steps)
    assert pursue(rig, goal, 0.2) is None
    intrude(rig.core, rig.now)
    outcome, before = goal.update(rig.core, rig.now), followed(rig.core)
    assert outcome.code == code
    assert says in outcome.message
    goal.cancel(rig.core, rig.now)
    assert followed(rig.core) == before


def test_a_goal_that_is_refused_leaves_the_one_before():
    rig, goal = Rig(), MotionGoal([trajectory()])
    with pytest.raises(Refusal, match='no tendon states'):
        goal.begin(rig.core, 0.0)
    rig.run(0.1)
    goal.begin(rig.core, rig.now)
    assert followed(rig.core) == 'goal/0'


@pytest.mark.parametrize(
    ('path', 'end', 'time', 'code', 'at'),
    [
        (0.1, np.inf, np.inf, 'path_tolerance', 'prox_left: 0.1'),  # the limit of the rate is late
        (np.inf, 0.1, 0.2, 'goal_tolerance', 'prox_left: 0.'),
        (np.inf, 0.1, 3.0, '', 'at the end'),
        (np.inf, 0.1, np.inf, '', 'at the end'),
    ],
)
def test_tolerances_end_a_trajectory_that_is_not_followed(path, end, time, code, at):
    rig = Rig(rate_limit=0.5)
    tolerance = Tolerance(np.full(4, path), np.full(4, end), time)
    outcome = pursue(rig, MotionGoal([trajectory()], tolerance))
    assert outcome.code == code
    assert outcome.message.startswith(at)
    assert rig.code() == ('holding' if code else 'played')
