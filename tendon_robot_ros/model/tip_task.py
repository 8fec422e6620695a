"""What is asked of the tip, how far a shape is from it, and how long the search may take."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError, short
from ..robot import Robot
from ..robot.inputs import finite

if TYPE_CHECKING:
    from .forward import ForwardModel
    from .shape import Shape

Floats = npt.NDArray[np.float64]
# [1] of ln of what is left of the tensions' range, beside ln of the error that is left. Beside an
# error s (1 - t) that a share t of all tensions takes away, and d that none does, the least of
# ln(d² + s² (1 - t)²) / 2 - p ln(1 - t) is at t = 1 - d / (D s) with p = 1 / (1 + D²), without a
# jump: a tension goes evenly until d is D times what it takes away. D: a half.
TENSION_PRICE = 0.8
LEFT = 1e-3  # [1] what counts as left of the range where all tendons are at their limit
FAR_LENGTHS = 100.0  # [1] so far off all places cost the same: exp would overflow


class Patience:
    """Says True once time is over; another thread may end it before."""

    def __init__(self, budget: float = math.inf) -> None:
        """Begin to count; `budget` [s]."""
        self._began = time.monotonic()
        self.until: npt.NDArray[np.float64] = np.array([self._began + budget])  # (1,) [s]

    def __call__(self) -> bool:
        """Whether time is over."""
        return time.monotonic() > float(self.until[0])

    def begin(self) -> None:
        """Begin to count now: what had to wait has all of its time."""
        self.prolong(time.monotonic() - self._began)

    def prolong(self, more: float) -> None:
        """Let it last longer [s]; what was ended stays so."""
        self.until += more

    def end(self) -> None:
        """Let it be over now."""
        self.until[0] = -math.inf


@dataclass(frozen=True)
class TipTask:
    """What is asked of the tip, and what friction remembers where the way there begins."""

    model: ForwardModel
    target: Floats  # (8,) position [m], direction, weight of the position [1], of the direction
    past: Floats  # friction memory; all zero: straight and free of tension
    patience: Patience = field(default_factory=Patience)  # of a search, between its steps

    @property
    def per_newton(self) -> float:
        """Length of the robot over the range of its tensions [m/N]: weights are shares of it."""
        return self.model.robot.length / self._range

    @property
    def _range(self) -> float:
        """Return the mean range of the tensions [N]."""
        low, high = self.model.limits.T
        return float((high - low).mean())

    def tension(self, share: float, priced: bool) -> Floats:
        """
        Return what tension costs in a search (4,), see `aim` of the kernel.

        A share [1] of `per_newton`, and, priced, what `worth` says.
        """
        room, price = self._range * len(self.model.inputs), TENSION_PRICE if priced else 0.0
        return np.array([share * self.per_newton, price, self.model.robot.length, room])

    def worth(self, cost: float, inputs: Floats) -> float:
        """
        Return a cost [m²] with what tensions (m,) [N] cost beside the error e that is left.

        It grows with ln e - `TENSION_PRICE` x ln(1 - t), with the mean share t of the tensions in
        their range: how far a target is beyond reach does not make tension cheap. Beyond a length
        of the robot e itself counts, in lengths.
        """
        share = float((inputs - self.model.limits[:, 0]).mean()) / self._range
        length = self.model.robot.length
        away = math.sqrt(2.0 * cost) / length
        size = away if away < 1.0 else math.exp(min(away - 1.0, FAR_LENGTHS))
        left = math.pow(max(1.0 - share, LEFT), TENSION_PRICE)
        return 0.5 * (length * size / left) ** 2

    def held_at(self, shape: Shape) -> TipTask:
        """Return the task to stay where a tip is: what is beyond reach is not asked for again."""
        target = np.concatenate([shape.tip_position, shape.tip_direction, self.target[6:]])
        return replace(self, target=target)

    def shape(self, inputs: Floats, state: Floats) -> Shape:
        """Return the shape under tensions (m,) [N] that follow the past."""
        past = self.past if self.model.remembers else None
        return self.model.shape(inputs, state, past)

    def off(self, shape: Shape) -> Floats:
        """Return how far (6,) position [m] and direction are from the target."""
        return np.concatenate([shape.tip_position, shape.tip_direction]) - self.target[:6]

    def cost(self, shape: Shape) -> float:
        """Return half the square of the weighted distance [m²], as the kernel's searches do."""
        miss = np.repeat(self.target[6:], 3) * self.off(shape)
        return 0.5 * float(miss @ miss)

    def errors(self, shape: Shape) -> tuple[float, float]:
        """Return how far the tip is from where it should be, [m] and [rad]; 0: not asked."""
        x, y, z, bx, by, bz, weight, direction_weight = self.target.tolist()
        position = math.dist(shape.tip_position.tolist(), (x, y, z)) if weight else 0.0
        if not direction_weight:
            return position, 0.0
        ax, ay, az = shape.tip_direction.tolist()
        across = math.hypot(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)
        return position, math.atan2(across, ax * bx + ay * by + az * bz)


UNIT_LENGTHS = 10.0  # [1] of the arm from its base: millimetres are a thousand times as far


def refuse_other_unit(robot: Robot, position: npt.ArrayLike | None) -> None:
    """Refuse a position (3,) that is so far that it must be in another unit."""
    if position is None:
        return
    values = finite('position', position, 3)
    away = float(np.linalg.norm(values))
    if away > UNIT_LENGTHS * robot.length:
        mm = 1e-3 * away <= UNIT_LENGTHS * robot.length
        hint = '; if these are mm, divide by 1000' if mm else ''
        raise InputError(
            f'position: expected metres, got {short(values.tolist())}, {away:.4g} m from the base '
            f'of an arm of {robot.length:.4g} m{hint}'
        )


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
