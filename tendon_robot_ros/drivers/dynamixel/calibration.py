"""
Current to tension and back, encoder ticks to wire pull and back; the fit of a calibration.

A geared motor shows its friction with both signs: winding needs I = a_wind + b_wind T, paying out
I = a_out + b_out T. Each line is fitted by least squares over known weights; the standard errors
are those of the usual linear regression.
"""

from __future__ import annotations

import datetime
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...common.errors import InputError
from ..hardware import WEIGHTS_MIN, fit_line
from .control_table import RADIANS_PER_TICK, ServoModel

# [counts] of current from no tension to the limit; else one count would be more than 5 % of it
CURRENT_COUNTS_MIN = 20
# [1] of the tension limit; docs/dynamixel.md: else friction would hide too much of a command
FRICTION_BAND_MAX = 0.20


@dataclass(frozen=True)
class CurrentLine:
    """Current over tension: intercept [A] and slope [A/N]."""

    intercept: float
    slope: float

    def current(self, tension: float) -> float:
        """Return the current [A] at a tension [N]."""
        return self.intercept + self.slope * tension

    def tension(self, current: float) -> float:
        """Return the tension [N] at a current [A]: never negative."""
        return max(0.0, (current - self.intercept) / self.slope)


@dataclass(frozen=True)
class Calibration:
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

    def current(self, tension: float) -> float:
        """Return the mean current [A] of winding and paying out at a tension [N]."""
        return self.mean.current(tension)

    def tension(self, current: float) -> float:
        """Return the mean tension [N] of winding and paying out at a current [A]."""
        return self.mean.tension(current)

    def uncertainty(self, tension: float) -> float:
        """Return half the gap between the two lines at a tension, with their scatter [N]."""
        half = 0.5 * abs(self.wind.current(tension) - self.pay_out.current(tension))
        return math.hypot(half, self.scatter) / self.mean.slope


def from_data_sheet(model: ServoModel, radius: float) -> Calibration:
    """Make the lines of an uncalibrated motor with a spool of the given radius [m]."""
    slope = radius / model.torque_per_ampere
    friction = model.friction_current
    return Calibration(CurrentLine(friction, slope), CurrentLine(-friction, slope))


@dataclass(frozen=True)
class Resolution:
    """
    Resolution and friction band of a tension that a motor sets by current.

    Parameters
    ----------
    newtons_per_count : float
    counts : int
        From no tension to the limit.
    band : float
        Friction: largest error of the tension, up or down [N].
    limit : float
        The tension limit [N].

    """

    newtons_per_count: float
    counts: int
    band: float
    limit: float

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


def resolution(calibration: Calibration, model: ServoModel, limit: float) -> Resolution:
    """Compute newtons per count and the friction band for a tension limit [N]."""
    per_count = model.current_unit / calibration.mean.slope
    return Resolution(
        per_count, math.floor(limit / per_count + 1e-9), calibration.uncertainty(limit), limit
    )


@dataclass(frozen=True)
class Spool:
    """A spool: radius [m] and the direction of turning that winds, +1 or -1."""

    radius: float
    direction: int

    def pull(self, ticks: float) -> float:
        """Return the wire [m] wound by so many ticks."""
        return self.direction * self.radius * RADIANS_PER_TICK * ticks

    def ticks(self, pull: float) -> float:
        """Return the ticks that wind so much wire [m]."""
        return self.direction * pull / (self.radius * RADIANS_PER_TICK)


def smallest_spool(model: ServoModel, limit: float) -> float:
    """Return the smallest spool radius [m], in whole mm, with enough resolution by data sheet."""
    friction = model.friction_current * model.torque_per_ampere  # [N·m]
    count = model.current_unit * model.torque_per_ampere  # [N·m]
    smallest = max(friction / (FRICTION_BAND_MAX * limit), CURRENT_COUNTS_MIN * count / limit)
    return math.ceil(1e3 * smallest + 0.5) / 1e3


@dataclass(frozen=True)
class CurrentPoint:
    """Currents with one weight on the wire: mean while winding and while paying out [A]."""

    tension: float  # [N]
    wind: float
    pay_out: float


@dataclass(frozen=True)
class CurrentFit:
    """
    Two fitted lines with their standard errors.

    Parameters
    ----------
    calibration : Calibration
    errors : dict of str to tuple
        Standard errors of intercept [A] and slope [A/N] of `wind` and `pay_out`.
    points : tuple of CurrentPoint
    """

    calibration: Calibration
    errors: dict[str, tuple[float, float]]
    points: tuple[CurrentPoint, ...]

    @property
    def half_gap(self) -> float:
        """Half the gap between the lines at the heaviest weight [N]."""
        return self.calibration.uncertainty(max(point.tension for point in self.points))


def fit_current(points: Sequence[CurrentPoint]) -> CurrentFit:
    """
    Fit the two lines.

    Raises
    ------
    InputError
        Fewer than three weights, or currents that do not grow with the weight.

    """
    tensions = np.array([point.tension for point in points])
    if len(set(tensions.tolist())) < WEIGHTS_MIN:
        raise InputError(
            f'calibration: expected at least {WEIGHTS_MIN} different weights, '
            f'got {len(set(tensions.tolist()))}'
        )
    fits = {}
    for name in ('wind', 'pay_out'):
        fits[name] = fit_line(tensions, np.array([getattr(point, name) for point in points]))
        if fits[name].slope <= 0.0:
            raise InputError(
                f'calibration: {name}: the current does not grow with the weight '
                f'({fits[name].slope:.3g} A/N); does the weight hang free?'
            )
    wind, pay_out = (CurrentLine(fit.intercept, fit.slope) for fit in fits.values())
    scatter = max(fit.scatter for fit in fits.values())
    return CurrentFit(
        Calibration(wind, pay_out, measured=True, scatter=scatter),
        {name: (fit.intercept_error, fit.slope_error) for name, fit in fits.items()},
        tuple(points),
    )


def to_mapping(result: CurrentFit, model: str, radius: float) -> dict[str, Any]:
    """Return the calibration file's content for one tendon, with its motor and spool [m]."""
    lines = result.calibration
    return {
        'wind': [round(v, 7) for v in (lines.wind.intercept, lines.wind.slope)],
        'wind_errors': [round(v, 7) for v in result.errors['wind']],
        'pay_out': [round(v, 7) for v in (lines.pay_out.intercept, lines.pay_out.slope)],
        'pay_out_errors': [round(v, 7) for v in result.errors['pay_out']],
        'scatter': round(lines.scatter, 7),
        'half_gap': round(result.half_gap, 4),
        'model': model,
        'spool_radius': radius,
        'tensions': [round(point.tension, 4) for point in result.points],
        'date': datetime.date.today().isoformat(),
    }
