"""
Identification while running: parameters of the added effects follow the arm, within intervals.

At every posture at which the arm stands the markers are compared with the model at the estimate,

    y - f(T; theta) - B(T) b,

and `RecursiveEstimate` takes what they say of the parameters theta (prior: the intervals of the
description) and of the imperfections b of the arm (prior: plausible sizes); f' is exact. The
description in use follows slowly: only where the estimate differs from it by more than chance,
by a part of the interval at a time, never beyond it, and only if the error over the last
postures falls with it. Every change can be undone.

The estimate has Kalman filters side by side, so that the data choose its memory. The state holds p
parameters that may move slowly and q others that never do, in units of their prior standard
deviation. Before every measurement a filter forgets of the parameters

    P -> (l P^-1 + (1 - l) P0^-1)^-1,   0 < l <= 1,   P0 = 1,

as if part of what is known were exchanged for the prior (stabilised forgetting, Kulhavy and
Zarrop 1993): with l = 1 it is least squares, and however little the measurements say, P never
exceeds P0. Each filter has its own l, and its own size of what a model always gets wrong. Their
weights are their predictive likelihoods, the older ones raised to a power below 1, so that a
filter that was wrong long ago comes back (dynamic model averaging, Raftery, Karny, Ettler 2010).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from statistics import NormalDist
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..common.estimation import kalman_update
from ..common.words import listed, with_unit
from ..comparison.predict import FreeParameter, free_parameters
from ..comparison.statistics import chi2_isf
from ..data import Marker
from ..diagnosis.description import with_values
from ..model.model import Model
from ..robot import Robot
from .built_arm import ODD_PROBABILITY, REMAINDERS, BuiltArm
from .change import CONFIRMED_POSTURES

# [1] standard deviations of half of a 95 % interval, as values are by chance
INTERVAL_SD = NormalDist().inv_cdf(0.975)
# [1] probability of a difference from what is in use by chance; with more it is none
CHANCE_PROBABILITY = 0.01
# [1] of an interval, within which an estimate is at its end, because the prior keeps it from there
END = 0.02
# [1] of an interval, that a parameter moves at a time, so that one wrong estimate cannot move it
# far
STEP_MAX = 0.25
# [1] postures between two changes, so that the error after the last one shows: a change is judged
# by as many before it and after it
CHANGE_EVERY = 4
# [1] of what is known kept from one measurement to the next: the memory is of all, of 50, of 10
# and of 3 measurements, so that the data choose
MEMORIES = 1.0, 0.98, 0.9, 0.7
# [1] power of a weight from one measurement to the next, so that a filter that was wrong 30 of
# them ago comes back (Raftery, Karny, Ettler 2010)
WEIGHT_MEMORY = 0.97


class _Filter:
    """A Kalman filter with one memory and one size of the remainder."""

    def __init__(self, memory: float, remainder: float, parameters: int, others: int) -> None:
        self.memory, self.remainder, self.p = memory, remainder, parameters
        self.mean, self.covariance = np.zeros(parameters + others), np.eye(parameters + others)

    def forget(self) -> None:
        """Exchange part of what is known of the parameters for the prior."""
        if self.memory == 1.0:
            return
        here = self.covariance[: self.p, : self.p]
        information = self.memory * np.linalg.inv(here) + (1.0 - self.memory) * np.eye(self.p)
        self.covariance[: self.p, : self.p] = np.linalg.inv(information)

    def learn(self, off: Floats, columns: Floats, noise: Floats) -> tuple[float, float]:
        """Take a residual (r,) around the mean; return predictive log likelihood and chi²."""
        after = kalman_update(self.mean, self.covariance, columns, off, noise)
        self.mean, self.covariance = after.mean, after.covariance
        return after.log_likelihood, after.chi2

    def keep_within(self, low: Floats, high: Floats) -> None:
        """Bring parameters back to the nearest bound; what is tied to them follows."""
        for k in range(self.p):  # Simon 2006, eq. 7.94, one bound after the other
            off = self.mean[k] - np.clip(self.mean[k], low[k], high[k])
            if off != 0.0 and self.covariance[k, k] > 0.0:
                self.mean = self.mean - self.covariance[:, k] * (off / self.covariance[k, k])
        self.mean[: self.p] = np.clip(self.mean[: self.p], low, high)


class RecursiveEstimate:
    """Parameters that may move, beside others that do not; see the module."""

    def __init__(
        self,
        low: Floats,
        high: Floats,
        others: int = 0,
        remainders: Sequence[float] = (0.0,),
        memories: Sequence[float] = MEMORIES,
    ) -> None:
        """
        Know nothing but the prior: N(0, 1) each, parameters within bounds.

        Parameters
        ----------
        low, high : (p,) [prior sd]
            Bounds that no parameter leaves.
        others : int
            Number q of states that do not move.
        remainders : sequence of float
            1 sd of what the model always gets wrong [m]; each is tried.
        memories : sequence of float
            Shares l that are kept from one measurement to the next [1]; each is tried.

        """
        self.low, self.high = np.array(low, dtype=float), np.array(high, dtype=float)
        self._filters = [
            _Filter(memory, remainder, len(self.low), others)
            for memory, remainder in product(memories, remainders)
        ]
        self.weights = np.full(len(self._filters), 1.0 / len(self._filters))

    @property
    def mean(self) -> Floats:
        """Mean (p + q,) of all filters [prior sd]."""
        mean, p = self.weights @ np.array([f.mean for f in self._filters]), len(self.low)
        mean[:p] = np.clip(mean[:p], self.low, self.high)  # of values within: rounding alone
        return np.asarray(mean)

    @property
    def covariance(self) -> Floats:
        """Covariance (p + q, p + q) of all filters, what they differ by in it [prior sd²]."""
        mean, total = self.mean, 0.0
        for weight, one in zip(self.weights, self._filters, strict=True):
            off = one.mean - mean
            total = total + weight * (one.covariance + np.outer(off, off))
        return np.asarray(total)

    @property
    def memory(self) -> float:
        """Share that is kept from one measurement to the next, as the data have it [1]."""
        return float(self.weights @ [one.memory for one in self._filters])

    @property
    def remainder(self) -> float:
        """1 sd of what the model always gets wrong, as the data have it [m]."""
        return float(self.weights @ [one.remainder for one in self._filters])

    def learn(
        self, off: Floats, columns: Floats, noise: Floats, remainder: Floats | float = 0.0
    ) -> float:
        """
        Take a measurement.

        Parameters
        ----------
        off : (r,) [m]
            Measured minus predicted, at the present `mean`.
        columns : (r, p + q) [m per prior sd]
            How the state moves what is measured, there.
        noise : (r, r) [m²]
            Covariance of the measurement.
        remainder : (r, r), optional
            Covariance of what a model gets wrong that is off by 1 m.

        Returns
        -------
        float
            Least chi² of all filters: how badly the measurement fits at best.

        """
        at, fits = self.mean, list[tuple[float, float]]()
        for one in self._filters:
            one.forget()
            spread = noise + one.remainder**2 * remainder
            fits.append(one.learn(off - columns @ (one.mean - at), columns, spread))
            one.keep_within(self.low, self.high)
        logs = WEIGHT_MEMORY * np.log(self.weights) + np.array([log for log, _ in fits])
        weights = np.exp(logs - logs.max())
        weights = weights / weights.sum() + ODD_PROBABILITY  # no filter is ever out
        self.weights = weights / weights.sum()
        return min(chi2 for _, chi2 in fits)

    def fits(self, off: Floats, columns: Floats, noise: Floats, remainder: Floats) -> float:
        """Return the least chi² (degrees of freedom: r) of a measurement, without taking it."""
        at, least = self.mean, np.inf
        for one in self._filters:
            known = one.covariance.copy()
            known[: one.p, : one.p] += np.eye(one.p)  # wherever the parameters are by now
            spread = columns @ known @ columns.T + noise + one.remainder**2 * remainder
            own = off - columns @ (one.mean - at)
            least = min(least, float(own @ np.linalg.solve(spread, own)))
        return least


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
        """Say it in a line."""
        moved = with_unit(f'{self.before:.4g} -> {self.after:.4g}', self.unit)
        interval = f'(interval {self.low:.4g} to {self.high:.4g})'
        return f'{self.effect}.{self.parameter}: {moved} {interval}'


@dataclass(frozen=True)
class ModelChange:
    """One change of the description in use."""

    posture: int  # after which it was made
    parameters: tuple[ParameterChange, ...]
    error_before: float  # [m] rms of the markers over the last postures
    error_after: float
    robot: Robot  # before

    def undone(self) -> ModelChange:
        """Return the way back: after it is what was before."""
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
class _Followed:
    """A parameter that may follow."""

    free: FreeParameter
    low: float
    high: float
    centre: float  # of the prior: what was fitted
    spread: float  # 1 sd of the prior

    @property
    def name(self) -> str:
        """Effect and parameter."""
        return f'{self.free.effect}.{self.free.key}'

    def units(self, value: float) -> float:
        """Return a value in units of the prior."""
        return (value - self.centre) / self.spread


def followed(robot: Robot, frees: Sequence[FreeParameter]) -> tuple[list[_Followed], list[str]]:
    """Return the parameters that have an interval in a description, and why others have none."""
    made, without = [], []
    for free in frees:
        origin = robot.fitted.get(free.effect, {}).get('parameters', {}).get(free.key, {})
        low, high = origin.get('low'), origin.get('high')
        name = f'{free.effect}.{free.key}'
        if low is None or high is None or not low < high:
            without.append(f'{name} has no interval')
            continue
        low, high = max(low, free.parameter.low), min(high, free.parameter.high)
        described = robot.effects[free.effect].get(free.parameter.name, free.parameter.neutral)
        value = described[free.column or 0] if isinstance(described, tuple) else described
        if not low <= value <= high:
            without.append(f'{name} is outside its interval')
            continue
        made.append(_Followed(free, low, high, value, 0.5 * (high - low) / INTERVAL_SD))
    return made, without


class Adaptation:
    """Follows the parameters of one description."""

    def __init__(self, model: Model, markers: Sequence[Marker], noise: float) -> None:
        """
        Begin from a description.

        Parameters
        ----------
        model : Model
            As it is in use.
        markers : (J,) sequence of Marker
        noise : float
            1 sd of a coordinate of a marker [m].

        """
        self.robot = model.robot  # in use
        self.changes: list[ModelChange] = []
        self.problem, self._catalogue = '', model.catalogue
        frees = [
            free
            for name in self.robot.effects
            for free in free_parameters(model.catalogue[name], self.robot)
        ]
        self._followed, self.left_out = followed(self.robot, frees)
        if not self._followed:
            why = listed(self.left_out) if self.left_out else 'the description has no effect'
            self.problem = f'nothing can follow: {why}; investigate, or add with data'
        elif model.remembers:
            self.problem = 'nothing can follow: friction_memory depends on every earlier posture'
        self._arm = BuiltArm(self.robot, model.catalogue, markers, noise)
        self._estimate: RecursiveEstimate | None = None
        self._recent: deque[tuple[Floats, Floats]] = deque(maxlen=2 * CHANGE_EVERY)
        self.postures = self._changed_at = self._odd = 0

    @property
    def text(self) -> str:
        """How it is, in words."""
        if self.problem:
            return self.problem
        if self._odd >= CONFIRMED_POSTURES:
            return (
                f'the last {self._odd} postures fit with no value within the intervals: '
                'something else has changed; investigate'
            )
        if self._estimate is None:
            return 'no posture yet'
        words, ends = [], []
        for one, value, sd in self._values():
            width, unit = INTERVAL_SD * sd, one.free.parameter.unit
            words.append(with_unit(f'{one.name} {value:.4g} ± {width:.2g}', unit))
            if min(value - one.low, one.high - value) < END * (one.high - one.low):
                ends.append(f'{one.name} is at the end of its interval: investigate')
        return '; '.join([*words, *ends])

    @property
    def memory(self) -> float:
        """Postures that the estimate remembers, as the data have it; infinite: all."""
        kept = 1.0 if self._estimate is None else self._estimate.memory
        return float('inf') if kept >= 1.0 else 1.0 / (1.0 - kept)

    def values(self) -> dict[str, tuple[float, float]]:
        """Return the estimate of every parameter that may follow, and 1 sd of it [its unit]."""
        return {one.name: (value, sd) for one, value, sd in self._values()}

    def stands(
        self, tensions: Floats, positions: Floats, change: bool = True, frames: int = 1
    ) -> ModelChange | None:
        """
        Take a posture at which the arm stands; return what was changed in `robot`, if anything.

        Parameters
        ----------
        tensions : (m,) [N]
        positions : (J, 3) [m], nan where a marker was not seen
        change : bool
            Whether the description may follow; the estimate does in any case.
        frames : int
            Of which the positions are the mean.

        """
        if self.problem or not self._learn(tensions, positions, frames):
            return None
        self._recent.append((tensions, positions))
        self.postures += 1
        ready = len(self._recent) == 2 * CHANGE_EVERY and not self._odd
        if not (change and ready) or self.postures - self._changed_at < CHANGE_EVERY:
            return None
        return self._follow()

    def undo(self) -> ModelChange | None:
        """Take the last change back; return the way back, None: there is no change."""
        if not self.changes:
            return None
        last = self.changes.pop()
        self.robot, self._changed_at = last.robot, self.postures
        return last.undone()

    def _values(self) -> list[tuple[_Followed, float, float]]:
        """Return what may follow, its estimate and 1 sd."""
        if self._estimate is None:
            return [(one, one.centre, one.spread) for one in self._followed]
        mean, sd = self._estimate.mean, np.sqrt(np.diag(self._estimate.covariance))
        return [
            (one, float(np.clip(one.centre + one.spread * z, one.low, one.high)), one.spread * s)
            for one, z, s in zip(self._followed, mean.tolist(), sd.tolist(), strict=False)
        ]

    def _learn(self, tensions: Floats, positions: Floats, frames: int) -> bool:
        """Take a posture into the estimate; return whether the model has it."""
        measured, arm = positions.ravel(), self._arm
        point = {one.free: value for one, value, _ in self._values()}
        rows = np.isfinite(measured)
        expected = arm.expected(tensions, point)
        if expected is None or not rows.any():
            return False
        own = self._slopes(point, np.maximum(tensions, 0.0)[None])
        if own is None:
            return False
        columns = np.hstack([own, expected.columns])[rows]
        if self._estimate is None:
            self._estimate = RecursiveEstimate(
                np.array([one.units(one.low) for one in self._followed]),
                np.array([one.units(one.high) for one in self._followed]),
                expected.columns.shape[1],
                [part * self.robot.length for part in REMAINDERS[1:]],
            )
        known = columns[:, own.shape[1] :] @ self._estimate.mean[own.shape[1] :]
        off = measured[rows] - expected.markers[rows] - known
        noise, rest = arm.noise**2 / frames * np.eye(len(off)), arm.rest(rows)
        chi2 = self._estimate.fits(off, columns, noise, rest)
        self._odd = self._odd + 1 if chi2 > chi2_isf(ODD_PROBABILITY, len(off)) else 0
        if not self._odd:
            self._estimate.learn(off, columns, noise, rest)
        return True

    def _slopes(self, point: dict[FreeParameter, float], inputs: Floats) -> Floats | None:
        """Return how parameters move the markers (3 J, p) [m per prior sd], exactly."""
        whole = self._arm.whole
        if whole.markers(point, inputs) is None or whole.settled is None:
            return None
        frees = [one.free for one in self._followed]
        tangent = whole.tangent(point, frees, whole.settled)
        if tangent is None:
            return None
        spread = np.array([one.spread for one in self._followed])
        return np.asarray((spread[:, None] * tangent.markers.reshape(len(frees), -1)).T)

    def _follow(self) -> ModelChange | None:
        """Change the description in use towards the estimate, if that is worth it."""
        assert self._estimate is not None
        p = len(self._followed)
        in_use = np.array([one.units(self._in_use(one)) for one in self._followed])
        off = self._estimate.mean[:p] - in_use
        information = np.linalg.inv(self._estimate.covariance[:p, :p])
        if off @ information @ off < chi2_isf(CHANCE_PROBABILITY, p):
            return None
        most = STEP_MAX * 2.0 * INTERVAL_SD
        moved = in_use + off * min(1.0, most / float(np.abs(off).max()))
        after = {
            one.free: float(np.clip(one.centre + one.spread * z, one.low, one.high))
            for one, z in zip(self._followed, moved.tolist(), strict=True)
        }
        before = {one.free: self._in_use(one) for one in self._followed}
        errors = self._error(before), self._error(after)
        if not errors[1] < errors[0]:
            return None
        parameters = tuple(
            ParameterChange(
                one.free.effect,
                one.free.key,
                before[one.free],
                after[one.free],
                one.low,
                one.high,
                one.free.parameter.unit,
            )
            for one in self._followed
        )
        change = ModelChange(self.postures, parameters, *errors, self.robot)
        self.robot = with_values(self.robot, self._catalogue, after.items())
        self.changes.append(change)
        self._changed_at = self.postures
        return change

    def _in_use(self, one: _Followed) -> float:
        values = self.robot.effects[one.free.effect]
        value = values.get(one.free.parameter.name, one.free.parameter.neutral)
        return float(value[one.free.column or 0] if isinstance(value, tuple) else value)

    def _error(self, point: dict[FreeParameter, float]) -> float:
        """Return the rms error [m] of the markers over the last postures; inf: no equilibrium."""
        squares = []
        for tensions, positions in self._recent:
            here = self._arm.whole.markers(point, np.maximum(tensions, 0.0)[None])
            if here is None:
                return float('inf')
            squares.append(((here[0] - positions) ** 2).sum(axis=1))
        return float(np.sqrt(np.nanmean(np.concatenate(squares))))
