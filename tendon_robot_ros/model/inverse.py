"""Tensions for a target of the tip, within limits; also for an arm driven by wire lengths."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import islice

import numpy as np

from ..common.arrays import Floats
from ..common.errors import NoEquilibriumError
from ..common.estimation import ITERATIONS_MAX
from .program import within
from .pulls import command, held_shape
from .redundancy import Balance, balanced
from .shape import Reach, Shape
from .starts import (
    FEW_STARTS,
    SEEKING_WEIGHT,
    TRACKING_GAIN_MIN,
    TRIALS_MAX,
    Aim,
    Start,
    TriedTensions,
    aim,
    aim_by_pulls,
    aim_frugally,
    cost_at,
    rows_near,
    seek,
    starts_of,
)
from .tip_task import (
    COLD,
    CONVERGED_LENGTH,
    LOW_TENSION_WEIGHT,
    Patience,
    Policy,
    Preferences,
    TipTask,
    cost_of,
)

# [m] of a target that counts as reached: an order below trackers, so that they see no error
# (docs/model.md)
POSITION_TOLERANCE_M = 1e-4
# [rad] of a direction that counts as reached, with the same reason (docs/model.md)
DIRECTION_TOLERANCE = np.deg2rad(0.2)
# [m²] cost of a tip at that distance. Where friction remembers, searches from far away end at much
# tension against much tension, so that what the first start reaches is good enough
TOLERANCE_COST_M2 = cost_of(POSITION_TOLERANCE_M)
# [1] of a tension's range: a change that is larger is a jump, because it takes a drive seconds
JUMP_MAX = 0.1
# [1] of the cost of the one before, that a solution which jumps, or which is reported before the
# search ends, must have less than, because the tip would hardly be nearer for it
WORTHWHILE_MAX = 0.8


def reach(
    task: TipTask,
    policy: Policy = COLD,
    give_up: Callable[[], bool] = lambda: False,
    report: Callable[[Reach], None] | None = None,
) -> Reach:
    """
    Find tensions within the limits that bring the tip to a target.

    Parameters
    ----------
    task : TipTask
        The target of the tip, the present shape and the keep-out regions. A target that leads into
        a region gives the status `nearest`, with the region named.
    policy : Policy
        How many starts the search tries, and what tension costs.
    give_up : callable
        Called between starts, a `Patience` also between the steps of a search; once it returns
        True, `reach` returns the best solution so far.
    report : callable, optional
        Called with the best solution so far when it is much nearer than the one reported before,
        or than the guess: the arm can move there while the search continues.

    Raises
    ------
    NoEquilibriumError
        No start of the search leads to an equilibrium.

    """
    patience = give_up if isinstance(give_up, Patience) else Patience()
    task = replace(task, patience=patience)
    search = _Search(task, policy, give_up, report)
    best, model = search.first_converged(), task.model
    late = give_up()
    if not search.good_enough(best):
        # from a guess, without friction that sticks, it takes a millisecond: also when it is late
        if not late or (task.guess is not None and not model.sticks):
            best = search.priced_best(best, late)
    elif search.relaxes and not late:
        best = search.relaxed(best)
    solution = judged(task, best.inputs, best.state, in_time=not give_up())
    clearance = task.keep_out.clearance(solution.shape.positions).distance
    if task.preferences is None and clearance >= 0.0:
        return solution
    present = None if task.guess is None else task.guess.inputs
    # beyond reach the nearest tip is the target: no tension reaches the requested one
    held = task if solution.status == 'reached' else task.held_at(solution.shape)
    preferences = task.preferences or Preferences()
    balance = Balance(held, preferences, task.keep_out, present)
    return _balanced(task, balance, solution, give_up)


class _Search:
    """One search: its task, its policy and its tolerances."""

    def __init__(
        self,
        task: TipTask,
        policy: Policy,
        give_up: Callable[[], bool],
        report: Callable[[Reach], None] | None,
    ) -> None:
        self.task, self.policy, self.model = task, policy, task.model
        self.give_up, self.report = give_up, report
        converged = CONVERGED_LENGTH * self.model.robot.length
        # [m²] friction near standstill turns within four times as much (docs/model.md)
        self.converged_cost, self.kink_cost = cost_of(converged), cost_of(4.0 * converged)
        counts = policy.change_weight > 0.0 and self.model.sticks
        self.previous = task.guess if counts else None  # changes from its tensions cost
        free = not (task.by_pulls or task.preferences or self.previous)
        # whether to go on from a solution to one of low tension
        self.relaxes = free and (policy.relax or task.guess is None)

    def first_converged(self) -> TriedTensions:
        """Return the solution of the first start that converges, else the best of all."""
        task, sticks, remembers = self.task, self.model.sticks, self.model.remembers
        best: TriedTensions | None = None
        lowest_worth = cost_at_guess = np.inf
        low, high = self.model.limits.T
        present = low if task.guess is None else task.guess.inputs
        if self.report is not None and task.guess is not None:
            worth = task.worth(task.cost(task.guess), task.guess.inputs)
            cost_at_guess = (1.0 - TRACKING_GAIN_MIN) * worth
        last_reported = cost_at_guess
        for count, start in enumerate(starts_of(task, self.policy, self.report is not None)):
            trial = self._from(start)
            worth = self._worth(trial)
            converged = self._converged(trial) and not self._jumps(self.previous, trial)
            jumps = task.guess is not None and self._jumps(best, trial)
            fraction = WORTHWHILE_MAX if jumps and not converged else 1.0
            if best is None or worth < fraction * lowest_worth:
                best, lowest_worth = trial, worth
            # `worth`, since a target beyond reach is no reason to move to the limits of tension
            nearer = task.worth(best.cost, best.inputs) < last_reported
            if self.report is not None and nearer and (sticks or not converged):
                more = (best.inputs - present).sum()  # than the present tensions
                tense = more > JUMP_MAX * (high - low).sum()
                early = self._priced(best, best) if tense and not converged else best
                self.report(judged(task, early.inputs.copy(), early.state, in_time=False))
                last_reported = WORTHWHILE_MAX * task.worth(early.cost, early.inputs)
            good_enough = (sticks and count >= FEW_STARTS and best.cost < self.kink_cost) or (
                remembers and count == 0 and trial.cost < TOLERANCE_COST_M2
            )
            # the start after the first search is a first move of the arm, and takes no time
            unmoved = self.report is not None and last_reported == cost_at_guess
            must_find_first_move = sticks and count <= 1 and unmoved
            if converged or good_enough or (self.give_up() and not must_find_first_move):
                break
        assert best is not None
        if not np.isfinite(best.cost):
            effects = self.model.implicit_effects
            raise NoEquilibriumError('any start of the search', effects, np.inf)
        return best

    def priced_best(self, best: TriedTensions, late: bool) -> TriedTensions:
        """
        Return tensions for a target beyond reach whose error is worth their cost.

        The searches start from the best solution, from the present shape and, unless targets
        follow each other, from the straight arm at its lowest tensions.
        """
        guess, model = self.task.guess, self.model
        best = self._priced(best, best)
        if guess is not None:
            inputs = within(guess.inputs, *self.task.limits.T)
            best = self._priced(best, TriedTensions(inputs, guess.state))
        if not (self.policy.frugal or late):
            straight = TriedTensions(model.limits[:, 0], np.zeros(3 * model.robot.cells))
            best = self._priced(best, straight)
        return best

    def relaxed(self, best: TriedTensions) -> TriedTensions:
        """Return a solution of lower tension if it still converges, else the given one."""
        task, limits, result = self.task, self.model.limits, best
        if self.model.sticks:
            result = seek(task, 0.1, best, limits)
        else:
            for weight in (100.0 * SEEKING_WEIGHT, SEEKING_WEIGHT, LOW_TENSION_WEIGHT):
                result = aim(task, 0.0, result, limits, task.tension(weight))
        better = result.cost < best.cost and self._converged(result)
        return result if better and self._is_found_again(result) else best

    def good_enough(self, one: TriedTensions) -> bool:
        """Tell whether a search may end: converged, or as near as a kink of friction allows."""
        return self._converged(one) or (self.model.sticks and one.cost < self.kink_cost)

    def _from(self, start: Start) -> TriedTensions:
        search, tried = start
        if self.task.by_pulls:
            return aim_by_pulls(self.task, search, tried)
        trial = search(tried, self.model.limits)
        return trial if self._is_found_again(trial) else replace(trial, cost=np.inf)

    def _is_found_again(self, one: TriedTensions) -> bool:
        """Tell whether its bends lead to it again: tendons that stick have several equilibria."""
        return not self.model.sticks or np.isfinite(cost_at(self.task, one, self.task.limits).cost)

    def _converged(self, one: TriedTensions) -> bool:
        """Tell whether the cost without its part for low tension is within the tolerance."""
        low_tension = self.task.above_lowest(LOW_TENSION_WEIGHT, one.inputs)
        return one.cost - low_tension < self.converged_cost

    def _worth(self, one: TriedTensions) -> float:
        """Return the cost [m²] of the tip with those of tension and of the change of tension."""
        task, cost = self.task, self.task.worth(one.cost, one.inputs)
        if self.model.remembers:
            cost += task.above_lowest(SEEKING_WEIGHT, one.inputs)
        if self.previous is not None:
            change = one.inputs - self.previous.inputs
            weight = self.policy.change_weight * task.per_newton
            cost += 0.5 * weight**2 * float(change @ change)
        return cost

    def _jumps(self, before: TriedTensions | Shape | None, trial: TriedTensions) -> bool:
        """Tell whether tensions are far from those before, if there are any."""
        low, high = self.model.limits.T
        far = JUMP_MAX * (high - low)
        return before is not None and bool(np.any(np.abs(trial.inputs - before.inputs) > far))

    def _priced(self, best: TriedTensions, start: TriedTensions) -> TriedTensions:
        """
        Return the solution of a search with a price of tension, or `best` where that is better.

        A frugal policy adds the cost of tension. The change of tension costs nothing here: else
        the arm would lag behind a moving target, and jump. A target that is nearly reached is
        within reach: there only a nearer tip counts as better.
        """
        task, weight = self.task, self.policy.tension_weight

        def worth(one: TriedTensions) -> float:
            if best.cost < TOLERANCE_COST_M2:
                return one.cost
            return task.worth(one.cost + task.above_lowest(weight, one.inputs), one.inputs)

        tension = task.tension(weight, priced=True)
        search: Aim = partial(aim, task, 0.0, tension=tension)
        if self.policy.frugal:
            search = partial(aim_frugally, task, tension, TRIALS_MAX)
        result = search(start, task.limits)
        if task.by_pulls:  # only the taut wires keep tension
            result = aim_by_pulls(task, search, result)
        return result if worth(result) < worth(best) and self._is_found_again(result) else best


def _balanced(task: TipTask, balance: Balance, first: Reach, give_up: Callable[[], bool]) -> Reach:
    """Use the null space of the tip as preferred, and keep the arm out of regions."""
    regions = balance.keep_out
    before = regions.clearance(first.shape.positions)
    if task.by_pulls and before.distance >= 0.0:
        return first  # wires of given lengths leave no freedom
    solution, clearance = first, before
    for start in _starts_outside(balance, first.shape):
        shape = balanced(balance, start, ITERATIONS_MAX, give_up)
        if task.by_pulls:
            shape = task.shape(shape.inputs, shape.state)
            shape = held_shape(task.model, shape.pulls, shape, task.past)
        solution = judged(task, shape.inputs, shape.state, in_time=not give_up())
        if not regions:
            return solution
        clearance = regions.clearance(solution.shape.positions)
        if clearance.distance > -POSITION_TOLERANCE_M or give_up():
            break
    if clearance.distance > -POSITION_TOLERANCE_M and solution.status == 'reached':
        return solution
    kept = clearance.distance < POSITION_TOLERANCE_M or before.distance < 0.0
    name = clearance.region if clearance.distance < POSITION_TOLERANCE_M else before.region
    return replace(solution, status='nearest', region=name) if kept else solution


def _starts_outside(balance: Balance, shape: Shape) -> Iterator[Shape]:
    """Yield the shape, then those of the library that are outside of regions and near the tip."""
    yield shape
    if not balance.keep_out:
        return
    model, task = balance.task.model, balance.task
    free = balance.keep_out.distances(model.library.positions).min(axis=(0, 2)) > 0.0
    for row in islice((row for row in rows_near(task) if free[row]), FEW_STARTS):
        try:
            yield task.shape(model.library.inputs[row], model.library.state[row])
        except NoEquilibriumError:
            continue


def judged(task: TipTask, inputs: Floats, state: Floats, in_time: bool = True) -> Reach:
    """Return the tip errors of tensions (m,) [N], and whether tension limits cause them."""
    model, shape = task.model, task.shape(inputs, state)
    errors = task.errors(shape)
    if task.by_pulls:
        command(model, shape, task.past)
    top = model.limits[:, 1].tolist()
    at_limit = tuple(
        name
        for name, value, high in zip(model.inputs, inputs.tolist(), top, strict=True)
        if value >= high - 1e-9
    )
    status = 'reached'
    if not _within_tolerance(errors):
        bind = at_limit and in_time and _limits_bind(task, inputs, state)
        status = 'at_limit' if bind else 'nearest'
    return Reach(shape, *errors, status, at_limit)


def _within_tolerance(errors: tuple[float, float]) -> bool:
    return errors[0] <= POSITION_TOLERANCE_M and errors[1] <= DIRECTION_TOLERANCE


def _limits_bind(task: TipTask, inputs: Floats, state: Floats) -> bool:
    """Tell whether the target would be reached with three times the tension."""
    start, limits = TriedTensions(inputs, state), task.model.limits * [1.0, 3.0]
    more = aim(task, TRACKING_GAIN_MIN, start, limits)
    try:
        errors = task.errors(task.shape(more.inputs, more.state))
        return bool(np.isfinite(more.cost)) and _within_tolerance(errors)
    except NoEquilibriumError:
        return False
