"""Fits of parameters, of the imperfections of an arm, and of the sizes of these, in turn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from ..common.arrays import Floats
from ..comparison.noise import Whitener
from ..comparison.predict import FreeParameter, Point, Predictor
from .fit import Fit, Nuisance, with_imperfections
from .imperfections import (
    GAIN,
    KINDS_WITH_FEW_MEMBERS,
    NO_IMPERFECTIONS,
    Imperfections,
    Members,
    SplitPredictor,
)
from .marginal import STEP_FRACTIONS, STEPS_MAX, Prior, RandomEffects, Sizes
from .search import Search
from .verdict import BEST_FEW

FAILURES = (ArithmeticError, np.linalg.LinAlgError)  # no equilibrium at a start, or on the path
ROUNDS_MAX = 8  # [1] of parameters, imperfections and sizes in turn, else one that creeps goes on
DEVIANCE_CONVERGED = 0.1  # [1] of a round, because a likelihood ratio of 5 % decides nothing
GAINS_TO_COME = 4.0  # [1] of the last round, so that gains falling by a fifth a round all count
REVERSAL_GAIN_MIN = 2.0  # [1] of deviance: one parameter more would have to gain as much


@dataclass(frozen=True)
class FitPlace:
    """Where a fit is: parameters, imperfections and their sizes, and what all three are worth."""

    search: Search
    around: Members
    sizes: Floats  # (K,)
    deviance: float  # predicted there, nothing linear: priors and log |V| included


class Fitter:
    """
    Fits any set of parameters on one data set with one set of weights.

    Parameters
    ----------
    predictor : Predictor
        Of an arm as built a `SplitPredictor`.
    whitener : Whitener
    nuisances : sequence of Nuisance
    columns : mapping, optional
        Columns (N,) of the derivative that are known already.
    random : RandomEffects, optional
        Default: none of any kind, the description is exact.
    imperfections : Imperfections
        How these move the markers.

    """

    def __init__(
        self,
        predictor: Predictor,
        whitener: Whitener,
        nuisances: Sequence[Nuisance] = (),
        columns: Mapping[FreeParameter, Floats] | None = None,
        random: RandomEffects | None = None,
        imperfections: Imperfections = NO_IMPERFECTIONS,
    ) -> None:
        self.predictor, self.whitener = predictor, whitener
        self.columns: Mapping[FreeParameter, Floats] = dict(columns or {})
        self.random = random or RandomEffects.none(whitener.size)
        self.imperfections = imperfections
        self.sizes = self.random.start  # (K,) for the fit that runs
        self.nuisances = tuple(nuisances)
        self.go_around({})

    def fit(
        self,
        frees: Sequence[FreeParameter],
        start: Fit | Point | None = None,
        steps: int = STEPS_MAX,
        sizes: Floats | None = None,
        hopeless: float = np.inf,
    ) -> Fit:
        """
        Fit free parameters, and the nuisances that they do not claim, from the described values.

        `start` spares the search for a start. Imperfections and their sizes (K,) are estimated
        with the parameters, in turn, from where they start; where sizes are given they stay, and
        imperfections are linear around where the fitter is. A fit that will not come below a
        `hopeless` deviance stays as it is.
        """
        if sizes is not None:
            search = self._search(frees, start, sizes)
            search.run(steps)
            return self.freeze(search)
        descent = self.begin(frees, start, steps)
        while not descent.converged:
            descent.go_on(hopeless)
        return descent.fit()

    def begin(
        self,
        frees: Sequence[FreeParameter],
        start: Fit | Point | None = None,
        steps: int = STEPS_MAX,
    ) -> Descent:
        """Begin a fit that goes on round by round; see `fit`."""
        return Descent(self, self._search(frees, start), steps)

    def _search(
        self,
        frees: Sequence[FreeParameter],
        start: Fit | Point | None = None,
        sizes: Floats | None = None,
    ) -> Search:
        """Return a search of free parameters and the nuisances that they do not claim."""
        claimed = {(free.effect, free.parameter.name) for free in frees}
        nuisances = tuple(
            n for n in self.nuisances if (n.free.effect, n.free.parameter.name) not in claimed
        )
        if sizes is not None:
            self.sizes = sizes
        elif isinstance(start, Fit) and start.as_built:
            self.resume(start)
        else:
            self.sizes = self.random.start
            self.go_around({})
        search = Search(self, tuple(frees), nuisances)
        if start is not None:
            point = start.point if isinstance(start, Fit) else start
            search.begin([np.array([point.get(f, search.described(f)) for f in search.all])])
        else:
            search.begin(search.starts())
        return search

    def promised(self, frees: Sequence[FreeParameter], start: Point) -> float:
        """Return the chi² that slopes at a start promise to leave, of an exact arm."""
        search = self._search(frees, start)
        slopes = search.derivative() * search.scale
        return float(np.square(search.r - slopes @ np.linalg.lstsq(slopes, search.r)[0]).sum())

    def for_values(self, fit: Fit) -> Fit:
        """
        Fit again under the likeliest logarithms of the sizes: for values and intervals.

        An effect that competes may be paid for making a kind of imperfections small; a value that
        believed it would hold that kind's doing for its own.
        """
        if not fit.as_built or not fit.frees:
            return fit
        sizes = fit.built.estimate(prior=Prior.LOGARITHMS).values
        self.resume(fit)
        return self.fit(fit.frees, fit.point, sizes=sizes)

    def over_reversals(self, fit: Fit) -> Fit:
        """
        Return the best fit from both sides of where friction reverses near by.

        An input that is a little off may take a posture there, beyond which it moves by more or
        less than slopes on this side tell; cells would stand for the rest. Cells and kinks begin
        anew, with the gain of such an input one plausible sd off.
        """
        gains = {kind.name: kind for kind in fit.built.kinds}.get(GAIN)
        self.resume(fit)
        here = None if gains is None else self.predictor.markers(fit.point)
        if gains is None or here is None:
            return fit
        near, around = self.predictor.settled, fit.built.around
        few = {name: own for name, own in around.items() if name in KINDS_WITH_FEW_MEMBERS}
        reversals: list[tuple[float, Members]] = []
        for one in gains.plausible * np.eye(len(gains)):
            sides = [around.get(GAIN, 0.0 * one) + side for side in (one, -one)]
            bend = -2.0 * here
            for values in sides:
                self.go_around({**around, GAIN: values})
                moved = self.predictor.markers(fit.point, near=near)
                bend = bend + (np.nan if moved is None else moved)
            white = self.whitener.white(bend)
            curved = float(white @ white)  # slopes are not straight
            if curved > 2.0 * REVERSAL_GAIN_MIN:
                reversals += [(curved, {**few, GAIN: values}) for values in sides]
        best = fit
        for _, there in sorted(reversals, key=lambda row: -row[0])[: 2 * BEST_FEW]:
            scatter = replace(fit.built, around=there, sizes=self.random.start)
            with suppress(*FAILURES):
                start = replace(fit, built=scatter)
                other = self.fit(fit.frees, start, hopeless=best.deviance)
                best = min(best, other, key=lambda one: one.deviance)
        self.resume(best)
        return best

    def go(self, place: FitPlace) -> Search:
        """Go to a place: a search that goes on from there."""
        self.sizes = place.sizes
        self.go_around(place.around)
        search = copy(place.search)
        search.weigh_again()
        return search

    def place(self, search: Search) -> FitPlace:
        """Return where a search is, around the imperfections and with the sizes of now."""
        deviance = self._deviance(search.raw, self.around, self.sizes)
        return FitPlace(copy(search), self.around, self.sizes, deviance)

    def _deviance(self, raw: Floats, around: Members, sizes: Floats) -> float:
        """Return the deviance at a residual (N + nuisances,) predicted with imperfections."""
        random, n = self.random, self.whitener.size
        errors, rest = raw[:n] - self._shift(around), raw[n:]
        chi2 = random.misfit(errors, sizes) + random.cost(around, sizes) + float(rest @ rest)
        return chi2 + random.log_determinant(sizes) + random.prior(sizes)

    def first_better(self, here: FitPlace, search: Search, sizes: Floats) -> FitPlace | None:
        """Return the first better place on the path to what a search promises, if any."""
        likely = self.random.best(search.raw[: self.whitener.size], sizes)
        goal = self.random.named(likely, sizes)
        for fraction in STEP_FRACTIONS:
            around = _between(here.around, goal, fraction)
            self.go_around(around)
            moved = copy(search)
            step = search.values - here.search.values
            if not moved.go(here.search.values + fraction * step):
                continue
            for own in (sizes, here.sizes):
                deviance = self._deviance(moved.raw, around, own)
                if deviance < here.deviance:
                    return FitPlace(moved, around, own, deviance)
        return None

    def freeze(self, search: Search) -> Fit:
        """Freeze a search: the markers are those of the model alone."""
        plain = search.result()
        if isinstance(self.predictor, SplitPredictor):
            with self.predictor.as_described():
                described = self.predictor.markers(search.point)
            plain = plain if described is None else replace(plain, markers=described)
        return with_imperfections(plain, self.random, self.sizes, self.around)

    def go_around(self, members: Members) -> None:
        """Take imperfections as linear around members."""
        self.around = members
        if isinstance(self.predictor, SplitPredictor):
            self.predictor.around = members
        # less what imperfections do beyond slopes
        self.measured = self.predictor.dataset.mean + self.imperfections.moved(members)

    def resume(self, fit: Fit) -> None:
        """Go where a fit is: its imperfections and their sizes."""
        self.sizes = fit.built.sizes
        self.go_around(fit.built.around)

    def residual(self, markers: Floats) -> Floats:
        """Whitened residual (N,) for predicted markers."""
        return self.whitener.white(self.measured - markers)

    def lift(self, rows: Floats) -> Floats:
        """Take off whitened rows (N + nuisances, ...) what imperfections of that size explain."""
        if not self.random.kinds:
            return rows
        n, root = self.whitener.size, self.random.root(self.sizes)
        return np.concatenate([self.random.lift(root, rows[:n]), rows[n:]])

    def follow(self, raw: Floats, predict: Callable[[], Floats | None]) -> Floats | None:
        """
        Go around the imperfections that are most likely at a residual (N,), if that is better.

        Returns
        -------
        (N,), optional
            The residual there; None where nothing changes, or nothing is gained by going.

        """
        random, sizes, here = self.random, self.sizes, self.around
        goal = random.named(random.best(raw, sizes), sizes)
        there = self._shift(here)
        if np.square(self._shift(goal) - there).sum() < DEVIANCE_CONVERGED:
            return None
        cost = random.misfit(raw - there, sizes) + random.cost(here, sizes)
        for fraction in STEP_FRACTIONS:
            moved = _between(here, goal, fraction)
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
        moved = np.broadcast_to(self.imperfections.moved(members), self.measured.shape)
        return self.whitener.white(moved)

    def estimate(self, search: Search) -> Sizes:
        """Estimate the sizes of the imperfections where a search is."""
        n = self.whitener.size
        weights = np.append(np.full(search.count, 1e-9), 1.0 / search.spread**2)
        slopes = search.derivative(near=True)
        return self.random.estimate(search.raw[:n], slopes[:n], self.sizes, weights)


def _between(here: Members, goal: Members, fraction: float) -> Members:
    """Return members on the path to others; those that are not there yet start at nothing."""
    return {
        name: (1.0 - fraction) * here.get(name, np.zeros_like(value)) + fraction * value
        for name, value in goal.items()
    }


class Descent:
    """
    A running fit, round by round; of an exact arm the first round is the last.

    Parameters are searched where imperfections are linear, which promises a place for all three
    (parameters, imperfections and their sizes); whether to go there is told by what the model
    predicts there. So the deviance never rises, however little slopes tell of friction that
    reverses.
    """

    def __init__(self, fitter: Fitter, search: Search, steps: int = STEPS_MAX) -> None:
        """Search for parameters where a search has begun, the fitter being there."""
        self.fitter, self.steps, self._search = fitter, steps, search
        self.here = fitter.place(search)
        self.gain = np.inf  # in the last round
        self.converged = False
        self._rounds = 0
        search.run(steps)
        if not fitter.random.kinds:
            self.here, self.converged = fitter.place(search), True

    def at(self, fitter: Fitter) -> Descent:
        """Go on with another fitter, of another thread."""
        self.fitter = self._search.fitter = self.here.search.fitter = fitter
        return self

    def go_on(self, hopeless: float = np.inf) -> None:
        """Do one more round; none is left where what the next ones promise is `hopeless`."""
        fitter, search = self.fitter, self._search
        fitter.sizes = self.here.sizes
        fitter.go_around(self.here.around)
        estimated = fitter.estimate(search)
        if estimated.deviance - GAINS_TO_COME * self.gain > hopeless:
            self.converged = True
            return
        fitter.sizes = estimated.values
        search.weigh_again()
        search.run(self.steps)
        there = fitter.first_better(self.here, search, estimated.values)
        self._rounds += 1
        self.converged = there is None or self._rounds == ROUNDS_MAX
        if there is None:
            return
        self.gain, self.here = self.here.deviance - there.deviance, there
        self._search = fitter.go(there)
        self.converged = self.converged or self.gain < DEVIANCE_CONVERGED

    def fit(self) -> Fit:
        """Freeze it where it is."""
        return self.fitter.freeze(self.fitter.go(self.here))
