"""The driver's configuration: motors, spools, limits, calibration (docs/dynamixel.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...common.errors import DriverError
from ...common.yaml_reading import ConfigFields
from ...robot import Robot
from ..hardware import (
    fields_of_inputs,
    nearest,
    read_calibrations,
    read_direction,
    read_pull_limits,
    read_spool_radius,
)
from ..interface import Array
from .calibration import (
    CURRENT_COUNTS_MIN,
    FRICTION_BAND_MAX,
    Calibration,
    CurrentLine,
    Resolution,
    Spool,
    from_data_sheet,
    resolution,
)
from .control_table import BAUD_RATES, INSTEAD, MODELS, WITHOUT_CURRENT, ServoModel, plain_model

MOTOR_KEYS = (
    'id',
    'model',
    'spool_radius',
    'direction',
    'share',
    'tension_limit',
    'current_limit',
    'pull_limits',
    'tension_rate',
    'pull_rate',
    'calibration',
)


@dataclass(frozen=True)
class WireConfig:
    """
    One input: its motor, spool and limits.

    Parameters
    ----------
    name : str
    motor : int
        Servo id.
    model : ServoModel
    spool : Spool
    share : float
        Weight of this input in the position of a motor that several inputs share.
    tension_limit : float
        [N]
    current_limit : float
        [A]
    pull_limits : tuple of float
        [m]
    rate : float
        Fastest change of the command, [N/s] or [m/s] by the mode.
    calibration : Calibration
    """

    name: str
    motor: int
    model: ServoModel
    spool: Spool
    share: float
    tension_limit: float
    current_limit: float
    pull_limits: tuple[float, float]
    rate: float
    calibration: Calibration

    @property
    def resolution(self) -> Resolution:
        """Resolution of this wire's tension by the motor's current."""
        return resolution(self.calibration, self.model, self.tension_limit)


def read_wires(top: ConfigFields, robot: Robot, mode: str) -> tuple[WireConfig, ...]:
    """Read the motor of every input of the robot."""
    fields = fields_of_inputs(top, 'motors', 'a motor', robot)
    lines = read_calibrations(top, required=True)
    sharing = [item.content.get('id') for item in fields.values()]
    return tuple(
        read_wire(top, name, item, lines, robot, mode, sharing) for name, item in fields.items()
    )


def read_wire(
    top: ConfigFields,
    name: str,
    item: ConfigFields,
    lines: ConfigFields,
    robot: Robot,
    mode: str,
    sharing: list[Any],
) -> WireConfig:
    """Read one input; `sharing` lists the ids of all motors, as often as they have inputs."""
    item.only(*MOTOR_KEYS)
    identity = item.whole('id', 0, 252)
    model = read_model(nearest(item, top, 'model'))
    direction = read_direction(item, 'counter-clockwise winds')
    spool = Spool(read_spool_radius(item, top), direction)
    calibration = from_data_sheet(model, spool.radius)
    if lines.has(name) or item.has('calibration'):
        source = lines.child(name) if lines.has(name) else item.child('calibration')
        calibration = read_calibration(source, model, spool.radius)
    largest = model.current_limit * model.current_unit
    lowest, highest = robot.tension_limits
    limited = nearest(item, top, 'pull_limits')
    pull_limits = -math.inf, math.inf
    if limited.has('pull_limits') or mode == 'pull':
        pull_limits = read_pull_limits(limited)
    if mode == 'tension':
        fields, default = nearest(item, top, 'tension_rate'), 2.0 * highest
        rate = fields.value('tension_rate', default, 1e-6, 1e4, 'N/s')
    else:
        rate = nearest(item, top, 'pull_rate').value('pull_rate', 0.02, 1e-6, 1.0, 'm/s')
    return WireConfig(
        name=name,
        motor=identity,
        model=model,
        spool=spool,
        share=item.value('share', 1.0 / sharing.count(identity), 0.0, 1.0, '1'),
        tension_limit=item.value('tension_limit', highest, lowest + 1e-6, highest, 'N'),
        current_limit=nearest(item, top, 'current_limit').value(
            'current_limit', largest, model.current_unit, largest, 'A'
        ),
        pull_limits=pull_limits,
        rate=rate,
        calibration=calibration,
    )


def read_model(fields: ConfigFields) -> ServoModel:
    """Return a motor by the name on its label; the error lists the known ones."""
    name = plain_model(str(fields.content.get('model', '')))
    if name in WITHOUT_CURRENT.values():
        raise fields.error('model', INSTEAD, name)
    return MODELS[name] if name in MODELS else MODELS[fields.choice('model', tuple(MODELS))]


def read_calibration(item: ConfigFields, model: ServoModel, radius: float) -> Calibration:
    """Read the two lines of one motor, `wind` and `pay_out`, each [A, A/N]."""
    wind, pay_out = (CurrentLine(*item.vector(key, 2)) for key in ('wind', 'pay_out'))
    for key, line in (('wind', wind), ('pay_out', pay_out)):
        if not 1e-6 < line.slope < 1e3:
            raise item.error(key, '[intercept A, slope A/N] with a slope above 0', item.content)
    if item.content.get('model', model.name) != model.name:
        raise item.error('model', f'{model.name}: calibrate again', item.content['model'])
    if abs(item.value('spool_radius', radius, 0.0, 1.0, 'm') / radius - 1.0) > 0.01:
        raise item.error(
            'spool_radius', f'{radius:g} m: calibrate again', item.content['spool_radius']
        )
    scatter = item.value('scatter', 0.0, 0.0, 10.0, 'A')
    return Calibration(wind, pay_out, measured=True, scatter=scatter)


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
class DynamixelConfig:
    """Checked configuration of the driver; SI units."""

    source: str
    port: str
    baud: int
    watchdog: float | None  # [s], 0 = off, None = by the scheduling of the caller
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


def read_config(
    robot: Robot, content: Mapping[str, Any], mode: str, source: str
) -> DynamixelConfig:
    """
    Check a configuration for a robot.

    Raises
    ------
    DriverError
        With file, key, what was expected and what came; also when tension by current is coarse.

    """
    top = ConfigFields(source, '', dict(content))
    top.only(*KEYS)
    baud = top.content.get('baudrate', 1_000_000)
    if baud not in BAUD_RATES.values():
        raise top.error('baudrate', f'one of {", ".join(map(str, BAUD_RATES.values()))}', baud)
    zero = top.choice('zero', ZEROS, 'find' if mode == 'pull' else 'here')
    lowest = max(robot.tension_limits[0], 0.02 * robot.tension_limits[1])
    config = DynamixelConfig(
        source=source,
        port=top.port(),
        baud=int(baud),
        watchdog=top.value('watchdog', 0.0, 0.0, 2.54, 's') if top.has('watchdog') else None,
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
    check_sharing(top, config, mode)
    if mode == 'tension':
        refuse_coarse(config)
    return config


def refuse_coarse(config: DynamixelConfig) -> None:
    """Refuse tensions by current where a count or the friction band is too large."""
    if config.allow_coarse:
        return
    for wire in config.wires:
        if wire.resolution.coarse:
            raise DriverError(
                f'{config.source}: motors.{wire.name}: tension by current is too coarse: '
                f'{wire.resolution}; wanted: at least {CURRENT_COUNTS_MIN} counts and at most '
                f'{100 * FRICTION_BAND_MAX:.0f} %; use '
                'command_mode: pull, a larger spool or a lighter motor, calibrate it, or set '
                'allow_coarse: true'
            )


def check_sharing(top: ConfigFields, config: DynamixelConfig, mode: str) -> None:
    """Refuse motors that inputs cannot share."""
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


def limits(config: DynamixelConfig, robot: Robot, mode: str) -> tuple[Array, Array]:
    """Return command limits, shape (m, 2), and rates, shape (m,), in the unit of the mode."""
    low = robot.tension_limits[0]
    rows = [
        (low, wire.tension_limit) if mode == 'tension' else wire.pull_limits
        for wire in config.wires
    ]
    return np.array(rows), np.array([wire.rate for wire in config.wires])
