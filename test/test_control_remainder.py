"""What the closed loop says of the way that is left to the target."""

import numpy as np
import pytest

from tendon_robot_ros.control import ControllerCore, Settings, Target
from tendon_robot_ros.control.status import controller_status
from tendon_robot_ros.control.tip_loop import NO_NEARER_S, Remainder, TipProgress, foreign
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot

CYCLE = 0.005  # [s]
NAMES = ('one', 'two', 'three')
FREE = np.full((2, 3), 0.5)
SPATIAL = np.array([[0.5, -0.25, -0.25], [0.0, 0.4, -0.4], [1e-3, 1e-3, 1e-3]])  # [m]


def left(off, slopes=SPATIAL, room=FREE, rest=1e-4, region=''):
    return Remainder(np.array(off), slopes, room, rest, region)


def test_what_no_tendon_leads_the_tip_along_is_said_with_direction_and_reach():
    said = left([2e-4, 0.0, -1.4e-3]).why(NAMES)
    assert said.startswith('1.40 mm of it along (0.00, 0.00, -1.00)')
    assert said.endswith('by 1.73 mm over their whole range')
    planar = SPATIAL * [[1.0], [0.0], [0.0]]
    assert '(0.00, 1.00, 0.00)' in left([0.0, 1e-3, 0.0], planar).why(NAMES)


def test_a_tension_that_cannot_go_on_is_named_where_no_other_helps():
    high = np.array([[1.0, 0.5, 0.5], [0.0, 0.5, 0.5]])
    assert left([1e-3, 0.0, 0.0], room=high).why(NAMES) == ''  # the others may go down
    low = np.array([[1.0, 0.0, 0.0], [0.0, 0.5, 0.5]])
    assert left([1e-3, 0.0, 0.0], room=low).why(NAMES) == 'at its limit: one, two, three'
    assert left([-1e-3, 0.0, 0.0], room=low).why(NAMES) == ''


def test_a_region_comes_first_and_where_nothing_is_known_nothing_is_said():
    assert left([1e-3, 0.0, 0.0], region='lamp').why(NAMES) == 'kept out of lamp'
    assert left([1e-3, 1e-3, 0.0]).why(NAMES) == ''


def test_what_is_within_the_noise_is_none():
    assert left([2.9e-4, 0.0, 0.0]).reached and not left([3.1e-4, 0.0, 0.0]).reached
    assert left([9e-4, 0.0, 0.0], rest=5e-4).reached


def test_it_is_told_once_the_tip_comes_no_nearer_and_anew_for_another_target():
    over, target = TipProgress(), object()
    for now in np.arange(0.0, 5.0, 0.02):  # away by a time constant of 0.5 s, then 1 mm
        over.take(now, target, left([1e-3 + 0.1 * np.exp(-now / 0.5), 0.0, 0.0]))
        if over.settled(now):
            break
    assert 3.0 < now < 4.5
    over.take(now, target, left([5e-3, 0.0, 0.0]))
    assert over.settled(now) is None
    assert over.settled(now + NO_NEARER_S) is not None
    over.take(now + 2.0, object(), left([5e-3, 0.0, 0.0]))
    assert over.settled(now + 2.0) is None


@pytest.mark.parametrize('remembers', [False, True])
def test_a_model_that_is_far_off_its_arm_leads_to_diagnose(remembers):
    assert foreign(0.009, 0.2, remembers) == ''
    said = foreign(0.025, 0.2, remembers)
    assert said.startswith('the model is 25 mm off the arm here') and 'diagnose' in said
    assert ('friction_memory' in said) != remembers


def seen(shift, seconds=5.0):
    """Close the loop on an arm whose tip is shifted (3,) [m] from its model's."""
    core = ControllerCore(Model(load_robot('kato_10_1')), Settings(tip_gain=5.0))
    arm = Model(load_robot('kato_10_1'))
    shape, codes = arm.shape(np.full(4, 0.1)), []
    for step in range(round(seconds / CYCLE)):
        now = CYCLE * step
        core.measured(now, shape.inputs, shape.pulls)
        if step == 5:
            core.aim(Target(arm.shape(np.array([0.9, 0.1, 0.1, 0.5])).tip_position))
        output = core.step(now)
        if output is not None:
            shape = arm.follow(shape, output.tensions)
        if step % 6 == 0:
            core.predict(now, lambda shape: None)
        if step % 4 == 0:
            core.tip_measured(now, shape.tip_position + shift)
            codes.append(controller_status(core, now).code)
    return controller_status(core, now), codes


def test_reached_is_what_the_tracker_sees():
    said, codes = seen([0.004, 0.0, 0.0])
    assert said.code == 'reached' and said.message.endswith('as the tracker sees it')
    assert 'nearest' not in codes
    assert codes.index('reached') > 50  # not while the loop is on its way


def test_a_tip_out_of_the_plane_of_its_arm_is_not_called_reached():
    said, codes = seen([0.0, 0.003, 0.0])
    assert said.code == 'nearest' and 'reached' not in codes
    assert 'as near as it can, 3.00 mm from the target: 3.00 mm of it along (' in said.message
    assert 'by 0.00 mm over their whole range' in said.message


def test_a_loop_that_is_far_from_its_model_says_what_to_do():
    said, _ = seen([0.014, 0.0, 0.0])
    assert said.code == 'reached'
    assert 'the model is 14 mm off the arm here' in said.message
    assert 'friction_memory; diagnose tells which' in said.message
