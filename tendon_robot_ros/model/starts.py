"""
Searches for tensions that bring the tip to a target, and where they start.

`aim` goes from equilibrium to equilibrium. Where tendons stick it soon stalls at a kink of
friction; `seek` solves for bends and tensions at once. `inverse.reach` searches from one start
after the other, all over the workspace.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError, NoEquilibriumError
from ..robot.estimates import SAME_TENSION_N
from .compile import LEAST_TENSION_N
from .program import within
from .pulls import held_shape
from .tip_task import COLD, LOW_TENSION_WEIGHT, Policy, TipTask, cost_of

if TYPE_CHECKING:
    from .shape import Shape, ShapeBatch

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


@dataclass(frozen=True)
class TriedTensions:
    """Tensions (m,) [N], a state (3n,) [rad], of equilibrium or a guess, and a cost [m²]."""

    inputs: Floats
    state: Floats
    cost: float = np.inf


# how to improve tensions within limits (m, 2) [N], and from where
Aim = Callable[[TriedTensions, Floats], TriedTensions]
Start = tuple[Aim, TriedTensions]


def aim(
    task: TipTask,
    gain_min: float,
    start: TriedTensions,
    limits: Floats,
    tension: tuple[float, ...] | None = None,
    cost_max: float = np.inf,
    trials: int = TRIALS_MAX,
) -> TriedTensions:
    """
    Improve tensions, from equilibrium to equilibrium.

    Parameters
    ----------
    gain_min : float
        At the target, a step that reduces the cost by a smaller fraction is the last [1].
    start : TriedTensions
    limits : (m, 2) [N]
    tension : tuple of float, optional
        Cost of tension (`TipTask.tension`); default: just enough to decide between equal tips.
    cost_max : float
        A start that costs more stays as it is [m²].
    trials : int
        Equilibria that may be tried.

    """
    problem = _kernel_arguments(task, start, limits)
    tension = task.tension(LOW_TENSION_WEIGHT) if tension is None else tension
    search = task.model.arrays.part('inverse').aim
    cost = float(search(*problem, tension, trials, gain_min, cost_max))
    return TriedTensions(problem[1], problem[2][0], cost)


def aim_frugally(
    task: TipTask, tension: tuple[float, ...], trials: int, start: TriedTensions, limits: Floats
) -> TriedTensions:
    """Improve tensions with a cost of tension, which is no part of the cost that is returned."""
    found = aim(task, TRACKING_GAIN_MIN, start, limits, tension, trials=trials)
    return cost_at(task, found, limits)


def cost_at(task: TipTask, start: TriedTensions, limits: Floats) -> TriedTensions:
    """Return the equilibrium of tensions as they are, with its cost."""
    return aim(task, TRACKING_GAIN_MIN, start, limits, cost_max=0.0)


def step_towards(
    task: TipTask, guess: Shape, start: TriedTensions, limits: Floats
) -> TriedTensions:
    """Improve tensions by one step towards a far target: a first move of the arm."""
    near, step = task.target.copy(), 0.5 * FAR_LENGTH * task.model.robot.length
    near[:6] += (1.0 - step / np.sqrt(2.0 * task.cost(guess))) * task.tip_error(guess)
    nearer = replace(task, target=near)
    moved = aim(nearer, TRACKING_GAIN_MIN, start, limits, trials=STICKING_TRIALS_MAX)
    return cost_at(task, moved, limits)


def seek(
    task: TipTask,
    fraction: float,
    start: TriedTensions,
    limits: Floats,
    steps: int = TRIALS_MAX // 2,
) -> TriedTensions:
    """
    Improve tensions towards a far target, for tendons that stick and slip.

    Bends and tensions are solved for at once, with a smoothing length of friction that starts as a
    fraction of the widest; equilibrium comes last.
    """
    problem = _kernel_arguments(task, start, limits)
    part = task.model.arrays.part('inverse')
    part.seek(*problem, SEEKING_WEIGHT * task.per_newton, fraction, steps)
    found, far = TriedTensions(problem[1], problem[2][0]), far_cost(task)
    return aim(task, TRACKING_GAIN_MIN, found, limits, cost_max=far, trials=STICKING_TRIALS_MAX)


def far_cost(task: TipTask) -> float:
    """Return the cost [m²] from which a target counts as far."""
    return cost_of(FAR_LENGTH * task.model.robot.length)


def _kernel_arguments(task: TipTask, start: TriedTensions, limits: Floats) -> tuple[Any, ...]:
    """Return the arguments that both compiled searches share; the second and third are results."""
    low, high = np.ascontiguousarray(limits.T)
    model, until = task.model, task.patience.until.ctypes.data
    inputs, states = start.inputs.copy(), np.array([start.state, start.state])
    problem = (model.arrays.address, inputs, states, task.target, low, high)
    return *problem, until, task.past, model.scratch


def aim_by_pulls(task: TipTask, search: Aim, start: TriedTensions) -> TriedTensions:
    """
    Improve tensions among those that wire lengths can hold; the cost is infinite if none are held.

    Wires of given lengths keep no tension against each other: of the states with these lengths,
    the arm takes the one in which the loose wires are slack. So the wires that the lengths do not
    hold are set slack, one after the other, and the search is repeated with the others.
    """
    taut, tried = start.inputs > LEAST_TENSION_N, start
    for _ in range(len(taut)):
        limits = task.limits * taut[:, None]
        tried = search(replace(tried, inputs=np.clip(tried.inputs, *limits.T)), limits)
        if not np.isfinite(tried.cost):
            break
        try:
            shape = task.shape(tried.inputs, tried.state)
            held = held_shape(task.model, shape.pulls, shape, task.past)
        except (NoEquilibriumError, InputError):
            break
        if np.allclose(held.inputs, tried.inputs, rtol=0.0, atol=SAME_TENSION_N):
            return tried
        lost = taut & (held.inputs < tried.inputs - SAME_TENSION_N)
        if not lost.any():
            break
        taut[np.argmin(np.where(lost, held.inputs, np.inf))] = False
        tried = TriedTensions(held.inputs, held.state)
    return replace(tried, cost=np.inf)


def starts_of(task: TipTask, policy: Policy, reports: bool) -> Iterator[Start]:
    """
    Yield search functions with what they start from, each computed on demand.

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
        present = TriedTensions(within(guess.inputs, *task.limits.T), guess.state)
        # where friction remembers, a search creeps along narrow valleys
        trials = 4 * TRIALS_MAX if model.remembers else TRIALS_MAX
        trials = STICKING_TRIALS_MAX if model.sticks else trials
        track = partial(aim, task, TRACKING_GAIN_MIN, trials=trials)
        frugal = partial(aim_frugally, task, task.tension(policy.tension_weight), trials)
        far = model.sticks and task.cost(guess) >= far_cost(task)
        if not far and (model.sticks or not policy.frugal):
            yield track, present
        if policy.frugal:
            yield frugal, present
        if far:
            yield partial(cost_at, task), present  # to stay
            if policy.starts:
                yield partial(seek, task, 1.0), present
            if reports:
                yield _setting_out(task, guess, present, bool(policy.starts))
    starts = min(policy.starts, FEW_STARTS) if task.by_pulls else policy.starts
    if starts:
        yield nearby, TriedTensions(model.limits[:, 0], np.zeros(3 * model.robot.cells))
        for row in islice(rows_near(task), starts):
            yield nearby, TriedTensions(model.library.inputs[row], model.library.state[row])


def _setting_out(task: TipTask, guess: Shape, present: TriedTensions, from_library: bool) -> Start:
    """Return a start that soon brings a far tip nearer: a library shape, or a short step."""
    if from_library:
        library, row = task.model.library, next(rows_near(task))
        # at half of the distance or nearer
        if squared_distances(library, task.target)[row] < 0.25 * 2.0 * task.cost(guess):
            return partial(cost_at, task), TriedTensions(library.inputs[row], library.state[row])
    return partial(step_towards, task, guess), present


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
