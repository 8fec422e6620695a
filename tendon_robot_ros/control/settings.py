"""What the controller is told, and what it gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..model.inverse_pulls import limits_by_pulls

if TYPE_CHECKING:
    from ..model.model import Model

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Settings:
    """How the controller behaves; all of it may change at run time."""

    rate_limit: float = 10.0  # [N/s] of every tension
    state_timeout: float = 0.25  # [s] without tendon states the driver counts as gone
    twist_timeout: float = 0.1  # [s]
    patience: float = 0.5  # [s] without equilibrium, then the arm is released
    hold_direction: bool = False  # keep the view while a twist moves the tip
    direction_weight: float = 0.0  # [m/rad], 0: a fifth of the robot's length
    pull_mode: bool = False
    tip_gain: float = 0.0  # [1/s] of the integral on the measured tip, 0: open loop

    def limits(self, model: Model) -> Array:
        """Return tension limits (m, 2) [N]; wires that are driven by their length may be slack."""
        return limits_by_pulls(model) if self.pull_mode else model.limits


@dataclass(frozen=True)
class Target:
    """A set point of the tip in the base frame: position [m], approach direction, or both."""

    position: Array | None = None
    direction: Array | None = None
    stamp: str = ''  # as its sender gave it, to tell targets apart


@dataclass(frozen=True)
class Output:
    """A command: tensions (m,) [N] and, in pull mode, the wire pulls (m,) [m] they belong to."""

    tensions: Array
    pulls: Array | None = None
