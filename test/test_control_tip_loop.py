"""The closed loop: what it makes of the measured tip, and the steps that it takes."""

from types import SimpleNamespace

import numpy as np
import pytest
from friction_rig import CYCLE, TARGETS, model, standing

from tendon_robot_ros.common.errors import NoEquilibriumError
from tendon_robot_ros.control import ControllerCore, Settings, Target, target_search, tip_loop
from tendon_robot_ros.control.solver import Solver
from tendon_robot_ros.control.status import controller_status, controller_values
from tendon_robot_ros.control.tip_estimator import TipEstimate, TipStep
from tendon_robot_ros.model.derivatives import tip_slopes
from tendon_robot_ros.model.program import STEP_GAIN, bounded_step


def margin(gain, period, samples):
    """
    Return how much more than its corrected Jacobian says an arm may do before the loop rings.

    Of (z - 1 + a)(z - 1 + k) + a k z (g z^-n - 1) = 0: the largest g, all roots inside.
    """
    k, a, low, high = 1.0 - np.exp(-gain * period), STEP_GAIN, 1.0, 1e3
    for _ in range(40):
        g = 0.5 * (low + high)
        loop = np.zeros(max(samples, 1) + 2)
        loop[0], loop[1], loop[2] = 1.0, a + k - 2.0 - a * k, (1.0 - a) * (1.0 - k)
        loop[-1 if samples else -2] += a * k * g
        low, high = (g, high) if np.abs(np.roots(loop)).max() < 1.0 else (low, g)
    return low


@pytest.mark.parametrize('samples', [0, 1, 3])
def test_the_margin_of_the_gain_is_where_the_loop_begins_to_ring(samples):
    gain, period = 5.0, 0.02
    share, swings = 1.0 - np.exp(-gain * period), []
    most = margin(gain, period, samples)
    for factor in (0.98, 1.02):
        goal, bias, heard = 0.0, 0.0, [0.0] * (samples + 1)  # an arm that does so much more
        size = []
        for step in range(4000):
            load = 1.0 if step < 5 else 0.0
            heard = [factor * most * goal + load, *heard[:-1]]
            bias += share * (heard[samples] - goal - bias)
            goal += STEP_GAIN * (-bias - goal)
            size.append(abs(goal))
        swings.append(max(size[-200:]) / max(size[200:400]))
    assert swings[0] < 0.1 and swings[1] > 10.0


@pytest.mark.parametrize('tensions', [(0.83, 1.65, 0.43, 0.6), (0.64, 1.33, 0.65, 0.95)])
def test_a_step_is_found_where_tendons_stick_whichever_way_they_are_pulled_a_little(tensions):
    arm = model()
    width, here = arm.limits[:, 1] - arm.limits[:, 0], arm.follow(None, arm.limits[:, 0])
    goal = np.array(tensions)
    here = arm.follow(here, goal)
    wanted = here.tip_position + [-7e-3, 0.0, 7e-3]
    slopes = tip_slopes(arm, here, here.memory)[0][:3] * width
    little = bounded_step(slopes, 0.5 * (wanted - here.tip_position), goal, arm.limits, 0.02)
    assert np.linalg.norm(arm.follow(here, little).tip_position - wanted) > 10e-3
    for _ in range(12):
        nothing = TipEstimate.begin(here.inputs, arm.limits, np.full(4, 1e-3))
        step = TipStep(arm, here, wanted, np.zeros(4), arm.limits, True)
        here = arm.follow(here, goal := step.next_goal(nothing, goal))
    assert np.linalg.norm(here.tip_position - wanted) < 1e-3


LAG, PERIOD = 0.03, 0.02  # [s] of the drive, of the tracker


def answered(late, told=0.0):
    """Return the tip of an arm with a lag that is shifted, before a tracker that sees it late."""
    arm, tips = model(False), []
    core = ControllerCore(arm, Settings(tip_gain=5.0, drive_lag=LAG, tracker_delay=told))
    acts, shift, came = arm.limits[:, 0].copy(), np.array([3e-3, 0.0, -1e-3]), 1.2
    shape = arm.shape(acts)
    for step in range(round(2.4 / CYCLE)):
        now = CYCLE * (step + 1)
        core.measured(now, acts, shape.pulls)
        output = core.step(now)
        if step == 2:
            core.aim(Target(arm.shape(np.array(TARGETS[0])).tip_position))
        acts = acts + (1.0 - np.exp(-CYCLE / LAG)) * (output.tensions - acts)
        shape = arm.follow(shape, acts)
        core.predict(now, lambda shape: None)
        tips.append(shape.tip_position + (shift if now > came else 0.0))
        if step % 4 == 0 and step > 4 * late:
            core.tip_measured(now, tips[step - 4 * late])
    return np.array(tips)


def test_a_delay_that_is_told_only_shifts_the_answer(monkeypatch):
    """Smith 1957: behind lag and dead time the predicted loop is the one without, later."""
    monkeypatch.setattr(tip_loop, 'MODEL_SLOPE_SD', 1e-9)  # a loop that does not learn is linear
    begins, shift = round(1.2 / CYCLE), round(3 * PERIOD / CYCLE)
    at_once = answered(0)[begins:]
    late, unknown = (answered(3, told=told)[begins:] for told in (3 * PERIOD, 0.0))
    away = np.linalg.norm(at_once - at_once[-1], axis=1)
    assert away[0] > 3e-3 > 3e-5 > away[-40]
    off, untold = (np.abs(tips[shift:] - at_once[:-shift]).max() for tips in (late, unknown))
    assert off < 0.005 * away[0] < 0.05 * away[0] < untold


def noisy(noise, seconds=3.0):
    """Return the commands (n, m) [N] of an arm at a target with a noisy tracker, and its error."""
    rig, random = standing(tip_gain=5.0), np.random.default_rng(6)
    rig.core.aim(Target(model(False).shape(np.array(TARGETS[0])).tip_position))
    commands = []
    for _ in range(round(seconds / 0.02)):
        rig.run(0.02)
        seen = rig.shape.tip_position + [2e-3, 0.0, 0.0] + noise * random.normal(size=3)
        rig.core.tip_measured(rig.now, seen)
        commands.append(rig.core.command.copy())
    off = rig.shape.tip_position + [2e-3, 0.0, 0.0] - rig.core.target.position
    return np.array(commands), float(np.linalg.norm(off))


def test_a_standing_arm_rests_within_the_noise_of_its_tracker():
    commands, off = noisy(2e-4)
    assert off < 3e-4
    late = commands[-50:]  # of the last second
    assert np.mean(np.any(np.diff(late, axis=0) != 0.0, axis=1)) < 0.3
    assert noisy(0.0)[1] < 2e-5  # what a better tracker sees is gone to


def test_an_arm_that_snaps_on_its_way_is_not_given_up_and_one_that_stays_away_is():
    rig = standing(tip_gain=5.0)
    rig.core.aim(Target(model(False).shape(np.array(TARGETS[0])).tip_position))

    def told(seconds, away):
        for _ in range(round(seconds / 0.02)):
            rig.run(0.02)
            rig.core.tip_measured(rig.now, rig.shape.tip_position + away)
        return controller_values(rig.core, rig.now)['correction_frozen']

    def far(steps):  # no jumps
        for step in steps:
            told(0.02, np.array([0.0, 0.015 * step, 0.0]))

    assert told(1.0, np.zeros(3)) == ''
    far(range(8))
    assert told(0.1, np.array([0.0, 0.12, 0.0])) == ''
    far(range(8, 0, -1))
    assert told(0.5, np.zeros(3)) == ''
    far(range(8))
    assert told(1.5, np.array([0.0, 0.12, 0.0])) == 'too far from the model'
    assert 'the closed loop was left' in controller_status(rig.core, rig.now).message
    rig.core.aim(Target(model(False).shape(np.array(TARGETS[1])).tip_position))
    rig.run(0.01)  # no frame of the tracker
    assert controller_status(rig.core, rig.now).code == 'moving'  # another target, another chance
    assert told(1.5, np.array([0.0, 0.12, 0.0])) == 'too far from the model'
    rig.core.set_model(rig.core.model)  # in which perhaps nothing lacks any more
    told(0.3, np.zeros(3))
    assert told(0.3, np.zeros(3)) == ''


def test_a_comparison_that_ends_after_the_loop_was_left_changes_nothing():
    rig = standing(tip_gain=5.0)
    rig.core.aim(Target(model(False).shape(np.array(TARGETS[0])).tip_position))
    core, solver, answers = rig.core, Solver(), []
    core.solver = SimpleNamespace(
        post=lambda kind, work, done, *rest, **more: (
            answers.append(lambda: solver.post(kind, work, done))
            if kind == 'loop'
            else solver.post(kind, work, done)
        ),
        busy=lambda kind: kind == 'loop' and bool(answers),
        serve=lambda: None,
    )
    for _ in range(20):
        rig.run(0.02)
        core.tip_measured(rig.now, rig.shape.tip_position)
    assert answers
    core.loop.abandoned, core.loop.tensions, core.loop.estimate = 'too far', None, None
    answers.pop()()
    assert core.loop.tensions is None and core.loop.estimate is None


def test_the_closed_loop_is_kept_on_a_way_that_bends_over():
    rig = standing(tip_gain=5.0, approach='from_below', rate_limit=3.0)
    rig.core.aim(Target(rig.shape.tip_position + [2e-3, 0.0, 0.0]))
    away, left = 0.0, ''
    for _ in range(200):
        rig.run(0.02)
        rig.core.tip_measured(rig.now, rig.shape.tip_position + [1e-3, 0.0, 0.0])
        away = max(away, np.linalg.norm(rig.shape.tip_position - rig.core.target.position))
        left = left or rig.core.loop.abandoned
    assert away > 0.15 * model().robot.length and left == ''
    off = rig.shape.tip_position + [1e-3, 0.0, 0.0] - rig.core.target.position
    assert np.linalg.norm(off) < 1e-4


def test_the_closed_loop_begins_at_little_tension_where_friction_would_ask_for_much():
    arm, random = model(), np.random.default_rng(9)
    low, high = arm.limits.T
    shares = random.random((40, 4))
    ratios = []
    for share in shares[[3, 39]]:
        tip, most = arm.shape(low + 0.25 * (high - low) * share).tip_position, []
        for gain in (0.0, 5.0):
            rig = standing(tip_gain=gain)
            for tensions in TARGETS[:3]:
                rig.go(tensions)
            rig.core.aim(Target(tip))
            most.append(rig.core.solution.tensions.max())
        assert rig.core.solution.status == 'reached'
        ratios.append(most[1] / most[0])
    assert max(ratios) <= 1.0
    assert min(ratios) < 0.7  # where friction asks for much; elsewhere both ask for the same


def test_where_one_search_has_no_equilibrium_another_one_counts(monkeypatch):
    rig = standing(tip_gain=5.0)
    rig.go(TARGETS[0])
    reach = target_search.reach

    def without_memory(task, *rest):
        if task.past.any():
            raise NoEquilibriumError('the way there', (), 1.0)
        return reach(task, *rest)

    monkeypatch.setattr(target_search, 'reach', without_memory)
    target = Target(model(False).shape(np.array(TARGETS[1])).tip_position)
    rig.core.aim(target)
    assert rig.core.target is target and rig.core.solution.status == 'reached'


@pytest.mark.parametrize('wide', [0.0, 5e-6, 5e-5])
def test_a_search_that_stalls_goes_on_beside_it(monkeypatch, wide):
    arm, tensions = model(), np.array(TARGETS[0])
    here, shape, widths = arm.follow(None, arm.limits[:, 0]), arm.shape, [wide]

    def stops(wanted, *past):
        if np.abs(wanted / tensions - 1.0).max() <= widths[0]:
            raise NoEquilibriumError('here', (), 0.02)
        return shape(wanted, *past)

    there = arm.follow(here, tensions)
    monkeypatch.setattr(arm, 'shape', stops)
    beside = arm.follow(here, tensions)
    assert beside.tip_position == pytest.approx(there.tip_position, abs=1e-6 + 5.0 * wide)
    widths[0] = 0.01
    with pytest.raises(NoEquilibriumError):
        arm.follow(here, tensions)
