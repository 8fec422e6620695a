"""Search for the tensions of a target beside the control loop, within a time budget."""

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
from .approach import Approach, carry_friction, forgetting_approach, forgetting_tensions, truncated
from .checks import another_robot
from .solver import GiveUp
from .state import STREAM_PERIOD_S, Controller, Settings, Target

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Shape

Array = NDArray[np.float64]
Report = Callable[[Reach], None]  # called with the best solution so far
# [s] budget of a target that belongs to no stream: a person hardly notices it, and the arm already
# follows the best solution so far; a longer search would seldom come nearer
NEW_TARGET_BUDGET_S = 0.2
# [1] of the time between targets of a stream, because the evaluation of the shape needs the rest
STREAM_BUDGET = 0.8
# [s] about a cycle: the arm follows the solution at this time, else the command would wait for the
# whole search
FIRST_ANSWER_S = 0.006
# [1] of the length: largest step between two targets of a stream, and of its extrapolation; a
# larger step is a new target, because arms of this size take a second for it
STREAM_LENGTH = 0.1
# [rad] between two targets of a stream: the same of a bend, because a tip rotates by twice its
# relative path
STREAM_ROTATION_RAD = 0.3


@dataclass(frozen=True)
class TargetSearch:
    """
    A target whose tensions are searched.

    Attributes
    ----------
    target : Target
    began : float [s]
    budget : float [s]
        Time of the search: most of the time between targets of a stream, else
        `NEW_TARGET_BUDGET_S`.
    stream : object
        Identity of the stream: shared by targets that are close in time and space.
    streamed : bool
        Whether the target is not the first of its stream.
    velocity : (3,) [m/s] or None
        Velocity of the stream.

    """

    target: Target
    began: float
    budget: float
    stream: object
    streamed: bool = False
    velocity: Array | None = None

    @classmethod
    def begin(
        cls, core: Controller, before: TargetSearch | None, last: Target | None, target: Target
    ) -> TargetSearch:
        """Return the search, in the stream of the previous one where the target continues it."""
        now = core.time
        if before is None or before.target is not last or not _continues(core, before, target):
            return cls(target, now, NEW_TARGET_BUDGET_S, object())
        passed, velocity = max(now - before.began, 0.01), None
        if target.position is not None and before.target.position is not None:
            velocity = (target.position - before.target.position) / passed
            if before.velocity is not None:  # the periods of senders vary
                velocity = 0.5 * (velocity + before.velocity)
        budget = STREAM_BUDGET * passed
        return cls(target, now, budget, before.stream, True, velocity)

    @property
    def first_budget(self) -> float:
        """Time [s] after which the arm follows the first solution, while the search continues."""
        return min(self.budget, FIRST_ANSWER_S)

    def extrapolated(self, core: Controller) -> Target:
        """Return the target of a stream, extrapolated by the `look_ahead` of the settings."""
        target, horizon = self.target, core.settings.look_ahead
        if horizon == 0.0 or self.velocity is None or target.position is None:
            return target
        step, step_max = horizon * self.velocity, STREAM_LENGTH * core.model.robot.length
        step = step * min(1.0, step_max / max(float(np.linalg.norm(step)), 1e-12))
        return replace(target, position=target.position + step)


@dataclass(frozen=True)
class SearchResult:
    """Result of a search, which may have ended at its deadline."""

    approach: Approach | None
    problem: str
    in_time: bool
    remaining: float = 0.0  # [s] of the budget


def search_work(
    core: Controller, search: TargetSearch, budget: float, report: Report
) -> Callable[[GiveUp], SearchResult]:
    """
    Return solver work: a search within a budget [s].

    `report` is called in the control thread with the first good solution; the search then uses the
    rest of the budget. Without one in the first budget, a second search begins at the best result.
    There the deadline is checked only between starts, so that at least one start completes.
    """
    solve = request_of(core, core.model, search.extrapolated(core), search.streamed).answer
    first = budget == FIRST_ANSWER_S

    def work(give_up: GiveUp) -> SearchResult:
        remaining = search.budget - budget if first else 0.0

        def on_report(solution: Reach) -> None:
            nonlocal remaining
            core.solver.call_soon(lambda: report(solution))
            if isinstance(give_up, Patience):
                give_up.prolong(remaining)
                remaining = 0.0

        try:
            solution = solve(give_up if first else lambda: give_up(), on_report)
        except (NoEquilibriumError, InputError) as error:
            return SearchResult(None, str(error), not give_up(), remaining)
        return SearchResult(solution, '', not give_up(), remaining)

    return work


@dataclass(frozen=True)
class SearchRequest:
    """
    A search for the solver; it reads no state that the control thread changes.

    Attributes
    ----------
    target, as_sent : Target
        Target for the model, without the bias of its tip there, and the commanded target.
    guess, last : Shape or None
        Start of the search, and the last shape, with the memory of friction.
    acting : (m,) [N]
        Estimated present tensions.
    streamed : bool
        Whether the target continues a stream: the approach is straight.
    tracking : bool
        Whether to search only near the present shape.

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
        """Return the approach to the target; `report` is called with intermediate solutions."""
        model, settings = self.model, self.settings
        from_below = settings.approach == 'from_below' and not self._local
        if from_below or settings.keep_out or settings.pull_mode:
            report = None
        # independent of the present shape, so that a position always has the same tensions
        guess = None if from_below else self.guess
        if not (model.remembers or settings.keep_out):
            straight = Approach.straight(self._solve_from(None, guess, give_up, report))
            return replace(straight, via=forgetting_tensions(model)) if from_below else straight
        start = model.follow(self.last, self.acting)
        past = start if model.remembers else None
        if settings.tip_gain > 0.0 and not (from_below or settings.keep_out):
            return Approach.straight(self._for_closed_loop(start, give_up, report))
        path = Approach.straight(self._solve_from(past, guess or past, give_up, report))
        if from_below:

            def solve_from(shape: Shape) -> Reach:
                return self._solve_from(shape if model.remembers else None, shape, give_up)

            path = forgetting_approach(model, start, path.reach, solve_from)
        if settings.keep_out:
            path = truncated(start, path, self._task(start))
        return path

    @property
    def _local(self) -> bool:
        return self.tracking or self.streamed

    def _task(self, past: Shape | None) -> TipTask:
        """Return the task of the tip for an arm that comes from the shape `past`."""
        settings, memory = self.settings, None if past is None else past.memory
        task = tip_task(self.model, settings, self.target, memory)
        return replace(task, by_pulls=settings.pull_mode, keep_out=settings.keep_out)

    def _policies(self) -> Iterator[Policy]:
        """
        Yield search policies; each is tried where the model has no equilibrium by the one before.

        With friction memory, a target near the last one is searched near the present shape first.
        """
        if self.model.remembers and self._local:
            yield replace(STREAM, starts=0, relax=not self.tracking)
        elif self.tracking:
            yield TRACK
        if not self.tracking:
            stream = self.streamed and self.model.sticks
            # more starts would exceed the budget of a target
            yield STREAM if stream else replace(COLD, starts=STREAM.starts)

    def _solve_from(
        self,
        past: Shape | None,
        guess: Shape | None,
        give_up: GiveUp,
        report: Report | None = None,
    ) -> Reach:
        """Return tensions for the target when it is approached from the shape `past`."""
        task = replace(
            self._task(past),
            guess=guess,
            preferences=None if self._local else self.settings.preferences,
        )
        policies = list(self._policies())
        for policy in policies[:-1]:
            with suppress(NoEquilibriumError):
                return reach(task, policy, give_up, report)
        return reach(task, policies[-1], give_up, report)

    def _for_closed_loop(self, start: Shape, give_up: GiveUp, report: Report | None) -> Reach:
        """
        Return tensions from which the closed loop brings the tip to the target.

        From the present state of friction, an inaccurate model may require high co-contraction,
        where its error is largest. Solutions without the friction memory, and without the tip's
        bias, are therefore candidates, too: the first one whose highest tension is close to the
        lowest of all candidates is returned, and the loop corrects the rest.
        """
        if self._local or self.settings.pull_mode:
            return self._solve_from(start, self.guess or start, give_up, report)
        without_bias = replace(self, target=self.as_sent)
        solutions: list[Reach] = []
        for request, past, on_report in (
            (self, None, report),
            (without_bias, None, None),
            (self, start, None),
        ):
            try:
                if not (solutions and give_up()):
                    solution = request._solve_from(past, self.guess or past, give_up, on_report)
                    solutions.insert(len(solutions) if past is None else 0, solution)
            except NoEquilibriumError:
                if not solutions and past is not None:  # the last request
                    raise
        candidates = [one for one in solutions if one.status == 'reached'] or solutions
        low, high = self.model.limits.T
        highest = [float(((one.tensions - low) / (high - low)).max()) for one in candidates]
        enough = min(highest) + JUMP_MAX
        return next(one for one, size in zip(candidates, highest, strict=True) if size <= enough)


def tip_task(
    model: Model, settings: Settings, target: Target, memory: Array | None = None
) -> TipTask:
    """Return the task of the tip for a target, from a friction memory."""
    weight = settings.direction_weight or None
    return TipTask.at(model, target.position, target.direction, weight, memory)


def request_of(
    core: Controller,
    model: Model,
    target: Target,
    streamed: bool = False,
    tracking: bool = False,
) -> SearchRequest:
    """Return the search for a target from the present state of the core."""
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


def model_work(
    core: Controller, model: Model
) -> Callable[[GiveUp], tuple[Shape | None, Reach | None]]:
    """
    Return solver work: the present shape by a new model, and its solution for the current target.

    The work raises NoEquilibriumError where the new model has none at the present tensions, or for
    the target.
    """
    command, target, last, before = core.command, core.target, core.track.last, core.model
    other = another_robot(model.robot, before.robot)
    request = None if target is None or other else request_of(core, model, target)
    acting = None if command is None else core.acting_tensions()

    def work(give_up: GiveUp) -> tuple[Shape | None, Reach | None]:
        shape = None
        if command is not None and acting is not None:
            model.shape(command)
            shape = None if other else carry_friction(model, before, last, acting)
        if request is None:
            return shape, None
        return shape, replace(request, last=shape or request.last).answer(give_up).reach

    return work


def _continues(core: Controller, before: TargetSearch, target: Target) -> bool:
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
        return bool(old.direction @ target.direction > np.cos(STREAM_ROTATION_RAD))
    return True


def is_nearer(core: Controller, target: Target, solution: Reach) -> bool:
    """Whether a solution brings the tip nearer to a target than the last shape."""
    last = core.track.last
    task = tip_task(core.model, core.settings, target)
    return last is None or task.cost(solution.shape) < task.cost(last)
