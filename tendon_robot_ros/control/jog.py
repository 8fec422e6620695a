"""Moving the tip with a velocity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..exceptions import InputError, NoEquilibriumError
from .checks import Refusal
from .settings import Target

if TYPE_CHECKING:
    from ..model.shape import Shape
    from .core import ControllerCore

Array = NDArray[np.float64]
LEAD = 0.002  # [m] how far the wanted tip may be ahead of the reachable one


@dataclass(frozen=True)
class Twist:
    """A velocity of the tip [m/s] and [rad/s], in base axes or in those of the tip."""

    linear: Array
    angular: Array
    in_tip: bool = False

    @property
    def moves(self) -> bool:
        """Whether it is a velocity at all."""
        return bool(self.linear.any() or self.angular.any())


@dataclass
class Jog:
    """Where a stream of twists has moved the wanted tip."""

    position: Array
    direction: Array
    axes: Array  # (3, 3) of the tip, as columns
    twist: Twist | None = None
    received: float = -np.inf

    @classmethod
    def start(cls, shape: Shape) -> Jog:
        """Start at a shape."""
        return cls(shape.tip_position.copy(), shape.tip_direction.copy(), shape.frames[-1].copy())

    def take(self, now: float, twist: Twist) -> None:
        """Take the next velocity."""
        self.twist, self.received = twist, now

    def over(self, now: float, timeout: float) -> bool:
        """Whether no velocity came for the timeout."""
        return now - self.received > timeout

    def advance(self, passed: float, hold_direction: bool) -> tuple[Array, Array | None] | None:
        """Return position and direction wanted after some time, None if nothing moves."""
        assert self.twist is not None
        linear, angular = self.twist.linear, self.twist.angular
        if not self.twist.moves:
            return None
        if self.twist.in_tip:
            linear, angular = self.axes @ linear, self.axes @ angular
        self.position = self.position + linear * passed
        self.direction = rotated(self.direction, angular * passed)
        wants_direction = hold_direction or bool(angular.any())
        return self.position, self.direction if wants_direction else None

    def reached(self, shape: Shape) -> None:
        """Learn where the tip can be: what is wanted stays within reach of that."""
        ahead = self.position - shape.tip_position
        distance = float(np.linalg.norm(ahead))
        if distance > LEAD:
            self.position = shape.tip_position + ahead * (LEAD / distance)
        self.axes = shape.frames[-1]


def follow_twist(core: ControllerCore, jog: Jog, passed: float) -> bool:
    """Move the solution on by some time [s]; whether the twist goes on."""
    aim = jog.advance(passed, core.settings.hold_direction)
    if aim is None:  # a zero twist: stop where it is
        return False
    try:
        core.solution = core.solve(Target(*aim))
    except (NoEquilibriumError, InputError) as error:
        core.refusals['target'] = Refusal('no_equilibrium', f'twist ended: {error}')
        return False
    jog.reached(core.solution.shape)
    return True


def rotated(vector: Array, rotation: Array) -> Array:
    """Rotate a unit vector by a rotation vector [rad] (Rodrigues' formula)."""
    angle = float(np.linalg.norm(rotation))
    if angle < 1e-12:
        return vector
    axis = rotation / angle
    turned: Array = (
        vector * np.cos(angle)
        + np.cross(axis, vector) * np.sin(angle)
        + axis * (axis @ vector) * (1.0 - np.cos(angle))
    )
    return turned / np.linalg.norm(turned)
