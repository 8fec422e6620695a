"""What commands do while the solver searches: they hold, and follow the newest target only."""

import numpy as np
import pytest
from control_rig import Rig, model, reachable

from tendon_robot_ros.common.errors import NoEquilibriumError
from tendon_robot_ros.control import Target, Twist, target_search
from tendon_robot_ros.control.status import controller_status, controller_values
from tendon_robot_ros.model.shape import Reach
from tendon_robot_ros.model.tip_task import TipTask


class Gate:
    """Answers jobs when a test says so: a model as slow as one likes."""

    def __init__(self):
        self.jobs, self.late = {}, False

    def post(self, kind, work, done, budget=np.inf, urgent=False):
        self.jobs[kind] = work, done

    def call_soon(self, take):
        take()

    def busy(self, kind):
        return kind in self.jobs

    def serve(self):
        pass

    def answer(self, kind):
        work, done = self.jobs.pop(kind)
        try:
            done(work(lambda: self.late), None)
        except NoEquilibriumError as error:
            done(None, error)


@pytest.fixture
def rig():
    rig = Rig()
    rig.core.solver = Gate()
    rig.run(0.1)
    return rig


def test_while_it_searches_it_holds_says_so_and_can_be_stopped(rig):
    rig.core.aim(Target(reachable().position, stamp='new'))
    held = rig.run(3.0)
    assert len(rig.outputs) == 620  # a command in every cycle
    assert held.tensions.tolist() == [0.1] * 4
    said = controller_status(rig.core, rig.now)
    assert said.code == 'searching'
    assert said.message == 'looking for tensions for the target, for 3.0 s'
    values = controller_values(rig.core, rig.now)
    assert (values['target_stamp'], values['moving']) == ('new', 'true')
    rig.core.latch.stop('stop', 'stop was called')
    assert rig.run(0.1) is None
    rig.core.reset()
    rig.core.solver.answer('target')  # much too late
    rig.run(0.5)
    assert rig.tensions.tolist() == [0.1] * 4
    assert rig.code() == 'holding'


def test_it_goes_on_to_the_old_target_until_the_new_one_is_found(rig):
    old, new = reachable(), reachable((0.1, 0.8, 0.3, 0.1))
    rig.core.aim(old)
    rig.core.solver.answer('target')
    rig.run(0.02)
    rig.core.aim(new)
    rig.run(1.0)
    assert model().shape(rig.tensions).tip_position == pytest.approx(old.position, abs=1e-4)
    rig.core.solver.answer('target')
    rig.run(1.0)
    assert rig.core.target is new
    assert rig.code() == 'reached'


def test_of_two_targets_only_the_newest_counts(rig):
    rig.core.aim(reachable())
    first = rig.core.solver.jobs['target']
    rig.run(1.0)
    new = reachable((0.1, 0.8, 0.3, 0.1))
    rig.core.aim(new)
    first[1](first[0](lambda: True), None)
    assert rig.core.solution is None  # the result of an outdated target
    rig.core.solver.answer('target')
    assert rig.core.target is new


def test_targets_that_come_faster_than_the_model_answers_are_followed_all_the_same(rig):
    rig.core.aim(reachable((0.5, 0.1, 0.1, 0.9)))
    rig.core.solver.answer('target')
    rig.run(1.0)
    near = reachable((0.52, 0.1, 0.1, 0.9))
    rig.core.aim(near)
    first = rig.core.solver.jobs['target']
    assert rig.core.search.budget == 0.2  # a second passed: a new target
    rig.run(0.1)
    rig.core.aim(reachable((0.54, 0.1, 0.1, 0.9)))
    assert rig.core.search.budget == pytest.approx(0.08)  # most of the time between the two
    assert rig.code() == 'moving'
    rig.run(0.09)
    assert rig.code() == 'searching'
    first[1](first[0](lambda: True), None)  # an older one of the stream is on the way
    assert rig.core.target is near
    assert rig.core.search is not None


def test_what_is_found_when_time_ends_is_used_and_nothing_is_said(rig, monkeypatch):
    rig.core.solver.late = True
    rig.core.aim(Target(np.array([0.2, 0.0, 0.2])))
    rig.core.solver.answer('target')
    rig.core.solver.answer('target')
    rig.run(3.0)
    assert rig.code() == 'nearest'
    assert 'as near as found in time' in controller_status(rig.core, rig.now).message

    def fail(*args, **kwargs):
        raise NoEquilibriumError('any start of the search', (), 1.0)

    monkeypatch.setattr(target_search, 'reach', fail)
    rig.core.aim(reachable())
    rig.core.solver.answer('target')
    rig.core.solver.answer('target')
    assert rig.code() == 'refused_no_time'
    assert 'the search ended after 0.2 s' in controller_status(rig.core, rig.now).message


def test_what_is_found_first_is_on_its_way_while_the_search_goes_on(rig, monkeypatch):
    far = Target(np.array([0.2, 0.0, 0.2]))
    rig.core.predict(rig.now, lambda shape: None)
    rig.core.solver.answer('predict')
    rig.core.solver.late = True
    rig.core.aim(far)
    rig.core.solver.answer('target')
    first, before = rig.core.solution, model().shape([0.1] * 4)
    assert first.position_error < np.linalg.norm(before.tip_position - far.position)
    assert rig.core.search is not None
    rig.run(0.1)
    assert np.ptp(rig.tensions) > 0.01  # on the way
    rig.core.solver.late = False
    rig.core.solver.answer('target')
    assert rig.core.search is None
    found, high = rig.core.solution, model().limits[:, 1]
    task = TipTask.at(model(), far.position)
    worth = [task.worth(0.5 * one.position_error**2, one.tensions) for one in (first, found)]
    assert worth[1] <= worth[0]
    assert max(first.tensions.max(), found.tensions.max()) < high.max()  # it is beyond reach
    # what is no nearer than the arm is not gone to
    rig.run(3.0)
    rig.core.predict(rig.now, lambda shape: None)
    rig.core.solver.answer('predict')
    held, rig.core.solver.late = rig.core.solution, True
    nearest = Reach(before, 0.1, 0.0, 'nearest', ())
    monkeypatch.setattr(target_search, 'reach', lambda *_: nearest)
    rig.core.aim(Target(held.shape.tip_position))
    rig.core.solver.answer('target')
    assert rig.core.solution is held


def test_a_twist_ends_in_time_however_slow_the_model_is(rig):
    twist = Twist(np.array([0.02, 0.0, 0.0]), np.zeros(3))
    rig.core.twist(rig.now, twist)
    rig.core.solver.answer('twist')  # where the tip is
    rig.run(0.05)
    assert rig.code() == 'jogging'
    assert rig.tensions.tolist() == [0.1] * 4
    rig.run(0.2)
    assert rig.code() == 'holding'
    rig.core.solver.answer('twist')
    rig.run(0.2)
    assert rig.tensions.tolist() == [0.1] * 4


def test_in_pull_mode_wires_stay_where_they_were_measured_until_the_model_answers():
    rig = Rig(pull_mode=True)
    rig.core.solver = Gate()
    pulls = model().shape([0.5, 0.1, 0.1, 0.9]).pulls
    for _ in range(100):
        rig.now += 0.005
        rig.core.measured(rig.now, np.full(4, np.nan), pulls)
        assert rig.core.step(rig.now).pulls.tolist() == pulls.tolist()
    rig.core.solver.answer('resync')
    rig.core.aim(reachable((0.1, 0.8, 0.3, 0.1)))
    rig.core.solver.answer('target')
    seen = [pulls]
    for cycle in range(400):
        rig.now += 0.005
        rig.core.measured(rig.now, np.full(4, np.nan), pulls)
        seen.append(rig.core.step(rig.now).pulls)
        if cycle % 10 == 9 and rig.core.solver.busy('piece'):
            rig.core.solver.answer('piece')
    assert seen[9].tolist() == pulls.tolist()
    assert seen[-1] == pytest.approx(rig.core.solution.shape.pulls, abs=1e-9)
    assert np.abs(np.diff(seen, axis=0)).max() < 1e-3  # [m] in a cycle: no jump
