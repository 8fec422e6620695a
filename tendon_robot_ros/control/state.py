"""Inputs of the controller (settings, targets, twists, trajectories) and its output."""

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
# [s] between targets: faster ones are a stream, slower ones setpoints, because a person sends less
# than four per second
STREAM_PERIOD_S = 0.25


@dataclass(frozen=True)
class Settings:
    """Settings of the controller; all may change at run time."""

    rate_limit: float = 10.0  # [N/s] of every tension
    state_timeout: float = 0.25  # [s] without tendon states, then the driver is silent
    twist_timeout: float = 0.1  # [s]
    patience: float = 0.5  # [s] without equilibrium, then the arm is released
    hold_direction: bool = False  # keep the approach direction during a twist
    direction_weight: float = 0.0  # [m/rad], 0: a fifth of the robot's length
    pull_mode: bool = False
    tip_gain: float = 0.0  # [1/s] of the integral on the measured tip, 0: open loop
    resume: bool = False  # return to the old target when the driver is back
    approach: str = 'any'  # one of `approach.APPROACHES`
    preferences: Preferences | None = None  # None: low tension, where that is easy
    keep_out: KeepOut = field(default_factory=KeepOut)
    look_ahead: float = 0.0  # [s] by which streamed targets are extrapolated
    drive_lag: float = 0.0  # [s] time constant with which tensions follow the command
    tracker_delay: float = 0.0  # [s] from the exposure of the tracker to its message

    def limits(self, model: Model) -> Array:
        """Return tension limits (m, 2) [N]; in pull mode wires may be slack."""
        return limits_by_pulls(model) if self.pull_mode else model.limits


@dataclass(frozen=True)
class Target:
    """A setpoint of the tip in the base frame: position [m], approach direction, or both."""

    position: Array | None = None
    direction: Array | None = None
    stamp: str = ''  # of its sender, identifies the target

    def same(self, other: Target) -> bool:
        """Whether another target is the same, including its stamp."""
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
        """Whether the velocity is not zero."""
        return bool(self.linear.any() or self.angular.any())


@dataclass(frozen=True)
class Trajectory:
    """
    Values (n, m) [N], or [m] in pull mode, at times (n,) [s] since the start of the trajectory.

    Values are linear between the points. The first leg begins at the present command; with a first
    time of 0 the command moves to the first point at the rate limit. The end is held.
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
        Return a trajectory within the limits; refuse one that cannot be played as it is.

        Parameters
        ----------
        times : ndarray, shape (n,) [s]
            Since its start, increasing.
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

    def begin(self, now: float, command: Array | None) -> Trajectory:
        """Return the trajectory as started now at a command (m,)."""
        times, values = self.times, self.values
        if times[0] > 0.0 and command is not None:
            times, values = np.concatenate([[0.0], times]), np.vstack([command, values])
        return replace(self, times=times, values=values, began=now)

    def within(self, limits: Array) -> Trajectory:
        """Return the trajectory clipped to the limits (m, 2) [N] of a new model."""
        return replace(self, values=bounded(self.values, limits))

    def at(self, now: float) -> Array:
        """Return the values (m,) at a time [s]."""
        passed = now - self.began
        return np.array([np.interp(passed, self.times, column) for column in self.values.T])

    def over(self, now: float) -> bool:
        """Whether the end is reached in time."""
        return bool(now - self.began >= self.times[-1])

    def passed(self, now: float) -> float:
        """Return the played time [s]."""
        return float(min(now - self.began, self.times[-1]))


@dataclass(frozen=True)
class Output:
    """A command: tensions (m,) [N] and, in pull mode, the wire pulls (m,) [m] at them."""

    tensions: Array
    pulls: Array | None = None


class ShapeTracker:
    """The last shape of the model, at which the next search for an equilibrium starts."""

    def __init__(self, model: Model) -> None:
        """Begin with the straight arm."""
        self.model = model
        self.last: Shape | None = None
        self.problem = ''
        self._failed: tuple[float, float] | None = None  # [s] first and last time, in a row

    def shape_work(
        self, tensions: Array, before: Shape | None = None
    ) -> Callable[[GiveUp], Shape]:
        """Return solver work: the shape under tensions (m,) [N] after `before` or the last one."""
        model, before = self.model, before or self.last
        return lambda give_up: model.follow(before, tensions)

    def accept(self, shape: Shape) -> None:
        """Store a new shape."""
        self.last = shape
        self.recovered()

    def recovered(self) -> None:
        """Record that there is an equilibrium."""
        self.problem, self._failed = '', None

    def failed(self, now: float, problem: str) -> None:
        """Record that there is no equilibrium."""
        self.problem = problem
        self._failed = (now if self._failed is None else self._failed[0], now)

    @property
    def failing(self) -> float:
        """Time without an equilibrium [s]."""
        return 0.0 if self._failed is None else self._failed[1] - self._failed[0]


class Controller(Protocol):
    """Read access of modes, searches and the tip loop to the core."""

    model: Model
    settings: Settings
    solver: Solver
    time: float  # [s] of the last cycle
    command: Array | None  # (m,) [N], None before the first measurement
    track: ShapeTracker

    @property
    def target(self) -> Target | None:
        """The current target."""

    @property
    def solution(self) -> Reach | None:
        """The solution for the target, or for the twist."""

    @property
    def desired_tip(self) -> Array | None:
        """Desired position of the tip (3,) [m]: the target, or a point ahead of it in a stream."""

    @property
    def commanded(self) -> Array | None:
        """The last command, (m,) [N], or [m] in pull mode."""

    @property
    def measured_tensions(self) -> Array | None:
        """The measured tensions (m,) [N]; None where they are not observable."""

    @property
    def acting_offset(self) -> Array:
        """Difference (m,) [N] between the estimated and the commanded tensions."""

    @property
    def streaming(self) -> bool:
        """Whether targets follow each other closely."""

    def acting_tensions(self) -> Array:
        """Return the estimated tensions (m,) [N]."""

    def goal(self, tensions: Array) -> Array:
        """Return the tensions (m,) [N] of a solution as the tip loop corrects them."""

    def tip_bias(self, place: Array) -> Array:
        """Return the bias (3,) [m] of the model's tip near a position (3,) [m]."""

    def follows(self, now: float) -> bool:
        """Whether the driver follows commands and its last measurement is recent."""
