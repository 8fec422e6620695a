"""
The driver's configuration: motors, spools, limits (docs/dynamixel.md); calibration of a motor.

A geared motor shows its friction with both signs: winding needs I = a_wind + b_wind T, paying out
I = a_out + b_out T. Each line is fitted by least squares over known weights; the standard errors
are those of the usual linear regression.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, NamedTuple

import numpy as np

from ...common.errors import DriverError, InputError
from ...common.yaml_reading import ConfigFields, in_range, one_of
from ...robot import Robot
from .. import hardware
from .control_table import BAUD_RATES, INSTEAD, MODELS, WITHOUT_CURRENT, Counts, ServoModel

# [counts] of current from no tension to the limit; else one count would be more than 5 % of it
CURRENT_COUNTS_MIN = 20
# [1] of the tension limit; docs/dynamixel.md: else friction would hide too much of a command
FRICTION_BAND_MAX = 0.20


class CurrentLine(hardware.LineFit):
    """Current over tension: intercept [A] and slope [A/N], with their standard errors."""

    def current(self, tension: float) -> float:
        """Return the current [A] at a tension [N]."""
        return self.intercept + self.slope * tension

    def tension(self, current: float) -> float:
        """Return the tension [N] at a current [A]: never negative."""
        return max(0.0, (current - self.intercept) / self.slope)


class Calibration(NamedTuple):
    """
    Current over tension: one line for winding and one for paying out.

    A geared motor needs more current to wind than to hold, and less to pay out. The mean of both
    lines converts; half the gap between them is the uncertainty.

    Parameters
    ----------
    wind, pay_out : CurrentLine
    measured : bool
        False for the data sheet's torque per ampere and an assumed friction.
    scatter : float
        Standard deviation of the currents about their lines [A].

    """

    wind: CurrentLine
    pay_out: CurrentLine
    measured: bool = False
    scatter: float = 0.0

    @property
    def mean(self) -> CurrentLine:
        """The line between the two."""
        return CurrentLine(
            0.5 * (self.wind.intercept + self.pay_out.intercept),
            0.5 * (self.wind.slope + self.pay_out.slope),
        )

    def uncertainty(self, tension: float) -> float:
        """Return half the gap between the two lines at a tension, with their scatter [N]."""
        half = 0.5 * abs(self.wind.current(tension) - self.pay_out.current(tension))
        return math.hypot(half, self.scatter) / self.mean.slope


def from_data_sheet(model: ServoModel, radius: float) -> Calibration:
    """Make the lines of an uncalibrated motor with a spool of the given radius [m]."""
    slope = radius / model.torque_per_ampere
    friction = model.friction_current
    return Calibration(CurrentLine(friction, slope), CurrentLine(-friction, slope))


class Resolution:
    """
    Resolution and friction band of a tension that a motor sets by current.

    Attributes
    ----------
    newtons_per_count : float
    counts : int
        From no tension to the limit.
    band : float
        Friction: largest error of the tension, up or down [N].
    limit : float
        The tension limit [N].

    """

    def __init__(self, calibration: Calibration, model: ServoModel, limit: float) -> None:
        """Take the calibration of a motor and the tension limit [N]."""
        self.newtons_per_count = model.current_unit / calibration.mean.slope
        self.counts = math.floor(limit / self.newtons_per_count + 1e-9)
        self.band, self.limit = calibration.uncertainty(limit), limit

    @property
    def coarse(self) -> bool:
        """Whether it is too coarse to command tensions by current."""
        return self.counts < CURRENT_COUNTS_MIN or self.band > FRICTION_BAND_MAX * self.limit

    def __str__(self) -> str:
        """Return the numbers as text."""
        return (
            f'one count of current is {self.newtons_per_count:.3g} N ({self.counts} counts '
            f'up to {self.limit:g} N), the friction band is ±{self.band:.3g} N '
            f'({100 * self.band / self.limit:.0f} % of the limit)'
        )


def smallest_spool(model: ServoModel, limit: float) -> float:
    """Return the smallest spool radius [m], in whole mm, with enough resolution by data sheet."""
    friction = model.friction_current * model.torque_per_ampere  # [N·m]
    count = model.current_unit * model.torque_per_ampere  # [N·m]
    smallest = max(friction / (FRICTION_BAND_MAX * limit), CURRENT_COUNTS_MIN * count / limit)
    return math.ceil(1e3 * smallest + 0.5) / 1e3


class CurrentPoint(NamedTuple):
    """Currents with one weight on the wire: mean while winding and while paying out [A]."""

    tension: float  # [N]
    wind: float
    pay_out: float


def fit_current(points: Sequence[CurrentPoint]) -> Calibration:
    """
    Fit the two lines.

    Raises
    ------
    InputError
        Fewer than three weights, or currents that do not grow with the weight.

    """
    tensions, *currents = np.reshape(points, (-1, 3)).T
    if (different := len(np.unique(tensions))) < hardware.WEIGHTS_MIN:
        raise InputError(
            f'calibration: expected at least {hardware.WEIGHTS_MIN} different weights, '
            f'got {different}'
        )
    wind, pay_out = (CurrentLine(*hardware.fit_line(tensions, measured)) for measured in currents)
    for name, line in (('wind', wind), ('pay_out', pay_out)):
        if line.slope <= 0.0:
            raise InputError(
                f'calibration: {name}: the current does not grow with the weight '
                f'({line.slope:.3g} A/N); does the weight hang free?'
            )
    return Calibration(wind, pay_out, measured=True, scatter=max(wind.scatter, pay_out.scatter))


def to_mapping(
    lines: Calibration, points: Sequence[CurrentPoint], model: str, radius: float
) -> dict[str, Any]:
    """Return the calibration file's content for one tendon, with its motor and spool [m]."""
    wind, pay_out = ([round(v, 7) for v in line] for line in (lines.wind, lines.pay_out))
    tensions = [point.tension for point in points]
    return {
        'wind': wind[:2],
        'wind_errors': wind[2:4],
        'pay_out': pay_out[:2],
        'pay_out_errors': pay_out[2:4],
        'scatter': round(lines.scatter, 7),
        'half_gap': round(lines.uncertainty(max(tensions)), 4),
        'model': model,
        'spool_radius': radius,
        'tensions': [round(tension, 4) for tension in tensions],
        'date': datetime.date.today().isoformat(),
    }


# keys of a motor that hold for all motors where they stand at the top of the file
COMMON_KEYS = (
    'model',
    'spool_radius',
    'current_limit',
    'pull_limits',
    'tension_rate',
    'pull_rate',
    'calibration',
)
MOTOR_KEYS = ('id', 'direction', 'share', 'tension_limit', *COMMON_KEYS)


@dataclass(frozen=True)
class MotorWire(hardware.WireConfig):
    """
    One input and its motor.

    Parameters
    ----------
    motor : int
        Servo id.
    model : ServoModel
    share : float
        Weight of this input in the position of a motor that several inputs share.
    current_limit : float
        [A]
    calibration : Calibration
    """

    motor: int
    model: ServoModel
    share: float
    current_limit: float
    calibration: Calibration

    @property
    def resolution(self) -> Resolution:
        """Resolution of this wire's tension by the motor's current."""
        return Resolution(self.calibration, self.model, self.tension_limit)


def read_wires(top: ConfigFields, robot: Robot, mode: str) -> tuple[MotorWire, ...]:
    """Read the motor of every input of the robot."""
    items = hardware.fields_of_inputs(top, 'motors', 'a motor', robot)
    lines = hardware.read_calibrations(top, required=True)
    shared = [item.content.get('id') for item in items.values()]
    rate = 'pull_rate', 1e-6, 1.0, 'm/s', 0.02  # key, lowest, highest, unit, default
    if mode == 'tension':
        rate = 'tension_rate', 1e-6, 1e4, 'N/s', 2.0 * robot.tension_limits[1]
    wires = []
    for name, item in items.items():
        item.only(*MOTOR_KEYS)
        identity = item.whole('id', 0, 252)
        model = read_model(hardware.nearest(item, top, 'model'))
        radius = hardware.read_spool_radius(item, top)
        calibration = from_data_sheet(model, radius)
        if lines.has(name) or item.has('calibration'):
            source = item.child('calibration') if item.has('calibration') else lines.child(name)
            calibration = read_calibration(source, model, radius)
        largest = model.current_limit * model.current_unit
        limited = hardware.nearest(item, top, 'current_limit')
        direction = hardware.read_direction(item, 'counter-clockwise winds')
        wires.append(
            MotorWire(
                name,
                hardware.Spool(radius, direction, Counts.TICKS_PER_TURN),
                **hardware.read_wire_limits(item, top, robot, mode),
                rate=hardware.nearest(item, top, rate[0]).number(*rate),
                motor=identity,
                model=model,
                share=item.number('share', 0.0, 1.0, default=1.0 / shared.count(identity)),
                current_limit=limited.number(
                    'current_limit', model.current_unit, largest, 'A', largest
                ),
                calibration=calibration,
            )
        )
    return tuple(wires)


def read_model(fields: ConfigFields) -> ServoModel:
    """Return a motor by the name on its label; the error lists the known ones."""
    label = str(fields.content.get('model', '')).strip().upper()
    name = label.removesuffix('-T').removesuffix('-R')
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
    if abs(item.number('spool_radius', 0.0, 1.0, 'm', radius) / radius - 1.0) > 0.01:
        raise item.error(
            'spool_radius', f'{radius:g} m: calibrate again', item.content['spool_radius']
        )
    scatter = item.number('scatter', 0.0, 10.0, 'A', 0.0)
    return Calibration(wind, pay_out, measured=True, scatter=scatter)


@dataclass(frozen=True, kw_only=True)
class DynamixelConfig(hardware.PortConfig):
    """Checked configuration of the driver, by the keys of its file; SI units."""

    # 0 = off, None = by the scheduling of the caller
    watchdog: Annotated[float | None, in_range(0.0, 2.54, 's')] = None
    answer_time: Annotated[float, in_range(0.001, 0.1, 's')] = 0.012
    # in pull mode
    pull_operation: Annotated[str, one_of('current_based', 'extended')] = 'current_based'
    # of the search for slack
    home_speed: Annotated[float, in_range(1e-5, 0.1, 'm/s')] = 0.005
    # below the motor's own limit at which the arm is released
    temperature_margin: Annotated[float, in_range(0.0, 50.0, '°C')] = 5.0
    allow_coarse: Annotated[bool, ConfigFields.flag] = False
    allow_latency: Annotated[bool, ConfigFields.flag] = False
    motors: tuple[MotorWire, ...]  # of every input

    @property
    def by_id(self) -> dict[int, tuple[MotorWire, ...]]:
        """The wires of every servo, by its id."""
        ids = dict.fromkeys(wire.motor for wire in self.motors)
        return {i: tuple(wire for wire in self.motors if wire.motor == i) for i in ids}


KEYS = (*(field.name for field in fields(DynamixelConfig)), *COMMON_KEYS)


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
    config = DynamixelConfig(
        **hardware.read_port_config(top, robot, mode, tuple(BAUD_RATES.values()), slack=0.02),
        **top.fields(DynamixelConfig),
        motors=read_wires(top, robot, mode),
    )
    for identity, wires in config.by_id.items():
        names = ' and '.join(wire.name for wire in wires)
        if len(wires) > 1 and mode == 'tension':
            raise top.error(
                'motors',
                'a motor of its own for every input in tension mode',
                f'id {identity} for {names}; use command_mode: pull',
            )
        if len({wire.model.name for wire in wires}) > 1:
            raise top.error('motors', f'one model for id {identity}', names)
        shares = [wire.share for wire in wires]
        if abs(sum(shares) - 1.0) > 1e-6:
            raise top.error('motors', f'shares of id {identity} that add up to 1', shares)
    for wire in config.motors:
        if mode == 'tension' and wire.resolution.coarse and not config.allow_coarse:
            raise DriverError(
                f'{source}: motors.{wire.name}: tension by current is too coarse: '
                f'{wire.resolution}; wanted: at least {CURRENT_COUNTS_MIN} counts and at most '
                f'{100 * FRICTION_BAND_MAX:.0f} %; use '
                'command_mode: pull, a larger spool or a lighter motor, calibrate it, or set '
                'allow_coarse: true'
            )
    return config
