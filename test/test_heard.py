"""What the controller makes of a driver that lost some of its motors."""

import numpy as np
import pytest
from source_tree import ROOT

from tendon_robot_ros.control.state import MeasuredState
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot

LIMITS = np.tile([0.1, 5.0], (4, 1))


@pytest.mark.parametrize('lost', [[0], [1], [2, 3], [0, 1, 3]])
def test_motors_that_are_silent_leave_the_others_to_say_where_the_arm_is(lost):
    model = Model(load_robot(ROOT / 'config' / 'robots' / 'kato_10_1.yaml'))
    tensions = np.array([1.5, 0.1, 0.6, 0.1])
    pulls = model.shape(tensions).pulls
    pulls[lost] = np.nan
    said = MeasuredState(np.full(4, np.nan), pulls, 0.0)
    found = said.in_newtons(model, LIMITS, None, LIMITS[:, 0])
    assert np.isfinite(found).all()
    assert np.all((found >= LIMITS[:, 0]) & (found <= LIMITS[:, 1]))
