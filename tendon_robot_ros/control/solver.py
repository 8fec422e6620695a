"""Where the model is evaluated: in a thread of its own, so that no command waits for it."""

from __future__ import annotations

import math
import threading
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from ..common.errors import TendonRobotError
from ..common.processes import ComputingThread, RealtimeLoan, switch_often
from ..model.tip_task import Patience

GiveUp = Callable[[], bool]
Work = Callable[[GiveUp], Any]  # reads no state that the commanding thread changes
Done = Callable[[Any, TendonRobotError | None], None]
SOLVER = 'solver'  # name of the thread
# [s] to wait for what is being evaluated; a longer one would be seen when a node ends
END_TIMEOUT_S = 0.2


class Solver(Protocol):
    """Evaluates the model; of the jobs of one kind only the newest counts."""

    def post(
        self, kind: str, work: Work, done: Done, budget: float = math.inf, urgent: bool = False
    ) -> None:
        """
        Have something evaluated.

        Parameters
        ----------
        kind : str
            A job that waits is replaced by one of its kind, one that runs is asked to give up.
        work : callable
            Is given `give_up`, to be asked now and then; returns the result, or raises.
        done : callable
            Takes the result and the error, one of them None, in the thread of `serve`. What was
            given up answers, too: the callable knows whether the answer is still wanted.
        budget : float [s]
            Time after which `give_up` says True, from when the work begins.
        urgent : bool
            The answer is not to wait for the next cycle, nor the work for other programs.

        """

    def tell(self, take: Callable[[], None]) -> None:
        """From within work: have something called in the thread of `serve`, and that soon."""

    def busy(self, kind: str) -> bool:
        """Whether an answer of this kind is to come."""

    def serve(self) -> None:
        """Hand out the answers."""


class InPlace:
    """Evaluates at once, in the thread that asks: nothing is ever waited for."""

    def post(
        self, kind: str, work: Work, done: Done, budget: float = math.inf, urgent: bool = False
    ) -> None:
        """Evaluate and answer."""
        result, error = None, None
        try:
            result = work(lambda: False)
        except TendonRobotError as raised:
            error = raised
        done(result, error)

    def tell(self, take: Callable[[], None]) -> None:
        """Call it."""
        take()

    def busy(self, kind: str) -> bool:
        """Return False."""
        return False

    def serve(self) -> None:
        """Do nothing: all is answered."""


@dataclass
class _Job:
    work: Work
    done: Done
    give_up: Patience
    urgent: bool
    kind: str
    result: Any = None
    error: Exception | None = None

    def answer(self, waiting: Counter[str]) -> None:
        """Hand out the answer; raise what no user's mistake can explain."""
        waiting[self.kind] -= 1
        if self.error is not None and not isinstance(self.error, TendonRobotError):
            raise self.error
        self.done(self.result, self.error)


class Worker:
    """Evaluates in a thread; one job after the other, in the order of their coming."""

    def __init__(self, wake: Callable[[], None] = lambda: None) -> None:
        """
        Start the thread.

        Parameters
        ----------
        wake : callable
            Called from the thread when an urgent answer is there.

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
        self._thread = ComputingThread(self._work, SOLVER, self._end)
        self._thread.start()

    def post(
        self, kind: str, work: Work, done: Done, budget: float = math.inf, urgent: bool = False
    ) -> None:
        """Leave a job for the thread."""
        job = _Job(work, done, Patience(budget), urgent, kind)
        with self._changed:
            if kind not in self._waiting:
                self._open[kind] += 1
            self._waiting[kind] = job  # keeps the place in the queue of the one it replaces
            if self._running is not None and self._running.kind == kind:
                self._running.give_up.end()
            if urgent and self._loan is not None and self._thread.native_id is not None:
                self._loan.begin(self._thread.native_id)  # also for what runs before it
            self._changed.notify()

    def lend_realtime(self) -> None:
        """Have work done in real time from now on, for a while; call `limit_realtime` often."""
        self._loan = RealtimeLoan()

    def limit_realtime(self) -> None:
        """Let what takes too long go on as other programs do."""
        if self._loan is not None:
            self._loan.limit()

    def tell(self, take: Callable[[], None]) -> None:
        """Have it called with the next answers, and these handed out at once."""
        self._answered.append(take)
        self._wake()

    def busy(self, kind: str) -> bool:
        """Whether an answer of this kind is to come."""
        return self._open[kind] > 0

    def serve(self) -> None:
        """Hand out the answers; raise what no user's mistake can explain."""
        while self._answered:
            self._answered.popleft()()

    def close(self) -> None:
        """End the thread; if it is busy, the end of the process waits for it."""
        self._end()
        self._thread.join(END_TIMEOUT_S)

    def _end(self) -> None:
        with self._changed:
            self._ended = True
            self._waiting.clear()
            if self._running is not None:
                self._running.give_up.end()
            self._changed.notify()

    def _work(self) -> None:
        while (job := self._next()) is not None:
            if self._loan is not None:  # commands wait for it while it holds Python's lock
                self._loan.begin(threading.get_native_id())
            try:
                job.result = job.work(job.give_up)
            except Exception as error:
                job.error = error
            with self._changed:
                self._running = None
            self._answered.append(partial(job.answer, self._open))
            if job.urgent and not self._ended:
                self._wake()
            with self._changed:
                urgent = any(one.urgent for one in self._waiting.values())
            if self._loan is not None and not urgent:
                self._loan.end()

    def _next(self) -> _Job | None:
        with self._changed:
            while not self._waiting and not self._ended:
                self._changed.wait()
            if self._ended:
                return None
            self._running = job = self._waiting.pop(next(iter(self._waiting)))
            job.give_up.begin()
            return job
