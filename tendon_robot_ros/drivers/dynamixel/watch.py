"""
What is polled beside the state, one kind per cycle, whichever is most overdue.

The alert bit of a status packet is hidden in group reads, so hardware errors are read from
address 70. Whatever looks bad is read once more before anybody acts on it: a late answer of
another read may look like it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from .bus import Bus
from .motor import HEALTH, Motor
from .tables import REGISTERS, WATCHDOG_TRIPPED
from .torque import lost_power, recover_watchdog, torque_off


@dataclass
class Watch:
    """The timetable of the polls."""

    bus: Bus
    mode: int  # operating mode, address 11
    watchdog: int  # address 98
    due: dict[str, float] = field(default_factory=dict)
    tripped: list[Motor] = field(default_factory=list)  # whose watchdog this poll found tripped
    _shown: float = -math.inf

    def poll(self, motors: list[Motor], now: float) -> None:
        """Do the most overdue poll, if any, for the servos that answer."""
        self.tripped = []
        for motor in motors:
            motor.tripped = motor.tripped and now - self._shown < SHOWN
        late = {name: now - self.due.get(name, 0.0) for name in PERIODS}
        name = max(late, key=lambda n: late[n] / PERIODS[n])
        if late[name] < 0.0 or not motors:
            return
        self.due[name] = now + PERIODS[name]
        register = REGISTERS.get(name)  # or health: several in a row
        where = HEALTH if register is None else (register.address, register.size)
        found = self.bus.block(*where, [motor.identity for motor in motors])
        for motor in motors:
            data = found.get(motor.identity)
            if data is None:
                motor.answers = False  # asked twice: no need to ask for its state, too
            elif register is None:
                motor.take_health(data)
            else:
                LOOK[name](self, motor, data[0])

    def confirmed(self, motor: Motor, name: str, value: int) -> bool:
        """Read a suspicious value once more."""
        return self.bus.read(motor.identity, name) == value

    def errors(self, motor: Motor, value: int) -> None:
        """Note hardware errors; torque goes off at once for that motor."""
        if value == motor.errors or not self.confirmed(motor, 'hardware_error_status', value):
            return
        motor.errors = value
        if value:
            torque_off(self.bus, [motor])

    def dog(self, motor: Motor, value: int) -> None:
        """Notice a tripped watchdog, and a servo that has forgotten it."""
        if not motor.wanted or value == self.watchdog:
            return
        if not self.confirmed(motor, 'bus_watchdog', value):
            return
        if value == WATCHDOG_TRIPPED:
            recover_watchdog(self.bus, motor, self.mode, self.watchdog, tripped=True)
            motor.tripped, self._shown = True, time.monotonic()
            self.tripped.append(motor)
        elif value == 0:
            lost_power(motor)
            self.bus.write(motor.identity, 'torque_enable', 0)

    def torque(self, motor: Motor, value: int) -> None:
        """Notice torque that went off by itself: by a hardware error, or with the power."""
        if motor.wanted and not value and self.confirmed(motor, 'torque_enable', 0):
            self.errors(motor, self.bus.read(motor.identity, 'hardware_error_status') or 0)
            if not motor.errors:
                lost_power(motor)


SHOWN = 0.5  # [s] for which a tripped watchdog is told of
PERIODS = {
    'hardware_error_status': 0.020,
    'bus_watchdog': 0.045,
    'torque_enable': 0.025,
    'health': 0.250,
}  # [s]
LOOK: dict[str, Callable[[Watch, Motor, int], None]] = {
    'hardware_error_status': Watch.errors,
    'bus_watchdog': Watch.dog,
    'torque_enable': Watch.torque,
}
