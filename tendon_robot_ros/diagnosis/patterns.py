"""Patterns without physics that compete with the effects: does the catalogue lack the cause."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..common.arrays import Floats
from ..comparison.noise import Whitener
from ..comparison.predict import CELLS, SOFT_CELL, TAPER, FreeParameter, Point
from ..comparison.statistics import chi2_isf, chi2_sf
from ..effects import Parameter
from .fit import Fit
from .fitter import FAILURES, REVERSAL_GAIN_MIN, ROUNDS_MAX, Fitter
from .imperfections import PUSH, SplitPredictor, typical_force
from .intervals import load_of
from .search import DIFFERENCE_STEP
from .session import side_by_side
from .slopes import pushes
from .verdict import APART_FROM_SCORE, BEST_FEW, NEAR_SCORE, SAME_ERROR_RATIO, SIGNIFICANCE

NAMES = ('contact', 'soft_cell', 'taper', 'gain_per_posture', 'rotation_per_posture')


@dataclass(frozen=True)
class Pattern:
    """A pattern fitted on top of a fit."""

    name: str  # 'contact', 'soft_cell', 'taper', 'gain_per_posture', 'rotation_per_posture'
    deviance: float  # chi², with log |V| where an arm is taken as built
    parameters: int
    cell: int = 0  # 1-based, of a soft cell or a contact
    size: float = 0.0  # soft cell: bend over the bend it should have; taper: change tip - base
    free: int = 1  # numbers that the pattern itself may choose
    places: int = 1  # among which it was searched
    values: tuple[float, ...] = ()  # one per posture [1] or [rad]; contact: force (3,) [N]
    alike: tuple[int, ...] = ()  # 1-based cells where it would do as well, its own among them

    @property
    def everywhere(self) -> bool:
        """Whether it is the same in every posture."""
        return self.name in NAMES[:3]

    def gain_p_value(self, deviance: float) -> float:
        """Chance of so much gain over a deviance without the pattern, its place searched."""
        return self.places * chi2_sf(max(deviance - self.deviance, 0.0), self.free)

    @property
    def score(self) -> float:
        """Deviance plus twice the number of parameters."""
        return self.deviance + 2.0 * self.parameters

    def text(self, postures: Sequence[str]) -> str:
        """Say where to look, given the names of the postures."""
        if self.name == 'contact':
            angle = load_of(self.values).from_axis
            off_axis = ''
            if angle is not None:
                off_axis = f", {np.degrees(angle.value):.0f}° from the arm's axis"
            return (
                f'The remainder looks like a force of {1e3 * self.size:.2g} mN{off_axis}, at cell '
                f'{self.cell}, the same in every posture: does a cable pull there, or something '
                'touch?'
            )
        if self.name == 'soft_cell':
            much = f'{self.size:.1f} times as much as'
            if SAME_ERROR_RATIO > self.size > 1.0 / SAME_ERROR_RATIO:
                more = 'more' if self.size > 1.0 else 'less'
                much = f'{100.0 * abs(self.size - 1.0):.2g} % {more} than'
            return (
                f'The remainder is the same in every posture: cell '
                f'{" or ".join(map(str, self.alike))} bends {much} it should. '
                'Look at that cell.'
            )
        if self.name == 'taper':
            how = 'stiffer' if self.size > 0.0 else 'softer'
            return (
                f'The remainder is the same in every posture: the arm is {how} towards the tip, '
                f'by {100.0 * abs(self.size):.0f} % from base to tip.'
            )
        values = np.array(self.values)
        worst = postures[int(np.argmax(np.abs(values)))]
        if self.name == 'gain_per_posture':
            return (
                f'The remainder looks like tensions that were not what was set: by '
                f'{100.0 * np.std(values):.1f} % (sd) from posture to posture, most in {worst}. '
                'Check how tensions are set, or declare tension_noise: setting.'
            )
        return (
            'The remainder looks like a base that turns from posture to posture: by '
            f'{np.degrees(np.max(np.abs(values))):.1f}° in {worst}. Check the mount.'
        )


class Patterns:
    """
    Fits the patterns on top of a converged fit.

    Where a pattern has a number for every posture, the parameters of the fit stay where they are;
    imperfections and tolerances of cells give way: one soft cell is not thirty that deviate a
    little.
    """

    def __init__(
        self, fitter: Fitter, fit: Fit, line: float = np.inf, reversals: bool = False
    ) -> None:
        """
        Keep the fit and its whitened residual.

        Fits far behind the `line` are given up; `reversals`: others are tried beyond reversals of
        friction.
        """
        self.fitter, self.fit, self.line, self.reversals = fitter, fit, line, reversals
        self.point: Point = fit.point
        fitter.resume(fit)
        self.relief = CellRelief(fit, fitter.whitener)
        markers = fitter.predictor.markers(self.point)
        self.markers = fit.markers if markers is None else markers
        self.settled = fitter.predictor.settled
        self.r = self.white(self.markers)
        self.prior = fit.chi2 - float(self.r @ self.r)
        self.extra = fit.rank

    def white(self, markers: Floats) -> Floats:
        """Whitened residual for predicted markers; imperfections give way."""
        return self.relief.residual(self.fitter.lift(self.fitter.residual(markers)))

    def deviance(self, predict: Callable[[], Floats | None]) -> float:
        """
        Deviance of what a pattern predicts; imperfections follow it, and so do their sizes.

        The fitter comes back to where the fit is.
        """
        markers, fitter = predict(), self.fitter
        if markers is None:
            return np.inf
        if not self.fit.as_built:
            white = self.white(markers)
            return float(white @ white) + self.prior
        raw, nothing = fitter.residual(markers), np.zeros((self.fitter.whitener.size, 0))
        for _ in range(ROUNDS_MAX):
            estimated = fitter.random.estimate(raw, nothing, fitter.sizes)
            fitter.sizes = estimated.values
            followed = fitter.follow(raw, predict)
            if followed is None:
                break
            raw = followed
        deviance = fitter.random.estimate(raw, nothing, fitter.sizes).deviance
        fitter.resume(self.fit)
        return deviance + self.prior

    def _changes(self, change: Floats, p: int) -> Floats:
        """Return what changes (q, P, J, 3) [m] of the markers of one posture do to it, (N, q)."""
        alone = np.zeros_like(change)
        alone[:, p] = change[:, p]
        return self.relief.apply(self.fitter.lift(-self.fitter.whitener.white(alone).T))

    def contact(self) -> Pattern | None:
        """Fit a force at one cell, the same in all postures: where, and how strong."""
        split = self.fitter.predictor
        if not isinstance(split, SplitPredictor) or not split.pushable:
            return None
        unit = typical_force(split.whole)
        slopes = pushes(split, self.point, 1e-3 * unit)
        if slopes is None:
            return None
        gains = [self._gain(-moves) for moves in slopes]
        axes = [Parameter(f'force_{xyz}', 'N', -30 * unit, 30 * unit, 0.0, unit) for xyz in 'xyz']
        fits = self._at_best_places(gains, lambda i: [FreeParameter(PUSH, p, i) for p in axes])
        fit, i = min(fits, key=_deviance)
        if fit is None:
            return None
        force, n = fit.values[len(self.fit.frees) : len(fit.frees)], len(slopes)
        size, place = float(np.linalg.norm(force)), i + 1 - split.whole.plate_cells
        return Pattern(
            'contact', fit.deviance, fit.rank + 1, place, size, 3, n, tuple(force.tolist())
        )

    def soft_cell(self) -> Pattern | None:
        """One cell with its own stiffness: where, and how soft."""
        n = self.fitter.predictor.model.arrays.chain.n
        softness = Parameter('softness', '1', -1.5, 4.0, 0.0, 0.1)  # logarithm of the bend
        frees = [FreeParameter(SOFT_CELL, softness, i) for i in range(n)]
        usual = self.fit.built.sizes.copy()  # a cell that scatters by more is what is searched
        for k, kind in enumerate(self.fit.built.kinds):
            usual[k] = min(usual[k], kind.plausible) if kind.name == CELLS else usual[k]
        self.fitter.sizes = usual
        gains = [self._gain(-moves) for moves in self._moved(frees)]
        fits = self._at_best_places(gains, lambda i: [frees[i]])
        fit, i = min(fits, key=_deviance)
        if fit is None:
            return None
        size = float(np.exp(fit.values[len(self.fit.frees)]))
        alike_below = fit.deviance + chi2_isf(SIGNIFICANCE, 1)
        near = [row for row in fits if _deviance(row) < alike_below]
        first = 1 - self.fitter.predictor.robot.plate_cells  # number of the model's cell 0
        alike = tuple(sorted(cell + first for _, cell in near))
        return Pattern('soft_cell', fit.deviance, fit.rank + 1, i + first, size, 1, n, alike=alike)

    def _moved(self, frees: Sequence[FreeParameter]) -> Iterator[Floats]:
        """Yield what parameters that are zero do to the markers, (1, P, J, 3) per unit."""
        predictor, near, step = self.fitter.predictor, self.settled, DIFFERENCE_STEP
        found = None if near is None else predictor.tangent(self.point, frees, near)
        for i, free in enumerate(frees):
            if found is not None:
                yield found.markers[i : i + 1]
                continue
            moved = predictor.markers({**self.point, free: step}, near=near)
            yield (
                np.zeros_like(self.markers)[None]
                if moved is None
                else ((moved - self.markers)[None] / step)
            )

    def taper(self) -> Pattern | None:
        """Stiffness that changes linearly from base to tip, mean and slope free."""
        names = ('mean', 'slope')
        frees = [FreeParameter(TAPER, Parameter(name, '1', -2.0, 2.0, 0.0, 0.1)) for name in names]
        fit, _ = min(self._at_best_places([0.0], lambda i: frees), key=_deviance)
        if fit is None:
            return None
        slope = fit.values[len(fit.frees) - 1]
        change = float(np.exp(2.0 * slope) - 1.0)
        return Pattern('taper', fit.deviance, fit.rank, free=2, size=change)

    def _at_best_places(
        self, gains: Sequence[float], frees: Callable[[int], list[FreeParameter]]
    ) -> list[tuple[Fit | None, int]]:
        """
        Fit a pattern at the places that promise most.

        Of an arm as built also with the imperfections of the fit to start from: at the best place,
        and at others that such a start may bring before it; and where that is better, beyond a
        reversal of friction.
        """
        places = np.argsort(gains)[::-1][:BEST_FEW].tolist()
        fits = sorted(((self._refit(frees(i)), i) for i in places), key=_deviance)
        reach = APART_FROM_SCORE
        for k, (fit, i) in enumerate(fits):
            least = min(_deviance(row) for row in fits)
            if fit is None or self._beaten(fit) or fit.deviance > least + reach:
                break
            again = self._refit(frees(i), self.fit)
            if again is not None and again.deviance < fit.deviance:
                reach = max(reach, APART_FROM_SCORE + fit.deviance - again.deviance)
                fits[k] = again, i
        best = min(fits, key=_deviance)[0]
        if not self.reversals or best is None or self._beaten(best):
            return fits
        beyond = self.fitter.over_reversals(best)
        self.fitter.resume(self.fit)
        if beyond.deviance > best.deviance - REVERSAL_GAIN_MIN:
            return fits
        for k, (fit, i) in enumerate(fits):
            again = beyond if fit is best else None
            if fit is not None and again is None:
                scatter = replace(fit.built, around=beyond.built.around, sizes=beyond.built.sizes)
                again = self._refit(frees(i), replace(fit, built=scatter))
            fits[k] = min((fit, i), (again, i), key=_deviance)
        return fits

    def _beaten(self, fit: Fit) -> bool:
        """Tell whether a fit needs no other start: there is none, or it is far behind the line."""
        return not self.fit.as_built or fit.deviance > self.line + 2.0 * NEAR_SCORE

    def _refit(self, frees: Sequence[FreeParameter], start: Fit | None = None) -> Fit | None:
        """
        Fit parameters of a pattern together with those of the fit; None: no equilibrium.

        Of an arm as built from one without imperfections, which else keep their share of it, or
        from those of another fit.
        """
        hopeless = min(self.fit.deviance, self.line) + NEAR_SCORE  # it contains the fit
        anew = self.fit.point if self.fit.as_built else self.fit
        try:
            every = (*self.fit.frees, *frees)
            return self.fitter.fit(every, start or anew, hopeless=hopeless)
        except FAILURES:
            return None
        finally:
            self.fitter.resume(self.fit)

    def _gain(self, slopes: Floats) -> float:
        """Return what changes (q, P, J, 3) of the residual take off its chi², as far as linear."""
        white = self.relief.apply(self.fitter.lift(self.fitter.whitener.white(slopes).T))
        here = self.white(self.markers)
        return float(here @ white @ np.linalg.lstsq(white, here, rcond=1e-9)[0])

    def gain_per_posture(self) -> Pattern | None:
        """Every posture with its own factor on the inputs."""
        inputs, markers, r = self.fitter.predictor.inputs, self.markers, self.r
        gains = np.ones(len(inputs))
        for _ in range(6):
            moved = self._driven(inputs * (gains + 1e-3)[:, None])
            if moved is None:
                return None
            change = (moved - markers)[None] / 1e-3
            slopes = np.hstack([self._changes(change, p) for p in range(len(inputs))])
            step = np.linalg.lstsq(slopes, -r, rcond=1e-9)[0]
            trial = np.clip(gains + np.clip(step, -0.3, 0.3), 0.2, 3.0)
            predicted = self._driven(inputs * trial[:, None])
            if predicted is None:
                break
            new = self.white(predicted)
            if new @ new >= r @ r:
                break
            gain = float(r @ r - new @ new)
            gains, markers, r = trial, predicted, new
            if gain < 0.1:
                break
        return Pattern(
            'gain_per_posture',
            self.deviance(lambda: self._driven(inputs * gains[:, None])),
            self.extra + len(inputs),
            free=len(inputs),
            values=tuple((gains - 1.0).tolist()),
        )

    def _driven(self, inputs: Floats) -> Floats | None:
        """Predict the markers under other inputs (P, m)."""
        return self.fitter.predictor.markers(self.point, inputs, near=self.settled)

    def rotation_per_posture(self) -> Pattern:
        """Every posture rotated about the base by its own small rotation vector."""
        change = np.array([np.cross(axis, self.markers) for axis in np.eye(3)])
        postures = range(change.shape[1])
        slopes = np.hstack([self._changes(change, p) for p in postures])
        turns, _, parameters, _ = np.linalg.lstsq(slopes, -self.r, rcond=1e-7)
        turned = turns.reshape(-1, 1, 3)
        angles = np.linalg.norm(turns.reshape(-1, 3), axis=1)

        def predict() -> Floats | None:
            markers = self.fitter.predictor.markers(self.point, near=self.settled)
            return None if markers is None else markers + np.cross(turned, markers)

        return Pattern(
            'rotation_per_posture',
            self.deviance(predict),
            self.extra + int(parameters),
            free=int(parameters),
            values=tuple(angles.tolist()),
        )


def patterns_of(
    fitters: Sequence[Fitter],
    fit: Fit,
    progress: Callable[[str, int, int], None] | None = None,
    line: float = np.inf,
    reversals: bool = False,
) -> list[Pattern]:
    """
    Fit all patterns on top of a fit; those without equilibrium drop out.

    Those whose deviance stays far above a `line` need not be fitted to their ends; the others are
    tried beyond `reversals` of friction as well.
    """
    found: dict[str, Pattern | None] = {}

    def work(worker: int, names: Sequence[str]) -> None:
        own = Patterns(fitters[worker], fit, line, reversals)
        for name in names:
            found[name] = getattr(own, name)()
            if progress is not None:
                progress('causes outside the catalogue', len(found), len(NAMES))

    side_by_side(
        [partial(work, names=NAMES[:1]), partial(work, names=NAMES[1:])], min(len(fitters), 2)
    )
    return [pattern for name in NAMES if (pattern := found[name]) is not None]


def _deviance(row: tuple[Fit | None, int]) -> float:
    return np.inf if row[0] is None else row[0].deviance


class CellRelief:
    """
    What the tolerance of the cells takes off a whitened residual when it is free to do so.

    For patterns that are fitted on top of a converged fit: its cells give way to the pattern.
    Without such a tolerance nothing changes.
    """

    def __init__(self, fit: Fit, whitener: Whitener) -> None:
        """Take the slopes and the values of the cells at a fit."""
        count, size = len(fit.frees), whitener.size
        own = [i for i, n in enumerate(fit.nuisances) if n.quantity == CELLS]
        spread = np.array([fit.nuisances[i].spread for i in own])
        columns = fit.jacobian[:size, [count + i for i in own]]
        self._shift = columns @ fit.values[[count + i for i in own]]
        self._columns = columns * spread
        self._normal = np.eye(len(own)) + self._columns.T @ self._columns

    def residual(self, white: Floats) -> Floats:
        """Return a residual (N,), taken at the fit's cells, with the best ones; they follow it."""
        return self.apply(white - self._shift)

    def apply(self, white: Floats) -> Floats:
        """Return (N + cells, ...) of whitened changes (N, ...) of the markers."""
        best = -np.linalg.solve(self._normal, self._columns.T @ white)
        return np.concatenate([white + self._columns @ best, best])
