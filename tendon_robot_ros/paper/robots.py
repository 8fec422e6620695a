"""Variants of the paper's robots: another arm, other effects, PCCA."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..model.model import Model
from ..robot import Robot

Floats = npt.NDArray[np.float64]
# [m] hinge friction of the 10:1 prototype: reproduces section IV.D's errors
HINGE_LEVER_M = 0.40e-3


@dataclass(frozen=True)
class Robots:
    """The four descriptions that the experiments need."""

    target: Robot  # 1:1, section IV.B
    prototype: Robot  # 10:1, two sections, IV.C
    single: Robot  # 10:1, one section, IV.D
    small: Robot  # 2:1, one section, IV.E


def pcca(robot: Robot) -> Robot:
    """Return the robot without any effect: piecewise constant curvature."""
    return replace(robot, name='PCCA', effects={}, fitted={})


def with_arm(robot: Robot, arm: float) -> Robot:
    """Return the robot with all tendons at a distance [m] from the centroid, sides kept."""
    tendons = []
    for tendon in robot.tendons:
        scale = arm / float(np.hypot(*tendon.base))
        place = (scale * tendon.base[0], scale * tendon.base[1])
        tendons.append(replace(tendon, base=place, end=place))
    return replace(robot, tendons=tuple(tendons))


def with_cells(robot: Robot, cells: int) -> Robot:
    """Return a robot of one section with as many cells, of the same length and stiffness."""
    (section,) = robot.sections
    made = replace(
        section,
        cells=cells,
        cell_length=section.cells * section.cell_length / cells,
        bending_stiffness=(section.bending_stiffness[0] * cells / section.cells,) * cells,
        mass_profile=(1.0,) * cells,
    )
    return replace(robot, sections=(made,))


def at_view(model: Model, inputs: tuple[int, int], near: Floats, view: float, side: int) -> Floats:
    """
    Find tensions at which the tip looks at a view angle exactly.

    Parameters
    ----------
    model : Model
        Of a planar robot.
    inputs : (int, int)
        Index of the input whose tension is given, and of the one that is found; others are slack.
    near : (b,) [N]
        Tensions of the first.
    view : float
        Tip angle [rad].
    side : int
        Sign of the tip angle.

    Returns
    -------
    (c, m) [N]
        In the order of `near`, those without a solution left out.

    """
    levels = np.linspace(0.0, model.robot.tension_limits[1], 101)
    rows = np.zeros((len(near), len(levels), len(model.inputs)))
    rows[:, :, inputs[0]], rows[:, :, inputs[1]] = near[:, None], levels
    gap = _gap(model, rows.reshape(-1, rows.shape[2]), view, side).reshape(rows.shape[:2])
    crossing = (gap[:, :-1] < 0.0) & (gap[:, 1:] >= 0.0)
    postures = np.flatnonzero(crossing.any(axis=1))
    at = crossing[postures].argmax(axis=1)
    low, high = rows[postures, at], rows[postures, at + 1]
    for _ in range(40):
        middle = 0.5 * (low + high)
        below = (_gap(model, middle, view, side) < 0.0)[:, None]
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(high)


def _gap(model: Model, tensions: Floats, view: float, side: int) -> Floats:
    bend = model.solve(tensions)[0].bend
    return np.asarray(side * bend[:, :, 0].sum(axis=1) - view)


# -----------------------------------------------------------------------------
# Cells that bend a little more or less than they should, as those of a real prototype.


def held(play: Floats, robot: Robot) -> Floats:
    """Take the mean of every section off the play (..., n) [rad]: taut wires hold the sum."""
    parts = np.split(play, np.cumsum([s.cells for s in robot.sections])[:-1], axis=-1)
    return np.concatenate([part - part.mean(axis=-1, keepdims=True) for part in parts], axis=-1)


def turned(positions: Floats, play: Floats) -> Floats:
    """
    Turn every cell about its proximal end, with all that lies beyond it.

    Parameters
    ----------
    positions : (..., n, 3) [m]
        Ends of the cells.
    play : (..., n) [rad]
        Turns in the x-z plane, towards +x.

    """
    moved = np.array(positions, dtype=float)
    joints = np.concatenate([np.zeros_like(moved[..., :1, :]), moved[..., :-1, :]], axis=-2)
    for i in reversed(range(moved.shape[-2])):  # what lies nearer to the base is still in place
        away = moved[..., i:, :] - joints[..., i : i + 1, :]
        c, s = np.cos(play[..., i, None]), np.sin(play[..., i, None])
        moved[..., i:, 0] = joints[..., i, None, 0] + c * away[..., 0] + s * away[..., 2]
        moved[..., i:, 2] = joints[..., i, None, 2] - s * away[..., 0] + c * away[..., 2]
    return moved
