"""Tensions for a target: searched beside the commands, for a limited time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError, NoEquilibriumError
from ..model.inverse import JUMP_MAX, reach
from ..model.shape import Reach
from ..model.tip_task import COLD, STREAM, TRACK, Patience, Policy, TipTask
from .approach import Approach, carried, cut_short, forgetting, forgotten
from .checks import another_robot
from .solver import GiveUp
from .state import STREAM_PERIOD_S, Controller, Settings, Target

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Shape

Array = NDArray[np.float64]
Report = Callable[[Reach], None]  # is given what a search has found so far
# [s] for a target that is none of a stream: a person hardly notices, and the best found until then
# is on its way; a longer search would seldom come nearer
NEW_TARGET_BUDGET_S = 0.2
# [1] of the time between targets of a stream, because the shape needs the rest
STREAM_BUDGET = 0.8
# [s] about a cycle: what is found until then is gone to, else the command would wait for the rest
FIRST_ANSWER_S = 0.006
# [1] of the length, between two targets of a stream, and by which one is led: what is further off
# is somewhere else, because arms of this size go there in a second
STREAM_LENGTH = 0.1
# [rad] between two targets of a stream: as much of a bend, because a tip turns by twice its way
STREAM_TURN_RAD = 0.3


@dataclass(frozen=True)
class TargetSearch:
    """
    A target whose tensions are looked for.

    Attributes
    ----------
    target : Target
    began : float [s]
    budget : float [s]
        After that the best found counts: most of the time between targets of a stream, else
        `NEW_TARGET_BUDGET_S`.
    stream : object
        The same for targets that follow each other closely in time and space.

    """

    target: Target
    began: float
    budget: float
    stream: object
    streamed: bool = False  # it is not the first
    velocity: Array | None = None  # (3,) [m/s] of a stream

    @classmethod
    def begin(
        cls, core: Controller, before: TargetSearch | None, last: Target | None, target: Target
    ) -> TargetSearch:
        """Look whether the target goes on from the search before; `last` is the last one."""
        now = core.time
        if before is None or before.target is not last or not _goes_on(core, before, target):
            return cls(target, now, NEW_TARGET_BUDGET_S, object())
        passed, velocity = max(now - before.began, 0.01), None
        if target.position is not None and before.target.position is not None:
            velocity = (target.position - before.target.position) / passed
            if before.velocity is not None:  # senders are not that regular
                velocity = 0.5 * (velocity + before.velocity)
        budget = STREAM_BUDGET * passed
        return cls(target, now, budget, before.stream, True, velocity)

    @property
    def first_budget(self) -> float:
        """Time [s] after which what was found is gone to, while the search goes on."""
        return min(self.budget, FIRST_ANSWER_S)


@dataclass(frozen=True)
class SearchResult:
    """What a search found; the deadline may have ended it."""

    approach: Approach | None
    problem: str
    in_time: bool
    left: float = 0.0  # [s] for which it may go on


def searching(
    core: Controller, search: TargetSearch, budget: float, report: Report
) -> Callable[[GiveUp], SearchResult]:
    """
    Return how to search for a time [s]; `report` hears, where commands are made, what comes first.

    Where nothing was within the first time, what is found when it ends is where another search
    begins. In that one the deadline is looked at only between starts, so that one start at least
    comes to its end.
    """
    solve = request_of(core, core.model, ahead_of(core, search), search.streamed).answer
    first = budget == FIRST_ANSWER_S

    def work(give_up: GiveUp) -> SearchResult:
        left = search.budget - budget if first else 0.0

        def heard(solution: Reach) -> None:
            nonlocal left
            core.solver.tell(lambda: report(solution))
            if isinstance(give_up, Patience):
                give_up.prolong(left)
                left = 0.0

        try:
            solution = solve(give_up if first else lambda: give_up(), heard)
        except (NoEquilibriumError, InputError) as error:
            return SearchResult(None, str(error), not give_up(), left)
        return SearchResult(solution, '', not give_up(), left)

    return work


def ahead_of(core: Controller, search: TargetSearch) -> Target:
    """Return where a stream of targets will be by the time that the arm has followed."""
    target, lead = search.target, core.settings.look_ahead
    if lead == 0.0 or search.velocity is None or target.position is None:
        return target
    step = lead * search.velocity
    size, most = float(np.linalg.norm(step)), STREAM_LENGTH * core.model.robot.length
    return replace(target, position=target.position + step * min(1.0, most / max(size, 1e-12)))


@dataclass(frozen=True)
class SearchRequest:
    """
    What the solver searches for: it reads nothing that the commanding thread changes.

    Attributes
    ----------
    target, as_sent : Target
        Without what the measured tip is off the model there, and with it.
    guess, last : Shape or None
        Where a search begins, and the last shape, with what friction remembered.
    acting : (m,) [N]
        The tensions that act now.
    streamed : bool
        The target goes on from the one before: straight there.
    tracking : bool
        Search only near where the arm is.

    """

    model: Model
    settings: Settings
    target: Target
    as_sent: Target
    guess: Shape | None
    last: Shape | None
    acting: Array
    streamed: bool
    tracking: bool

    def answer(self, give_up: GiveUp, report: Report | None = None) -> Approach:
        """Find tensions and the approach to them; `report` hears what is found meanwhile."""
        model, settings = self.model, self.settings
        from_below = settings.approach == 'from_below' and not self._near
        if from_below or settings.keep_out or settings.pull_mode:
            report = None
        # the same place is always found by the same tensions
        guess = None if from_below else self.guess
        if not (model.remembers or settings.keep_out):
            straight = Approach.straight(self._reach(None, guess, give_up, report))
            return replace(straight, via=forgetting(model)) if from_below else straight
        here = model.follow(self.last, self.acting)
        past = here if model.remembers else None
        if settings.tip_gain > 0.0 and not (from_below or settings.keep_out):
            return Approach.straight(self._for_closed_loop(here, give_up, report))
        way = Approach.straight(self._reach(past, guess or past, give_up, report))
        if from_below:

            def from_there(there: Shape) -> Reach:
                return self._reach(there if model.remembers else None, there, give_up)

            way = forgotten(model, here, way.reach, from_there)
        if settings.keep_out:
            way = cut_short(here, way, self._task(here))
        return way

    @property
    def _near(self) -> bool:
        return self.tracking or self.streamed

    def _task(self, past: Shape | None) -> TipTask:
        """Return what is wanted of the tip of an arm that is reached from a shape."""
        settings, memory = self.settings, None if past is None else past.memory
        task = tip_task(self.model, settings, self.target, memory)
        return replace(task, by_pulls=settings.pull_mode, keep_out=settings.keep_out)

    def _policies(self) -> Iterator[Policy]:
        """
        Yield how to search; where the model has no equilibrium, the next one counts.

        Where friction remembers, a target near the last one is looked for near there alone.
        """
        if self.model.remembers and self._near:
            yield replace(STREAM, starts=0, relax=not self.tracking)
        elif self.tracking:
            yield TRACK
        if not self.tracking:
            stream = self.streamed and self.model.sticks
            # more starts would not end within the time for a target
            yield STREAM if stream else replace(COLD, starts=STREAM.starts)

    def _reach(
        self,
        past: Shape | None,
        guess: Shape | None,
        give_up: GiveUp,
        report: Report | None = None,
    ) -> Reach:
        """Find tensions that are right when they are reached from a shape."""
        task = replace(
            self._task(past),
            guess=guess,
            preferences=None if self._near else self.settings.preferences,
        )
        policies = list(self._policies())
        for policy in policies[:-1]:
            with suppress(NoEquilibriumError):
                return reach(task, policy, give_up, report)
        return reach(task, policies[-1], give_up, report)

    def _for_closed_loop(self, here: Shape, give_up: GiveUp, report: Report | None) -> Reach:
        """
        Find tensions from where the closed loop brings the tip to its place.

        From the present state of friction, a model that is not the arm's may ask for much tension
        against much tension, where it is furthest off. Then friction is left to the loop, and so
        is the tip's bias elsewhere.
        """
        if self._near or self.settings.pull_mode:
            return self._reach(here, self.guess or here, give_up, report)
        without_bias = replace(self, target=self.as_sent)
        solutions: list[Reach] = []
        for request, past, heard in (
            (self, None, report),
            (without_bias, None, None),
            (self, here, None),
        ):
            try:
                if not (solutions and give_up()):
                    made = request._reach(past, self.guess or past, give_up, heard)
                    solutions.insert(len(solutions) if past is None else 0, made)
            except NoEquilibriumError:
                if not solutions and past is not None:  # the last one
                    raise
        there = [one for one in solutions if one.status == 'reached'] or solutions
        low, high = self.model.limits.T
        most = [float(((one.tensions - low) / (high - low)).max()) for one in there]
        enough = min(most) + JUMP_MAX
        return next(one for one, size in zip(there, most, strict=True) if size <= enough)


def tip_task(
    model: Model, settings: Settings, target: Target, memory: Array | None = None
) -> TipTask:
    """Return what a target asks of the tip of a model, from a friction memory."""
    weight = settings.direction_weight or None
    return TipTask.at(model, target.position, target.direction, weight, memory)


def request_of(
    core: Controller,
    model: Model,
    target: Target,
    streamed: bool = False,
    tracking: bool = False,
) -> SearchRequest:
    """Return the request of tensions for a target, from where the arm is."""
    guess, last = (
        None if shape is None or len(shape.bend) != model.robot.cells else shape
        for shape in (
            core.track.last if core.solution is None else core.solution.shape,
            core.track.last,
        )
    )
    as_sent, acting = target, core.acting_tensions()
    if target.position is not None:
        target = replace(target, position=target.position - core.tip_bias(target.position))
    return SearchRequest(
        model, core.settings, target, as_sent, guess, last, acting, streamed, tracking
    )


def with_model(
    core: Controller, model: Model
) -> Callable[[GiveUp], tuple[Shape | None, Reach | None]]:
    """
    Return how to find the shape by another model, and tensions for the target that is followed.

    NoEquilibriumError where it has none at the present tensions, or for the target.
    """
    command, target, last, before = core.command, core.target, core.track.last, core.model
    other = another_robot(model.robot, before.robot)
    request = None if target is None or other else request_of(core, model, target)
    acting = None if command is None else core.acting_tensions()

    def work(give_up: GiveUp) -> tuple[Shape | None, Reach | None]:
        here = None
        if command is not None and acting is not None:
            model.shape(command)
            here = None if other else carried(model, before, last, acting)
        if request is None:
            return here, None
        return here, replace(request, last=here or request.last).answer(give_up).reach

    return work


def _goes_on(core: Controller, before: TargetSearch, target: Target) -> bool:
    if core.time - before.began > STREAM_PERIOD_S:
        return False
    old = before.target
    if (old.position is None) != (target.position is None):
        return False
    if (old.direction is None) != (target.direction is None):
        return False
    if old.position is not None and target.position is not None:
        step = float(np.linalg.norm(target.position - old.position))
        if step > STREAM_LENGTH * core.model.robot.length:
            return False
    if old.direction is not None and target.direction is not None:
        return bool(old.direction @ target.direction > np.cos(STREAM_TURN_RAD))
    return True


def is_nearer(core: Controller, target: Target, solution: Reach) -> bool:
    """Whether tensions bring the tip nearer to a target than it is."""
    last = core.track.last
    task = tip_task(core.model, core.settings, target)
    return last is None or task.cost(solution.shape) < task.cost(last)
