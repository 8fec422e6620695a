"""
Calibrate current against tension: hang known weights, wind them up, pay them out, fit two lines.

A geared motor shows its friction with both signs: winding needs I = a_wind + b_wind T, paying out
I = a_out + b_out T. Each line is fitted by least squares over the weights; the standard errors
are those of the usual linear regression.
"""

from __future__ import annotations

import datetime
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...common.errors import DriverError, InputError
from ...common.processes import ends_between
from ..ports import PortLostError
from .bus import Bus
from .config import WireConfig
from .control_table import (
    RADIANS_PER_TICK,
    REGISTERS,
    Calibration,
    CurrentLine,
    OperatingMode,
)
from .motor import Motor
from .torque import read_state, torque_off, torque_on

SAMPLE_PERIOD_S = 0.01  # [s]
ARRIVAL_TIMEOUT_S = 1.0  # [s] without coming nearer to its last goal: the motor does not follow
AWAY_MAX = 0.2  # [1] of a way, within which its end counts as reached: friction holds it there
TURNING = (0.5, 1.5)  # parts of the speed asked for at which a reading counts
STEADY_PART = (0.35, 0.9)  # part of the way in which the current counts
WEIGHTS_MIN = 3
READ_ATTEMPTS = 3
SAMPLES_MIN = 5


@dataclass(frozen=True)
class CurrentPoint:
    """Currents with one weight on the wire: mean while winding and while paying out [A]."""

    tension: float  # [N]
    wind: float
    pay_out: float


@dataclass(frozen=True)
class CurrentFit:
    """
    Two fitted lines and how well they are known.

    Parameters
    ----------
    calibration : Calibration
    errors : dict of str to tuple
        Standard errors of intercept [A] and slope [A/N] of `wind` and `pay_out`.
    points : tuple of Point
    """

    calibration: Calibration
    errors: dict[str, tuple[float, float]]
    points: tuple[CurrentPoint, ...]

    @property
    def half_gap(self) -> float:
        """Half the gap between the lines at the heaviest weight [N]."""
        return self.calibration.uncertainty(max(point.tension for point in self.points))


def fit_current(points: Sequence[CurrentPoint]) -> CurrentFit:
    """
    Fit the two lines.

    Raises
    ------
    InputError
        Fewer than three weights, or currents that do not grow with the weight.

    """
    tensions = np.array([point.tension for point in points])
    if len(set(tensions.tolist())) < WEIGHTS_MIN:
        raise InputError(
            f'calibration: expected at least {WEIGHTS_MIN} different weights, '
            f'got {len(set(tensions.tolist()))}'
        )
    lines, errors, spread = {}, {}, []
    for name in ('wind', 'pay_out'):
        currents = np.array([getattr(point, name) for point in points])
        lines[name], errors[name], scatter = _line(tensions, currents)
        spread.append(scatter)
        if lines[name].slope <= 0.0:
            raise InputError(
                f'calibration: {name}: the current does not grow with the weight '
                f'({lines[name].slope:.3g} A/N); does the weight hang free?'
            )
    calibration = Calibration(lines['wind'], lines['pay_out'], measured=True, scatter=max(spread))
    return CurrentFit(calibration, errors, tuple(points))


def _line(x: np.ndarray, y: np.ndarray) -> tuple[CurrentLine, tuple[float, float], float]:
    """Fit a line: the line, the standard errors of intercept and slope, and the scatter."""
    slope, intercept = np.polyfit(x, y, 1)
    rest = y - intercept - slope * x
    scatter = math.sqrt(float(rest @ rest) / max(1, len(x) - 2))
    spread = float(np.sum((x - x.mean()) ** 2))
    errors = (
        scatter * math.sqrt(1.0 / len(x) + x.mean() ** 2 / spread),
        scatter / math.sqrt(spread),
    )
    return CurrentLine(float(intercept), float(slope)), errors, scatter


def to_mapping(result: CurrentFit, wire: WireConfig) -> dict[str, Any]:
    """Return what is written to the calibration file for one tendon."""
    lines = result.calibration
    return {
        'wind': [round(v, 7) for v in (lines.wind.intercept, lines.wind.slope)],
        'wind_errors': [round(v, 7) for v in result.errors['wind']],
        'pay_out': [round(v, 7) for v in (lines.pay_out.intercept, lines.pay_out.slope)],
        'pay_out_errors': [round(v, 7) for v in result.errors['pay_out']],
        'scatter': round(lines.scatter, 7),
        'half_gap': round(result.half_gap, 4),
        'model': wire.model.name,
        'spool_radius': wire.spool.radius,
        'tensions': [round(point.tension, 4) for point in result.points],
        'date': datetime.date.today().isoformat(),
    }


def measure(bus: Bus, motor: Motor, tension: float, travel: float, speed: float) -> CurrentPoint:
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
                torque_on(bus, [motor], OperatingMode.CURRENT_BASED_POSITION, watchdog=10)
                up = _go(bus, motor, end, travel / speed, check)
                down = _go(bus, motor, start, travel / speed, check)
            finally:
                torque_off(bus, [motor])
    except PortLostError as error:
        raise DriverError(f'{error}: lost while calibrating; the bus watchdog stops it') from None
    finally:
        motor.guided = None
    return CurrentPoint(tension, up, down)


def _turn_to(bus: Bus, motor: Motor, ticks: int) -> None:
    """Send a goal and read what the motor does a period later."""
    bus.send_goals(
        'goal_position', {motor.identity: ticks}, {motor.identity: motor.position_bounds}
    )
    time.sleep(SAMPLE_PERIOD_S)
    for _ in range(READ_ATTEMPTS):
        read_state(bus, [motor])
        if motor.answers:
            return
    raise DriverError(f'{bus.path}: {motor}: no answer while calibrating; torque is off')


def _go(bus: Bus, motor: Motor, end: int, duration: float, check: Callable[[], None]) -> float:
    """
    Turn to `end` at constant speed; return the mean current on the steady part [A].

    A process that is late turns it more slowly, instead of leaving readings out. It counts while
    it turns: one that stands, because its next goal is late, holds with anything up to friction.
    """
    start, part, before = motor.ticks or 0, 0.0, time.monotonic()
    currents = []
    wire = motor.wires[0]
    ticks = (end - start) / duration  # [1/s]
    speed = ticks * RADIANS_PER_TICK / REGISTERS['present_velocity'].unit  # [counts]
    while part < 1.0:
        check()
        _turn_to(bus, motor, round(start + part * (end - start)))
        turns = TURNING[0] < motor.velocity / speed < TURNING[1]
        if STEADY_PART[0] < part < STEADY_PART[1] and turns and motor.current is not None:
            currents.append(wire.spool.direction * motor.current * motor.model.current_unit)
        now = time.monotonic()
        part, before = part + min(now - before, 2.0 * SAMPLE_PERIOD_S) / duration, now
    left, nearer = math.inf, time.monotonic()
    while (now_left := abs((motor.ticks or 0) - end)) > AWAY_MAX * abs(end - start):
        if now_left < left:
            left, nearer = now_left, time.monotonic()
        if time.monotonic() - nearer < ARRIVAL_TIMEOUT_S:
            check()
            _turn_to(bus, motor, end)  # its last goal is an old one where this process was late
            continue
        raise DriverError(
            f'{bus.path}: {motor}: does not follow; is the weight too heavy for '
            f'{motor.strongest * motor.model.current_unit:.2f} A, or blocked?'
        )
    if len(currents) < SAMPLES_MIN:
        raise DriverError(
            f'{bus.path}: {motor}: only {len(currents)} readings; go slower or further'
        )
    return float(np.mean(currents))
