"""
Paths to a target: they erase friction's memory on request and stop before keep-out regions.

With friction the posture depends on the path of the tensions. An approach from below first lets
every tendon slip in all eyelets, so that equal tensions always lead to the same posture.
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
# every law of friction has lost its memory
BEND_SLIPS = 80.0
# [1] of the largest radius: the presliding length where the model has none, 0.2 mm on the arm of
# Kato 2015 (assumed)
PRESLIDING_RADIUS = 0.036
# [rad] summed over the arm; more would wind it up
BEND_MAX_RAD = 4.0
# [1] of a tension's range, tried in sequence until the required bend, because the bend is no
# known function of the tension
BENDS = np.geomspace(0.005, 1.0, 24)
# [1] of full friction: tolerance of the directions of friction that another model takes over;
# noise of load cells would change them by more
CARRIED_TOLERANCE = 1e-3
# [1] iterations; a direction that needs more is at a kink of friction and would never converge
CARRIED_ITERATIONS_MAX = 40
# [1] of a straight leg: first step between two clearance checks; nearer regions would shorten it
CHECK_STEP = 0.05
# [m] clearance below which steps shrink no further: no point of the arm moves by more than half
# of it between two checks, so that none cuts a corner by more than a millimetre
CHECK_NEAR_M = 2e-3


@dataclass(frozen=True)
class Approach:
    """Tensions for a target, and the tensions (v, m) [N] to pass before."""

    reach: Reach
    via: Array

    @classmethod
    def straight(cls, direct: Reach) -> Approach:
        """Return the approach in a straight line to tensions."""
        return cls(direct, np.empty((0, len(direct.tensions))))


def carry_friction(
    model: Model, before: Model, last: Shape | None, tensions: Array
) -> Shape | None:
    """
    Return the shape by a new model with the directions of friction of the previous model.

    The arm has not moved, only its model has changed: the directions in which tendons were last
    dragged stay. The travel of the tendons is that of the new model, found by iteration: with the
    travel of the previous model, all tendons would have slipped by the difference.

    Parameters
    ----------
    model, before : Model
        The new and the previous model.
    last : Shape or None
        Last shape by `before`.
    tensions : (m,) [N]
        Tensions that act now.

    Returns
    -------
    Shape or None
        None where one of the models has no friction memory, where their cells or tendons differ,
        or where the new model has no equilibrium.

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


def forgetting_approach(
    model: Model, shape: Shape, direct: Reach, solve: Callable[[Shape], Reach]
) -> Approach:
    """
    Return the approach to a target that first erases the memory of friction.

    Parameters
    ----------
    model : Model
    here : Shape
        Present shape, with the memory of friction.
    direct : Reach
        Tensions for the target in a straight line: the fallback where the approach has no
        equilibrium.
    solve : callable
        Returns the tensions for the target when it is approached from a shape.

    """
    via = forgetting_tensions(model)
    try:
        for tensions in via:
            shape = model.follow(shape, tensions)
        return Approach(solve(shape), via)
    except NoEquilibriumError:
        return Approach.straight(direct)


def forgetting_tensions(model: Model) -> Array:
    """
    Return tensions (2, m) [N] that erase the memory of friction when they act in sequence.

    The tendons on one side bend the whole arm, then all tensions fall to their lower limits: in
    every eyelet every tendon has slipped in both directions, whatever its law of friction. The
    bend moves the wire nearest to the centroid by many presliding lengths. The side is that of
    the tendon for which the smallest slip of the others is largest.
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
    bend_min = min(BEND_SLIPS * length / float(np.abs(along).min()), BEND_MAX_RAD)
    low, high = model.limits.T
    shape = straight = model.shape(low)
    for more in float((high - low).max()) * BENDS:
        try:
            shape = model.shape(np.clip(low + more * side, low, high), shape.state)
        except NoEquilibriumError:
            break
        if np.linalg.norm(shape.bend - straight.bend, axis=1).sum() >= bend_min:
            break
    return np.array([shape.inputs, low])


def truncated(start: Shape, path: Approach, task: TipTask) -> Approach:
    """
    Return the part of an approach before the arm enters a region, with the status `nearest`.

    An arm that is inside a region already may leave it: only deeper postures are refused.
    """
    allowed, model, shape = _allowed(start, task.keep_out), task.model, start
    via: list[Array] = []
    for tensions in (*path.via, path.reach.tensions):
        for _, new, near in _postures(model.follow, shape, shape.inputs, tensions, task.keep_out):
            if near.distance < allowed:
                kept = Reach(shape, *task.errors(shape), 'nearest', (), near.region)
                return Approach(kept, np.array(via).reshape(-1, len(model.inputs)))
            shape = new
        via.append(tensions)
    return path


def keep_out_refusal(
    model: Model, start: Shape, trajectory: Trajectory, keep_out: KeepOut, pull: bool
) -> Refusal | None:
    """
    Return why a trajectory of the tendons enters a region, None where it keeps out of all.

    Parameters
    ----------
    here : Shape
        Present shape.
    trajectory : Trajectory
        Tensions or, where `pull`, wire pulls; straight lines from the present ones to the first
        point and between the points.

    """

    def pulled(shape: Shape, pulls: Array) -> Shape:
        return model.pull_shape(pulls, shape, shape.memory if model.remembers else None)

    allowed, solve, time = _allowed(start, keep_out), pulled if pull else model.follow, 0.0
    shape, begin = start, start.pulls if pull else start.inputs
    for due, end in zip(trajectory.times.tolist(), trajectory.values, strict=True):
        try:
            for fraction, new, near in _postures(solve, shape, begin, end, keep_out):
                shape = new
                if near.distance < allowed:
                    return Refusal(
                        'keep_out',
                        f'tendon_trajectory: at {time + fraction * (due - time):.2f} s the arm '
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


def _allowed(start: Shape, keep_out: KeepOut) -> float:
    return min(keep_out.clearance(start.positions).distance, 0.0) - CLEARANCE_BINDS_M


def _postures(
    solve: Solve, shape: Shape, begin: Array, end: Array, keep_out: KeepOut
) -> Iterator[tuple[float, Shape, Clearance]]:
    """Yield postures along a straight leg: fraction of the leg, shape and clearance."""
    fraction, step = 0.0, CHECK_STEP
    while fraction < 1.0:
        fraction = min(fraction + step, 1.0)
        new = solve(shape, begin + fraction * (end - begin))
        moved = float(np.linalg.norm(new.positions - shape.positions, axis=1).max())
        clearance = keep_out.clearance(new.positions)
        yield fraction, new, clearance
        room = 0.5 * max(clearance.distance, CHECK_NEAR_M)  # [m] limit of the motion of any point
        step, shape = min(max(step * room / max(moved, 1e-9), 0.1 * CHECK_STEP), 2.0 * step), new
