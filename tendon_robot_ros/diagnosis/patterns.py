"""Patterns without a physical law that compete with effects: the cause may not be catalogued."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..common.arrays import Floats
from ..common.errors import Progress
from ..effects import Parameter
from ..inference.candidates import gain_p_value
from ..inference.fit import Fit
from ..inference.fitter import BEST_FEW, FAILURES, REVERSAL_GAIN_MIN, Fitter
from ..inference.predict import CELLS, SOFT_CELL, TAPER, FreeParameter, Point, slope
from ..inference.search import DIFFERENCE_STEP
from ..inference.session import NEAR_SCORE
from ..inference.statistics import SIGNIFICANCE, chi2_isf
from .verdict import SAME_ERROR_RATIO

NAMES = ('soft_cell', 'taper', 'gain_per_posture', 'rotation_per_posture')


@dataclass(frozen=True)
class Pattern:
    """A pattern fitted on top of a fit."""

    name: str  # one of `NAMES`
    deviance: float  # chi², of an arm as built with log |V| and priors
    parameters: int
    gain_p: float  # p-value of its gain
    cell: int = 0  # 1-based, of a soft cell
    size: float = 0.0  # soft cell: bend over the bend it should have; taper: change tip - base
    values: tuple[float, ...] = ()  # one per posture [1] or [rad]
    alike: tuple[int, ...] = ()  # 1-based cells that explain as much, its own included

    @property
    def everywhere(self) -> bool:
        """Whether the pattern is the same in every posture."""
        return self.name in NAMES[:2]

    @property
    def score(self) -> float:
        """Deviance plus twice the number of parameters."""
        return self.deviance + 2.0 * self.parameters

    def text(self, postures: Sequence[str]) -> str:
        """Return a sentence on what to check, given the names of the postures."""
        same, like = 'The remainder is the same in every posture:', 'The remainder looks like'
        if self.name == 'soft_cell':
            much = f'{self.size:.1f} times as much as'
            if SAME_ERROR_RATIO > self.size > 1.0 / SAME_ERROR_RATIO:
                more = 'more' if self.size > 1.0 else 'less'
                much = f'{100.0 * abs(self.size - 1.0):.2g} % {more} than'
            cells = ' or '.join(map(str, self.alike))
            return f'{same} cell {cells} bends {much} it should. Look at that cell.'
        if self.name == 'taper':
            how = 'stiffer' if self.size > 0.0 else 'softer'
            by = f'{100.0 * abs(self.size):.0f} %'
            return f'{same} the arm is {how} towards the tip, by {by} from base to tip.'
        values = np.array(self.values)
        worst = postures[int(np.argmax(np.abs(values)))]
        if self.name == 'gain_per_posture':
            by = f'{100.0 * np.std(values):.1f} % (sd)'
            return (
                f'{like} inputs that were not what was set: by {by} from posture to posture, most '
                f'in {worst}. Check how they are set, or declare tension_noise: setting.'
            )
        most = f'{np.degrees(np.max(np.abs(values))):.1f}° in {worst}'
        return f'{like} a base that turns from posture to posture: by {most}. Check the mount.'


class Patterns:
    """
    Fits the patterns on top of a converged fit.

    With a pattern of one parameter per posture, the parameters of the fit stay fixed, while
    imperfections are fitted again: else part of a soft cell would remain in deviations of many.
    """

    def __init__(
        self, fitter: Fitter, fit: Fit, line: float = np.inf, reversals: bool = False
    ) -> None:
        """
        Keep the fit and its whitened residual.

        Fits far behind the deviance `line` stop early; with `reversals` the others are also tried
        beyond reversals of friction.
        """
        self.fitter, self.fit, self.line, self.reversals = fitter, fit, line, reversals
        self.point: Point = fit.point
        fitter.resume(fit)
        markers = fitter.predictor.markers(self.point)
        self.markers = fit.markers if markers is None else markers
        self.settled = fitter.predictor.settled
        self.r = self.white(self.markers)
        # summed, because friction may now settle elsewhere than in the fit, so that a difference
        # from its chi² would be no prior
        rows = fit.residual[fitter.whitener.size :][: len(fit.nuisances)]
        self.prior = float((rows**2).sum())

    def white(self, markers: Floats) -> Floats:
        """Whitened residual for predicted markers, without what imperfections explain."""
        return self.fitter.lift(self.fitter.residual(markers))

    def deviance(self, markers: Floats) -> float:
        """Deviance of the markers of a pattern, imperfections and their sizes fitted again."""
        raw, fitter = self.fitter.residual(markers), self.fitter
        estimated = fitter.random.estimate(raw, np.zeros((len(raw), 0)), fitter.sizes)
        return estimated.deviance + self.prior

    def _changes(self, change: Floats, p: int) -> Floats:
        """Return columns (N, q) of changes (q, P, J, 3) [m] of the markers of one posture."""
        alone = np.zeros_like(change)
        alone[:, p] = change[:, p]
        return self.fitter.lift(-self.fitter.whitener.white(alone).T)

    def soft_cell(self) -> Pattern | None:
        """Fit one cell with its own stiffness: its place and softness."""
        n = self.fitter.predictor.model.arrays.chain.n
        softness = Parameter('softness', '1', -1.5, 4.0, 0.0, 0.1)  # logarithm of the bend
        frees = [FreeParameter(SOFT_CELL, softness, i) for i in range(n)]
        built = self.fit.built
        most = [kind.plausible if kind.name == CELLS else np.inf for kind in built.kinds]
        self.fitter.sizes = np.minimum(built.sizes, most)  # else the cell itself would be scatter
        white = [self.fitter.whitener.white(moves).T for moves in self._moved(frees)]
        columns = self.fitter.lift(np.hstack(white))
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
        gains = ((self.white(self.markers) @ columns) ** 2).tolist()
        fits = self._at_best_places(gains, lambda i: [frees[i]])
        fit, i = min(fits, key=_deviance)
        if fit is None:
            return None
        size = float(np.exp(fit.values[len(self.fit.frees)]))
        alike_below = fit.deviance + chi2_isf(SIGNIFICANCE, 1)
        near = [row for row in fits if _deviance(row) < alike_below]
        first = 1 - self.fitter.predictor.robot.plate_cells  # number of cell 0: a plate has none
        alike, place = tuple(sorted(cell + first for _, cell in near)), i + first
        by_chance = independent(columns) * self._chance(self.fit, fit.deviance, fit.markers, 1)
        parameters = fit.rank + 1
        return Pattern('soft_cell', fit.deviance, parameters, by_chance, place, size, alike=alike)

    def _chance(self, base: Fit, deviance: float, markers: Floats, rank: int) -> float:
        return gain_p_value(base, self.fitter.whitener, deviance, markers, rank)

    def _moved(self, frees: Sequence[FreeParameter]) -> Iterator[Floats]:
        """Yield derivatives (1, P, J, 3) of the markers by parameters that are zero."""
        predictor, near, step = self.fitter.predictor, self.settled, DIFFERENCE_STEP
        tangent = None if near is None else predictor.tangent(self.point, frees, near)
        for i, free in enumerate(frees):
            if tangent is not None:
                yield tangent.markers[i : i + 1]
                continue
            moved = predictor.markers({**self.point, free: step}, near=near)
            yield slope(self.markers, moved, step)[None]

    def taper(self) -> Pattern | None:
        """
        Fit a stiffness that changes linearly from base to tip, mean and slope free.

        Its gain is that of the slope: another mean alone is an effect of the catalogue.
        """
        names = ('mean', 'slope')
        frees = [FreeParameter(TAPER, Parameter(name, '1', -2.0, 2.0, 0.0, 0.1)) for name in names]
        mean = min(self._at_best_places([0.0], lambda i: frees[:1]), key=_deviance)[0]
        fit = min(self._at_best_places([0.0], lambda i: frees), key=_deviance)[0]
        if fit is None or mean is None:
            return None
        slope = fit.values[len(fit.frees) - 1]
        change = float(np.exp(2.0 * slope) - 1.0)
        by_chance = self._chance(mean, fit.deviance, fit.markers, 1)
        return Pattern('taper', fit.deviance, fit.rank, by_chance, size=change)

    def _at_best_places(
        self, gains: Sequence[float], frees: Callable[[int], list[FreeParameter]]
    ) -> list[tuple[Fit | None, int]]:
        """
        Fit a pattern at the places with the largest linearised gain.

        With `reversals` also from beyond a reversal of friction.
        """
        places = np.argsort(gains)[::-1][:BEST_FEW].tolist()
        fits = [(self._refit(frees(i)), i) for i in places]
        best = min(fits, key=_deviance)[0]
        far = self.line + 2.0 * NEAR_SCORE  # no other start would bring it near
        if not self.reversals or best is None or best.deviance > far:
            return fits
        beyond = self.fitter.over_reversals(best)
        self.fitter.resume(self.fit)
        if beyond.deviance > best.deviance - REVERSAL_GAIN_MIN:
            return fits
        for k, (fit, i) in enumerate(fits):
            refitted = beyond if fit is best else None
            if fit is not None and refitted is None:
                start = fit.started_from(beyond.built.around, beyond.built.sizes)
                refitted = self._refit(frees(i), start)
            fits[k] = min((fit, i), (refitted, i), key=_deviance)
        return fits

    def _refit(self, frees: Sequence[FreeParameter], start: Fit | None = None) -> Fit | None:
        """
        Fit parameters of a pattern together with those of the fit; None: no equilibrium.

        Of an arm as built from no imperfections, since those of the fit explain a part of the
        pattern, or from those of another fit.
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

    def gain_per_posture(self) -> Pattern | None:
        """Fit a factor on the inputs in every posture."""
        inputs, markers, r = self.fitter.predictor.inputs, self.markers, self.r
        gains = np.ones(len(inputs))
        while True:  # the misfit falls in every round
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
            if not new @ new < r @ r:
                break
            gain = float(r @ r - new @ new)
            gains, markers, r = trial, predicted, new
            if gain < 0.1:
                break
        deviance = self.deviance(markers)
        return Pattern(
            'gain_per_posture',
            deviance,
            self.fit.rank + len(inputs),
            self._chance(self.fit, deviance, markers, len(inputs)),
            values=tuple((gains - 1.0).tolist()),
        )

    def _driven(self, inputs: Floats) -> Floats | None:
        """Predict the markers under other inputs (P, m)."""
        return self.fitter.predictor.markers(self.point, inputs, near=self.settled)

    def rotation_per_posture(self) -> Pattern:
        """Fit a small rotation vector [rad] about the base in every posture."""
        change = np.array([np.cross(axis, self.markers) for axis in np.eye(3)])
        postures = range(change.shape[1])
        slopes = np.hstack([self._changes(change, p) for p in postures])
        rotations, _, parameters, _ = np.linalg.lstsq(slopes, -self.r, rcond=1e-7)
        by_posture = rotations.reshape(-1, 1, 3)
        angles = np.linalg.norm(rotations.reshape(-1, 3), axis=1)
        turned = self.markers + np.cross(by_posture, self.markers)
        deviance = self.deviance(turned)
        return Pattern(
            'rotation_per_posture',
            deviance,
            self.fit.rank + int(parameters),
            self._chance(self.fit, deviance, turned, int(parameters)),
            values=tuple(angles.tolist()),
        )

    def fitted(self, progress: Progress) -> list[Pattern]:
        """Fit all patterns on top of the fit; those without equilibrium drop out."""
        found = list[Pattern | None]()
        for number, name in enumerate(NAMES, start=1):
            found.append(getattr(self, name)())
            progress('causes outside the catalogue', number, len(NAMES))
        return [pattern for pattern in found if pattern is not None]


def independent(columns: Floats) -> float:
    """Return how many independent tests those of unit columns (N, M) amount to (Galwey 2009)."""
    strengths = np.linalg.svd(columns, compute_uv=False)
    return float(strengths.sum() ** 2 / max((strengths**2).sum(), 1.0))


def _deviance(row: tuple[Fit | None, int]) -> float:
    return np.inf if row[0] is None else row[0].deviance
