"""The controller without ROS: targets to commands, halts, stops."""

from dataclasses import replace

import numpy as np
import pytest
from control_rig import CYCLE, Rig, aimed, model, reachable, standing

from tendon_robot_ros.common.errors import DriverError
from tendon_robot_ros.common.rotations import angle_between
from tendon_robot_ros.control import Refusal, Target, Twist
from tendon_robot_ros.control.state import MeasuredState
from tendon_robot_ros.control.status import controller_status


def test_a_target_is_approached_at_the_rate_limit_and_reached():
    rig = standing(rate_limit=2.0)
    rig.core.aim(reachable())
    first = rig.run(CYCLE).tensions
    assert np.abs(first - 0.1).max() == pytest.approx(2.0 * CYCLE)
    assert rig.code() == 'moving'
    rig.run(1.0)
    assert rig.code() == 'reached'
    tip = model().shape(rig.tensions).tip_position
    assert tip == pytest.approx(reachable().position, abs=1e-5)


def test_before_the_driver_is_heard_there_are_no_commands_and_no_targets():
    rig = Rig()
    rig.alive = False
    with pytest.raises(Refusal, match='no tendon states; send it again'):
        rig.core.aim(reachable())
    assert rig.run(0.1) is None
    assert rig.code() == 'waiting'
    rig.alive = True
    rig.run(1.0)
    assert rig.code() == 'holding'


def test_it_starts_from_what_the_driver_measures():
    rig = Rig()
    rig.tensions = np.array([1.0, 0.5, 0.2, 0.3])
    assert rig.run(CYCLE).tensions == pytest.approx([1.0, 0.5, 0.2, 0.3])
    assert rig.code() == 'holding'


def lost_and_found(**settings):
    """Return a controller on its way to a target whose driver was away and is slack now."""
    rig = aimed(0.1, rate_limit=2.0, **settings)
    rig.alive = False
    rig.run(0.3)
    held = rig.outputs[-1].tensions
    rig.run(0.5)
    assert np.array_equal(rig.outputs[-1].tensions, held)
    assert rig.code() == 'no_driver'
    rig.alive, rig.tensions = True, np.full(4, 0.2)
    assert np.abs(rig.run(CYCLE).tensions - 0.2).max() <= 2.0 * CYCLE + 1e-12
    rig.run(2.0)
    return rig


def test_a_driver_that_comes_back_is_held_where_it_is_until_a_new_target():
    rig = lost_and_found()
    assert rig.code() == 'holding'
    assert rig.tensions.tolist() == [0.2] * 4
    rig.core.aim(reachable())
    rig.run(2.0)
    assert rig.code() == 'reached'


def test_with_resume_a_driver_that_comes_back_is_led_to_the_old_target():
    assert lost_and_found(resume=True).code() == 'reached'


def test_a_driver_that_stays_away_finds_no_old_command_when_it_comes_back():
    rig = aimed(1.0)
    rig.alive = False
    assert rig.run(1.1) is not None  # a hiccup: the last command is held
    assert rig.run(0.3) is None
    assert 'no commands until they are back' in controller_status(rig.core, rig.now).message
    rig.alive, rig.tensions = True, np.full(4, 0.2)
    assert rig.run(0.5).tensions.tolist() == [0.2] * 4


def test_a_controller_that_was_not_running_for_a_while_holds_what_it_finds():
    rig = aimed(1.0)
    rig.now += 2.0  # it was stopped; the driver released the arm meanwhile
    rig.tensions = np.full(4, 0.1)
    assert rig.run(0.5).tensions.tolist() == [0.1] * 4
    assert rig.code() == 'holding'


def test_a_twist_moves_the_tip_and_ends_by_itself():
    rig = aimed(1.0)
    start = model().shape(rig.tensions).tip_position
    twist = Twist(np.array([0.02, 0.0, 0.0]), np.zeros(3))
    rig.run(0.5, lambda rig: rig.core.twist(rig.now, twist))
    assert rig.code() == 'jogging'
    moved = model().shape(rig.tensions).tip_position - start
    assert moved == pytest.approx([0.01, 0.0, 0.0], abs=1e-3)
    rig.run(0.2)
    before = rig.tensions
    rig.run(0.5)
    assert np.array_equal(rig.tensions, before)
    assert rig.code() == 'holding'


def test_a_zero_twist_stops_at_once():
    rig = standing()
    rig.core.twist(rig.now, Twist(np.array([0.05, 0.0, 0.0]), np.zeros(3)))
    rig.run(0.05)
    rig.core.twist(rig.now, Twist(np.zeros(3), np.zeros(3)))
    before = rig.tensions
    rig.run(0.05)
    assert np.array_equal(rig.tensions, before)


def test_a_twist_may_hold_the_direction_and_may_be_given_in_tip_axes():
    def turned(**settings):
        rig = aimed(1.0, reachable((0.3, 0.6, 0.3, 0.9)), **settings)
        start = model().shape(rig.tensions)
        along = Twist(np.array([0.01, 0.0, 0.0]), np.zeros(3), in_tip=True)
        rig.run(0.5, lambda rig: rig.core.twist(rig.now, along))
        end = model().shape(rig.tensions)
        assert (end.tip_position - start.tip_position) @ start.frames[-1, :, 0] > 0.002
        return np.arccos(np.clip(start.tip_direction @ end.tip_direction, -1, 1))

    assert turned(hold_direction=True) < 0.3 * turned()


def test_a_turn_begins_where_the_tip_looks_after_it_was_moved():
    rig = aimed(1.0, replace(reachable((0.3, 0.2, 0.2, 0.2)), direction=None))
    along = Twist(np.array([0.03, 0.0, 0.0]), np.zeros(3))
    rig.run(2.0, lambda rig: rig.core.twist(rig.now, along))
    before = model().shape(rig.tensions).tip_direction
    turn = Twist(np.zeros(3), np.array([0.0, 0.001, 0.0]))
    rig.run(0.2, lambda rig: rig.core.twist(rig.now, turn))
    turned = angle_between(model().shape(rig.tensions).tip_direction, before)
    assert turned < np.deg2rad(0.5)  # the tip has turned by sixteen degrees as it was moved


def test_a_stop_silences_it_and_drops_the_target():
    rig = aimed(0.02)
    rig.core.latch.stop('topic', 'topic stop says true', lasting=True)
    assert rig.run(0.1) is None
    with pytest.raises(Refusal, match='topic stop says true; call reset first'):
        rig.core.aim(reachable())
    with pytest.raises(DriverError, match='reset refused: topic stop says true'):
        rig.core.reset()
    rig.core.latch.cause_removed('topic')
    rig.core.reset()
    before = rig.tensions
    rig.run(0.5)
    assert np.array_equal(rig.tensions, before)
    assert rig.code() == 'holding'


def test_a_stop_and_a_reset_in_the_same_cycle_drop_the_target():
    rig = aimed(0.02)
    rig.core.latch.stop('stop', 'stop was called')
    rig.core.reset()
    rig.run(0.5)
    assert rig.code() == 'holding'


def test_while_the_driver_is_stopped_it_follows_the_measured_state():
    rig = aimed(1.0)
    rig.core.driver_reports('stop was called')
    rig.tensions = np.full(4, 0.3)
    assert rig.run(0.1).tensions == pytest.approx([0.3] * 4)
    assert rig.code() == 'driver_stopped'
    with pytest.raises(Refusal, match='the driver does not follow: stop was called'):
        rig.core.aim(reachable())
    rig.core.driver_reports('')
    assert rig.run(0.5).tensions == pytest.approx([0.3] * 4)


def test_out_of_reach_is_said_with_the_distance():
    rig = aimed(3.0, Target(np.array([0.2, 0.0, 0.2])))
    said = controller_status(rig.core, rig.now)
    assert said.code in ('nearest', 'at_limit')
    assert 'mm' in said.message


@pytest.mark.parametrize('lost', [[0], [1], [2, 3], [0, 1, 3]])
def test_motors_that_are_silent_leave_the_others_to_say_where_the_arm_is(lost):
    arm, limits = model(), np.tile([0.1, 5.0], (4, 1))
    tensions = np.array([1.5, 0.1, 0.6, 0.1])
    pulls = arm.shape(tensions).pulls
    pulls[lost] = np.nan
    said = MeasuredState(np.full(4, np.nan), pulls, 0.0)
    found = said.in_newtons(arm, limits, None, limits[:, 0])
    assert np.isfinite(found).all()
    assert np.all((found >= limits[:, 0]) & (found <= limits[:, 1]))
