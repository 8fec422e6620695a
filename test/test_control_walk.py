"""A walk of the tensions that leaves the measured tip where it is."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tendon_robot_ros.control import ControllerCore, Settings, Target
from tendon_robot_ros.control.mismatch import Mismatch
from tendon_robot_ros.control.walk import NOISE_M, SPEED_MAX, STUCK_S, Leak, Led, begun
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.model.program import bounded_step
from tendon_robot_ros.model.redundancy import Preferences
from tendon_robot_ros.robot import load_robot

LENGTH, CYCLE = 0.2, 0.005  # [m], [s]
TRACKER_M = 1e-4  # [m] noise on each axis


def leak(doubt=1.0):
    return Leak(0.0, np.zeros(3), np.zeros(3), np.diag([doubt**2, LENGTH**2]))


def test_an_offset_that_grows_along_the_way_is_learned():
    known, offset, slope = leak(), np.array([0.01, -0.02, 0.0]), np.array([0.1, 0.05, -0.08])
    for way in (0.0, 0.01, 0.03):
        known = known.learned(way, offset + slope * way, 1e-7, LENGTH, 0.0)
    assert known.slope == pytest.approx(slope, abs=1e-4)
    assert known.offset == pytest.approx(offset + 0.03 * slope, abs=1e-6)


def test_standing_still_the_offset_is_the_mean_of_what_was_seen_and_no_leak_is_learned():
    random, known = np.random.default_rng(1), leak()
    seen = NOISE_M * random.normal(size=(40, 3))
    for left in seen:
        known = known.learned(0.0, left, NOISE_M, LENGTH, 0.0)
    assert known.offset == pytest.approx(seen.mean(axis=0), abs=1e-9)
    assert known.spread[0, 0] == pytest.approx(NOISE_M**2 / 40, rel=1e-3)
    assert known.spread[1, 1] == pytest.approx(LENGTH**2) and not known.slope.any()


def test_the_better_the_leak_is_known_the_faster_the_walk_goes():
    gone = replace(leak(), way=1.0)
    speeds = [replace(gone, spread=np.diag([1e-10, sd**2])).speed() for sd in (0.2, 0.1, 1e-4)]
    assert speeds[1] == pytest.approx(2.0 * speeds[0]) and speeds[2] == SPEED_MAX


def test_a_walk_goes_no_faster_than_the_way_behind_it_tells_of_the_way_ahead():
    known = replace(leak(), spread=np.diag([1e-10, 1e-4**2]))
    speeds = [replace(known, way=way).speed() for way in (-1e-3, 0.0, 1e-3, 2e-3, 1.0)]
    assert speeds[0] == speeds[1] < SPEED_MAX / 10.0 and speeds[4] == SPEED_MAX
    assert speeds[2] - speeds[1] == pytest.approx(speeds[3] - speeds[2])


def test_tensions_that_may_only_rise_lead_the_tip_anywhere():
    slopes = np.array([[1.0, -1.0, 0.5, -0.5], [0.2, -0.1, -0.4, 0.3], [0.0] * 4])
    limits, tensions = np.array([[0.0, 5.0]] * 4), np.ones(4)
    for angle in np.linspace(0.0, 6.0, 7):
        wanted = 1e-4 * np.array([np.cos(angle), np.sin(angle), 0.0])
        made = bounded_step(slopes, wanted, tensions, limits, 1e-4, ways=np.ones(4))
        assert made.min() >= 1.0
        assert slopes @ (made - tensions) / 5.0 == pytest.approx(wanted, abs=1e-7)


def test_a_walk_to_where_the_arm_is_is_over():
    here = np.full(4, 1.0)
    known = Mismatch.unknown(here, np.array([[0.1, 5.0]] * 4), np.full(4, 0.05))
    led = Led(None, here)
    walk = begun(None, led, here, known, here, LENGTH)
    assert begun(walk, led, here, known, here, LENGTH) is walk
    assert begun(walk, Led(None, here), here, known, here, LENGTH) is not walk


def test_a_walk_that_has_no_way_on_for_a_moment_is_not_over():
    here, limits = np.full(4, 1.0), np.array([[0.1, 5.0]] * 4)
    known = Mismatch.unknown(here, limits, np.full(4, 0.05))
    walk = begun(None, Led(None, here + 0.5), here, known, here, LENGTH)
    stood = replace(walk, stuck=0.5 * STUCK_S), replace(walk, stuck=1.1 * STUCK_S)
    assert [one._over(here) for one in (walk, *stood)] == [False, False, True]
    assert walk._over(here + 0.48)


def test_a_walk_on_which_the_tip_does_not_come_back_to_its_place_is_over():
    here, limits = np.full(4, 1.0), np.array([[0.1, 5.0]] * 4)
    slopes = np.array([[1.0, -1.0, 0.5, -0.5], [0.0] * 4, [0.2, -0.1, -0.4, 0.3]])

    def there(goal, before=None):
        return SimpleNamespace(inputs=goal, tip_position=0.02 * slopes @ (goal - here))

    ahead = SimpleNamespace(here=there(here), wanted=np.zeros(3), limits=limits, there=there)
    known = Mismatch.unknown(here, limits, np.full(4, 0.05))
    walk = begun(None, Led(None, here + 1.0), here, known, here, LENGTH)
    walk = replace(walk, heading=np.ones(4), leak=leak(1e-5))
    far = replace(walk, leak=replace(walk.leak, offset=np.array([5e-4, 0.0, 0.0])))
    ends = []
    for one in (walk, far):
        for _ in range(round(1.2 * STUCK_S / 0.02)):
            one, _ = one.step(ahead, here, known, 0.02)
        ends.append(one.end is not None)
    assert ends == [False, True]


def test_a_walk_goes_on_where_the_nearest_direction_that_holds_the_tip_would_turn_a_tension():
    slopes = np.array([[-2.0, 1.0, -1.0, 1.5], [-0.1, 0.3, 0.2, -0.05]])
    limits, here = np.array([[0.0, 5.0]] * 4), np.ones(4)
    towards = here + 5.0 * np.array([0.2, 0.01, 0.01, 0.01])
    wish = (towards - here) / 5.0
    assert (wish - np.linalg.pinv(slopes) @ (slopes @ wish)).min() < 0.0
    known = Mismatch.unknown(here, limits, np.full(4, 0.05))
    free = begun(None, Led(None, towards), here, known, here, LENGTH)._free(slopes, here, limits)
    assert free.min() >= 0.0 and free.max() > 0.01
    assert np.abs(slopes @ free).max() < 1e-3 * free.max()


def test_a_leak_that_is_hardly_known_leads_no_tension():
    vague = replace(leak(), slope=np.array([0.1, 0.0, 0.0]), spread=np.diag([1e-10, 0.1**2]))
    assert vague.sure()[0] == pytest.approx(0.025)
    known = replace(vague, spread=np.diag([1e-10, 1e-4**2]))
    assert known.sure()[0] == pytest.approx(0.1, rel=1e-3)


class Rig:
    """A controller whose arm rubs more than its model says; the tip is seen with noise."""

    def __init__(self, seed=1, cells=0.0):
        robot = load_robot('kato_10_1').with_effect('friction_memory', {'presliding_length': 2e-4})
        rubs = {'friction_coefficient': 0.4}
        self.arm = Model(robot.with_effect('tendon_friction', rubs))
        self.core = ControllerCore(Model(robot), Settings(tip_gain=6.0))
        self.shape, self.random = self.arm.shape(np.full(4, 0.1)), np.random.default_rng(seed)
        self.now, self.tips, self.commands, self.cells = 0.0, [], [], cells  # [N] noise

    def run(self, seconds):
        for step in range(round(seconds / CYCLE)):
            self.now += CYCLE
            seen = self.shape.inputs + self.cells * self.random.normal(size=4)
            self.core.measured(self.now, seen, self.shape.pulls)
            output = self.core.step(self.now)
            if not np.array_equal(output.tensions, self.shape.inputs):
                self.shape = self.arm.follow(self.shape, output.tensions)
            if step % 6 == 0:
                self.core.predict(self.now, lambda shape: None)
            if step % 4 == 0:
                noise = TRACKER_M * self.random.normal(size=3)
                self.core.loop.take(self.now, self.core, self.shape.tip_position + noise)
            self.tips.append(self.shape.tip_position)
            self.commands.append(output.tensions)


@pytest.mark.slow  # the next one looks at the same on a walk towards less
def test_on_an_arm_that_rubs_more_no_tension_turns_round_and_the_tip_stays():
    rig = Rig()
    rig.run(0.1)
    rig.core.aim(Target(np.array([-0.09, 0.0, 0.175])))
    rig.run(4.0)
    tip, tensions, begin = rig.tips[-1], rig.commands[-1], len(rig.tips)
    before = rig.arm.tip_stiffness(rig.shape).along([1, 0, 0])
    wants = Preferences(low_tension=0.5, stiffness=0.1, stiffness_direction=(1.0, 0.0, 0.0))
    rig.core.settings = replace(rig.core.settings, preferences=wants)
    rig.run(50.0)
    away = np.linalg.norm(np.array(rig.tips[begin:]) - tip, axis=1)
    risen = np.diff(np.array(rig.commands[begin:]), axis=0)
    assert away.max() < 1.5e-4
    assert risen.min() > -1e-12
    assert np.all(rig.commands[-1] > tensions + 0.05)
    assert rig.arm.tip_stiffness(rig.shape).along([1, 0, 0]) > 1.15 * before


def test_a_walk_ends_where_the_tip_is_as_stiff_as_is_enough():
    rig = Rig()
    rig.run(0.1)
    rig.core.aim(Target(np.array([-0.09, 0.0, 0.175])))
    rig.run(4.0)
    model, along = rig.core.model, (1.0, 0.0, 0.0)
    enough = 1.15 * model.tip_stiffness(rig.core.track.last).along(along)
    wants = Preferences(
        low_tension=0.01, stiffness=0.1, stiffness_direction=along, stiffness_enough=enough
    )
    rig.core.settings = replace(rig.core.settings, preferences=wants)
    tip, begin = rig.tips[-1], len(rig.tips)
    rig.run(60.0)
    away = np.linalg.norm(np.array(rig.tips[begin:]) - tip, axis=1)
    assert away.max() < 1.5e-4
    assert np.diff(np.array(rig.commands[begin:]), axis=0).min() > -1e-12
    made = model.tip_stiffness(rig.core.track.last).along(along)
    assert 0.999 < made / enough < 1.01
    begin = len(rig.commands)
    rig.run(2.0)
    assert rig.commands[-1] == pytest.approx(rig.commands[begin], abs=1e-9)


def walked(seed):
    """Return a rig at a target, after a short walk from there that is over, and its last goal."""
    rig = Rig(seed)
    rig.run(0.1)
    rig.core.aim(Target(np.array([-0.09, 0.0, 0.175])))
    rig.run(4.0)
    loop, solution = rig.core.loop, rig.core.solution
    towards = loop.goal(rig.core, solution.tensions) + 0.1
    loop.lead(Led(solution, towards))
    rig.run(20.0)
    assert np.all(np.abs(rig.commands[-1] - towards) < 0.1)
    return rig


@pytest.fixture(scope='module')
def over():
    """Give a rig after a walk; what follows happens to it one after the other."""
    return walked(2)


@pytest.mark.slow
def test_where_another_walk_is_over_the_tip_stays_as_well():
    test_where_a_walk_is_over_the_tip_stays_and_no_tension_turns_round(walked(3))


def test_where_a_walk_is_over_the_tip_stays_and_no_tension_turns_round(over):
    rig = over
    begin, tip = len(rig.tips), rig.tips[-1]
    rig.run(4.0)
    assert np.diff(np.array(rig.commands[begin - 1 :]), axis=0).min() > -1e-12
    assert np.linalg.norm(np.array(rig.tips[begin:]) - tip, axis=1).max() < 2e-5


def test_noise_of_load_cells_is_no_motion_of_the_arm_on_a_walk():
    rig = Rig(2, cells=0.005)
    rig.run(0.1)
    rig.core.aim(Target(np.array([-0.09, 0.0, 0.175])))
    rig.run(4.0)
    loop, solution = rig.core.loop, rig.core.solution
    loop.lead(Led(solution, loop.goal(rig.core, solution.tensions) + 0.1))
    biases = []
    for _ in range(40):
        rig.run(0.1)
        biases.append(rig.core.felt.bias)
    assert np.ptp(biases[1:], axis=0).max() == 0.0
    rig.core.aim(Target(np.array([-0.08, 0.0, 0.175])))
    rig.run(1.0)
    assert not np.array_equal(rig.core.felt.bias, biases[-1])


def test_a_walk_that_is_over_sees_the_tip_creep_and_leads_it_back_by_tensions_that_go_on(over):
    rig = over
    begin, tip, solution = len(rig.tips), rig.tips[-1].copy(), rig.core.solution
    rig.arm = Model(rig.arm.robot.with_effect('tip_load', {'force_x': 3e-5}))
    rig.shape = rig.arm.follow(rig.shape, rig.shape.inputs)
    moved = np.linalg.norm(rig.shape.tip_position - tip)
    assert 1e-4 < moved < 3e-4
    rig.run(6.0)
    assert rig.core.solution is solution
    assert np.linalg.norm(rig.tips[-1] - tip) < 1e-4
    assert np.diff(np.array(rig.commands[begin - 1 :]), axis=0).min() > -1e-12


def test_a_load_after_a_walk_is_taken_by_the_ordinary_loop(over):
    rig = over
    tip = rig.tips[-1]
    rig.arm = Model(rig.arm.robot.with_effect('tip_load', {'force_x': 0.002}))
    rig.shape = rig.arm.follow(rig.shape, rig.shape.inputs)
    assert np.linalg.norm(rig.shape.tip_position - tip) > 5e-3
    rig.run(2.0)
    assert np.linalg.norm(rig.tips[-1] - tip) < 2e-4
