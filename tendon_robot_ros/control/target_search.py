"""Tensions for a target: searched beside the commands, for a limited time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError, NoEquilibriumError
from ..model.shape import Reach
from ..model.tip_task import Patience, TipTask, tip_target
from .friction import Approach, forgetting, forgotten
from .keeping_out import cut_short
from .solver import GiveUp
from .state import STREAM_PERIOD_S, Controller, Settings, Target

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Shape

Array = NDArray[np.float64]
COLD_SEARCH_STARTS = 12  # of a search from nowhere; a twist only goes on from where it is
NEW_TARGET_BUDGET_S = 0.2  # [s] for a target that is none of a stream
STREAM_BUDGET_SHARE = 0.8  # [1] of the time between targets of a stream; the shape needs the rest
FIRST_ANSWER_S = 0.006  # [s] about a cycle: what is found until then is gone to
STREAM_STEP_SHARE = 0.1  # [1] of the length: what is further off is no stream
STREAM_TURN_RAD = 0.3  # [rad] and what is turned further
MORE_TENSION_MAX = 0.1  # [1] of a tension's range, for a nearer tip that the loop finds anyway
LEAD_SHARE_MAX = 0.1  # [1] of the length: further ahead a stream is not where it will go

Tell = Callable[[Reach], None]  # is given what a search has found so far


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
        cls, core: Controller, before: TargetSearch | None, asked: Target | None, target: Target
    ) -> TargetSearch:
        """Look whether the target goes on from the search before; `asked` is what was last."""
        now = core.time
        if before is None or before.target is not asked or not _goes_on(core, before, target):
            return cls(target, now, NEW_TARGET_BUDGET_S, object())
        passed, velocity = max(now - before.began, 0.01), None
        if target.position is not None and before.target.position is not None:
            velocity = (target.position - before.target.position) / passed
            if before.velocity is not None:  # senders are not that regular
                velocity = 0.5 * (velocity + before.velocity)
        budget = STREAM_BUDGET_SHARE * passed
        return cls(target, now, budget, before.stream, True, velocity)

    @property
    def first_budget(self) -> float:
        """Time [s] after which what was found is gone to, while the search goes on."""
        return min(self.budget, FIRST_ANSWER_S)


@dataclass(frozen=True)
class SearchResult:
    """What a search found; the deadline may have ended it."""

    found: Approach | None
    problem: str
    in_time: bool
    left: float = 0.0  # [s] for which it may go on


def searching(
    core: Controller, search: TargetSearch, budget: float, tell: Tell
) -> Callable[[GiveUp], SearchResult]:
    """
    Return how to search for a time [s]; `tell` hears in the commanding thread what is found first.

    Where nothing was within the first time, what is found when it ends is where another search
    begins. In that one the deadline is looked at only between starts, so that one start at least
    comes to its end.
    """
    solve = question_of(core, core.model, ahead_of(core, search), search.streamed).answer
    first = budget == FIRST_ANSWER_S

    def work(give_up: GiveUp) -> SearchResult:
        left = search.budget - budget if first else 0.0

        def told(found: Reach) -> None:
            nonlocal left
            core.solver.tell(lambda: tell(found))
            if isinstance(give_up, Patience):
                give_up.prolong(left)
                left = 0.0

        try:
            found = solve(give_up if first else lambda: give_up(), told)
        except (NoEquilibriumError, InputError) as error:
            return SearchResult(None, str(error), not give_up(), left)
        return SearchResult(found, '', not give_up(), left)

    return work


def ahead_of(core: Controller, search: TargetSearch) -> Target:
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
    acting: Array  # (m,) [N] that act now
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

    def _for_closed_loop(self, here: Shape, give_up: GiveUp, tell: Tell | None) -> Reach:
        """
        Find tensions from where the closed loop brings the tip to its place.

        From the present state of friction, a model that is not the arm's may ask for much tension
        against much tension, where it is furthest off. Then friction is left to the loop, and so
        is the tip's bias elsewhere.
        """
        if self.streamed or self.tracking or self.settings.pull_mode:
            return self.reach(here, self.guess or here, give_up, tell)
        without_bias = replace(self, target=self.asked)
        found: list[Reach] = []
        for question, past, told in (
            (self, None, tell),
            (without_bias, None, None),
            (self, here, None),
        ):
            try:
                if not (found and give_up()):
                    made = question.reach(past, self.guess or past, give_up, told)
                    found.insert(len(found) if past is None else 0, made)
            except NoEquilibriumError:
                if not found and past is not None:  # the last one
                    raise
        there = [one for one in found if one.status == 'reached'] or found
        low, high = self.model.limits.T
        most = [float(((one.tensions - low) / (high - low)).max()) for one in there]
        enough = min(most) + MORE_TENSION_MAX
        return next(one for one, size in zip(there, most, strict=True) if size <= enough)

    def answer(self, give_up: GiveUp, tell: Tell | None = None) -> Approach:
        """Find tensions and the approach to them; `tell` hears what is found meanwhile."""
        model, settings = self.model, self.settings
        if self.kind != 'any' or settings.keep_out or settings.pull_mode:
            tell = None
        if not (model.remembers or settings.keep_out):
            direct = self.reach(None, self._guess(), give_up, tell)
            straight = Approach.straight(direct)
            return replace(straight, via=forgetting(model)) if self._below else straight
        here = model.follow(self.last, self.acting)
        past = here if model.remembers else None
        if settings.tip_gain > 0.0 and self.kind == 'any' and not settings.keep_out:
            return Approach.straight(self._for_closed_loop(here, give_up, tell))
        direct = self.reach(past, self._guess() or past, give_up, tell)

        def again(there: Shape) -> Reach:
            return self.reach(there if model.remembers else None, there, give_up)

        found = Approach.straight(direct)
        if self._below:
            found = forgotten(model, here, direct, again)
        if settings.keep_out:
            weight = settings.direction_weight or None
            asked = tip_target(model, self.target.position, self.target.direction, 1.0, weight)
            task = TipTask(model, asked, here.memory)
            found = cut_short(model, here, found, settings.keep_out, task)
        return found


def question_of(
    core: Controller,
    model: Model,
    target: Target,
    streamed: bool = False,
    tracking: bool = False,
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
    asked, acting = target, core.acting_tensions()
    if target.position is not None:
        target = replace(target, position=target.position - core.tip_bias(target.position))
    return ReachQuestion(
        model, core.settings, target, asked, guess, last, acting, streamed, tracking
    )


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
        if step > STREAM_STEP_SHARE * core.model.robot.length:
            return False
    if old.direction is not None and target.direction is not None:
        return bool(old.direction @ target.direction > np.cos(STREAM_TURN_RAD))
    return True


def is_nearer(core: Controller, target: Target, found: Reach) -> bool:
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
