"""Patterns without physics that compete with the effects: does the catalogue lack the cause."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..comparison.predict import CELLS, Point
from ..comparison.statistics import chi2_sf, minimum
from .as_built import SplitPredictor, typical_force
from .cells import CellRelief
from .fit import Fit
from .fitter import Fitter

Floats = npt.NDArray[np.float64]


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

    def gain_p_value(self, deviance: float) -> float:
        """Chance of so much gain over a deviance without the pattern, its place searched."""
        return self.places * chi2_sf(max(deviance - self.deviance, 0.0), self.free)

    @property
    def score(self) -> float:
        """Deviance plus twice the number of parameters."""
        return self.deviance + 2.0 * self.parameters


class Rivals:
    """
    Fits the patterns on top of a settled fit, its parameters staying where they are.

    Only a tolerance of the cells gives way: one soft cell is not thirty that deviate a little.
    """

    def __init__(self, fitter: Fitter, fit: Fit) -> None:
        """Keep the fit and its whitened residual."""
        self.fitter, self.fit = fitter, fit
        self.point: Point = fit.point
        if fit.built is not None:
            fitter.take(fit.built.sizes)
        self.relief = CellRelief(fit, fitter.whitener)
        self.r = self.white(fit.markers)
        self.prior = fit.chi2 - float(self.r @ self.r)
        self.extra = fit.rank

    def all(self) -> list[Pattern]:
        """Fit all patterns; those without equilibrium drop out."""
        patterns = [
            self.contact(),
            self.soft_cell(),
            self.taper(),
            self.gain_per_posture(),
            self.rotation_per_posture(),
        ]
        return [pattern for pattern in patterns if pattern is not None]

    def white(self, markers: Floats) -> Floats:
        """Whitened residual for predicted markers; imperfections give way."""
        return self.relief.residual(self.fitter.lift(self.raw(markers)))

    def raw(self, markers: Floats) -> Floats:
        """Whitened residual (N,) for predicted markers."""
        return self.fitter.whitener.white(self.fitter.measured - markers)

    def deviance(self, white: Floats, raw: Floats) -> float:
        """Deviance of a residual; the sizes of imperfections are estimated with the pattern."""
        random, built = self.fitter.random, self.fit.built
        if random is None or built is None:
            return float(white @ white) + self.prior
        nothing = np.zeros((len(raw), 0))
        return random.estimate(raw, nothing, built.sizes).deviance + self.prior

    def _changes(self, change: Floats, p: int) -> Floats:
        """Return what changes (q, P, J, 3) [m] of the markers of one posture do to it, (N, q)."""
        alone = np.zeros_like(change)
        alone[:, p] = change[:, p]
        return self.relief.apply(self.fitter.lift(-self.fitter.whitener.white(alone).T))

    def _stiff(self, factor: Floats) -> Floats | None:
        markers = self.fitter.predictor.markers(self.point, stiffness=factor)
        return None if markers is None else self.white(markers)

    def contact(self) -> Pattern | None:
        """Fit a force at one cell, the same in all postures: where, and how strong."""
        if self.fit.built is None:
            return None
        split = SplitPredictor(self.fitter.predictor)
        cells, unit = split.whole.cells, typical_force(split.whole)
        gains: list[tuple[float, int, Floats]] = []
        for i in range(cells):
            moved = [split.pushed(self.point, i, 0.1 * unit * axis) for axis in np.eye(3)]
            if any(one is None for one in moved):
                return None
            slopes = np.array([self.white(one) - self.r for one in moved if one is not None]).T
            step = -np.linalg.lstsq(slopes, self.r, rcond=1e-9)[0]
            gain = float(self.r @ self.r - np.sum((self.r + slopes @ step) ** 2))
            gains.append((gain, i, 0.1 * unit * step))
        best = [self._pushed(split, i, force) for _, i, force in sorted(gains, key=_gain)[-3:]]
        return min((one for one in best if one), key=lambda pattern: pattern.score, default=None)

    def _pushed(self, split: SplitPredictor, i: int, force: Floats) -> Pattern | None:
        """Fit a force at a cell by Gauss-Newton, from a guess."""
        unit, best = typical_force(split.whole), np.zeros(3)
        r, markers = self.r, self.fit.markers
        for _ in range(6):
            pushed = split.pushed(self.point, i, force)
            new = None if pushed is None else self.white(pushed)
            if pushed is None or new is None or new @ new >= r @ r:
                force = best + 0.3 * (force - best)
                continue
            gain = float(r @ r - new @ new)
            best, r, markers = force, new, pushed
            if gain < 0.1:
                break
            moved = [split.pushed(self.point, i, best + 0.01 * unit * a) for a in np.eye(3)]
            slopes = np.array([self.white(m) - r for m in moved if m is not None]).T
            if slopes.shape[1] < 3:
                break
            force = best - 0.01 * unit * np.linalg.lstsq(slopes, r, rcond=1e-9)[0]
        deviance = self.deviance(r, self.raw(markers))
        size = float(np.linalg.norm(best))
        values, n = tuple(best.tolist()), split.whole.cells
        return Pattern('contact', deviance, self.extra + 4, i + 1, size, 3, n, values)

    def soft_cell(self) -> Pattern | None:
        """One cell with its own stiffness: where, and how soft."""
        n = self.fitter.predictor.model.arrays.chain.n
        self._others_as_usual()
        whole = self._one_stiff(0, 0.0, n)
        gains, guesses = np.zeros(n), np.zeros(n)
        for i in range(n):
            moved = self._one_stiff(i, 0.02, n)
            if moved is None or whole is None:
                continue
            slope = (moved - whole) / 0.02
            size = float(slope @ slope)
            if size > 1e-12:
                guesses[i] = -(slope @ whole) / size
                gains[i] = (slope @ whole) ** 2 / size
        best: Pattern | None = None
        for i in np.argsort(-gains)[:3]:
            pattern = self._one_cell(int(i), float(guesses[i]), n)
            if best is None or pattern.deviance < best.deviance:
                best = pattern
        if self.fit.built is not None:
            self.fitter.take(self.fit.built.sizes)
        return best

    def _others_as_usual(self) -> None:
        """Let no cell scatter more than is plausible: one that does is what is searched."""
        random, built = self.fitter.random, self.fit.built
        if random is None or built is None:
            return
        sizes = built.sizes.copy()
        for k, kind in enumerate(random.kinds):
            if kind.name == CELLS:
                sizes[k] = min(sizes[k], kind.plausible)
        self.fitter.take(sizes)

    def _one_stiff(self, i: int, softness: float, n: int) -> Floats | None:
        """Whitened residual with one cell softer; its own change is exact."""
        raw = self._raw_with(i, softness, n)
        return None if raw is None else self.relief.residual(self.fitter.lift(raw))

    def _raw_with(self, i: int, softness: float, n: int) -> Floats | None:
        factor = np.where(np.arange(n) == i, np.exp(-softness), 1.0)
        markers = self.fitter.predictor.markers(self.point, stiffness=factor)
        return None if markers is None else self.raw(markers - self.fitter.bend)

    def _one_cell(self, i: int, guess: float, n: int) -> Pattern:
        def cost(softness: float) -> float:
            white = self._one_stiff(i, softness, n)
            return np.inf if white is None else float(white @ white)

        guess = float(np.clip(guess, -1.5, 1.5))
        reach = max(abs(guess), 0.05)
        softness, lowest = minimum(cost, guess - 1.5 * reach, guess + 3.0 * reach, 2e-3)
        raw, deviance = self._raw_with(i, softness, n), lowest + self.prior
        if self.fit.built is not None and raw is not None:
            deviance = self.deviance(raw, raw)
        return Pattern('soft_cell', deviance, self.extra + 2, i + 1, float(np.exp(softness)), 1, n)

    def taper(self) -> Pattern | None:
        """Stiffness that changes linearly from base to tip, mean and slope free."""
        n = self.fitter.predictor.model.arrays.chain.n
        along = np.linspace(-1.0, 1.0, n)
        values = np.zeros(2)
        r = self.r
        for _ in range(6):
            here = np.exp(values[0] + values[1] * along)
            columns = []
            for shape in (np.ones(n), along):
                moved = self._stiff(here * np.exp(0.01 * shape))
                if moved is None:
                    return None
                columns.append((moved - r) / 0.01)
            slopes = np.array(columns).T
            step = -np.linalg.lstsq(slopes, r, rcond=None)[0]
            step = np.clip(step, -0.5, 0.5)
            moved = self._stiff(np.exp(values[0] + step[0] + (values[1] + step[1]) * along))
            if moved is None or moved @ moved >= r @ r:
                break
            gain = float(r @ r - moved @ moved)
            values, r = values + step, moved
            if gain < 0.1:
                break
        markers = self.fitter.predictor.markers(
            self.point, stiffness=np.exp(values[0] + values[1] * along)
        )
        assert markers is not None
        return Pattern(
            'taper',
            self.deviance(r, self.raw(markers)),
            self.extra + 2,
            free=2,
            size=float(np.exp(values[0] + values[1]) / np.exp(values[0] - values[1]) - 1.0),
        )

    def gain_per_posture(self) -> Pattern | None:
        """Every posture with its own factor on the inputs."""
        inputs, markers, r = self.fitter.predictor.inputs, self.fit.markers, self.r
        gains = np.ones(len(inputs))
        for _ in range(6):
            moved = self.fitter.predictor.markers(self.point, inputs * (gains + 1e-3)[:, None])
            if moved is None:
                return None
            change = (moved - markers)[None] / 1e-3
            slopes = np.hstack([self._changes(change, p) for p in range(len(inputs))])
            step = np.linalg.lstsq(slopes, -r, rcond=1e-9)[0]
            trial = np.clip(gains + np.clip(step, -0.3, 0.3), 0.2, 3.0)
            predicted = self.fitter.predictor.markers(self.point, inputs * trial[:, None])
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
            self.deviance(r, self.raw(markers)),
            self.extra + len(inputs),
            free=len(inputs),
            values=tuple((gains - 1.0).tolist()),
        )

    def rotation_per_posture(self) -> Pattern:
        """Every posture rotated about the base by its own small rotation vector."""
        change = np.array([np.cross(axis, self.fit.markers) for axis in np.eye(3)])
        postures = range(change.shape[1])
        slopes = np.hstack([self._changes(change, p) for p in postures])
        turns, _, parameters, _ = np.linalg.lstsq(slopes, -self.r, rcond=1e-7)
        r = self.r + slopes @ turns
        moved = np.einsum('pa,apjc->pjc', turns.reshape(-1, 3), change)
        angles = np.linalg.norm(turns.reshape(-1, 3), axis=1)
        return Pattern(
            'rotation_per_posture',
            self.deviance(r, self.raw(self.fit.markers + moved)),
            self.extra + int(parameters),
            free=int(parameters),
            values=tuple(angles.tolist()),
        )


def _gain(row: tuple[float, int, Floats]) -> float:
    return row[0]
