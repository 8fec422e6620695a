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
from dataclasses import dataclass

import numpy as np

from ...common.errors import DriverError, MovedError
from ...common.processes import ends_between
from ..hardware import READINGS_MIN, PortLostError
from ..interface import CYCLE_S, travelled
from .bus import Bus
from .calibration import CurrentPoint
from .config import DynamixelConfig
from .control_table import RADIANS_PER_TICK, REGISTERS, WATCHDOG_TRIPPED, OperatingMode
from .motor import Motor
from .torque import (
    WATCHDOG_S,
    read_state,
    recover_watchdog,
    torque_off,
    torque_on,
    watchdog_counts,
)

MODE = OperatingMode.CURRENT_BASED_POSITION
WATCHDOG_COUNTS = watchdog_counts(WATCHDOG_S)
MISSED_ANSWERS_MAX = 5  # [1] in a row, so that one broken answer ends no motion
BACK_OFF_M = 0.002  # [m] paid out first, else a blocked motor would seem to have found its wire
LAG_MAX_M = 0.5 * BACK_OFF_M  # [m] behind the goal, so that a motor that follows has no such lag
STALLED_S = 0.15  # [s] of standing still against the wire, so that a busy cycle is no stall
TURNING_TIMEOUT_S = 2.0  # [s] without turning, or with too little current, else it would never end
EXTRA_TIME_S = 5.0  # [s] beside three times the distance at `home_speed`, because stalls take time
TRIPS_MAX = 5  # [1] of one motor's watchdog, because a computer so often late is too late
ARRIVAL_TOLERANCE = 0.2  # [1] of the distance, because friction may hold a motor short of its end
# [1] of the speed within which a reading counts, because a motor that stands holds with anything
# up to its friction
SPEED_TOLERANCE = 0.5
STEADY_BEGIN = 0.35  # [1] of the distance from which a reading counts, so that the start is over
STEADY_END = 0.9  # [1] of the distance up to which it counts, because a weight lands at the end


@dataclass
class SlackSearch:
    """The search of one motor: its direction, its goal, and the time that it stands still."""

    motor: Motor
    start: int  # ticks
    origin: float  # ticks; where the first attempt began
    goal: float  # ticks
    direction: int  # +1 or -1, of the ticks
    backing: bool
    still: float = 0.0  # [s] for which it has not followed its goal
    stalls: tuple[int, ...] = ()
    missed: int = 0  # answers in a row
    trips: int = 0  # of its watchdog
    checked: float = 0.0  # [s] of `still` at which its watchdog was read
    finished: bool = False

    @property
    def middle(self) -> float | None:
        """Ticks of the zero, once all wires have been found."""
        if len(self.stalls) < len(self.motor.wires):
            return None
        return sum(self.stalls) / len(self.stalls)

    def ticks(self, length: float) -> float:
        """Turn a length of wire [m] into ticks."""
        return abs(self.motor.wires[0].spool.ticks(length))


def find_slack(
    bus: Bus, config: DynamixelConfig, motors: list[Motor], cancelled: Callable[[], bool]
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
    read_state(bus, motors)
    searches = []
    for motor in motors:
        if motor.ticks is None or not motor.answers:
            raise DriverError(f'{bus.path}: {motor}: no answer; check the cable')
        origin = motor.ticks - travelled(bus.path).get(motor.identity, 0.0)
        alone, spool = len(motor.wires) == 1, motor.wires[0].spool
        search = SlackSearch(motor, motor.ticks, origin, motor.ticks, spool.direction, alone)
        _stay_near(config, search)
        reach = search.ticks(config.home_travel + 2.0 * BACK_OFF_M)
        amperes = max(w.calibration.wind.current(config.home_tension) for w in motor.wires)
        counts = max(1, math.ceil(amperes / motor.model.current_unit))
        motor.guided = (counts, (math.ceil(origin - reach), math.floor(origin + reach)))
        searches.append(search)
    try:
        torque_on(bus, motors, MODE, WATCHDOG_COUNTS)
        try:
            wind_until_taut(bus, config, searches, cancelled)
        except MovedError:
            raise
        except (DriverError, PortLostError) as error:
            raise MovedError(str(error)) from None
    finally:
        end_search(bus, searches)


def wind_until_taut(
    bus: Bus, config: DynamixelConfig, searches: list[SlackSearch], cancelled: Callable[[], bool]
) -> None:
    """
    Move all motors until every zero is known.

    A pause of this process counts as one cycle: whether a motor turned meanwhile is not known.
    """
    remaining = 3.0 * config.home_travel / config.home_speed + EXTRA_TIME_S
    before = time.monotonic()
    while not all(search.finished for search in searches):
        if cancelled():
            raise DriverError(f'{bus.path}: looking for slack was cancelled; torque is off')
        now = time.monotonic()
        passed, before = min(now - before, 2.0 * CYCLE_S), now
        remaining -= passed
        if remaining < 0.0:
            late = ', '.join(str(search.motor) for search in searches if not search.finished)
            raise DriverError(
                f'{bus.path}: {late}: looking for slack took too long; torque is off'
            )
        search_cycle(bus, config, searches, passed)
        time.sleep(CYCLE_S)
    for search in searches:
        search.motor.zero = search.middle


def end_search(bus: Bus, searches: list[SlackSearch]) -> None:
    """Torque off; record the distances of motors whose zero is still unknown."""
    motors = [search.motor for search in searches]
    try:
        torque_off(bus, motors)
        read_state(bus, motors)
    except PortLostError:  # their watchdogs stop them, at their goals at the latest
        for motor in motors:
            motor.torque_requested = motor.answers = False
    distances = travelled(bus.path)
    for search in searches:
        motor = search.motor
        motor.guided = None
        end = motor.ticks if motor.answers and motor.ticks is not None else search.goal
        distances[motor.identity] = end - search.origin
    if all(motor.zero is not None for motor in motors):
        distances.clear()


def search_cycle(
    bus: Bus, config: DynamixelConfig, searches: list[SlackSearch], passed: float
) -> None:
    """Read every motor and move every goal a little."""
    read_state(bus, [search.motor for search in searches])
    for search in searches:
        search.missed = 0 if search.motor.answers else search.missed + 1
        if search.missed > MISSED_ANSWERS_MAX:
            raise DriverError(f'{bus.path}: {search.motor}: no answer while looking for slack')
        if search.missed:
            continue
        ticks = search.motor.ticks or 0
        if search.backing:
            back_off(bus, config, search, passed)
        elif search.middle is not None:  # a motor with two wires comes back half-way
            step = search.ticks(config.home_speed * CYCLE_S)
            search.goal += max(-step, min(step, search.middle - search.goal))
            search.finished = abs(ticks - search.middle) < search.ticks(LAG_MAX_M)
        elif wind(config, search, passed) and not resumed(bus, search) and is_taut(config, search):
            search.stalls += (ticks,)
            search.goal, search.still = float(ticks), 0.0
            search.direction = -search.direction
    goals = {s.motor.identity: round(s.goal) for s in searches}
    bounds = {s.motor.identity: s.motor.position_bounds for s in searches}
    bus.send_goals('goal_position', goals, bounds)


def back_off(bus: Bus, config: DynamixelConfig, search: SlackSearch, passed: float) -> None:
    """Pay out a little; refuse a motor that does not turn."""
    ticks = search.motor.ticks or 0
    search.goal = search.start - search.direction * search.ticks(BACK_OFF_M)
    moved = abs(ticks - search.start)
    if moved >= 0.5 * search.ticks(BACK_OFF_M):
        search.backing, search.goal, search.still = False, float(ticks), 0.0
        return
    search.still += passed
    if search.still > search.checked + STALLED_S:
        search.checked = search.still
        if resumed(bus, search):
            return
    if search.still > TURNING_TIMEOUT_S:
        amperes = (search.motor.guided or (0, (0, 0)))[0] * search.motor.model.current_unit
        raise DriverError(
            f'{config.port}: {search.motor}: does not turn with {amperes:.3f} A; calibrate it, '
            f'or raise home_tension (now {config.home_tension:g} N); torque is off'
        )


def wind(config: DynamixelConfig, search: SlackSearch, passed: float) -> bool:
    """Move the goal ahead; return whether the motor stays behind it and stands still."""
    motor, ticks = search.motor, search.motor.ticks or 0
    lag, step = search.ticks(LAG_MAX_M), search.ticks(config.home_speed * CYCLE_S)
    search.goal += search.direction * min(step, max(0.0, 2.0 * lag - abs(search.goal - ticks)))
    slow = (
        abs(motor.velocity) * REGISTERS['present_velocity'].unit / RADIANS_PER_TICK
        < 0.1 * step / CYCLE_S + 30.0
    )
    behind = slow and abs(search.goal - ticks) >= lag
    search.still = search.still + passed if behind else 0.0
    if search.still > STALLED_S:
        return True
    _stay_near(config, search)
    return False


def resumed(bus: Bus, search: SlackSearch) -> bool:
    """
    Return whether a motor stands because its watchdog tripped, and if so let it continue.

    Such a motor has neither found its wire nor is it blocked: this computer was late. Its
    position is known.
    """
    motor = search.motor
    if bus.read(motor.identity, 'bus_watchdog') != WATCHDOG_TRIPPED:
        return False
    search.trips += 1
    if search.trips > TRIPS_MAX:
        raise MovedError(
            f'{bus.path}: {motor}: its bus watchdog stopped it {search.trips} times while it '
            'looked for slack: this computer is late again and again; torque is off'
        )
    recover_watchdog(bus, motor, MODE, WATCHDOG_COUNTS, tripped=True)
    search.goal, search.still, search.checked = float(motor.ticks or 0), 0.0, 0.0
    return True


def _stay_near(config: DynamixelConfig, search: SlackSearch) -> None:
    """Refuse to go further than `home_travel`, over all attempts."""
    if abs((search.motor.ticks or 0) - search.origin) > search.ticks(config.home_travel):
        raise MovedError(
            f'{config.port}: {search.motor}: no resistance within home_travel = '
            f'{config.home_travel:g} m; is the wire on its spool, is direction right? torque is '
            'off'
        )


def is_taut(config: DynamixelConfig, search: SlackSearch) -> bool:
    """
    Return whether a motor that stands has the current of a taut wire.

    Against a taut wire it draws its current limit, without one only the current of its friction.
    One that stands still with less is held by something else: MovedError.
    """
    motor = search.motor
    drawn = search.direction * (motor.current or 0) * motor.model.current_unit
    taut = max(w.calibration.wind.current(0.5 * config.home_tension) for w in motor.wires)
    if drawn < taut and search.still > TURNING_TIMEOUT_S:
        raise MovedError(
            f'{config.port}: {motor}: stands still with {drawn:.3f} A, expected more than '
            f'{taut:.3f} A against a taut wire: something else holds it back; does the spool '
            'turn freely, is the supply strong enough? torque is off'
        )
    return drawn >= taut


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
    read_state(bus, [motor])
    if motor.ticks is None or not motor.answers:
        raise DriverError(f'{bus.path}: {motor}: no answer; check the cable')
    start = motor.ticks
    end = start + round(wire.spool.ticks(travel))
    slack = abs(end - start) // 4
    motor.guided = (motor.strongest, (min(start, end) - slack, max(start, end) + slack))
    try:
        with ends_between() as check:
            try:
                torque_on(bus, [motor], MODE, WATCHDOG_COUNTS)
                up = turn_steadily(bus, motor, end, travel / speed, check)
                down = turn_steadily(bus, motor, start, travel / speed, check)
            finally:
                torque_off(bus, [motor])
    except PortLostError as error:
        raise DriverError(f'{error}: lost while calibrating; the bus watchdog stops it') from None
    finally:
        motor.guided = None
    return CurrentPoint(tension, up, down)


def turn_to(bus: Bus, motor: Motor, ticks: int) -> None:
    """Send a goal and read what the motor does a period later."""
    bus.send_goals(
        'goal_position', {motor.identity: ticks}, {motor.identity: motor.position_bounds}
    )
    time.sleep(CYCLE_S)
    for _ in range(MISSED_ANSWERS_MAX):
        read_state(bus, [motor])
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
        at_speed = abs(motor.velocity / speed - 1.0) < SPEED_TOLERANCE
        if STEADY_BEGIN < part < STEADY_END and at_speed and motor.current is not None:
            currents.append(wire.spool.direction * motor.current * motor.model.current_unit)
        now = time.monotonic()
        part, before = part + min(now - before, 2.0 * CYCLE_S) / duration, now
    nearest, progress_at = math.inf, time.monotonic()
    while (distance := abs((motor.ticks or 0) - end)) > ARRIVAL_TOLERANCE * abs(end - start):
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
