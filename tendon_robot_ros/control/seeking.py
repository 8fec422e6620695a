"""Tensions for a target: searched beside the commands, for a limited time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError, NoEquilibriumError, TendonRobotError
from ..model.shape import Reach
from ..model.tip_task import Patience, TipTask, tip_target
from .checks import Refusal
from .friction_state import Approach, forgotten, from_below, straight
from .keeping_out import cut_short
from .solver import GiveUp
from .state import STREAM_PERIOD_S, Controller, Settings, Target

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Shape

Array = NDArray[np.float64]
COLD_SEARCH_STARTS = 12  # of a cold search; a twist only goes on from where it is
NEW_TARGET_BUDGET_S = 0.2  # [s] for a target that is none of a stream
STREAM_BUDGET_SHARE = 0.8  # [1] of the time between targets of a stream; the shape needs the rest
FIRST_ANSWER_S = 0.006  # [s] in which a search that finds nothing on its way is cut for once
# [1] of the length, [rad] between two targets of a stream
STREAM_STEP_SHARE, STREAM_TURN_RAD = 0.1, 0.3
MORE_TENSION_MAX = 0.1  # [1] of a tension's range, for a nearer tip that the loop finds anyway
LEAD_SHARE_MAX = 0.1  # [1] of the length, by which targets are led


Tell = Callable[[Reach], None]  # is given what a search has found so far


class Seeker(Controller, Protocol):
    """A controller that looks for the tensions of a target."""

    search: TargetSearch | None  # for a target that is not yet followed
    asked: TargetSearch | None  # the last one

    def follow(
        self, target: Target, found: Approach, in_time: bool = True, led: Target | None = None
    ) -> None:
        """Go to where the tensions for a target are, or for one that leads it."""


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
    def begin(cls, core: Seeker, target: Target, now: float) -> TargetSearch:
        """Look whether the target goes on from the one before."""
        before = core.asked
        if before is None or not _goes_on(core, before, target, now):
            return cls(target, now, NEW_TARGET_BUDGET_S, object())
        passed, velocity = max(now - before.began, 0.01), None
        if target.position is not None and before.target.position is not None:
            velocity = (target.position - before.target.position) / passed
            if before.velocity is not None:  # senders are not that regular
                velocity = 0.5 * (velocity + before.velocity)
        budget = STREAM_BUDGET_SHARE * passed
        return cls(target, now, budget, before.stream, True, velocity)


@dataclass(frozen=True)
class SearchResult:
    """What a search found; the deadline may have ended it."""

    found: Approach | None
    problem: str
    in_time: bool
    left: float = 0.0  # [s] for which it may go on


def seek(core: Seeker, target: Target) -> None:
    """Look for the tensions of a target; until they are found the arm goes on as before."""
    search = core.search = core.asked = TargetSearch.begin(core, target, core.stepped)
    _search_on(core, search, min(search.budget, FIRST_ANSWER_S))


def _search_on(core: Seeker, search: TargetSearch, budget: float) -> None:
    """
    Search for a time [s]; what is much nearer is gone to while the search goes on.

    Where nothing was within the first time, what is found when it ends is where another search
    begins.
    """
    solve = question_of(core, core.model, _ahead(core, search), search.streamed).answer
    first = budget == FIRST_ANSWER_S

    def work(give_up: GiveUp) -> SearchResult:
        left = search.budget - budget if first else 0.0

        def tell(found: Reach) -> None:
            nonlocal left
            core.solver.tell(lambda: _go_on(core, search, found))
            if isinstance(give_up, Patience):
                give_up.prolong(left)
                left = 0.0

        try:
            # the second is asked between starts only: on a slow machine none would get anywhere
            found = solve(give_up if first else lambda: give_up(), tell)
        except (NoEquilibriumError, InputError) as error:
            return SearchResult(None, str(error), not give_up(), left)
        return SearchResult(found, '', not give_up(), left)

    def done(result: SearchResult, error: TendonRobotError | None) -> None:
        if error is not None:
            result = SearchResult(None, str(error), True)
        _take(core, search, result)

    core.solver.post('target', work, done, budget, urgent=True)


def _go_on(core: Seeker, search: TargetSearch, found: Reach) -> None:
    """Go where a search is on its way, unless something else is wanted by now."""
    if core.search is search:
        core.follow(search.target, straight(found), False, _ahead(core, search))


def _ahead(core: Seeker, search: TargetSearch) -> Target:
    """Return where a stream of targets will be by the time that the arm has followed."""
    target, lead = search.target, core.settings.look_ahead
    if lead == 0.0 or search.velocity is None or target.position is None:
        return target
    step = lead * search.velocity
    size, most = float(np.linalg.norm(step)), LEAD_SHARE_MAX * core.model.robot.length
    return replace(target, position=target.position + step * min(1.0, most / max(size, 1e-12)))


@dataclass(frozen=True)
class ReachQuestion:
    """What the solver is asked: it reads nothing that the commanding thread changes."""

    model: Model
    settings: Settings
    target: Target  # without what the measured tip is off
    asked: Target  # with it
    guess: Shape | None
    last: Shape | None  # the last shape, with what friction remembered
    felt: Array  # (m,) [N] that act now
    streamed: bool
    tracking: bool

    def reach(
        self, past: Shape | None, guess: Shape | None, give_up: GiveUp, tell: Tell | None = None
    ) -> Reach:
        """
        Find tensions that are right when they are reached from a shape.

        Where friction remembers, a target near the last one is looked for near there alone.
        """
        if self._near and self.model.remembers:
            try:
                return self._reach(past, guess, give_up, tell, gently=True)
            except NoEquilibriumError:
                if self.tracking:
                    raise
        gently = self.streamed and self.model.sticks
        return self._reach(past, guess, give_up, tell, gently)

    def _reach(
        self,
        past: Shape | None,
        guess: Shape | None,
        give_up: GiveUp,
        tell: Tell | None,
        gently: bool,
    ) -> Reach:
        near = self.tracking or (gently and self.model.remembers)
        return self.model.reach(
            position=self.target.position,
            direction=self.target.direction,
            guess=guess,
            direction_weight=self.settings.direction_weight or None,
            starts=0 if near else COLD_SEARCH_STARTS,
            by_pulls=self.settings.pull_mode,
            relax=not self.tracking,
            gently=gently,
            memory=None if past is None else past.memory,
            preferences=None if self._near else self.settings.preferences,
            keep_out=self.settings.keep_out,
            give_up=give_up,
            tell=tell,
        )

    @property
    def _near(self) -> bool:
        return self.tracking or self.streamed

    @property
    def kind(self) -> str:
        """How the target is approached."""
        return 'any' if self._near else self.settings.approach

    @property
    def _below(self) -> bool:
        return self.kind == 'from_below'

    def _guess(self) -> Shape | None:
        """Return where to begin; the same place is always found by the same tensions."""
        return None if self._below else self.guess

    def _loose(self, here: Shape, give_up: GiveUp, tell: Tell | None) -> Reach:
        """
        Find tensions from where the closed loop brings the tip to its place.

        From the state of friction that is, a model that is not the arm's may ask for much tension
        against much tension, where it is furthest off. Then friction is left to the loop, and so
        is by how much the tip was off elsewhere.
        """
        ways: list[tuple[ReachQuestion, Shape | None, Tell | None]] = [(self, here, tell)]
        if not (self.streamed or self.tracking or self.settings.pull_mode):
            bare = replace(self, target=self.asked)
            ways = [(self, None, tell), (bare, None, None), (self, here, None)]
        found: list[Reach] = []
        for count, (question, past, told) in enumerate(ways):
            try:
                if not (found and give_up()):
                    made = question.reach(past, self.guess or past, give_up, told)
                    found.insert(len(found) if past is None else 0, made)
            except NoEquilibriumError:
                if not found and count == len(ways) - 1:
                    raise
        there = [one for one in found if one.status == 'reached'] or found
        low, high = self.model.limits.T
        most = [float(((one.tensions - low) / (high - low)).max()) for one in there]
        enough = min(most) + MORE_TENSION_MAX
        return next(one for one, size in zip(there, most, strict=True) if size <= enough)

    def answer(self, give_up: GiveUp, tell: Tell | None = None) -> Approach:
        """Find tensions and the way there; `tell` of what is found meanwhile, if that is it."""
        model, settings = self.model, self.settings
        if self.kind != 'any' or settings.keep_out or settings.pull_mode:
            tell = None
        if not (model.remembers or settings.keep_out):
            direct = self.reach(None, self._guess(), give_up, tell)
            return from_below(model, direct) if self._below else straight(direct)
        here = model.follow(self.last, self.felt)
        past = here if model.remembers else None
        if settings.tip_gain > 0.0 and self.kind == 'any' and not settings.keep_out:
            return straight(self._loose(here, give_up, tell))
        direct = self.reach(past, self._guess() or past, give_up, tell)

        def again(there: Shape) -> Reach:
            return self.reach(there if model.remembers else None, there, give_up)

        found = forgotten(model, here, direct, again) if self._below else straight(direct)
        if settings.keep_out:
            weight = settings.direction_weight or None
            asked = tip_target(model, self.target.position, self.target.direction, 1.0, weight)
            task = TipTask(model, asked, here.memory)
            found = cut_short(model, here, found, settings.keep_out, task)
        return found


def question_of(
    core: Controller, model: Model, target: Target, streamed: bool = False, tracking: bool = False
) -> ReachQuestion:
    """
    Return the question of the tensions for a target, from where the arm is.

    Parameters
    ----------
    streamed : bool
        The target goes on from the one before: straight there.
    tracking : bool
        Search only near where the arm is.

    """
    guess = core.track.last if core.solution is None else core.solution.shape
    guess, last = (
        None if shape is None or len(shape.bend) != model.robot.cells else shape
        for shape in (guess, core.track.last)
    )
    asked, felt = target, core.felt_tensions()
    if target.position is not None:
        target = replace(target, position=target.position - core.tip_shift(target.position))
    return ReachQuestion(
        model, core.settings, target, asked, guess, last, felt, streamed, tracking
    )


def _take(core: Seeker, search: TargetSearch, result: SearchResult) -> None:
    """Use what was found, unless something else is wanted by now; search on for what is left."""
    newest, left = core.search, 0.0 if result.in_time else result.left
    if newest is None or newest.stream is not search.stream:
        return
    if newest is search and left > 0.0:
        if result.found is not None and _nearer(core, search.target, result.found.reach):
            core.follow(search.target, result.found, False, _ahead(core, search))
        _search_on(core, search, left)
        return
    if newest is search:
        core.search = None
    elif result.found is None:
        return  # of a stream: the next one may be better
    if result.found is not None:  # of a stream an older target, too, is on the way
        core.follow(search.target, result.found, result.in_time, _ahead(core, search))
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


def _nearer(core: Controller, target: Target, found: Reach) -> bool:
    """Whether tensions bring the tip nearer to a target than it is."""
    last = core.track.last
    if last is None:
        return True
    asked = tip_target(
        core.model,
        target.position,
        target.direction,
        1.0,
        core.settings.direction_weight or None,
    )
    weights = np.repeat(asked[6:], 3)
    before, after = (
        np.concatenate([shape.tip_position, shape.tip_direction]) for shape in (last, found.shape)
    )
    off = [float(np.linalg.norm(weights * (tip - asked[:6]))) for tip in (before, after)]
    return off[1] < off[0]
