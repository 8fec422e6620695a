"""
Identification while running: parameters of the added effects follow the arm, within intervals.

At every posture at which the arm stands the markers are compared with the model at the estimate,

    y - f(T; theta) - B(T) b,

and `RecursiveEstimate` takes what they say of the parameters theta (prior: the intervals of the
description) and of the imperfections b of the arm (prior: plausible sizes); f' is exact. The
description in use follows slowly: only where the estimate differs from it by more than chance,
by a share of the interval at a time, never beyond it, and only if the error over the last
postures falls with it. Every change can be undone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.words import listed, with_unit
from ..comparison.predict import FreeParameter, free_parameters
from ..comparison.statistics import chi2_isf
from ..data import Marker
from ..diagnosis.description import with_values
from ..model.model import Model
from ..robot import Robot
from .built_arm import BuiltArm
from .recursive import RecursiveEstimate

Floats = npt.NDArray[np.float64]
INTERVAL_SD = 1.96  # half of a 95 % interval in standard deviations
REMAINDER_SHARES = (0.0003, 0.001, 0.003, 0.01)  # of the length, at the tip: each is tried
CHANCE_PROBABILITY = 0.01  # of a difference from what is in use, below which it is none
ODD_PROBABILITY = 1e-6  # of a posture that parameters within their intervals do not explain
ODD_POSTURES = 3  # in a row, from which on nothing follows any more
END_SHARE = 0.02  # of an interval, within which an estimate is at its end
STEP_SHARE_MAX = 0.25  # of an interval, that a parameter moves at a time
JUDGED_POSTURES = 8  # by whose error a change is judged
CHANGE_EVERY = 4  # postures between two changes


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
        self._recent: deque[tuple[Floats, Floats]] = deque(maxlen=JUDGED_POSTURES)
        self.postures = self._changed_at = self._odd = 0

    @property
    def text(self) -> str:
        """How it is, in words."""
        if self.problem:
            return self.problem
        if self._odd >= ODD_POSTURES:
            return (
                f'the last {self._odd} postures fit with no value within the intervals: '
                'something else has changed; investigate'
            )
        if self._estimate is None:
            return 'no posture yet'
        said, ends = [], []
        for one, value, sd in self._values():
            width, unit = INTERVAL_SD * sd, one.free.parameter.unit
            said.append(with_unit(f'{one.name} {value:.4g} ± {width:.2g}', unit))
            if min(value - one.low, one.high - value) < END_SHARE * (one.high - one.low):
                ends.append(f'{one.name} is at the end of its interval: investigate')
        return '; '.join([*said, *ends])

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
        ready = len(self._recent) == JUDGED_POSTURES and not self._odd
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

    def _point(self) -> dict[FreeParameter, float]:
        return {one.free: value for one, value, _ in self._values()}

    def _learn(self, tensions: Floats, positions: Floats, frames: int) -> bool:
        """Take a posture into the estimate; return whether the model has it."""
        measured, point, arm = positions.ravel(), self._point(), self._arm
        rows = np.isfinite(measured)
        expected = arm.expected(tensions, point)
        if expected is None or not rows.any():
            return False
        own = self._slopes(point, np.maximum(tensions, 0.0)[None])
        if own is None:
            return False
        columns = np.hstack([own, expected.columns])[rows]
        if self._estimate is None:
            self._estimate = self._begun(expected.columns.shape[1])
        known = columns[:, own.shape[1] :] @ self._estimate.mean[own.shape[1] :]
        off = measured[rows] - expected.markers[rows] - known
        noise, rest = arm.noise**2 / frames * np.eye(len(off)), arm.rest(rows)
        chi2 = self._estimate.fits(off, columns, noise, rest)
        self._odd = self._odd + 1 if chi2 > chi2_isf(ODD_PROBABILITY, len(off)) else 0
        if not self._odd:
            self._estimate.learn(off, columns, noise, rest)
        return True

    def _begun(self, imperfections: int) -> RecursiveEstimate:
        low = np.array([one.units(one.low) for one in self._followed])
        high = np.array([one.units(one.high) for one in self._followed])
        sizes = [share * self.robot.length for share in REMAINDER_SHARES]
        return RecursiveEstimate(low, high, imperfections, sizes)

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
        told = np.linalg.inv(self._estimate.covariance[:p, :p])
        if off @ told @ off < chi2_isf(CHANCE_PROBABILITY, p):
            return None
        most = STEP_SHARE_MAX * 2.0 * INTERVAL_SD
        moved = in_use + off * min(1.0, most / float(np.abs(off).max()))
        after = {
            one.free: float(np.clip(one.centre + one.spread * z, one.low, one.high))
            for one, z in zip(self._followed, moved.tolist(), strict=True)
        }
        before = {one.free: self._in_use(one) for one in self._followed}
        errors = self._error(before), self._error(after)
        if not errors[1] < errors[0]:
            return None
        change = ModelChange(self.postures, self._told(before, after), *errors, self.robot)
        self.robot = with_values(self.robot, self._catalogue, after.items())
        self.changes.append(change)
        self._changed_at = self.postures
        return change

    def _told(
        self, before: dict[FreeParameter, float], after: dict[FreeParameter, float]
    ) -> tuple[ParameterChange, ...]:
        return tuple(
            ParameterChange(
                one.free.effect, one.free.key, before[one.free], after[one.free],
                one.low, one.high, one.free.parameter.unit,
            )
            for one in self._followed
        )  # fmt: skip

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
