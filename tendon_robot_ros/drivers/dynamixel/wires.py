"""The wires of the configuration: motor, spool, limits and calibration of every input."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...robot import Robot
from ...robot_checks import parse_yaml
from ..fields import Fields
from .tables import MODELS, Model
from .units import Calibration, Line, Resolution, Spool, from_data_sheet, resolution

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
PULL_RATE = 'pull_rate', 0.02, 1e-6, 1.0, 'm/s'


@dataclass(frozen=True)
class WireConfig:
    """
    One input: its motor, spool and limits.

    Parameters
    ----------
    name : str
    motor : int
        Servo id.
    model : Model
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
        Fastest change of the command, [N/s] or [m/s] as the mode says.
    calibration : Calibration
    """

    name: str
    motor: int
    model: Model
    spool: Spool
    share: float
    tension_limit: float
    current_limit: float
    pull_limits: tuple[float, float]
    rate: float
    calibration: Calibration

    @property
    def resolution(self) -> Resolution:
        """How finely this motor sets this wire's tension."""
        return resolution(self.calibration, self.model, self.tension_limit)


def read_wires(top: Fields, robot: Robot, mode: str) -> tuple[WireConfig, ...]:
    """Read the motor of every input of the robot."""
    motors = top.child('motors')
    motors.only(*robot.inputs)
    lines = _calibrations(top)
    missing = [name for name in robot.inputs if not motors.has(name)]
    if missing:
        raise top.error(
            'motors', 'a motor for every input of the robot', f'none for {", ".join(missing)}'
        )
    sharing = [motors.child(name).content.get('id') for name in robot.inputs]
    return tuple(_wire(top, name, lines, robot, mode, sharing) for name in robot.inputs)


def _wire(
    top: Fields, name: str, lines: Fields, robot: Robot, mode: str, sharing: list[Any]
) -> WireConfig:
    item = top.child('motors').child(name)
    item.only(*MOTOR_KEYS)
    identity = item.content.get('id')
    if isinstance(identity, bool) or not isinstance(identity, int) or not 0 <= identity <= 252:
        raise item.error('id', 'a whole number from 0 to 252', identity)
    where = item if item.has('model') else top
    model = MODELS[where.choice('model', tuple(MODELS))]
    where = item if item.has('spool_radius') else top
    spool = Spool(where.number('spool_radius', 5e-4, 0.2, 'm'), _direction(item))
    calibration = from_data_sheet(model, spool.radius)
    if lines.has(name) or item.has('calibration'):
        found = lines.child(name) if lines.has(name) else item.child('calibration')
        calibration = read_calibration(found, model, spool.radius)
    most = model.current_limit * model.current_unit
    lowest, highest = robot.tension_limits
    where = item if item.has('current_limit') else top
    return WireConfig(
        name=name,
        motor=identity,
        model=model,
        spool=spool,
        share=item.value('share', 1.0 / sharing.count(identity), 0.0, 1.0, '1'),
        tension_limit=item.value('tension_limit', highest, lowest + 1e-6, highest, 'N'),
        current_limit=where.value('current_limit', most, model.current_unit, most, 'A'),
        pull_limits=_pull_limits(top, item, mode),
        rate=_rate(top, item, highest, mode),
        calibration=calibration,
    )


def _direction(item: Fields) -> int:
    value = item.content.get('direction', 1)
    if isinstance(value, bool) or value not in (1, -1):
        raise item.error('direction', '1 (counter-clockwise winds) or -1', value)
    return int(value)


def _rate(top: Fields, item: Fields, highest: float, mode: str) -> float:
    tension = 'tension_rate', 2.0 * highest, 1e-6, 1e4, 'N/s'
    key, default, low, high, unit = tension if mode == 'tension' else PULL_RATE
    return (item if item.has(key) else top).value(key, default, low, high, unit)


def _pull_limits(top: Fields, item: Fields, mode: str) -> tuple[float, float]:
    where = item if item.has('pull_limits') else top
    if not where.has('pull_limits') and mode == 'tension':
        return (-math.inf, math.inf)
    low, high = where.vector('pull_limits', 2)
    if not -1.0 <= low < high <= 1.0:
        raise where.error('pull_limits', '[lowest, highest] [m], lowest < highest', [low, high])
    return low, high


def _calibrations(top: Fields) -> Fields:
    """Open the calibrations: a mapping, or the path of the file that `calibrate` wrote."""
    value = top.content.get('calibration')
    if isinstance(value, str):
        file = Path(top.source).parent / value
        try:
            value = parse_yaml(file.read_text(encoding='utf-8'))
        except (OSError, ValueError) as error:
            raise top.error('calibration', 'a readable YAML file', f'{file}: {error}') from None
        return Fields(str(file), '', value)
    return Fields(top.source, 'calibration', value)


def read_calibration(item: Fields, model: Model, radius: float) -> Calibration:
    """Read the two lines of one motor, `wind` and `pay_out`, each [A, A/N]."""
    wind, pay_out = (Line(*item.vector(key, 2)) for key in ('wind', 'pay_out'))
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
