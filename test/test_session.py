"""The class of what cannot be told apart: its limit, its order, and what drops out of it."""

from types import SimpleNamespace

import pytest
import simulated
from simulated import CATALOGUE, measured

from tendon_robot_ros.diagnosis.verdict import APART_FROM_SCORE, indistinct
from tendon_robot_ros.inference.candidates import Candidate, Ranked
from tendon_robot_ros.inference.session import Session

ROBOT = simulated.robot()


def ranked(name, chi2, rank=1, probability=0.5):
    """Return a candidate that needs no fit to be judged."""
    fit = SimpleNamespace(deviance=chi2, rank=rank, probability=lambda freedom: probability)
    return Ranked(Candidate((name,), (), False), fit, 100.0, None)


def names(group):
    return [one.candidate.names[0] for one in group]


@pytest.fixture
def session():
    return Session(measured(ROBOT, count=2), ROBOT, CATALOGUE, workers=1)


def test_the_class_ends_at_its_limit(session):
    fits = [ranked('hinge_friction', 100.0), ranked('tip_load', 100.0 + APART_FROM_SCORE - 0.01),
            ranked('gravity', 100.0 + APART_FROM_SCORE + 0.01)]  # fmt: skip
    assert names(indistinct(session, fits)) == ['hinge_friction', 'tip_load']


def test_what_is_not_adequate_does_not_belong_to_the_class(session):
    fits = [ranked('hinge_friction', 100.0), ranked('tip_load', 99.0, probability=5e-4)]
    assert names(indistinct(session, fits)) == ['hinge_friction']


def test_more_parameters_cost_two_each(session):
    fits = [
        ranked('hinge_friction', 100.0, 1),
        ranked('gravity', 100.0 + APART_FROM_SCORE - 5.0, 4),
    ]
    assert names(indistinct(session, fits)) == ['hinge_friction']


def test_ties_go_by_the_order_of_the_catalogue(session):
    fits = [ranked('backbone_stiffness', 100.3), ranked('transmission_loss', 100.0)]
    assert names(indistinct(session, fits)) == [
        'backbone_stiffness',
        'transmission_loss',
    ]
    fits = [ranked('backbone_stiffness', 103.0), ranked('transmission_loss', 100.0)]
    assert names(indistinct(session, fits)) == [
        'transmission_loss',
        'backbone_stiffness',
    ]


def test_a_section_of_its_own_contains_the_whole_backbone(session):
    fits = [ranked('section_stiffness', 100.0, 2), ranked('backbone_stiffness', 101.0, 1)]
    assert names(indistinct(session, fits)) == ['backbone_stiffness']


def fitted(hidden, robot=ROBOT):
    session = Session(measured(robot, hidden, count=12), robot, CATALOGUE, workers=1)
    session.weigh({})
    tested, _ = session.split_tested({})
    return session, {r.candidate.names[0]: r for r in session.fit_all(tested)}


def test_a_larger_candidate_that_can_do_the_same_drops_out():
    robot = simulated.robot('kato_10_1')
    session, found = fitted({'tendon_stiffness': {'per_tendon': 5e-4}}, robot)
    assert session.contains(found['section_stiffness'], found['tendon_stiffness'])
    assert not session.contains(found['tendon_stiffness'], found['section_stiffness'])
    assert not session.contains(found['tip_load'], found['tendon_stiffness'])


def test_exact_twins_fit_alike_and_the_first_is_best():
    session, found = fitted({'transmission_loss': {'fraction': 0.08}})
    twins = [found['backbone_stiffness'], found['transmission_loss']]
    assert twins[0].fit.chi2 == pytest.approx(twins[1].fit.chi2, abs=0.05)
    assert session.best(list(found.values())).candidate.names == ('backbone_stiffness',)


def test_workers_do_not_change_the_result():
    dataset = measured(ROBOT, {'hinge_friction': {'lever': 2e-4}}, count=5)
    results = []
    for workers in (1, 3):
        session = Session(dataset, ROBOT, CATALOGUE, workers=workers)
        session.weigh({})
        tested, _ = session.split_tested({})
        results.append([(r.candidate.label, r.fit.chi2) for r in session.fit_all(tested)])
    assert [name for name, _ in results[0]] == [name for name, _ in results[1]]
    for (_, one), (_, other) in zip(*results, strict=True):
        assert one == pytest.approx(other, rel=1e-4)
