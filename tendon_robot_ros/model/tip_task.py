"""What is asked of the tip of a model, and how far a shape is from it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError
from ..common.patience import Patience
from .inputs import finite

if TYPE_CHECKING:
    from .forward import ForwardModel
    from .shape import Shape

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class TipTask:
    """What is asked of the tip, and what friction remembers where the way there begins."""

    model: ForwardModel
    target: Floats  # (8,) position [m], direction, weight of the position [1], of the direction
    past: Floats  # friction memory; all zero: straight and free of tension
    patience: Patience = field(default_factory=Patience)  # of a search, between its steps

    def shape(self, inputs: Floats, state: Floats) -> Shape:
        """Return the shape under tensions (m,) [N] that follow the past."""
        past = self.past if self.model.remembers else None
        return self.model.shape(inputs, state, past)

    def errors(self, shape: Shape) -> tuple[float, float]:
        """Return how far the tip is from where it should be, [m] and [rad]; 0: not asked."""
        x, y, z, bx, by, bz, weight, direction_weight = self.target.tolist()
        position = math.dist(shape.tip_position.tolist(), (x, y, z)) if weight else 0.0
        if not direction_weight:
            return position, 0.0
        ax, ay, az = shape.tip_direction.tolist()
        across = math.hypot(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)
        return position, math.atan2(across, ax * bx + ay * by + az * bz)


def tip_target(
    model: ForwardModel,
    position: npt.ArrayLike | None,
    direction: npt.ArrayLike | None,
    position_weight: float,
    direction_weight: float | None,
) -> Floats:
    """Return what is asked as one array (8,); see `TipTask`."""
    if position is None and direction is None:
        raise InputError('target: expected a position, a direction, or both, got neither')
    target = np.zeros(8)
    if position is not None:
        target[:3], target[6] = finite('position', position, 3), position_weight
    if direction is not None:
        along = finite('direction', direction, 3)
        size = math.sqrt(along @ along)
        if size < 1e-9:
            raise InputError(f'direction: expected a vector of some length, got {along}')
        weight = 0.2 * model.robot.length if direction_weight is None else direction_weight
        target[3:6], target[7] = along / size, weight
    return target
