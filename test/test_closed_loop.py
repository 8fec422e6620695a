"""The integral on the measured tip: it removes what the model misses, and knows when to freeze."""

import numpy as np
import pytest

from tendon_robot_ros.control import ControllerCore, Settings, Target
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot

RATE = 0.01  # [s]


class Rig:
    """A controller whose arm is softer than its model says."""

    def __init__(self, gain=2.0):
        robot = load_robot('kato_10_1')
        self.model = Model(robot)
        self.arm = Model(robot.with_effect('backbone_stiffness', {'relative_change': -0.05}))
        self.core = ControllerCore(self.model, Settings(tip_gain=gain))
        self.now = 0.0
        self.tensions = self.model.limits[:, 0].copy()
        self.shift = np.zeros(3)

    def run(self, seconds, track=True):
        for step in range(round(seconds / RATE)):
            self.now += RATE
            self.core.measured(self.now, self.tensions, np.full(4, np.nan))
            output = self.core.step(self.now)
            self.tensions = output.tensions
            if track and step % 3 == 0:
                self.core.tip_measured(self.now, self.tip() + self.shift)

    def tip(self):
        return self.arm.shape(self.tensions).tip_position

    def aim(self):
        there = self.model.shape([0.5, 0.1, 0.1, 0.6])
        self.core.aim(Target(there.tip_position, there.tip_direction))
        return there.tip_position


@pytest.fixture
def rig():
    rig = Rig()
    rig.run(0.1, track=False)
    return rig


def test_the_tip_reaches_the_target_that_the_model_misses(rig):
    target = rig.aim()
    rig.run(1.0, track=False)
    missed = np.linalg.norm(rig.tip() - target)
    assert missed > 1e-3
    rig.run(5.0)
    assert np.linalg.norm(rig.tip() - target) < 0.02 * missed
    said = rig.core.loop.values(rig.now)
    assert said['correction_frozen'] == ''
    assert float(said['correction (m)']) == pytest.approx(missed, rel=0.3)


def test_a_jump_of_the_tracker_changes_nothing(rig):
    rig.aim()
    rig.run(5.0)
    before = rig.tensions.copy()
    rig.now += RATE
    rig.core.tip_measured(rig.now, rig.tip() + 0.05)
    assert rig.core.loop.frozen == 'tracker jumped'
    rig.run(0.02, track=False)
    assert rig.tensions == pytest.approx(before, abs=1e-6)


def test_a_silent_tracker_freezes_the_correction(rig):
    rig.aim()
    rig.run(3.0)
    rig.run(0.3, track=False)
    kept = rig.tensions.copy()
    assert rig.core.loop.values(rig.now)['correction_frozen'] == 'tracker silent'
    rig.core.tip_measured(rig.now, rig.tip())
    rig.run(0.05, track=False)
    assert rig.tensions == pytest.approx(kept, abs=1e-9)


def test_at_a_limit_the_integral_does_not_wind_up(rig):
    rig.core.aim(Target(np.array([0.19, 0.0, 0.19])))
    rig.run(3.0)
    wound = rig.core.loop.tensions
    rig.run(3.0)
    assert np.array_equal(rig.core.loop.tensions, wound) or rig.core.loop.frozen == ''
    assert np.all(rig.tensions <= rig.model.limits[:, 1])
    assert np.all(rig.tensions >= rig.model.limits[:, 0])


def test_a_new_model_begins_without_correction(rig):
    target = rig.aim()
    rig.run(4.0)
    before = rig.tensions.copy()
    rig.core.set_model(rig.arm)
    rig.run(RATE, track=False)
    assert np.abs(rig.tensions - before).max() <= 10.0 * 0.011  # no jump: the rate limit
    rig.run(2.0)
    assert np.linalg.norm(rig.tip() - target) < 5e-5
    assert float(rig.core.loop.values(rig.now)['correction (m)']) < 5e-5


def test_open_loop_takes_no_notice():
    rig = Rig(gain=0.0)
    rig.run(0.1, track=False)
    target = rig.aim()
    rig.run(4.0)
    assert np.linalg.norm(rig.tip() - target) > 1e-3
