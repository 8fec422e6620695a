"""The search for the best values of freed parameters: bounded, globalised Gauss-Newton."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..comparison.noise import Whitener
from ..comparison.predict import FreeParameter, Point, Predictor, SettledShapes
from .as_built import Imperfections, Members
from .fit import Fit, Nuisance, with_imperfections
from .marginal import RandomEffects, Sizes
from .split import SplitPredictor

Floats = npt.NDArray[np.float64]
ROUNDS = 6  # of parameters, sizes of the imperfections and imperfections in turn
SHIFT_SETTLED = 0.3  # whitened change by imperfections that is worth no further look
WAY_SHARES = (1.0, 0.5, 0.2)  # of the way to better imperfections, the first that is better
DEVIANCE_SETTLED = 0.1  # change in deviance at which they are settled


@dataclass(frozen=True)
class AsBuilt:
    """The imperfections of an arm, for the fits of one worker."""

    split: SplitPredictor
    random: RandomEffects
    imperfections: Imperfections


class Fitter:
    """Fits any set of parameters on one data set with one set of weights."""

    def __init__(
        self,
        predictor: Predictor,
        whitener: Whitener,
        nuisances: Sequence[Nuisance] = (),
        columns: Mapping[FreeParameter, Floats] | None = None,
        built: AsBuilt | None = None,
    ) -> None:
        """Keep what all fits share; `columns` (N,) of the derivative are known already."""
        self.predictor, self.whitener = predictor, whitener
        self.columns = dict(columns or {})
        self.built = built  # None: the description is exact
        self.random = None if built is None else built.random
        self.sizes: Floats | None = None  # (K,) of the imperfections, for the fit that runs
        self._root: Floats | None = None
        self.nuisances = tuple(nuisances)
        self.measured = predictor.dataset.mean  # less what imperfections do beyond slopes
        if built is not None:
            self.go_around({})

    def fit(
        self,
        frees: Sequence[FreeParameter],
        start: Fit | Point | None = None,
        turns: int = 25,
        sizes: Floats | None = None,
    ) -> Fit:
        """
        Fit free parameters, and the nuisances that they do not claim, from the described values.

        `start` spares the search for a start. Imperfections and their sizes (K,) are estimated
        with the parameters, in turn, from where they start; where sizes are given they stay, and
        imperfections are linear around where the fitter is.
        """
        claimed = {(free.effect, free.parameter.name) for free in frees}
        nuisances = tuple(
            n for n in self.nuisances if (n.free.effect, n.free.parameter.name) not in claimed
        )
        if self.random is not None:
            self._begin(start, sizes)
        search = Search(self, tuple(frees), nuisances)
        if start is not None:
            point = start.point if isinstance(start, Fit) else start
            search.begin([np.array([point.get(f, search.described(f)) for f in search.all])])
        else:
            search.begin(search.starts())
        search.run(turns)
        if self.random is None or sizes is not None:
            return search.result()
        before = np.inf
        for _ in range(ROUNDS):
            estimated = self.estimate(search)
            self.take(estimated.values)
            search.weigh_again()
            moved = search.follow()
            if not moved and abs(before - estimated.deviance) < DEVIANCE_SETTLED:
                break
            before = estimated.deviance
            search.run(turns)
        return search.result()

    def _begin(self, start: Fit | Point | None, sizes: Floats | None) -> None:
        """Take the sizes and imperfections to start from."""
        assert self.random is not None
        if sizes is not None:
            self.take(sizes)
        elif isinstance(start, Fit) and start.built is not None:
            self.take(start.built.sizes)
            self.go_around(start.members or {})
        else:
            self.take(self.random.start)
            self.go_around({})

    def take(self, sizes: Floats) -> None:
        """Take sizes (K,) of the imperfections: their share is then no error any more."""
        assert self.random is not None
        self.sizes, self._root = sizes, self.random.root(sizes)

    def go_around(self, members: Members) -> None:
        """Take imperfections as linear around members."""
        assert self.built is not None
        self.built.split.around = members
        self.measured = self.predictor.dataset.mean + self.built.imperfections.moved(members)

    def resume(self, fit: Fit) -> None:
        """Go where a fit is: its imperfections and their sizes."""
        if fit.built is not None and self.built is not None:
            self.take(fit.built.sizes)
            self.go_around(fit.built.around)

    def residual(self, markers: Floats) -> Floats:
        """Whitened residual (N,) for predicted markers."""
        return self.whitener.white(self.measured - markers)

    def lift(self, rows: Floats) -> Floats:
        """Take off whitened rows (N + nuisances, ...) what imperfections of that size explain."""
        if self.random is None or self._root is None:
            return rows
        n = len(self.random.columns)
        return np.concatenate([self.random.lift(self._root, rows[:n]), rows[n:]])

    def follow(self, raw: Floats, predict: Callable[[], Floats | None]) -> Floats | None:
        """
        Go around the imperfections that are most likely at a residual (N,), if that is better.

        Returns
        -------
        (N,), optional
            The residual there; None where nothing changes, or nothing is gained by going.

        """
        built, random, sizes = self.built, self.random, self.sizes
        assert built is not None and random is not None and sizes is not None
        here = built.split.around
        goal = random.named(random.best(raw, sizes), sizes)
        there, cost = self._shift(here), None
        if np.linalg.norm(self._shift(goal) - there) < SHIFT_SETTLED:
            return None
        cost = random.misfit(raw - there, sizes) + random.cost(here, sizes)
        for share in WAY_SHARES:
            moved = {
                name: (1.0 - share) * here.get(name, np.zeros_like(value)) + share * value
                for name, value in goal.items()
            }
            self.go_around(moved)
            markers = predict()
            if markers is None:
                continue
            new = self.residual(markers)
            errors = new - self._shift(moved)
            if random.misfit(errors, sizes) + random.cost(moved, sizes) < cost:
                return new
        self.go_around(here)
        return None

    def _shift(self, members: Members) -> Floats:
        """Whitened (N,) move of the markers by members, by their slopes."""
        assert self.built is not None
        moved = np.broadcast_to(self.built.imperfections.moved(members), self.measured.shape)
        return self.whitener.white(moved)

    def estimate(self, search: Search) -> Sizes:
        """Estimate the sizes of the imperfections where a search is."""
        assert self.random is not None
        raw, slopes = search.raw, search.derivative()
        n = len(self.random.columns)
        weights = np.append(np.full(search.count, 1e-9), 1.0 / search.spread**2)
        return self.random.estimate(raw[:n], slopes[:n], self.sizes, weights)


class Search:
    """One running fit: scaled parameters, damping, best point."""

    def __init__(
        self, fitter: Fitter, frees: tuple[FreeParameter, ...], nuisances: tuple[Nuisance, ...]
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
        self.slopes: Floats | None = None
        self.raw: Floats  # whitened residual with prior rows at the best point
        self.r: Floats  # the same, less what imperfections explain
        self.settled: SettledShapes | None = None  # of the best point: neighbours start there

    def described(self, free: FreeParameter) -> float:
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

    def run(self, turns: int) -> None:
        """Improve until nothing is left to gain."""
        for _ in range(turns):
            if not self.improve():
                break

    def weigh_again(self) -> None:
        """Take the residual again when the sizes of the imperfections have changed."""
        self.r = self.fitter.lift(self.raw)
        self.damping = 1e-3

    def follow(self) -> bool:
        """Go around the most likely imperfections; False where that changes nothing."""
        predictor, point = self.fitter.predictor, self.point
        n = self.fitter.whitener.size
        raw = self.fitter.follow(self.raw[:n], lambda: predictor.markers(point, near=self.settled))
        if raw is None:
            return False
        self.raw, self.slopes = np.concatenate([raw, self.raw[n:]]), None
        self.weigh_again()
        return True

    @property
    def point(self) -> Point:
        """Values of now."""
        return dict(zip(self.all, self.values.tolist(), strict=True))

    def residual(self, values: Floats) -> tuple[Floats, Floats] | None:
        """Whitened residual with prior rows, and the markers; None without equilibrium."""
        point = dict(zip(self.all, values.tolist(), strict=True))
        markers = self.fitter.predictor.markers(point, near=self.settled)
        if markers is None:
            return None
        white = self.fitter.residual(markers)
        prior = (values[self.count :] - self.centre) / self.spread
        return np.concatenate([white, prior]), markers

    def begin(self, starts: list[Floats]) -> None:
        """Take the best of the starts."""
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

    def derivative(self) -> Floats:
        """Jacobian (N + nuisances, q) of the residual by differences of the settled model."""
        if self.slopes is not None:
            return self.slopes
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
                predicted = self.residual(moved)
                if predicted is not None:
                    column = (predicted[0] - self.raw) / step
                    break
            columns.append(np.zeros_like(self.raw) if column is None else column)
        self.slopes = np.array(columns).T.reshape(len(self.raw), len(self.scale))
        return self.slopes

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
        scaled = self.fitter.lift(self.derivative()) * self.scale
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
            predicted = self.residual(moved)
            lifted = None if predicted is None else self.fitter.lift(predicted[0])
            new = np.inf if lifted is None else float(lifted @ lifted)
            if predicted is not None and lifted is not None and new < cost:
                self.values, (self.raw, self.markers), self.r = moved, predicted, lifted
                self.settled = self.fitter.predictor.settled
                self.slopes = None
                self.damping = max(0.1 * self.damping, 1e-9)
                return cost - new > 1e-3 + 1e-5 * new
            self.damping *= 8.0
        return False

    def result(self) -> Fit:
        """Freeze the fit."""
        fitter, raw, slopes, markers = self.fitter, self.raw, self.derivative(), self.markers
        if fitter.built is not None:
            with fitter.built.split.as_described():
                described = fitter.predictor.markers(self.point)
            markers = markers if described is None else described
        plain = Fit(self.frees, self.nuisances, self.values, raw, slopes, markers)
        if fitter.built is None or fitter.random is None or fitter.sizes is None:
            return plain
        return with_imperfections(plain, fitter.random, fitter.sizes, fitter.built.split.around)
