"""The remaining error of the tip in closed loop, and its cause in words."""

import numpy as np
import pytest
from friction_rig import TARGETS, standing

from tendon_robot_ros.common.local_stop import SILENCE_S
from tendon_robot_ros.control import Target
from tendon_robot_ros.control.status import controller_status
from tendon_robot_ros.control.tip_loop import Remainder, TipProgress, foreign

NAMES = ('one', 'two', 'three')
FREE = np.full((2, 3), 0.5)
SPATIAL = np.array([[0.5, -0.25, -0.25], [0.0, 0.4, -0.4], [1e-3, 1e-3, 1e-3]])  # [m]


def remainder(off, slopes=SPATIAL, room=FREE, rest=1e-4, region=''):
    return Remainder(np.array(off), slopes, room, rest, region)


def test_a_direction_in_which_no_tendon_moves_the_tip_is_named_with_its_range():
    cause = remainder([2e-4, 0.0, -1.4e-3]).why(NAMES)
    assert cause.startswith('1.40 mm of it along (0.00, 0.00, -1.00)')
    assert cause.endswith('by 1.73 mm over their whole range')
    planar = SPATIAL * [[1.0], [0.0], [0.0]]
    assert '(0.00, 1.00, 0.00)' in remainder([0.0, 1e-3, 0.0], planar).why(NAMES)


def test_two_tendons_lead_no_tip_out_of_their_plane():
    pair, room = np.array([[0.5, -0.5], [0.0, 0.0], [1e-3, 1e-3]]), FREE[:, :2]
    cause = remainder([0.0, 5e-3, 0.0], pair, room).why(NAMES[:2])
    assert cause.startswith('5.00 mm of it along (0.00, 1.00, 0.00)')


def test_a_tension_at_its_limit_is_named_where_no_other_one_helps():
    high = np.array([[1.0, 0.5, 0.5], [0.0, 0.5, 0.5]])
    assert remainder([1e-3, 0.0, 0.0], room=high).why(NAMES) == ''  # the others may go down
    low = np.array([[1.0, 0.0, 0.0], [0.0, 0.5, 0.5]])
    assert remainder([1e-3, 0.0, 0.0], room=low).why(NAMES) == 'at its limit: one, two, three'
    assert remainder([-1e-3, 0.0, 0.0], room=low).why(NAMES) == ''


def test_a_region_comes_first_and_without_a_known_cause_the_text_is_empty():
    assert remainder([1e-3, 0.0, 0.0], region='lamp').why(NAMES) == 'kept out of lamp'
    assert remainder([1e-3, 1e-3, 0.0]).why(NAMES) == ''


def test_an_error_within_the_noise_counts_as_reached():
    assert remainder([2.9e-4, 0.0, 0.0]).reached and not remainder([3.1e-4, 0.0, 0.0]).reached
    assert remainder([9e-4, 0.0, 0.0], rest=5e-4).reached


def test_the_remainder_is_reported_once_it_is_constant_and_a_new_target_restarts():
    progress, target = TipProgress(), object()
    for now in np.arange(0.0, 5.0, 0.02):  # away by a time constant of 0.5 s, then 1 mm
        progress.take(now, target, remainder([1e-3 + 0.1 * np.exp(-now / 0.5), 0.0, 0.0]))
        if progress.settled(now):
            break
    assert 3.0 < now < 4.5
    progress.take(now, target, remainder([5e-3, 0.0, 0.0]))
    assert progress.settled(now) is None
    assert progress.settled(now + SILENCE_S) is not None
    progress.take(now + 2.0, object(), remainder([5e-3, 0.0, 0.0]))
    assert progress.settled(now + 2.0) is None


@pytest.mark.parametrize('remembers', [False, True])
def test_a_model_that_is_far_off_its_arm_leads_to_diagnose(remembers):
    assert foreign(0.009, 0.2, remembers) == ''
    said = foreign(0.025, 0.2, remembers)
    assert said.startswith('the model is 25 mm off the arm here') and 'diagnose' in said
    assert ('friction_memory' in said) != remembers
    assert foreign(0.025, 0.2, remembers, known=0.013) == ''
    assert foreign(0.025, 0.2, remembers, known=0.012) == said


def seen(shift, seconds=5.0):
    """Close the loop on an arm whose tip is shifted (3,) [m] from its model's."""
    rig, codes = standing(remembers=False, tip_gain=5.0), []
    rig.core.aim(Target(rig.arm.shape(np.array(TARGETS[0])).tip_position))
    for _ in range(round(seconds / 0.02)):
        rig.run(0.02)
        rig.core.tip_measured(rig.now, rig.shape.tip_position + shift)
        codes.append(rig.code())
    return controller_status(rig.core, rig.now), codes


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
