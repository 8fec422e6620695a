"""The search for the best values of freed parameters: bounded, globalised Gauss-Newton."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from .fit import Fit, Nuisance
from .noise import Whitener
from .predict import Free, Point, Predictor, Settled

Floats = npt.NDArray[np.float64]


class Fitter:
    """Fits any set of parameters on one data set with one set of weights."""

    def __init__(
        self,
        predictor: Predictor,
        whitener: Whitener,
        nuisances: Sequence[Nuisance] = (),
        columns: Mapping[Free, Floats] | None = None,
    ) -> None:
        """Keep what all fits share; `columns` (N,) of the derivative are known already."""
        self.predictor, self.whitener = predictor, whitener
        self.columns = dict(columns or {})
        self.nuisances = tuple(nuisances)
        self.measured = predictor.dataset.mean

    def fit(self, frees: Sequence[Free], start: Point | None = None, turns: int = 25) -> Fit:
        """
        Fit free parameters, and the nuisances that they do not claim, from the described values.

        `start` (values) spares the search for a start.
        """
        claimed = {(free.effect, free.parameter.name) for free in frees}
        nuisances = tuple(
            n for n in self.nuisances if (n.free.effect, n.free.parameter.name) not in claimed
        )
        search = Search(self, tuple(frees), nuisances)
        if start is not None:
            search.begin([np.array([start.get(f, search.described(f)) for f in search.all])])
        else:
            search.begin(search.starts())
        for _ in range(turns):
            if not search.improve():
                break
        return search.result()


class Search:
    """One running fit: scaled parameters, damping, best point."""

    def __init__(
        self, fitter: Fitter, frees: tuple[Free, ...], nuisances: tuple[Nuisance, ...]
    ) -> None:
        """Scale the parameters by their typical sizes."""
        self.fitter, self.frees, self.nuisances = fitter, frees, nuisances
        self.all = frees + tuple(n.free for n in nuisances)
        count = len(frees)
        self.scale = np.array([f.parameter.typical for f in frees] + [n.spread for n in nuisances])
        self.low = np.array(
            [f.parameter.low for f in frees] + [n.centre - 30.0 * n.spread for n in nuisances]
        )
        self.high = np.array(
            [f.parameter.high for f in frees] + [n.centre + 30.0 * n.spread for n in nuisances]
        )
        self.centre = np.array([n.centre for n in nuisances])
        self.spread = np.array([n.spread for n in nuisances])
        self.count = count
        self.damping = 1e-3
        self.slopes: Floats | None = None
        self.settled: Settled | None = None  # of the best point: neighbours settle from there

    def described(self, free: Free) -> float:
        """Value in the description, moved inside the bounds."""
        value = self.fitter.predictor.value(free)
        return float(np.clip(value, free.parameter.low, free.parameter.high))

    def starts(self) -> list[Floats]:
        """Points to start from: as described, and for one parameter a ladder of sizes."""
        start = np.array([self.described(f) for f in self.frees] + list(self.centre))
        catalogue = self.fitter.predictor.model.catalogue
        starts = [start]
        if any(catalogue[f.effect].always_on for f in self.frees):
            starts = []  # its neutral value is no absence
        if starts and self.count != 1:
            return starts
        for factor in (0.03, 0.1, 0.3, 1.0, 3.0):
            for sign in (1.0, -1.0):
                point = start.copy()
                for i, free in enumerate(self.frees):
                    size = sign * factor * free.parameter.typical
                    if catalogue[free.effect].always_on:
                        point[i] = abs(size)
                    elif self.count == 1:
                        point[i] += size
                starts.append(np.clip(point, self.low, self.high))
        return list({tuple(point.tolist()): point for point in starts}.values())

    def residual(self, values: Floats) -> tuple[Floats, Floats] | None:
        """Whitened residual with prior rows, and the markers; None without equilibrium."""
        point = dict(zip(self.all, values.tolist(), strict=True))
        markers = self.fitter.predictor.markers(point, near=self.settled)
        if markers is None:
            return None
        white = self.fitter.whitener.white(self.fitter.measured - markers)
        prior = (values[self.count :] - self.centre) / self.spread
        return np.concatenate([white, prior]), markers

    def begin(self, starts: list[Floats]) -> None:
        """Take the best of the starts."""
        best = np.inf
        for start in starts:
            values = np.clip(start, self.low, self.high)
            found = self.residual(values)
            if found is None:
                continue
            cost = float(found[0] @ found[0])
            if cost < best:
                best, self.values, (self.r, self.markers) = cost, values, found
                settled = self.fitter.predictor.settled
        if not np.isfinite(best):
            raise ArithmeticError('no start of the fit has an equilibrium')
        self.settled = settled

    def derivative(self) -> Floats:
        """Jacobian (N + nuisances, q) of the residual by differences of the settled model."""
        columns = []
        for i, scale in enumerate(self.scale):
            if (known := self._known(i)) is not None:
                columns.append(known)
                continue
            h = 1e-3 * scale
            if self.values[i] + h > self.high[i]:
                h = -h
            column = None
            for step in (h, -h, 0.1 * h):
                moved = self.values.copy()
                moved[i] += step
                found = self.residual(moved)
                if found is not None:
                    column = (found[0] - self.r) / step
                    break
            columns.append(np.zeros_like(self.r) if column is None else column)
        return np.array(columns).T.reshape(len(self.r), len(self.scale))

    def _known(self, i: int) -> Floats | None:
        """Column of a nuisance that is known already; None where it must be taken."""
        column = self.fitter.columns.get(self.all[i])
        if column is None:
            return None
        prior = np.zeros(len(self.spread))
        prior[i - self.count] = 1.0 / self.spread[i - self.count]
        return np.concatenate([column, prior])

    def improve(self) -> bool:
        """Take one damped step within the bounds; False when there is nothing to gain."""
        if not len(self.scale):
            return False
        self.slopes = self.derivative()
        scaled = self.slopes * self.scale
        gradient = scaled.T @ self.r
        pressed = ((self.values <= self.low) & (gradient > 0.0)) | (
            (self.values >= self.high) & (gradient < 0.0)
        )
        free = np.flatnonzero(~pressed & (np.abs(scaled).max(axis=0) > 0.0))
        if not len(free):
            return False
        normal = scaled[:, free].T @ scaled[:, free]
        cost = float(self.r @ self.r)
        for _ in range(12):
            damped = normal + self.damping * np.diag(np.diag(normal) + 1e-12)
            step = np.zeros(len(self.scale))
            step[free] = -np.linalg.solve(damped, gradient[free])
            moved = np.clip(
                self.values + np.clip(step, -30.0, 30.0) * self.scale, self.low, self.high
            )
            found = self.residual(moved)
            new = np.inf if found is None else float(found[0] @ found[0])
            if found is not None and new < cost:
                self.values, (self.r, self.markers) = moved, found
                self.settled = self.fitter.predictor.settled
                self.slopes = None
                self.damping = max(0.1 * self.damping, 1e-9)
                return cost - new > 1e-3 + 1e-5 * new
            self.damping *= 8.0
        return False

    def result(self) -> Fit:
        """Freeze the fit."""
        slopes = self.derivative() if self.slopes is None else self.slopes
        return Fit(self.frees, self.nuisances, self.values, self.r, slopes, self.markers)
