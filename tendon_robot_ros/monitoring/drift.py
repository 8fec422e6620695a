"""
Is the arm still what it was: a sequential test with a stated false-alarm rate.

`BuiltArm` predicts every posture at which the arm stands. A change theta (an effect of the
catalogue appears, a cell gets softer, a gain moves, the tracker is bumped) that began at a posture
shifts the innovations of its Kalman filter by G theta; the signatures G follow from the filter's
gains (Willsky and Jones 1976). With theta ~ N(0, T) each change gives a likelihood ratio

    log E = 1/2 d' (C + T^-1)^-1 d - 1/2 log det(1 + T C),   C = sum G' S^-1 G,  d = sum G' S^-1 nu

whose mean without a change is 1: an e-process. Averaged over the changes and added up over the
postures at which one may have begun, it is an e-detector (Shin, Ramdas, Rinaldo 2023): an alarm at
a sum of A comes without a change on average after A beginnings at the earliest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..comparison.predict import CELLS, FreeParameter, Predictor, free_parameters
from ..diagnosis.as_built import GAIN, POSITION, ROTATION
from .built_arm import BuiltArm

Floats = npt.NDArray[np.float64]
BEGIN_EVERY = 4  # postures between two at which a change may begin
BEGINNINGS_KEPT = 8
STEP_SHARE = 0.1  # of a typical size, of a difference
CHANGES = {CELLS: 0.1, GAIN: 0.03, POSITION: 2e-3, ROTATION: 0.01}  # 1 sd of a change
TRACKER = 'the tracker'


@dataclass(frozen=True)
class Suspect:
    """A change that may have happened."""

    name: str
    probability: float  # among all changes, given that there was one
    values: dict[str, float]  # most likely size, by parameter [its unit]


@dataclass(frozen=True)
class DriftState:
    """What is known after a posture."""

    alarm: bool
    evidence: float  # the sum; an alarm at the threshold
    postures: int  # since the change that is most likely began
    suspects: tuple[Suspect, ...] = ()  # most likely first, while there is an alarm


@dataclass(frozen=True)
class _Change:
    """A kind of change: its columns in the stacked signatures."""

    name: str
    columns: slice
    keys: tuple[str, ...]


class _ChangeBegun:
    """A posture at which a change may have begun, and what came since."""

    def __init__(self, states: int, changes: int) -> None:
        self.followed = np.zeros((states, changes))  # what the filter took for imperfections
        self.told = np.zeros((changes, changes))
        self.seen = np.zeros(changes)
        self.postures = 0


class DriftAlarm:
    """Watches an arm posture by posture."""

    def __init__(self, arm: BuiltArm, postures: float = 20000.0) -> None:
        """
        Begin; the arm has learned its reference postures.

        Parameters
        ----------
        arm : BuiltArm
        postures : float
            Without a change no alarm before so many postures, on average and at least.

        """
        self.arm, self.threshold = arm, max(postures / BEGIN_EVERY, 2.0)
        self._frees: list[FreeParameter] = []
        self._changes: list[_Change] = []
        self._spread: Floats = np.zeros(0)
        self._beginnings: list[_ChangeBegun] = []
        self._count = 0
        self.state = DriftState(False, 0.0, 0)

    def update(self, tensions: Floats, positions: Floats, frames: int = 1) -> DriftState:
        """
        Take a posture at which the arm stands.

        Parameters
        ----------
        tensions : (m,) [N]
        positions : (J, 3) [m], nan where a marker was not seen
        frames : int
            Of which the positions are the mean.

        """
        arm, measured = self.arm, positions.ravel()
        expected = arm.expected(tensions)
        rows = np.isfinite(measured)
        if expected is None or not rows.any():
            return self.state
        shown = self._signatures(tensions, expected.columns)
        if shown is None:
            return self.state
        columns, shown = expected.columns[rows], shown[rows]
        innovation = measured[rows] - expected.markers[rows]
        covariance = columns @ arm.covariance @ columns.T + arm.scatter(
            rows, expected.columns, frames
        )
        gain = arm.covariance @ columns.T @ np.linalg.inv(covariance)
        inverse = np.linalg.inv(arm.widening * covariance)
        if self._count % BEGIN_EVERY == 0:
            self._beginnings.append(_ChangeBegun(len(arm.mean), len(self._spread)))
            del self._beginnings[:-BEGINNINGS_KEPT]
        self._count += 1
        for begun in self._beginnings:
            signature = shown - columns @ begun.followed
            weighted = inverse @ signature
            begun.told += signature.T @ weighted
            begun.seen += weighted.T @ innovation
            begun.followed += gain @ signature
            begun.postures += 1
        arm.learn(expected, measured, frames)
        self.state = self._judged()
        return self.state

    def restart(self) -> None:
        """Forget the evidence, after a change was looked after."""
        self._beginnings, self._count = [], 0
        self.state = DriftState(False, 0.0, 0)

    def _judged(self) -> DriftState:
        """Add up the evidence, and name what it speaks for."""
        logs = np.array([[self._log_ratio(b, c) for c in self._changes] for b in self._beginnings])
        evidence = float(np.exp(np.minimum(logs, 600.0)).mean(axis=1).sum())
        begun = self._beginnings[int(np.argmax(logs.max(axis=1)))]
        alarm = self.state.alarm or evidence >= self.threshold
        suspects = self._suspects(logs) if alarm else ()
        return DriftState(alarm, evidence, begun.postures, suspects)

    def _suspects(self, logs: Floats) -> tuple[Suspect, ...]:
        """Name changes by their probability, the most likely first."""
        total = np.logaddexp.reduce(logs, axis=0)
        shares = np.exp(total - np.logaddexp.reduce(total))
        made = []
        for i in np.argsort(-shares)[:5].tolist():
            change, begun = self._changes[i], self._beginnings[int(np.argmax(logs[:, i]))]
            told, seen = self._of(begun, change)
            sizes = np.linalg.solve(told + np.eye(len(seen)), seen) * self._spread[change.columns]
            values = dict(zip(change.keys, sizes.tolist(), strict=True))
            made.append(Suspect(change.name, float(shares[i]), values))
        return tuple(made)

    def _log_ratio(self, begun: _ChangeBegun, change: _Change) -> float:
        told, seen = self._of(begun, change)
        both = told + np.eye(len(seen))
        gained = float(seen @ np.linalg.solve(both, seen))
        return 0.5 * gained - 0.5 * float(np.linalg.slogdet(both)[1])

    def _of(self, begun: _ChangeBegun, change: _Change) -> tuple[Floats, Floats]:
        """Return information and score of a change, in units of its prior."""
        scale = self._spread[change.columns]
        told = begun.told[change.columns, change.columns] * np.outer(scale, scale)
        return told, begun.seen[change.columns] * scale

    def _signatures(self, tensions: Floats, built: Floats) -> Floats | None:
        """Return what a unit of every change does to the markers, (3 J, c) [m per unit]."""
        whole, inputs = self.arm.whole, np.maximum(tensions, 0.0)[None]
        here = whole.markers({}, inputs)
        if here is None:
            return None
        if not self._changes:
            self._list_changes(whole)
        columns = []
        for free in self._frees:
            value, step = whole.value(free), STEP_SHARE * free.parameter.typical
            if value + step > free.parameter.high:
                step = -step
            moved = whole.markers({free: value + step}, inputs)
            columns.append(np.zeros(here.size) if moved is None else (moved - here).ravel() / step)
        return np.column_stack([*columns, built / self.arm.plausible])

    def _list_changes(self, whole: Predictor) -> None:
        """List what may change: effects, single cells, gains, the tracker's frame."""
        spread: list[float] = []
        for effect in self.arm.catalogue:
            if effect.needs in ('history', 'pulls'):
                continue
            if effect.acts_on and effect.acts_on not in self.arm.robot.effects:
                continue
            frees = free_parameters(effect, self.arm.robot)
            place = slice(len(spread), len(spread) + len(frees))
            self._changes.append(_Change(effect.name, place, tuple(f.key for f in frees)))
            self._frees += frees
            spread += [free.parameter.typical for free in frees]
        count, tracker = len(spread), list[int]()
        for kind in self.arm.kinds:
            here = range(count, count + len(kind))
            count += len(kind)
            spread += [CHANGES.get(kind.name, 1.0)] * len(kind)
            if kind.name in (POSITION, ROTATION):
                tracker += here
            elif kind.name in CHANGES:
                what = 'stiffness of' if kind.name == CELLS else 'gain of'
                self._changes += [
                    _Change(f'{what} {name}', slice(i, i + 1), ('relative_change',))
                    for i, name in zip(here, kind.members, strict=True)
                ]
        if tracker:
            place = slice(tracker[0], tracker[-1] + 1)
            self._changes.append(_Change(TRACKER, place, _frame_keys(len(tracker))))
        self._spread = np.array(spread)


def _frame_keys(count: int) -> tuple[str, ...]:
    """Name the parameters of the tracker's frame."""
    return tuple(f'{what}_{axis}' for what in (POSITION, ROTATION) for axis in 'xyz')[:count]


def described(suspects: Sequence[Suspect]) -> str:
    """Say what it looks like."""
    named = [f'{s.name} ({100.0 * s.probability:.0f} %)' for s in suspects if s.probability > 0.05]
    return ', '.join(named) or 'nothing of the catalogue'
