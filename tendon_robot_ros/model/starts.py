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

from ..common.arrays import Floats
from .program import within
from .pulls import Aim
from .tip_task import LOW_TENSION_WEIGHT, Policy, TipTask

if TYPE_CHECKING:
    from .shape import Shape, ShapeBatch

Start = tuple[Aim, Floats, Floats]  # how to search, tensions (m,) [N] and bends to start from
# [1] of the cost, gained by a step: less ends a search, because rounding gains as much
GAIN_MIN = 1e-6
# [1] of the cost: less ends a search from near, because the next target comes before more is
# gained
TRACKING_GAIN_MIN = 1e-2
# [1] equilibria of a search; what takes more has been seen to stall, and another start would be
# quicker
TRIALS_MAX = 120
# [1] where friction remembers, because a search then creeps along narrow valleys
REMEMBERING_TRIALS_MAX = 4 * TRIALS_MAX
# [1] where tendons stick: what needs more stands at a kink, and another start is quicker
# (docs/model.md)
STICKING_TRIALS_MAX = 10
# [1] starts of an arm that is driven by wire lengths, because each of them is several searches
PULL_STARTS_MAX = 4
# [1] shapes of the library among which starts are chosen: more than would ever be tried
LIBRARY_NEIGHBOURS = 128
# [1] weight of the tensions of a shape of the library, because from much tension against much
# tension there is often no way down
START_TENSION_WEIGHT = 0.1
# [1] weight of tensions while bends and tensions are found at once (docs/model.md)
SEEKING_WEIGHT = 100.0 * LOW_TENSION_WEIGHT
# [1] of the smoothing length, with which such a search begins (docs/model.md)
SEEKING_WIDTH = 1e3
# [1] by which it shrinks in a step: ten steps from that width, so that fifteen in all do
# (docs/model.md)
SEEKING_SHRINK = 0.5
# [1] steps of such a search: it settles within these or seldom does (docs/model.md)
SEEKING_STEPS_MAX = 60
# [1] of the length, of a first step towards a far target: soon made, else the arm would wait
FIRST_STEP_LENGTH = 0.03
# [1] of the length: from a tip farther off, no search from equilibrium to equilibrium would arrive
FAR_LENGTH = 2.0 * FIRST_STEP_LENGTH


def aim(
    task: TipTask,
    gain_min: float,
    inputs: Floats,
    bend: Floats,
    limits: Floats,
    tension: Floats | None = None,
    cost_max: float = np.inf,
    trials: int = TRIALS_MAX,
) -> tuple[float, Floats]:
    """
    Improve inputs in place, from equilibrium to equilibrium; return the cost [m²] and the bends.

    Parameters
    ----------
    gain_min : float
        Once the tip is there, a step that gains a smaller part of the cost is the last [1].
    inputs, bend : (m,) [N] and (3n,) [rad]
        Where the search starts.
    limits : (m, 2) [N]
    tension : (4,), optional
        What it costs (`TipTask.tension`); default: so little that it decides between equal tips.
    cost_max : float
        A start that costs more stays as it is [m²].
    trials : int
        Equilibria that may be tried.

    """
    bends = np.array([bend, bend])
    begin, end = _kernel_arguments(task, inputs, bends, limits)
    tension = task.tension(LOW_TENSION_WEIGHT) if tension is None else tension
    search = task.model.arrays.part('inverse').aim
    return float(search(*begin, tension, trials, gain_min, cost_max, *end)), bends[0]


def aim_frugally(
    task: TipTask,
    tension: Floats,
    trials: int,
    inputs: Floats,
    bend: Floats,
    limits: Floats,
) -> tuple[float, Floats]:
    """Improve inputs in place with tension that counts; return the plain cost [m²] and bends."""
    bends = aim(task, TRACKING_GAIN_MIN, inputs, bend, limits, tension, trials=trials)[1]
    return cost_there(task, inputs, bends, limits)


def cost_there(
    task: TipTask, inputs: Floats, bend: Floats, limits: Floats
) -> tuple[float, Floats]:
    """Return the cost [m²] and the bends of the equilibrium under inputs, as they are."""
    return aim(task, TRACKING_GAIN_MIN, inputs, bend, limits, cost_max=0.0)


def step_towards(
    task: TipTask, guess: Shape, inputs: Floats, bend: Floats, limits: Floats
) -> tuple[float, Floats]:
    """Improve inputs in place by a step to a tip that is far: the arm may set out."""
    near, step = task.target.copy(), FIRST_STEP_LENGTH * task.model.robot.length
    near[:6] += (1.0 - step / np.sqrt(2.0 * task.cost(guess))) * task.off(guess)
    bends = aim(
        replace(task, target=near),
        TRACKING_GAIN_MIN,
        inputs,
        bend,
        limits,
        trials=STICKING_TRIALS_MAX,
    )[1]
    return cost_there(task, inputs, bends, limits)


def seek(
    task: TipTask,
    width: float,
    inputs: Floats,
    bend: Floats,
    limits: Floats,
    steps: int = SEEKING_STEPS_MAX,
) -> tuple[float, Floats]:
    """
    Improve inputs in place from far away; return the cost [m²] and the bends of the equilibrium.

    For tendons that stick and slip: bends and tensions are solved for at once, with a smoothing
    length of friction that starts `width` times its own.
    """
    bends = np.array([bend, bend])
    begin, end = _kernel_arguments(task, inputs, bends, limits)
    part = task.model.arrays.part('inverse')
    part.seek(*begin, SEEKING_WEIGHT * task.per_newton, width, SEEKING_SHRINK, steps, *end)
    return aim(
        task,
        TRACKING_GAIN_MIN,
        inputs,
        bends[0],
        limits,
        cost_max=far_cost(task),
        trials=STICKING_TRIALS_MAX,
    )


def far_cost(task: TipTask) -> float:
    """Return the cost [m²] of a tip that is far off."""
    return float(0.5 * (FAR_LENGTH * task.model.robot.length) ** 2)


def _kernel_arguments(
    task: TipTask, inputs: Floats, bends: Floats, limits: Floats
) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    """Return what both compiled searches take first: where and to what, and last: how long."""
    low, high = np.ascontiguousarray(limits[:, 0]), np.ascontiguousarray(limits[:, 1])
    model, until = task.model, task.patience.until.ctypes.data
    return (
        (model.arrays.address, inputs, bends, task.target, low, high),
        (until, task.past, model.scratch),
    )


def starts_of(task: TipTask, policy: Policy, reports: bool) -> Iterator[Start]:
    """
    Yield how to search, and tensions and bends to start from; made only when needed.

    The guess, then the straight arm, from where a gentle bend is nearer than a curl, then the
    shapes of the library whose tips are nearest, those of low tension first. Where what is found
    first is reported, a guess that is far is followed by where the arm may set out. Of a frugal
    policy the guess is searched from with tension that counts, too; where tendons stick that is a
    start more.
    """
    model, guess, nearby = task.model, task.guess, partial(aim, task, GAIN_MIN)
    if model.sticks:
        # for a direction, too, little is free, and another start is quicker
        steps = SEEKING_STEPS_MAX // 2 if task.target[7] else SEEKING_STEPS_MAX
        nearby = partial(seek, task, SEEKING_WIDTH, steps=steps)
    if guess is not None:
        here = within(guess.inputs, *model.limits.T)
        trials = TRIALS_MAX if not model.remembers else REMEMBERING_TRIALS_MAX
        trials = STICKING_TRIALS_MAX if model.sticks else trials
        track = partial(aim, task, TRACKING_GAIN_MIN, trials=trials)
        frugal = partial(aim_frugally, task, task.tension(policy.tension_weight), trials)
        far = model.sticks and task.cost(guess) >= far_cost(task)
        if not far and (model.sticks or not policy.frugal):
            yield track, here.copy(), guess.state
        if policy.frugal:
            yield frugal, here.copy(), guess.state
        if far:
            yield partial(cost_there, task), here, guess.state  # to stay
            if policy.starts:
                yield partial(seek, task, SEEKING_WIDTH), here.copy(), guess.state
            if reports:
                yield _setting_out(task, guess, here, bool(policy.starts))
    starts = min(policy.starts, PULL_STARTS_MAX) if task.by_pulls else policy.starts
    if starts:
        yield nearby, model.limits[:, 0].copy(), np.zeros(3 * model.robot.cells)
        for row in islice(rows_near(task), starts):
            yield nearby, model.library.inputs[row].copy(), model.library.state[row]


def _setting_out(task: TipTask, guess: Shape, inputs: Floats, from_library: bool) -> Start:
    """Return what soon brings a far tip nearer: a shape of the library, or a short step."""
    if from_library:
        library, row = task.model.library, next(rows_near(task))
        # at half of the distance or nearer
        if misses(library, task.target)[row] < 0.25 * 2.0 * task.cost(guess):
            return partial(cost_there, task), library.inputs[row].copy(), library.state[row]
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
    tension = START_TENSION_WEIGHT * task.per_newton * (library.inputs - low).sum(axis=1)
    near = np.argsort(misses(library, task.target) + tension * tension)[:LIBRARY_NEIGHBOURS]
    places, away = library.inputs[near] / high, np.full(len(near), np.inf)
    for count in range(len(near)):
        left = np.flatnonzero(away > 0.0)
        if not len(left):
            return
        row = int(np.argmax(away)) if count % 2 else int(left[0])
        yield int(near[row])
        away = np.minimum(away, ((places - places[row]) ** 2).sum(axis=1))
