"""An arm as it is built, learned from references: what is misread, what is new, what changes."""

import numpy as np
import pytest
from marks import slow
from source_tree import ROOT
from watched_arm import ROBOT, alarm_of, alarms, averaged, postures, untaught

from tendon_robot_ros.monitoring.references import Reference, contradicted
from tendon_robot_ros.monitoring.watch import DriftAlarm
from tendon_robot_ros.robot import load_robot
from tendon_robot_ros.simulation.hidden import Workmanship
from tendon_robot_ros.simulation.plant import make_plant


def references(random, count=30, sizes=1.0):
    """Return postures of an arm of four imperfections; the errors of each so much larger."""
    known = random.normal(size=4)
    for size in np.broadcast_to(sizes, count):
        columns = random.normal(size=(60, 4))
        off = columns @ known + size * random.normal(size=60)
        yield Reference(off, columns, np.eye(60))


@pytest.mark.long
def test_of_good_references_one_in_a_thousand_arms_loses_one_and_of_misread_ones_all_are_found():
    random, counts = np.random.default_rng(5), np.ones(30, dtype=bool)
    good = [contradicted(list(references(random)), counts).any() for _ in range(400)]
    assert sum(good) <= 3
    off = np.where(np.isin(np.arange(30), [3, 4, 20]), 4.0, 1.0)
    for wide in (1.0, 20.0):  # what is thought to be new in every posture
        seen = [r._replace(scatter=wide * r.scatter) for r in references(random, 30, off)]
        assert np.flatnonzero(contradicted(seen, counts)).tolist() == [3, 4, 20]
    few = list(references(random, 9, np.append(np.ones(8), 50.0)))
    assert not contradicted(few, counts[:9]).any(), 'nine cannot tell what is usual'
    assert not contradicted([None, *few], counts[:10]).any()


def test_where_a_model_is_wrong_here_and_there_no_reference_is_misread():
    random, counts = np.random.default_rng(6), np.ones(30, dtype=bool)
    off = np.exp(0.3 * random.normal(size=30))
    assert not contradicted(list(references(random, 30, off)), counts).any()


@pytest.fixture(scope='module')
def well_known():
    """Return an arm as it is built, learned from the mean of thirty frames, tensions as read."""
    random, free = np.random.default_rng(3), make_plant(ROBOT, {}, seed=12, work=Workmanship())
    arm = untaught(ROBOT)
    arm.fit(*averaged(free, postures(60, 1012), random), 30)
    return arm, free, random


@pytest.mark.long
def test_noise_is_learned_at_its_size_and_innovations_vary_as_expected(well_known):
    arm, free, random = well_known
    assert arm.setting * arm.plausible[arm._gains[0]] == pytest.approx(0.001)
    assert arm.remainder == 0.0
    assert arm.widening < 1.7
    arm = arm.as_known(arm.mean, arm.covariance)
    scores = arm._follow(*averaged(free, postures(32, 5012), random), 30)
    off, told = (np.sum([score[i] for score in scores], axis=0) for i in (0, 1))
    both = np.linalg.solve(told + np.eye(len(off)), np.column_stack([off, told]))
    assert 0.4 < off @ both[:, 0] / np.trace(both[:, 1:]) < 1.6  # all postures as one batch


@pytest.mark.long
def test_where_an_arm_hardly_bends_and_kinks_turn_its_friction_over_nothing_is_told():
    """Both tendons of a section pull nearly alike: the markers may be 1 mm off the tangent."""
    robot = load_robot(ROOT / 'config' / 'robots' / 'kato_10_1.yaml')
    random, free = np.random.default_rng(3), make_plant(robot, {}, seed=3, work=Workmanship())
    arm = untaught(robot)
    rows = postures(60, 1003, robot)
    arm.fit(*averaged(free, rows, random), 30)
    alarm, turning = DriftAlarm(arm, 21600.0), np.array([[0.318, 0.422, 0.402, 0.299]])
    (read,), (seen,) = averaged(free, turning, random)
    expected = arm.expected(read)
    assert np.abs(expected.markers - seen.ravel()).max() > 5e-4
    smooth, new = arm.expected(np.array([0.1, 0.5, 0.1, 0.3])), len(arm.mean)
    assert np.abs(expected.columns[:, new:]).max() > 2e-4
    assert np.abs(smooth.columns[:, new:]).max() < 5e-6
    assert alarm.update(read, seen, 30).evidence < 100.0


@pytest.mark.parametrize('cell', [slow(3), 4, slow(6)])
@pytest.mark.long
def test_a_slightly_softer_cell_is_told_within_twenty_postures(well_known, cell):
    arm, _, random = well_known
    alarm = alarm_of(arm)
    soft = {'soft_cell': {'cell': cell, 'factor': 0.95}}
    plant = make_plant(ROBOT, soft, seed=12, work=Workmanship())
    assert alarms(alarm, *averaged(plant, postures(20, 2012), random))[-1]
    assert alarm.state.suspects[0].name in [f'stiffness of cell {cell + i}' for i in range(-1, 2)]


ODD_POSTURES = {
    'the frame of the tracker 2 mm off': (1.0, np.array([0.0, 2e-3, 0.0])),
    'a tension read 20 % wrong': (np.array([1.2, 1.0, 1.0]), np.zeros(3)),
    'everything 1 m off': (1.0, np.array([1.0, 0.0, 0.0])),
}


@pytest.mark.parametrize('seed', [12, slow(14)])
@pytest.mark.parametrize('what', [*list(ODD_POSTURES)[:2], slow('everything 1 m off')])
@pytest.mark.long
def test_the_filter_learns_nothing_of_one_odd_posture_and_no_alarm_comes_of_it(
    well_known, what, seed
):
    arm, free, random = well_known
    read, seen = averaged(free, postures(31, 1000 * seed), random)
    alarm, without = alarm_of(arm), alarm_of(arm)
    gain, shift = ODD_POSTURES[what]
    first = alarm.update(gain * read[0], seen[0] + shift, 30)
    assert first.evidence > alarm.threshold and not first.alarm
    assert not any(alarms(alarm, read[1:], seen[1:]))
    alarms(without, read[1:], seen[1:])
    assert alarm.arm.mean == pytest.approx(without.arm.mean, abs=1e-12)
    assert alarm.state.evidence < 50.0


@pytest.mark.long
def test_the_filter_stays_the_arm_that_was_when_the_tracker_is_moved_far(well_known):
    """It followed by hundreds of sd, and ended without a positive covariance."""
    arm, _, random = well_known
    alarm = alarm_of(arm)
    moved = make_plant(ROBOT, {}, seed=12, work=Workmanship())
    moved.built.position[:] += [0.012, 0.0, 0.016]
    moved.built.rotation[:] += [0.0, np.radians(10.0), 0.0]
    told = alarms(alarm, *averaged(moved, postures(4, 6012), random))
    assert told == [False, True, True, True]
    assert alarm.arm.mean == pytest.approx(arm.mean, abs=1e-12)
    assert alarm.state.suspects[0].name == 'the tracker'


@pytest.mark.long
def test_a_load_after_an_odd_posture_is_told_and_named_as_without_it(well_known):
    arm, free, random = well_known
    alarm = alarm_of(arm)
    read, seen = averaged(free, postures(8, 3012), random)
    seen[1] += [0.0, 2e-3, 0.0]
    assert not any(alarms(alarm, read, seen))
    loaded = make_plant(ROBOT, {'tip_load': {'force_x': 0.004}}, seed=12, work=Workmanship())
    told = alarms(alarm, *averaged(loaded, postures(4, 4012), random))
    assert told == [False, True, True, True]
    assert alarm.state.suspects[0].name == 'tip_load'
    assert alarm.state.suspects[0].values['force_x'] == pytest.approx(0.004, rel=0.1)
