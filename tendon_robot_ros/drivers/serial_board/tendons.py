"""The tendons of the configuration: channel, spool, limits and load cell of every input."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...robot import Robot
from ...robot_checks import parse_yaml
from ..fields import Fields
from ..interface import Array

TENDON_KEYS = (
    'channel',
    'direction',
    'spool_radius',
    'ticks_per_turn',
    'tension_limit',
    'pull_limits',
)
CHANNELS = 8  # most a board can have
WIDEST = 1.0  # [m] of wire either way, where no pull limits are given


@dataclass(frozen=True)
class Cell:
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

    def uncertainty(self, tension: Array) -> Array:
        """Return the standard uncertainty [N] at tensions [N], any shape."""
        fixed = self.newtons_per_count * math.hypot(self.zero_error, self.scatter)
        share = self.slope_error / self.newtons_per_count
        return np.hypot(fixed, share * tension)


@dataclass(frozen=True)
class TendonConfig:
    """One input: its channel, spool [m per tick, > 0 winds] and limits [N], [m]."""

    name: str
    channel: int
    metres_per_tick: float
    tension_limit: float
    pull_limits: tuple[float, float]
    cell: Cell | None

    def __str__(self) -> str:
        """Name it for messages."""
        return f'{self.name} (channel {self.channel})'


def read_tendons(
    top: Fields, robot: Robot, mode: str, calibrated: bool
) -> tuple[TendonConfig, ...]:
    """Read the channel of every input; `calibrated` tells whether load cells must be."""
    tendons = top.child('tendons')
    tendons.only(*robot.inputs)
    missing = [name for name in robot.inputs if not tendons.has(name)]
    if missing:
        raise top.error(
            'tendons', 'a channel for every input of the robot', f'none for {", ".join(missing)}'
        )
    cells = _calibrations(top)
    made = tuple(_tendon(top, name, cells, robot, mode, calibrated) for name in robot.inputs)
    numbers = [tendon.channel for tendon in made]
    for tendon in made:
        if numbers.count(tendon.channel) > 1:
            raise top.error('tendons', 'a channel of its own for every input', str(tendon))
    return made


def _tendon(
    top: Fields, name: str, cells: Fields, robot: Robot, mode: str, calibrated: bool
) -> TendonConfig:
    item = top.child('tendons').child(name)
    item.only(*TENDON_KEYS)
    channel = item.content.get('channel')
    if isinstance(channel, bool) or not isinstance(channel, int) or not 0 <= channel < CHANNELS:
        raise item.error('channel', f'a whole number from 0 to {CHANNELS - 1}', channel)
    direction = item.content.get('direction', 1)
    if isinstance(direction, bool) or direction not in (1, -1):
        raise item.error('direction', '1 (growing encoder ticks wind) or -1', direction)
    radius = _where(item, top, 'spool_radius').number('spool_radius', 5e-4, 0.2, 'm')
    ticks = _where(item, top, 'ticks_per_turn').number('ticks_per_turn', 1.0, 1e7, 'ticks')
    low, high = robot.tension_limits
    if calibrated and not cells.has(name):
        raise top.error(
            'calibration',
            f'the load cell of every input; none for {name}: type '
            f'calibrate serial CONFIG --robot ROBOT --tendon {name} --weights KG KG KG',
            list(cells.content),
        )
    return TendonConfig(
        name=name,
        channel=channel,
        metres_per_tick=direction * 2.0 * math.pi * radius / ticks,
        tension_limit=item.value('tension_limit', high, low + 1e-6, high, 'N'),
        pull_limits=_pull_limits(_where(item, top, 'pull_limits'), mode),
        cell=_cell(cells.child(name)) if cells.has(name) else None,
    )


def _where(item: Fields, top: Fields, key: str) -> Fields:
    return item if item.has(key) else top


def _pull_limits(where: Fields, mode: str) -> tuple[float, float]:
    if not where.has('pull_limits') and mode == 'tension':
        return -WIDEST, WIDEST
    low, high = where.vector('pull_limits', 2)
    if not -WIDEST <= low < high <= WIDEST:
        raise where.error('pull_limits', '[lowest, highest] [m], lowest < highest', [low, high])
    return low, high


def _calibrations(top: Fields) -> Fields:
    """Open the calibrations: a mapping, or the path of the file that `calibrate` wrote."""
    value = top.content.get('calibration')
    if not isinstance(value, str):
        return Fields(top.source, 'calibration', value)
    file = Path(top.source).parent / value
    try:
        return Fields(str(file), '', parse_yaml(file.read_text(encoding='utf-8')))
    except FileNotFoundError:
        return Fields(str(file), '', {})
    except (OSError, ValueError) as error:
        raise top.error('calibration', 'a readable YAML file', f'{file}: {error}') from None


def _cell(item: Fields) -> Cell:
    slope = item.number('newtons_per_count', -1e-3, 1e-3, 'N/count')
    if abs(slope) < 1e-9:
        raise item.error('newtons_per_count', 'a slope of at least 1e-9 N/count', slope)
    return Cell(
        item.number('zero', -8e6, 8e6, 'counts'),
        slope,
        *(
            item.value(key, 0.0, 0.0, 1e6, unit)
            for key, unit in (
                ('zero_error', 'counts'),
                ('slope_error', 'N/count'),
                ('scatter', 'counts'),
            )
        ),
    )
