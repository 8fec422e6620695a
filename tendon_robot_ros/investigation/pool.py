"""Postures that may be chosen: within tension, bend and the regions that are kept out."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError, NoEquilibriumError
from ..model.model import Model
from ..model.pulls import pull_shapes
from ..robot import Robot
from ..robot.keep_out import KeepOut
from ..workspace.postures import default_postures
from .goal import Goal

Floats = npt.NDArray[np.float64]
POOL_POSTURES = 120
PULL_POSTURES = 40  # of wire pulls: those take longer
FRESH_SEED = 7919  # of the postures to verify on: none of the pool
WAY_POINTS = 16  # that are looked at on the way to a posture
MARGIN_SHARE = 0.05  # of the length: how far an arm may be from an untried model


@dataclass(frozen=True)
class Room:
    """Where the arm may be, and how far off the model may be that says where it is."""

    regions: KeepOut = field(default_factory=KeepOut)
    margin: float = 0.0  # [m]

    def keeps(self, points: Floats) -> bool:
        """
        Tell whether an arm keeps clear on a way (w, n, 3) [m] of its points, base first.

        The model may be off the more the farther from the base; between two steps of the way a
        point goes at most half of what it moved.
        """
        if not self.regions:
            return True
        off = self.margin * np.linspace(0.0, 1.0, points.shape[1])
        moved = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=0, initial=0.0)
        return bool((self.regions.distances(points) >= off + 0.5 * moved).all())


def pool(
    robot: Robot,
    goal: Goal,
    input: str,
    path: str,
    model: Model,
    room: Room,
    start: Floats | None = None,
) -> Floats:
    """
    Return postures (b, m) [N] or [m] that may be chosen.

    Parameters
    ----------
    robot : Robot
    goal : Goal
    input, path : str
        As of a data set.
    model : Model
        What is known of the arm now: says where it is at a posture.
    room : Room
    start : (m,), optional
        Where the arm comes from; default: it was let go.

    """
    count = PULL_POSTURES if input == 'displacement' else POOL_POSTURES
    singles = default_postures(robot, max(count // 5, 3), 0, input)
    rows = np.vstack(
        [singles, default_postures(robot, count - len(singles), 1 + goal.seed, input)]
    )
    if path == 'sequence':  # letting go is what shows a memory
        loops = default_postures(robot, count // 2, 2 + goal.seed, input, 'sequence')
        rows = np.vstack([rows, loops])
    return allowed(np.unique(rows, axis=0), goal, input, model, room, start)


def fresh(robot: Robot, goal: Goal, input: str, model: Model, room: Room) -> Floats:
    """Return allowed postures that no pool has, to verify on."""
    rows = default_postures(robot, 4 * goal.checks + 4, FRESH_SEED + goal.seed, input)
    return allowed(rows, goal, input, model, room)


def allowed(
    rows: Floats, goal: Goal, input: str, model: Model, room: Room, start: Floats | None = None
) -> Floats:
    """Return the postures whose tensions and whose shape, and the way to it, may be."""
    if input == 'tension':
        rows = rows[(rows <= goal.tension_max + 1e-9).all(axis=1)]
    elif np.isfinite(goal.tension_max):
        rows = np.array([row for row in rows if _pulls_gently(model, row, goal.tension_max)])
    rows = rows.reshape(-1, len(model.inputs))
    if not room.regions or not len(rows):
        return rows
    return rows[[_stays(model, row, input, room, start) for row in rows]]


def _pulls_gently(model: Model, pulls: Floats, most: float) -> bool:
    """Tell whether wire pulls take no more tension [N]."""
    try:
        return bool(model.pull_shape(pulls).inputs.max() <= most)
    except (NoEquilibriumError, InputError):
        return False


def _stays(model: Model, row: Floats, input: str, room: Room, start: Floats | None) -> bool:
    """Tell whether the arm keeps out on its straight way to a posture."""
    begin = model.limits[:, 0] if input == 'tension' else np.where(np.isnan(row), np.nan, 0.0)
    if start is not None:
        begin = start
    shares = np.linspace(0.0, 1.0, WAY_POINTS)[:, None]
    way = np.where(np.isnan(row), np.nan, begin + shares * (row - begin))
    try:
        shapes = model.shapes(way) if input == 'tension' else pull_shapes(model, way)
    except (NoEquilibriumError, InputError):
        return False
    points = np.concatenate([np.zeros((len(way), 1, 3)), shapes.positions], axis=1)
    return room.keeps(points)
