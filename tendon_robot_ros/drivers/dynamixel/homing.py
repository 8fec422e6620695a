"""
Find where the wires begin to pull: wind slowly with little current until the motors stall.

All motors wind at the same time, so that the arm stays where it is. A motor of its own first pays
out a little: one that cannot even do that has too little current to overcome its gear, and its
stall would mean nothing. A motor with two wires winds one, then the other; zero is half-way.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from ...common.errors import DriverError, MovedError
from ..ports import PortLostError, travelled
from .bus import Bus
from .config import DynamixelConfig
from .control_table import (
    RADIANS_PER_TICK,
    REGISTERS,
    WATCHDOG_TRIPPED,
    OperatingMode,
)
from .motor import Motor
from .torque import read_state, recover_watchdog, torque_off, torque_on

CYCLE_S = 0.01  # [s]
BACK_OFF_M = 0.002  # [m]
LAG_MAX_M = 0.001  # [m] behind the goal: it does not follow any more
STALLED_AFTER_S = 0.15  # [s]
MISSED_ANSWERS_MAX = 5  # answers in a row
WATCHDOG_COUNTS = 10  # of address 98: 0.2 s
TRIPS_MAX = 5  # of the watchdog of one motor: a computer that is late so often is too late
TURNS_WITHIN_S = 2.0  # [s] or it does not turn
MORE_TIME_S = 5.0  # [s] than three times the way at `home_speed`, for torque on and stalls


@dataclass
class SlackSearch:
    """One motor on its way: which way it winds now and since when it stands still."""

    motor: Motor
    start: int  # ticks
    origin: float  # ticks; where the first attempt began
    goal: float  # ticks
    way: int  # +1 or -1, the direction of the ticks
    backing: bool
    still: float = 0.0  # [s] for which it has not done as told
    stalls: tuple[int, ...] = ()
    missed: int = 0  # answers in a row
    trips: int = 0  # of its watchdog
    asked: float = 0.0  # [s] of `still` at which its watchdog was asked
    done: bool = False

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
    searches = _prepare(bus, config, motors)
    try:
        torque_on(bus, motors, OperatingMode.CURRENT_BASED_POSITION, WATCHDOG_COUNTS)
        try:
            _search(bus, config, searches, cancelled)
        except MovedError:
            raise
        except (DriverError, PortLostError) as error:
            raise MovedError(str(error)) from None
    finally:
        _end(bus, searches)


def _prepare(bus: Bus, config: DynamixelConfig, motors: list[Motor]) -> list[SlackSearch]:
    read_state(bus, motors)
    searches = []
    for motor in motors:
        if motor.ticks is None or not motor.answers:
            raise DriverError(f'{bus.path}: {motor}: no answer; check the cable')
        wire = motor.wires[0]
        alone = len(motor.wires) == 1
        origin = motor.ticks - travelled(bus.path).get(motor.identity, 0.0)
        search = SlackSearch(
            motor, motor.ticks, origin, motor.ticks, wire.spool.direction, backing=alone
        )
        _stay_near(config, search)
        reach = search.ticks(config.home_travel + 2.0 * BACK_OFF_M)
        amperes = max(w.calibration.wind.current(config.home_tension) for w in motor.wires)
        counts = max(1, math.ceil(amperes / motor.model.current_unit))
        motor.guided = (counts, (math.ceil(origin - reach), math.floor(origin + reach)))
        searches.append(search)
    return searches


def _search(
    bus: Bus, config: DynamixelConfig, searches: list[SlackSearch], cancelled: Callable[[], bool]
) -> None:
    """
    Move all motors until every zero is known.

    A pause of this process counts as one cycle: nobody looked whether a motor turned meanwhile.
    """
    left = 3.0 * config.home_travel / config.home_speed + MORE_TIME_S
    before = time.monotonic()
    while not all(search.done for search in searches):
        if cancelled():
            raise DriverError(f'{bus.path}: looking for slack was cancelled; torque is off')
        now = time.monotonic()
        passed, before = min(now - before, 2.0 * CYCLE_S), now
        left -= passed
        if left < 0.0:
            late = ', '.join(str(search.motor) for search in searches if not search.done)
            raise DriverError(
                f'{bus.path}: {late}: looking for slack took too long; torque is off'
            )
        _cycle(bus, config, searches, passed)
        time.sleep(CYCLE_S)
    for search in searches:
        search.motor.zero = search.middle


def _end(bus: Bus, searches: list[SlackSearch]) -> None:
    """Torque off; remember how far those went whose zero is not known."""
    motors = [search.motor for search in searches]
    try:
        torque_off(bus, motors)
        read_state(bus, motors)
    except PortLostError:  # their watchdogs stop them, at the goal at the furthest
        for motor in motors:
            motor.wanted = motor.answers = False
    gone = travelled(bus.path)
    for search in searches:
        motor = search.motor
        motor.guided = None
        end = motor.ticks if motor.answers and motor.ticks is not None else search.goal
        gone[motor.identity] = end - search.origin
    if all(motor.zero is not None for motor in motors):
        gone.clear()


def _cycle(bus: Bus, config: DynamixelConfig, searches: list[SlackSearch], passed: float) -> None:
    """Move every goal a little, look at every motor."""
    read_state(bus, [search.motor for search in searches])
    for search in searches:
        search.missed = 0 if search.motor.answers else search.missed + 1
        if search.missed > MISSED_ANSWERS_MAX:
            raise DriverError(f'{bus.path}: {search.motor}: no answer while looking for slack')
        if search.missed:
            continue
        if search.backing:
            _back_off(bus, config, search, passed)
        elif search.middle is not None:
            _return(config, search, search.middle)
        elif _wind(config, search, passed) and not _awoken(bus, search) and _pulls(config, search):
            _stalled(search)
    goals = {s.motor.identity: round(s.goal) for s in searches}
    bus.send_goals(
        'goal_position', goals, {s.motor.identity: s.motor.position_bounds for s in searches}
    )


def _back_off(bus: Bus, config: DynamixelConfig, search: SlackSearch, passed: float) -> None:
    """Pay out a little; refuse a motor that does not turn."""
    ticks = search.motor.ticks or 0
    search.goal = search.start - search.way * search.ticks(BACK_OFF_M)
    moved = abs(ticks - search.start)
    if moved >= 0.5 * search.ticks(BACK_OFF_M):
        search.backing, search.goal, search.still = False, float(ticks), 0.0
        return
    search.still += passed
    if search.still > search.asked + STALLED_AFTER_S:
        search.asked = search.still
        if _awoken(bus, search):
            return
    if search.still > TURNS_WITHIN_S:
        amperes = (search.motor.guided or (0, (0, 0)))[0] * search.motor.model.current_unit
        raise DriverError(
            f'{config.port}: {search.motor}: does not turn with {amperes:.3f} A; calibrate it, '
            f'or raise home_tension (now {config.home_tension:g} N); torque is off'
        )


def _wind(config: DynamixelConfig, search: SlackSearch, passed: float) -> bool:
    """Let the goal run ahead; tell whether the motor stays behind and stands still: wire found."""
    motor, ticks = search.motor, search.motor.ticks or 0
    lag, step = search.ticks(LAG_MAX_M), search.ticks(config.home_speed * CYCLE_S)
    search.goal += search.way * min(step, max(0.0, 2.0 * lag - abs(search.goal - ticks)))
    slow = (
        abs(motor.velocity) * REGISTERS['present_velocity'].unit / RADIANS_PER_TICK
        < 0.1 * step / CYCLE_S + 30.0
    )
    behind = slow and abs(search.goal - ticks) >= lag
    search.still = search.still + passed if behind else 0.0
    if search.still > STALLED_AFTER_S:
        return True
    _stay_near(config, search)
    return False


def _awoken(bus: Bus, search: SlackSearch) -> bool:
    """
    Tell whether a motor stands because its watchdog stopped it, and let it go on from there.

    Such a motor has not found its wire, and it is not one that cannot turn: this computer was
    late. Where it stands is known.
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
    recover_watchdog(
        bus, motor, OperatingMode.CURRENT_BASED_POSITION, WATCHDOG_COUNTS, tripped=True
    )
    search.goal, search.still, search.asked = float(motor.ticks or 0), 0.0, 0.0
    return True


def _stay_near(config: DynamixelConfig, search: SlackSearch) -> None:
    """Refuse to go further than `home_travel`, over all attempts."""
    if abs((search.motor.ticks or 0) - search.origin) > search.ticks(config.home_travel):
        raise MovedError(
            f'{config.port}: {search.motor}: no resistance within home_travel = '
            f'{config.home_travel:g} m; is the wire on its spool, is direction right? torque is '
            'off'
        )


def _pulls(config: DynamixelConfig, search: SlackSearch) -> bool:
    """
    Tell whether a motor that stands has the current of a taut wire; refuse one that goes without.

    Against a wire it has all that it may have, without one what its friction takes. One that
    stands with less is held back by something else: its wire is not found.
    """
    motor = search.motor
    drawn = search.way * (motor.current or 0) * motor.model.current_unit
    taut = max(w.calibration.wind.current(0.5 * config.home_tension) for w in motor.wires)
    if drawn < taut and search.still > TURNS_WITHIN_S:
        raise MovedError(
            f'{config.port}: {motor}: stands still with {drawn:.3f} A, expected more than '
            f'{taut:.3f} A against a taut wire: something else holds it back; does the spool '
            'turn freely, is the supply strong enough? torque is off'
        )
    return drawn >= taut


def _stalled(search: SlackSearch) -> None:
    ticks = search.motor.ticks or 0
    search.stalls += (ticks,)
    search.goal, search.still = float(ticks), 0.0
    search.way = -search.way


def _return(config: DynamixelConfig, search: SlackSearch, middle: float) -> None:
    """Go to the zero: a motor with two wires comes back half-way."""
    step = search.ticks(config.home_speed * CYCLE_S)
    search.goal += max(-step, min(step, middle - search.goal))
    search.done = abs((search.motor.ticks or 0) - middle) < search.ticks(LAG_MAX_M)
