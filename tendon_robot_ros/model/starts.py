"""
Searches for tensions that bring the tip to a target, and where they start.

`aim` goes from equilibrium to equilibrium. Where tendons stick it soon stalls at a kink of
friction; `seek` solves for bends and tensions at once. `inverse.reach` searches from one start
after the other, all over the workspace.
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
from .tip_task import COLD, LOW_TENSION_WEIGHT, Policy, TipTask, cost_of

if TYPE_CHECKING:
    from .shape import Shape, ShapeBatch

Start = tuple[Aim, Floats, Floats]  # how to search, tensions (m,) [N] and bends to start from
# [1] of the cost, gained by a step: less ends a search from near that has reached the target,
# because the next target comes before more is gained
TRACKING_GAIN_MIN = 1e-2
# [1] equilibria of a search; what takes more has been seen to stall, and another start would be
# quicker. A search for bends and tensions at once settles within half as many steps or seldom does
# (docs/model.md)
TRIALS_MAX = 120
# [1] where tendons stick: what needs more stands at a kink, and another start is quicker
# (docs/model.md)
STICKING_TRIALS_MAX = 10
# [1] starts where each is several searches (an arm driven by wire lengths, regions to keep out of)
# or seldom comes nearer (a kink of friction), because each takes milliseconds
FEW_STARTS = 4
# [1] weight of tensions while bends and tensions are found at once (docs/model.md)
SEEKING_WEIGHT = 100.0 * LOW_TENSION_WEIGHT
# [1] of the length: from a tip farther off, no search from equilibrium to equilibrium would
# arrive; half of it is a first step there
FAR_LENGTH = 0.06


def aim(
    task: TipTask,
    gain_min: float,
    inputs: Floats,
    bend: Floats,
    limits: Floats,
    tension: tuple[float, ...] | None = None,
    cost_max: float = np.inf,
    trials: int = TRIALS_MAX,
) -> tuple[float, Floats]:
    """
    Improve inputs in place, from equilibrium to equilibrium; return the cost [m²] and the bends.

    Parameters
    ----------
    gain_min : float
        At the target, a step that reduces the cost by a smaller fraction is the last [1].
    inputs, bend : (m,) [N] and (3n,) [rad]
        Where the search starts.
    limits : (m, 2) [N]
    tension : tuple of float, optional
        Cost of tension (`TipTask.tension`); default: just enough to decide between equal tips.
    cost_max : float
        A start that costs more stays as it is [m²].
    trials : int
        Equilibria that may be tried.

    """
    bends = np.array([bend, bend])
    problem = _kernel_arguments(task, inputs, bends, limits)
    tension = task.tension(LOW_TENSION_WEIGHT) if tension is None else tension
    search = task.model.arrays.part('inverse').aim
    return float(search(*problem, tension, trials, gain_min, cost_max)), bends[0]


def aim_frugally(
    task: TipTask,
    tension: tuple[float, ...],
    trials: int,
    inputs: Floats,
    bend: Floats,
    limits: Floats,
) -> tuple[float, Floats]:
    """Improve inputs in place with a cost of tension; return cost [m²] without it, and bends."""
    bends = aim(task, TRACKING_GAIN_MIN, inputs, bend, limits, tension, trials=trials)[1]
    return cost_at(task, inputs, bends, limits)


def cost_at(task: TipTask, inputs: Floats, bend: Floats, limits: Floats) -> tuple[float, Floats]:
    """Return the cost [m²] and the bends of the equilibrium under inputs, as they are."""
    return aim(task, TRACKING_GAIN_MIN, inputs, bend, limits, cost_max=0.0)


def step_towards(
    task: TipTask, guess: Shape, inputs: Floats, bend: Floats, limits: Floats
) -> tuple[float, Floats]:
    """Improve inputs in place by one step towards a far target: a first move of the arm."""
    near, step = task.target.copy(), 0.5 * FAR_LENGTH * task.model.robot.length
    near[:6] += (1.0 - step / np.sqrt(2.0 * task.cost(guess))) * task.tip_error(guess)
    bends = aim(
        replace(task, target=near),
        TRACKING_GAIN_MIN,
        inputs,
        bend,
        limits,
        trials=STICKING_TRIALS_MAX,
    )[1]
    return cost_at(task, inputs, bends, limits)


def seek(
    task: TipTask,
    fraction: float,
    inputs: Floats,
    bend: Floats,
    limits: Floats,
    steps: int = TRIALS_MAX // 2,
) -> tuple[float, Floats]:
    """
    Improve inputs in place towards a far target; return the cost [m²] and bends at equilibrium.

    For tendons that stick and slip: bends and tensions are solved for at once, with a smoothing
    length of friction that starts as a fraction of the widest.
    """
    bends = np.array([bend, bend])
    problem = _kernel_arguments(task, inputs, bends, limits)
    part = task.model.arrays.part('inverse')
    part.seek(*problem, SEEKING_WEIGHT * task.per_newton, fraction, steps)
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
    """Return the cost [m²] from which a target counts as far."""
    return cost_of(FAR_LENGTH * task.model.robot.length)


def _kernel_arguments(
    task: TipTask, inputs: Floats, bends: Floats, limits: Floats
) -> tuple[Any, ...]:
    """Return the arguments that both compiled searches share."""
    low, high = np.ascontiguousarray(limits.T)
    model, until = task.model, task.patience.until.ctypes.data
    problem = (model.arrays.address, inputs, bends, task.target, low, high)
    return *problem, until, task.past, model.scratch


def starts_of(task: TipTask, policy: Policy, reports: bool) -> Iterator[Start]:
    """
    Yield search functions with tensions and bends to start from, each computed on demand.

    The first start is the guess, then the straight arm, from which a gentle bend is nearer than a
    curl, then the shapes of the library whose tips are nearest. Where
    solutions are reported, a far guess is followed by a first move of the arm. A frugal policy
    also searches from the guess with a cost of tension; where tendons stick that is one start
    more.
    """
    model, guess, nearby = task.model, task.guess, partial(aim, task, 0.0)
    if model.sticks:
        # for a direction, too, little is free, and another start is quicker
        steps = TRIALS_MAX // (4 if task.target[7] else 2)
        nearby = partial(seek, task, 1.0, steps=steps)
    if guess is not None:
        present = within(guess.inputs, *task.limits.T)
        # where friction remembers, a search creeps along narrow valleys
        trials = 4 * TRIALS_MAX if model.remembers else TRIALS_MAX
        trials = STICKING_TRIALS_MAX if model.sticks else trials
        track = partial(aim, task, TRACKING_GAIN_MIN, trials=trials)
        frugal = partial(aim_frugally, task, task.tension(policy.tension_weight), trials)
        far = model.sticks and task.cost(guess) >= far_cost(task)
        if not far and (model.sticks or not policy.frugal):
            yield track, present.copy(), guess.state
        if policy.frugal:
            yield frugal, present.copy(), guess.state
        if far:
            yield partial(cost_at, task), present, guess.state  # to stay
            if policy.starts:
                yield partial(seek, task, 1.0), present.copy(), guess.state
            if reports:
                yield _setting_out(task, guess, present, bool(policy.starts))
    starts = min(policy.starts, FEW_STARTS) if task.by_pulls else policy.starts
    if starts:
        yield nearby, model.limits[:, 0].copy(), np.zeros(3 * model.robot.cells)
        for row in islice(rows_near(task), starts):
            yield nearby, model.library.inputs[row].copy(), model.library.state[row]


def _setting_out(task: TipTask, guess: Shape, inputs: Floats, from_library: bool) -> Start:
    """Return a start that soon brings a far tip nearer: a library shape, or a short step."""
    if from_library:
        library, row = task.model.library, next(rows_near(task))
        # at half of the distance or nearer
        if squared_distances(library, task.target)[row] < 0.25 * 2.0 * task.cost(guess):
            return partial(cost_at, task), library.inputs[row].copy(), library.state[row]
    return partial(step_towards, task, guess), inputs.copy(), guess.state


def squared_distances(library: ShapeBatch, target: Floats) -> Floats:
    """Return squared weighted distances (rows,) [m²] of the tips of shapes from a target."""
    error = np.repeat(target[6:], 3) * (library.tip - target[:6])
    squares: Floats = (error * error).sum(axis=1)
    return squares


def rows_near(task: TipTask) -> Iterator[int]:
    """
    Yield shapes of the library whose tips are near the target, the nearest first.

    Every other one is that whose tensions are furthest from all before: from high tensions that
    oppose each other, searches often find no path to lower ones.
    """
    library, high = task.model.library, task.model.limits[:, 1]
    # more than would ever be tried
    near = np.argsort(squared_distances(library, task.target))[: 5 * COLD.starts]
    points, distance = library.inputs[near] / high, np.full(len(near), np.inf)
    for count in range(len(near)):
        remaining = np.flatnonzero(distance > 0.0)
        if not len(remaining):
            return
        row = int(np.argmax(distance)) if count % 2 else int(remaining[0])
        yield int(near[row])
        distance = np.minimum(distance, ((points - points[row]) ** 2).sum(axis=1))
