"""The search for the best values of freed parameters: bounded, globalised Gauss-Newton."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ..common.arrays import Floats
from .fit import Nuisance
from .noise import Whitener
from .predict import FreeParameter, Point, Predictor, SettledShapes, Tangent

GAIN_MIN = 1e-3  # [1] of chi²: a smaller gain ends a search, because no decision rests on it
GAIN_RATIO_MIN = 1e-5  # [1] of chi², else a search far from any fit would not end
LADDER = (0.03, 0.1, 0.3, 1.0, 3.0)  # [1] typical sizes to start at, because chi² has local minima
DIFFERENCE_STEP = 0.02  # [1] of a typical size or input, solved for, because laws have kinks


def sized(free: FreeParameter, factor: float, predictor: Predictor) -> float:
    """Return a value of so many typical sizes; one that only shapes the others is as described."""
    own = free.parameter
    return free.clip(predictor.value(free) if own.has_default else factor * own.typical)


class Weighs(Protocol):
    """Weights of the errors of a search: the part of `Fitter` that it uses."""

    predictor: Predictor
    whitener: Whitener

    def residual(self, markers: Floats) -> Floats:
        """Whitened residual (N,) for predicted markers."""

    def lift(self, rows: Floats) -> Floats:
        """Remove from whitened rows (N + nuisances, ...) what imperfections explain."""


class Search:
    """Levenberg-Marquardt search with bounds: scaled parameters, damping, best point."""

    def __init__(
        self, fitter: Weighs, frees: tuple[FreeParameter, ...], nuisances: tuple[Nuisance, ...]
    ) -> None:
        """Scale the parameters by their typical sizes."""
        self.fitter, self.frees, self.nuisances = fitter, frees, nuisances
        self.all = frees + tuple(n.free for n in nuisances)
        count = len(frees)
        self.scale = np.array([f.parameter.typical for f in frees] + [n.spread for n in nuisances])
        self.low = np.array(
            [f.parameter.low for f in frees]
            + [max(n.free.parameter.low, n.centre - 30.0 * n.spread) for n in nuisances]
        )
        self.high = np.array(
            [f.parameter.high for f in frees]
            + [min(n.free.parameter.high, n.centre + 30.0 * n.spread) for n in nuisances]
        )
        self.centre = np.array([n.centre for n in nuisances])
        self.spread = np.array([n.spread for n in nuisances])
        self.count = count
        self.damping = 1e-3
        self.gain_min = GAIN_MIN
        self.slopes: Floats | None = None  # Jacobian at the values `taken`
        self.tangent: Tangent | None = None  # derivatives of the equilibria there
        self.fresh = False  # whether `slopes` belong to the best point
        self.raw: Floats  # whitened residual with prior rows at the best point
        self.r: Floats  # the same without what imperfections explain
        self.settled: SettledShapes | None = None  # of the best point, from which neighbours start

    def starts(self) -> list[Floats]:
        """Points to start from: as described, and for one parameter a ladder of sizes."""
        start = np.array([self.fitter.predictor.start(f) for f in self.frees] + list(self.centre))
        catalogue = self.fitter.predictor.model.catalogue
        starts = [start]
        if any(catalogue[f.effect].always_on for f in self.frees):
            starts = []  # its neutral value is no absence
        if starts and self.count != 1:
            return starts
        for factor in LADDER:
            for sign in (1.0, -1.0):
                point = start.copy()
                for i, free in enumerate(self.frees):
                    size = sign * factor * free.parameter.typical
                    if free.parameter.has_default:
                        continue
                    if catalogue[free.effect].always_on:
                        point[i] = abs(size)
                    elif self.count == 1:
                        point[i] += size
                starts.append(np.clip(point, self.low, self.high))
        return list({tuple(point.tolist()): point for point in starts}.values())

    def run(self, steps: int) -> None:
        """Improve until convergence, for so many steps at most."""
        for _ in range(steps):
            if not self.improve():
                break

    def update_residual(self) -> None:
        """Update the residual after a change of the sizes of the imperfections."""
        self.r = self.fitter.lift(self.raw)
        self.damping = 1e-3

    def go(self, values: Floats) -> bool:
        """Move to values (q,) with other imperfections; False without equilibrium."""
        predicted = self.residual(values, self._ahead(values))
        if predicted is None:
            return False
        self.values, (self.raw, self.markers) = values, predicted
        self.settled = self.fitter.predictor.settled
        if self.slopes is not None:
            self._age()
        return True

    @property
    def point(self) -> Point:
        """Present values."""
        return dict(zip(self.all, self.values.tolist(), strict=True))

    def residual(
        self, values: Floats, near: SettledShapes | None = None
    ) -> tuple[Floats, Floats] | None:
        """Whitened residual with prior rows, and the markers; None without equilibrium."""
        point = dict(zip(self.all, values.tolist(), strict=True))
        markers = self.fitter.predictor.markers(point, near=near or self.settled)
        if markers is None:
            return None
        white = self.fitter.residual(markers)
        prior = (values[self.count :] - self.centre) / self.spread
        return np.concatenate([white, prior]), markers

    def begin(self, starts: list[Floats]) -> None:
        """Start from the best of several points; ArithmeticError where none has an equilibrium."""
        best = np.inf
        for start in starts:
            values = np.clip(start, self.low, self.high)
            predicted = self.residual(values)
            if predicted is None:
                continue
            lifted = self.fitter.lift(predicted[0])
            cost = float(lifted @ lifted)
            if cost < best:
                best, self.values, (self.raw, self.markers) = cost, values, predicted
                settled = self.fitter.predictor.settled
        if not np.isfinite(best):
            raise ArithmeticError('no start of the fit has an equilibrium')
        self.settled = settled
        self.r = self.fitter.lift(self.raw)

    def derivative(self, near: bool = False) -> Floats:
        """Jacobian (N + nuisances, q) of the residual; `near`: that of a neighbour suffices."""
        if self.slopes is None or not (near or self.fresh):
            self.slopes, self.tangent = self._slopes()
            self.linearised_at, self.fresh = self.values.copy(), True
        return self.slopes

    def take(self, tangent: Tangent | None) -> None:
        """Begin with the derivatives of a neighbour of the start, where they are known."""
        if tangent is None:
            return
        self.tangent, self.slopes = tangent, self._whitened(tangent)
        self.linearised_at = np.array(list(tangent.at.values()))
        self._age()

    def _slopes(self) -> tuple[Floats, Tangent | None]:
        """Return the Jacobian, and the derivatives of the equilibria where they are known."""
        unknown = self.low < self.high
        frees, moved = [f for f, own in zip(self.all, unknown, strict=True) if own], None
        if frees and self.settled is not None:
            moved = self.fitter.predictor.tangent(self.point, frees, self.settled)
        if moved is None or not np.isfinite(moved.markers).all():
            slopes = np.zeros((len(self.raw), len(self.scale)))
            for i in np.flatnonzero(unknown).tolist():
                slopes[:, i] = self._difference(i)
            return slopes, None
        rates = []
        for one in (moved.markers, moved.states, moved.tensions):
            rates.append(np.zeros((len(unknown), *one.shape[1:])))
            rates[-1][unknown] = one
        tangent = Tangent(*rates, at=self.point)
        return self._whitened(tangent), tangent

    def _whitened(self, tangent: Tangent) -> Floats:
        """Return the Jacobian (N + nuisances, q) by derivatives of the equilibria."""
        columns = self.fitter.whitener.white(tangent.markers).T
        priors = np.zeros((len(self.spread), len(self.scale)))
        priors[:, self.count :] = np.diag(1.0 / self.spread)
        return np.concatenate([-columns, priors])

    def _difference(self, i: int) -> Floats:
        """Column of the Jacobian by a finite difference of the settled model."""
        h = 1e-3 * self.scale[i]
        if self.values[i] + h > self.high[i]:
            h = -h
        moved = self.values.copy()
        moved[i] += h
        predicted = self.residual(moved)
        return np.zeros_like(self.raw) if predicted is None else (predicted[0] - self.raw) / h

    def improve(self) -> bool:
        """Take one damped step within the bounds; False on convergence."""
        if not len(self.scale):
            return False
        scaled = self.fitter.lift(self.derivative(near=True)) * self.scale
        gradient = scaled.T @ self.r
        pressed = ((self.values <= self.low) & (gradient > 0.0)) | (
            (self.values >= self.high) & (gradient < 0.0)
        )
        free = np.flatnonzero(~pressed & (np.abs(scaled).max(axis=0) > 0.0))
        if not len(free):
            return False
        normal = scaled.T @ scaled
        cost = float(self.r @ self.r)
        gain_min = self.gain_min + GAIN_RATIO_MIN * cost
        for _ in range(12):
            part, step = normal[np.ix_(free, free)], np.zeros(len(self.scale))
            damped = part + self.damping * np.diag(np.diag(part) + 1e-12)
            step[free] = -np.linalg.solve(damped, gradient[free])
            whole = self.values + step * self.scale
            moved = self.values + np.clip(step, -30.0, 30.0) * self.scale
            moved = np.clip(moved, self.low, self.high)
            step = (moved - self.values) / self.scale
            promised = -float(step @ (2.0 * gradient + normal @ step))
            if promised < 0.3 * gain_min:
                if (moved == whole).all():
                    break
                self.damping *= 8.0  # a shorter step may gain before it is cut
                continue
            predicted = self.residual(moved, self._ahead(moved))
            lifted = None if predicted is None else self.fitter.lift(predicted[0])
            new = np.inf if lifted is None else float(lifted @ lifted)
            if predicted and lifted is not None and new < cost:
                self.values, (self.raw, self.markers), self.r = moved, predicted, lifted
                self.settled = self.fitter.predictor.settled
                self._age()
                self.damping = max(0.1 * self.damping, 1e-9)
                return cost - new > gain_min
            if not self.fresh:
                break
            self.damping *= 8.0
        if self.fresh:
            return False
        self.slopes = None  # of a point too far away
        return self.improve()

    def _ahead(self, values: Floats) -> SettledShapes | None:
        """Return the predicted equilibria at other values, to first order."""
        if self.settled is None or self.tangent is None:
            return self.settled
        move = values - self.values
        rates = self.tangent.states, self.tangent.tensions
        states, tensions = (np.tensordot(move, rate, 1) for rate in rates)
        return SettledShapes(
            np.maximum(self.settled.tensions + tensions, 0.0),
            self.settled.state + states,
            self.settled.slopes,
        )

    def _age(self) -> None:
        """Mark the Jacobian as that of another point, and drop it where that is far."""
        far = np.abs(self.values - self.linearised_at) > LADDER[0] * self.scale
        self.fresh = False
        if far.any():
            self.slopes = None
