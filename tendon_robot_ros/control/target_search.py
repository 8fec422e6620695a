"""
Search for the tensions of a target beside the control loop, and the path of the tensions there.

With friction the posture depends on the path of the tensions. An approach from below first lets
every tendon slip in all eyelets, so that equal tensions always lead to the same posture. Paths end
before keep-out regions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError, NoEquilibriumError
from ..common.estimation import ITERATIONS_MAX
from ..model.inverse import JUMP_MAX, POSITION_TOLERANCE_M, reach
from ..model.model import Model
from ..model.program import STEP_MAX
from ..model.shape import Reach, Shape
from ..model.tip_task import COLD, STREAM, TRACK, Patience, Policy, TipTask
from ..robot.keep_out import Clearance, KeepOut
from .inputs import (
    STREAM_PERIOD_S,
    Refusal,
    Settings,
    Target,
    Trajectory,
    another_robot,
    check_inputs,
)
from .solver import GiveUp, Work
from .state import ControllerState

Report = Callable[[Reach], None]  # called with the best solution so far
Solve = Callable[[Shape, Floats], Shape]
APPROACHES = 'any', 'from_below'
# [1] of the time between targets of a stream, because the evaluation of the shape needs the rest
STREAM_BUDGET = 0.8
# [s] about a cycle: the arm follows the solution at this time, else the command would wait for the
# whole search
FIRST_ANSWER_S = 0.006
# [1] of the length: largest step between two targets of a stream, and of its extrapolation; a
# larger step is a new target, because arms of this size take a second for it
STREAM_LENGTH = 0.1
# [rad] half a turn over the arm: wires near its outside move through eyelets by 80 presliding
# lengths, those at half of the radius by 40, so that every law of friction has lost its memory
FORGETTING_BEND_RAD = np.pi


@dataclass(frozen=True)
class Approach:
    """Tensions for a target, and the tensions (m,) [N] to pass before."""

    reach: Reach
    via: Sequence[Floats] = ()


@dataclass(frozen=True)
class TargetSearch:
    """
    A target whose tensions are searched.

    Attributes
    ----------
    target : Target
    began : float [s]
    budget : float [s]
        Time of the search: most of the time between targets of a stream, or of the slowest stream
        for a single target.
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
    velocity: Floats | None = None

    @classmethod
    def begin(
        cls,
        core: ControllerState,
        before: TargetSearch | None,
        last: Target | None,
        target: Target,
    ) -> TargetSearch:
        """Return the search, in the stream of the previous one where the target continues it."""
        now = core.time
        if before is None or before.target is not last or not before._continues(core, target):
            return cls(target, now, STREAM_BUDGET * STREAM_PERIOD_S, object())
        passed, velocity = max(now - before.began, 0.01), None
        if target.position is not None and before.target.position is not None:
            velocity = (target.position - before.target.position) / passed
            if before.velocity is not None:  # the periods of senders vary
                velocity = 0.5 * (velocity + before.velocity)
        return cls(target, now, STREAM_BUDGET * passed, before.stream, True, velocity)

    def _continues(self, core: ControllerState, target: Target) -> bool:
        """Whether a target belongs to this stream: close in time, position and direction."""
        if core.time - self.began > STREAM_PERIOD_S:
            return False
        # the tip of a bent arm rotates by two to three times its path over the length
        length = core.model.robot.length
        for old, new, most in (
            (self.target.position, target.position, STREAM_LENGTH * length),
            (self.target.direction, target.direction, 3.0 * STREAM_LENGTH),
        ):
            if (old is None) != (new is None):
                return False
            if old is not None and new is not None and np.linalg.norm(new - old) > most:
                return False
        return True

    def extrapolated(self, core: ControllerState) -> Target:
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
    core: ControllerState, search: TargetSearch, budget: float, report: Report
) -> Work[SearchResult]:
    """
    Return solver work: a search within a budget [s].

    `report` is called in the control thread with the first good solution; the search then uses the
    rest of the budget. Without one in the first budget, a second search begins at the best result.
    There the deadline is checked only between starts, so that at least one start completes.
    """
    policy = STREAM if search.streamed else COLD
    solve = SearchRequest.of(core, core.model, search.extrapolated(core), policy).answer
    first = budget == FIRST_ANSWER_S

    def work(give_up: GiveUp) -> SearchResult:
        remaining = search.budget - budget if first else 0.0

        def on_report(solution: Reach) -> None:
            nonlocal remaining
            core.solver.call_soon(lambda: report(solution))
            if isinstance(give_up, Patience):
                give_up.prolong(remaining)
                remaining = 0.0

        path, problem = None, ''
        try:
            path = solve(give_up if first else lambda: give_up(), on_report)
        except (NoEquilibriumError, InputError) as error:
            problem = str(error)
        return SearchResult(path, problem, not give_up(), remaining)

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
    policy : Policy
        `COLD`, `STREAM` for a target that continues a stream, or `TRACK` to search only near the
        present shape. The approach of the last two is straight.

    """

    model: Model
    settings: Settings
    target: Target
    as_sent: Target
    guess: Shape | None
    last: Shape | None
    acting: Floats
    policy: Policy

    @classmethod
    def of(
        cls, core: ControllerState, model: Model, target: Target, policy: Policy = COLD
    ) -> SearchRequest:
        """Return the search for a target from the present state of the core."""
        last, solution = core.track.last, core.solution
        guess, last = (
            None if shape is None or len(shape.bend) != model.robot.cells else shape
            for shape in (last if solution is None else solution.shape, last)
        )
        return cls(
            model=model,
            settings=core.settings,
            target=core.without_bias(target),
            as_sent=target,
            guess=guess,
            last=last,
            acting=core.acting_tensions(),
            policy=policy,
        )

    def answer(self, give_up: GiveUp, report: Report | None = None) -> Approach:
        """Return the approach to the target; `report` is called with intermediate solutions."""
        model, settings = self.model, self.settings
        from_below = settings.approach == 'from_below' and not self._local
        via = forgetting_tensions(model) if from_below else ()
        if from_below or settings.keep_out or settings.pull_mode:
            report = None
        # independent of the present shape, so that a position always has the same tensions
        guess = None if from_below else self.guess
        if not (model.remembers or settings.keep_out):
            return Approach(self._solve_from(None, guess, give_up, report), via)
        if self.last is not None and settings.pull_mode and model.bends_remember:
            start = self.last  # at the pulls, whose tensions may be others than the commanded ones
        else:
            start = model.follow(self.last, self.acting)
        past = start
        try:
            for tensions in via:
                past = model.follow(past, tensions)
        except NoEquilibriumError:  # then in a straight line
            past, via = start, ()
        closed = settings.tip_gain > 0.0 and not (via or settings.keep_out or settings.pull_mode)
        if closed and model.remembers and not self._local:
            path = Approach(self._for_closed_loop(start, give_up, report))
        elif model.remembers:
            path = Approach(self._solve_with_memory(past, give_up, report), via)
        else:
            path = Approach(self._solve_from(None, guess, give_up, report), via)
        return self._truncated(start, path) if settings.keep_out else path

    def _solve_with_memory(self, past: Shape, give_up: GiveUp, report: Report | None) -> Reach:
        """
        Return tensions for the target when it is approached from the shape `past`.

        The search begins at the solution for an arm without a past, because it does not depend on
        where the arm comes from: of several solutions every approach then ends in the same, and
        the model's errors are the same, too. Targets near the last one begin at the present shape.
        """
        model, settings, reference = self.model, self.settings, None
        smooth = settings.preferences is not None and settings.preferences.smooth > 0.0
        if not (self._local or smooth):
            with suppress(NoEquilibriumError):
                reference = self._solve_from(None, None, give_up)
        guess = self.guess or past if reference is None else reference.shape
        if settings.pull_mode:  # the same lengths are hardly another shape, whatever the tensions
            with suppress(NoEquilibriumError, InputError):
                guess = model.follow_pulls(past, guess.pulls)
        return self._solve_from(past, guess, give_up, report, reference)

    def _for_closed_loop(self, start: Shape, give_up: GiveUp, report: Report | None) -> Reach:
        """
        Return tensions from which the closed loop brings the tip to the target.

        From the present state of friction, an inaccurate model may require high co-contraction,
        where its error is largest. Solutions without the friction memory, and without the tip's
        bias, are therefore candidates, too: the first one whose highest tension is close to the
        lowest of all candidates is returned, and the loop corrects the rest.
        """
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

    @property
    def _local(self) -> bool:
        return self.policy is not COLD

    def _task(self, past: Shape | None) -> TipTask:
        """Return the task of the tip for an arm that comes from the shape `past`."""
        settings, memory = self.settings, None if past is None else past.memory
        task = tip_task(self.model, settings, self.target, memory)
        return replace(task, by_pulls=settings.pull_mode, keep_out=settings.keep_out)

    def _policies(self) -> list[Policy]:
        """
        Return search policies; each is tried where the model has no equilibrium by the one before.

        With friction memory, a target near the last one is searched near the present shape first.
        """
        if self.policy is TRACK:
            return [TRACK]
        # more starts would exceed the budget of a target
        cold = replace(COLD, starts=STREAM.starts)
        streamed = self.policy is STREAM
        if streamed and self.model.remembers:
            return [replace(STREAM, starts=0), cold]
        return [STREAM if streamed and self.model.sticks else cold]

    def _solve_from(
        self,
        past: Shape | None,
        guess: Shape | None,
        give_up: GiveUp,
        report: Report | None = None,
        reference: Reach | None = None,
    ) -> Reach:
        """
        Return tensions for the target when it is approached from the shape `past`.

        Near a `reference` first, and elsewhere only where that alone reaches the target.
        """
        preferences = None if self._local else self.settings.preferences
        task = replace(self._task(past), guess=guess, preferences=preferences)
        *policies, last = (*([TRACK] if reference else []), *self._policies())
        for policy in policies:
            with suppress(NoEquilibriumError):
                solution = reach(task, policy, give_up, report)
                nearest = reference is None or reference.status != 'reached'
                if nearest or solution.status == 'reached':
                    return solution
        return reach(task, last, give_up, report)

    def _truncated(self, start: Shape, path: Approach) -> Approach:
        """
        Return the part of an approach before the arm enters a region, with the status `nearest`.

        An arm that is inside a region already may leave it: only deeper postures are refused.
        """
        shape, ends = start, (*path.via, path.reach.tensions)
        steps = _postures(self.model.follow, start, start.inputs, ends, self.settings.keep_out)
        for leg, _, new, entered in steps:
            if entered is not None:
                errors = self._task(start).errors(shape)
                return Approach(Reach(shape, *errors, 'nearest', (), entered.region), ends[:leg])
            shape = new
        return path


def tip_task(
    model: Model, settings: Settings, target: Target, memory: Floats | None = None
) -> TipTask:
    """Return the task of the tip for a target, from a friction memory."""
    weight = settings.direction_weight or None
    return TipTask.at(model, target.position, target.direction, weight, memory)


def is_nearer(core: ControllerState, target: Target, solution: Reach) -> bool:
    """Whether a solution brings the tip nearer to a target than the last shape."""
    last = core.track.last
    task = tip_task(core.model, core.settings, target)
    return last is None or task.cost(solution.shape) < task.cost(last)


def model_work(core: ControllerState, model: Model) -> Work[tuple[Shape | None, Reach | None]]:
    """
    Return solver work: the present shape by a new model, and its solution for the current target.

    The work raises InputError for other inputs, and NoEquilibriumError where the new model has no
    equilibrium at the present tensions, or for the target.
    """
    command, target, last, before = core.command, core.target, core.track.last, core.model
    other = another_robot(model.robot, before.robot)
    request = None if target is None or other else SearchRequest.of(core, model, target)
    acting = None if command is None else core.acting_tensions()

    def work(give_up: GiveUp) -> tuple[Shape | None, Reach | None]:
        check_inputs(model.inputs, before.inputs)
        shape = None
        if command is not None and acting is not None:
            model.shape(command)
            shape = None if other else carry_friction(model, before, last, acting)
        if request is None:
            return shape, None
        return shape, replace(request, last=shape or request.last).answer(give_up).reach

    return work


def carry_friction(
    model: Model, before: Model, last: Shape | None, tensions: Floats
) -> Shape | None:
    """
    Return the shape by a new model with the directions of friction of the previous model.

    The arm has not moved, only its model has changed: the directions in which tendons were last
    dragged stay. The travel of the tendons is that of the new model, found by iteration: with the
    travel of the previous model, all tendons would have slipped by the difference.

    Parameters
    ----------
    model, before : Model
        The new and the previous model.
    last : Shape or None
        Last shape by `before`.
    tensions : (m,) [N]
        Tensions that act now.

    Returns
    -------
    Shape or None
        None where one of the models has no friction memory, where their cells or tendons differ,
        or where the new model has no equilibrium.

    """
    same = last is not None and (last.form.n, last.form.k) == (model.form.n, model.form.k)
    if last is None or not same or not (model.remembers and before.remembers):
        return None
    signs = slice(len(last.state), len(last.state) + last.tendon_tensions.size)
    directions, memory, shape = last.memory[signs].copy(), last.memory, last
    with suppress(NoEquilibriumError):
        for _ in range(ITERATIONS_MAX):
            shape = model.shape(tensions, shape.state, memory)
            if np.allclose(shape.memory[signs], directions, rtol=0.0, atol=1e-3):
                break  # of full friction: noise of load cells would change them by more
            memory = shape.memory.copy()
            memory[signs] = directions
        return shape
    return None


def forgetting_tensions(model: Model) -> tuple[Floats, Floats]:
    """
    Return two tensions (m,) [N] that erase the memory of friction when they act in sequence.

    The tendons on one side bend the whole arm, then all tensions fall to their lower limits: in
    every eyelet every tendon has slipped in both directions, whatever its law of friction. The
    side is that of the tendon for which the smallest slip of the others is largest.
    """
    ends = np.array([tendon.end for tendon in model.robot.tendons])
    radii = np.hypot(*ends.T)
    arms = [ends @ (end / radius) for end, radius in zip(ends, radii, strict=True) if radius > 0.0]
    along = max(arms, key=lambda arm: float(np.abs(arm).min()))  # (tendons,) [m]
    pulls = np.array([along[list(members)].mean() for members in model.robot.input_tendons])
    side = np.maximum(pulls, 0.0) / np.abs(along).max()
    low, high = model.limits.T
    shape = straight = model.shape(low)
    for more in np.arange(STEP_MAX, 1.0, STEP_MAX) * float((high - low).max()):
        try:
            shape = model.shape(np.clip(low + more * side, low, high), shape.state)
        except NoEquilibriumError:
            break
        if np.linalg.norm(shape.bend - straight.bend, axis=1).sum() >= FORGETTING_BEND_RAD:
            break
    return shape.inputs, low


def keep_out_refusal(
    model: Model, start: Shape, trajectory: Trajectory, keep_out: KeepOut, pull: bool
) -> Refusal | None:
    """
    Return why a trajectory of the tendons enters a region, None where it keeps out of all.

    Parameters
    ----------
    start : Shape
        Present shape.
    trajectory : Trajectory
        Tensions or, where `pull`, wire pulls; straight lines from the present ones to the first
        point and between the points.

    """
    solve = model.follow_pulls if pull else model.follow
    begin, times, time = start.pulls if pull else start.inputs, (0.0, *trajectory.times), 0.0
    try:
        for leg, part, _, entered in _postures(solve, start, begin, trajectory.values, keep_out):
            time = times[leg] + part * (times[leg + 1] - times[leg])
            if entered is not None:
                code, problem = 'keep_out', f'at {time:.2f} s the arm would enter {entered.region}'
                break
        else:
            return None
    except (NoEquilibriumError, InputError) as error:
        code = 'no_equilibrium'
        problem = (
            f'after {time:.2f} s nobody can say whether the arm keeps out of the regions: {error}'
        )
    return Refusal(code, f'tendon_trajectory: {problem}; nothing of it was played')


def _postures(
    solve: Solve, shape: Shape, begin: Floats, ends: Iterable[Floats], keep_out: KeepOut
) -> Iterator[tuple[int, float, Shape, Clearance | None]]:
    """
    Yield postures along straight legs: leg, fraction of it, shape, and the region it enters.

    A region is entered where the arm is deeper in it than at the beginning. No point moves by
    more than half of the clearance between two postures, as far as the shortest step allows it, so
    that none cuts a corner of a region.
    """
    allowed = min(keep_out.clearance(shape.positions).distance, 0.0) - POSITION_TOLERANCE_M
    for leg, end in enumerate(ends):
        fraction, step = 0.0, STEP_MAX
        while fraction < 1.0:
            fraction = min(fraction + step, 1.0)
            new = solve(shape, begin + fraction * (end - begin))
            moved = float(np.linalg.norm(new.positions - shape.positions, axis=1).max())
            clearance = keep_out.clearance(new.positions)
            yield leg, fraction, new, clearance if clearance.distance < allowed else None
            factor = 0.5 * clearance.distance / max(moved, 1e-9)
            step, shape = min(max(step * factor, 0.1 * STEP_MAX), 2.0 * step), new
        begin = end
