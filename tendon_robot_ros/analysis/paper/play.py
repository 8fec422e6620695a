"""Cells that bend a little more or less than they should, as those of a real prototype."""

from __future__ import annotations

import numpy as np

from ...robot import Robot
from .robots import Floats


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
