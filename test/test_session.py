"""Fits of candidates side by side: which contain others, and which is best."""

import pytest
import simulated
from simulated import CATALOGUE, measured

from tendon_robot_ros.inference.session import Question
from tendon_robot_ros.inference.statistics import first_of_best

ROBOT = simulated.robot()


def fitted(hidden, robot=ROBOT):
    session = Question.of(measured(robot, hidden, count=12), robot, CATALOGUE).weigh()
    tested = session.tested(session.candidates, {})
    return session, {r.candidate.names[0]: r for r in session.fit_all(tested)}


def test_a_larger_candidate_that_can_do_the_same_drops_out():
    robot = simulated.robot('kato_10_1')
    session, found = fitted({'tendon_stiffness': {'per_tendon': 5e-4}}, robot)
    assert session.contains(found['section_stiffness'], found['tendon_stiffness'])
    assert not session.contains(found['tendon_stiffness'], found['section_stiffness'])
    assert not session.contains(found['tip_load'], found['tendon_stiffness'])


def test_exact_twins_fit_alike_and_the_first_is_best():
    _, found = fitted({'transmission_loss': {'fraction': 0.08}})
    twins = [found['backbone_stiffness'], found['transmission_loss']]
    assert twins[0].fit.chi2 == pytest.approx(twins[1].fit.chi2, abs=0.05)
    assert first_of_best(list(found.values())).names == ('backbone_stiffness',)
