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

from ...exceptions import DriverError
from .bus import Bus
from .config import Config
from .motor import Motor
from .tables import CURRENT_POSITION_MODE, RPM_PER_COUNT, TICKS_PER_TURN
from .torque import read_state, torque_off, torque_on

PERIOD = 0.01  # [s]
BACK_OFF = 0.002  # [m]
LAG = 0.001  # [m] behind the goal: it does not follow any more
STALLED_FOR = 0.15  # [s]
MOST_MISSED = 5  # answers in a row


@dataclass
class Search:
    """One motor on its way: which way it winds now and since when it stands still."""

    motor: Motor
    start: int  # ticks
    goal: float  # ticks
    way: int  # +1 or -1, the direction of the ticks
    backing: bool
    still_since: float | None = None
    stalls: tuple[int, ...] = ()
    missed: int = 0  # answers in a row
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
    bus: Bus, config: Config, motors: list[Motor], cancelled: Callable[[], bool]
) -> None:
    """
    Wind the slack up and set the zero of every motor; torque is off afterwards.

    Raises
    ------
    DriverError
        A motor does not turn, finds no resistance within `home_travel`, or fails.

    """
    searches = _prepare(bus, config, motors)
    try:
        torque_on(bus, motors, CURRENT_POSITION_MODE, watchdog=10)
        deadline = time.monotonic() + 3.0 * config.home_travel / config.home_speed + 5.0
        while not all(search.done for search in searches):
            if cancelled():
                raise DriverError(f'{bus.path}: looking for slack was cancelled; torque is off')
            if time.monotonic() > deadline:
                raise DriverError(f'{bus.path}: looking for slack took too long; torque is off')
            _cycle(bus, config, searches)
            time.sleep(PERIOD)
        for search in searches:
            search.motor.zero = search.middle
    finally:
        torque_off(bus, motors)
        for motor in motors:
            motor.guided = None


def _prepare(bus: Bus, config: Config, motors: list[Motor]) -> list[Search]:
    read_state(bus, motors)
    searches = []
    for motor in motors:
        if motor.ticks is None or not motor.answers:
            raise DriverError(f'{bus.path}: {motor}: no answer; check the cable')
        wire = motor.wires[0]
        alone = len(motor.wires) == 1
        search = Search(motor, motor.ticks, motor.ticks, wire.spool.direction, backing=alone)
        reach = math.ceil(search.ticks(config.home_travel + 2.0 * BACK_OFF))
        amperes = max(w.calibration.wind.current(config.home_tension) for w in motor.wires)
        counts = max(1, math.ceil(amperes / motor.model.current_unit))
        motor.guided = (counts, (motor.ticks - reach, motor.ticks + reach))
        searches.append(search)
    return searches


def _cycle(bus: Bus, config: Config, searches: list[Search]) -> None:
    """Move every goal a little, look at every motor."""
    read_state(bus, [search.motor for search in searches])
    now = time.monotonic()
    for search in searches:
        search.missed = 0 if search.motor.answers else search.missed + 1
        if search.missed > MOST_MISSED:
            raise DriverError(f'{bus.path}: {search.motor}: no answer while looking for slack')
        if search.missed:
            continue
        if search.backing:
            _back_off(config, search, now)
        elif search.middle is not None:
            _return(config, search, search.middle)
        else:
            _wind(config, search, now)
    goals = {s.motor.identity: round(s.goal) for s in searches}
    bus.send_goals(
        'goal_position', goals, {s.motor.identity: s.motor.position_bounds for s in searches}
    )


def _back_off(config: Config, search: Search, now: float) -> None:
    """Pay out a little; refuse a motor that does not turn."""
    ticks = search.motor.ticks or 0
    search.goal = search.start - search.way * search.ticks(BACK_OFF)
    moved = abs(ticks - search.start)
    if moved >= 0.5 * search.ticks(BACK_OFF):
        search.backing, search.goal = False, float(ticks)
        search.still_since = None
        return
    search.still_since = search.still_since or now
    if now - search.still_since > 2.0:
        amperes = (search.motor.guided or (0, (0, 0)))[0] * search.motor.model.current_unit
        raise DriverError(
            f'{config.port}: {search.motor}: does not turn with {amperes:.3f} A; calibrate it, '
            f'or raise home_tension (now {config.home_tension:g} N); torque is off'
        )


def _wind(config: Config, search: Search, now: float) -> None:
    """Let the goal run ahead; a motor that stays behind and stands still has found the wire."""
    motor, ticks = search.motor, search.motor.ticks or 0
    lag, step = search.ticks(LAG), search.ticks(config.home_speed * PERIOD)
    search.goal += search.way * min(step, max(0.0, 2.0 * lag - abs(search.goal - ticks)))
    slow = abs(motor.velocity) * RPM_PER_COUNT / 60.0 * TICKS_PER_TURN < 0.1 * step / PERIOD + 30.0
    if abs(search.goal - ticks) < lag or not slow:
        search.still_since = None
    elif search.still_since is None:
        search.still_since = now
    elif now - search.still_since > STALLED_FOR:
        _stalled(search, ticks)
        return
    if abs(ticks - search.start) > search.ticks(config.home_travel):
        raise DriverError(
            f'{config.port}: {motor}: no resistance within home_travel = '
            f'{config.home_travel:g} m; is the wire on its spool, is direction right? torque is '
            'off'
        )


def _stalled(search: Search, ticks: int) -> None:
    search.stalls += (ticks,)
    search.goal, search.still_since = float(ticks), None
    search.way = -search.way


def _return(config: Config, search: Search, middle: float) -> None:
    """Go to the zero: a motor with two wires comes back half-way."""
    step = search.ticks(config.home_speed * PERIOD)
    search.goal += max(-step, min(step, middle - search.goal))
    search.done = abs((search.motor.ticks or 0) - middle) < search.ticks(LAG)
