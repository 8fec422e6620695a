"""Targets for an arm that is driven by wire lengths: they hold no two wires tight."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..exceptions import InputError, NoEquilibriumError
from .pulls import pull_shape

if TYPE_CHECKING:
    from .model import Model

Floats = npt.NDArray[np.float64]
Aim = Callable[[Floats, Floats, Floats], tuple[float, Floats]]
SAME = 1e-3  # [N] difference of tensions that counts as held
SLACK = 1e-6  # [N]


def limits_by_pulls(model: Model) -> Floats:
    """Return tension limits (m, 2) [N] of wires that may be slack."""
    return model.limits * [0.0, 1.0]


def aim_by_pulls(model: Model, aim: Aim, inputs: Floats, bend: Floats) -> tuple[float, Floats]:
    """
    Improve inputs (m,) [N] in place among those that wire lengths can hold.

    Wires of given lengths keep up no tension against each other: the arm takes that one of the
    states with these lengths in which the loose wires are slack. So the wires that the lengths do
    not hold are set slack, one after the other, and the others aim again.

    Parameters
    ----------
    aim : callable
        Inputs (m,) [N], bends (n, 2) [rad] and limits (m, 2) [N] to the cost [m²] and the bends.

    Returns
    -------
    cost : float [m²]
        Infinite where nothing was found that is held.
    bends : (n, 2) [rad]

    """
    taut = inputs > model.limits[:, 0] + SLACK
    for _ in range(len(inputs)):
        limits = limits_by_pulls(model) * taut[:, None]
        np.clip(inputs, *limits.T, out=inputs)
        cost, bends = aim(inputs, bend, limits)
        if not np.isfinite(cost):
            break
        try:
            there = model.shape(inputs, bends)
            held = pull_shape(model, there.pulls, there)
        except (NoEquilibriumError, InputError):
            break
        if np.allclose(held.inputs, inputs, rtol=0.0, atol=SAME):
            return cost, bends
        lost = taut & (held.inputs < inputs - SAME)
        if not lost.any():
            break
        taut[np.argmin(np.where(lost, held.inputs, np.inf))] = False
        inputs[:], bend = held.inputs, held.bend
    return np.inf, bend
