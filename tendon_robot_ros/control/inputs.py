"""Inputs of the controller: settings, targets, twists, trajectories; checks of messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..common.arrays import Floats, interpolated
from ..common.errors import InputError
from ..common.rotations import from_quaternion
from ..common.words import LISTED_MAX, NAME_LENGTH_MAX
from ..drivers.safety import bounded
from ..model.tip_task import Preferences
from ..robot import Robot
from ..robot.keep_out import KeepOut

# [s] between targets: faster ones are a stream, slower ones setpoints, because a person sends less
# than four per second
STREAM_PERIOD_S = 0.25


class Refusal(InputError):
    """A message is refused; `code` is short and stable, for programs."""

    def __init__(self, code: str, message: str) -> None:
        """Store the code beside the sentence."""
        self.code = code
        super().__init__(message)


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
    approach: str = 'any'  # one of `APPROACHES`
    preferences: Preferences | None = None  # None: low tension, where that is easy
    keep_out: KeepOut = field(default_factory=KeepOut)
    look_ahead: float = 0.0  # [s] by which streamed targets are extrapolated
    drive_lag: float = 0.0  # [s] time constant with which tensions follow the command
    tracker_delay: float = 0.0  # [s] from the exposure of the tracker to its message


@dataclass(frozen=True)
class Target:
    """A setpoint of the tip in the base frame: position [m], approach direction, or both."""

    position: Floats | None = None
    direction: Floats | None = None
    stamp: str = ''  # of its sender, identifies the target

    def same(self, other: Target) -> bool:
        """Whether another target is the same, including its stamp."""
        return all(map(np.array_equal, vars(self).values(), vars(other).values()))


@dataclass(frozen=True)
class Twist:
    """A velocity of the tip [m/s] and [rad/s], in base axes or in those of the tip."""

    linear: Floats
    angular: Floats
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

    times: Floats
    values: Floats
    stamp: str = ''
    began: float = np.inf  # monotonic [s]

    @classmethod
    def checked(
        cls, times: Floats, values: Floats, limits: Floats | None, inputs: tuple[str, ...]
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

    def begin(self, now: float, command: Floats | None) -> Trajectory:
        """Return the trajectory as started now at a command (m,)."""
        times, values = self.times, self.values
        if times[0] > 0.0 and command is not None:
            times, values = np.concatenate([[0.0], times]), np.vstack([command, values])
        return replace(self, times=times, values=values, began=now)

    def within(self, limits: Floats) -> Trajectory:
        """Return the trajectory clipped to the limits (m, 2) [N] of a new model."""
        return replace(self, values=bounded(self.values, limits))

    def at(self, now: float) -> Floats:
        """Return the values (m,) at a time [s]."""
        return interpolated(now - self.began, self.times, self.values)

    def passed(self, now: float) -> float:
        """Return the played time [s]."""
        return float(min(now - self.began, self.times[-1]))


@dataclass(frozen=True)
class Output:
    """A command: tensions (m,) [N] and, in pull mode, the wire pulls (m,) [m] at them."""

    tensions: Floats
    pulls: Floats | None = None


def cut(name: str) -> str:
    """Return a name for a message, cut where it gets long."""
    return name if len(name) <= NAME_LENGTH_MAX else f'{name[:NAME_LENGTH_MAX]}...'


def check_stamp(stamp: float, now: float, tolerance: float, what: str) -> None:
    """
    Refuse an old or a future stamp.

    Parameters
    ----------
    stamp, now : float
        Time in the message's header and of this node's clock [s]; a stamp of 0 means now.
    tolerance : float
        Largest difference [s].
    what : str
        Names the message.

    """
    age = now - stamp
    if stamp != 0.0 and abs(age) > tolerance:
        code, when = ('stale', 'old') if age > 0.0 else ('future', 'in the future')
        raise Refusal(
            code,
            f'{what}: stamp is {abs(age):.3g} s {when}, expected at most '
            f'{tolerance:g} s; check clocks, or send stamp 0 for now',
        )


def finite(values: Sequence[float], what: str) -> Floats:
    """Return the values as an array; refuse nan and inf."""
    array = np.array(values, dtype=float)
    if not np.isfinite(array).all():
        raise Refusal('not_finite', f'{what}: expected finite numbers, got {array.tolist()}')
    return array


def position(values: Sequence[float], longest: float, what: str) -> Floats:
    """Return a position [m]; refuse one that is further away than any robot's tip could be."""
    point = finite(values, what)
    if np.linalg.norm(point) > longest:
        raise Refusal(
            'too_far',
            f'{what}: {np.linalg.norm(point):.4g} m from the base, expected '
            f'at most {longest:.4g} m; positions are in metres',
        )
    return point


def direction(quaternion: Sequence[float], what: str) -> Floats:
    """
    Return the +z axis of an orientation, its approach direction; roll is ignored.

    Parameters
    ----------
    quaternion : sequence of 4 float
        x, y, z, w; its norm may be off by 1 %.
    what : str
        Names the message.

    """
    x, y, z, w = finite(quaternion, what)
    norm = float(np.sqrt(x * x + y * y + z * z + w * w))
    if not 0.99 < norm < 1.01:
        raise Refusal(
            'quaternion',
            f'{what}: orientation (x, y, z, w) has norm {norm:.4g}, '
            'expected 1; for a position alone use the point topic',
        )
    return from_quaternion((x / norm, y / norm, z / norm, w / norm))[:, 2]


def by_name(
    names: Sequence[str], values: Sequence[float], inputs: Sequence[str], what: str, quantity: str
) -> Floats:
    """
    Return the values of a joint message in the robot's order.

    Parameters
    ----------
    names, values : sequence
        As in the message.
    inputs : sequence of str
        The robot's inputs: every one of them must be there, once, and nothing else.
    what, quantity : str
        Name the message and its field.

    """
    if tuple(names) == tuple(inputs) and len(values) == len(names):
        return np.array(values, dtype=float)  # the usual case
    unknown = [name for name in names if name not in inputs]
    missing = [name for name in inputs if name not in names]
    if unknown or missing or len(names) != len(inputs):
        problem = 'a name stands twice'
        if unknown:
            more = len(unknown) - LISTED_MAX
            problem = f'unknown {", ".join(map(cut, unknown[:LISTED_MAX]))}'
            problem += f' and {more} more' if more > 0 else ''
        elif missing:
            problem = f'missing {", ".join(missing)}'
        raise Refusal('names', f'{what}: {problem}; expected {", ".join(inputs)}, once each')
    if len(values) != len(names):
        raise Refusal(
            'length', f'{what}: expected {len(names)} values of {quantity}, got {len(values)}'
        )
    at = dict(zip(names, values, strict=True))
    return np.array([at[name] for name in inputs], dtype=float)


def check_inputs(inputs: tuple[str, ...], expected: tuple[str, ...]) -> None:
    """Refuse a model with other inputs than the one in use."""
    if inputs != expected:
        raise InputError(
            f'the new model has the inputs {", ".join(inputs)}, expected {", ".join(expected)}; '
            'restart the node to change them'
        )


def another_robot(robot: Robot, before: Robot) -> bool:
    """Whether a description is of another arm, so that targets in its base frame are void."""
    return robot.name != before.name or not np.isclose(robot.length, before.length, rtol=1e-9)
