"""
The driver's configuration and the calibration of its load cells (docs/serial_board.md).

A load cell is calibrated by least squares of counts = zero + tension / newtons_per_count over
known weights, nothing hung being the first.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, NamedTuple

import numpy as np

from ...common.errors import InputError
from ...common.yaml_reading import ConfigFields, in_range, one_of
from ...robot import Robot
from .. import hardware
from .messages import RELEASES, Protocol


class Cell(NamedTuple):
    """
    Calibration of a load cell: tension = (counts - zero) * newtons_per_count.

    Parameters
    ----------
    zero : float
        [counts]
    newtons_per_count : float
        [N/count], negative where the cell is mounted the other way round.
    zero_error, slope_error : float
        Standard errors [counts], [N/count].
    scatter : float
        Standard deviation of the counts about the line [counts].

    """

    zero: float
    newtons_per_count: float
    zero_error: float = 0.0
    slope_error: float = 0.0
    scatter: float = 0.0

    def uncertainty(self, tension: float) -> float:
        """Return the standard uncertainty [N] at a tension [N]."""
        fixed = self.newtons_per_count * math.hypot(self.zero_error, self.scatter)
        return math.hypot(fixed, self.slope_error / self.newtons_per_count * tension)


class CountsPoint(NamedTuple):
    """Counts with one weight: tension [N], mean and standard deviation [counts]."""

    tension: float
    mean: float
    spread: float


def fit_counts(points: Sequence[CountsPoint]) -> Cell:
    """
    Fit the line.

    Raises
    ------
    InputError
        Too few different weights, or counts that do not change with the weight.

    """
    tensions, counts, spreads = np.reshape(points, (-1, 3)).T
    if (different := len(np.unique(tensions))) < hardware.WEIGHTS_MIN:
        raise InputError(
            f'calibration: expected at least {hardware.WEIGHTS_MIN - 1} different weights besides '
            f'none, got {different - 1}'
        )
    noise = math.sqrt(float(np.mean(spreads**2)))
    line = hardware.fit_line(tensions, counts, noise)
    if abs(line.slope) * float(np.ptp(tensions)) < 5.0 * line.scatter or line.slope == 0.0:
        raise InputError(
            f'calibration: the counts do not follow the weight ({line.slope:.3g} counts/N, '
            f'scatter {line.scatter:.3g} counts); does it hang on the load cell of this channel?'
        )
    return Cell(
        zero=line.intercept,
        newtons_per_count=1.0 / line.slope,
        zero_error=line.intercept_error,
        slope_error=line.slope_error / line.slope**2,
        scatter=line.scatter,
    )


def cell_mapping(cell: Cell, points: Sequence[CountsPoint]) -> dict[str, Any]:
    """Return the entry of one tendon in the calibration file."""
    heaviest = max(point.tension for point in points)
    return {
        'zero': round(cell.zero, 1),
        'newtons_per_count': float(f'{cell.newtons_per_count:.8g}'),
        'zero_error': round(cell.zero_error, 2),
        'slope_error': float(f'{cell.slope_error:.3g}'),
        'scatter': round(cell.scatter, 2),
        'uncertainty': float(f'{cell.uncertainty(heaviest):.3g}'),
        'tensions': [round(point.tension, 4) for point in points],
        'date': datetime.date.today().isoformat(),
    }


# keys of a channel that hold for all channels where they stand at the top of the file
COMMON_KEYS = ('spool_radius', 'ticks_per_turn', 'pull_limits')
# [1] of a tick, which the protocol has in whole nanometres: else gain and rates of the board would
# be wrong by more than a spool radius is known
ROUNDING_MAX = 0.01
TENDON_KEYS = ('channel', 'direction', 'tension_limit', *COMMON_KEYS)


@dataclass(frozen=True)
class ChannelWire(hardware.WireConfig):
    """One input, its channel and load cell, which is nan where it is not calibrated yet."""

    channel: int
    cell: Cell

    @property
    def counted(self) -> float:
        """Metres that the board counts per metre of wire: its ticks have whole nanometres."""
        nanometres = 1e9 * self.spool.metres_per_tick
        return round(nanometres) / nanometres

    def __str__(self) -> str:
        """Name it for messages."""
        return f'{self.name} (channel {self.channel})'


def read_wires(
    top: ConfigFields, robot: Robot, mode: str, rate: float, calibrated: bool
) -> tuple[ChannelWire, ...]:
    """Read the channel of every input; `calibrated`: load cells must be calibrated."""
    cells = hardware.read_calibrations(top, required=False)
    wires = []
    for name, item in hardware.fields_of_inputs(top, 'tendons', 'a channel', robot).items():
        item.only(*TENDON_KEYS)
        channel = item.whole('channel', 0, Protocol.CHANNELS_MAX - 1)
        direction = hardware.read_direction(item, 'growing encoder ticks wind')
        radius = hardware.read_spool_radius(item, top)
        counted = hardware.nearest(item, top, 'ticks_per_turn')
        ticks_per_turn = counted.number('ticks_per_turn', 1.0, 1e7, 'ticks')
        limits = hardware.read_wire_limits(item, top, robot, mode)
        if calibrated and not cells.has(name):
            raise top.error(
                'calibration',
                f'the load cell of every input; none for {name}: type '
                f'motors calibrate serial CONFIG --robot ROBOT --tendon {name} --weights KG KG KG',
                list(cells.content),
            )
        cell = read_cell(cells.child(name)) if cells.has(name) else Cell(math.nan, math.nan)
        spool = hardware.Spool(radius, direction, ticks_per_turn)
        wire = ChannelWire(name, spool, **limits, rate=rate, channel=channel, cell=cell)
        if abs(wire.counted - 1.0) > ROUNDING_MAX:
            expected = f'whole nanometres of wire per tick, to {ROUNDING_MAX:.0%}'
            tick = f'{1e9 * abs(spool.metres_per_tick):.3g} nm'
            raise counted.error('ticks_per_turn', expected, tick)
        wires.append(wire)
    channels = [wire.channel for wire in wires]
    for wire in wires:
        if channels.count(wire.channel) > 1:
            raise top.error('tendons', 'a channel of its own for every input', str(wire))
    return tuple(wires)


def read_cell(item: ConfigFields) -> Cell:
    """Read the calibration of a load cell."""
    slope = item.number('newtons_per_count', -1e-3, 1e-3, 'N/count')
    if abs(slope) < 1e-9:
        raise item.error('newtons_per_count', 'a slope of at least 1e-9 N/count', slope)
    units = {'zero_error': 'counts', 'slope_error': 'N/count', 'scatter': 'counts'}
    errors = {key: item.number(key, 0.0, 1e6, unit, 0.0) for key, unit in units.items()}
    return Cell(item.number('zero', -8e6, 8e6, 'counts'), slope, **errors)


# [1/s] that common boards divide from their clock: datasheet of the ATmega2560 (U2X at 16 MHz)
BAUD_RATES = (115_200, 230_400, 250_000, 500_000, 1_000_000, 2_000_000)


@dataclass(frozen=True, kw_only=True)
class BoardConfig(hardware.PortConfig):
    """Checked configuration of the driver, by the keys of its file; SI units."""

    source: str  # the file
    telemetry_rate: Annotated[float, in_range(20.0, 1000.0, 'Hz')] = 250.0
    # of silence after which the board releases
    command_timeout: Annotated[float, in_range(0.02, 10.0, 's')] = 0.2
    release_rate: float  # [N/s]
    release_to: Annotated[str, one_of(*RELEASES)] = 'pretension'
    pretension: float  # [N] after a release
    # of the tension loop
    tension_gain: Annotated[float, in_range(1e-6, 1.0, 'm/(N·s)')] = 0.015
    tension_rate: float  # [N/s]
    pull_rate: float  # [m/s]
    home_time: Annotated[float, in_range(0.5, 120.0, 's')] = 10.0  # of the search for slack
    tendons: tuple[ChannelWire, ...]  # of every input

    @property
    def period(self) -> float:
        """Time between two telemetries [s]."""
        return 1.0 / self.telemetry_rate


FIELDS = (field.name for field in fields(BoardConfig) if field.name != 'source')
KEYS = (*FIELDS, 'calibration', *COMMON_KEYS)


def read_config(
    robot: Robot, content: Mapping[str, Any], mode: str, source: str, *, calibrated: bool = True
) -> BoardConfig:
    """
    Check a configuration for a robot; `calibrated`: load cells must be calibrated.

    Raises
    ------
    DriverError
        With file, key, what was expected and what came.

    """
    top = ConfigFields(source, '', dict(content))
    top.only(*KEYS)
    low, high = robot.tension_limits
    tension_rate = top.number('tension_rate', 1e-3, 1e3, 'N/s', 2.0 * high)
    pull_rate = top.number('pull_rate', 1e-5, 1.0, 'm/s', 0.05)
    rate = tension_rate if mode == 'tension' else pull_rate
    return BoardConfig(
        **hardware.read_port_config(top, robot, mode, BAUD_RATES, slack=0.05),
        **top.fields(BoardConfig),
        source=source,
        release_rate=top.number('release_rate', 1e-3, 1e3, 'N/s', 2.0 * high),
        pretension=top.number('pretension', 0.0, high, 'N', low),
        tension_rate=tension_rate,
        pull_rate=pull_rate,
        tendons=read_wires(top, robot, mode, rate, calibrated),
    )
