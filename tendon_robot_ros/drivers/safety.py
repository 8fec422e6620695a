"""What keeps an arm safe: commands within limits and rates, a stop that latches, the rules."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..common.errors import DriverError
from .interface import MODES

Array = NDArray[np.float64]
STOP_TIME_MIN_S = 0.05  # [s] in which a stop may let go at the soonest
CYCLE_MAX_S = 0.05  # [s]; after a stall the command does not catch up in one step


def approach(current: Array, goal: Array, step: Array) -> Array:
    """
    Move towards a goal on a straight line, no input by more than its step.

    Every input arrives at the same time, so the arm passes through postures between the two.

    Parameters
    ----------
    current, goal : ndarray, shape (m,) [N] or [m]
        Where the command is and where it should go.
    step : ndarray, shape (m,), same unit
        Largest change of each input, >= 0.

    Returns
    -------
    ndarray, shape (m,), same unit
        Between `current` and `goal`.

    """
    way = goal - current
    moving = np.abs(way) > step
    if not moving.any():
        return goal.copy()
    part = float(np.min(step[moving] / np.abs(way[moving])))
    low, high = np.minimum(current, goal), np.maximum(current, goal)
    return np.clip(current + part * way, low, high)


def bounded(command: Array, limits: Array) -> Array:
    """Clip a command, shape (m,), to limits, shape (m, 2)."""
    return np.minimum(np.maximum(command, limits[:, 0]), limits[:, 1])  # np.clip costs more


# -----------------------------------------------------------------------------
# A stop that latches, and that nobody can reset while its cause lasts. Any thread may stop.


class StopLatch:
    """Why there is a stop: a sentence per cause."""

    def __init__(self) -> None:
        """Nothing is stopped."""
        self._latched: dict[str, str] = {}
        self._lasting: set[str] = set()

    def __bool__(self) -> bool:
        """Whether there is a stop."""
        return bool(self._latched)

    @property
    def reasons(self) -> list[str]:
        """One sentence per cause."""
        return list(self._latched.values())

    @property
    def keys(self) -> set[str]:
        """What stopped."""
        return set(self._latched)

    def stop(self, key: str, reason: str, lasting: bool = False) -> None:
        """Latch a stop; while its cause is lasting, `reset` is refused."""
        self._latched[key] = reason
        if lasting:
            self._lasting.add(key)

    def cause_gone(self, key: str) -> None:
        """Say that the cause of a stop is gone; the stop stays latched until `reset`."""
        self._lasting.discard(key)

    def forget(self, key: str) -> None:
        """Take back a stop, for its sender only: people call `reset`."""
        self._latched.pop(key, None)
        self._lasting.discard(key)

    def reset(self) -> None:
        """
        Clear the stops.

        Raises
        ------
        DriverError
            A cause is still there.

        """
        if self._lasting:
            latched = list(self._latched.items())
            reasons = [reason for key, reason in latched if key in self._lasting]
            raise DriverError('reset refused: ' + '; '.join(reasons))
        self._latched.clear()


# -----------------------------------------------------------------------------
# The rules that the supervisor holds, and what it decides in a cycle.


@dataclass(frozen=True)
class SafetyRules:
    """
    Limits of a robot's commands.

    Parameters
    ----------
    inputs : tuple of str, length m
    mode : str
        `tension` [N] or `pull` [m]: the unit of everything below.
    limits : ndarray, shape (m, 2)
    rates : ndarray, shape (m,)
        Largest change per second while following.
    rest : ndarray, shape (m,)
        Where a release goes: pretension, or the wire pulls of the straight arm.
    release_rate : float
        Largest change per second while releasing, unless a stop was asked for.
    stop_time : float
        After a stop was asked for, all is at rest so much later [s]; 0: at the release rate.
    command_timeout : float
        Silence after which the arm is released [s].
    release_to : str
        `pretension`: hold there; `limp`: then torque off.
    tension_limits : tuple of float
        A wire that is measured above the second gets less [N]; a tension that is not observed
        counts as none.
    give_way : float, optional
        In pull mode: what a motor may still pull `stop_time` after a stop was asked for [N];
        None where motors cannot be told.

    """

    inputs: tuple[str, ...]
    mode: str
    limits: Array
    rates: Array
    rest: Array
    release_rate: float
    command_timeout: float = 0.1
    release_to: str = 'pretension'
    stop_time: float = 0.0
    tension_limits: tuple[float, float] = (0.0, np.inf)
    give_way: float | None = None

    def __post_init__(self) -> None:
        """Refuse rules that cannot be held."""
        m = len(self.inputs)
        shapes = [np.shape(a) for a in (self.limits, self.rates, self.rest)]
        if shapes != [(m, 2), (m,), (m,)]:
            raise DriverError(f'safety rules: expected values for {m} inputs, got shapes {shapes}')
        if self.mode not in MODES or self.release_to not in ('pretension', 'limp'):
            raise DriverError(
                f'safety rules: unknown mode or release_to: {self.mode!r}, {self.release_to!r}'
            )
        if not np.all(self.limits[:, 0] < self.limits[:, 1]):
            raise DriverError(f'safety rules: limits: lowest >= highest: {self.limits.tolist()}')
        if not np.all((self.rest >= self.limits[:, 0]) & (self.rest <= self.limits[:, 1])):
            raise DriverError(
                f'safety rules: rest {self.rest.tolist()} is outside the limits '
                f'{self.limits.tolist()}'
            )
        positive = [*self.rates, self.release_rate, self.command_timeout]
        if not (np.all(np.isfinite(positive)) and min(positive) > 0.0):
            raise DriverError('safety rules: rates and command_timeout must be > 0 and finite')
        if not 0.0 <= self.stop_time < np.inf:
            raise DriverError(f'safety rules: stop_time must be >= 0, got {self.stop_time}')
        if self.give_way is not None and not (self.mode == 'pull' and self.give_way >= 0.0):
            raise DriverError(f'safety rules: give_way is for pull mode, >= 0: {self.give_way}')


@dataclass(frozen=True)
class Decision:
    """
    What to do in this cycle.

    Parameters
    ----------
    command : ndarray, shape (m,)
        What to write.
    off : tuple of str
        Inputs whose torque must be off.
    state : str
        `off`, `following`, `releasing`, `released` (at rest, holding), `holding` (its cause ended
        before that) or `limp`.
    reasons : tuple of str
        Why it does not follow, one sentence each.
    clipped : tuple of str
        Inputs whose command was outside the limits.
    weakening : float
        How far motors give way after a stop in pull mode: 0 not at all, 1 to `give_way`.

    """

    command: Array
    off: tuple[str, ...]
    state: str
    reasons: tuple[str, ...] = ()
    clipped: tuple[str, ...] = ()
    weakening: float = 0.0
