"""The driver's configuration: motors, spools, limits; checked on reading (docs/dynamixel.md)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...exceptions import DriverError
from ...robot import Robot
from ..fields import Fields
from ..interface import Array
from .tables import BAUD_RATES
from .wires import WireConfig, read_wires

KEYS = (
    'port',
    'baudrate',
    'model',
    'spool_radius',
    'watchdog',
    'answer_time',
    'tension_rate',
    'pull_rate',
    'pull_limits',
    'current_limit',
    'pull_operation',
    'zero',
    'home_tension',
    'home_speed',
    'home_travel',
    'temperature_margin',
    'allow_coarse',
    'allow_latency',
    'calibration',
    'motors',
)
OPERATIONS = ('current_based', 'extended')
ZEROS = ('find', 'here')


@dataclass(frozen=True)
class Config:
    """Everything the driver needs to know; SI units."""

    source: str
    port: str
    baud: int
    watchdog: float  # [s], 0 = off
    answer_time: float  # [s]
    operation: str  # in pull mode: 'current_based' or 'extended'
    zero: str  # 'find' slack at enabling, or 'here': pull 0 is where it is enabled
    home_tension: float  # [N]
    home_speed: float  # [m/s]
    home_travel: float  # [m]
    margin: float  # [°C] below the motor's own limit at which the arm is released
    allow_coarse: bool
    allow_latency: bool
    wires: tuple[WireConfig, ...]

    @property
    def ids(self) -> tuple[int, ...]:
        """Ids of the servos, each once."""
        return tuple(dict.fromkeys(wire.motor for wire in self.wires))

    def on(self, identity: int) -> tuple[WireConfig, ...]:
        """Return the wires of one servo."""
        return tuple(wire for wire in self.wires if wire.motor == identity)


def read_config(robot: Robot, content: Mapping[str, Any], mode: str, source: str) -> Config:
    """
    Check a configuration for a robot.

    Raises
    ------
    DriverError
        With file, key, what was expected and what came; also when tension by current is coarse.

    """
    top = Fields(source, '', dict(content))
    top.only(*KEYS)
    zero = top.choice('zero', ZEROS, 'find' if mode == 'pull' else 'here')
    lowest = max(robot.tension_limits[0], 0.02 * robot.tension_limits[1])
    config = Config(
        source=source,
        port=top.port(),
        baud=_baud(top),
        watchdog=top.value('watchdog', 0.2, 0.0, 2.54, 's'),
        answer_time=top.value('answer_time', 0.012, 0.001, 0.1, 's'),
        operation=top.choice('pull_operation', OPERATIONS, OPERATIONS[0]),
        zero=zero,
        home_tension=top.value('home_tension', lowest, 1e-6, robot.tension_limits[1], 'N'),
        home_speed=top.value('home_speed', 0.005, 1e-5, 0.1, 'm/s'),
        home_travel=top.value('home_travel', 0.05, 1e-4, 1.0, 'm'),
        margin=top.value('temperature_margin', 5.0, 0.0, 50.0, '°C'),
        allow_coarse=top.flag('allow_coarse'),
        allow_latency=top.flag('allow_latency'),
        wires=read_wires(top, robot, mode),
    )
    _check_sharing(top, config, mode)
    if mode == 'tension':
        refuse_coarse(config)
    return config


def refuse_coarse(config: Config) -> None:
    """Refuse tensions by current where a count or the friction is too large for them."""
    if config.allow_coarse:
        return
    for wire in config.wires:
        if wire.resolution.coarse:
            raise DriverError(
                f'{config.source}: motors.{wire.name}: tension by current is too coarse: '
                f'{wire.resolution}; wanted: at least 20 counts and at most 20 %; use '
                'command_mode: pull, a larger spool or a lighter motor, calibrate it, or set '
                'allow_coarse: true'
            )


def _baud(top: Fields) -> int:
    value = top.content.get('baudrate', 1_000_000)
    if value not in BAUD_RATES.values():
        raise top.error('baudrate', f'one of {", ".join(map(str, BAUD_RATES.values()))}', value)
    return int(value)


def _check_sharing(top: Fields, config: Config, mode: str) -> None:
    for identity in config.ids:
        wires = config.on(identity)
        names = ' and '.join(wire.name for wire in wires)
        if len(wires) > 1 and mode == 'tension':
            raise top.error(
                'motors',
                'a motor of its own for every input in tension mode',
                f'id {identity} for {names}; use command_mode: pull',
            )
        if len({wire.model.name for wire in wires}) > 1:
            raise top.error('motors', f'one model for id {identity}', names)
        if abs(sum(wire.share for wire in wires) - 1.0) > 1e-6:
            raise top.error(
                'motors',
                f'shares of id {identity} that add up to 1',
                [wire.share for wire in wires],
            )


def limits(config: Config, robot: Robot, mode: str) -> tuple[Array, Array]:
    """Return command limits, shape (m, 2), and rates, shape (m,), in the unit of the mode."""
    low = robot.tension_limits[0]
    rows = [
        (low, wire.tension_limit) if mode == 'tension' else wire.pull_limits
        for wire in config.wires
    ]
    return np.array(rows), np.array([wire.rate for wire in config.wires])
