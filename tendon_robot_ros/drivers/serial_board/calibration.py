"""
Calibrate a load cell: hang known weights on it, fit counts over tension by a straight line.

Least squares of counts = zero + tension / newtons_per_count over the weights, nothing hung being
the first; the standard errors are those of the usual linear regression.
"""

from __future__ import annotations

import datetime
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...common.errors import DriverError, InputError
from ..interface import Array
from ..ports import PortLostError
from . import messages
from .config import BoardConfig, Cell
from .link import BoardLink, identify, wait_for
from .messages import Message

SAMPLE_S = 0.0125  # [s] between two values of an HX711
WEIGHTS_MIN = 3  # nothing hung included
VALUES_MIN = 5
SETTLE_S = 0.2  # [s] not counted: values from before the weight hung


@dataclass(frozen=True)
class CountsPoint:
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
    tensions = np.array([point.tension for point in points])
    counts = np.array([point.mean for point in points])
    different = len(set(tensions.tolist()))
    if different < WEIGHTS_MIN:
        raise InputError(
            f'calibration: expected at least {WEIGHTS_MIN - 1} different weights besides '
            f'none, got {different - 1}'
        )
    (slope, zero), factors = np.polyfit(tensions, counts, 1, cov='unscaled')
    rest = counts - zero - slope * tensions
    noise = math.sqrt(float(np.mean([point.spread**2 for point in points])))
    scatter = max(math.sqrt(float(rest @ rest) / max(1, len(points) - 2)), noise)
    if abs(slope) * float(np.ptp(tensions)) < 5.0 * scatter or slope == 0.0:
        raise InputError(
            f'calibration: the counts do not follow the weight ({slope:.3g} counts/N, scatter '
            f'{scatter:.3g} counts); does it hang on the load cell of this channel?'
        )
    errors = scatter * np.sqrt(np.diag(factors))
    return Cell(
        zero=float(zero),
        newtons_per_count=float(1.0 / slope),
        zero_error=float(errors[1]),
        slope_error=float(errors[0] / slope**2),
        scatter=scatter,
    )


def to_mapping(cell: Cell, points: Sequence[CountsPoint]) -> dict[str, Any]:
    """Return what is written to the calibration file for one tendon."""
    heaviest = max(point.tension for point in points)
    return {
        'zero': round(cell.zero, 1),
        'newtons_per_count': float(f'{cell.newtons_per_count:.8g}'),
        'zero_error': round(cell.zero_error, 2),
        'slope_error': float(f'{cell.slope_error:.3g}'),
        'scatter': round(cell.scatter, 2),
        'uncertainty': float(f'{cell.uncertainty(np.array(heaviest)):.3g}'),
        'tensions': [round(point.tension, 4) for point in points],
        'date': datetime.date.today().isoformat(),
    }


def connect(config: BoardConfig) -> tuple[BoardLink, int]:
    """Open the port and ask who is there; return the link and the number of channels."""
    link = BoardLink(config.port, config.baud)
    link.open()
    try:
        return link, identify(link, config).channels
    except (DriverError, PortLostError) as error:
        link.close()
        raise DriverError(str(error)) from None


def measure(
    link: BoardLink, channels: int, channel: int, tension: float, seconds: float
) -> CountsPoint:
    """
    Read a load cell for some seconds; the motors stay as they are.

    Parameters
    ----------
    link : BoardLink
    channels : int
        Of the board.
    channel : int
        The one whose cell is read.
    tension : float
        Weight of what hangs on it [N].
    seconds : float

    Raises
    ------
    DriverError
        The board does not answer, or the cell is saturated.

    """
    values = _counts(link, channels, channel, seconds)
    values = values[np.append(True, np.diff(values) != 0.0)]  # the same value, asked for twice
    if len(values) < VALUES_MIN:
        raise DriverError(f'{link.path}: channel {channel}: no values of its load cell')
    if np.max(np.abs(values)) >= messages.CELL_COUNTS_MAX:
        raise DriverError(f'{link.path}: channel {channel}: load cell saturated; less weight')
    spread = float(values.std(ddof=1))
    noise = 1.05 * float(np.median(np.abs(np.diff(values))))  # 1 sd, of any that hangs still
    if spread > 4.0 * noise + 5.0:
        raise DriverError(
            f'{link.path}: channel {channel}: the weight does not hang still: {spread:.0f} counts '
            f'(1 sd), the noise is {noise:.0f}; begin again'
        )
    return CountsPoint(tension, float(values.mean()), spread)


def _counts(link: BoardLink, channels: int, channel: int, seconds: float) -> Array:
    counts: list[float] = []
    began = time.monotonic()
    try:
        while (passed := time.monotonic() - began) < SETTLE_S + seconds:
            link.send(Message.RAW)
            for frame in wait_for(link, Message.RAW_CELLS, 0.1):
                cells = messages.read_cells(frame, channels)
                if cells is not None and passed > SETTLE_S:
                    counts.append(float(cells[channel]))
            time.sleep(SAMPLE_S)
    except PortLostError as error:
        raise DriverError(f'{error}: lost while calibrating') from None
    return np.array(counts)
