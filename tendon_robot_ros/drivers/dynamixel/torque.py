"""Torque on without a jump, torque off, and recovery of a servo after an interruption."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from dataclasses import dataclass, field

from ...common.errors import DriverError
from ...common.processes import in_realtime
from .bus import Bus
from .config import DynamixelConfig
from .control_table import (
    REGISTERS,
    WATCHDOG_TRIPPED,
    OperatingMode,
    hardware_errors,
)
from .motor import HEALTH, STATE, Motor
from .settings import must_write, settle

WATCHDOG_S = 0.2  # [s] of silence, because a busy computer is late by as much: docs/safety.md
# [s] of silence where this thread is in real time: four counts, docs/safety.md
WATCHDOG_REALTIME_S = 0.08
# [s] for which a tripped watchdog is a fault, so that a reader of diagnostics sees it
TRIP_REPORTED_S = 0.5
# [s] between two reads of what is not part of the state: a hardware error is noticed in two cycles
# of 100 Hz and no two become due in the same one, so that a cycle has at most one of them
POLL_PERIODS = {
    'hardware_error_status': 0.020,
    'bus_watchdog': 0.045,
    'torque_enable': 0.025,
    'health': 0.250,
}


def watchdog_time(config: DynamixelConfig) -> tuple[float, str]:
    """
    Return after which silence [s] the motors stop by themselves, and why after that.

    Without a time of its own in the configuration it is short only where the calling thread,
    which is to talk to the motors, is in real time: a trip has no ramp.
    """
    if config.watchdog is not None:
        return config.watchdog, 'as configured'
    if in_realtime():
        return WATCHDOG_REALTIME_S, 'default in real time'
    return WATCHDOG_S, 'default without real time; docs/safety.md tells how to get it'


def watchdog_counts(seconds: float) -> int:
    """Return the value of address 98: at least one unit when it is on at all."""
    return min(127, math.ceil(seconds / REGISTERS['bus_watchdog'].unit - 1e-9))


def operating_mode(config: DynamixelConfig, mode: str) -> int:
    """Return the value of address 11."""
    if mode == 'tension':
        return OperatingMode.CURRENT
    return (
        OperatingMode.EXTENDED_POSITION
        if config.operation == 'extended'
        else OperatingMode.CURRENT_BASED_POSITION
    )


def read_state(bus: Bus, motors: Iterable[Motor]) -> None:
    """Read current, velocity and position of several servos."""
    motors = list(motors)
    blocks = bus.block(*STATE, [motor.identity for motor in motors])
    for motor in motors:
        data = blocks.get(motor.identity)
        motor.answers = data is not None
        if data is not None:
            motor.take(data)


def torque_on(bus: Bus, motors: Iterable[Motor], mode: int, watchdog: int) -> None:
    """
    Switch the torque on where the motors are.

    Parameters
    ----------
    bus : Bus
    motors : iterable of Motor
    mode : int
        Operating mode, address 11.
    watchdog : int
        Address 98, in units of 20 ms; 0 = off.

    Raises
    ------
    DriverError
        A hardware error keeps it off, or a servo does not take a value.

    """
    chosen = list(motors)
    for motor in chosen:
        errors = bus.read(motor.identity, 'hardware_error_status')
        if errors:
            words = ', '.join(text for _, text in hardware_errors(errors))
            raise DriverError(f'{bus.path}: {motor}: {words}; remove the cause, then reboot it')
        must_write(bus, motor, 'torque_enable', 0)
        settle(bus, motor, mode)
    read_state(bus, chosen)
    silent = [str(motor) for motor in chosen if not motor.answers]
    if silent:
        raise DriverError(f'{bus.path}: {", ".join(silent)}: no answer; check the cable')
    hold(bus, chosen, mode)
    for motor in chosen:
        must_write(bus, motor, 'torque_enable', 1)
        motor.torque_requested, motor.restarted, motor.tripped = True, False, False
    hold(bus, chosen, mode)
    for motor in chosen:
        must_write(bus, motor, 'bus_watchdog', watchdog)


def hold(bus: Bus, motors: Iterable[Motor], mode: int) -> None:
    """Make the present state the goal: the measured current, or the measured position."""
    chosen = [motor for motor in motors if motor.ticks is not None]
    bounds = {motor.identity: motor.current_bounds for motor in chosen}
    if mode == OperatingMode.CURRENT:
        currents = {motor.identity: motor.current or 0 for motor in chosen}
        bus.send_goals('goal_current', currents, bounds)
        return
    if mode == OperatingMode.CURRENT_BASED_POSITION:
        largest = {identity: high for identity, (_, high) in bounds.items()}
        bus.send_goals('goal_current', largest, bounds)
    ticks = {motor.identity: motor.ticks or 0 for motor in chosen}
    bus.send_goals('goal_position', ticks, {i: (goal, goal) for i, goal in ticks.items()})


def torque_off(bus: Bus, motors: Iterable[Motor]) -> None:
    """Switch the torque off; a servo that does not answer gets two attempts."""
    for motor in motors:
        motor.torque_requested = motor.restarted = motor.tripped = False
        for _ in range(2):
            if bus.write(motor.identity, 'torque_enable', 0) is None:
                break


def come_back(bus: Bus, motor: Motor, mode: int, watchdog: int) -> bool:
    """
    Read the state of a servo after a lost connection, and continue from its position.

    A servo that lost its power stays off: somebody may have used the switch in the motor supply.

    Returns
    -------
    bool
        Whether it answers again.

    """
    number = bus.ping(motor.identity)
    values = (
        [bus.read(motor.identity, name) for name in ('torque_enable', 'bus_watchdog')]
        if number is not None
        else [None]
    )
    if number != motor.model.number or None in values:
        motor.answers = False
        return False
    read_state(bus, [motor])
    torque, state = values
    if not motor.torque_requested:
        if torque:
            torque_off(bus, [motor])
    elif not torque or (watchdog and state == 0):
        lost_power(motor)
        bus.write(motor.identity, 'torque_enable', 0)
    else:
        recover_watchdog(bus, motor, mode, watchdog, tripped=state == WATCHDOG_TRIPPED)
    return motor.answers


def lost_power(motor: Motor) -> None:
    """Note that a servo lost its torque by itself; its count of turns is unknown now."""
    motor.restarted, motor.torque_requested, motor.zero = True, False, None


def recover_watchdog(bus: Bus, motor: Motor, mode: int, watchdog: int, tripped: bool) -> None:
    """Clear a tripped watchdog, hold what is measured now, and arm it again."""
    if tripped:
        bus.write(motor.identity, 'bus_watchdog', 0)
    hold(bus, [motor], mode)
    if tripped:
        bus.write(motor.identity, 'bus_watchdog', watchdog)
    motor.tripped = False


@dataclass
class Watch:
    """
    Polls of registers beside the state, one kind per cycle, whichever is most overdue.

    The alert bit of a status packet is hidden in group reads, so hardware errors are read from
    address 70. A bad value is read once more before anything follows from it: a late answer of
    another read may look like it.
    """

    bus: Bus
    mode: int  # operating mode, address 11
    watchdog: int = 0  # address 98
    due: dict[str, float] = field(default_factory=dict)
    tripped: list[Motor] = field(default_factory=list)  # whose watchdog had tripped at this poll
    _reported: float = -math.inf

    def poll(self, motors: list[Motor], now: float) -> None:
        """Do the most overdue poll, if any, for the servos that answer."""
        self.tripped = []
        for motor in motors:
            motor.tripped = motor.tripped and now - self._reported < TRIP_REPORTED_S
        late = {name: now - self.due.get(name, 0.0) for name in POLL_PERIODS}
        name = max(late, key=lambda n: late[n] / POLL_PERIODS[n])
        if late[name] < 0.0 or not motors:
            return
        self.due[name] = now + POLL_PERIODS[name]
        register = REGISTERS.get(name)  # or health: several in a row
        where = HEALTH if register is None else (register.address, register.size)
        blocks = self.bus.block(*where, [motor.identity for motor in motors])
        for motor in motors:
            data = blocks.get(motor.identity)
            if data is None:
                motor.answers = False  # read twice already
            elif register is None:
                motor.take_health(data)
            else:
                self.check(name, motor, data[0])

    def check(self, register: str, motor: Motor, value: int) -> None:
        """Act on the value of a polled register, if it is bad and another read confirms it."""
        bad = {
            'hardware_error_status': value != motor.errors,
            'bus_watchdog': motor.torque_requested and value != self.watchdog,
            'torque_enable': motor.torque_requested and not value,
        }
        if not bad[register] or self.bus.read(motor.identity, register) != value:
            return
        if register == 'hardware_error_status':
            motor.errors = value
            if value:
                torque_off(self.bus, [motor])
        elif register == 'torque_enable':  # switched off by itself: an error, or the power
            status = self.bus.read(motor.identity, 'hardware_error_status') or 0
            self.check('hardware_error_status', motor, status)
            if not motor.errors:
                lost_power(motor)
        elif value == WATCHDOG_TRIPPED:
            recover_watchdog(self.bus, motor, self.mode, self.watchdog, tripped=True)
            motor.tripped, self._reported = True, time.monotonic()
            self.tripped.append(motor)
        elif value == 0:  # it has forgotten its watchdog
            lost_power(motor)
            self.bus.write(motor.identity, 'torque_enable', 0)
