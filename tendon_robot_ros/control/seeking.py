"""Tensions for a target: searched beside the commands, for a limited time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ..common.errors import InputError, NoEquilibriumError, TendonRobotError
from .checks import Refusal
from .solver import GiveUp
from .state import STREAM_PERIOD_S, Controller, Target

if TYPE_CHECKING:
    from collections.abc import Callable

    from ..model.model import Model
    from ..model.shape import Reach

COLD_SEARCH_STARTS = 12  # of a cold search; a twist only goes on from where it is
NEW_TARGET_BUDGET_S = 0.2  # [s] for a target that is none of a stream
# [1] of the length, [rad] between two targets of a stream
STREAM_STEP_SHARE, STREAM_TURN_RAD = 0.1, 0.3


class Seeker(Controller, Protocol):
    """A controller that looks for the tensions of a target."""

    search: TargetSearch | None  # for a target that is not yet followed
    asked: TargetSearch | None  # the last one

    def follow(self, target: Target, solution: Reach, in_time: bool = True) -> None:
        """Go to where the tensions for a target are."""


@dataclass(frozen=True)
class TargetSearch:
    """
    A target whose tensions are looked for.

    Attributes
    ----------
    target : Target
    began : float [s]
    budget : float [s]
        After that the best found counts: half the time between targets of a stream, else
        `NEW_TARGET_BUDGET_S`.
    stream : object
        The same for targets that follow each other closely in time and space.

    """

    target: Target
    began: float
    budget: float
    stream: object
    streamed: bool = False  # it is not the first

    @classmethod
    def begin(cls, core: Seeker, target: Target, now: float) -> TargetSearch:
        """Look whether the target goes on from the one before."""
        before = core.asked
        if before is None or not _goes_on(core, before, target, now):
            return cls(target, now, NEW_TARGET_BUDGET_S, object())
        return cls(target, now, 0.5 * max(now - before.began, 0.01), before.stream, True)


@dataclass(frozen=True)
class SearchResult:
    """What a search found; the deadline may have ended it."""

    reach: Reach | None
    problem: str
    in_time: bool


def seek(core: Seeker, target: Target) -> None:
    """Look for the tensions of a target; until they are found the arm goes on as before."""
    search = core.search = core.asked = TargetSearch.begin(core, target, core.stepped)
    solve = solution_of(core, core.model, target)

    def work(give_up: GiveUp) -> SearchResult:
        try:
            return SearchResult(solve(give_up), '', not give_up())
        except (NoEquilibriumError, InputError) as error:
            return SearchResult(None, str(error), not give_up())

    def done(result: SearchResult, error: TendonRobotError | None) -> None:
        if error is not None:
            result = SearchResult(None, str(error), True)
        _take(core, search, result)

    core.solver.post('target', work, done, search.budget, urgent=True)


def solution_of(
    core: Controller, model: Model, target: Target, tracking: bool = False
) -> Callable[[GiveUp], Reach]:
    """Return how to find tensions for a target from where the arm is; tracking: only there."""
    guess = core.track.last if core.solution is None else core.solution.shape
    if guess is not None and len(guess.bend) != model.robot.cells:
        guess = None
    weight, by_pulls = core.settings.direction_weight or None, core.settings.pull_mode

    def solve(give_up: GiveUp) -> Reach:
        return model.reach(
            position=target.position,
            direction=target.direction,
            guess=guess,
            direction_weight=weight,
            starts=0 if tracking else COLD_SEARCH_STARTS,
            by_pulls=by_pulls,
            relax=not tracking,
            give_up=give_up,
        )

    return solve


def _take(core: Seeker, search: TargetSearch, result: SearchResult) -> None:
    """Use what was found, unless something else is wanted by now."""
    newest = core.search
    if newest is None or newest.stream is not search.stream:
        return
    if newest is search:
        core.search = None
    elif result.reach is None:
        return  # of a stream: the next one may be better
    if result.reach is not None:  # of a stream an older target, too, is on the way
        core.follow(search.target, result.reach, result.in_time)
        return
    code = 'no_equilibrium' if result.in_time else 'no_time'
    late = '' if result.in_time else f' (the search ended after {search.budget:.3g} s)'
    core.refusals['target'] = Refusal(code, f'target refused: {result.problem}{late}')


def _goes_on(core: Seeker, before: TargetSearch, target: Target, now: float) -> bool:
    if before.target is not (core.search.target if core.search else core.target):
        return False
    if now - before.began > STREAM_PERIOD_S:
        return False
    old = before.target
    if (old.position is None) != (target.position is None):
        return False
    if (old.direction is None) != (target.direction is None):
        return False
    if old.position is not None and target.position is not None:
        step = float(np.linalg.norm(target.position - old.position))
        if step > STREAM_STEP_SHARE * core.model.robot.length:
            return False
    if old.direction is not None and target.direction is not None:
        return bool(old.direction @ target.direction > np.cos(STREAM_TURN_RAD))
    return True
