"""Patterns without physics that compete with the effects: does the catalogue lack the cause."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .cells import CellRelief
from .fit import Fit
from .predict import Point
from .probability import minimum
from .search import Fitter

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Pattern:
    """A pattern fitted on top of a fit."""

    name: str  # 'soft_cell', 'taper', 'gain_per_posture', 'rotation_per_posture'
    chi2: float
    parameters: int
    cell: int = 0  # 1-based, of a soft cell
    size: float = 0.0  # soft cell: bend over the bend it should have; taper: change tip - base
    values: tuple[float, ...] = ()  # one per posture [1] or [rad]

    @property
    def score(self) -> float:
        """Chi² plus twice the number of parameters."""
        return self.chi2 + 2.0 * self.parameters


class Rivals:
    """
    Fits the patterns on top of a settled fit, its parameters staying where they are.

    Only a tolerance of the cells gives way: one soft cell is not thirty that deviate a little.
    """

    def __init__(self, fitter: Fitter, fit: Fit) -> None:
        """Keep the fit and its whitened residual."""
        self.fitter, self.fit = fitter, fit
        self.point: Point = fit.point
        self.relief = CellRelief(fit, fitter.whitener)
        self.r = self.white(fit.markers)
        self.prior = fit.chi2 - float(self.r @ self.r)
        self.extra = fit.rank

    def all(self) -> list[Pattern]:
        """Fit all patterns; those without equilibrium drop out."""
        found = [
            self.soft_cell(),
            self.taper(),
            self.gain_per_posture(),
            self.rotation_per_posture(),
        ]
        return [pattern for pattern in found if pattern is not None]

    def white(self, markers: Floats) -> Floats:
        """Whitened residual for predicted markers."""
        return self.relief.residual(self.fitter.whitener.white(self.fitter.measured - markers))

    def _changes(self, change: Floats, p: int) -> Floats:
        """Return what changes (q, P, J, 3) [m] of the markers of one posture do to it, (N, q)."""
        alone = np.zeros_like(change)
        alone[:, p] = change[:, p]
        return self.relief.apply(-self.fitter.whitener.white(alone).T)

    def _stiff(self, factor: Floats) -> Floats | None:
        markers = self.fitter.predictor.markers(self.point, stiffness=factor)
        return None if markers is None else self.white(markers)

    def soft_cell(self) -> Pattern | None:
        """One cell with its own stiffness: where, and how soft."""
        n = self.fitter.predictor.model.arrays.chain.n
        gains, guesses = np.zeros(n), np.zeros(n)
        for i in range(n):
            moved = self._stiff(np.where(np.arange(n) == i, 0.98, 1.0))
            if moved is None:
                continue
            slope = (moved - self.r) / -np.log(0.98)
            size = float(slope @ slope)
            if size > 1e-12:
                guesses[i] = -(slope @ self.r) / size
                gains[i] = (slope @ self.r) ** 2 / size
        best: Pattern | None = None
        for i in np.argsort(-gains)[:3]:
            pattern = self._one_cell(int(i), float(guesses[i]), n)
            if best is None or pattern.chi2 < best.chi2:
                best = pattern
        return best

    def _one_cell(self, i: int, guess: float, n: int) -> Pattern:
        def cost(softness: float) -> float:
            white = self._stiff(np.where(np.arange(n) == i, np.exp(-softness), 1.0))
            return np.inf if white is None else float(white @ white)

        guess = float(np.clip(guess, -1.5, 1.5))
        reach = max(abs(guess), 0.05)
        softness, lowest = minimum(cost, guess - 1.5 * reach, guess + 3.0 * reach, 2e-3)
        return Pattern(
            'soft_cell', lowest + self.prior, self.extra + 2, i + 1, float(np.exp(softness))
        )

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
        return Pattern(
            'taper',
            float(r @ r) + self.prior,
            self.extra + 2,
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
            found = self.fitter.predictor.markers(self.point, inputs * trial[:, None])
            if found is None:
                break
            new = self.white(found)
            if new @ new >= r @ r:
                break
            gain = float(r @ r - new @ new)
            gains, markers, r = trial, found, new
            if gain < 0.1:
                break
        return Pattern(
            'gain_per_posture',
            float(r @ r) + self.prior,
            self.extra + len(inputs),
            values=tuple((gains - 1.0).tolist()),
        )

    def rotation_per_posture(self) -> Pattern:
        """Every posture rotated about the base by its own small rotation vector."""
        change = np.array([np.cross(axis, self.fit.markers) for axis in np.eye(3)])
        postures = range(change.shape[1])
        slopes = np.hstack([self._changes(change, p) for p in postures])
        turns, _, parameters, _ = np.linalg.lstsq(slopes, -self.r, rcond=1e-7)
        r = self.r + slopes @ turns
        angles = np.linalg.norm(turns.reshape(-1, 3), axis=1)
        return Pattern(
            'rotation_per_posture',
            float(r @ r) + self.prior,
            self.extra + int(parameters),
            values=tuple(angles.tolist()),
        )
