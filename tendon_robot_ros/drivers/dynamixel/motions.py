"""
Motions that the driver makes by itself: the search for slack, and a weight for a calibration.

Where the wires begin to pull is found by winding slowly with little current until the motors
stall. All motors wind at the same time, so that the arm stays where it is. A motor of its own
first pays out a little: one that cannot even do that has too little current to overcome its gear,
and its stall would mean nothing. A motor with two wires winds one, then the other; zero is
half-way.

For a calibration a known weight is wound up and let down again at constant speed.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from ...common.errors import DriverError, MovedError
from ...common.processes import ends_between
from ..hardware import READINGS_MIN, STANDING_S
from ..interface import CYCLE_S, travelled
from ..serial_port import HICCUPS_MAX, PortLostError, lost_while
from . import servos
from .bus import Bus
from .config import CurrentPoint, DynamixelConfig
from .control_table import RADIANS_PER_TICK, REGISTERS, Counts, OperatingMode
from .motor import Motor

MODE = OperatingMode.CURRENT_BASED_POSITION
WATCHDOG_COUNTS = servos.watchdog_counts(servos.WATCHDOG_S)
BACK_OFF_M = 0.002  # [m] paid out first, else a blocked motor would seem to have found its wire
TURNING_TIMEOUT_S = 2.0  # [s] without turning, or with too little current, else it would never end
# [1] of the distance at either end that does not count, because there the motor starts, a weight
# lands, and friction may hold the motor short of its goal
END_FRACTION = 0.2


class SlackSearch:
    """The search of one motor: its direction, its goal, and the time that it stands still."""

    def __init__(self, bus: Bus, config: DynamixelConfig, motor: Motor) -> None:
        """Begin where the motor is; give it only the current of the homing tension."""
        self.bus, self.config, self.motor = bus, config, motor
        self.start = motor.ticks or 0
        self.goal = float(self.start)  # ticks
        # ticks; where the first attempt began
        self.origin = self.start - travelled(bus.path).get(motor.identity, 0.0)
        self.direction = motor.wires[0].spool.direction  # +1 or -1, of the ticks
        # ticks behind its goal that show a stall: a motor that follows has no such lag
        self.lag = self.ticks(0.5 * BACK_OFF_M)
        self.backing, self.finished = len(motor.wires) == 1, False
        self.still = 0.0  # [s] for which it has not followed its goal
        self.checked = 0.0  # [s] of `still` at which its watchdog was read
        self.stalls: tuple[int, ...] = ()
        self.missed, self.trips = 0, 0  # answers in a row; trips of its watchdog
        self.stay_near()
        reach = self.ticks(config.home_travel + 2.0 * BACK_OFF_M)
        amperes = max(w.calibration.wind.current(config.home_tension) for w in motor.wires)
        counts = max(1, math.ceil(amperes / motor.model.current_unit))
        bounds = math.ceil(self.origin - reach), math.floor(self.origin + reach)
        motor.guided = (counts, bounds)

    @property
    def middle(self) -> float | None:
        """Ticks of the zero, once all wires have been found."""
        if len(self.stalls) < len(self.motor.wires):
            return None
        return sum(self.stalls) / len(self.stalls)

    def ticks(self, length: float) -> float:
        """Turn a length of wire [m] into ticks."""
        return abs(self.motor.wires[0].spool.ticks(length))

    def cycle(self, passed: float) -> None:
        """Move the goal a little, by what was just read; time [s] has passed."""
        self.missed = 0 if self.motor.answers else self.missed + 1
        if self.missed > HICCUPS_MAX:
            raise DriverError(f'{self.bus.path}: {self.motor}: no answer while looking for slack')
        if self.missed:
            return
        ticks = self.motor.ticks or 0
        if self.backing:
            self.back_off(ticks, passed)
        elif self.middle is not None:  # a motor with two wires comes back half-way
            step = self.ticks(self.config.home_speed * CYCLE_S)
            self.goal += max(-step, min(step, self.middle - self.goal))
            self.finished = abs(ticks - self.middle) < self.lag
        elif self.wind(ticks, passed) and not self.resumed() and self.is_taut():
            self.stalls += (ticks,)
            self.goal, self.still = float(ticks), 0.0
            self.direction = -self.direction

    def back_off(self, ticks: int, passed: float) -> None:
        """Pay out a little; refuse a motor that does not turn."""
        self.goal = self.start - self.direction * self.ticks(BACK_OFF_M)
        if abs(ticks - self.start) >= self.lag:
            self.backing, self.goal, self.still = False, float(ticks), 0.0
            return
        self.still += passed
        if self.still > self.checked + STANDING_S:
            self.checked = self.still
            if self.resumed():
                return
        if self.still > TURNING_TIMEOUT_S:
            amperes = self.motor.current_bounds[1] * self.motor.model.current_unit
            raise DriverError(
                f'{self.bus.path}: {self.motor}: does not turn with {amperes:.3f} A; calibrate '
                f'it, or raise home_tension (now {self.config.home_tension:g} N); torque is off'
            )

    def wind(self, ticks: int, passed: float) -> bool:
        """Move the goal ahead; return whether the motor stays behind it and stands still."""
        step = self.ticks(self.config.home_speed * CYCLE_S)
        ahead = abs(self.goal - ticks)
        self.goal += self.direction * min(step, max(0.0, 2.0 * self.lag - ahead))
        unit = REGISTERS['present_velocity'].unit / RADIANS_PER_TICK
        slow = abs(self.motor.velocity) * unit < 0.1 * step / CYCLE_S + 30.0
        behind = slow and abs(self.goal - ticks) >= self.lag
        self.still = self.still + passed if behind else 0.0
        if self.still > STANDING_S:
            return True
        self.stay_near()
        return False

    def resumed(self) -> bool:
        """
        Return whether a motor stands because its watchdog tripped, and if so let it continue.

        Such a motor has neither found its wire nor is it blocked: this computer was late. Its
        position is known.
        """
        motor = self.motor
        if self.bus.read(motor.identity, 'bus_watchdog') != Counts.WATCHDOG_TRIPPED:
            return False
        self.trips += 1
        if self.trips > HICCUPS_MAX:
            raise MovedError(
                f'{self.bus.path}: {motor}: its bus watchdog stopped it {self.trips} times while '
                'it looked for slack: this computer is late again and again; torque is off'
            )
        servos.recover_watchdog(self.bus, motor, MODE, WATCHDOG_COUNTS, tripped=True)
        self.goal, self.still, self.checked = float(motor.ticks or 0), 0.0, 0.0
        return True

    def stay_near(self) -> None:
        """Refuse to go further than `home_travel`, over all attempts."""
        if abs((self.motor.ticks or 0) - self.origin) > self.ticks(self.config.home_travel):
            raise MovedError(
                f'{self.bus.path}: {self.motor}: no resistance within home_travel = '
                f'{self.config.home_travel:g} m; is the wire on its spool, is direction right? '
                'torque is off'
            )

    def is_taut(self) -> bool:
        """
        Return whether a motor that stands has the current of a taut wire.

        Against a taut wire it draws its current limit, without one only the current of its
        friction. One that stands still with less is held by something else: MovedError.
        """
        motor, half = self.motor, 0.5 * self.config.home_tension
        drawn = self.direction * (motor.current or 0) * motor.model.current_unit
        taut = max(w.calibration.wind.current(half) for w in motor.wires)
        if drawn < taut and self.still > TURNING_TIMEOUT_S:
            raise MovedError(
                f'{self.bus.path}: {motor}: stands still with {drawn:.3f} A, expected more than '
                f'{taut:.3f} A against a taut wire: something else holds it back; does the spool '
                'turn freely, is the supply strong enough? torque is off'
            )
        return drawn >= taut


def find_slack(
    bus: Bus, config: DynamixelConfig, motors: list[Motor], check: Callable[[], None]
) -> None:
    """
    Wind the slack up and set the zero of every motor; torque is off afterwards.

    Raises
    ------
    MovedError
        A motor does not turn, finds no resistance within `home_travel` of where the first
        attempt began, or fails.
    DriverError
        The torque does not come on: nothing has moved.

    """
    servos.read_all(bus, motors)
    searches = [SlackSearch(bus, config, motor) for motor in motors]
    try:
        servos.torque_on(bus, motors, MODE, WATCHDOG_COUNTS)
        try:
            wind_until_taut(bus, config, searches, check)
        except (DriverError, PortLostError) as error:
            raise error if isinstance(error, MovedError) else MovedError(str(error)) from None
    finally:
        end_search(bus, searches)


def wind_until_taut(
    bus: Bus, config: DynamixelConfig, searches: list[SlackSearch], check: Callable[[], None]
) -> None:
    """
    Move all motors until every zero is known.

    A pause of this process counts as one cycle: whether a motor turned meanwhile is not known.
    """
    # a motor with two wires goes to and fro and stalls twice
    remaining = 3.0 * config.home_travel / config.home_speed + 2.0 * TURNING_TIMEOUT_S
    before = time.monotonic()
    while not all(search.finished for search in searches):
        check()
        now = time.monotonic()
        passed, before = min(now - before, 2.0 * CYCLE_S), now
        remaining -= passed
        if remaining < 0.0:
            late = ', '.join(str(search.motor) for search in searches if not search.finished)
            raise DriverError(
                f'{bus.path}: {late}: looking for slack took too long; torque is off'
            )
        servos.read_state(bus, [search.motor for search in searches])
        for search in searches:
            search.cycle(passed)
        servos.send_positions(bus, {search.motor: round(search.goal) for search in searches})
        time.sleep(CYCLE_S)
    for search in searches:
        search.motor.zero = search.middle


def end_search(bus: Bus, searches: list[SlackSearch]) -> None:
    """Torque off; record how far the motors have gone."""
    motors = [search.motor for search in searches]
    try:
        servos.torque_off(bus, motors)
        servos.read_state(bus, motors)
    except PortLostError:  # their watchdogs stop them, at their goals at the latest
        for motor in motors:
            motor.answers = False
    distances = travelled(bus.path)
    for search in searches:
        motor = search.motor
        motor.guided = None
        end = motor.ticks if motor.answers and motor.ticks is not None else search.goal
        distances[motor.identity] = end - search.origin


def wind_weight(
    bus: Bus, motor: Motor, tension: float, travel: float, speed: float
) -> CurrentPoint:
    """
    Wind a hanging weight up and let it down again; torque is off before and after.

    Parameters
    ----------
    bus : Bus
    motor : Motor
        With one wire; the weight stands on the ground and the wire is just taut.
    tension : float
        Weight of what hangs [N].
    travel, speed : float
        How far [m] and how fast [m/s].

    Raises
    ------
    DriverError
        The motor does not answer, does not lift the weight, or does not follow.

    """
    wire = motor.wires[0]
    servos.read_all(bus, [motor])
    start = motor.ticks or 0
    end = start + round(wire.spool.ticks(travel))
    slack = abs(end - start) // 4
    motor.guided = (motor.strongest, (min(start, end) - slack, max(start, end) + slack))
    try:
        with lost_while('calibrating; the bus watchdog stops it'), ends_between() as check:
            try:
                servos.torque_on(bus, [motor], MODE, WATCHDOG_COUNTS)
                up = turn_steadily(bus, motor, end, travel / speed, check)
                down = turn_steadily(bus, motor, start, travel / speed, check)
            finally:
                servos.torque_off(bus, [motor])
    finally:
        motor.guided = None
    return CurrentPoint(tension, up, down)


def turn_to(bus: Bus, motor: Motor, ticks: int) -> None:
    """Send a goal and read what the motor does a period later."""
    servos.send_positions(bus, {motor: ticks})
    time.sleep(CYCLE_S)
    for _ in range(HICCUPS_MAX):
        servos.read_state(bus, [motor])
        if motor.answers:
            return
    raise DriverError(f'{bus.path}: {motor}: no answer while calibrating; torque is off')


def turn_steadily(
    bus: Bus, motor: Motor, end: int, duration: float, check: Callable[[], None]
) -> float:
    """
    Turn to `end` [ticks] in a duration [s]; return the mean current on the steady part [A].

    A process that is late turns it more slowly, instead of skipping readings. Only readings at
    the requested speed count: a motor that stands, because its next goal is late, holds with any
    current up to its friction.
    """
    start, part, before = motor.ticks or 0, 0.0, time.monotonic()
    currents = []
    wire = motor.wires[0]
    ticks = (end - start) / duration  # [1/s]
    speed = ticks * RADIANS_PER_TICK / REGISTERS['present_velocity'].unit  # [counts]
    while part < 1.0:
        check()
        turn_to(bus, motor, round(start + part * (end - start)))
        at_speed = 0.5 < motor.velocity / speed < 1.5
        steady = at_speed and END_FRACTION < part < 1.0 - END_FRACTION
        if steady and motor.current is not None:
            currents.append(wire.spool.direction * motor.current * motor.model.current_unit)
        now = time.monotonic()
        part, before = part + min(now - before, 2.0 * CYCLE_S) / duration, now
    nearest, progress_at = math.inf, time.monotonic()
    while (distance := abs((motor.ticks or 0) - end)) > END_FRACTION * abs(end - start):
        if distance < nearest:
            nearest, progress_at = distance, time.monotonic()
        if time.monotonic() - progress_at < TURNING_TIMEOUT_S:
            check()
            turn_to(bus, motor, end)  # its last goal is an old one where this process was late
            continue
        raise DriverError(
            f'{bus.path}: {motor}: does not follow; is the weight too heavy for '
            f'{motor.strongest * motor.model.current_unit:.2f} A, or blocked?'
        )
    if len(currents) < READINGS_MIN:
        raise DriverError(
            f'{bus.path}: {motor}: only {len(currents)} readings; go slower or further'
        )
    return float(np.mean(currents))
