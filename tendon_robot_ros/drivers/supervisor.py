"""
What may reach the motors: keeps the rules of safety.py, ramps to pretension. No clock, no threads.

The driver node asks it once per cycle. However wrong the commands are, what comes out stays within
the limits, changes no faster than the rates, and goes to pretension when commands stay away.

Whatever released the arm, commands are followed again only after `resume` (the sender has a new
target), `reset` (a person) or `start`: a cause that comes and goes moves nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..common.errors import DriverError
from .interface import Reading
from .safety import (
    CYCLE_MAX_S,
    STOP_TIME_MIN_S,
    Decision,
    SafetyRules,
    StopLatch,
    approach,
    bounded,
)

Array = NDArray[np.float64]
OFF, FOLLOWING, RELEASING, RELEASED, LIMP = 'off', 'following', 'releasing', 'released', 'limp'
HOLDING = 'holding'  # a release whose cause ended before the arm was at rest
HARDWARE = 'hardware'  # key of a stop that nobody asked for


@dataclass
class Supervisor:
    """The state between two cycles; all times are monotonic seconds given by the caller."""

    rules: SafetyRules
    state: str = OFF
    latch: StopLatch = field(default_factory=StopLatch)
    _output: Array = field(init=False)
    _asked: Array | None = None  # last usable command
    _asked_at: float = -np.inf
    _now: float = -np.inf
    _clipped: tuple[str, ...] = ()
    _tripped: set[str] = field(default_factory=set)  # inputs with a latched hardware error
    _faulty: set[str] = field(default_factory=set)  # inputs with a fault, or in reach of one
    _let_go: str = ''  # why the sender of the commands wants no more of them
    held: str = ''  # why the arm was released, until commands are followed again
    releases: int = 0  # counted since the beginning
    _causes: list[str] = field(default_factory=list)  # of a release, but for silence, last cycle
    _stop_rate: float = 0.0  # of the release since a stop was asked for, 0 before that
    _weakening: float = 0.0  # share by which motors have given way, after a stop in pull mode

    def __post_init__(self) -> None:
        """Start at rest, off."""
        self._output = self.rules.rest.copy()

    def start(self, now: float, reading: Reading) -> None:
        """
        Begin at the measured state, after torque on: no jump.

        Raises
        ------
        DriverError
            Pull mode, and a wire pull is not measured.

        """
        if self.rules.mode == 'pull' and not np.all(np.isfinite(reading.pulls)):
            missing = [
                n
                for n, p in zip(self.rules.inputs, reading.pulls, strict=True)
                if not np.isfinite(p)
            ]
            raise DriverError(f'cannot start: no wire pull measured for {", ".join(missing)}')
        self._output = self._measured(reading, np.zeros(len(self.rules.inputs)))
        self._asked, self._asked_at, self._now = None, now, now
        self._clipped, self._let_go, self._stop_rate = (), '', 0.0
        self._weakening, self.held = 0.0, ''
        self.state = FOLLOWING

    def reset(self) -> None:
        """
        Clear the latched stops; the arm then waits for a new command.

        Raises
        ------
        DriverError
            A cause is still there.

        """
        self.latch.reset()
        self._tripped.clear()
        self._follow_anew()

    def resume(self) -> None:
        """
        Follow commands again after a release: their sender has a new target.

        Raises
        ------
        DriverError
            A cause is still there, or latched.

        """
        if causes := list(dict.fromkeys([*self.latch.reasons, *self._causes])):
            raise DriverError('; '.join(causes))
        self._follow_anew()

    def _hold_back(self, reason: str) -> None:
        """Follow no commands from now on."""
        self.releases += not self.held
        self.held, self._asked = reason, None

    def _follow_anew(self) -> None:
        self._asked, self._let_go, self.held = None, '', ''

    def let_go(self, reason: str) -> None:
        """Release as after a stop; a command that came before counts no more."""
        self._let_go = reason
        self._hold_back(reason)

    def step(self, now: float, command: Array | None, reading: Reading) -> Decision:
        """
        Decide one cycle.

        Parameters
        ----------
        now : float
            Monotonic time [s].
        command : ndarray, shape (m,), optional
            A command that came since the last cycle; values that are not finite count as none.
        reading : Reading
            What the motors last said.

        """
        passed = now - self._now
        passed = min(max(passed, 0.0), CYCLE_MAX_S) if np.isfinite(passed) else 0.0
        self._now = max(now, self._now) if np.isfinite(now) else self._now
        reasons = self._watch(reading) + self.latch.reasons
        self._causes = reasons.copy()
        self._accept(command)
        if self.state == OFF:
            return Decision(self._output.copy(), self.rules.inputs, OFF, tuple(reasons))
        if self._let_go:
            reasons.append(self._let_go)
        silent = self._now - self._asked_at > self.rules.command_timeout
        if silent and not self._let_go:
            reasons.append(f'no command for {self.rules.command_timeout:g} s')
        if (self._causes or self._let_go) or (silent and self._asked is not None):
            self._hold_back('; '.join(dict.fromkeys(reasons)))
        if reasons:
            self._release(passed, reading)
        elif self.held:
            self._hold(passed, reading)
        else:
            self.state, self._stop_rate = FOLLOWING, 0.0
            if self._weakening > 0.0:  # the arm has moved the motors
                self._output, self._weakening = self._measured(reading, self._output), 0.0
            goal = self._output if self._asked is None else self._asked
            self._move(goal, self.rules.rates, passed, reading)
        off = (
            self.rules.inputs
            if self.state == LIMP
            else tuple(name for name in self.rules.inputs if name in self._tripped)
        )
        return Decision(
            self._output.copy(),
            off,
            self.state,
            tuple(dict.fromkeys(reasons)),
            self._clipped,
            self._weakening,
        )

    def _accept(self, command: Array | None) -> None:
        """Take a command, clipped to the limits; of a released arm only that one came."""
        if command is None or not np.isfinite(command).all():
            return
        self._asked_at, self._let_go = self._now, ''
        if self.held or self._causes:
            return
        self._asked = bounded(command, self.rules.limits)
        outside = np.abs(command - self._asked) > 1e-9
        self._clipped = ()
        if outside.any():
            self._clipped = tuple(
                name for name, bad in zip(self.rules.inputs, outside, strict=True) if bad
            )

    def _watch(self, reading: Reading) -> list[str]:
        """Latch hardware errors; after a lost connection begin again at the measured state."""
        reasons = [fault.message for fault in reading.faults]
        self.latch.cause_gone(HARDWARE)
        for fault in reading.faults:
            if fault.hardware:
                self._tripped.update(fault.inputs or self.rules.inputs)
                self.latch.stop(HARDWARE, fault.message, lasting=True)
        faulty = {name for fault in reading.faults for name in fault.inputs or self.rules.inputs}
        if (back := self._faulty - faulty) and self.state not in (OFF, LIMP):
            measured = self._measured(reading, self._output)
            if self._stop_rate > 0.0:  # a hiccup of the bus makes no tension rise again
                measured = np.minimum(measured, self._output)
            again = np.array([name in back for name in self.rules.inputs])
            self._output = np.where(again, measured, self._output)
        self._faulty = faulty
        return reasons

    def _hold(self, passed: float, reading: Reading) -> None:
        """Stay where the end of the cause found the arm."""
        if self.state == LIMP:
            return
        at_rest = np.allclose(self._output, self.rules.rest, atol=1e-12)
        self.state = RELEASED if at_rest else HOLDING
        self._move(self._output, self.rules.rates, passed, reading)

    def _release(self, passed: float, reading: Reading) -> None:
        if self.state == LIMP:
            return
        before = self._output
        rate = self.rules.release_rate
        if self._let_go or self.latch.keys - {HARDWARE}:
            if self.rules.give_way is None:
                rate = self._stopping(rate)
            else:
                self._give_way(passed)
        rates = np.full(len(self.rules.inputs), rate)
        self._move(self.rules.rest, rates, passed, reading)
        arrived = np.allclose(self._output, self.rules.rest, atol=1e-12)
        held = passed > 0.0 and np.array_equal(before, self._output)
        self.state = RELEASING
        if arrived or held:
            self.state = LIMP if self.rules.release_to == 'limp' else RELEASED

    def _give_way(self, passed: float) -> None:
        """
        Weaken the motors in `stop_time`; the arm takes from them the wire that it was bent by.

        Paid out faster than the arm takes it, wire would leave the spool. What the bend has drawn
        out is wound again: there is no strength behind it.
        """
        time = self.rules.stop_time
        self._weakening = min(1.0, self._weakening + (passed / time if time > 0.0 else 1.0))
        rates = np.maximum(self.rules.rates - self.rules.release_rate, 0.0)  # that comes on top
        wound = np.minimum(self.rules.rest, self._output + rates * passed)
        self._output = np.maximum(self._output, wound)

    def _stopping(self, rate: float) -> float:
        """Return the rate that lets go in `stop_time`, from where the stop found the arm."""
        if self._stop_rate == 0.0:
            far = float(np.abs(self._output - self.rules.rest).max())
            time = self.rules.stop_time
            self._stop_rate = max(rate, far / time if time > 0.0 else 0.0)
        return self._stop_rate

    def _move(self, goal: Array, rate: Array, passed: float, reading: Reading) -> None:
        """
        Approach a goal; where a wire pulls more than its limit, give it less at once.

        What the sensor does not know says nothing: only what the tension less its standard
        uncertainty is above the limit counts. A tension falls by that, cycle after cycle, no
        faster than a stop lets go; a pull by its step.

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

    def _measured(self, reading: Reading, unknown: Array) -> Array:
        """Where the motors are now, as a command; `unknown` where that is not observable."""
        measured = reading.tensions if self.rules.mode == 'tension' else reading.pulls
        known = np.where(np.isfinite(measured), measured, unknown)
        if self.rules.mode == 'tension':
            return np.clip(known, 0.0, self.rules.limits[:, 1])
        return known
