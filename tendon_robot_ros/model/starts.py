"""
Searches for tensions that bring the tip to a target, and where they start.

`aim` goes from equilibrium to equilibrium. Where tendons stick it soon stands at a kink; `seek`
finds bends and tensions at once. Starts all over the workspace, one after the other, make a whole
search; `inverse.reach` goes through them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from .pulls import Aim
from .tip_task import TipTask

if TYPE_CHECKING:
    from .shape import Shape, ShapeBatch

Floats = npt.NDArray[np.float64]
Start = tuple[Aim, Floats, Floats]  # how to search, tensions (m,) [N] and bends to start from
# [1] gain of a step: a search goes on, tracking has the next tick
GAIN_MIN, TRACKING_GAIN_MIN = 1e-6, 1e-2
POSED_STEPS_MAX = 30  # for a direction, too: little is free, and another start is quicker
LIBRARY_NEIGHBOURS = 128  # shapes of the library among which starts are chosen
# How tensions count beside lengths: shares [1] of `TipTask.per_newton`
START_TENSION_SHARE = 0.1  # those of a shape when a start is chosen
LOW_TENSION_SHARE = 4e-5  # how little low tension counts
GENTLE_SHARE = 0.02  # where directions that tendons hardly lead to are to be left
SEEKING_SHARE = 4e-3  # and where bends and tensions are found at once
SEEKING_WIDTHS, SEEKING_SHRINK, SEEKING_STEPS_MAX = (1e3, 1e2), 0.5, 60
# [1] of the length: a tip so far off no search for an equilibrium improves; a step towards it
FAR_SHARE, FIRST_STEP_SHARE = 0.06, 0.03
# [1] of the square of how far the tip is: for a shape of the library so near the arm may set out
NEARER_SHARE = 0.25
TRIALS_MAX = 120  # equilibria of a search
REMEMBERING_TRIALS_MAX = 480  # where friction remembers, ways creep along narrow valleys
# Where tendons stick a search that does not arrive soon stands at a kink: another start is quicker
STICKING_TRIALS_MAX = 10


def aim(
    task: TipTask,
    enough: float,
    inputs: Floats,
    bend: Floats,
    limits: Floats,
    preference: float = LOW_TENSION_SHARE,
    far: float = np.inf,
    most: int = TRIALS_MAX,
    priced: bool = False,
) -> tuple[float, Floats]:
    """
    Improve inputs in place; return the cost [m²] and the bends of the equilibrium.

    Once the tip is there, a step that gains less than `enough` of the cost is the last, else the
    one after so many trials. What costs more than `far` [m²] stays as it is. `preference`: how low
    tension counts, a share of `TipTask.per_newton`. `priced`: to what a target beyond reach is
    worth, see `TipTask.worth`.
    """
    bends = np.array([bend, bend])
    begin, end = _shared(task, inputs, bends, limits)
    tension = task.tension(preference, priced)
    cost = task.model.arrays.part('inverse').aim(*begin, tension, most, enough, far, *end)
    return float(cost), bends[0]


def aim_gently(
    task: TipTask, most: int, inputs: Floats, bend: Floats, limits: Floats, priced: bool = False
) -> tuple[float, Floats]:
    """
    Improve inputs in place, with tension that counts; return the plain cost [m²] and the bends.

    In directions in which tendons hardly lead the tip, tenths of a millimetre are not worth
    newtons of all tendons against each other.
    """
    gently = partial(aim, task, TRACKING_GAIN_MIN, preference=GENTLE_SHARE, priced=priced)
    bends = gently(inputs, bend, limits, most=most)[1]
    return aim(task, TRACKING_GAIN_MIN, inputs, bends, limits, far=0.0)


def step_towards(
    task: TipTask, guess: Shape, inputs: Floats, bend: Floats, limits: Floats
) -> tuple[float, Floats]:
    """Improve inputs in place by a step to a tip that is far: the arm may set out."""
    near, reach = task.target.copy(), FIRST_STEP_SHARE * task.model.robot.length
    near[:6] += (1.0 - reach / np.sqrt(2.0 * task.cost(guess))) * task.off(guess)
    step = replace(task, target=near)
    bends = aim(step, TRACKING_GAIN_MIN, inputs, bend, limits, most=STICKING_TRIALS_MAX)[1]
    return aim(task, TRACKING_GAIN_MIN, inputs, bends, limits, far=0.0)


def seek(
    task: TipTask,
    wide: float,
    inputs: Floats,
    bend: Floats,
    limits: Floats,
    steps: int = SEEKING_STEPS_MAX,
) -> tuple[float, Floats]:
    """
    Improve inputs in place from far away; return the cost [m²] and the bends of the equilibrium.

    For tendons that stick and slip: bends and tensions are found at once, with a slip length that
    starts `wide` times its own.
    """
    bends = np.array([bend, bend])
    begin, end = _shared(task, inputs, bends, limits)
    part = task.model.arrays.part('inverse')
    part.seek(*begin, SEEKING_SHARE * task.per_newton, wide, SEEKING_SHRINK, steps, *end)
    return aim(
        task, TRACKING_GAIN_MIN, inputs, bends[0], limits, far=_far(task), most=STICKING_TRIALS_MAX
    )


def _far(task: TipTask) -> float:
    """Return the cost [m²] of a tip that is far off."""
    return float(0.5 * (FAR_SHARE * task.model.robot.length) ** 2)


def _shared(
    task: TipTask, inputs: Floats, bends: Floats, limits: Floats
) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Return what both compiled searches take first: where and to what, and last: how long."""
    low, high = np.ascontiguousarray(limits[:, 0]), np.ascontiguousarray(limits[:, 1])
    model, until = task.model, task.patience.until.ctypes.data
    return (
        (model.arrays.address, inputs, bends, task.target, low, high),
        (until, task.past, model.scratch),
    )


def beginnings(
    task: TipTask, guess: Shape | None, count: int, step: bool, gently: bool = False
) -> Iterator[Start]:
    """
    Yield how to search, and tensions and bends to start from; made only when needed.

    The guess, then the straight arm, from where a gentle bend is nearer than a curl, then the
    shapes of the library whose tips are nearest, those of low tension first: from much tension
    against much tension there is often no way down. `step`: from a guess that is far, early, to
    where the arm may set out. `gently`: from the guess see `aim_gently`; where tendons stick that
    is one start more.
    """
    model, near = task.model, partial(aim, task, GAIN_MIN)
    if model.sticks:
        steps = POSED_STEPS_MAX if task.target[7] else SEEKING_STEPS_MAX
        near = partial(seek, task, SEEKING_WIDTHS[0], steps=steps)
    if guess is not None:
        inputs = np.minimum(np.maximum(guess.inputs, model.limits[:, 0]), model.limits[:, 1])
        if not model.sticks:
            most = REMEMBERING_TRIALS_MAX if model.remembers else TRIALS_MAX
            search = partial(aim, task, TRACKING_GAIN_MIN, most=most)
            yield partial(aim_gently, task, most) if gently else search, inputs, guess.state
        elif task.cost(guess) < _far(task):
            search = partial(aim, task, TRACKING_GAIN_MIN, most=STICKING_TRIALS_MAX)
            yield search, inputs.copy(), guess.state
            if gently:
                yield partial(aim_gently, task, STICKING_TRIALS_MAX), inputs.copy(), guess.state
        else:
            if gently:
                yield partial(aim_gently, task, STICKING_TRIALS_MAX), inputs.copy(), guess.state
            yield from _starts_far(task, guess, inputs, count, step)
    if count:
        yield near, model.limits[:, 0].copy(), np.zeros(3 * model.robot.cells)
        for row in islice(rows_near(task), count):
            yield near, model.library.inputs[row].copy(), model.library.state[row]


def _starts_far(
    task: TipTask, guess: Shape, inputs: Floats, count: int, step: bool
) -> Iterator[Start]:
    """Yield starts from a guess with its tip far, where tendons stick."""
    yield partial(aim, task, TRACKING_GAIN_MIN, far=0.0), inputs, guess.state  # to stay
    if count:
        yield partial(seek, task, SEEKING_WIDTHS[0]), inputs.copy(), guess.state
        if step:
            yield _setting_out(task, guess, inputs)
    elif step:
        yield partial(step_towards, task, guess), inputs.copy(), guess.state


def _setting_out(task: TipTask, guess: Shape, inputs: Floats) -> Start:
    """Return what soon brings a far tip nearer: a shape of the library, or a short step."""
    library, row = task.model.library, next(rows_near(task))
    if misses(library, task.target)[row] < NEARER_SHARE * 2.0 * task.cost(guess):
        there = partial(aim, task, TRACKING_GAIN_MIN, far=0.0)
        return there, library.inputs[row].copy(), library.state[row]
    return partial(step_towards, task, guess), inputs.copy(), guess.state


def misses(library: ShapeBatch, target: Floats) -> Floats:
    """Return squares (rows,) [m²] of how far the tips of shapes are from a target."""
    tips = np.concatenate([library.tip_position, library.tip_direction], axis=1)
    miss = np.repeat(target[6:], 3) * (tips - target[:6])
    squares: Floats = (miss * miss).sum(axis=1)
    return squares


def rows_near(task: TipTask) -> Iterator[int]:
    """
    Yield shapes of the library whose tips are near the target, those of low tension first.

    Every other one is that whose tensions are furthest from those before: from much tension
    against much tension there is often no way down.
    """
    library, low, high = task.model.library, *task.model.limits.T
    tension = START_TENSION_SHARE * task.per_newton * (library.inputs - low).sum(axis=1)
    near = np.argsort(misses(library, task.target) + tension * tension)[:LIBRARY_NEIGHBOURS]
    places, away = library.inputs[near] / high, np.full(len(near), np.inf)
    for count in range(len(near)):
        left = np.flatnonzero(away > 0.0)
        if not len(left):
            return
        row = int(np.argmax(away)) if count % 2 else int(left[0])
        yield int(near[row])
        away = np.minimum(away, ((places - places[row]) ** 2).sum(axis=1))
