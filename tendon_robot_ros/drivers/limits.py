"""Two small rules that keep a command where it may be; used by drivers and by the controller."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def approach(current: Array, goal: Array, step: Array) -> Array:
    """
    Move towards a goal on a straight line, no input by more than its step.

    Every input arrives at the same time, so the arm passes through postures between the two.

    Parameters
    ----------
    current, goal : ndarray, shape (m,) [N] or [m]
        Where the command is and where it should go.
    step : ndarray, shape (m,), same unit
        Largest change of each input, >= 0.

    Returns
    -------
    ndarray, shape (m,), same unit
        Between `current` and `goal`.

    """
    way = goal - current
    moving = np.abs(way) > step
    if not moving.any():
        return goal.copy()
    part = float(np.min(step[moving] / np.abs(way[moving])))
    low, high = np.minimum(current, goal), np.maximum(current, goal)
    return np.clip(current + part * way, low, high)


def bounded(command: Array, limits: Array) -> Array:
    """Clip a command, shape (m,), to limits, shape (m, 2)."""
    return np.clip(command, limits[:, 0], limits[:, 1])
