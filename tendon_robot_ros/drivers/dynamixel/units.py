"""
Current to tension and back, encoder ticks to wire pull and back.

A geared motor needs more current to wind than to hold, and less to pay out: two straight lines
over the tension. Their mean converts; half the gap between them is the uncertainty.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from .tables import TICKS_PER_TURN, Model

FEWEST_COUNTS = 20  # of current, from no tension to the limit
WIDEST_BAND = 0.20  # of the tension limit
RADIANS_PER_TICK = 2.0 * math.pi / TICKS_PER_TURN


@dataclass(frozen=True)
class Line:
    """Current over tension: intercept [A] and slope [A/N]."""

    intercept: float
    slope: float

    def current(self, tension: float) -> float:
        """Return the current [A] at a tension [N]."""
        return self.intercept + self.slope * tension


@dataclass(frozen=True)
class Calibration:
    """
    Two lines, one for winding and one for paying out.

    Parameters
    ----------
    wind, pay_out : Line
    measured : bool
        False for the data sheet's torque per ampere and an assumed friction.
    scatter : float
        Standard deviation of the currents about their lines [A].

    """

    wind: Line
    pay_out: Line
    measured: bool = False
    scatter: float = 0.0

    @property
    def mean(self) -> Line:
        """The line between the two."""
        return Line(
            0.5 * (self.wind.intercept + self.pay_out.intercept),
            0.5 * (self.wind.slope + self.pay_out.slope),
        )

    def current(self, tension: float) -> float:
        """Return the current [A] that is between winding and paying out at a tension [N]."""
        return self.mean.current(tension)

    def tension(self, current: float) -> float:
        """Return the tension [N] at a current [A]: never negative."""
        mean = self.mean
        return max(0.0, (current - mean.intercept) / mean.slope)

    def uncertainty(self, tension: float) -> float:
        """Return half the gap between the two lines at a tension, with their scatter [N]."""
        half = 0.5 * abs(self.wind.current(tension) - self.pay_out.current(tension))
        return math.hypot(half, self.scatter) / self.mean.slope


def from_data_sheet(model: Model, radius: float) -> Calibration:
    """Make the lines of an uncalibrated motor with a spool of the given radius [m]."""
    slope = radius / model.torque_per_ampere
    friction = model.friction_current
    return Calibration(Line(friction, slope), Line(-friction, slope))


@dataclass(frozen=True)
class Resolution:
    """
    How finely a motor and its spool set a tension by current.

    Parameters
    ----------
    newtons_per_count : float
    counts : int
        From no tension to the limit.
    band : float
        Friction: the tension may be off by as much, up or down [N].
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
        return self.counts < FEWEST_COUNTS or self.band > WIDEST_BAND * self.limit

    def __str__(self) -> str:
        """Say the numbers."""
        return (
            f'one count of current is {self.newtons_per_count:.3g} N ({self.counts} counts '
            f'up to {self.limit:g} N), the friction band is ±{self.band:.3g} N '
            f'({100 * self.band / self.limit:.0f} % of the limit)'
        )


def resolution(calibration: Calibration, model: Model, limit: float) -> Resolution:
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


def smallest_spool(model: Model, limit: float) -> float:
    """Return the spool radius [m], in whole mm, from which the data sheet's motor is fine."""
    friction = model.friction_current * model.torque_per_ampere  # [N·m]
    count = model.current_unit * model.torque_per_ampere  # [N·m]
    least = max(friction / (WIDEST_BAND * limit), FEWEST_COUNTS * count / limit)
    return 1e-3 * math.ceil(1e3 * least + 0.5)
