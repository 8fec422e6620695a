"""
Online identification: parameters of the added effects follow the arm within their intervals.

At every posture at which the arm rests the markers are compared with the model at the estimate,

    y - f(T; theta) - B(T) b,

and `RecursiveEstimate` updates the parameters theta (prior: the intervals of the description) and
the imperfections b of the arm (prior: plausible sizes) by this residual; the Jacobian of f is
exact. The description in use follows slowly: only where the estimate differs from it
significantly, by a fraction of the interval at a time, never beyond it, and only if the error over
the last postures falls. Every change can be undone.

The estimate is a bank of Kalman filters, so that the data select its memory. The state holds p
parameters that may move slowly and q constants, in units of their prior standard deviation. Before
every measurement a filter forgets part of its information on the parameters

    P -> (l P^-1 + (1 - l) P0^-1)^-1,   0 < l <= 1,   P0 = 1,

in exchange for the prior (stabilised forgetting, Kulhavy and Zarrop 1993): l = 1 is recursive
least squares, and P never exceeds P0, however uninformative the measurements are. Each filter has
its own l and its own size of the remainder, the persistent error of the model. The weights of the
filters are their predictive likelihoods with a forgetting exponent below 1, so that old errors of
a filter fade (dynamic model averaging, Raftery, Karny, Ettler 2010).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from scipy.special import softmax

from ..common.arrays import Floats
from ..common.errors import NoEquilibriumError
from ..common.estimation import KalmanUpdate, kalman_update
from ..common.words import listed, with_unit
from ..data import Marker
from ..inference.description import with_values
from ..inference.predict import FreeParameter, frees_of
from ..inference.statistics import QUANTILE, RARE, chi2_isf
from ..model.model import Model
from ..robot import Robot
from .built_arm import ODD_PROBABILITY, BuiltArm, slopes
from .change import CONFIRMED_POSTURES, JUDGED_POSTURES

# [1] of an interval: an estimate this near to an end is at the end, because the prior keeps it
# off the end itself
END = 0.02
# [1] of an interval: largest step of a parameter, so that one wrong estimate cannot move it far
STEP_MAX = 0.25
# [1] fractions of the information kept from one measurement to the next: memories of all, of 50,
# of 10 and of 3 measurements, so that the data select one; the second is also that of the weights
MEMORIES = 1.0, 0.98, 0.9, 0.7


class _Filter:
    """A Kalman filter with one forgetting factor and one size of the remainder."""

    def __init__(self, memory: float, remainder: float, parameters: int, others: int) -> None:
        self.memory, self.remainder, self.p = memory, remainder, parameters
        self.mean, self.covariance = np.zeros(parameters + others), np.eye(parameters + others)

    def forget(self) -> None:
        """Exchange part of the information on the parameters for the prior."""
        if self.memory < 1.0:
            known, p = self.covariance[: self.p, : self.p], self.p
            kept = self.memory * np.linalg.inv(known) + (1.0 - self.memory) * np.eye(p)
            self.covariance[:p, :p] = np.linalg.inv(kept)

    def keep_within(self, low: Floats, high: Floats) -> None:
        """Project parameters onto their bounds; correlated states follow."""
        for k in range(self.p):  # Simon 2006, eq. 7.94, one bound after the other
            off = self.mean[k] - np.clip(self.mean[k], low[k], high[k])
            if off != 0.0 and self.covariance[k, k] > 0.0:
                self.mean = self.mean - self.covariance[:, k] * (off / self.covariance[k, k])
        self.mean[: self.p] = np.clip(self.mean[: self.p], low, high)


class RecursiveEstimate:
    """Estimate of moving parameters and constants by a bank of filters; see the module."""

    def __init__(
        self,
        low: Floats,
        high: Floats,
        others: int = 0,
        remainders: Sequence[float] = (0.0,),
        memories: Sequence[float] = MEMORIES,
    ) -> None:
        """
        Begin with the prior N(0, 1) of every state, parameters within bounds.

        Parameters
        ----------
        low, high : (p,) [prior sd]
            Bounds of the parameters.
        others : int
            Number q of constants.
        remainders : sequence of float
            Candidate sizes of the remainder, 1 sd [m].
        memories : sequence of float
            Candidate forgetting factors l [1].

        """
        self.low, self.high = np.array(low, dtype=float), np.array(high, dtype=float)
        self._filters = [
            _Filter(memory, remainder, len(self.low), others)
            for memory, remainder in product(memories, remainders)
        ]
        self.weights = np.full(len(self._filters), 1.0 / len(self._filters))

    @property
    def mean(self) -> Floats:
        """Weighted mean (p + q,) of the filters [prior sd]."""
        first, p = self._filters[0].mean, len(self.low)
        # about one of them, so that filters at the same end give this end
        mean = first + self.weights @ np.array([one.mean - first for one in self._filters])
        mean[:p] = np.clip(mean[:p], self.low, self.high)  # removes rounding errors
        return np.asarray(mean)

    @property
    def covariance(self) -> Floats:
        """Covariance (p + q, p + q) of the mixture, between filters included [prior sd²]."""
        mean, total = self.mean, 0.0
        for weight, one in zip(self.weights, self._filters, strict=True):
            off = one.mean - mean
            total = total + weight * (one.covariance + np.outer(off, off))
        return np.asarray(total)

    @property
    def memory(self) -> float:
        """Weighted forgetting factor [1]."""
        return float(self.weights @ [one.memory for one in self._filters])

    def learn(
        self, off: Floats, columns: Floats, noise: Floats, remainder: Floats | float = 0.0
    ) -> None:
        """
        Update all filters by a measurement.

        Parameters
        ----------
        off : (r,) [m]
            Measured minus predicted, at the present `mean`.
        columns : (r, p + q) [m per prior sd]
            Jacobian of the measurement by the state, there.
        noise : (r, r) [m²]
            Covariance of the measurement.
        remainder : (r, r), optional
            Covariance of a remainder of 1 m [1].

        """
        at, fits = self.mean, list[KalmanUpdate]()
        for one in self._filters:
            one.forget()
            spread, own = noise + one.remainder**2 * remainder, off - columns @ (one.mean - at)
            fits.append(kalman_update(one.mean, one.covariance, columns, own, spread))
            one.mean, one.covariance = fits[-1].mean, fits[-1].covariance
            one.keep_within(self.low, self.high)
        logs = MEMORIES[1] * np.log(self.weights) + [fit.log_likelihood for fit in fits]
        weights = softmax(logs) + ODD_PROBABILITY  # no filter is excluded for good
        self.weights = weights / weights.sum()

    def fits(self, off: Floats, columns: Floats, noise: Floats, remainder: Floats) -> float:
        """Return the smallest chi² (r degrees of freedom) of a measurement without an update."""
        at, chi2_min = self.mean, np.inf
        for one in self._filters:
            known = one.covariance.copy()
            known[: one.p, : one.p] += np.eye(one.p)  # for parameters that have moved
            spread, own = noise + one.remainder**2 * remainder, off - columns @ (one.mean - at)
            chi2_min = min(chi2_min, kalman_update(one.mean, known, columns, own, spread).chi2)
        return chi2_min


@dataclass(frozen=True)
class ParameterChange:
    """One parameter of the description in use, before and after."""

    effect: str
    parameter: str
    before: float
    after: float
    low: float  # its interval
    high: float
    unit: str

    def __str__(self) -> str:
        """Return the change in one line of text."""
        moved = with_unit(f'{self.before:.4g} -> {self.after:.4g}', self.unit)
        interval = f'(interval {self.low:.4g} to {self.high:.4g})'
        return f'{self.effect}.{self.parameter}: {moved} {interval}'


@dataclass(frozen=True)
class ModelChange:
    """One change of the description in use."""

    posture: int  # after which it happened
    parameters: tuple[ParameterChange, ...]
    error_before: float  # [m] rms of the markers over the last postures
    error_after: float
    robot: Robot  # before the change

    def inverse(self) -> ModelChange:
        """Return the change that restores the state before."""
        back = tuple(replace(o, before=o.after, after=o.before) for o in self.parameters)
        return ModelChange(self.posture, back, self.error_after, self.error_before, self.robot)

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            'posture': self.posture,
            'parameters': [vars(one) for one in self.parameters],
            'error': {'before': self.error_before, 'after': self.error_after, 'unit': 'm'},
        }


@dataclass(frozen=True)
class _Adaptable:
    """A parameter that may follow the arm."""

    free: FreeParameter
    low: float
    high: float
    centre: float  # of the prior: the fitted value
    spread: float  # 1 sd of the prior

    @property
    def name(self) -> str:
        """Effect and parameter."""
        return f'{self.free.effect}.{self.free.key}'

    def units(self, value: float) -> float:
        """Return a value in units of the prior."""
        return (value - self.centre) / self.spread

    def value(self, units: float) -> float:
        """Return the value of so many units, within the interval."""
        return float(np.clip(self.centre + self.spread * units, self.low, self.high))


def described_value(robot: Robot, free: FreeParameter) -> float:
    """Return the value that a description gives a parameter of one of its effects."""
    value = robot.effects[free.effect].get(free.parameter.name, free.parameter.neutral)
    return float(value[free.column or 0] if isinstance(value, tuple) else value)


def adaptable(robot: Robot, frees: Iterable[FreeParameter]) -> tuple[list[_Adaptable], list[str]]:
    """Return the parameters with an interval in a description, and reasons for the others."""
    parameters, without = [], []
    for free in frees:
        origin = robot.fitted.get(free.effect, {}).get('parameters', {}).get(free.key, {})
        low, high = origin.get('low'), origin.get('high')
        name = f'{free.effect}.{free.key}'
        if low is None or high is None or not low < high:
            without.append(f'{name} has no interval')
            continue
        low, high = max(low, free.parameter.low), min(high, free.parameter.high)
        value = described_value(robot, free)
        if not low <= value <= high:
            without.append(f'{name} is outside its interval')
            continue
        parameters.append(_Adaptable(free, low, high, value, 0.5 * (high - low) / QUANTILE))
    return parameters, without


class Adaptation:
    """Follows the parameters of one description."""

    def __init__(self, model: Model, markers: Sequence[Marker], noise: float) -> None:
        """
        Begin from a description.

        Parameters
        ----------
        model : Model
            The model in use.
        markers : (J,) sequence of Marker
        noise : float
            1 sd of a coordinate of a marker [m].

        """
        self.robot = model.robot  # in use
        self.changes: list[ModelChange] = []
        self.problem, self._catalogue = '', model.catalogue
        frees = frees_of(self.robot.effects, model.catalogue, self.robot)
        self._adaptable, self.excluded = adaptable(self.robot, frees)
        if not self._adaptable:
            why = listed(self.excluded) if self.excluded else 'the description has no effect'
            self.problem = f'nothing can follow: {why}; investigate, or add with data'
        elif model.remembers:
            self.problem = 'nothing can follow: the arm remembers every earlier posture'
        self._arm = arm = BuiltArm(self.robot, model.catalogue, markers, noise)
        self._estimate = RecursiveEstimate(
            np.array([one.units(one.low) for one in self._adaptable]),
            np.array([one.units(one.high) for one in self._adaptable]),
            arm.built,
            [size for size in arm.remainders if size > 0.0],
        )
        self._recent: deque[tuple[Floats, Floats]] = deque(maxlen=2 * JUDGED_POSTURES)
        self.postures = self._changed_at = self._odd = 0

    @property
    def text(self) -> str:
        """The state in words."""
        if self.problem:
            return self.problem
        if self._odd >= CONFIRMED_POSTURES:
            return (
                f'the last {self._odd} postures fit with no value within the intervals: '
                'something else has changed; investigate'
            )
        if not self.postures:
            return 'no posture yet'
        words, ends = [], []
        for one, value, sd in self._values():
            width, unit = QUANTILE * sd, one.free.parameter.unit
            words.append(with_unit(f'{one.name} {value:.4g} ± {width:.2g}', unit))
            if min(value - one.low, one.high - value) < END * (one.high - one.low):
                ends.append(f'{one.name} is at the end of its interval: investigate')
        return '; '.join([*words, *ends])

    @property
    def memory(self) -> float:
        """Number of postures in the memory of the estimate, infinite for all."""
        kept = self._estimate.memory if self.postures else 1.0
        return float('inf') if kept >= 1.0 else 1.0 / (1.0 - kept)

    def values(self) -> dict[str, tuple[float, float]]:
        """Return the estimate of every parameter that may follow, and 1 sd of it [its unit]."""
        return {one.name: (value, sd) for one, value, sd in self._values()}

    def update(
        self, tensions: Floats, positions: Floats, change: bool = True, frames: int = 1
    ) -> ModelChange | None:
        """
        Update by a posture at which the arm rests; return the change of `robot`, None without one.

        Parameters
        ----------
        tensions : (m,) [N]
        positions : (J, 3) [m], nan for a missing marker
        change : bool
            Whether the description may follow; the estimate is updated in any case.
        frames : int
            Number of frames whose mean the positions are.

        """
        if self.problem or not self._learn(tensions, positions, frames):
            return None
        self._recent.append((tensions, positions))
        self.postures += 1
        ready = len(self._recent) == 2 * JUDGED_POSTURES and not self._odd
        if not (change and ready) or self.postures - self._changed_at < JUDGED_POSTURES:
            return None
        return self._follow()

    def undo(self) -> ModelChange | None:
        """Undo the last change and return its inverse, None without a change."""
        if not self.changes:
            return None
        last = self.changes.pop()
        self.robot, self._changed_at = last.robot, self.postures
        return last.inverse()

    def _values(self) -> list[tuple[_Adaptable, float, float]]:
        """Return the adaptable parameters, their estimates and 1 sd."""
        mean, sd = self._estimate.mean, np.sqrt(np.diag(self._estimate.covariance))
        known = zip(self._adaptable, mean.tolist(), sd.tolist(), strict=False)
        return [(one, one.value(z), one.spread * s) for one, z, s in known]

    def _learn(self, tensions: Floats, positions: Floats, frames: int) -> bool:
        """Update the estimate by a posture; return False where the model has no equilibrium."""
        measured, arm = positions.ravel(), self._arm
        point = {one.free: value for one, value, _ in self._values()}
        frees, rows = [one.free for one in self._adaptable], np.isfinite(measured)
        if not rows.any():
            return False
        try:
            expected = arm.expected(tensions, point)
            moved = slopes(arm.described, point, frees, np.maximum(tensions, 0.0)[None])
        except NoEquilibriumError:
            return False
        own = moved[0] * [one.spread for one in self._adaptable]
        columns = np.hstack([own, expected.columns[:, : arm.built] @ arm.prior])[rows]
        known = columns[:, own.shape[1] :] @ self._estimate.mean[own.shape[1] :]
        off = measured[rows] - expected.markers[rows] - known
        noise, rest = arm.noise**2 / frames * np.eye(len(off)), arm.rest(rows)
        chi2 = self._estimate.fits(off, columns, noise, rest)
        self._odd = self._odd + 1 if chi2 > chi2_isf(ODD_PROBABILITY, len(off)) else 0
        if not self._odd:
            self._estimate.learn(off, columns, noise, rest)
        return True

    def _follow(self) -> ModelChange | None:
        """Change the description in use towards the estimate where that is significant."""
        p = len(self._adaptable)
        before = {one.free: described_value(self.robot, one.free) for one in self._adaptable}
        in_use = np.array([one.units(before[one.free]) for one in self._adaptable])
        off = self._estimate.mean[:p] - in_use
        information = np.linalg.inv(self._estimate.covariance[:p, :p])
        if off @ information @ off < chi2_isf(RARE, p):
            return None
        step_max = STEP_MAX * 2.0 * QUANTILE
        moved = in_use + off * min(1.0, step_max / float(np.abs(off).max()))
        there = zip(self._adaptable, moved.tolist(), strict=True)
        after = {one.free: one.value(z) for one, z in there}
        errors = self._error(before), self._error(after)
        if not errors[1] < errors[0]:
            return None
        changes = []
        for one in self._adaptable:
            free, values = one.free, (before[one.free], after[one.free], one.low, one.high)
            changes.append(ParameterChange(free.effect, free.key, *values, free.parameter.unit))
        change = ModelChange(self.postures, tuple(changes), *errors, self.robot)
        self.robot = with_values(self.robot, self._catalogue, after.items())
        self.changes.append(change)
        self._changed_at = self.postures
        return change

    def _error(self, point: dict[FreeParameter, float]) -> float:
        """Return the rms error [m] of the markers over the last postures; inf: no equilibrium."""
        squares = []
        for tensions, positions in self._recent:
            markers = self._arm.described.markers(point, np.maximum(tensions, 0.0)[None])
            if markers is None:
                return float('inf')
            squares.append(((markers[0] - positions) ** 2).sum(axis=1))
        return float(np.sqrt(np.nanmean(np.concatenate(squares))))
