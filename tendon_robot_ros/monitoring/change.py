"""
What may happen to an arm, each fitted to the postures since an alarm, and the posture to ask next.

Effects appear, cells get softer, gains move, trackers are bumped.

The drift alarm looks at changes to first order, at postures that happened to come. Here a change
theta moves the model itself; the arm is otherwise as it was known before,

    y = f(T, b0; theta) + B (b - b0) + remainder + noise,   b ~ N(b0, P),   theta ~ N(0, s² T)

and the change is worth its evidence by Laplace's approximation,

    log E = -1/2 (r' V^-1 r + theta' (s² T)^-1 theta + log |V| + log |1 + s² T J' V^-1 J|),

s one of a few scales, each as likely as the others: nobody knows how large a change is. A posture
is worth how far the likely changes would lie apart there, each with the value that was fitted and
free to follow within what is known of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..common.estimation import gauss_newton
from ..common.words import digits, mm, spoken, with_unit
from ..comparison.predict import CELLS, FreeParameter, Point, Predictor, free_parameters
from ..comparison.statistics import chi2_sf
from ..data import DataSet
from ..diagnosis.imperfections import GAIN, SplitPredictor
from ..diagnosis.intervals import load_of, vector_rows
from ..diagnosis.slopes import imperfections
from ..report.sentences import load_words
from .built_arm import ODD_PROBABILITY, BuiltArm

TRACKER, FRAME = 'the tracker', 'base_misalignment'  # a tracker that was bumped does what it does
SHIFT = 'shift'  # of the frame; the other keys of the effect are a rotation
# [1] relative 1 sd of a change of a kind of imperfection: what is seen on arms that wear
# (assumed), because nobody knows more
USUAL_CHANGES = {CELLS: 0.1, GAIN: 0.03}
# [m] 1 sd of a bumped tracker (assumed), because nobody knows how hard
USUAL_SHIFT = 2e-3
# [rad] 1 sd of the same, at half a metre as far as the shift and more, because it stands there
USUAL_ROTATION = 0.01
# [1] of a usual size, that a change may have, each as likely, because nobody knows how large it is
SCALES = 1.0, 10.0, 100.0
# [1] of log E behind the best, within which a change is fitted around itself; what is further off
# would not become likely by that
CLOSE_LOG = 30.0
# [1] probability of one change, from which nothing needs to be asked; what is left may be chance
APART_PROBABILITY = 0.95
# [1] postures that a change is judged by, unless nothing else is left at all: one or two may be
# odd, so that two of three tell
CONFIRMED_POSTURES = 3
# [1] probability of a change that a posture is chosen for; for less it would be asked in vain
LIKELY_MIN = 1e-3
# [1] changes that a posture is chosen for, because further ones are unlikely beside them
LIKELY_MAX = 4
# [sd²] of one posture; with less a dozen of them would not tell
HOPELESS_APART = 0.25
# [1] parameters of an effect that are told, else the sentence would not be read
SIZES_TOLD = 2


@dataclass(frozen=True)
class PossibleChange:
    """Something that may have happened: an effect, or imperfections that moved."""

    name: str
    keys: tuple[str, ...]
    spread: Floats  # (k,) 1 sd of its values, as they usually are [their units]
    frees: tuple[FreeParameter, ...] = ()  # of an effect
    members: slice = slice(0)  # among the imperfections of the arm
    gravity: tuple[float, float, float] | None = None  # [m/s²]

    @property
    def is_effect(self) -> bool:
        """Whether the model has parameters for it."""
        return bool(self.frees)

    def suspect(self, probability: float, values: Floats) -> Suspect:
        """Return it with a probability and a size (k,) [its units]."""
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
        for i in np.argsort(sizes)[::-1][:SIZES_TOLD]:
            size = f'{spoken(self.keys[i])} {digits(float(values[i]))}'
            parts.append(with_unit(size, self.frees[i].parameter.unit))
        return ', '.join(parts)


@dataclass(frozen=True)
class Suspect:
    """A change that may have happened."""

    name: str
    probability: float  # among all changes, given that there was one
    values: dict[str, float]  # most likely size, by parameter [its unit]
    size: str = ''  # the same in words
    is_effect: bool = True  # of the catalogue; else an imperfection of the arm moved


def changes_of(arm: BuiltArm) -> tuple[PossibleChange, ...]:
    """List what may happen to an arm: effects, single cells, gains, the tracker's frame."""
    made = list[PossibleChange]()
    for effect in arm.catalogue:
        if effect.needs in ('history', 'pulls'):
            continue
        if effect.acts_on and effect.acts_on not in arm.robot.effects:
            continue
        frees = free_parameters(effect, arm.robot)
        usual = np.array([free.parameter.typical for free in frees])
        keys = tuple(free.key for free in frees)
        down = arm.robot.gravity
        name = effect.name
        if name == FRAME:
            name = TRACKER
            usual = np.array(
                [USUAL_SHIFT if k.startswith(SHIFT) else USUAL_ROTATION for k in keys]
            )
        made.append(PossibleChange(name, keys, usual, frees, gravity=down))
    count = 0
    for kind in arm.kinds:
        here, count = range(count, count + len(kind)), count + len(kind)
        usual = np.full(1, USUAL_CHANGES.get(kind.name, 1.0))
        if kind.name in USUAL_CHANGES:
            what = 'stiffness of' if kind.name == CELLS else 'gain of'
            made += [
                PossibleChange(f'{what} {name}', ('relative_change',), usual, (), slice(i, i + 1))
                for i, name in zip(here, kind.members, strict=True)
            ]
    return tuple(made)


def described(suspects: Sequence[Suspect]) -> str:
    """Say what it looks like."""
    named = [
        f'{s.name} ({100.0 * s.probability:.0f} %)'
        for s in suspects
        if s.probability > 1.0 - APART_PROBABILITY
    ]
    return ', '.join(named) or 'nothing of the catalogue'


@dataclass(frozen=True)
class PosturesSeen:
    """Postures as measured."""

    tensions: Floats  # (P, m) [N]
    positions: Floats  # (P, 3 J) [m]
    frames: tuple[int, ...]

    @cached_property
    def rows(self) -> npt.NDArray[np.bool_]:
        """Which coordinates were seen (P, 3 J)."""
        return np.isfinite(self.positions)


class _Weights:
    """The covariance V of what is seen, in the space of the imperfections."""

    def __init__(self, arm: BuiltArm, seen: PosturesSeen, columns: Floats) -> None:
        """Take the columns (P, 3 J, q) [m per sd] of the imperfections."""
        self.rows, self._roots, log = seen.rows, list[Floats](), 0.0
        for rows, own, frames in zip(seen.rows, columns, seen.frames, strict=True):
            root = np.linalg.cholesky(arm.widening * arm.scatter(rows, own, frames))
            log += 2.0 * float(np.log(np.diag(root)).sum())
            self._roots.append(np.linalg.inv(root))
        q = len(arm.covariance)
        known = np.linalg.cholesky(arm.widening * arm.covariance + 1e-12 * np.eye(q))
        self._built = self.white(columns) @ known
        inner = np.linalg.cholesky(np.eye(q) + self._built.T @ self._built)
        self._inner = np.linalg.inv(inner)
        self.log_determinant = log + 2.0 * float(np.log(np.diag(inner)).sum())

    def white(self, values: Floats) -> Floats:
        """Whiten values (P, 3 J, ...) by what is new in every posture: (N, ...)."""
        parts = zip(self._roots, values, self.rows, strict=True)
        return np.concatenate([root @ own[rows] for root, own, rows in parts])

    def lifted(self, white: Floats) -> tuple[Floats, Floats]:
        """Return whitened values and what of them imperfections would take."""
        return white, self._inner @ (self._built.T @ white)

    @staticmethod
    def product(one: tuple[Floats, Floats], other: tuple[Floats, Floats]) -> Floats:
        """Return x' V^-1 y of two that were lifted."""
        return np.asarray(one[0].T @ other[0] - one[1].T @ other[1])


@dataclass(frozen=True)
class ChangeFit:
    """A change at its most likely size."""

    change: PossibleChange
    values: Floats  # (k,) [its units]
    log: float  # log E
    information: Floats  # (k, k) of the values, their prior included
    chi2: float = 0.0  # that it leaves of the postures

    def suspect(self, probability: float) -> Suspect:
        """Return the change with a probability."""
        return self.change.suspect(probability, self.values)


class ChangeWork:
    """Fits to one set of postures."""

    def __init__(self, arm: BuiltArm, seen: PosturesSeen) -> None:
        self.arm, self.seen = arm, seen
        whole, P = self.arm.split.dataset, len(seen.tensions)
        dataset = DataSet(
            'since',
            self.arm.robot,
            whole.markers,
            tuple(map(str, range(P))),
            seen.tensions,
            np.full((P, 1, len(whole.markers), 3), np.nan),
            gravity=self.arm.robot.gravity,
        )
        self.split = SplitPredictor(Predictor(dataset, self.arm.robot, self.arm.catalogue))
        self.split.around = self.arm.members
        here = self._markers({})
        columns = self._columns({}) if here is not None else None
        self.ready = columns is not None
        if here is not None and columns is not None:
            self.here, self.columns = here, columns
            self.weights = _Weights(self.arm, seen, columns)

    def fit(self, change: PossibleChange) -> ChangeFit | None:
        """Fit one change, around the arm as it was."""
        return self._effect(change) if change.is_effect else self._member(change)

    def fit_around(self, fit: ChangeFit) -> ChangeFit | None:
        """Fit an effect once more, imperfections as they move the arm that it acts on."""
        columns = self._columns(self._point(fit.change, fit.values))
        if columns is None:
            return None
        usual, self.weights = self.weights, _Weights(self.arm, self.seen, columns)
        try:
            return self._effect(fit.change, fit.values)
        finally:
            self.weights = usual

    def explains(self, fit: ChangeFit) -> bool:
        """Tell whether what a change leaves may be chance."""
        return chi2_sf(fit.chi2, int(self.seen.rows.sum())) > ODD_PROBABILITY

    def fit_from_afar(self, fit: ChangeFit) -> ChangeFit:
        """
        Fit an effect from a usual size of each of its values, either way; return the best.

        A load under which the arm bends over has several minima, and the one that is reached from
        no load at all may be none that it has.
        """
        starts = np.vstack([np.diag(fit.change.spread), -np.diag(fit.change.spread)])
        fits = [self._effect(fit.change, start) for start in starts]
        return max([fit, *(one for one in fits if one is not None)], key=lambda one: one.log)

    def shown(self, fit: ChangeFit) -> tuple[Floats, Floats] | None:
        """Return markers (P, 3 J) [m] under a change, and their slopes (P, 3 J, k)."""
        if not fit.change.is_effect:
            slopes = self._slopes_of_members(fit.change)
            return self.here + slopes @ fit.values, slopes
        point = self._point(fit.change, fit.values)
        there, moved = self._markers(point), self._slopes(fit.change, point)
        return None if there is None or moved is None else (there, moved)

    def apart(
        self, one: tuple[Floats, Floats], other: tuple[Floats, Floats], information: Floats
    ) -> Floats:
        """Return how far two changes lie apart (P,) in sd², the other free to follow."""
        off, far = one[0] - other[0], np.zeros(len(self.seen.tensions))
        for p, frames in enumerate(self.seen.frames):
            columns, rows = self.columns[p], np.ones(off.shape[1], dtype=bool)
            spread = self.arm.scatter(rows, columns, frames)
            spread = self.arm.widening * (spread + columns @ self.arm.covariance @ columns.T)
            solved = np.linalg.solve(spread, np.column_stack([off[p], other[1][p]]))
            along = other[1][p].T @ solved[:, 0]
            both = information + other[1][p].T @ solved[:, 1:]
            far[p] = off[p] @ solved[:, 0] - along @ np.linalg.solve(both, along)
        return np.maximum(far, 0.0)

    def _member(self, change: PossibleChange) -> ChangeFit:
        """Fit imperfections that moved: linear."""
        weights, slopes = self.weights, self._slopes_of_members(change)
        white = weights.lifted(weights.white(self.seen.positions - self.here))
        columns = weights.lifted(weights.white(slopes))
        information = weights.product(columns, columns)
        prior = np.diag((SCALES[-1] * change.spread) ** -2.0)
        values = np.linalg.solve(information + prior, weights.product(columns, white))
        left = white[0] - columns[0] @ values, white[1] - columns[1] @ values
        chi2 = float(weights.product(left, left))
        log = self._evidence(change, values, chi2, information)
        return ChangeFit(change, values, log, information + prior, chi2)

    def _effect(self, change: PossibleChange, start: Floats | None = None) -> ChangeFit | None:
        """Fit an effect by Gauss-Newton, shortened steps, within its bounds."""
        frees, weights = change.frees, self.weights
        described = np.array([self.split.value(free) for free in frees])
        low, high = np.array([(f.parameter.low, f.parameter.high) for f in frees]).T - described
        prior = np.diag((SCALES[-1] * change.spread) ** -2.0)

        def linearised(
            values: Floats, left: tuple[Floats, Floats]
        ) -> tuple[Floats, Floats] | None:
            slopes = self._slopes(change, self._point(change, values))
            if slopes is None:
                return None
            columns = weights.lifted(weights.white(slopes))
            return weights.product(columns, columns), weights.product(columns, left)

        def left(values: Floats) -> tuple[tuple[Floats, Floats], float] | None:
            there = self._markers(self._point(change, values))
            if there is None:
                return None
            white = weights.lifted(weights.white(self.seen.positions - there))
            return white, float(weights.product(white, white))

        start = np.zeros(len(frees)) if start is None else start
        fit = gauss_newton(start, prior, left, linearised, (low, high))
        if fit is None:
            return None
        values, _, chi2, information = fit
        return ChangeFit(
            change,
            values,
            self._evidence(change, values, chi2, information),
            information + prior,
            chi2,
        )

    def _evidence(
        self, change: PossibleChange, values: Floats, chi2: float, information: Floats
    ) -> float:
        """Return log E, every scale of the change as likely as the others."""
        logs = []
        for scale in SCALES:
            spread = scale * change.spread
            both = np.eye(len(values)) + information * np.outer(spread, spread)
            cost = float(((values / spread) ** 2).sum()) + float(np.linalg.slogdet(both)[1])
            logs.append(-0.5 * (chi2 + cost + self.weights.log_determinant))
        return float(np.logaddexp.reduce(logs) - np.log(len(SCALES)))

    def _point(self, change: PossibleChange, values: Floats) -> Point:
        own = zip(change.frees, values.tolist(), strict=True)
        return {free: self.split.value(free) + value for free, value in own}

    def _markers(self, point: Point) -> Floats | None:
        seen = self.split.markers(point)
        return None if seen is None else seen.reshape(len(seen), -1)

    def _slopes(self, change: PossibleChange, point: Point) -> Floats | None:
        """Return how an effect's parameters move the markers there, (P, 3 J, k)."""
        if self._markers(point) is None or self.split.settled is None:
            return None
        tangent = self.split.tangent(point, change.frees, self.split.settled)
        if tangent is None:
            return None
        moved = tangent.markers.reshape(*tangent.markers.shape[:2], -1)
        return np.moveaxis(moved, 0, 2)

    def _slopes_of_members(self, change: PossibleChange) -> Floats:
        """Return how imperfections move the markers (P, 3 J, k), per unit."""
        return self.columns[:, :, change.members] / self.arm.plausible[change.members]

    def _columns(self, point: Point) -> Floats | None:
        """Return what each imperfection of a plausible size does (P, 3 J, q) [m]."""
        own = self.arm.plausible
        if not len(own):
            return np.zeros((*self.seen.positions.shape, 0))
        made = imperfections(self.split, point, self.arm.members)
        if made is None:
            return None
        moves = made.moves[: len(own)].reshape(len(own), len(self.seen.tensions), -1)
        return np.moveaxis(own[:, None, None] * moves, 0, 2)


class ChangeFinder:
    """
    Tells what has changed, posture by posture.

    Parameters
    ----------
    arm : BuiltArm
        As it was known before the change; it is not changed here.
    changes : sequence of PossibleChange
        What may have happened.

    """

    def __init__(self, arm: BuiltArm, changes: Sequence[PossibleChange]) -> None:
        """Know nothing of the change."""
        self.arm, self.changes = arm, tuple(changes)
        self.taken: list[tuple[Floats, Floats, int]] = []  # tensions, markers (3 J,), frames
        self.fits: list[ChangeFit] = []  # the most likely first

    def take(self, tensions: Floats, positions: Floats, frames: int = 1) -> None:
        """Take a posture: (m,) [N], the mean of frames (J, 3) [m], nan where nothing was seen."""
        self.taken.append((np.maximum(tensions, 0.0), positions.ravel(), frames))

    def suspects(self) -> tuple[Suspect, ...]:
        """Fit every change; return them by their probability, the most likely first."""
        if not self.taken:
            return ()
        tensions, positions, frames = zip(*self.taken, strict=True)
        work = ChangeWork(self.arm, PosturesSeen(np.array(tensions), np.array(positions), frames))
        if not work.ready:
            return ()
        fits = [fit for change in self.changes if (fit := work.fit(change)) is not None]
        if not any(work.explains(fit) for fit in fits):
            fits = [work.fit_from_afar(fit) if fit.change.is_effect else fit for fit in fits]
        best = max(fit.log for fit in fits)
        near = [fit for fit in fits if fit.change.is_effect and fit.log > best - CLOSE_LOG]
        again = {fit.change.name: work.fit_around(fit) for fit in near}
        fits = [again.get(fit.change.name) or fit for fit in fits]
        self.fits = sorted(fits, key=lambda fit: -fit.log)
        probabilities = self._probabilities()
        return tuple(
            fit.suspect(float(p)) for fit, p in zip(self.fits, probabilities, strict=True)
        )

    def most_telling(self, offered: Floats) -> int | None:
        """
        Return which of the tensions (b, m) [N] separates the likely changes best.

        None where one is likely enough, on a few postures at least, or nothing that is offered
        separates them.
        """
        probabilities, few = self._probabilities(), len(self.taken) < CONFIRMED_POSTURES
        if not len(probabilities) or (probabilities[0] > APART_PROBABILITY and not few):
            return None
        likely = [i for i, p in enumerate(probabilities[:LIKELY_MAX]) if p > LIKELY_MIN]
        blank = np.zeros((len(offered), self.arm.split.dataset.positions.shape[2] * 3))
        usual = self.taken[-1][2] if self.taken else 1
        frames = (usual,) * len(offered)
        work = ChangeWork(self.arm, PosturesSeen(np.maximum(offered, 0.0), blank, frames))
        if not work.ready:
            return None
        shown = [work.shown(self.fits[i]) for i in likely]
        if shown[0] is None:
            return None
        worth, first = np.zeros(len(offered)), shown[0]
        for i, other in zip(likely[1:], shown[1:], strict=True):
            if other is not None:
                apart = work.apart(first, other, self.fits[i].information)
                worth += probabilities[i] * np.log1p(apart)
        best, least = (
            int(np.argmax(worth)),
            np.log1p(HOPELESS_APART) * probabilities[likely[1:]].sum(),
        )
        return best if worth[best] > least else None

    def _probabilities(self) -> Floats:
        logs = np.array([fit.log for fit in self.fits])
        odds = np.exp(logs - logs.max()) if len(logs) else logs
        return np.asarray(odds / odds.sum()) if len(odds) else odds
