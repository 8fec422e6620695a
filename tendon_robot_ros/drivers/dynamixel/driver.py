"""Dynamixel servos behind the driver interface; what they report, as readings and as text."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from itertools import compress

import numpy as np

from ...common.arrays import Floats
from ...common.errors import DriverError
from ...robot import Robot
from ..interface import Fault
from ..serial_port import HICCUPS_MAX, RESTART_TIMEOUT_S, PortDriver, PortLostError, lost_while
from . import servos
from .bus import Bus, check_latency
from .config import DynamixelConfig, read_config
from .control_table import OperatingMode
from .motions import find_slack
from .motor import Motor, make_motors


class DynamixelDriver(PortDriver):
    """Drives the wires of a robot with Dynamixel servos."""

    config: DynamixelConfig
    link: Bus
    read_config = staticmethod(read_config)
    device, source = 'adapter', 'current'

    def __init__(self, robot: Robot, config: DynamixelConfig, mode: str) -> None:
        """Take robot, checked configuration, and `tension` or `pull`."""
        super().__init__(robot, mode, config, config.motors)
        self.link = Bus(config.port, config.baudrate, config.answer_time)
        self.motors = make_motors(config, mode)
        self._operating = servos.operating_mode(config, mode)
        self._watch = servos.Watch(self.link, self._operating)
        self._silence, self._silent_after = 'set when torque comes on', float('nan')  # [s]
        self._latency: int | None = None
        self._lost: list[Motor] = []
        self._next_ping = 0
        self.limits_current = self._operating == OperatingMode.CURRENT_BASED_POSITION
        self._limit_due = 0  # times that the current limit is still to be sent
        observable = config.allow_coarse or mode == 'tension'
        # (motor, wire, whether its tension can be told by the current) of every input
        self._wires = [
            (self.motors[wire.motor], wire, observable or not wire.resolution.coarse)
            for wire in config.motors
        ]

    def open(self) -> None:
        """Open the port for this process alone and check every servo."""
        self._latency = check_latency(self.config.port, self.config.allow_latency)
        if self._latency is not None:
            self.link.answer_time = self.config.answer_time + 2e-3 * self._latency
        super().open()

    def enable(self) -> None:
        """Torque on where the motors are, as strong as they may be."""
        self.limit_current(0.0, 0.0)
        super().enable()

    def _shake_hands(self) -> None:
        servos.shake_hands(self.link, self.config, self.motors)
        servos.read_state(self.link, self.motors.values())
        for motor in self.motors.values():  # anybody may have turned it since it was closed
            motor.zero = None
        self._zero_in_place()

    def _slack_unknown(self) -> bool:
        return any(motor.zero is None for motor in self.motors.values())

    def _find_slack(self) -> None:
        with servos.naming_second_talker(self.link):
            find_slack(self.link, self.config, list(self.motors.values()), self.refuse_cancelled)

    def _torque_on(self) -> None:
        seconds, why = servos.watchdog_time(self.config)
        self._watch.watchdog = servos.watchdog_counts(seconds)
        self._silence = f'{seconds:g} s ({why})' if seconds else f'off ({why})'
        self._silent_after = seconds
        with servos.naming_second_talker(self.link):
            every = self.motors.values()
            servos.torque_on(self.link, every, self._operating, self._watch.watchdog)
        self._zero_in_place()

    def disable(self, inputs: Sequence[str] = ()) -> None:
        """Torque off at once; a motor that two inputs share goes off with either."""
        with suppress(PortLostError):
            servos.torque_off(self.link, self._motors_of(inputs))

    def reboot(self, inputs: Sequence[str] = ()) -> None:
        """Restart motors after a hardware error; their torque is off and their turns unknown."""
        self._require_open('reboot')
        chosen = self._motors_of(inputs)
        with lost_while('rebooting'):
            servos.torque_off(self.link, chosen)
            for motor in chosen:
                self.link.reboot(motor.identity)
                motor.zero = None
            deadline = time.monotonic() + RESTART_TIMEOUT_S
            waiting = list(chosen)
            while waiting and time.monotonic() < deadline:
                waiting = [m for m in waiting if self.link.ping(m.identity) is None]
            for motor in chosen:
                motor.errors = self.link.read(motor.identity, 'hardware_error_status') or 0
            servos.read_state(self.link, chosen)
            self._zero_in_place()
        if waiting:
            raise DriverError(
                f'{self.config.port}: no answer after the reboot: {", ".join(map(str, waiting))}'
            )

    def describe(self) -> dict[str, str]:
        """Return facts about bus and servos: names with units to values."""
        facts = {
            'port': self.config.port,
            'baud_rate (1/s)': str(self.config.baudrate),
            'latency_timer (s)': '' if self._latency is None else f'{1e-3 * self._latency:g}',
            'group read': 'fast sync read' if self.link.fast else 'sync read',
            'tension_uncertainty (N)': f'{max(w.resolution.band for w in self.config.motors):.3g}',
        }
        facts |= {what: str(count) for what, count in self.link.failures.items()}
        for motor in self.motors.values():
            facts |= {
                f'{motor}: model': motor.model.name,
                f'{motor}: firmware': str(motor.firmware),
                f'{motor}: torque': 'on' if motor.torque_requested else 'off',
            }
            if motor.temperature is not None:
                facts[f'{motor}: temperature (°C)'] = f'{motor.temperature:.0f}'
            if motor.voltage is not None:
                facts[f'{motor}: supply (V)'] = f'{motor.voltage:.1f}'
            if motor.settled:
                set_ = (f'{name.replace("_", " ")} {how}' for name, how in motor.settled.items())
                facts[f'registers of {motor} that were set'] = ', '.join(set_)
            for wire in motor.wires:
                known = 'measured' if wire.calibration.measured else 'data sheet'
                per_count, (winds, holds) = wire.resolution.newtons_per_count, motor.strength(wire)
                facts |= {
                    f'{wire.name}: tension_per_count (N)': f'{per_count:.3g}',
                    f'{wire.name}: friction_band (N)': f'{wire.resolution.band:.3g}',
                    f'{wire.name}: winds_to (N)': f'{winds:.3g}',
                    f'{wire.name}: holds_to (N)': f'{holds:.3g}',
                    f'{wire.name}: calibration': known,
                }
        return {**facts, 'bus_watchdog (s)': f'{self._silent_after:g}'}

    def strength(self) -> str:
        """Return as text up to which tension motors wind and hold, and how to calibrate it."""
        motors = self.motors.values()
        wires = [(wire, *motor.strength(wire)) for motor in motors for wire in motor.wires]
        weakest, strongest = min(wires, key=lambda w: w[1]), max(wires, key=lambda w: w[2])
        text = (
            f'at their largest current motors wind up to {weakest[1]:.3g} N ({weakest[0].name}) '
            f'and hold up to {strongest[2]:.3g} N ({strongest[0].name}, tension_limit '
            f'{strongest[0].tension_limit:g} N): between them is the friction of the gear'
        )
        if assumed := [wire.name for wire, *_ in wires if not wire.calibration.measured]:
            text += f', which is assumed: calibrate {", ".join(assumed)} (docs/dynamixel.md)'
        return text

    def silence(self) -> str:
        """Return the time-out of the bus watchdog (address 98) as text."""
        return self._silence

    def _send(self) -> None:
        """Send the goals, and the current limit while it is reduced and for a while after."""
        on = [motor for motor in self.motors.values() if motor.torque_requested]
        if self._limits_reduced() or self._limit_due > 0:
            servos.send_currents(self.link, {motor: motor.current_bounds[1] for motor in on})
            self._limit_due -= 1
        tension = self.mode == 'tension'
        # a silent servo may have lost its power and its count of turns: a position goal would
        # wind it on
        goals = {
            motor: motor.goal([self._goal[self.inputs.index(n)] for n in motor.names])
            for motor in on
            if motor.answers or tension
        }
        send = servos.send_currents if tension else servos.send_positions
        send(self.link, goals)

    def limit_current(self, reduction: float, tension: float) -> None:
        """Reduce the current from what motors carry (0: their limit) to `tension` [N] (1)."""
        if not self.limits_current:
            return
        if reduction > 0.0 or self._limits_reduced():
            self._limit_due = HICCUPS_MAX + 1  # nobody acknowledges it, and so many may be lost
        for motor in self.motors.values():
            motor.limit_current(reduction, tension)

    def _limits_reduced(self) -> bool:
        return any(motor.reduced_limit is not None for motor in self.motors.values())

    def _forget_readings(self) -> None:
        self._lost = list(self.motors.values())
        for motor in self._lost:
            motor.answers = False

    def _faults(self) -> tuple[Fault, ...]:
        talker = self.link.disturbed() if self._lost else ''
        every = (motor.faults(self.port, talker) for motor in self.motors.values())
        return tuple(fault for some in every for fault in some)

    def _tensions(self) -> tuple[Floats, Floats]:
        tensions = [motor.tension(wire) if known else np.nan for motor, wire, known in self._wires]
        doubt = [
            wire.calibration.uncertainty(tension)
            for (_, wire, _), tension in zip(self._wires, tensions, strict=True)
        ]
        return np.array(tensions), np.array(doubt)

    def _pulls(self) -> Floats:
        return np.array([motor.pull(wire) for motor, wire, _ in self._wires])

    def _converse(self, now: float) -> None:
        """Read the state of the motors that answer, poll them, and ping one that is lost."""
        responding = [motor for motor in self.motors.values() if motor.answers]
        servos.read_state(self.link, responding)
        self._watch.poll([motor for motor in responding if motor.answers], now)
        self._resume_from_measured(self._watch.tripped)
        before, self._lost = self._lost, [m for m in self.motors.values() if not m.answers]
        if len(self._lost) > len(before):
            self._retried = now  # report it first; a ping without an answer takes time
        elif self._lost and self._may_retry(now):
            self._next_ping += 1  # a different first servo every time, until one is silent
            start = self._next_ping % len(self._lost)
            for motor in self._lost[start:] + self._lost[:start]:
                if not servos.come_back(self.link, motor, self._operating, self._watch.watchdog):
                    return
                self._resume_from_measured([motor])

    def _resume_from_measured(self, motors: Sequence[Motor]) -> None:
        """Let the next command of these motors begin at what they measure."""
        self._start_from_measured(np.array([motor in motors for motor, *_ in self._wires]))

    def _zero_in_place(self) -> None:
        if self.config.zero == 'here':
            for motor in self.motors.values():
                if motor.zero is None and motor.ticks is not None:
                    motor.zero = float(motor.ticks)

    def _motors_of(self, inputs: Sequence[str]) -> list[Motor]:
        return list(dict.fromkeys(m for m, *_ in compress(self._wires, self._chosen(inputs))))
