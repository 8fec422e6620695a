"""The friction coefficient from slip angles (Kato et al. 2015, section IV.A)."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.errors import DataSetError, InputError
from ..comparison.statistics import estimate
from ..data.folder.csv_file import CsvFile
from ..robot import Robot
from ..robot.description import EffectValues

COLUMNS = ('measurement', 'angle_deg')
# robust standard deviations from the median: an outlier (Iglewicz and Hoaglin 1993)
OUTLIER_FROM_SD = 3.5
ANGLES_MIN = 3


@dataclass(frozen=True)
class SlipFriction:
    """A friction coefficient [1]: the tangent of the angle at which a wire slips."""

    mean: float
    sd: float  # of one measurement
    low: float  # 95 % t-interval of the mean
    high: float
    n: int  # outliers included
    outliers: tuple[str, ...]  # names of the measurements
    mean_without: float  # without the outliers

    def to_json(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self)


def read_slip_angles(path: str | Path) -> tuple[tuple[str, ...], npt.NDArray[np.float64]]:
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
    table = file.read(COLUMNS[:1], COLUMNS[1:])
    degrees = table.numbers['angle_deg']
    for i in np.flatnonzero(~((degrees > 0.0) & (degrees < 90.0))):
        raise file.error(
            int(i) + 2,
            f'angle_deg is {degrees[i]:g}',
            'write the slip angle in degrees, between 0 and 90',
        )
    if np.degrees(np.arctan(1.0)) > 20.0 * degrees.max():
        raise DataSetError(str(path), 'no angle exceeds 2.25°', 'write degrees, not radians')
    labels = table.labels['measurement']
    return tuple(labels[code] for code in table.codes['measurement']), np.radians(degrees)


def slip_friction(names: tuple[str, ...], angles: npt.ArrayLike) -> SlipFriction:
    """
    Return mean and spread of the tangent of slip angles (n,) [rad].

    An outlier lies farther from the median than 3.5 robust standard deviations (1.4826 times the
    median deviation). It is named, not removed.

    Raises
    ------
    InputError
        There are fewer than three.

    """
    tangents = np.tan(np.asarray(angles, dtype=float))
    if len(tangents) < ANGLES_MIN:
        raise InputError(
            f'slip angles: expected at least {ANGLES_MIN}, got {len(tangents)}; measure more'
        )
    mean = estimate(tangents)
    away = np.abs(tangents - np.median(tangents))
    spread = 1.4826 * float(np.median(away))
    far = away > OUTLIER_FROM_SD * spread if spread > 0.0 else np.zeros(len(away), dtype=bool)
    return SlipFriction(
        mean=mean.mean,
        sd=float(tangents.std(ddof=1)),
        low=mean.low,
        high=mean.high,
        n=len(tangents),
        outliers=tuple(np.array(names)[far].tolist()),
        mean_without=float(tangents[~far].mean()),
    )


def with_friction(robot: Robot, friction: SlipFriction, data: str, date: str) -> Robot:
    """
    Return the robot with the measured friction, its origin beside it.

    The spread of the mean becomes the declared tolerance of the coefficient.
    """
    origin = {
        'friction_coefficient': {
            'value': round(friction.mean, 4),
            'low': round(friction.low, 4),
            'high': round(friction.high, 4),
            'unit': '1',
        },
        'data': data,
        'date': date,
    }
    values: EffectValues = {'friction_coefficient': round(friction.mean, 4)}
    made = robot.with_effect('tendon_friction', values, origin)
    relative = round((friction.high - friction.low) / 3.92 / friction.mean, 4)
    return replace(made, tolerances={**robot.tolerances, 'friction_coefficient': relative})


# -----------------------------------------------------------------------------
# Friction coefficients (section IV.A), rehearsed: the measured slip angles are not printed.

PUBLISHED_FRICTION = {'2:1': (0.31, 18), '10:1': (0.33, 30)}  # scale: coefficient, measurements
ANGLE_SD = 0.03  # [1] of one measurement: assumed, Table II is lost
ANGLE_READING_DEG = 0.1  # [°] of the rotational stage: assumed


def rehearsals(seed: int = 0) -> dict[str, SlipFriction]:
    """Draw slip angles of the published coefficients and evaluate them, scale by scale."""
    frictions = {}
    for scale, (coefficient, n) in PUBLISHED_FRICTION.items():
        random = np.random.default_rng([seed, n])
        degrees = np.degrees(np.arctan(coefficient + ANGLE_SD * random.normal(size=n)))
        angles = np.radians(np.round(degrees / ANGLE_READING_DEG) * ANGLE_READING_DEG)
        frictions[scale] = slip_friction(tuple(map(str, range(1, n + 1))), angles)
    return frictions
