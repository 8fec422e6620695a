"""The solver in a thread of its own: commands never wait for it, only the newest target counts."""

import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from control_rig import Rig, model, reachable
from processes import run

from tendon_robot_ros.common import processes
from tendon_robot_ros.common.errors import NoEquilibriumError
from tendon_robot_ros.control import Target, Twist
from tendon_robot_ros.control.solver import Worker
from tendon_robot_ros.control.status import controller_status
from tendon_robot_ros.model.shape import Reach
from tendon_robot_ros.model.tip_task import Patience

ROBOTS = Path(__file__).parent.parent / 'config' / 'robots'
ENDS_WHILE_SEARCHING = """
import os, sys, time
from tendon_robot_ros.control.solver import Worker
from tendon_robot_ros.model.model import Model
from tendon_robot_ros.robot import load_robot

model = Model(load_robot(sys.argv[1]))
low = model.limits[:, 0]
model.reach([1.0, 0.3, 0.1], guess=model.shape(low), starts=0)
for count in range(4):
    child = os.fork()
    if child == 0:
        break
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
else:
    sys.exit()


def search(give_up):
    while not give_up():
        model.reach([1.0, 0.3, 0.1], guess=model.shape(low), starts=0)


worker = Worker()
worker.post('target', search, print)
time.sleep(0.01 + 0.002 * count)
"""


@pytest.fixture
def worker():
    made = Worker()
    yield made
    made.close()


def until(condition, what):
    end = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < end, f'waited in vain for {what}'
        time.sleep(0.001)


def served(worker, condition, what):
    def done():
        worker.serve()
        return condition()

    until(done, what)


def test_answers_come_in_the_thread_that_serves(worker):
    said = []
    worker.post(
        'a', lambda give_up: threading.current_thread().name, lambda *got: said.append(got)
    )
    assert worker.busy('a')
    served(worker, lambda: said, 'an answer')
    assert said == [('solver', None)]
    assert not worker.busy('a')


def test_a_newer_job_replaces_the_one_that_waits_and_asks_the_one_that_runs_to_give_up(worker):
    running, said = threading.Event(), []

    def patient(give_up):
        running.set()
        until(give_up, 'being asked to give up')
        return 'given up'

    take = lambda result, error: said.append(result)  # noqa: E731
    worker.post('a', patient, take)
    assert running.wait(10.0)
    worker.post('b', lambda give_up: 'of another kind', take)
    worker.post('a', lambda give_up: 'never begun', take)
    worker.post('a', lambda give_up: 'newest', take)
    served(worker, lambda: len(said) == 3, 'three answers')
    assert said == ['given up', 'of another kind', 'newest']
    assert not worker.busy('a')


def test_after_its_budget_a_job_is_asked_to_give_up(worker):
    said = []
    worker.post(
        'a', lambda give_up: until(give_up, 'the end'), lambda *got: said.append(got), 0.02
    )
    served(worker, lambda: said, 'an answer')


def test_what_work_tells_is_heard_before_its_end_in_the_thread_that_serves():
    woken, heard, goes_on = threading.Event(), [], threading.Event()
    worker = Worker(woken.set)

    def work(give_up):
        worker.tell(lambda: heard.append(threading.current_thread().name))
        assert goes_on.wait(20.0)
        return 'the end'

    worker.post('a', work, lambda result, error: heard.append(result))
    assert woken.wait(20.0)
    worker.serve()
    assert heard == [threading.current_thread().name]
    assert worker.busy('a')
    goes_on.set()
    served(worker, lambda: len(heard) == 2, 'the end')
    assert heard[1] == 'the end'
    worker.close()


def test_the_time_of_a_job_begins_when_it_does_and_what_was_ended_stays_so(worker):
    said = []
    worker.post('a', lambda give_up: time.sleep(0.05), lambda *got: None)
    worker.post('b', lambda give_up: give_up(), lambda *got: said.append(got), 0.04)
    served(worker, lambda: said, 'an answer')
    assert said == [(False, None)]
    patience = Patience(0.0)
    assert patience()
    patience.prolong(100.0)
    assert not patience()
    patience.end()
    patience.prolong(100.0)
    patience.begin()
    assert patience()


def test_a_refusal_is_an_answer_and_a_mistake_of_the_code_is_raised(worker):
    said = []

    def refuse(give_up):
        raise NoEquilibriumError('here', (), 1.0)

    worker.post('a', refuse, lambda *got: said.append(got))
    served(worker, lambda: said, 'an answer')
    assert isinstance(said[0][1], NoEquilibriumError)
    worker.post('a', lambda give_up: 1 / 0, lambda *got: said.append(got))
    with pytest.raises(ZeroDivisionError):
        served(worker, lambda: False, 'the error')


def test_a_search_that_runs_does_not_outlive_the_interpreter(tmp_path):
    script = tmp_path / 'ends.py'
    script.write_text(ENDS_WHILE_SEARCHING)
    ended = run([sys.executable, script, ROBOTS / 'spatial_3.yaml'])
    assert ended.stdout.split() == ['0'] * 4, ended.stderr  # nearly all crashed


class Gate:
    """Answers jobs when a test says so: a model as slow as one likes."""

    def __init__(self):
        self.jobs, self.late = {}, False

    def post(self, kind, work, done, budget=np.inf, urgent=False):
        self.jobs[kind] = work, done

    def tell(self, take):
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
    assert said.values['target_stamp'] == 'new'
    assert said.values['moving'] == 'true'
    rig.core.stop('stop', 'stop was called')
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

    monkeypatch.setattr(model(), 'reach', fail)
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
    assert rig.core.solution.position_error <= first.position_error
    # what is no nearer than the arm is not gone to
    rig.run(3.0)
    rig.core.predict(rig.now, lambda shape: None)
    rig.core.solver.answer('predict')
    held, rig.core.solver.late = rig.core.solution, True
    monkeypatch.setattr(model(), 'reach', lambda **_: Reach(before, 0.1, 0.0, 'nearest', ()))
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


LENDS = """
import os, time, threading
from tendon_robot_ros.common.processes import LOAN_MAX_S, REALTIME_PRIORITY_LENT, go_realtime
from tendon_robot_ros.control.solver import SOLVER, Worker

LENT = os.SCHED_RR | os.SCHED_RESET_ON_FORK, REALTIME_PRIORITY_LENT
worker, said = Worker(), []


def lent(give_up=None):
    return (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == LENT


def asked(work, urgent=True, looks=True):
    said.clear()
    worker.post('a', work, lambda *got: said.append(got), urgent=urgent)
    end = time.monotonic() + 10.0
    while not said and time.monotonic() < end:
        time.sleep(0.002)
        if looks:
            worker.limit_realtime()
        worker.serve()
    return said[0][0]


def endless(give_up):
    began = time.monotonic()
    while lent() and time.monotonic() - began < 1.0:
        pass
    return time.monotonic() - began


before = asked(lent)
go_realtime(but=[SOLVER])
worker.lend_realtime()
urgent, other = asked(lent), asked(lent, urgent=False)
took = asked(endless)
time.sleep(LOAN_MAX_S)
waits, seen = threading.Event(), []


def late(give_up):
    waits.wait(10.0)
    seen.append(lent())


worker.post('b', late, lambda *got: None)
worker.post('a', lent, lambda *got: None, urgent=True)
waits.set()
again = asked(lent)
print(before, urgent, other, 0.4 * LOAN_MAX_S < took < LOAN_MAX_S + 0.2, seen[0], again)
worker.close()
"""


def test_work_is_done_in_real_time_and_never_for_long_where_that_is_allowed():
    allowed = run(['chrt', '-r', '5', 'true']).returncode == 0
    said = run([sys.executable, '-c', LENDS])
    wanted = (False, True, True, True, True, True) if allowed else (False,) * 6
    assert said.stdout.split() == [str(one) for one in wanted], said.stderr


def test_real_time_is_lent_for_its_share_of_the_time_only(monkeypatch):
    now, lent = [0.0], []
    monkeypatch.setattr(processes.time, 'monotonic', lambda: now[0])
    monkeypatch.setattr(processes, '_scheduled', lambda *how: lent.append(how[2]) or True)
    loan, sum_lent = processes.RealtimeLoan(), 0.0
    for _ in range(10_000):  # asked for all the time
        loan.begin(1)
        now[0] += 1e-3
        sum_lent += 1e-3 * (lent[-1] > 0)
        loan.limit()
    assert sum_lent == pytest.approx(processes.LOAN_SHARE * now[0], rel=0.1)
    loan.begin(1)
    loan.end()
    told = len(lent)
    now[0] += 10.0
    loan.limit()
    assert len(lent) == told, 'who waits for work gives back nothing: it may hold the lock'
    loan.begin(1)
    now[0] += 0.99 * processes.LOAN_MAX_S
    loan.limit()
    assert lent[-1] == processes.REALTIME_PRIORITY_LENT
    now[0] += 0.02 * processes.LOAN_MAX_S
    loan.limit()
    assert lent[-1] == 0


def test_what_computes_comes_after_what_moves_motors():
    order = [
        processes.REALTIME_PRIORITY_LENT,
        processes.REALTIME_PRIORITY_MOCK,
        processes.REALTIME_PRIORITY_SECOND,
        processes.REALTIME_PRIORITY,
    ]
    assert order == sorted(set(order))
