"""Evaluation of the model in a thread of its own, so that no command waits for it."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import inf
from typing import Any

from ..common.errors import TendonRobotError
from ..common.processes import ComputingThread, RealtimeLoan, switch_often
from ..model.tip_task import Patience

GiveUp = Callable[[], bool]
type Work[T] = Callable[[GiveUp], T]  # reads no state that the control thread changes
Failure = TendonRobotError | None  # why a job has no result; None: it has one
Done = Callable[[Any, Failure], None]
SOLVER = 'solver'  # name of the thread


class Solver:
    """Evaluates the model at once, in the calling thread; see `Worker`."""

    def post(
        self, kind: str, work: Work[Any], done: Done, budget: float = inf, urgent: bool = False
    ) -> None:
        """
        Post a job; of several jobs of one kind only the newest matters.

        Parameters
        ----------
        kind : str
            A waiting job of the same kind is replaced, a running one is requested to give up.
        work : callable
            Takes `give_up`, which it polls; returns the result, or raises an error.
        done : callable
            Called in the thread of `serve` with the result and the error, one of them None, also
            for a job that gave up: the callable checks whether the result is still current.
        budget : float [s]
            Time from the start of the work after which `give_up` returns True.
        urgent : bool
            The result does not wait for the next cycle, and the work has real-time priority.

        """
        result, error = None, None
        try:
            result = work(lambda: False)
        except TendonRobotError as raised:
            error = raised
        done(result, error)

    def call_soon(self, take: Callable[[], None]) -> None:
        """Call something soon in the thread of `serve`; for use within work."""
        take()

    def busy(self, kind: str) -> bool:
        """Whether a job of this kind is unfinished."""
        return False

    def serve(self) -> None:
        """Call `done` of the finished jobs; raise an error that is no TendonRobotError."""


@dataclass
class _Job:
    work: Work[Any]
    done: Done
    give_up: Patience
    urgent: bool
    kind: str


class Worker(Solver):
    """Evaluates in a thread, one job after the other in the order of arrival."""

    def __init__(self, wake: Callable[[], None] = lambda: None) -> None:
        """
        Start the thread.

        Parameters
        ----------
        wake : callable
            Called from the thread when an urgent job is finished.

        """
        self._wake = wake
        self._changed = threading.Condition()
        self._waiting: dict[str, _Job] = {}
        self._running: _Job | None = None
        self._answered: deque[Callable[[], None]] = deque()
        self._open: Counter[str] = Counter()
        self._ended = False
        self._loan: RealtimeLoan | None = None
        switch_often()
        self._thread = ComputingThread(self._run, SOLVER, self.close)
        self._thread.start()

    def post(
        self, kind: str, work: Work[Any], done: Done, budget: float = inf, urgent: bool = False
    ) -> None:
        """Queue a job for the thread."""
        job = _Job(work, done, Patience(budget), urgent, kind)
        with self._changed:
            if kind not in self._waiting:
                self._open[kind] += 1
            self._waiting[kind] = job  # at the position of the job that it replaces
            if self._running is not None and self._running.kind == kind:
                self._running.give_up.end()
            if urgent and self._loan is not None and self._thread.native_id is not None:
                self._loan.begin(self._thread.native_id)  # also for the job before it
            self._changed.notify()

    def lend_realtime(self) -> None:
        """Run jobs in real time from now on, for a limited time; call `limit_realtime` often."""
        self._loan = RealtimeLoan()

    def limit_realtime(self) -> None:
        """Take the real-time priority from a job that runs too long."""
        if self._loan is not None:
            self._loan.limit()

    def call_soon(self, take: Callable[[], None]) -> None:
        """Call something with the next results, and wake the thread of `serve`."""
        self._answered.append(take)
        self._wake()

    def busy(self, kind: str) -> bool:
        """Whether a job of this kind is unfinished."""
        return self._open[kind] > 0

    def serve(self) -> None:
        """Call `done` of the finished jobs; raise an error that is no TendonRobotError."""
        while self._answered:
            self._answered.popleft()()

    def close(self) -> None:
        """End the thread; a busy one ends with its job."""
        with self._changed:
            self._ended = True
            self._waiting.clear()
            if self._running is not None:
                self._running.give_up.end()
            self._changed.notify()

    def _run(self) -> None:
        while (job := self._next()) is not None:
            if self._loan is not None:  # commands wait while it holds Python's lock
                self._loan.begin(threading.get_native_id())
            result, error = None, None
            try:
                result = job.work(job.give_up)
            except Exception as raised:
                error = raised
            with self._changed:
                self._running = None
            self._answered.append(partial(self._answer, job, result, error))
            if job.urgent and not self._ended:
                self._wake()
            with self._changed:
                urgent = any(one.urgent for one in self._waiting.values())
            if self._loan is not None and not urgent:
                self._loan.end()

    def _answer(self, job: _Job, result: Any, error: Exception | None) -> None:
        """Call `done`; raise an error that is no TendonRobotError."""
        self._open[job.kind] -= 1
        if error is not None and not isinstance(error, TendonRobotError):
            raise error
        job.done(result, error)

    def _next(self) -> _Job | None:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._ended)
            if self._ended:
                return None
            self._running = job = self._waiting.pop(next(iter(self._waiting)))
            job.give_up.begin()
            return job
