"""Moving the tip with a velocity."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ..common.errors import TendonRobotError
from ..common.rotations import rotated
from .seeking import question_of
from .state import Controller, Target

if TYPE_CHECKING:
    from ..model.shape import Shape
    from .friction_state import Approach

Array = NDArray[np.float64]
LEAD_MAX_M = 0.002  # [m] how far the wanted tip may be ahead of the reachable one
LATE_MAX_S = 0.05  # [s] by which a slow solution is made up for at once


class Jogger(Controller, Protocol):
    """A controller whose tip a twist may move."""

    jog: Jog | None

    def end_twist(self, jog: Jog, problem: str) -> None:
        """End a twist that leads nowhere."""


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

    position: Array = field(default_factory=lambda: np.full(3, np.nan))
    direction: Array = field(default_factory=lambda: np.full(3, np.nan))
    axes: Array = field(default_factory=lambda: np.eye(3))  # of the tip, as columns
    begun: bool = False  # from a shape
    due: float = 0.0  # [s] by which the wanted tip is to be moved
    twist: Twist | None = None
    received: float = -np.inf

    def begin(self, shape: Shape) -> None:
        """Start at a shape."""
        self.position, self.direction = shape.tip_position.copy(), shape.tip_direction.copy()
        self.axes, self.begun = shape.frames[-1].copy(), True

    def take(self, now: float, twist: Twist) -> None:
        """Take the next velocity."""
        self.twist, self.received = twist, now

    def over(self, now: float, timeout: float) -> bool:
        """Whether no velocity came for the timeout."""
        return now - self.received > timeout

    def advance(self, passed: float, hold_direction: bool) -> tuple[Array, Array | None]:
        """Return position and direction wanted after some time."""
        assert self.twist is not None
        linear, angular = self.twist.linear, self.twist.angular
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
        if distance > LEAD_MAX_M:
            self.position = shape.tip_position + ahead * (LEAD_MAX_M / distance)
        self.axes = shape.frames[-1]


def start_jog(core: Jogger, jog: Jog) -> None:
    """Have the solver say where the tip is."""
    assert core.command is not None
    track = core.track

    def done(shape: Shape | None, error: TendonRobotError | None) -> None:
        if shape is not None:
            track.took(shape)
            jog.begin(shape)
        else:
            core.end_twist(jog, str(error))

    core.solver.post('twist', track.finding(core.command), done)


def follow_twist(core: Jogger, jog: Jog, passed: float) -> bool:
    """Move the solution on by some time [s]; whether the twist goes on."""
    assert jog.twist is not None
    if not jog.twist.moves:
        return False  # stop where it is
    jog.due = min(jog.due + passed, LATE_MAX_S)
    if not jog.begun or core.solver.busy('twist'):
        return True
    position, direction = jog.advance(jog.due, core.settings.hold_direction)
    jog.due = 0.0

    def done(found: Approach | None, error: TendonRobotError | None) -> None:
        if found is None:
            core.end_twist(jog, str(error))
        elif core.jog is jog:
            core.solution = found.reach
            jog.reached(found.reach.shape)

    question = question_of(core, core.model, Target(position, direction), tracking=True)
    core.solver.post('twist', question.answer, done)
    return core.jog is jog
