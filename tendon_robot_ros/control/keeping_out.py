"""Whether the arm would enter a region on its way to a target, or on a played trajectory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError, NoEquilibriumError
from ..model.inverse import CLEARANCE_BINDS_M
from ..model.shape import Reach
from .checks import Refusal
from .friction import Approach

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Shape
    from ..model.tip_task import TipTask
    from ..robot.keep_out import Clearance, KeepOut

Array = NDArray[np.float64]
Solve = Callable[['Shape', Array], 'Shape']
STEP, STEP_MIN = 0.05, 0.005  # [1] of a straight leg: the first look, and the closest ones
NEAR_M = 2e-3  # [m] from a region: nearer, no point of the arm goes further than half of that


def cut_short(
    model: Model, here: Shape, found: Approach, keep_out: KeepOut, task: TipTask
) -> Approach:
    """
    Return an approach up to where the arm would enter a region; `nearest`, with the region named.

    An arm that is inside already may leave: what counts is how deep it goes beyond that.
    """
    allowed = _allowed(here, keep_out)
    shape = here
    via: list[Array] = []
    for tensions in (*found.via, found.reach.tensions):
        for _, new, near in _looks(model.follow, shape, shape.inputs, tensions, keep_out):
            if near.distance < allowed:
                position, direction = task.errors(shape)
                kept = Reach(shape, position, direction, 'nearest', (), near.region)
                return Approach(kept, np.array(via).reshape(-1, len(model.inputs)))
            shape = new
        via.append(tensions)
    return found


def entered(
    model: Model, here: Shape, times: Array, values: Array, keep_out: KeepOut, pull: bool
) -> Refusal | None:
    """
    Return why a trajectory of the tendons may not be played, None where it keeps out.

    Parameters
    ----------
    here : Shape
        Where the arm is.
    times, values : (n,) [s], (n, m) [N] or, where `pull`, [m]
        The first point is gone to from where the arm is, then in straight lines.

    """

    def pulled(shape: Shape, pulls: Array) -> Shape:
        return model.pull_shape(pulls, shape, shape.memory if model.remembers else None)

    allowed, solve, time = _allowed(here, keep_out), pulled if pull else model.follow, 0.0
    shape, begin = here, here.pulls if pull else here.inputs
    for due, end in zip(times.tolist(), values, strict=True):
        try:
            for share, new, near in _looks(solve, shape, begin, end, keep_out):
                shape = new
                if near.distance < allowed:
                    return Refusal(
                        'keep_out',
                        f'tendon_trajectory: at {time + share * (due - time):.2f} s the arm '
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
    """Look at the arm along a straight leg: the share of it that is gone, shape, clearance."""
    done, step = 0.0, STEP
    while done < 1.0:
        done = min(done + step, 1.0)
        new = solve(shape, begin + done * (end - begin))
        moved = float(np.linalg.norm(new.positions - shape.positions, axis=1).max())
        near = keep_out.clearance(new.positions)
        yield done, new, near
        room = 0.5 * max(near.distance, NEAR_M)  # no point of the arm goes further at once
        step, shape = min(max(step * room / max(moved, 1e-9), STEP_MIN), 2.0 * step), new
