"""
Measure the friction coefficient between wire and eyelet from slip angles.

SLIP_ANGLES is a CSV file with the columns measurement (a name) and angle_deg: the angle of a
slanted test piece at which the wire slips (Kato et al. 2015, section IV.A). The coefficient is the
tangent. Outliers are named and stay in the mean. With --robot and --output the coefficient is
written into a robot description as tendon_friction.

example: python -m tendon_robot_ros study friction data/slip_angles/scale_10_1.csv
    --robot config/robots/kato_10_1.yaml --output with_friction.yaml
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..cli import options
from ..common.arrays import Floats
from ..common.errors import DataSetError, InputError
from ..common.words import listed
from ..data.csv_file import CsvFile
from ..inference.outliers import TRIALS_MIN
from ..inference.statistics import estimate, normal_ppf
from ..robot import Robot, load_robot

HELP = 'friction coefficient from slip angles, into a robot description'

COLUMNS = ('measurement', 'angle_deg')
# [1] robust standard deviations from the median, of an outlier (Iglewicz and Hoaglin 1993)
OUTLIER_FROM_SD = 3.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add = parser.add_argument
    add('angles', metavar='SLIP_ANGLES', help='CSV file: measurement,angle_deg')
    add('--robot', metavar='ROBOT', help='robot description to write the coefficient into')
    options.add_file(parser, '--output', 'the new description', 'NEW')
    options.declare(parser, '--json', '--overwrite')


def run(args: argparse.Namespace) -> None:
    """Read, compute, write."""
    if (args.robot is None) != (args.output is None):
        raise InputError('friction: --robot and --output go together; give both or neither')
    options.refuse_existing('--output', args.output, args.overwrite)
    friction = SlipFriction(*read_slip_angles(args.angles))
    text = lines(friction)
    if args.output:
        date = datetime.now(UTC).date().isoformat()
        robot = with_friction(load_robot(args.robot), friction, Path(args.angles).name, date)
        options.write_description(robot, args.output)
        text.append(options.next_step(args.output))
    options.emit(args, friction.to_json(), '\n'.join(text))


def lines(friction: SlipFriction) -> list[str]:
    """Say the coefficient, its interval, and the outliers."""
    outliers = 'none'
    if friction.outliers:
        outliers = (
            f'{listed(friction.outliers)}; without them {friction.mean_without:.3f}. '
            'Look at how they were measured; nothing was removed.'
        )
    return [
        f'friction coefficient: {friction.mean:.3f} ± {friction.sd:.3f} '
        f'(mean ± SD of the tangent, n = {friction.n})',
        f'95 % interval of the mean: {friction.low:.3f} to {friction.high:.3f}',
        f'outliers: {outliers}',
    ]


class SlipFriction:
    """
    A friction coefficient [1]: mean and spread of the tangent of slip angles.

    An outlier lies farther from the median than 3.5 robust standard deviations (1.4826 times the
    median deviation; where more than half of the angles are alike, 1.2533 times the mean one). It
    is named, not removed.

    Parameters
    ----------
    names : (n,)
        Of the measurements.
    angles : (n,) [rad]
        At which the wire slips.

    Raises
    ------
    InputError
        There are fewer than three.

    """

    def __init__(self, names: tuple[str, ...], angles: npt.ArrayLike) -> None:
        tangents = np.tan(np.asarray(angles, dtype=float))
        self.n = len(tangents)  # outliers included
        if self.n < TRIALS_MIN:
            expected = f'expected at least {TRIALS_MIN}, got {self.n}'
            raise InputError(f'slip angles: {expected}; measure more')
        mean = estimate(tangents)
        off = np.abs(tangents - np.median(tangents))
        # 1 sd if they are normal
        spread = np.median(off) / normal_ppf(0.75) or np.mean(off) * np.sqrt(0.5 * np.pi)
        far = off > OUTLIER_FROM_SD * spread
        self.mean, self.low, self.high = mean.mean, mean.low, mean.high  # 95 % t-interval
        self.sd = float(tangents.std(ddof=1))  # of one measurement
        self.outliers: tuple[str, ...] = tuple(np.array(names)[far].tolist())
        self.mean_without = float(tangents[~far].mean())  # without the outliers

    def to_json(self) -> dict[str, Any]:
        """Return plain data."""
        return dict(vars(self))


def read_slip_angles(path: str | Path) -> tuple[tuple[str, ...], Floats]:
    """
    Read a CSV file with the columns `measurement` (a name) and `angle_deg`.

    Returns
    -------
    names (n,), angles (n,) [rad]

    Raises
    ------
    DataSetError
        With the row, what is wrong there and what to do.

    """
    remedy = f'name a CSV file with the columns {", ".join(COLUMNS)}'
    file = CsvFile(Path(path), COLUMNS, COLUMNS, 'leave the row out', remedy)
    degrees = file.read(COLUMNS[:1]).numbers['angle_deg']
    for i in np.flatnonzero(~((degrees > 0.0) & (degrees < 90.0))):
        remedy = 'write the slip angle in degrees, between 0 and 90'
        raise file.error(int(i) + 2, f'angle_deg is {degrees[i]:g}', remedy)
    if degrees.max() < 0.5 * np.pi:  # smoother than any wire, and all angles in radians
        problem = f'no angle exceeds {0.5 * np.pi:.2f}°'
        raise DataSetError(str(path), problem, 'write degrees, not radians')
    labels = file.labels['measurement']
    return tuple(labels[code] for code in file.codes['measurement']), np.radians(degrees)


def with_friction(robot: Robot, friction: SlipFriction, data: str, date: str) -> Robot:
    """
    Return the robot with the measured friction, its origin beside it.

    The spread of the mean becomes the declared tolerance of the coefficient.
    """
    value, low, high = (round(x, 4) for x in (friction.mean, friction.low, friction.high))
    interval = {'value': value, 'low': low, 'high': high, 'unit': '1'}
    origin = {'friction_coefficient': interval, 'data': data, 'date': date}
    changed = robot.with_effect('tendon_friction', {'friction_coefficient': value}, origin)
    relative = round((friction.high - friction.low) / (2.0 * 1.96) / friction.mean, 4)
    return replace(changed, tolerances={**robot.tolerances, 'friction_coefficient': relative})
