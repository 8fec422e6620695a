"""Fits of many candidates side by side; of an arm as built those far behind are given up."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import numpy as np

from ..comparison.predict import Point
from .candidates import Candidate
from .decide import NEAR_SCORE
from .fit import Fit
from .fitter import GAINS_TO_COME, Descent, Fitter

Starts = Mapping[str, Fit | Point]
ROUNDS_EARLY = 2  # of every fit, before those far behind are given up
FAILURES = (ArithmeticError, np.linalg.LinAlgError)  # no equilibrium at a start, or on the way


def side_by_side(tasks: Sequence[Callable[[int], object]], workers: int) -> None:
    """Call tasks with the number of the worker that does each, in turn: 0, 1, 0, ..."""

    def work(worker: int) -> None:
        for task in tasks[worker::workers]:
            task(worker)

    if workers == 1 or len(tasks) < 2:
        for number, task in enumerate(tasks):
            task(number % workers)
        return
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, range(workers)))


class Race:
    """
    Fits of candidates, spread over fitters; those without equilibrium drop out.

    Of an arm as built a fit that is `NEAR_SCORE` and what it may still gain behind the best one
    after `ROUNDS_EARLY` rounds is left there.
    """

    def __init__(
        self, fitters: Sequence[Fitter], candidates: Sequence[Candidate], done: Callable[[], None]
    ) -> None:
        """Take the fitters, one a thread; `done` is called for every fit that ends."""
        self.fitters, self.candidates, self.done = fitters, candidates, done
        self._fits: list[Fit | None] = [None] * len(candidates)
        self._descents: dict[int, Descent] = {}
        self._behind: list[int] = []

    def run(self, starts: Starts | None = None) -> list[tuple[Candidate, Fit]]:
        """Fit all, from `starts` by the labels of the candidates."""
        every, known = range(len(self.candidates)), starts or {}
        if self.fitters[0].random is None:
            self._each(every, lambda i, fitter: self._fit(i, fitter, known))
        else:
            self._each(every, lambda i, fitter: self._begin(i, fitter, known))
            near = self._near()
            self._each(near, self._finish)
            self._behind = [i for i in self._descents if i not in near]
            self._each(self._behind, self._leave)
        return self._found(every)

    def behind(self) -> list[tuple[Candidate, Fit]]:
        """Return those that were left behind."""
        return self._found(self._behind)

    def go_on(self) -> list[tuple[Candidate, Fit]]:
        """Fit those that were left behind to their ends."""
        self._each(self._behind, self._finish)
        return self._found(self._behind)

    def _found(self, which: Sequence[int]) -> list[tuple[Candidate, Fit]]:
        return [(self.candidates[i], fit) for i in which if (fit := self._fits[i]) is not None]

    def _each(self, which: Sequence[int], do: Callable[[int, Fitter], None]) -> None:
        tasks = [lambda worker, i=i: do(i, self.fitters[worker]) for i in which]
        side_by_side(tasks, len(self.fitters))

    def _fit(self, i: int, fitter: Fitter, starts: Starts) -> None:
        candidate = self.candidates[i]
        with suppress(*FAILURES):
            self._fits[i] = fitter.fit(candidate.frees, starts.get(candidate.label))
        self.done()

    def _begin(self, i: int, fitter: Fitter, starts: Starts) -> None:
        candidate = self.candidates[i]
        try:
            descent = fitter.begin(candidate.frees, starts.get(candidate.label))
            for _ in range(ROUNDS_EARLY):
                if not descent.settled:
                    descent.go_on()
            self._descents[i] = descent
        except FAILURES:
            self.done()

    def _near(self) -> list[int]:
        """Return those that are the best, or may become so."""
        scores = {i: self._score(i) for i in self._descents}
        limit = min(scores.values(), default=np.inf) + NEAR_SCORE
        promised = {i: s - GAINS_TO_COME * self._descents[i].gain for i, s in scores.items()}
        return [i for i, score in promised.items() if score <= limit]

    def _score(self, i: int) -> float:
        return self._descents[i].here.deviance + 2.0 * len(self.candidates[i].frees)

    def _finish(self, i: int, fitter: Fitter) -> None:
        descent = self._descents[i].at(fitter)
        with suppress(*FAILURES):
            while not descent.settled:
                descent.go_on()
            self._fits[i] = descent.fit()
        self.done()

    def _leave(self, i: int, fitter: Fitter) -> None:
        with suppress(*FAILURES):
            self._fits[i] = self._descents[i].at(fitter).fit()
        self.done()
