"""Numbers as figures carry them and as people read them: rounded, in the unit that suits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.words import digits, scale_of, spoken, with_unit
from ..diagnosis.result import LoadVector, Value


def plain(values: npt.ArrayLike, scale: float = 1.0, places: int = 4) -> list[float | None]:
    """Return numbers (n,) times a scale, rounded; None for NaN."""
    array = np.round(np.asarray(values, dtype=float) * scale, places)
    return [float(value) if np.isfinite(value) else None for value in array]


TICKS = [a * 10.0**b for b in range(-3, 4) for a in (1, 2, 5)]
LOG_AXIS = {'type': 'log', 'tickvals': TICKS, 'ticktext': [f'{tick:g}' for tick in TICKS]}


def mm_list(metres: npt.ArrayLike) -> list[float | None]:
    """Return lengths in mm."""
    return plain(metres, 1e3)


def degrees_list(radians: npt.ArrayLike) -> list[float | None]:
    """Return angles in degrees."""
    return plain(radians, 180.0 / np.pi)


def error_bars(
    up: Sequence[float | None], down: Sequence[float | None] | None = None, width: int = 2
) -> dict[str, Any]:
    """Return bars of so much above and below, else of the same size, as plotly draws them."""
    bars: dict[str, Any] = {'type': 'data', 'array': up, 'thickness': 1, 'width': width}
    return bars if down is None else bars | {'symmetric': False, 'arrayminus': down}


ZEROS_MAX = 3  # zeros behind the point that are shown of nothing: more would claim to be known
SIDE_WITHIN_RAD = 0.05  # [rad] 3°: nearer to an axis a direction is called by its name
DECIMALS_MAX = 7  # places behind the point because a row of zeros is not read; then an exponent
SYMMETRIC_WITHIN = 0.2  # [1] of half the interval by which its ends may differ to be written as ±


def quantity(name: str, value: Value, size: float = 0.0) -> str:
    """
    Say 'lever = 0.158 ± 0.007 mm', or the ends of an interval that is not symmetric.

    `size` [unit of the value] chooses the prefix together with the value.
    """
    return f'{spoken(name)} = {_with_interval(name, value, size)}'


def _with_interval(name: str, value: Value, size: float = 0.0) -> str:
    number, down, up = value.value, value.value - value.low, value.high - value.value
    half = 0.5 * (down + up)
    factor, unit = scale_of(value.unit, max(abs(number), half, size), name)
    note = f' ({value.note})' if value.note else ''
    if not math.isfinite(half) or half <= 0.0:
        return f'{with_unit(digits(factor * number, 3), unit)}{note}'
    places = decimals(factor * half)
    shown = rounded(factor * number, places)
    if abs(up - down) <= SYMMETRIC_WITHIN * half:
        return f'{with_unit(f"{shown} ± {rounded(factor * half, places)}", unit)}{note}'
    ends = f'{rounded(factor * value.low, places)} to {rounded(factor * value.high, places)}'
    extra = f', {value.note}' if value.note else ''
    return f'{with_unit(shown, unit)} (95 %: {ends}{extra})'


def quantities(values: Mapping[str, Value], load: LoadVector | None = None) -> str:
    """Join the parameters of an effect; of a force also say its size and direction."""
    said = [quantity(name, v, _largest(values, v.unit)) for name, v in values.items()]
    return ', '.join([*said, *([] if load is None else [f'together {load_words(load)}'])])


def load_words(load: LoadVector) -> str:
    """Say '0.151 ± 0.004 N, along gravity, 86 ± 9° from the arm's axis'."""
    size = _with_interval('', load.size)
    told = []
    if (angle := load.from_gravity) is not None:
        if angle.low <= 0.0:
            told.append('along gravity')
        elif angle.high >= math.pi:
            told.append('against gravity')
        else:
            told.append(f'{_with_interval("angle", angle)} from gravity')
    if (angle := load.from_axis) is not None:
        if angle.low <= 0.0 or angle.high >= math.pi:
            end = 'tip' if angle.low <= 0.0 else 'base'
            told.append(f"along the arm's axis, towards its {end}")
        else:
            said = f"{_with_interval('', angle)} from the arm's axis"
            if load.from_gravity is None:  # which does not tell the side
                quarter = round(load.around_axis / (0.5 * math.pi))
                side = f'{round(math.degrees(load.around_axis)) % 360}° (x: 0°, y: 90°)'
                if abs(load.around_axis - quarter * 0.5 * math.pi) < SIDE_WITHIN_RAD:
                    side = ('x', 'y', '-x', '-y')[quarter % 4]
                said = f'{said} towards {side}'
            told.append(said)
    return ', '.join([size, *(told or ['its direction is not told'])])


def short_quantities(values: Mapping[str, Value]) -> str:
    """Join the parameters without their intervals: 'relative_change -8 %'."""
    parts = []
    for name, value in values.items():
        factor, unit = scale_of(value.unit, _largest(values, value.unit), name)
        places = decimals(0.2 * factor * max(_largest(values, value.unit), 1e-300))
        shown = with_unit(rounded(factor * value.value, places), unit)
        parts.append(f'{spoken(name)} {shown}')
    return ', '.join(parts)


def told_quantity(name: str, value: Value) -> str:
    """Say 'force_y 0.000 N': as many places as the interval tells, without its ends."""
    half = 0.5 * (value.high - value.low)
    known = math.isfinite(half) and half > 0.0
    factor, unit = scale_of(value.unit, max(abs(value.value), half if known else 0.0), name)
    shown = factor * value.value
    text = rounded(shown, decimals(factor * half)) if known else digits(shown, 3)
    return f'{spoken(name)} {with_unit(text, unit)}'


def described_quantity(name: str, unit: str, numbers: Sequence[float], count: int = 3) -> str:
    """Say what a description holds: 'relative_change 5/10 %'."""
    factor, shown = scale_of(unit, max(abs(number) for number in numbers), name)
    return (
        f'{spoken(name)} {with_unit("/".join(digits(factor * n, count) for n in numbers), shown)}'
    )


def _largest(values: Mapping[str, Value], unit: str) -> float:
    return max(abs(value.value) for value in values.values() if value.unit == unit)


def decimals(half: float) -> int:
    """Places behind the point that show a half width with one digit, two if it begins with 1."""
    exponent = math.floor(math.log10(half))
    leading = half / 10.0**exponent
    return max((1 if leading < 2.0 else 0) - exponent, 0)


def rounded(value: float, places: int) -> str:
    """Show a number with so many places behind the point, never as -0 nor as a row of zeros."""
    text = f'{value:.{places}f}' if places <= DECIMALS_MAX else digits(value, 3)
    if float(text) != 0.0:
        return text
    return f'{0.0:.{min(places, ZEROS_MAX)}f}' if places <= DECIMALS_MAX else '0'
