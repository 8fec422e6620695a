"""What the controller is told and gives: commands, measured states, the shape now."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..common.errors import InputError, NoEquilibriumError
from ..model.pulls import limits_by_pulls
from ..robot.keep_out import KeepOut
from .solver import GiveUp

if TYPE_CHECKING:
    from ..drivers.safety import StopLatch
    from ..model.model import Model
    from ..model.shape import Reach, Shape
    from ..model.tip_task import Preferences
    from .solver import Solver

Array = NDArray[np.float64]
STREAM_PERIOD_S = 0.25  # [s]: targets that come faster are a path, slower ones set points


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
    resume: bool = False  # go to the old target when the driver comes back
    approach: str = 'any'  # one of `friction.APPROACHES`
    preferences: Preferences | None = None  # None: low tension, where that is easy
    keep_out: KeepOut = field(default_factory=KeepOut)
    look_ahead: float = 0.0  # [s] by which targets that follow each other are led
    drive_lag: float = 0.0  # [s] of first order, with which tensions follow the command
    tracker_delay: float = 0.0  # [s] from what a tracker sees to when it is heard

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


# -----------------------------------------------------------------------------
# What the driver last measured, and how long ago that was.


@dataclass
class MeasuredState:
    """Tensions (m,) [N] and wire pulls (m,) [m] as measured, nan where not observable."""

    tensions: Array
    pulls: Array
    time: float  # monotonic [s]

    @property
    def observed(self) -> bool:
        """Whether every tension was."""
        return bool(np.all(np.isfinite(self.tensions)))

    @property
    def located(self) -> bool:
        """Whether every wire pull was."""
        return bool(np.all(np.isfinite(self.pulls)))

    def observed_or(self, unknown: Array) -> Array:
        """Return the measured tensions (m,) [N], or others where they are not observable."""
        return np.maximum(self.tensions, 0.0) if self.observed else unknown

    def complete(self, model: Model, tensions: Array) -> Array:
        """Return the wire pulls (m,) [m]; those of tensions where they are not observable."""
        if self.located:
            return self.pulls
        return np.where(np.isfinite(self.pulls), self.pulls, model.shape(tensions).pulls)

    def in_newtons(
        self, model: Model, limits: Array, guess: Shape | None, unknown: Array
    ) -> Array:
        """Return the tensions (m,) [N] of the wire pulls, or others where none belong to them."""
        if not np.isfinite(self.pulls).any():
            return unknown
        low, high = limits.T
        try:
            shape = model.pull_shape(self.pulls, guess)
            if np.all((shape.inputs >= low) & (shape.inputs <= high)):
                return shape.inputs
            # a slack tendon is below its limit: look for the same pulls within the limits
            start = np.clip(shape.inputs, low + 1e-6, high - 1e-6)
            known = np.isfinite(self.pulls)
            fit = least_squares(
                lambda tensions: 1e3 * (model.shape(tensions).pulls - self.pulls)[known],  # [mm]
                start,
                bounds=(low, high),
                max_nfev=30,
            )
        except (NoEquilibriumError, InputError):
            return unknown
        return np.asarray(fit.x, dtype=float)


# -----------------------------------------------------------------------------
# The shape that the model gives from time to time, and for how long it has given none.


class ShapeTracker:
    """Starts each search for an equilibrium at the one before."""

    def __init__(self, model: Model) -> None:
        """Begin straight."""
        self.model = model
        self.last: Shape | None = None
        self.problem = ''
        self._failed: tuple[float, float] | None = None  # [s] first and last time, in a row

    def finding(self, tensions: Array, before: Shape | None = None) -> Callable[[GiveUp], Shape]:
        """Return how to find the shape under tensions (m,) [N] after another, or the last, one."""
        model, before = self.model, before or self.last
        return lambda give_up: model.follow(before, tensions)

    def took(self, shape: Shape) -> None:
        """Remember a shape."""
        self.last = shape
        self.works()

    def works(self) -> None:
        """Remember that there is an equilibrium."""
        self.problem, self._failed = '', None

    def failed(self, now: float, problem: str) -> None:
        """Remember that there is none."""
        self.problem = problem
        self._failed = (now if self._failed is None else self._failed[0], now)

    @property
    def failing(self) -> float:
        """For how long there has been none [s]."""
        return 0.0 if self._failed is None else self._failed[1] - self._failed[0]


class Controller(Protocol):
    """What modes, searches and the tip loop read of the core; they write nothing of it."""

    model: Model
    settings: Settings
    solver: Solver
    time: float  # [s] of the last cycle
    command: Array | None  # (m,) [N], None until the driver was heard
    driver_stopped: str
    latch: StopLatch
    track: ShapeTracker

    @property
    def target(self) -> Target | None:
        """The target that is followed."""

    @property
    def solution(self) -> Reach | None:
        """The tensions that were found for the target, or for the twist."""

    @property
    def wanted(self) -> Array | None:
        """Where the tip should be, (3,) [m]: at the target, or ahead of it in a stream."""

    @property
    def commanded(self) -> Array | None:
        """What was commanded last, (m,) [N], or [m] in pull mode."""

    @property
    def measured_tensions(self) -> Array | None:
        """The measured tensions (m,) [N]; None where they are not observable."""

    @property
    def acting_offset(self) -> Array:
        """By how much (m,) [N] the tensions that act differ from the commanded ones."""

    @property
    def streaming(self) -> bool:
        """Whether targets follow each other closely."""

    def acting_tensions(self) -> Array:
        """Return the tensions (m,) [N] that act."""

    def goal(self, tensions: Array) -> Array:
        """Return where the tip loop has the goal of tensions (m,) [N] that were found."""

    def tip_bias(self, place: Array) -> Array:
        """Return by how much (3,) [m] the measured tip is off the model near a place (3,) [m]."""

    def fresh(self, now: float) -> bool:
        """Whether the driver was heard lately."""
