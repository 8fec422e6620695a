"""What the controller is told (settings, targets, twists, trajectories), and what it gives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ..drivers.safety import bounded
from ..model.pulls import limits_by_pulls
from ..robot.keep_out import KeepOut
from .checks import Refusal
from .solver import GiveUp

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Reach, Shape
    from ..model.tip_task import Preferences
    from .solver import Solver

Array = NDArray[np.float64]
# [s] between targets: faster ones are a path, slower ones set points, because a person sends no
# four in a second
STREAM_PERIOD_S = 0.25


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
    approach: str = 'any'  # one of `approach.APPROACHES`
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

    def same(self, other: Target) -> bool:
        """Whether another one is the same, stamp and all."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return all(np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b for a, b in pairs)


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


@dataclass(frozen=True)
class Trajectory:
    """
    Values (n, m) [N], or [m] in pull mode, at times (n,) [s] since the trajectory came.

    Between the points values go in straight lines. The first leg begins where the command is; when
    the first time is 0 the command goes there at the rate limit. The end is held.
    """

    times: Array
    values: Array
    stamp: str = ''
    began: float = np.inf  # monotonic [s]

    @classmethod
    def checked(
        cls, times: Array, values: Array, limits: Array | None, inputs: tuple[str, ...]
    ) -> Trajectory:
        """
        Refuse a trajectory that cannot be played as it stands.

        Parameters
        ----------
        times : ndarray, shape (n,) [s]
            Since its beginning, growing.
        values : ndarray, shape (n, m) [N] or [m]
            In the order of `inputs`.
        limits : ndarray, shape (m, 2), optional
            Lowest and highest value of each input.
        inputs : tuple of str
            Their names, for the message.

        Raises
        ------
        Refusal

        """
        what = 'tendon_trajectory'
        if not (np.isfinite(times).all() and np.isfinite(values).all()):
            raise Refusal('not_finite', f'{what}: expected finite numbers')
        if times[0] < 0.0 or np.any(np.diff(times) <= 0.0):
            raise Refusal('times', f'{what}: expected times from 0 that grow from point to point')
        if limits is None:
            return cls(times, values)
        outside = (values < limits[:, 0] - 1e-9) | (values > limits[:, 1] + 1e-9)  # rounding
        if outside.any():
            point, column = np.argwhere(outside)[0]
            low, high = limits[column]
            raise Refusal(
                'limits',
                f'{what}: point {point + 1}: {inputs[column]}: expected {low:g} to {high:g} N, '
                f'got {values[point, column]:g}; nothing of it was played',
            )
        return cls(times, bounded(values, limits))

    def begin(self, now: float, here: Array | None) -> Trajectory:
        """Start the clock at a command (m,)."""
        times, values = self.times, self.values
        if times[0] > 0.0 and here is not None:
            times, values = np.concatenate([[0.0], times]), np.vstack([here, values])
        return replace(self, times=times, values=values, began=now)

    def within(self, limits: Array) -> Trajectory:
        """Return the same within the limits (m, 2) [N] of a model that came meanwhile."""
        return replace(self, values=bounded(self.values, limits))

    def at(self, now: float) -> Array:
        """Return the values (m,) that are due."""
        passed = now - self.began
        return np.array([np.interp(passed, self.times, column) for column in self.values.T])

    def over(self, now: float) -> bool:
        """Whether the last point is due."""
        return bool(now - self.began >= self.times[-1])

    def passed(self, now: float) -> float:
        """Return how much of it is played [s]."""
        return float(min(now - self.began, self.times[-1]))


@dataclass(frozen=True)
class Output:
    """A command: tensions (m,) [N] and, in pull mode, the wire pulls (m,) [m] they belong to."""

    tensions: Array
    pulls: Array | None = None


class ShapeTracker:
    """The last shape of the model; each search for an equilibrium starts at the one before."""

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

    def follows(self, now: float) -> bool:
        """Whether the driver follows commands, and was heard lately."""
