"""The solver in a thread of its own: the newest job counts, it gives up, it runs in real time."""

import sys
import threading
import time
from pathlib import Path

import pytest
from processes import run, until

from tendon_robot_ros.common import processes
from tendon_robot_ros.common.errors import NoEquilibriumError
from tendon_robot_ros.control.solver import Worker
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
        worker.call_soon(lambda: heard.append(threading.current_thread().name))
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


@pytest.mark.long
def test_a_search_that_runs_does_not_outlive_the_interpreter(tmp_path):
    script = tmp_path / 'ends.py'
    script.write_text(ENDS_WHILE_SEARCHING)
    ended = run([sys.executable, script, ROBOTS / 'spatial_3.yaml'])
    assert ended.stdout.split() == ['0'] * 4, ended.stderr  # nearly all crashed


LENDS = """
import os, time, threading
from tendon_robot_ros.common.processes import Realtime, LOAN_MAX_S, go_realtime
from tendon_robot_ros.control.solver import SOLVER, Worker

LENT = os.SCHED_RR | os.SCHED_RESET_ON_FORK, Realtime.COMPUTATION
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
    assert sum_lent == pytest.approx(0.5 * now[0], rel=0.1)
    loan.begin(1)
    loan.end()
    told = len(lent)
    now[0] += 10.0
    loan.limit()
    assert len(lent) == told, 'who waits for work gives back nothing: it may hold the lock'
    loan.begin(1)
    now[0] += 0.99 * processes.LOAN_MAX_S
    loan.limit()
    assert lent[-1] == processes.Realtime.COMPUTATION
    now[0] += 0.02 * processes.LOAN_MAX_S
    loan.limit()
    assert lent[-1] == 0


def test_what_computes_comes_after_what_moves_motors():
    order = [
        processes.Realtime.COMPUTATION,
        processes.Realtime.MOCK_DRIVER,
        processes.Realtime.CONTROLLER,
        processes.Realtime.DRIVER,
    ]
    assert order == sorted(set(order))
