"""
The way to a target: friction forgets on it where that helps, and it ends before a region.

Friction remembers the way. From below, tendons first slip all over, so that the same tensions
always lead to the same place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError, NoEquilibriumError
from ..model.inverse import CLEARANCE_BINDS_M
from ..model.shape import Reach
from .checks import Refusal

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Shape
    from ..model.tip_task import TipTask
    from ..robot.keep_out import Clearance, KeepOut
    from .state import Trajectory

Array = NDArray[np.float64]
Solve = Callable[['Shape', Array], 'Shape']
APPROACHES = 'any', 'from_below'
# [1] presliding lengths that the wire nearest to the middle is moved through its eyelets, so that
# each law of friction has forgotten what was before
BEND_SLIPS = 80.0
# [1] of the largest radius: the presliding length where nobody knows it, 0.2 mm on the arm of Kato
# 2015 (assumed)
PRESLIDING_RADIUS = 0.036
# [rad] of the whole arm; more would wind it up
BEND_MAX_RAD = 4.0
# [1] of a tension's range, tried one after the other until that bend, because it grows by no law
BENDS = np.geomspace(0.005, 1.0, 24)
# [1] of full friction, to which its directions are carried to another model; noise of load cells
# would turn them by more
CARRIED_TOLERANCE = 1e-3
# [1] iterations for that; a direction that takes more stands at a kink, and would never settle
CARRIED_ITERATIONS_MAX = 40
# [1] of a straight leg: the first look at the arm on it; regions that are nearer would bring it
# closer
LOOK_STEP = 0.05
# [m] from a region: nearer, no point of the arm goes further than half of that between two looks,
# so that none passes a corner unseen by more than a millimetre
LOOK_NEAR_M = 2e-3


@dataclass(frozen=True)
class Approach:
    """Tensions for a target, and the tensions (v, m) [N] on the way there."""

    reach: Reach
    via: Array

    @classmethod
    def straight(cls, direct: Reach) -> Approach:
        """Go straight to tensions."""
        return cls(direct, np.empty((0, len(direct.tensions))))


def carried(model: Model, before: Model, last: Shape | None, tensions: Array) -> Shape | None:
    """
    Return the shape in which friction is as another model had it; None: nothing is known of it.

    The arm has not moved, only what is believed of it: the directions in which tendons were last
    dragged stay. The travel from which they go on is that of the new model there, until which
    they are set back: taken from the other one, all tendons would have slipped by the difference.

    Parameters
    ----------
    model, before : Model
        The one that comes, and the one that was.
    last : Shape or None
        As `before` had it.
    tensions : (m,) [N]
        That act now.

    """
    same = last is not None and (last.form.n, last.form.k) == (model.form.n, model.form.k)
    if last is None or not same or not (model.remembers and before.remembers):
        return None
    signs = slice(len(last.state), len(last.state) + last.tendon_tensions.size)
    directions, memory, shape = last.memory[signs].copy(), last.memory, last
    try:
        for _ in range(CARRIED_ITERATIONS_MAX):
            shape = model.shape(tensions, shape.state, memory)
            if np.abs(shape.memory[signs] - directions).max() < CARRIED_TOLERANCE:
                break
            memory = shape.memory.copy()
            memory[signs] = directions
    except NoEquilibriumError:
        return None
    return shape


def forgotten(
    model: Model, here: Shape, direct: Reach, solve: Callable[[Shape], Reach]
) -> Approach:
    """
    Return the approach to a target on which friction forgets first, from where the arm is.

    Parameters
    ----------
    model : Model
    here : Shape
        Where the arm is, with what friction remembers.
    direct : Reach
        Tensions for the target, in a straight line from there: what is left where there is no
        equilibrium on the way.
    solve : callable
        From a shape to tensions for the target that are right from there.

    """
    via = forgetting(model)
    try:
        for tensions in via:
            here = model.follow(here, tensions)
        return Approach(solve(here), via)
    except NoEquilibriumError:
        return Approach.straight(direct)


def forgetting(model: Model) -> Array:
    """
    Return tensions (2, m) [N] after which friction knows nothing of what was before.

    The tendons on one side pull until the whole arm bends there, then all are at their lowest: at
    every eyelet every tendon has slipped there and back, whatever its law of slip. The bend takes
    the wire nearest to the middle many presliding lengths through its eyelets. The side is that
    of the tendon for which all others slip most.
    """
    ends = np.array([tendon.end for tendon in model.robot.tendons])
    radii = np.hypot(*ends.T)
    arms = [ends @ (end / radius) for end, radius in zip(ends, radii, strict=True) if radius > 0.0]
    along = max(arms, key=lambda arm: float(np.abs(arm).min()))  # (tendons,) [m]
    pulls = np.array([along[list(members)].mean() for members in model.robot.input_tendons])
    side = np.maximum(pulls, 0.0) / np.abs(along).max()
    length = PRESLIDING_RADIUS * float(radii.max())
    if model.remembers:
        length = float(model.arrays.get('friction_memory', 'presliding_length', None))
    wanted = min(BEND_SLIPS * length / float(np.abs(along).min()), BEND_MAX_RAD)
    low, high = model.limits.T
    shape = straight = model.shape(low)
    for more in float((high - low).max()) * BENDS:
        try:
            shape = model.shape(np.clip(low + more * side, low, high), shape.state)
        except NoEquilibriumError:
            break
        if np.linalg.norm(shape.bend - straight.bend, axis=1).sum() >= wanted:
            break
    return np.array([shape.inputs, low])


def cut_short(here: Shape, way: Approach, task: TipTask) -> Approach:
    """
    Return an approach up to where the arm would enter a region; `nearest`, with the region named.

    An arm that is inside already may leave: what counts is how deep it goes beyond that.
    """
    allowed, model, shape = _allowed(here, task.keep_out), task.model, here
    via: list[Array] = []
    for tensions in (*way.via, way.reach.tensions):
        for _, new, near in _looks(model.follow, shape, shape.inputs, tensions, task.keep_out):
            if near.distance < allowed:
                kept = Reach(shape, *task.errors(shape), 'nearest', (), near.region)
                return Approach(kept, np.array(via).reshape(-1, len(model.inputs)))
            shape = new
        via.append(tensions)
    return way


def entered(
    model: Model, here: Shape, way: Trajectory, keep_out: KeepOut, pull: bool
) -> Refusal | None:
    """
    Return why a trajectory of the tendons may not be played, None where it keeps out.

    Parameters
    ----------
    here : Shape
        Where the arm is.
    way : Trajectory
        Of tensions or, where `pull`, of wire pulls; the first point is gone to from where the arm
        is, then in straight lines.

    """

    def pulled(shape: Shape, pulls: Array) -> Shape:
        return model.pull_shape(pulls, shape, shape.memory if model.remembers else None)

    allowed, solve, time = _allowed(here, keep_out), pulled if pull else model.follow, 0.0
    shape, begin = here, here.pulls if pull else here.inputs
    for due, end in zip(way.times.tolist(), way.values, strict=True):
        try:
            for part, new, near in _looks(solve, shape, begin, end, keep_out):
                shape = new
                if near.distance < allowed:
                    return Refusal(
                        'keep_out',
                        f'tendon_trajectory: at {time + part * (due - time):.2f} s the arm '
                        f'would enter {near.region}; nothing of it was played',
                    )
        except (NoEquilibriumError, InputError) as error:
            return Refusal(
                'no_equilibrium',
                f'tendon_trajectory: after {time:.2f} s nobody can say whether the arm keeps out '
                f'of the regions: {error}; nothing of it was played',
            )
        time, begin = due, end
    return None


def _allowed(here: Shape, keep_out: KeepOut) -> float:
    return min(keep_out.clearance(here.positions).distance, 0.0) - CLEARANCE_BINDS_M


def _looks(
    solve: Solve, shape: Shape, begin: Array, end: Array, keep_out: KeepOut
) -> Iterator[tuple[float, Shape, Clearance]]:
    """Look at the arm along a straight leg: the part of it that is gone, shape, clearance."""
    done, step = 0.0, LOOK_STEP
    while done < 1.0:
        done = min(done + step, 1.0)
        new = solve(shape, begin + done * (end - begin))
        moved = float(np.linalg.norm(new.positions - shape.positions, axis=1).max())
        near = keep_out.clearance(new.positions)
        yield done, new, near
        room = 0.5 * max(near.distance, LOOK_NEAR_M)  # no point of the arm goes further at once
        step, shape = min(max(step * room / max(moved, 1e-9), 0.1 * LOOK_STEP), 2.0 * step), new
