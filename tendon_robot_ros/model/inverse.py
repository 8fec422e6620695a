"""Tensions for a target of the tip, within limits; also for an arm driven by wire lengths."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..common.errors import NoEquilibriumError
from ..robot.keep_out import KeepOut
from .program import within
from .pulls import Aim, aim_by_pulls, limits_by_pulls, pull_shape
from .redundancy import Balance, Preferences, balanced
from .shape import Reach, Shape
from .starts import (
    GAIN_MIN,
    GENTLE_SHARE,
    LOW_TENSION_SHARE,
    SEEKING_WIDTHS,
    TRACKING_GAIN_MIN,
    TRIALS_MAX,
    aim,
    aim_gently,
    beginnings,
    rows_near,
    seek,
)
from .tip_task import Patience, TipTask, tip_target

if TYPE_CHECKING:
    from .forward import ForwardModel

Floats = npt.NDArray[np.float64]
Found = tuple[float, Floats, Floats]  # cost [m²], tensions (m,) [N] and state [rad]
POSITION_THRESHOLD = 1e-4  # [m]
DIRECTION_THRESHOLD = np.deg2rad(0.2)  # [rad]
COST_REACHED_M2 = 1e-12  # [m²] cost below which no further start is tried: 1 µm
PULL_STARTS = 4  # each is several searches
RELAXING_SHARES = (0.4, 0.04, 4e-3, 4e-4)  # how low tension counts on the way there, see `aim`
# [1] of a tension's range: with a guess, no such jump for a tip that is hardly nearer, by its cost
JUMP_SHARE, AS_GOOD = 0.1, 0.8
# [1] of `TipTask.worth` where the arm is, and of what was told last: what is better is told
STAYED_SHARE, TOLD_SHARE = 0.99, 0.5
# Where friction remembers, ways from far away end at much tension against much tension: what the
# first start reaches is not left
NEAR_REACHED_M2 = 0.5 * POSITION_THRESHOLD**2  # [m²]
# Shares [1] of `TipTask.per_newton`: how tension counts among ends of different starts there, and,
# gently, the way there where tendons stick: it takes time
PULLING_SHARE, GOING_SHARE = 4e-3, 0.06
KINK_REACHED_M2, KINK_STARTS = 2e-11, 4  # [m²] cost that does after so many: 6 µm
BALANCE_STEPS_MAX, OUTSIDE_STARTS = 40, 3  # programs after a search, other beginnings
CLEARANCE_BINDS_M = 1e-4  # [m] from a region: it is what keeps the arm from its target


def reach(
    model: ForwardModel,
    position: npt.ArrayLike | None = None,
    direction: npt.ArrayLike | None = None,
    *,
    guess: Shape | None = None,
    position_weight: float = 1.0,
    direction_weight: float | None = None,
    starts: int = 24,
    by_pulls: bool = False,
    relax: bool = False,
    gently: bool = False,
    memory: Floats | None = None,
    preferences: Preferences | None = None,
    keep_out: KeepOut | None = None,
    give_up: Callable[[], bool] = lambda: False,
    tell: Callable[[Reach], None] | None = None,
) -> Reach:
    """
    Find tensions within the limits that bring the tip to a target.

    Parameters
    ----------
    position : (3,) [m], optional
    direction : (3,), optional
        Approach direction of the tip; its length and the roll about it are ignored.
    guess : Shape, optional
        The present state: tracking starts there and searches elsewhere only if it must.
    position_weight : float [1]
    direction_weight : float [m/rad], optional
        Default: a fifth of the robot's length.
    starts : int
        How many starts a cold search may take.
    by_pulls : bool
        Only tensions that wire lengths can hold (see `inverse_pulls`); the lower limit is 0.
    relax : bool
        With a guess, too, go on from a solution to one of low tension, as a cold search does.
    gently : bool
        With a guess, newtons of all tendons against each other are not spent on tenths of a
        millimetre in directions in which tendons hardly lead the tip, and where tendons stick
        the way there counts, see `GOING_SHARE`: for targets of a stream.
    memory : optional
        Friction memory where the arm is (`Shape.memory`): tensions then count as reached from
        there, along a straight line. Default: from straight and free of tension.
    preferences : Preferences, optional
        What the freedom that the target leaves is used for; default: low tension.
    keep_out : KeepOut, optional
        Regions that no part of the arm may enter; a target that leads there is `nearest`, with
        the region named.
    give_up : callable
        Asked between starts, a `Patience` also between the steps of a search; once it says True
        the best found so far is returned.
    tell : callable, optional
        Is given the best found so far when it is much nearer than what was told before, or than
        the guess: where to go while the search goes on.

    Raises
    ------
    InputError
        Neither position nor direction, or not finite.

    """
    target = tip_target(model, position, direction, position_weight, direction_weight)
    past = model.arrays.fresh_memory() if memory is None else memory
    patience = give_up if isinstance(give_up, Patience) else Patience()
    task = TipTask(model, target, past, patience)
    starts = min(starts, PULL_STARTS) if by_pulls else starts
    begin = beginnings(task, guess, starts, tell is not None, gently)
    going = guess if gently and model.sticks else None
    priced = partial(_priced, task, gently, by_pulls)
    best = _searched(task, begin, guess, by_pulls, give_up, tell, going, priced)
    late = give_up()
    if not _is_there(task, *best[:2]):
        # from a guess, without friction that sticks, it takes a millisecond: also when it is late
        if not late or (guess is not None and not model.sticks):
            for start in _beyond(model, best, guess, gently or late):
                best = priced(best, start)
    elif (relax or guess is None) and not (late or by_pulls or preferences or going):
        best = _relaxed(task, best)
    made = judged(task, *best[1:], in_time=not give_up())
    if preferences is None and not keep_out:
        return made
    regions = keep_out or KeepOut()
    if preferences is None and regions.clearance(made.shape.positions).distance >= 0.0:
        return made
    limits = limits_by_pulls(model) if by_pulls else model.limits
    here = None if guess is None else guess.inputs
    wants = preferences or Preferences()
    # beyond reach, what is nearest is held: the freedom is not spent on what no tension reaches
    held = task if made.status == 'reached' else task.held_at(made.shape)
    return _balanced(task, Balance(held, wants, regions, limits, here), made, by_pulls, give_up)


def _searched(
    task: TipTask,
    starts: Iterator[tuple[Aim, Floats, Floats]],
    guess: Shape | None,
    by_pulls: bool,
    give_up: Callable[[], bool],
    tell: Callable[[Reach], None] | None,
    going: Shape | None,
    priced: Callable[[Found, tuple[Floats, Floats]], Found],
) -> Found:
    """Return cost [m²], tensions and bends of the first start that meets it, or of the best."""
    model = task.model
    best: Found | None = None
    sticks, remembers, least, stayed = model.sticks, model.remembers, np.inf, np.inf
    if tell is not None and guess is not None:
        stayed = STAYED_SHARE * task.worth(task.cost(guess), guess.inputs)
    told = stayed
    for count, (search, inputs, bend) in enumerate(starts):
        if by_pulls:
            cost, bends = aim_by_pulls(task, search, inputs, bend)
        else:
            cost, bends = search(inputs, bend, model.limits)
        met, worth = _met(task, cost, inputs), _worth(task, cost, inputs, going)
        met = met and not (going is not None and _jumps(model, going.inputs, inputs))
        if best is None or worth < least * (1.0 if met else _share(task, guess, inputs, best[1])):
            best, least = (cost, inputs, bends), worth
        good = task.worth(*best[:2])  # what is beyond reach is no reason to set out for the limits
        if tell is not None and good < told and (sticks or not met):
            tense = not met and _is_tense(model, guess, best[1])
            early = priced(best, best[1:]) if tense else best
            tell(judged(task, early[1].copy(), early[2], in_time=False))
            told = TOLD_SHARE * task.worth(*early[:2])
        does = sticks and count >= KINK_STARTS and best[0] < KINK_REACHED_M2
        does = does or (remembers and count == 0 and cost < NEAR_REACHED_M2)
        # what comes after the first search takes no time: where the arm may set out
        waits = sticks and count <= 1 and tell is not None and told == stayed
        if met or does or (give_up() and not waits):
            break
    assert best is not None
    if not np.isfinite(best[0]):
        raise NoEquilibriumError('any start of the search', model.implicit_effects, np.inf)
    return best


def _worth(task: TipTask, cost: float, inputs: Floats, going: Shape | None) -> float:
    """Return a cost [m²] with what tensions (m,) [N], or the way there, count."""
    cost = task.worth(cost, inputs)
    if task.model.remembers:
        cost += 0.5 * (PULLING_SHARE * task.per_newton) ** 2 * _above(task.model, inputs)
    if going is not None:
        way = GOING_SHARE * task.per_newton * (inputs - going.inputs)
        cost += 0.5 * float((way**2).sum())
    return cost


def _share(task: TipTask, guess: Shape | None, inputs: Floats, others: Floats) -> float:
    """Return what share of the cost tensions (m,) [N] must have to be taken for others."""
    return AS_GOOD if guess is not None and _jumps(task.model, others, inputs) else 1.0


def _jumps(model: ForwardModel, before: Floats, inputs: Floats) -> bool:
    """Tell whether tensions (m,) [N] are far from those before."""
    low, high = model.limits.T
    return bool(np.any(np.abs(inputs - before) > JUMP_SHARE * (high - low)))


def _is_tense(model: ForwardModel, guess: Shape | None, inputs: Floats) -> bool:
    """Tell whether tensions (m,) [N] are on the whole far above those where the arm is."""
    low, high = model.limits.T
    here = low if guess is None else guess.inputs
    return bool((inputs - here).sum() > JUMP_SHARE * (high - low).sum())


def _balanced(
    task: TipTask, balance: Balance, made: Reach, by_pulls: bool, give_up: Callable[[], bool]
) -> Reach:
    """Use the freedom that is left as it is preferred, and keep the arm out of regions."""
    regions = balance.keep_out
    away = regions.clearance(made.shape.positions)
    if by_pulls and away.distance >= 0.0:
        return made  # wires of given lengths leave no freedom
    found, near = made, away
    for start in _outside(balance, made.shape):
        shape = balanced(balance, start, BALANCE_STEPS_MAX, give_up)
        if by_pulls:
            shape = pull_shape(task.model, shape.pulls, shape, task.past)
        found = judged(task, shape.inputs, shape.state, in_time=not give_up())
        if not regions:
            return found
        near = regions.clearance(found.shape.positions)
        if near.distance > -CLEARANCE_BINDS_M or give_up():
            break
    if near.distance > -CLEARANCE_BINDS_M and found.status == 'reached':
        return found
    kept = near.distance < CLEARANCE_BINDS_M or away.distance < 0.0
    name = near.region if near.distance < CLEARANCE_BINDS_M else away.region
    return replace(found, status='nearest', region=name) if kept else found


def _outside(balance: Balance, shape: Shape) -> Iterator[Shape]:
    """Yield the shape, then those of the library that are outside of regions and near the tip."""
    yield shape
    if not balance.keep_out:
        return
    model, task = balance.task.model, balance.task
    free = balance.keep_out.distances(model.library.positions).min(axis=(0, 2)) > 0.0
    for row in islice((row for row in rows_near(task) if free[row]), OUTSIDE_STARTS):
        try:
            yield task.shape(model.library.inputs[row], model.library.state[row])
        except NoEquilibriumError:
            continue


def _beyond(
    model: ForwardModel, best: Found, guess: Shape | None, gently: bool
) -> Iterator[tuple[Floats, Floats]]:
    """
    Yield tensions and states from which a target beyond reach is searched for.

    From the best that was found, from where the arm is and, unless targets follow each other, from
    the straight arm at its lowest tensions.
    """
    yield best[1:]
    if guess is not None:
        yield within(guess.inputs, *model.limits.T), guess.state
    if not gently:
        yield model.limits[:, 0], np.zeros(3 * model.robot.cells)


def _priced(
    task: TipTask, gently: bool, by_pulls: bool, best: Found, start: tuple[Floats, Floats]
) -> Found:
    """
    Return the posture for a target beyond reach whose error is worth its tension, or the best.

    As a search from tensions and a state finds it; gently, what that adds to the error counts. The
    way there does not: else the arm stays behind a target that goes on, and jumps. A target that
    is nearly met is within reach: there only what is nearer is taken.
    """
    share = GENTLE_SHARE if gently else LOW_TENSION_SHARE

    def worth(cost: float, inputs: Floats) -> float:
        if best[0] < NEAR_REACHED_M2:
            return cost
        spent = 0.5 * (share * task.per_newton) ** 2 * _above(task.model, inputs)
        return task.worth(cost + spent, inputs)

    search: Aim = partial(aim, task, GAIN_MIN, priced=True)
    if gently:
        search = partial(aim_gently, task, TRIALS_MAX, priced=True)
    inputs, model = start[0].copy(), task.model
    cost, bend = search(inputs, start[1], limits_by_pulls(model) if by_pulls else model.limits)
    if by_pulls:  # of the wires that pull there
        cost, bend = aim_by_pulls(task, search, inputs, bend)
    return (cost, inputs, bend) if worth(cost, inputs) < worth(*best[:2]) else best


def _relaxed(task: TipTask, best: Found) -> Found:
    """Go from what meets the target to low tension, where it is still met there."""
    model, (cost, _, bend), less = task.model, best, best[1].copy()
    if model.sticks:
        new, bends = seek(task, SEEKING_WIDTHS[1], less, bend, model.limits)
    else:
        bends = bend
        for preference in (*RELAXING_SHARES, LOW_TENSION_SHARE):
            new, bends = aim(task, GAIN_MIN, less, bends, model.limits, preference)
    return (new, less, bends) if new < cost and _met(task, new, less) else best


def _is_there(task: TipTask, cost: float, inputs: Floats) -> bool:
    """Tell whether a search need not go on, as `_met` or as near as a kink lets tendons stick."""
    return _met(task, cost, inputs) or (task.model.sticks and cost < KINK_REACHED_M2)


def _met(task: TipTask, cost: float, inputs: Floats) -> bool:
    """Tell whether a cost [m²] meets the target but for what says how much tension there is."""
    if cost < COST_REACHED_M2:
        return True
    return (
        cost - 0.5 * (LOW_TENSION_SHARE * task.per_newton) ** 2 * _above(task.model, inputs)
        < COST_REACHED_M2
    )


def _above(model: ForwardModel, inputs: Floats) -> float:
    """Return the sum of squares [N²] of tensions beyond their lowest."""
    above = inputs - model.limits[:, 0]
    return float(above @ above)


def judged(task: TipTask, inputs: Floats, bend: Floats, in_time: bool = True) -> Reach:
    """Return how near tensions (m,) [N] bring the tip, and whether their limits are to blame."""
    model = task.model
    shape = task.shape(inputs, bend)
    position, direction = task.errors(shape)
    top = model.limits[:, 1].tolist()
    at_limit = tuple(
        name
        for name, value, high in zip(model.inputs, inputs.tolist(), top, strict=True)
        if value >= high - 1e-9
    )
    status = 'reached'
    if position > POSITION_THRESHOLD or direction > DIRECTION_THRESHOLD:
        bind = at_limit and in_time and _limits_bind(task, inputs, bend)
        status = 'at_limit' if bind else 'nearest'
    return Reach(shape, position, direction, status, at_limit)


def _limits_bind(task: TipTask, inputs: Floats, bend: Floats) -> bool:
    """Tell whether the target would be reached with three times the tension."""
    model = task.model
    wide = model.limits * [1.0, 3.0]
    more = inputs.copy()
    cost, bends = aim(task, TRACKING_GAIN_MIN, more, bend, wide)
    if not np.isfinite(cost):
        return False
    try:
        errors = task.errors(task.shape(more, bends))
    except NoEquilibriumError:
        return False
    return errors[0] <= POSITION_THRESHOLD and errors[1] <= DIRECTION_THRESHOLD
