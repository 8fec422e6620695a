"""Dynamixel servos behind the driver interface: fails safe, comes back from where the arm is."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

import numpy as np

from ...exceptions import DriverError
from ...robot import Robot
from ..interface import Array, Driver, Fault, Reading
from ..limits import approach, bounded
from .bus import Bus, PortLostError
from .config import Config, limits, read_config
from .facts import facts, reading
from .handshake import shake_hands
from .homing import find_slack
from .motor import Motor, make_motors
from .port import check_latency
from .torque import (
    come_back,
    operating_mode,
    read_state,
    torque_off,
    torque_on,
    watchdog_counts,
)
from .watch import Watch

LONGEST_STEP = 0.1  # [s]; after a pause the command does not catch up
RETRY = 0.2  # [s] between two attempts to get a port or a servo back
REBOOT_TIME = 2.0  # [s]


class DynamixelDriver(Driver):
    """
    Drives the wires of a robot with Dynamixel servos.

    Attributes
    ----------
    cancelled : callable
        Asked while `enable` looks for slack; a true answer ends it.

    """

    def __init__(self, robot: Robot, config: Config, mode: str) -> None:
        """Take robot, checked configuration, and `tension` or `pull`."""
        self.robot, self.inputs, self.mode, self.config = robot, robot.inputs, mode, config
        self.limits, self.rates = limits(config, robot, mode)
        self.motors = make_motors(config, mode)
        self.bus = Bus(config.port, config.baud, config.answer_time)
        self.cancelled: Callable[[], bool] = lambda: False
        self._operating = operating_mode(config, mode)
        self._watchdog = watchdog_counts(config)
        self._watch = Watch(self.bus, self._operating, self._watchdog)
        self._latency: int | None = None
        self._is_open = False
        self._lost: list[Motor] = []
        self._turn = 0
        self._goal = np.zeros(len(self.inputs))
        self._written = self._retried = time.monotonic()
        observable = config.allow_coarse or mode == 'tension'
        self._observable = np.array([observable or not w.resolution.coarse for w in config.wires])

    @classmethod
    def from_config(
        cls, robot: Robot, config: Mapping[str, Any], *, mode: str, source: str
    ) -> Self:
        """Make the driver from what its configuration file says."""
        return cls(robot, read_config(robot, config, mode, source), mode)

    def open(self) -> None:
        """Open the port for this process alone and check every servo."""
        self._latency = check_latency(self.config.port, self.config.allow_latency)
        if self._latency is not None:
            self.bus.answer_time = self.config.answer_time + 2e-3 * self._latency
        self.bus.open()
        try:
            shake_hands(self.bus, self.config, self.motors)
            read_state(self.bus, self.motors.values())
        except (DriverError, PortLostError) as error:
            self.bus.close()
            raise DriverError(str(error)) from None
        self._zero_here()
        self._is_open = True

    def close(self) -> None:
        """Give the port back."""
        self._is_open = False
        self.bus.close()

    def enable(self) -> None:
        """Torque on where the arm is; with `zero: find`, wind up the slack first."""
        self._must_be_open('enable')
        motors = list(self.motors.values())
        try:
            if self.config.zero == 'find' and any(motor.zero is None for motor in motors):
                find_slack(self.bus, self.config, motors, self.cancelled)
            torque_on(self.bus, motors, self._operating, self._watchdog)
        except (DriverError, PortLostError) as error:
            self.disable()
            raise DriverError(str(error)) from None
        self._zero_here()
        self._start_from_measured(motors)

    def disable(self, inputs: Sequence[str] = ()) -> None:
        """Torque off at once; a motor that two inputs share goes off with either."""
        chosen = self._chosen(inputs)
        try:
            torque_off(self.bus, chosen)
        except PortLostError:
            for motor in chosen:  # and off when the port comes back
                motor.wanted = motor.restarted = motor.tripped = False

    def reboot(self, inputs: Sequence[str] = ()) -> None:
        """Restart motors after a hardware error; their torque is off and their turns unknown."""
        self._must_be_open('reboot')
        chosen = self._chosen(inputs)
        try:
            torque_off(self.bus, chosen)
            for motor in chosen:
                self.bus.reboot(motor.identity)
                motor.zero = None
            deadline = time.monotonic() + REBOOT_TIME
            waiting = list(chosen)
            while waiting and time.monotonic() < deadline:
                waiting = [m for m in waiting if self.bus.ping(m.identity) is None]
            for motor in chosen:
                motor.errors = self.bus.read(motor.identity, 'hardware_error_status') or 0
            read_state(self.bus, chosen)
            self._zero_here()
        except PortLostError as error:
            raise DriverError(f'{error}: lost while rebooting') from None
        if waiting:
            raise DriverError(
                f'{self.config.port}: no answer after the reboot: {", ".join(map(str, waiting))}'
            )

    def describe(self) -> dict[str, str]:
        """Return facts about bus and servos."""
        return facts(self.bus, self.config, self.motors.values(), self._latency)

    def write(self, command: Array) -> None:
        """Command tensions [N] or pulls [m], shape (m,), kept within limits and rates."""
        self._must_be_open('write')
        wanted = bounded(self.checked(command), self.limits)
        now = time.monotonic()
        step = self.rates * min(now - self._written, LONGEST_STEP)
        self._written = now
        self._goal = approach(self._goal, wanted, step)
        goals, bounds = {}, {}
        for identity, motor in self.motors.items():
            if motor.wanted:
                goals[identity] = motor.goal(
                    [self._goal[self.inputs.index(n)] for n in motor.names]
                )
                bounds[identity] = (
                    motor.current_bounds if self.mode == 'tension' else motor.position_bounds
                )
        name = 'goal_current' if self.mode == 'tension' else 'goal_position'
        try:
            if self.bus.connected:
                self.bus.send_goals(name, goals, bounds)
        except PortLostError:
            pass  # read() says so and tries to get it back

    def read(self) -> Reading:
        """Read every motor; look after errors, watchdogs and what was lost."""
        self._must_be_open('read')
        now = time.monotonic()
        try:
            if self.bus.connected or self._reopened(now):
                self._converse(now)
        except PortLostError:
            pass
        return self._reading(time.monotonic())

    def _converse(self, now: float) -> None:
        there = [motor for motor in self.motors.values() if motor.answers]
        read_state(self.bus, there)
        self._watch.poll([motor for motor in there if motor.answers], now)
        self._start_from_measured(self._watch.tripped)
        before, self._lost = self._lost, [m for m in self.motors.values() if not m.answers]
        if len(self._lost) > len(before):
            self._retried = now  # say so first; looking for it costs time
        elif self._lost and now - self._retried > RETRY:
            self._retried = now
            self._look_for_lost()

    def _look_for_lost(self) -> None:
        """Ask the lost servos, another one first every time, until one is silent."""
        self._turn += 1
        start = self._turn % len(self._lost)
        for motor in self._lost[start:] + self._lost[:start]:
            if not come_back(self.bus, motor, self._operating, self._watchdog):
                return
            self._start_from_measured([motor])

    def _reopened(self, now: float) -> bool:
        """Try to get a lost port back; whoever was lost with it is looked for at once."""
        if now - self._retried < RETRY:
            return False
        self._retried = now
        if not self.bus.reopen():
            return False
        self._retried, self._lost = -np.inf, list(self.motors.values())
        return True

    def _reading(self, now: float) -> Reading:
        faults: tuple[Fault, ...] | None = None
        if not self.bus.connected:
            for motor in self.motors.values():
                motor.answers = False
            gone = f'{self.config.port}: the port is gone; plug the adapter in again'
            faults = (Fault('port', gone),)
        return reading(self.config, self.motors, self._observable, now, faults)

    def _start_from_measured(self, motors: list[Motor]) -> None:
        """Let the next command begin at what these motors measure."""
        for motor in motors:
            for wire in motor.wires:
                value = motor.tension(wire) if self.mode == 'tension' else motor.pull(wire)
                self._goal[self.inputs.index(wire.name)] = value if np.isfinite(value) else 0.0
        self._written = time.monotonic()

    def _zero_here(self) -> None:
        if self.config.zero == 'here':
            for motor in self.motors.values():
                if motor.zero is None and motor.ticks is not None:
                    motor.zero = float(motor.ticks)

    def _chosen(self, inputs: Sequence[str]) -> list[Motor]:
        unknown = [name for name in inputs if name not in self.inputs]
        if unknown:
            raise DriverError(
                f'expected inputs of {", ".join(self.inputs)}, got {", ".join(unknown)}'
            )
        return [
            motor for motor in self.motors.values() if not inputs or set(inputs) & set(motor.names)
        ]

    def _must_be_open(self, what: str) -> None:
        if not self._is_open:
            raise DriverError(f'{self.config.port}: {what}: the driver is not open')
