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
from ..common.patience import Patience
from ..robot.keep_out import KeepOut
from .pulls import Aim, aim_by_pulls, limits_by_pulls, pull_shape
from .redundancy import Balance, Preferences, balanced
from .shape import Reach, Shape
from .tip_task import TipTask, tip_target

if TYPE_CHECKING:
    from .forward import ForwardModel

Floats = npt.NDArray[np.float64]
POSITION_THRESHOLD = 1e-4  # [m]
DIRECTION_THRESHOLD = np.deg2rad(0.2)  # [rad]
COST_REACHED_M2 = 1e-12  # [m²] cost below which no further start is tried: 1 µm
PULL_STARTS = 4  # each is several searches
# [1] gain of a step: a search goes on, tracking has the next tick
GAIN_MIN, TRACKING_GAIN_MIN = 1e-6, 1e-2
LIBRARY_NEIGHBOURS = 128  # shapes of the library among which starts are chosen
START_TENSION_WEIGHT = 3e-3  # [m/N] how the tensions of a shape count when a start is chosen
LOW_TENSION_WEIGHT = 1e-6  # [m/N] how little low tension counts
RELAXING_WEIGHTS = (1e-2, 1e-3, 1e-4, 1e-5)  # [m/N] how it counts on the way there
SEEKING_WEIGHT = 1e-4  # [m/N] and where bends and tensions are found at once
SEEKING_WIDTHS, SEEKING_SHRINK, SEEKING_STEPS_MAX = (1e3, 1e2), 0.5, 60
FAR_M2 = 5e-5  # [m²] cost of a tip that no search for an equilibrium improves: 1 cm
TRIALS_MAX = 120  # equilibria of a search
# Where tendons stick a search that does not arrive soon stands at a kink: another start is quicker
STICKING_TRIALS_MAX = 10
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
    memory: Floats | None = None,
    preferences: Preferences | None = None,
    keep_out: KeepOut | None = None,
    give_up: Callable[[], bool] = lambda: False,
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
    best = _searched(task, _starts(task, guess, starts), by_pulls, give_up)
    if not by_pulls and preferences is None and not give_up():
        best = _finished(task, relax or guess is None, *best)
    made = judged(task, *best[1:], in_time=not give_up())
    if preferences is None and not keep_out:
        return made
    regions = keep_out or KeepOut()
    if preferences is None and regions.clearance(made.shape.positions).distance >= 0.0:
        return made
    limits = limits_by_pulls(model) if by_pulls else model.limits
    here = None if guess is None else guess.inputs
    wants = preferences or Preferences()
    return _balanced(Balance(task, wants, regions, limits, here), made, by_pulls, give_up)


def _searched(
    task: TipTask,
    starts: Iterator[tuple[Aim, Floats, Floats]],
    by_pulls: bool,
    give_up: Callable[[], bool],
) -> tuple[float, Floats, Floats]:
    """Return cost [m²], tensions and bends of the first start that meets it, or of the best."""
    model = task.model
    best: tuple[float, Floats, Floats] | None = None
    for count, (search, inputs, bend) in enumerate(starts):
        if by_pulls:
            cost, bends = aim_by_pulls(task, search, inputs, bend)
        else:
            cost, bends = search(inputs, bend, model.limits)
        if best is None or cost < best[0]:
            best = (cost, inputs, bends)
        does = model.sticks and count >= KINK_STARTS and best[0] < KINK_REACHED_M2
        if _met(model, cost, inputs) or does or give_up():
            break
    assert best is not None
    if not np.isfinite(best[0]):
        raise NoEquilibriumError('any start of the search', model.implicit_effects, np.inf)
    return best


def _balanced(balance: Balance, made: Reach, by_pulls: bool, give_up: Callable[[], bool]) -> Reach:
    """Use the freedom that is left as it is preferred, and keep the arm out of regions."""
    task, regions = balance.task, balance.keep_out
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
    for row in islice(
        (row for row in _rows_near(model, task.target) if free[row]), OUTSIDE_STARTS
    ):
        try:
            yield task.shape(model.library.inputs[row], model.library.state[row])
        except NoEquilibriumError:
            continue


def _finished(
    task: TipTask, relax: bool, cost: float, inputs: Floats, bend: Floats
) -> tuple[float, Floats, Floats]:
    """Go to the least error from the best that was found or, with it met, to low tension."""
    model = task.model
    if not _met(model, cost, inputs):
        if model.sticks:  # no search for an equilibrium has gone on from there
            cost, bend = _aim(task, GAIN_MIN, inputs, bend, model.limits)
        return cost, inputs, bend
    if not relax:
        return cost, inputs, bend
    less = inputs.copy()
    if model.sticks:
        new, bends = _seek(task, SEEKING_WIDTHS[1], less, bend, model.limits)
    else:
        bends = bend
        for preference in (*RELAXING_WEIGHTS, LOW_TENSION_WEIGHT):
            new, bends = _aim(task, GAIN_MIN, less, bends, model.limits, preference)
    if new < cost and _met(model, new, less):
        return new, less, bends
    return cost, inputs, bend


def _starts(
    task: TipTask, guess: Shape | None, count: int
) -> Iterator[tuple[Aim, Floats, Floats]]:
    """
    Yield how to search, and tensions and bends to start from; made only when needed.

    The guess, then the straight arm, from where a gentle bend is nearer than a curl, then the
    shapes of the library whose tips are nearest, those of low tension first: from much tension
    against much tension there is often no way down.
    """
    model, sticks = task.model, task.model.sticks
    near = partial(_aim, task, GAIN_MIN if guess is None else TRACKING_GAIN_MIN)
    if sticks:
        near = partial(near, most=STICKING_TRIALS_MAX)
    seek = partial(_seek, task, SEEKING_WIDTHS[0])
    if guess is not None:
        inputs = np.minimum(np.maximum(guess.inputs, model.limits[:, 0]), model.limits[:, 1])
        if sticks:
            yield partial(near, far=FAR_M2), inputs.copy(), guess.state
            near = seek
        if count or not sticks:
            yield near, inputs, guess.state
    near = seek if sticks else partial(_aim, task, GAIN_MIN)
    if count:
        yield near, model.limits[:, 0].copy(), np.zeros(3 * model.robot.cells)
        for row in islice(_rows_near(model, task.target), count):
            yield near, model.library.inputs[row].copy(), model.library.state[row]


def _rows_near(model: ForwardModel, target: Floats) -> Iterator[int]:
    """
    Yield shapes of the library whose tips are near a target, those of low tension first.

    Every other one is that whose tensions are furthest from those before: from much tension
    against much tension there is often no way down.
    """
    library, low, high = model.library, *model.limits.T
    tips = np.concatenate([library.tip_position, library.tip_direction], axis=1)
    miss = np.repeat(target[6:], 3) * (tips - target[:6])
    tension = START_TENSION_WEIGHT * (library.inputs - low).sum(axis=1)
    near = np.argsort((miss * miss).sum(axis=1) + tension * tension)[:LIBRARY_NEIGHBOURS]
    places, away = library.inputs[near] / high, np.full(len(near), np.inf)
    for count in range(len(near)):
        left = np.flatnonzero(away > 0.0)
        if not len(left):
            return
        row = int(np.argmax(away)) if count % 2 else int(left[0])
        yield int(near[row])
        away = np.minimum(away, ((places - places[row]) ** 2).sum(axis=1))


def _met(model: ForwardModel, cost: float, inputs: Floats) -> bool:
    """Tell whether a cost [m²] meets the target but for what says how much tension there is."""
    if cost < COST_REACHED_M2:
        return True
    above = inputs - model.limits[:, 0]
    return cost - 0.5 * LOW_TENSION_WEIGHT**2 * float(above @ above) < COST_REACHED_M2


def _aim(
    task: TipTask,
    enough: float,
    inputs: Floats,
    bend: Floats,
    limits: Floats,
    preference: float = LOW_TENSION_WEIGHT,
    far: float = np.inf,
    most: int = TRIALS_MAX,
) -> tuple[float, Floats]:
    """
    Improve inputs in place; return the cost [m²] and the bends of the equilibrium.

    Once the tip is there, a step that gains less than `enough` of the cost is the last, else the
    one after so many trials. What costs more than `far` stays as it is.
    """
    model, bends = task.model, np.array([bend, bend])
    cost = model.arrays.part('inverse').aim(
        model.arrays.address,
        inputs,
        bends,
        task.target,
        np.ascontiguousarray(limits[:, 0]),
        np.ascontiguousarray(limits[:, 1]),
        preference,
        most,
        enough,
        far,
        task.patience.until.ctypes.data,
        task.past,
        model.scratch,
    )
    return float(cost), bends[0]


def _seek(
    task: TipTask, wide: float, inputs: Floats, bend: Floats, limits: Floats
) -> tuple[float, Floats]:
    """
    Improve inputs in place from far away; return the cost [m²] and the bends of the equilibrium.

    For tendons that stick and slip: bends and tensions are found at once, with a slip length that
    starts `wide` times its own.
    """
    model, bends = task.model, np.array([bend, bend])
    model.arrays.part('simultaneous').seek(
        model.arrays.address,
        inputs,
        bends,
        task.target,
        np.ascontiguousarray(limits[:, 0]),
        np.ascontiguousarray(limits[:, 1]),
        SEEKING_WEIGHT,
        wide,
        SEEKING_SHRINK,
        SEEKING_STEPS_MAX,
        task.patience.until.ctypes.data,
        task.past,
        model.scratch,
    )
    return _aim(
        task, TRACKING_GAIN_MIN, inputs, bends[0], limits, far=FAR_M2, most=STICKING_TRIALS_MAX
    )


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
    cost, bends = _aim(task, TRACKING_GAIN_MIN, more, bend, wide)
    if not np.isfinite(cost):
        return False
    try:
        errors = task.errors(task.shape(more, bends))
    except NoEquilibriumError:
        return False
    return errors[0] <= POSITION_THRESHOLD and errors[1] <= DIRECTION_THRESHOLD
