"""Fits side by side: those far behind are left there, the others are as if fitted alone."""

import pytest
import simulated
from simulated import CATALOGUE, measured

from tendon_robot_ros.inference.session import Question, side_by_side

ROBOT = simulated.robot()
HIDDEN = {'tip_load': {'force_x': 5e-3}}


@pytest.fixture(scope='module')
def session():
    made = Question.of(measured(ROBOT, HIDDEN, count=6), ROBOT, CATALOGUE, workers=2).weigh({})
    return made


def alone(session, candidate):
    """Return the deviance of a fit that knows of no other."""
    return session.fitters[0].fit(candidate.frees).deviance


def test_the_best_is_fitted_as_if_it_were_alone_and_those_far_behind_are_left(session):
    tested, _ = session.split_tested({})
    race = session.race(tested)
    deviances = {candidate.label: fit.deviance for candidate, fit in race.run()}
    stopped = {candidate.label for candidate, _ in race.stopped_early()}
    assert set(deviances) == {candidate.label for candidate in tested}
    assert min(deviances, key=deviances.get) == 'tip_load' not in stopped
    assert 'hinge_friction' in stopped
    for candidate in tested:
        if candidate.label not in stopped:
            assert deviances[candidate.label] == pytest.approx(alone(session, candidate), abs=1e-3)


def test_what_was_left_behind_can_go_on_to_its_end(session):
    names = ('tip_load', 'hinge_friction')
    race = session.race([c for c in session.candidates if c.label in names])
    before = dict(race.run())
    ended = race.go_on()
    assert [candidate.label for candidate, _ in ended] == ['hinge_friction']
    for candidate, fit in ended:
        assert fit.deviance <= before[candidate].deviance + 1e-6
        assert fit.deviance == pytest.approx(alone(session, candidate), abs=1e-3)


def test_all_tasks_are_done_each_by_one_worker():
    done = []
    tasks = [lambda worker, i=i: done.append((i, worker)) for i in range(5)]
    side_by_side(tasks, 2)
    assert sorted(done) == [(0, 0), (1, 1), (2, 0), (3, 1), (4, 0)]
