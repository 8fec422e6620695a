"""A board with load cells behind the driver interface: it closes the tension loop itself."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np

from ...exceptions import DriverError
from ...robot import Robot
from ..interface import Array, Driver, Reading
from ..limits import approach, bounded
from . import facts, handshake, homing, messages
from .config import Config, limits, read_config
from .link import Link, LinkLostError
from .messages import Telemetry

LONGEST_STEP = 0.1  # [s]; after a pause the command does not catch up
RETRY = 0.2  # [s] between two attempts to get a lost port back
HEARTBEAT = 0.1  # [s]
SILENT = 0.1  # [s] without telemetry
OLD = 0.05  # [s]; after a longer pause what waits in the port is thrown away


class SerialDriver(Driver):
    """
    Drives the wires of a robot with a board that speaks docs/serial_protocol.md.

    Attributes
    ----------
    link : Link
    telemetry : Telemetry or None
        The newest; None while nothing comes.

    """

    def __init__(self, robot: Robot, config: Config, mode: str) -> None:
        """Take robot, checked configuration, and `tension` or `pull`."""
        self.robot, self.inputs, self.mode, self.config = robot, robot.inputs, mode, config
        self.limits, self.rates = limits(config, robot, mode)
        self.link = Link(config.port, config.baud)
        self.telemetry: Telemetry | None = None
        self.places = np.array([tendon.channel for tendon in config.tendons])
        self.identity: messages.Identity | None = None
        self.zero = np.full(len(self.inputs), np.nan)  # [m] on the board where pull is 0
        self.wanted = np.zeros(len(self.inputs), dtype=bool)  # torque should be on
        self.restarted = np.zeros(len(self.inputs), dtype=bool)
        self._tripped = False
        self._is_open = False
        self._goal = np.zeros(len(self.inputs))
        self._written = self._heard = self._read_at = self._retried = -np.inf

    @classmethod
    def from_config(
        cls, robot: Robot, config: Mapping[str, Any], *, mode: str, source: str
    ) -> Self:
        """Make the driver from what its configuration file says."""
        return cls(robot, read_config(robot, config, mode, source), mode)

    def open(self) -> None:
        """Open the port for this process alone, ask who is there, tell it its configuration."""
        self.link.open()
        try:
            self.identity = handshake.identify(self.link, self.config)
            handshake.let_go(self.link, self.identity.channels)
            handshake.ask(self.link, messages.CLEAR, b'\xff')
            self._configure()
            if self._hear(1.0) is None:
                raise DriverError(f'{self.config.port}: no telemetry; check the baud rate')
        except (DriverError, LinkLostError) as error:
            self.link.close()
            raise DriverError(str(error)) from None
        self._zero_here()
        self.restarted[:] = False
        self._is_open = True

    def close(self) -> None:
        """Give the port back; the board releases when it hears nothing."""
        self._is_open = False
        self.link.close()

    def enable(self) -> None:
        """Torque on where the arm is; with `zero: find`, wind up the slack first."""
        self._must_be_open('enable')
        try:
            self._read_again()
            latched = [fault.message for fault in facts.latched(self)]
            if latched:
                raise DriverError('; '.join(latched))
            if self.config.zero == 'find' and not np.isfinite(self.zero).all():
                self.zero = homing.find_slack(self)
                handshake.give_limits(self.link, self.config, self.zero)
            self.switch_on(self.mode)
        except (DriverError, LinkLostError) as error:
            self.disable()
            raise DriverError(str(error)) from None
        self.wanted[:], self.restarted[:] = True, False
        self._start_from_measured()

    def switch_on(self, mode: str) -> None:
        """Torque on in a mode, where the wires are."""
        mask = facts.mask(self.places)
        handshake.ask(self.link, messages.ENABLE, bytes((messages.MODES[mode], mask)))
        self._read_again()

    def disable(self, inputs: Sequence[str] = ()) -> None:
        """Torque off at once."""
        chosen = facts.chosen(self.inputs, inputs)
        self.wanted[chosen] = self.restarted[chosen] = False
        try:
            if self.link.connected:
                content = bytes((facts.mask(self.places[chosen]),))
                handshake.ask(self.link, messages.DISABLE, content, attempts=2)
        except (DriverError, LinkLostError):
            pass  # read() says so, and switches off what came back unwanted

    def reboot(self, inputs: Sequence[str] = ()) -> None:
        """Clear latched faults of motors, after their cause was removed; leaves them off."""
        self._must_be_open('reboot')
        chosen = facts.chosen(self.inputs, inputs)
        self.disable(inputs)
        try:
            content = bytes((facts.mask(self.places[chosen]),))
            handshake.ask(self.link, messages.CLEAR, content)
            self._read_again()
        except LinkLostError as error:
            raise DriverError(f'{error}: lost while clearing faults') from None
        again = [f.message for f in facts.latched(self) if not inputs or f.inputs[0] in inputs]
        if again:
            raise DriverError('; '.join(again))

    def describe(self) -> dict[str, str]:
        """Return facts about board and link."""
        return facts.describe(self)

    def write(self, command: Array) -> None:
        """Command tensions [N] or pulls [m], shape (m,), kept within limits and rates."""
        self._must_be_open('write')
        wanted = bounded(self.checked(command), self.limits)
        now = time.monotonic()
        late = now - self._written > self.config.timeout
        step = self.rates * min(now - self._written, LONGEST_STEP)
        self._written = now
        if late:  # the board may have released meanwhile: read() looks first where the arm is
            return
        self._goal = approach(self._goal, wanted, step)
        try:
            if self.link.connected and self.wanted.any():
                self.command(self.mode, self._goal)
        except LinkLostError:
            pass  # read() says so and tries to get it back

    def command(self, mode: str, goal: Array) -> None:
        """Send one command, shape (m,) [N] or [m], to all channels in one frame."""
        assert self.identity is not None
        values = np.zeros(self.identity.channels)
        values[self.places] = goal if mode == 'tension' else goal + self.zero
        self.link.send(messages.COMMAND, messages.command(mode, values))

    def read(self) -> Reading:
        """Take the newest telemetry; look after silence, restarts and lost ports."""
        self._must_be_open('read')
        now = time.monotonic()
        try:
            if self.link.connected or self._reopened(now):
                self._converse(now)
        except (LinkLostError, DriverError):  # DriverError: it came back and went away again
            self.telemetry = None
        return facts.reading(self, time.monotonic(), self._tripped)

    def _converse(self, now: float) -> None:
        if now - self.link.sent_at > HEARTBEAT:
            self.link.send(messages.HEARTBEAT)
        if now - self._read_at > OLD:
            self.link.flush()
        lost = self.telemetry is None
        found = self._hear(min(3.0 * self.config.period, 0.03))
        self._read_at = time.monotonic()
        if found is None:
            if self._read_at - self._heard > max(SILENT, 5.0 * self.config.period):
                self.telemetry = None
            return
        if not found.flags & messages.CONFIGURED:
            self._come_back()
            found = self.telemetry or found
        enabled = np.array([found.enabled >> i & 1 for i in self.places], dtype=bool)
        healthy = found.faults[self.places] == 0
        self.restarted |= self.wanted & ~enabled & healthy
        self._tripped = bool(found.flags & messages.SILENCE) and bool(self.wanted.any())
        if lost or self._tripped:
            self._start_from_measured()
        if np.any(enabled & ~self.wanted):  # it was switched off while the port was lost
            content = bytes((facts.mask(self.places[enabled & ~self.wanted]),))
            self.link.send(messages.DISABLE, content)

    def _come_back(self) -> None:
        """Tell a board that had no power what it must know; its motors stay off."""
        self.restarted |= self.wanted
        if self.config.zero == 'find':
            self.zero[:] = np.nan
        self._configure()
        self._hear(0.1)

    def _configure(self) -> None:
        handshake.configure(self.link, self.config, np.nan_to_num(self.zero))

    def _hear(self, wait: float) -> Telemetry | None:
        """Take the newest telemetry, None when none came."""
        assert self.identity is not None
        found = handshake.telemetry(self.link, self.identity.channels, wait)
        if found is not None:
            self.telemetry, self._heard = found, time.monotonic()
        return found

    def _read_again(self) -> None:
        """Take telemetry that is newer than what was just asked for."""
        self.link.flush()
        if self._hear(0.5) is None:
            raise DriverError(f'{self.config.port}: no telemetry; check cable and supply')
        self._read_at = time.monotonic()

    def _reopened(self, now: float) -> bool:
        if now - self._retried < RETRY:
            return False
        self._retried = now
        self.telemetry = None
        if not self.link.reopen():
            return False
        self.link.send(messages.HEARTBEAT)
        self._heard = now
        return True

    def _start_from_measured(self) -> None:
        """Let the next command begin at what is measured."""
        value = facts.tensions(self) if self.mode == 'tension' else facts.pulls(self)
        self._goal = np.where(np.isfinite(value), value, self._goal)
        self._written = time.monotonic()

    def _zero_here(self) -> None:
        if self.config.zero == 'here' and self.telemetry is not None:
            measured = self.telemetry.pulls[self.places]
            self.zero = np.where(np.isfinite(self.zero), self.zero, measured)
            handshake.give_limits(self.link, self.config, self.zero)

    def _must_be_open(self, what: str) -> None:
        if not self._is_open:
            raise DriverError(f'{self.config.port}: {what}: the driver is not open')
