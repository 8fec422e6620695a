"""The integral on the measured tip: it removes what the model misses, and knows when to freeze."""

import control_rig
import numpy as np
import pytest
from control_rig import CYCLE, model, reachable

from tendon_robot_ros.control import Target
from tendon_robot_ros.model.model import Model


class Rig(control_rig.Rig):
    """A controller whose arm is softer than its model says."""

    def __init__(self, gain=2.0):
        super().__init__(tip_gain=gain)
        softer = {'relative_change': -0.05}
        self.arm = Model(model().robot.with_effect('backbone_stiffness', softer))

    def run(self, seconds, track=True):
        super().run(seconds, self.see if track else None)

    def see(self, _):
        if round(self.now / CYCLE) % 6 == 0:
            self.core.tip_measured(self.now, self.tip())

    def tip(self):
        return self.arm.shape(self.tensions).tip_position

    def aim(self):
        target = reachable((0.5, 0.1, 0.1, 0.6))
        self.core.aim(target)
        return target.position


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
    rig.now += CYCLE
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
    assert np.all(rig.tensions <= model().limits[:, 1])
    assert np.all(rig.tensions >= model().limits[:, 0])


def test_a_new_model_begins_without_correction(rig):
    target = rig.aim()
    rig.run(4.0)
    before = rig.tensions.copy()
    rig.core.set_model(rig.arm)
    rig.run(CYCLE, track=False)
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
