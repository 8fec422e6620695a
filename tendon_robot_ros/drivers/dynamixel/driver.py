"""Dynamixel servos behind the driver interface; what they say as readings and as text."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...common.errors import DriverError
from ...robot import Robot
from ..hardware import PortDriver
from ..interface import Array, Fault, Reading
from ..ports import PortLostError
from .bus import Bus
from .config import DynamixelConfig, limits, read_config
from .control_table import (
    OperatingMode,
)
from .handshake import second_talker_told, shake_hands
from .homing import find_slack
from .motor import Motor, make_motors
from .port import check_latency
from .torque import (
    Watch,
    come_back,
    operating_mode,
    read_state,
    torque_off,
    torque_on,
    watchdog_counts,
    watchdog_time,
)


def driver_facts(
    bus: Bus, config: DynamixelConfig, motors: Iterable[Motor], latency: int | None
) -> dict[str, str]:
    """Describe port, reading, failures and every servo: names with units to values."""
    out = {
        'port': config.port,
        'baud_rate (1/s)': str(config.baud),
        'latency_timer (s)': '' if latency is None else f'{1e-3 * latency:g}',
        'group read': 'fast sync read' if bus.fast else 'sync read',
        'tension_uncertainty (N)': f'{_doubt(config):.3g}',
    }
    out |= {what: str(count) for what, count in bus.failures.items()}
    for motor in motors:
        out |= {
            f'{motor}: model': motor.model.name,
            f'{motor}: firmware': str(motor.firmware),
            f'{motor}: torque': 'on' if motor.wanted else 'off',
        }
        if motor.temperature is not None:
            out[f'{motor}: temperature (°C)'] = f'{motor.temperature:.0f}'
        if motor.voltage is not None:
            out[f'{motor}: supply (V)'] = f'{motor.voltage:.1f}'
        if motor.settled:
            changed = (f'{name.replace("_", " ")} {how}' for name, how in motor.settled.items())
            out[f'registers of {motor} that were set'] = ', '.join(changed)
        for wire in motor.wires:
            known = 'measured' if wire.calibration.measured else 'data sheet'
            winds, holds = motor.strength(wire)
            out |= {
                f'{wire.name}: tension_per_count (N)': f'{wire.resolution.newtons_per_count:.3g}',
                f'{wire.name}: friction_band (N)': f'{wire.resolution.band:.3g}',
                f'{wire.name}: winds_to (N)': f'{winds:.3g}',
                f'{wire.name}: holds_to (N)': f'{holds:.3g}',
                f'{wire.name}: calibration': known,
            }
    return out


def strength_told(motors: Iterable[Motor]) -> str:
    """Say up to which tension the motors wind and hold their wires, and how to know it better."""
    wires = [(wire, *motor.strength(wire)) for motor in motors for wire in motor.wires]
    weakest, strongest = min(wires, key=lambda w: w[1]), max(wires, key=lambda w: w[2])
    told = (
        f'at their largest current motors wind up to {weakest[1]:.3g} N ({weakest[0].name}) and '
        f'hold up to {strongest[2]:.3g} N ({strongest[0].name}, tension_limit '
        f'{strongest[0].tension_limit:g} N): between them is the friction of the gear'
    )
    assumed = [wire.name for wire, *_ in wires if not wire.calibration.measured]
    if assumed:
        told += f', which is assumed: calibrate {", ".join(assumed)} (docs/dynamixel.md)'
    return told


def _doubt(config: DynamixelConfig) -> float:
    """Return the largest uncertainty of a tension told from current [N]."""
    return max(wire.resolution.band for wire in config.wires)


def driver_reading(
    config: DynamixelConfig,
    motors: Mapping[int, Motor],
    observable: NDArray[np.bool_],
    now: float,
    faults: tuple[Fault, ...],
) -> Reading:
    """
    Put together what was last read.

    Parameters
    ----------
    config : DynamixelConfig
    motors : mapping of id to Motor
    observable : ndarray of bool, shape (m,)
        Inputs whose tension the current shows well enough.
    now : float
        `time.monotonic()` [s].
    faults : tuple of Fault

    """
    pairs = [(motors[wire.motor], wire) for wire in config.wires]
    tensions = np.where(observable, [motor.tension(wire) for motor, wire in pairs], np.nan)
    spread = [
        wire.calibration.uncertainty(t) for (_, wire), t in zip(pairs, tensions, strict=True)
    ]
    pulls = np.array([motor.pull(wire) for motor, wire in pairs])
    return Reading(now, pulls, tensions, 'current', np.array(spread), faults)


# -----------------------------------------------------------------------------
# Dynamixel servos behind the driver interface: fails safe, comes back from where the arm is.

REBOOT_TIME_S = 2.0  # [s]
STRENGTH_REPEATED = 20  # times: nobody acknowledges a goal


class DynamixelDriver(PortDriver):
    """Drives the wires of a robot with Dynamixel servos."""

    config: DynamixelConfig
    link: Bus
    read_config = staticmethod(read_config)

    def __init__(self, robot: Robot, config: DynamixelConfig, mode: str) -> None:
        """Take robot, checked configuration, and `tension` or `pull`."""
        self.bus = Bus(config.port, config.baud, config.answer_time)
        super().__init__(robot, mode, config, self.bus, *limits(config, robot, mode))
        self.motors = make_motors(config, mode)
        self._operating = operating_mode(config, mode)
        self._watch = Watch(self.bus, self._operating)
        self._silence, self._silent_after = 'set when torque comes on', float('nan')  # [s]
        self._latency: int | None = None
        self._lost: list[Motor] = []
        self._turn = 0
        observable = config.allow_coarse or mode == 'tension'
        self.gives_way = self._operating == OperatingMode.CURRENT_BASED_POSITION
        self._strength_due = 0  # times that it is still to be sent
        self._observable = np.array([observable or not w.resolution.coarse for w in config.wires])

    def open(self) -> None:
        """Open the port for this process alone and check every servo."""
        self._latency = check_latency(self.config.port, self.config.allow_latency)
        if self._latency is not None:
            self.bus.answer_time = self.config.answer_time + 2e-3 * self._latency
        super().open()

    def enable(self) -> None:
        """Torque on where the motors are, as strong as they may be."""
        self.weaken(0.0, 0.0)
        super().enable()

    def _shake_hands(self) -> None:
        shake_hands(self.bus, self.config, self.motors)
        read_state(self.bus, self.motors.values())
        self._zero_here()

    def _slack_unknown(self) -> bool:
        return any(motor.zero is None for motor in self.motors.values())

    def _find_slack(self) -> None:
        with second_talker_told(self.bus):
            find_slack(self.bus, self.config, list(self.motors.values()), self.cancelled)

    def _torque_on(self) -> None:
        seconds, why = watchdog_time(self.config)
        self._watch.watchdog = watchdog_counts(seconds)
        self._silence = f'{seconds:g} s ({why})' if seconds else f'off ({why})'
        self._silent_after = seconds
        with second_talker_told(self.bus):
            torque_on(self.bus, list(self.motors.values()), self._operating, self._watch.watchdog)
        self._zero_here()

    def disable(self, inputs: Sequence[str] = ()) -> None:
        """Torque off at once; a motor that two inputs share goes off with either."""
        chosen = self._motors_of(inputs)
        try:
            torque_off(self.bus, chosen)
        except PortLostError:
            for motor in chosen:  # and off when the port comes back
                motor.wanted = motor.restarted = motor.tripped = False

    def reboot(self, inputs: Sequence[str] = ()) -> None:
        """Restart motors after a hardware error; their torque is off and their turns unknown."""
        self._require_open('reboot')
        chosen = self._motors_of(inputs)
        try:
            torque_off(self.bus, chosen)
            for motor in chosen:
                self.bus.reboot(motor.identity)
                motor.zero = None
            deadline = time.monotonic() + REBOOT_TIME_S
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
        facts = driver_facts(self.bus, self.config, self.motors.values(), self._latency)
        return {**facts, 'bus_watchdog (s)': f'{self._silent_after:g}'}

    def strength(self) -> str:
        """Return what current and friction make of the tension limits."""
        return strength_told(self.motors.values())

    def silence(self) -> str:
        """Return what address 98 was set to."""
        return self._silence

    def write(self, command: Array) -> None:
        """Command tensions [N] or pulls [m], shape (m,), kept within limits and rates."""
        self._require_open('write')
        self._goal = self._towards(self.checked(command), self.limits, self._since_write())
        goals, bounds = {}, {}
        for identity, motor in self.motors.items():
            # a silent one may have lost its power and with it its turns: a place would wind it on
            if motor.wanted and (motor.answers or self.mode == 'tension'):
                goals[identity] = motor.goal(
                    [self._goal[self.inputs.index(n)] for n in motor.names]
                )
                bounds[identity] = (
                    motor.current_bounds if self.mode == 'tension' else motor.position_bounds
                )
        name = 'goal_current' if self.mode == 'tension' else 'goal_position'
        try:
            if self.bus.connected:
                self._send_strength()
                self.bus.send_goals(name, goals, bounds)
        except PortLostError:
            pass  # read() says so and tries to get it back

    def weaken(self, share: float, least: float) -> None:
        """Let motors hold less, from what they carry (share 0: their limit) to `least` [N] (1)."""
        if not self.gives_way:
            return
        if share > 0.0 or any(motor.weakened is not None for motor in self.motors.values()):
            self._strength_due = STRENGTH_REPEATED
        for motor in self.motors.values():
            motor.weaken(share, least)

    def _send_strength(self) -> None:
        """Send what the motors may hold while it is less than usual, and for a while after."""
        weak = any(motor.weakened is not None for motor in self.motors.values())
        if weak or self._strength_due > 0:
            motors = [motor for motor in self.motors.values() if motor.wanted]
            bounds = {motor.identity: motor.current_bounds for motor in motors}
            most = {identity: high for identity, (_, high) in bounds.items()}
            self.bus.send_goals('goal_current', most, bounds)
            self._strength_due -= 1

    def read(self) -> Reading:
        """Read every motor; look after errors, watchdogs and what was lost."""
        self._require_open('read')
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
        elif self._lost and self._may_retry(now):
            self._look_for_lost()

    def _look_for_lost(self) -> None:
        """Ask the lost servos, another one first every time, until one is silent."""
        self._turn += 1
        start = self._turn % len(self._lost)
        for motor in self._lost[start:] + self._lost[:start]:
            if not come_back(self.bus, motor, self._operating, self._watch.watchdog):
                return
            self._start_from_measured([motor])

    def _reopened(self, now: float) -> bool:
        """Try to get a lost port back; whoever was lost with it is looked for at once."""
        if not self._may_retry(now) or not self.bus.reopen():
            return False
        self._retried, self._lost = -np.inf, list(self.motors.values())
        return True

    def _reading(self, now: float) -> Reading:
        if self.bus.connected:
            talker = '' if not self._lost else self.bus.disturbed()
            every = (motor.faults(self.config.port, talker) for motor in self.motors.values())
            faults = tuple(fault for some in every for fault in some)
        else:
            for motor in self.motors.values():
                motor.answers = False
            gone = f'{self.config.port}: the port is gone; plug the adapter in again'
            faults = (Fault('port', gone),)
        return driver_reading(self.config, self.motors, self._observable, now, faults)

    def _start_from_measured(self, motors: Iterable[Motor] | None = None) -> None:
        """Let the next command begin at what these motors, or all, measure."""
        for motor in self.motors.values() if motors is None else motors:
            for wire in motor.wires:
                value = motor.tension(wire) if self.mode == 'tension' else motor.pull(wire)
                self._goal[self.inputs.index(wire.name)] = value if np.isfinite(value) else 0.0
        if motors is None:  # the others go on: a stop is not to wait for one that was silent
            self._written = time.monotonic()

    def _zero_here(self) -> None:
        if self.config.zero == 'here':
            for motor in self.motors.values():
                if motor.zero is None and motor.ticks is not None:
                    motor.zero = float(motor.ticks)

    def _motors_of(self, inputs: Sequence[str]) -> list[Motor]:
        names = {
            name for name, named in zip(self.inputs, self._chosen(inputs), strict=True) if named
        }
        return [motor for motor in self.motors.values() if names & set(motor.names)]
