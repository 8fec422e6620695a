"""
Safety of an arm: rules, a stop that latches, and the supervisor that decides every cycle.

The driver node calls the supervisor once per cycle for the command of the motors; the supervisor
has no clock and no threads. Whatever commands it receives, its output stays within the limits,
changes no faster than the rates, and goes to pretension when no commands arrive.

After any release, commands are followed again only after `resume` (the sender has a new target),
`reset` (a person) or `start`: an intermittent cause moves nothing.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from itertools import compress
from typing import NamedTuple

import numpy as np

from ..common.arrays import Floats
from ..common.errors import DriverError
from .interface import MODES, Reading

OFF, FOLLOWING, RELEASING, RELEASED, LIMP = 'off', 'following', 'releasing', 'released', 'limp'
HOLDING = 'holding'  # a release whose cause ended before the arm was at rest
HARDWARE = 'hardware'  # key of a stop that nobody requested
CYCLE_MAX_S = 0.05  # [s] after a longer cycle the command does not catch up, else it would jump
STOP_TIME_MIN_S = CYCLE_MAX_S  # in which a stop may let go at the soonest: not in one step either


def approach(current: Floats, goal: Floats, step: Floats) -> Floats:
    """
    Move towards a goal on a straight line, no input by more than its step.

    Every input arrives at the same time, so the arm passes through postures between the two.

    Parameters
    ----------
    current, goal : ndarray, shape (m,) [N] or [m]
        Present command and goal.
    step : ndarray, shape (m,), same unit
        Largest change of each input, >= 0.

    Returns
    -------
    ndarray, shape (m,), same unit
        Between `current` and `goal`.

    """
    change = goal - current
    moving = np.abs(change) > step
    if not moving.any():
        return goal.copy()
    part = float(np.min(step[moving] / np.abs(change[moving])))
    low, high = np.minimum(current, goal), np.maximum(current, goal)
    return np.clip(current + part * change, low, high)


def bounded(command: Floats, limits: Floats) -> Floats:
    """Clip a command, shape (m,), to limits, shape (m, 2)."""
    return np.minimum(np.maximum(command, limits[:, 0]), limits[:, 1])  # np.clip costs more


class StopLatch:
    """
    A stop that latches and cannot be reset while its cause lasts; any thread may stop.

    It holds one sentence per cause.
    """

    def __init__(self) -> None:
        """Start without a stop."""
        self._latched: dict[str, str] = {}
        self._lasting: set[str] = set()
        self._lock = threading.RLock()  # a stop may come in a signal, in the middle of `reset`

    def __bool__(self) -> bool:
        """Whether there is a stop."""
        return bool(self._latched)

    @property
    def reasons(self) -> list[str]:
        """One sentence per cause."""
        return list(self._latched.values())

    @property
    def keys(self) -> set[str]:
        """Keys of the latched causes."""
        return set(self._latched)

    def stop(self, key: str, reason: str, lasting: bool = False) -> None:
        """Latch a stop; while its cause is lasting, `reset` is refused."""
        with self._lock:
            if lasting:
                self._lasting.add(key)
            self._latched[key] = reason  # last, so that `reset` does not clear it as ended

    def cause_removed(self, key: str) -> None:
        """Note that the cause of a stop is removed; the stop stays latched until `reset`."""
        self._lasting.discard(key)

    def forget(self, key: str) -> None:
        """Withdraw a stop, for its sender only: people call `reset`."""
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
        with self._lock:
            latched = list(self._latched.items())  # a signal may latch more meanwhile
            if self._lasting:
                reasons = [reason for key, reason in latched if key in self._lasting]
                raise DriverError('reset refused: ' + '; '.join(reasons))
            for key, _ in latched:
                self._latched.pop(key, None)


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
        Goal of a release: pretension, or the wire pulls of the straight arm.
    release_rate : float
        Largest change per second while releasing, unless a stop was requested.
    stop_time : float
        Time after a request to stop until all is at rest [s]; 0: at the release rate.
    command_timeout : float
        Silence after which the arm is released [s].
    release_to : str
        `pretension`: hold there; `limp`: then torque off.
    tension_limits : tuple of float
        The tension of a wire that is measured above the second is reduced [N]; a tension that is
        not observed counts as 0.
    stop_tension : float, optional
        In pull mode: largest tension `stop_time` after a requested stop [N]; None where the
        current of the motors cannot be limited.

    """

    inputs: tuple[str, ...]
    mode: str
    limits: Floats
    rates: Floats
    rest: Floats
    release_rate: float
    command_timeout: float = 0.1
    release_to: str = 'pretension'
    stop_time: float = 0.0
    tension_limits: tuple[float, float] = (0.0, np.inf)
    stop_tension: float | None = None

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
        tension = self.stop_tension
        if tension is not None and not (self.mode == 'pull' and tension >= 0.0):
            raise DriverError(f'safety rules: stop_tension is for pull mode, >= 0: {tension}')


class Decision(NamedTuple):
    """
    Command and state of one cycle.

    Parameters
    ----------
    command : ndarray, shape (m,)
        Command for the driver [N] or [m].
    off : tuple of str
        Inputs whose torque must be off.
    state : str
        `off`, `following`, `releasing`, `released` (at rest, holding), `holding` (its cause ended
        before that) or `limp`.
    reasons : tuple of str
        Causes of a release, one sentence each.
    clipped : tuple of str
        Inputs whose command was outside the limits.
    current_reduction : float
        Reduction of the motors' current limit after a stop in pull mode: 0 none, 1 to what
        `stop_tension` takes.
    stopped : bool
        Whether a stop is latched.

    """

    command: Floats
    off: tuple[str, ...]
    state: str
    reasons: tuple[str, ...] = ()
    clipped: tuple[str, ...] = ()
    current_reduction: float = 0.0
    stopped: bool = False


class Supervisor:
    """
    Decides the command of the motors in every cycle.

    All times are monotonic seconds given by the caller.
    """

    def __init__(self, rules: SafetyRules) -> None:
        """Start at rest, off."""
        self.rules, self.latch, self.state = rules, StopLatch(), OFF
        self.held = ''  # why the arm was released, until commands are followed again
        self.releases = 0  # counted since the beginning
        self._output = rules.rest.copy()
        self._requested: Floats | None = None  # last usable command
        self._requested_at = self._now = -np.inf
        self._clipped: tuple[str, ...] = ()
        self._tripped: set[str] = set()  # inputs with a latched hardware error
        self._faulty: set[str] = set()  # inputs with a fault, or affected by one
        self._let_go = ''  # reason for which the sender ended its commands
        self._causes: list[str] = []  # of a release, but for silence, last cycle
        self._stop_rate = 0.0  # of the release since a stop was requested, 0 before that
        self._reduction = 0.0  # of the motors' current limit, after a stop in pull mode

    def start(self, now: float, reading: Reading) -> None:
        """
        Start from the measured state, after torque on: no jump.

        Raises
        ------
        DriverError
            Pull mode, and a wire pull is not measured.

        """
        if self.rules.mode == 'pull' and not np.all(np.isfinite(reading.pulls)):
            missing = ', '.join(compress(self.rules.inputs, ~np.isfinite(reading.pulls)))
            raise DriverError(f'cannot start: no wire pull measured for {missing}')
        self._output = self._measured(reading, np.zeros(len(self.rules.inputs)))
        self._requested, self._requested_at, self._now = None, now, now
        self._clipped, self._let_go, self._stop_rate = (), '', 0.0
        self._reduction, self.held = 0.0, ''
        self.state = FOLLOWING

    def reset(self) -> None:
        """
        Clear the latched stops; the arm then waits for a new command.

        Raises
        ------
        DriverError
            A cause is still there.

        """
        if self.latch:  # no cycle may have seen it
            self._hold_back('; '.join(self.latch.reasons))
        self.latch.reset()
        self._tripped.clear()
        self._clear_command()

    def resume(self) -> None:
        """
        Follow commands again after a release, because their sender has a new target.

        Raises
        ------
        DriverError
            A cause is still there, or latched.

        """
        if causes := list(dict.fromkeys([*self.latch.reasons, *self._causes])):
            raise DriverError('; '.join(causes))
        self._clear_command()

    def _hold_back(self, reason: str) -> None:
        """Ignore commands until `resume`, `reset` or `start`."""
        self.releases += not self.held
        self.held, self._requested = reason, None

    def _clear_command(self) -> None:
        self._requested, self._let_go, self.held = None, '', ''

    def let_go(self, reason: str) -> None:
        """Release as after a stop; earlier commands are discarded."""
        self._let_go = reason
        self._hold_back(reason)

    def step(self, now: float, command: Floats | None, reading: Reading) -> Decision:
        """
        Decide one cycle.

        Parameters
        ----------
        now : float
            Monotonic time [s].
        command : ndarray, shape (m,), optional
            Command that arrived since the last cycle; values that are not finite count as none.
        reading : Reading
            Last reading of the motors.

        """
        passed = now - self._now
        passed = min(max(passed, 0.0), CYCLE_MAX_S) if np.isfinite(passed) else 0.0
        self._now = max(now, self._now) if np.isfinite(now) else self._now
        faults, latched = self._watch(reading), self.latch.reasons
        stopped, self._causes = bool(latched), list(dict.fromkeys(faults + latched))
        self._accept(command)
        inputs, reasons = self.rules.inputs, self._causes.copy()
        if self.state == OFF:
            return Decision(self._output.copy(), inputs, OFF, tuple(reasons), stopped=stopped)
        if self._let_go:
            reasons.append(self._let_go)
        silent = self._now - self._requested_at > self.rules.command_timeout
        if silent and not self._let_go:
            reasons.append(f'no command for {self.rules.command_timeout:g} s')
        causes = tuple(reasons)
        if (self._causes or self._let_go) or (silent and self._requested is not None):
            self._hold_back('; '.join(causes))
        if causes:
            self._release(passed, reading)
        elif self.held:  # hold the command at which the cause ended
            if self.state != LIMP:
                at_rest = np.allclose(self._output, self.rules.rest, atol=1e-12)
                self.state = RELEASED if at_rest else HOLDING
                self._move(self._output, self.rules.rates, passed, reading)
        else:
            self.state, self._stop_rate = FOLLOWING, 0.0
            if self._reduction > 0.0:  # the arm has moved the motors
                self._output, self._reduction = self._measured(reading, self._output), 0.0
            goal = self._output if self._requested is None else self._requested
            self._move(goal, self.rules.rates, passed, reading)
        limp = self.state == LIMP
        off = tuple(name for name in inputs if limp or name in self._tripped)
        state, reduction = self.state, self._reduction
        return Decision(self._output.copy(), off, state, causes, self._clipped, reduction, stopped)

    def _accept(self, command: Floats | None) -> None:
        """Accept a command, clipped to the limits; of a released arm only note its time."""
        if command is None or not np.isfinite(command).all():
            return
        self._requested_at, self._let_go = self._now, ''
        if self.held or self._causes:
            return
        self._requested = bounded(command, self.rules.limits)
        outside = np.abs(command - self._requested) > 1e-9
        self._clipped = tuple(compress(self.rules.inputs, outside))

    def _watch(self, reading: Reading) -> list[str]:
        """Latch hardware errors; after a lost connection start from the measured state."""
        reasons = [fault.message for fault in reading.faults]
        self.latch.cause_removed(HARDWARE)
        for fault in reading.faults:
            if fault.hardware:
                self._tripped.update(fault.inputs or self.rules.inputs)
                self.latch.stop(HARDWARE, fault.message, lasting=True)
        faulty = {name for fault in reading.faults for name in fault.inputs or self.rules.inputs}
        if (back := self._faulty - faulty) and self.state not in (OFF, LIMP):
            measured = self._measured(reading, self._output)
            if self._stop_rate > 0.0:  # a hiccup of the bus makes no tension rise again
                measured = np.minimum(measured, self._output)
            returned = np.array([name in back for name in self.rules.inputs])
            self._output = np.where(returned, measured, self._output)
        self._faulty = faulty
        return reasons

    def _release(self, passed: float, reading: Reading) -> None:
        """Go to rest; after a request to stop within `stop_time`."""
        if self.state == LIMP:
            return
        rules, before, rate = self.rules, self._output, self.rules.release_rate
        if (self._let_go or self.latch.keys - {HARDWARE}) and rules.stop_tension is None:
            if self._stop_rate == 0.0:  # from the command at the time of the stop
                distance = float(np.abs(before - rules.rest).max())
                soon = distance / rules.stop_time if rules.stop_time > 0.0 else 0.0
                self._stop_rate = max(rate, soon)
            rate = self._stop_rate
        elif self._let_go or self.latch.keys - {HARDWARE}:
            self._reduce_current(passed)
        rates = np.full(len(rules.inputs), rate)
        self._move(rules.rest, rates, passed, reading)
        arrived = np.allclose(self._output, rules.rest, atol=1e-12)
        held = passed > 0.0 and np.array_equal(before, self._output)
        self.state = RELEASING
        if arrived or held:
            self.state = LIMP if rules.release_to == 'limp' else RELEASED

    def _reduce_current(self, passed: float) -> None:
        """
        Reduce the current limit in `stop_time`; the bent arm then takes wire from the motors.

        Wire that is paid out faster than the arm takes it would leave the spool. Wire that the
        bend has drawn out is wound again, because the reduced current cannot strain it.
        """
        time = self.rules.stop_time
        self._reduction = min(1.0, self._reduction + (passed / time if time > 0.0 else 1.0))
        rates = np.maximum(self.rules.rates - self.rules.release_rate, 0.0)  # that comes on top
        wound = np.minimum(self.rules.rest, self._output + rates * passed)
        self._output = np.maximum(self._output, wound)

    def _move(self, goal: Floats, rate: Floats, passed: float, reading: Reading) -> None:
        """
        Approach a goal; reduce the tension of a wire above its limit at once.

        Only the excess of the tension minus its standard uncertainty over the limit counts. The
        command of a tension falls by that excess in every cycle, no faster than a stop releases;
        that of a pull falls by its step.

        A slack wire may be paid out further: the arm takes it up as the others bend it, and
        holding it back would strain the wire against them.
        """
        rules, reached = self.rules, approach(self._output, goal, rate * passed)
        high = np.full(len(reached), rules.tension_limits[1])
        less = np.broadcast_to(rate * passed, high.shape)
        if rules.mode == 'tension':
            high = np.minimum(high, rules.limits[:, 1])
        doubt = np.zeros_like(high)
        if reading.tension_sd is not None:  # a geared motor's current says little
            doubt = np.nan_to_num(reading.tension_sd)
        beyond = np.nan_to_num(reading.tensions - doubt - high)
        if rules.mode == 'tension':
            stop = np.ptp(rules.limits, axis=1) / max(rules.stop_time, STOP_TIME_MIN_S)
            less = np.minimum(beyond, stop * passed)
        reached = np.where(beyond > 0.0, np.minimum(reached, self._output - less), reached)
        self._output = np.maximum(reached, np.minimum(self._output, rules.limits[:, 0]))

    def _measured(self, reading: Reading, unknown: Floats) -> Floats:
        """Return the measured state as a command; `unknown` where it is not observable."""
        measured = reading.tensions if self.rules.mode == 'tension' else reading.pulls
        known = np.where(np.isfinite(measured), measured, unknown)
        if self.rules.mode == 'tension':
            return np.clip(known, 0.0, self.rules.limits[:, 1])
        return known
