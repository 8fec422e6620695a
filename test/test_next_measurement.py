"""The proposed posture separates what could not be told apart, more often than a random one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import simulated
from simulated import measure, postures

from tendon_robot_ros.diagnosis.diagnose import diagnose
from tendon_robot_ros.diagnosis.next_measurement import _conditions, input_grid, propose
from tendon_robot_ros.effects import load_catalogue

ROBOT = simulated.robot()
ONE_TENDON = np.outer([0.3, 0.5, 0.7, 0.9, 1.1, 1.3], [1.0, 0.0])
HIDDEN = [
    {'hinge_friction': {'lever': 2e-4}},
    {'tension_offset': {'offset': 0.03}},
    {'eyelet_clearance': {'clearance': 1.5e-4}},
    {'tip_load': {'force_x': 2e-3}},
]


def size(found):
    return max(len(found.cannot_tell_apart), 1)


def after(inputs, hidden, seed, tensions):
    """Return the size of the class once one more posture was measured."""
    return size(diagnose(measure(postures(ROBOT, [*inputs, tensions]), hidden, seed=seed)))


def test_postures_are_proposed_where_all_those_used_have_the_same_total_tension():
    pulled = np.linspace(0.5, 1.2, 6)
    grid = input_grid(postures(ROBOT, np.column_stack([pulled, 1.7 - pulled])), (0.0, 1.2))
    assert len(grid) > 0
    assert grid.max() <= 1.2 and grid.sum(axis=1).min() > 1.7


def test_nothing_is_proposed_where_the_tensions_used_are_the_limits():
    limited = replace(ROBOT, tension_limits=(0.0, 1.0))
    used = postures(limited, [[1.0, 1.0]] * 3)
    assert propose(SimpleNamespace(dataset=used, robot=limited), []) is None


def test_an_arm_that_is_turned_over_has_gravity_the_other_way_round_and_no_minus_zero():
    hung = SimpleNamespace(robot=replace(ROBOT, gravity=(9.81, 0.0, 0.0)))
    used, group = postures(ROBOT, ONE_TENDON), SimpleNamespace(names=('gravity',))
    session = SimpleNamespace(
        dataset=used, robot=ROBOT, predictor=hung, catalogue=load_catalogue()
    )
    (_, (_, turned, _)) = _conditions(session, [SimpleNamespace(candidate=group)])
    assert str(turned.tolist()) == '[-9.81, 0.0, 0.0]'


@pytest.mark.blind
def test_a_proposal_shrinks_the_class_more_often_than_a_random_posture(capsys):
    random, shrunk, rows = np.random.default_rng(5), {'proposed': [], 'random': []}, []
    for seed in range(4):
        for hidden in HIDDEN:
            first = diagnose(measure(postures(ROBOT, ONE_TENDON), hidden, seed=seed))
            step = first.next_measurement
            if first.verdict != 'ambiguous' or step is None or step.difference < 2 * step.noise:
                continue
            proposed = [step.input[name] for name in ROBOT.inputs]
            anywhere = random.uniform(0.0, 1.25 * 1.3, 2)
            sizes = [after(ONE_TENDON, hidden, 50 + seed, t) for t in (proposed, anywhere)]
            for key, one in zip(shrunk, sizes, strict=True):
                shrunk[key].append(one < size(first))
            rows.append((next(iter(hidden)), size(first), *sizes))
    rates = {key: float(np.mean(hits)) for key, hits in shrunk.items()}
    with capsys.disabled():
        print(f'\nof {len(rows)} ambiguous cases the class shrank: {rates}')
        for name, before, proposed, anywhere in rows:
            print(f'{name:20s} {before} -> {proposed} (proposed), {anywhere} (random)')
    assert len(rows) >= 8
    assert rates['proposed'] >= 0.8
    assert rates['proposed'] >= rates['random']
    assert np.mean([row[2] for row in rows]) <= np.mean([row[3] for row in rows])
