"""
Common parts of drivers of real motors.

Commands within limits and rates, the configuration of every input, and the straight lines of
calibrations.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from ..common.arrays import Bools, Floats
from ..common.errors import DriverError, TendonRobotError
from ..common.yaml_reading import ConfigFields, in_range, read_yaml
from ..robot import Robot
from .interface import Driver
from .safety import CYCLE_MAX_S, STOP_TIME_MIN_S, approach, bounded

PULL_MAX_M = 1.0  # [m] of wire either way: more would be a mistake in a unit
WEIGHTS_MIN = 3  # [1] different ones in a calibration, else a line fits them without a residual
# [s] of standing still, or at a tension, until a wire is taut or a load cell has settled, so that
# a busy cycle is no stall
STANDING_S = 0.2
# [1] in a mean, or of which the largest current is carried, else noise and ripple would count
READINGS_MIN = 5


class HardwareDriver(Driver):
    """
    A driver of real motors: it is open or not, and its command moves within limits and rates.

    Tensions rise at the rates; they may fall faster, because a stop releases them.

    Parameters
    ----------
    robot : Robot
    mode : str
        `tension` or `pull`.
    place : str
        Port or topic; every message begins with it.
    limits : ndarray, shape (m, 2) [N] or [m]
    rates : ndarray, shape (m,) [N/s] or [m/s]

    """

    def __init__(self, robot: Robot, mode: str, place: str, limits: Floats, rates: Floats) -> None:
        """Create a closed driver."""
        self.robot, self.inputs, self.mode, self.place = robot, robot.inputs, mode, place
        self.limits, self.rates = limits, rates
        self._is_open = False
        self._goal: Floats = np.zeros(len(self.inputs))  # (m,) what was commanded last
        self._written = -np.inf  # monotonic [s]

    def _require_open(self, what: str) -> None:
        if not self._is_open:
            raise DriverError(f'{self.place}: {what}: the driver is not open; call open() first')

    def _chosen(self, inputs: Sequence[str]) -> Bools:
        """Return a mask (m,) of the named inputs; none named means all."""
        if unknown := [name for name in inputs if name not in self.inputs]:
            raise DriverError(
                f'expected inputs of {", ".join(self.inputs)}, got {", ".join(unknown)}'
            )
        return np.array([not inputs or name in inputs for name in self.inputs])

    def _since_write(self) -> float:
        """Return the time since the last command [s], and restart that clock."""
        now = time.monotonic()
        passed, self._written = now - self._written, now
        return passed

    def _towards(self, command: Floats, limits: Floats, passed: float) -> Floats:
        """Return the next goal (m,): towards a command (m,), within limits and rates."""
        goal = bounded(command, limits)
        rates = self.rates
        if self.mode == 'tension':
            falling = np.maximum(rates, limits[:, 1] / STOP_TIME_MIN_S)
            rates = np.where(goal < self._goal, falling, rates)
        # no wire moves in one step after a pause
        return approach(self._goal, goal, rates * min(passed, 2.0 * CYCLE_MAX_S))


class Spool(NamedTuple):
    """A spool: radius [m], direction of turning that winds (+1 or -1), ticks of the encoder."""

    radius: float
    direction: int
    ticks_per_turn: float

    @property
    def metres_per_tick(self) -> float:
        """Wire wound by a tick [m], negative where growing ticks pay out."""
        return self.direction * 2.0 * math.pi * self.radius / self.ticks_per_turn

    def pull(self, ticks: float) -> float:
        """Return the wire [m] wound by so many ticks."""
        return self.metres_per_tick * ticks

    def ticks(self, pull: float) -> float:
        """Return the ticks that wind so much wire [m]."""
        return pull / self.metres_per_tick


@dataclass(frozen=True)
class WireConfig:
    """
    One input: its spool and limits.

    Parameters
    ----------
    name : str
    spool : Spool
    tension_limit : float
        [N]
    pull_limits : tuple of float
        [m]
    rate : float
        Fastest change of the command, [N/s] or [m/s] by the mode.

    """

    name: str
    spool: Spool
    tension_limit: float
    pull_limits: tuple[float, float]
    rate: float


def fields_of_inputs(
    top: ConfigFields, key: str, what: str, robot: Robot
) -> dict[str, ConfigFields]:
    """
    Return the fields of every input of the robot.

    Parameters
    ----------
    top : ConfigFields
    key : str
        Key of their mapping: `motors`, `tendons`.
    what : str
        What every input needs, for messages: `a motor`.
    robot : Robot

    Raises
    ------
    DriverError
        An input is unknown, or has none.

    """
    mapping = top.child(key)
    mapping.only(*robot.inputs)
    if missing := [name for name in robot.inputs if not mapping.has(name)]:
        expected = f'{what} for every input of the robot'
        raise top.error(key, expected, f'none for {", ".join(missing)}')
    return {name: mapping.child(name) for name in robot.inputs}


def nearest(item: ConfigFields, top: ConfigFields, key: str) -> ConfigFields:
    """Return the fields of an input where it has a key of its own, else those of the file."""
    return item if item.has(key) else top


@dataclass(frozen=True, kw_only=True)
class PortConfig:
    """What the configuration of every driver on a serial port holds, by the keys of its file."""

    port: str
    baudrate: int  # [1/s]
    zero: str  # 'find' slack at enabling, or 'here': pull 0 is where the wires are
    home_tension: float  # [N] of the search for slack
    home_travel: Annotated[float, in_range(1e-4, 1.0, 'm')] = 0.05  # that it may wind


def read_port_config(
    top: ConfigFields, robot: Robot, mode: str, known: tuple[int, ...], slack: float
) -> dict[str, Any]:
    """
    Return the fields of `PortConfig` that depend on the robot, the mode or the kind of motor.

    Parameters
    ----------
    top : ConfigFields
    robot : Robot
    mode : str
        `tension` or `pull`.
    known : tuple of int
        Baud rates [1/s] that are possible.
    slack : float
        Tension of a wire that is just taut, as a fraction of the robot's highest.

    """
    low, high = robot.tension_limits
    port, baudrate = top.content.get('port'), top.content.get('baudrate', 1_000_000)
    if not isinstance(port, str) or not port:
        raise top.error('port', 'the path of a serial port, such as /dev/ttyUSB0', port)
    if baudrate not in known:
        raise top.error('baudrate', f'one of {", ".join(map(str, known))}', baudrate)
    return {
        'port': port,
        'baudrate': int(baudrate),
        'zero': top.choice('zero', ('find', 'here'), 'find' if mode == 'pull' else 'here'),
        'home_tension': top.number('home_tension', 1e-6, high, 'N', max(low, slack * high)),
    }


def read_spool_radius(item: ConfigFields, top: ConfigFields) -> float:
    """Return the radius of a spool [m]."""
    return nearest(item, top, 'spool_radius').number('spool_radius', 5e-4, 0.2, 'm')


def read_direction(item: ConfigFields, winding: str) -> int:
    """Return 1 where `winding` (what winds the wire, for messages) holds, else -1."""
    value = item.content.get('direction', 1)
    if isinstance(value, bool) or value not in (1, -1):
        raise item.error('direction', f'1 ({winding}) or -1', value)
    return int(value)


def read_pull_limits(fields: ConfigFields, largest: float = PULL_MAX_M) -> tuple[float, float]:
    """Return the lowest and the highest pull [m], within `largest` either way."""
    low, high = fields.vector('pull_limits', 2)
    if not -largest <= low < high <= largest:
        raise fields.error('pull_limits', '[lowest, highest] [m], lowest < highest', [low, high])
    return float(low), float(high)


def read_calibrations(top: ConfigFields, required: bool) -> ConfigFields:
    """
    Open the calibrations: a mapping, or the path of the file that `calibrate` writes.

    Raises
    ------
    DriverError
        The file cannot be read, or is required and not there.

    """
    value = top.content.get('calibration')
    if not isinstance(value, str):
        return ConfigFields(top.source, 'calibration', value)
    file = Path(top.source).parent / value
    if not required and not file.exists():
        return ConfigFields(str(file), '', {})

    def refuse(reason: str) -> TendonRobotError:
        return top.error('calibration', 'a readable YAML file', f'{file}: {reason}')

    return ConfigFields(str(file), '', read_yaml(file, refuse))


def read_wire_limits(
    item: ConfigFields, top: ConfigFields, robot: Robot, mode: str
) -> dict[str, Any]:
    """Return the limits of `WireConfig`; only pull mode needs limits of the pull."""
    low, high = robot.tension_limits
    limited = nearest(item, top, 'pull_limits')
    pull_limits = -PULL_MAX_M, PULL_MAX_M
    if limited.has('pull_limits') or mode == 'pull':
        pull_limits = read_pull_limits(limited)
    tension_limit = item.number('tension_limit', low + 1e-6, high, 'N', high)
    return {'tension_limit': tension_limit, 'pull_limits': pull_limits}


class LineFit(NamedTuple):
    """A line y = intercept + slope x, standard errors of both, and the scatter about it."""

    intercept: float
    slope: float
    intercept_error: float = 0.0
    slope_error: float = 0.0
    scatter: float = 0.0


def fit_line(x: Floats, y: Floats, noise: float = 0.0) -> LineFit:
    """
    Fit a straight line by least squares, with the standard errors of linear regression.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
    noise : float
        Scatter that is known from elsewhere, where the residuals show less.

    """
    (slope, intercept), factors = np.polyfit(x, y, 1, cov='unscaled')
    residual = y - intercept - slope * x
    scatter = max(float(np.sqrt(residual @ residual / max(1, len(x) - 2))), noise)
    slope_error, intercept_error = (scatter * np.sqrt(np.diag(factors))).tolist()
    return LineFit(float(intercept), float(slope), intercept_error, slope_error, scatter)
