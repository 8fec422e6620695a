"""The driver's configuration: channels, spools, limits, load cells (docs/serial_board.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...robot import Robot
from ..fields import Fields
from ..interface import Array
from .tendons import TendonConfig, read_tendons

KEYS = (
    'port',
    'baudrate',
    'telemetry_rate',
    'command_timeout',
    'release_rate',
    'release_to',
    'pretension',
    'tension_gain',
    'tension_rate',
    'pull_rate',
    'pull_limits',
    'spool_radius',
    'ticks_per_turn',
    'zero',
    'home_tension',
    'home_time',
    'calibration',
    'tendons',
)
BAUD_RATES = (115_200, 230_400, 250_000, 500_000, 1_000_000, 2_000_000)


@dataclass(frozen=True)
class Config:
    """Everything the driver needs to know; SI units."""

    source: str
    port: str
    baud: int
    period: float  # [s] of the telemetry
    timeout: float  # [s] of silence after which the board releases
    release_rate: float  # [N/s]
    release_to: str
    rest: float  # [N] after a release
    gain: float  # [m/(N·s)] of the tension loop
    tension_rate: float  # [N/s]
    pull_rate: float  # [m/s]
    zero: str  # 'find' slack at enabling, or 'here': pull 0 is where it is opened
    home_tension: float  # [N]
    home_time: float  # [s]
    tendons: tuple[TendonConfig, ...]


def read_config(
    robot: Robot, content: Mapping[str, Any], mode: str, source: str, *, calibrated: bool = True
) -> Config:
    """
    Check a configuration for a robot; `calibrated` tells whether load cells must be.

    Raises
    ------
    DriverError
        With file, key, what was expected and what came.

    """
    top = Fields(source, '', dict(content))
    top.only(*KEYS)
    low, high = robot.tension_limits
    baud = top.content.get('baudrate', 1_000_000)
    if baud not in BAUD_RATES:
        raise top.error('baudrate', f'one of {", ".join(map(str, BAUD_RATES))}', baud)
    lowest = max(low, 0.05 * high)
    return Config(
        source=source,
        port=top.port(),
        baud=int(baud),
        period=1.0 / top.value('telemetry_rate', 250.0, 20.0, 1000.0, 'Hz'),
        timeout=top.value('command_timeout', 0.2, 0.02, 10.0, 's'),
        release_rate=top.value('release_rate', 2.0 * high, 1e-3, 1e3, 'N/s'),
        release_to=top.choice('release_to', ('pretension', 'limp'), 'pretension'),
        rest=top.value('pretension', low, 0.0, high, 'N'),
        gain=top.value('tension_gain', 0.015, 1e-6, 1.0, 'm/(N·s)'),
        tension_rate=top.value('tension_rate', 2.0 * high, 1e-3, 1e3, 'N/s'),
        pull_rate=top.value('pull_rate', 0.05, 1e-5, 1.0, 'm/s'),
        zero=top.choice('zero', ('find', 'here'), 'find' if mode == 'pull' else 'here'),
        home_tension=top.value('home_tension', lowest, 1e-6, high, 'N'),
        home_time=top.value('home_time', 10.0, 0.5, 120.0, 's'),
        tendons=read_tendons(top, robot, mode, calibrated),
    )


def limits(config: Config, robot: Robot, mode: str) -> tuple[Array, Array]:
    """Return command limits, shape (m, 2), and rates, shape (m,), in the unit of the mode."""
    if mode == 'tension':
        rows = [(robot.tension_limits[0], tendon.tension_limit) for tendon in config.tendons]
        return np.array(rows), np.full(len(rows), config.tension_rate)
    rows = [tendon.pull_limits for tendon in config.tendons]
    return np.array(rows), np.full(len(rows), config.pull_rate)
