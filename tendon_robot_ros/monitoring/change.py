"""
Possible changes of an arm, fitted to the postures since an alarm, and the next posture to measure.

Effects appear, cells get softer, gains change, trackers are bumped.

The drift alarm treats changes to first order. Here a change theta acts in the model itself; the
imperfections b of the arm have the posterior before the change,

    y = f(T, b0; theta) + B (b - b0) + remainder + noise,   b ~ N(b0, P),   theta ~ N(0, s² T)

and the evidence of the change follows by Laplace's approximation,

    log E = -1/2 (r' V^-1 r + theta' (s² T)^-1 theta + log |V| + log |1 + s² T J' V^-1 J|),

with a few equally likely scales s, because the size of a change is unknown. The worth of a posture
is the separation of the likely changes there, each at its fitted value and free within its
uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.special import softmax

from ..common.arrays import Bools, Floats
from ..common.errors import NoEquilibriumError
from ..common.estimation import gauss_newton
from ..common.words import digits, mm, spoken, with_unit
from ..diagnosis.next_measurement import as_if_measured
from ..inference.imperfections import GAIN, BuiltPredictor, Kind
from ..inference.intervals import load_of, vector_rows
from ..inference.marginal import RandomEffects
from ..inference.outliers import TRIALS_MIN
from ..inference.predict import CELLS, FreeParameter, Point, Predictor, free_parameters
from ..inference.statistics import RARE, SIGNIFICANCE, TIE_SCORE, chi2_sf
from ..report.sentences import load_words
from .built_arm import FRAME, ODD_PROBABILITY, BuiltArm, moving_effects, slopes, solved

TRACKER = 'the tracker'  # a bumped one is a misaligned base
SHIFT = 'shift'  # prefix of the keys of a translation; the others are a rotation
# [1] of a typical or plausible size: scales s of a change, equally likely, because its size is
# unknown
SCALES = 1.0, 10.0, 100.0
CONFIRMED_POSTURES = TRIALS_MIN  # one of those that confirm a change may be an outlier
# [1] postures by which the arm before and after a change is judged, and between two possible
# ones: one more in every posture would cost as much as the filter
JUDGED_POSTURES = 4
# [1] parameters of an effect in a sentence, else it would not be read
SIZES_REPORTED = 2


@dataclass(frozen=True)
class PossibleChange:
    """A possible change: an effect that appeared, or imperfections that changed."""

    name: str
    keys: tuple[str, ...]
    spread: Floats  # (k,) prior 1 sd of its values [their units]
    frees: tuple[FreeParameter, ...] = ()  # of an effect
    members: slice = slice(0)  # among the imperfections of the arm
    gravity: tuple[float, float, float] | None = None  # [m/s²]

    @property
    def is_effect(self) -> bool:
        """Whether the model has parameters for it."""
        return bool(self.frees)

    @property
    def information(self) -> Floats:
        """Information (k, k) of the widest prior of its values."""
        return np.diag((SCALES[-1] * self.spread) ** -2.0)

    def suspect(self, probability: float, values: Floats) -> Suspect:
        """Return the change with a probability and values (k,) [its units]."""
        named = dict(zip(self.keys, values.tolist(), strict=True))
        of_catalogue = self.is_effect and self.name != TRACKER
        return Suspect(self.name, probability, named, self._size(values), of_catalogue)

    def _size(self, values: Floats) -> str:
        if self.name == TRACKER:
            moves = np.array([key.startswith(SHIFT) for key in self.keys])
            moved, turned = np.linalg.norm(values[moves]), np.linalg.norm(values[~moves])
            return f'{mm(float(moved), 2)}, {digits(float(np.degrees(turned)))}°'
        if not self.is_effect:
            return f'{100.0 * values[0]:+.1f} %'
        if rows := vector_rows(self.frees, self.name):
            return load_words(load_of(values[rows], None, self.gravity))
        sizes = [abs(v) / f.parameter.typical for v, f in zip(values, self.frees, strict=True)]
        parts = []
        for i in np.argsort(sizes)[::-1][:SIZES_REPORTED]:
            size = f'{spoken(self.keys[i])} {digits(float(values[i]))}'
            parts.append(with_unit(size, self.frees[i].parameter.unit))
        return ', '.join(parts)


@dataclass(frozen=True)
class Suspect:
    """A possible change with its probability."""

    name: str
    probability: float  # posterior, given that there was a change
    values: dict[str, float]  # most likely size, by parameter [its unit]
    size: str = ''  # the same in words
    is_effect: bool = True  # of the catalogue; else an imperfection


def changes_of(arm: BuiltArm) -> tuple[PossibleChange, ...]:
    """Return the possible changes: effects, single cells, gains, the tracker's frame."""
    changes = list[PossibleChange]()
    for effect in moving_effects(arm.robot, arm.catalogue):
        frees = free_parameters(effect, arm.robot)
        usual = np.array([free.parameter.typical for free in frees])
        keys = tuple(free.key for free in frees)
        name = TRACKER if effect.name == FRAME else effect.name
        changes.append(PossibleChange(name, keys, usual, frees, gravity=arm.robot.gravity))
    count = 0
    for kind in arm.kinds:
        indices, count = range(count, count + len(kind)), count + len(kind)
        if what := {CELLS: 'stiffness of', GAIN: 'gain of'}.get(kind.name):
            usual = np.full(1, kind.plausible)
            changes += [
                PossibleChange(f'{what} {name}', ('relative_change',), usual, (), slice(i, i + 1))
                for i, name in zip(indices, kind.members, strict=True)
            ]
    return tuple(changes)


def described(suspects: Sequence[Suspect]) -> str:
    """Return the likely suspects in words."""
    named = [
        f'{s.name} ({100.0 * s.probability:.0f} %)'
        for s in suspects
        if s.probability > SIGNIFICANCE
    ]
    return ', '.join(named) or 'nothing of the catalogue'


class _Weights:
    """Covariance V of the visible coordinates: of each posture, and by imperfections of all."""

    def __init__(
        self, arm: BuiltArm, visible: Bools, frames: Sequence[int], columns: Floats
    ) -> None:
        """Take visible coordinates (P, 3 J), columns (P, 3 J, q + n) [m per sd] of `Expected`."""
        self.rows, self._roots, self.log_determinant = visible, list[Floats](), 0.0
        for rows, own, count in zip(visible, columns, frames, strict=True):
            root = np.linalg.cholesky(arm.widening * arm.scatter(rows, own, count))
            self.log_determinant += 2.0 * float(np.log(np.diag(root)).sum())
            self._roots.append(np.linalg.inv(root))
        q = len(arm.covariance)
        known = np.linalg.cholesky(arm.widening * arm.covariance + 1e-12 * np.eye(q))
        built, size = Kind('built', '1', 1.0, tuple(map(str, range(q)))), np.ones(1)
        owners = np.zeros(q, dtype=np.int64)
        self._random = RandomEffects(self._scattered(columns[..., :q]) @ known, owners, [built])
        self._lift = self._random.root(size)
        self.log_determinant += self._random.log_determinant(size)

    def _scattered(self, values: Floats) -> Floats:
        """Whiten values (P, 3 J, ...) by the scatter of each posture: (N, ...)."""
        parts = zip(self._roots, values, self.rows, strict=True)
        return np.concatenate([root @ own[rows] for root, own, rows in parts])

    def white(self, values: Floats) -> Floats:
        """Whiten values (P, 3 J, ...): (N, ...), whose products are x' V^-1 y."""
        return self._random.lift(self._lift, self._scattered(values))


@dataclass(frozen=True)
class ChangeFit:
    """A change at its most likely size."""

    change: PossibleChange
    values: Floats  # (k,) [its units]
    log: float  # log E
    information: Floats  # (k, k) of the values, their prior included
    chi2: float = 0.0  # of the residuals


class ChangeWork:
    """Fits of changes to postures: tensions (P, m) [N], markers (P, 3 J) [m], (P,) frames."""

    def __init__(
        self, arm: BuiltArm, tensions: Floats, positions: Floats, frames: Sequence[int]
    ) -> None:
        self.arm, self.positions, self.frames = arm, positions, frames
        self.rows = np.isfinite(positions)
        dataset, _ = as_if_measured(arm.predictor.dataset, tensions)
        self.predictor = BuiltPredictor(Predictor(dataset, arm.robot, arm.catalogue))
        self.predictor.around, self.lacked = arm.members, np.zeros(positions.shape)
        expected = self._markers({})
        self.columns = arm.moved(self.predictor, {})
        self.lacked = arm.lacked(self.columns)
        self.expected = expected + self.lacked
        self.weights = _Weights(arm, self.rows, frames, self.columns)

    def fit(self, change: PossibleChange) -> ChangeFit | None:
        """Fit one change, with the imperfections linearised without a change."""
        if change.is_effect:
            return self._effect(change)
        white = self.weights.white(self.positions - self.expected)
        columns = self.weights.white(self._slopes_of_members(change))  # of imperfections: linear
        normal = columns.T @ columns + change.information
        values = np.linalg.solve(normal, columns.T @ white)
        return self._fitted(change, values, white - columns @ values, columns)

    def fit_around(self, fit: ChangeFit) -> ChangeFit | None:
        """Refit an effect, with the imperfections linearised at its value."""
        with suppress(NoEquilibriumError):
            columns = self.arm.moved(self.predictor, self._point(fit.change, fit.values))
            there = copy(self)
            there.weights = _Weights(self.arm, self.rows, self.frames, columns)
            return there._effect(fit.change, fit.values)
        return None

    def fit_from_afar(self, fit: ChangeFit) -> ChangeFit:
        """
        Fit an effect from several starts, plus and minus its usual size; return the best.

        A load that buckles the arm has several minima, and the one that is reached from zero may
        not be the global one.
        """
        starts = np.vstack([np.diag(fit.change.spread), -np.diag(fit.change.spread)])
        fits = [self._effect(fit.change, start) for start in starts]
        return max([fit, *(one for one in fits if one is not None)], key=lambda one: one.log)

    def predicted(self, fit: ChangeFit) -> tuple[Floats, Floats]:
        """Return markers (P, 3 J) [m] under a change, and their slopes (P, 3 J, k)."""
        if not fit.change.is_effect:
            moved = self._slopes_of_members(fit.change)
            return self.expected + moved @ fit.values, moved
        point = self._point(fit.change, fit.values)
        return self._markers(point), slopes(self.predictor, point, fit.change.frees)

    def apart(
        self, one: tuple[Floats, Floats], other: tuple[Floats, Floats], information: Floats
    ) -> Floats:
        """Return the separation (P,) [sd²] of two changes, with the second one free to adapt."""
        off, far = one[0] - other[0], np.zeros(len(self.frames))
        for p, frames in enumerate(self.frames):
            rows = np.ones(off.shape[1], dtype=bool)
            spread = self.arm.widening * self.arm.spread(rows, self.columns[p], frames)
            solved = np.linalg.solve(spread, np.column_stack([off[p], other[1][p]]))
            along = other[1][p].T @ solved[:, 0]
            both = information + other[1][p].T @ solved[:, 1:]
            far[p] = off[p] @ solved[:, 0] - along @ np.linalg.solve(both, along)
        return np.maximum(far, 0.0)

    def _effect(self, change: PossibleChange, start: Floats | None = None) -> ChangeFit | None:
        """Fit an effect by damped Gauss-Newton within its bounds."""
        frees, weights = change.frees, self.weights
        described = np.array([self.predictor.value(free) for free in frees])
        low, high = np.array([(f.parameter.low, f.parameter.high) for f in frees]).T - described

        def residual_of(values: Floats) -> Floats:
            return weights.white(self.positions - self._markers(self._point(change, values)))

        def columns_of(values: Floats, white: Floats) -> Floats:
            return weights.white(slopes(self.predictor, self._point(change, values), frees))

        start = np.zeros(len(frees)) if start is None else start
        with suppress(NoEquilibriumError):
            fit = gauss_newton(start, change.information, residual_of, columns_of, (low, high))
            return self._fitted(change, *fit)
        return None

    def _fitted(
        self, change: PossibleChange, values: Floats, white: Floats, columns: Floats
    ) -> ChangeFit:
        """Return a fit with its evidence, averaged over equally likely scales of the change."""
        logs, chi2, information = [], float(white @ white), columns.T @ columns
        for scale in SCALES:
            spread = scale * change.spread
            both = np.eye(len(values)) + information * np.outer(spread, spread)
            cost = float(((values / spread) ** 2).sum()) + float(np.linalg.slogdet(both)[1])
            logs.append(-0.5 * (chi2 + cost + self.weights.log_determinant))
        log = float(np.logaddexp.reduce(logs) - np.log(len(SCALES)))
        return ChangeFit(change, values, log, information + change.information, chi2)

    def _point(self, change: PossibleChange, values: Floats) -> Point:
        own = zip(change.frees, values.tolist(), strict=True)
        return {free: self.predictor.value(free) + value for free, value in own}

    def _markers(self, point: Point) -> Floats:
        return solved(self.predictor.markers(point)).reshape(self.lacked.shape) + self.lacked

    def _slopes_of_members(self, change: PossibleChange) -> Floats:
        """Return the Jacobian of the markers by imperfections (P, 3 J, k), per unit."""
        return self.columns[:, :, change.members] / self.arm.plausible[change.members]


class ChangeFinder:
    """
    Infers the change from the postures since it began.

    Parameters
    ----------
    arm : BuiltArm
        Estimate before the change; it is not modified.
    changes : sequence of PossibleChange
        Possible changes.

    """

    def __init__(self, arm: BuiltArm, changes: Sequence[PossibleChange]) -> None:
        """Begin without postures."""
        self.arm, self.changes = arm, tuple(changes)
        self.postures: list[tuple[Floats, Floats, int]] = []  # tensions, markers (3 J,), frames
        self.fits: list[ChangeFit] = []  # the most likely first

    def take(self, tensions: Floats, positions: Floats, frames: int = 1) -> None:
        """Add a posture: (m,) [N], the mean of frames (J, 3) [m], nan for a missing marker."""
        self.postures.append((np.maximum(tensions, 0.0), positions.ravel(), frames))

    def suspects(self) -> tuple[Suspect, ...]:
        """Fit every change; return them by probability, the most likely first."""
        tensions, positions, frames = zip(*self.postures, strict=True)
        try:
            work = ChangeWork(self.arm, np.array(tensions), np.array(positions), frames)
        except NoEquilibriumError:
            return ()
        fits = [fit for change in self.changes if (fit := work.fit(change)) is not None]
        least = min((fit.chi2 for fit in fits), default=np.inf)
        if chi2_sf(least, int(work.rows.sum())) <= ODD_PROBABILITY:  # none explains the postures
            fits = [work.fit_from_afar(fit) if fit.change.is_effect else fit for fit in fits]
        best, near_log = max(fit.log for fit in fits), np.log(ODD_PROBABILITY)
        near = [fit for fit in fits if fit.change.is_effect and fit.log > best + near_log]
        refitted = {fit.change.name: work.fit_around(fit) for fit in near}
        fits = [refitted.get(fit.change.name) or fit for fit in fits]
        self.fits = sorted(fits, key=lambda fit: -fit.log)
        likely = zip(self.fits, self._probabilities().tolist(), strict=True)
        return tuple(fit.change.suspect(p, fit.values) for fit, p in likely)

    def most_informative(self, offered: Floats) -> int | None:
        """
        Return the index of the tensions (b, m) [N] that separate the likely changes best.

        None where one change is confirmed, or where no offered posture separates them.
        """
        probabilities, few = self._probabilities(), len(self.postures) < CONFIRMED_POSTURES
        if not len(probabilities) or (probabilities[0] > 1.0 - SIGNIFICANCE and not few):
            return None
        likely = np.flatnonzero(probabilities > RARE).tolist()
        blank = np.zeros((len(offered), self.arm.predictor.dataset.positions.shape[2] * 3))
        usual = self.postures[-1][2] if self.postures else 1
        frames = (usual,) * len(offered)
        try:
            work = ChangeWork(self.arm, np.maximum(offered, 0.0), blank, frames)
            first = work.predicted(self.fits[likely[0]])
        except NoEquilibriumError:
            return None
        worth = np.zeros(len(offered))
        for i in likely[1:]:
            with suppress(NoEquilibriumError):
                other = work.predicted(self.fits[i])
                apart = work.apart(first, other, self.fits[i].information)
                worth += probabilities[i] * np.log1p(apart)
        best = int(np.argmax(worth))
        worth_min = np.log1p(TIE_SCORE) * probabilities[likely[1:]].sum()
        return best if worth[best] > worth_min else None

    def _probabilities(self) -> Floats:
        logs = np.array([fit.log for fit in self.fits])
        return np.asarray(softmax(logs)) if len(logs) else logs
