"""Null-space motion: tensions change while the measured tip stays where it is."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tendon_robot_ros.control import ControllerCore, Settings, Target
from tendon_robot_ros.control.tip_estimator import (
    DRIFT,
    HANDOVER_LENGTH,
    NullSpaceMotion,
    TipEstimate,
)
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.model.program import RANGE_TOLERANCE, bounded_step
from tendon_robot_ros.model.tip_task import Preferences
from tendon_robot_ros.robot import load_robot

LENGTH, CYCLE, PERIOD = 0.2, 0.005, 0.02  # [m], [s], [s]
TRACKER_M = 1e-4  # [m] noise on each axis
HERE, LIMITS = np.full(4, 1.0), np.array([[0.1, 5.0]] * 4)
SLOPES = np.array([[1.0, -1.0, 0.5, -0.5], [0.0] * 4, [0.2, -0.1, -0.4, 0.3]])  # [m]


def test_tensions_that_may_only_rise_lead_the_tip_anywhere():
    slopes = np.array([[1.0, -1.0, 0.5, -0.5], [0.2, -0.1, -0.4, 0.3], [0.0] * 4])
    limits, tensions = np.array([[0.0, 5.0]] * 4), np.ones(4)
    for angle in np.linspace(0.0, 6.0, 7):
        wanted = 1e-4 * np.array([np.cos(angle), np.sin(angle), 0.0])
        made = bounded_step(slopes, wanted, tensions, limits, 1e-4, signs=np.ones(4))
        assert made.min() >= 1.0
        assert slopes @ (made - tensions) / 5.0 == pytest.approx(wanted, abs=1e-7)


def stepped(more, slope_sd=1e-3, away=0.0, slopes=SLOPES, length=LENGTH):
    """Return a motion to so much more tension (4,) [N] after its first step, and the goal."""

    def there(goal):
        return SimpleNamespace(inputs=goal, tip_position=slopes @ ((goal - HERE) / 4.9))

    tip = SimpleNamespace(
        shape=there(HERE),
        shape_at=there,
        limits=LIMITS,
        slopes_at=lambda shape: slopes,
        model=SimpleNamespace(robot=SimpleNamespace(length=length)),
    )
    known = TipEstimate.begin(HERE, LIMITS, np.full(4, slope_sd))
    known = replace(known, bias=np.array([away, 0.0, 0.0]))
    motion = NullSpaceMotion.begin(None, HERE + more, HERE)
    return replace(motion, place=np.zeros(3)).step(tip, HERE, known, PERIOD)


def test_it_goes_as_fast_as_the_slopes_are_known():
    def speed(doubt):
        return np.abs(stepped(0.5, doubt)[1] - HERE).max() / 4.9 / PERIOD

    assert speed(1e-4) == pytest.approx(RANGE_TOLERANCE, rel=0.05)
    assert speed(0.2) == pytest.approx(0.5 * speed(0.1), rel=0.05)
    assert 0.3 * DRIFT * LENGTH / 0.2 < speed(0.2) < 3.0 * DRIFT * LENGTH / 0.2


def test_an_arm_of_any_length_takes_the_same_time():
    small, large = (
        stepped(0.5, size, slopes=size * SLOPES, length=size * LENGTH)[1] for size in (1.0, 10.0)
    )
    assert large == pytest.approx(small, rel=1e-9)


def test_no_tension_turns_where_the_nearest_direction_that_holds_the_tip_would():
    slopes = np.array([[-2.0, 1.0, -1.0, 1.5], [-0.1, 0.3, 0.2, -0.05], [0.0] * 4])
    wish = np.array([0.2, 0.01, 0.01, 0.01])
    assert (wish - np.linalg.pinv(slopes) @ (slopes @ wish)).min() < 0.0
    _, goal = stepped(4.9 * wish, slopes=slopes)
    change = (goal - HERE) / 4.9
    assert change.min() >= 0.0 and change.max() > 1e-6
    assert np.abs(slopes @ change).max() < 0.02 * np.abs(slopes).max() * change.max()


def test_at_the_preferred_tensions_it_holds_the_tip_there():
    motion, goal = stepped(0.0)
    assert motion is not None and goal == pytest.approx(HERE, abs=1e-12)


@pytest.mark.parametrize('length', [LENGTH, 10.0 * LENGTH])
def test_a_tip_that_is_pushed_away_is_left_to_the_tip_loop(length):
    away = HANDOVER_LENGTH * length
    assert stepped(0.5, away=0.9 * away, length=length)[0] is not None
    motion, goal = stepped(0.5, away=1.1 * away, length=length)
    assert motion is None and np.array_equal(goal, HERE)


def test_it_waits_until_the_bias_is_known():
    known = TipEstimate.begin(HERE, LIMITS, np.full(4, 0.1))
    motion = NullSpaceMotion.begin(None, HERE + 0.5, HERE)
    tip = SimpleNamespace(shape=SimpleNamespace(tip_position=np.zeros(3)))
    waits, goal = motion.step(tip, HERE, known, PERIOD)
    assert waits.place is None and goal is HERE
    for _ in range(200):
        known = known.updated(np.zeros(3), 0.01, np.full(4, 0.1))
    assert motion.step(tip, HERE, known, PERIOD)[0].place is not None


def begin(core, more):
    """Have a core's arm go to more tension [N] all over."""
    goal = core.goal(core.solution.tensions)
    core.loop.motion = NullSpaceMotion.begin(core.solution, goal + more, goal)


class Rig:
    """A controller whose arm rubs more than its model says; the tip is seen with noise."""

    def __init__(self, seed=1, cells=0.0):
        robot = load_robot('kato_10_1').with_effect('friction_memory', {'presliding_length': 2e-4})
        rubs = {'friction_coefficient': 0.4}
        self.arm = Model(robot.with_effect('tendon_friction', rubs))
        self.core = ControllerCore(Model(robot), Settings(tip_gain=6.0))
        self.shape, self.random = self.arm.shape(np.full(4, 0.1)), np.random.default_rng(seed)
        self.now, self.tips, self.commands, self.cells = 0.0, [], [], cells  # [N] noise
        self.lost = np.zeros(4)  # [N] of what is commanded, by drives that fail

    def run(self, seconds):
        for step in range(round(seconds / CYCLE)):
            self.now += CYCLE
            seen = self.shape.inputs + self.cells * self.random.normal(size=4)
            self.core.measured(self.now, seen, self.shape.pulls)
            output = self.core.step(self.now)
            acts = np.maximum(output.tensions - self.lost, 0.0)
            if not np.array_equal(acts, self.shape.inputs):
                self.shape = self.arm.follow(self.shape, acts)
            if step % 6 == 0:
                self.core.predict(self.now, lambda shape: None)
            if step % 4 == 0:
                noise = TRACKER_M * self.random.normal(size=3)
                self.core.tip_measured(self.now, self.shape.tip_position + noise)
            self.tips.append(self.shape.tip_position)
            self.commands.append(output.tensions)


def at_target(seed=1, cells=0.0):
    """Return a rig whose arm stands at a target."""
    rig = Rig(seed, cells)
    rig.run(0.1)
    rig.core.aim(Target(np.array([-0.09, 0.0, 0.175])))
    rig.run(4.0)
    return rig


@pytest.mark.long
def test_it_ends_where_the_tip_is_as_stiff_as_is_enough():
    rig = at_target()
    model, along = rig.core.model, (1.0, 0.0, 0.0)
    enough = 1.06 * model.tip_stiffness(rig.core.track.last).along(along)
    wants = Preferences(
        low_tension=0.01, stiffness=0.1, stiffness_direction=along, stiffness_enough=enough
    )
    rig.core.settings = replace(rig.core.settings, preferences=wants)
    tip, begin = rig.tips[-1], len(rig.tips)
    rig.run(25.0)
    away = np.linalg.norm(np.array(rig.tips[begin:]) - tip, axis=1)
    assert away.max() < 1.5e-4
    assert np.diff(np.array(rig.commands[begin:]), axis=0).min() > -1e-12
    made = model.tip_stiffness(rig.core.track.last).along(along)
    assert 0.999 < made / enough < 1.01
    begin = len(rig.commands)
    rig.run(2.0)
    assert rig.commands[-1] == pytest.approx(rig.commands[begin], abs=1e-9)


def moved_on(cells=0.0):
    """Return a rig at a target after a short motion from there that is over."""
    rig = at_target(2, cells)
    rig.begun = len(rig.tips)
    begin(rig.core, 0.1)
    rig.run(20.0)
    for _ in range(20):
        stood = rig.commands[-1]
        rig.run(2.0)
        if np.array_equal(stood, rig.commands[-1]):
            break
    assert np.array_equal(stood, rig.commands[-1])
    assert np.all(stood - rig.core.solution.tensions > 0.04)
    return rig


@pytest.fixture(scope='module')
def over():
    """Give a rig after a motion; what follows happens to it one after the other."""
    return moved_on()


def test_where_a_motion_is_over_the_tip_stays_and_no_tension_turns_round(over):
    rig = over
    begin, tip = len(rig.tips), rig.tips[-1]
    rig.run(4.0)
    assert np.diff(np.array(rig.commands[begin - 1 :]), axis=0).min() > -1e-12
    assert np.linalg.norm(np.array(rig.tips[begin:]) - tip, axis=1).max() < 2e-5


@pytest.mark.long
def test_noise_of_load_cells_is_no_motion_of_the_arm():
    rig = moved_on(cells=0.005)
    away = np.linalg.norm(np.array(rig.tips[rig.begun :]) - rig.tips[rig.begun], axis=1)
    assert away.max() < 1e-4


def test_a_tip_that_creeps_is_led_back_by_tensions_that_go_on(over):
    rig = over
    begin, tip, solution = len(rig.tips), rig.tips[-1].copy(), rig.core.solution
    rig.arm = Model(rig.arm.robot.with_effect('tip_load', {'force_x': 4e-5}))
    rig.shape = rig.arm.follow(rig.shape, rig.shape.inputs)
    moved = np.linalg.norm(rig.shape.tip_position - tip)
    assert 1e-4 < moved < 3e-4
    rig.run(6.0)
    assert rig.core.solution is solution
    assert np.linalg.norm(rig.tips[-1] - tip) < 1e-4
    assert np.diff(np.array(rig.commands[begin - 1 :]), axis=0).min() > -1e-12


def test_a_load_after_a_motion_is_taken_by_the_ordinary_loop(over):
    rig = over
    tip = rig.tips[-1]
    rig.arm = Model(rig.arm.robot.with_effect('tip_load', {'force_x': 0.002}))
    rig.shape = rig.arm.follow(rig.shape, rig.shape.inputs)
    assert np.linalg.norm(rig.shape.tip_position - tip) > 5e-3
    rig.run(2.0)
    assert np.linalg.norm(rig.tips[-1] - tip) < 2e-4


def test_a_drive_that_fails_on_a_motion_is_seen_by_the_tip_and_then_by_its_load_cell():
    rig = at_target(4)
    begin(rig.core, 0.1)
    rig.run(3.0)
    assert rig.core.loop.motion is not None
    rig.lost = np.array([0.0, 0.02, 0.0, 0.0])
    rig.run(2.0)
    assert rig.core.loop.motion is None
    assert rig.core.driver.acting.offset == pytest.approx(-rig.lost, abs=5e-3)
    assert np.linalg.norm(rig.tips[-1] - rig.core.target.position) < 5e-4
