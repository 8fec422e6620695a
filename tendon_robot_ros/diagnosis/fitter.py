"""Fits of freed parameters and imperfections: searches, sizes and imperfections in turn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..comparison.noise import Whitener
from ..comparison.predict import FreeParameter, Point, Predictor
from .fit import Fit, Nuisance, with_imperfections
from .imperfections import GAIN, KINDS_WITH_FEW_MEMBERS, Imperfections, Members, SplitPredictor
from .marginal import LOGARITHMS, RandomEffects, Sizes
from .search import Search

Floats = npt.NDArray[np.float64]
TURNS = 25  # of a search
ROUNDS = 8  # of parameters, sizes of the imperfections and imperfections together
SHIFT_SETTLED = 0.3  # whitened change by imperfections that is worth no further look
WAY_SHARES = (1.0, 0.5, 0.2)  # of the way to what slopes promise, the first that is better
TURN_FROM_CHI2 = 4.0  # whitened squared bend by one sd of a gain, from which it is a turn
TURN_GAIN_MIN = 2.0  # in deviance beyond a turn, that makes others worth a look there
TURNS_MAX = 6  # sides of turns that a fit is tried from
GAINS_TO_COME = 4.0  # times the gain of its last round, that a fit may still gain
DEVIANCE_SETTLED = 0.1  # fall of the deviance at which a fit is settled


@dataclass(frozen=True)
class AsBuilt:
    """The imperfections of an arm, for the fits of one worker."""

    split: SplitPredictor
    random: RandomEffects
    imperfections: Imperfections


@dataclass(frozen=True)
class FitPlace:
    """Where a fit is: parameters, imperfections and their sizes, and what all three are worth."""

    search: Search
    around: Members
    sizes: Floats  # (K,)
    deviance: float  # predicted there, nothing linear: priors and log |V| included


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
        self.columns: Mapping[FreeParameter, Floats] = dict(columns or {})
        self.built = built  # None: the description is exact
        self.random = None if built is None else built.random
        self.sizes: Floats | None = None  # (K,) of the imperfections, for the fit that runs
        self.nuisances = tuple(nuisances)
        self.measured = predictor.dataset.mean  # less what imperfections do beyond slopes
        if built is not None:
            self.go_around({})

    def fit(
        self,
        frees: Sequence[FreeParameter],
        start: Fit | Point | None = None,
        turns: int = TURNS,
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
        search = self._search(frees, start, sizes)
        if self.random is None or sizes is not None:
            search.run(turns)
            return self.freeze(search)
        descent = Descent(self, search, turns)
        while not descent.settled:
            descent.go_on(hopeless)
        return descent.fit()

    def begin(self, frees: Sequence[FreeParameter], start: Fit | Point | None = None) -> Descent:
        """Begin a fit of an arm as built that goes on round by round; see `fit`."""
        return Descent(self, self._search(frees, start))

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
        if self.random is not None:
            self._take_start(start, sizes)
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

    def told(self, fit: Fit) -> Fit:
        """
        Fit again under the likeliest logarithms of the sizes: for values and intervals.

        An effect that competes may be paid for making a kind of imperfections small; a value that
        believed it would hold that kind's doing for its own.
        """
        if fit.built is None or not fit.frees:
            return fit
        sizes = fit.built.estimate(prior=LOGARITHMS).values
        self.resume(fit)
        return self.fit(fit.frees, fit.point, sizes=sizes)

    def over_turns(self, fit: Fit) -> Fit:
        """
        Return the best fit from both sides of where friction turns over near by.

        An input that is a little off may take a posture there, beyond which it moves by more or
        less than slopes on this side tell; cells would stand for the rest. Cells and kinks begin
        anew, with the gain of such an input one plausible sd off.
        """
        best = fit
        for around in self._turns(fit):
            assert fit.built is not None and self.random is not None
            scatter = replace(fit.built, around=around, sizes=self.random.start)
            with suppress(ArithmeticError, np.linalg.LinAlgError):  # no equilibrium there
                start = replace(fit, built=scatter)
                found = self.fit(fit.frees, start, hopeless=best.deviance)
                best = min(best, found, key=lambda one: one.deviance)
        self.resume(best)
        return best

    def _turns(self, fit: Fit) -> list[Members]:
        """Return imperfections on both sides of turns: where slopes by gains are not straight."""
        if fit.built is None or self.built is None:
            return []
        self.resume(fit)
        kinds, split = {kind.name: kind for kind in fit.built.kinds}, self.built.split
        here = self.predictor.markers(fit.point)
        if GAIN not in kinds or here is None:
            return []
        near, around = self.predictor.settled, fit.built.around
        few = {name: own for name, own in around.items() if name in KINDS_WITH_FEW_MEMBERS}
        found: list[tuple[float, Members]] = []
        for one in kinds[GAIN].plausible * np.eye(len(kinds[GAIN])):
            sides = [around.get(GAIN, 0.0 * one) + way for way in (one, -one)]
            bend = -2.0 * here
            for gains in sides:
                split.around = {**around, GAIN: gains}
                moved = self.predictor.markers(fit.point, near=near)
                bend = bend + (np.nan if moved is None else moved)
            white = self.whitener.white(bend)
            turned = float(white @ white)
            if turned > TURN_FROM_CHI2:
                found += [(turned, {**few, GAIN: gains}) for gains in sides]
        split.around = around
        return [one for _, one in sorted(found, key=lambda row: -row[0])[:TURNS_MAX]]

    def go(self, place: FitPlace) -> Search:
        """Go to a place: a search that goes on from there."""
        assert self.random is not None
        self.take(place.sizes)
        self.go_around(place.around)
        search = copy(place.search)
        search.weigh_again()
        return search

    def place(self, search: Search) -> FitPlace:
        """Return where a search is, around the imperfections and with the sizes of now."""
        assert self.built is not None and self.sizes is not None
        around, sizes = self.built.split.around, self.sizes
        return FitPlace(copy(search), around, sizes, self._worth(search.raw, around, sizes))

    def _worth(self, raw: Floats, around: Members, sizes: Floats) -> float:
        """Return the deviance at a residual (N + nuisances,) predicted with imperfections."""
        random = self.random
        assert random is not None
        n = len(random.columns)
        errors, rest = raw[:n] - self._shift(around), raw[n:]
        chi2 = random.misfit(errors, sizes) + random.cost(around, sizes) + float(rest @ rest)
        return chi2 + random.log_determinant(sizes) + random.prior(sizes)

    def first_better(self, here: FitPlace, search: Search, sizes: Floats) -> FitPlace | None:
        """Return the first better place on the way to what a search promises, if there is one."""
        random = self.random
        assert random is not None
        goal = random.named(random.best(search.raw[: len(random.columns)], sizes), sizes)
        for share in WAY_SHARES:
            around = _between(here.around, goal, share)
            self.go_around(around)
            moved = copy(search)
            if not moved.go(here.search.values + share * (search.values - here.search.values)):
                continue
            for own in (sizes, here.sizes):
                worth = self._worth(moved.raw, around, own)
                if worth < here.deviance:
                    return FitPlace(moved, around, own, worth)
        return None

    def freeze(self, search: Search) -> Fit:
        """Freeze a search: the markers are those of the model alone."""
        plain = search.result()
        if self.built is None:
            return plain
        with self.built.split.as_described():
            described = self.predictor.markers(search.point)
        if described is not None:
            plain = replace(plain, markers=described)
        if self.random is None or self.sizes is None:
            return plain
        return with_imperfections(plain, self.random, self.sizes, self.built.split.around)

    def _take_start(self, start: Fit | Point | None, sizes: Floats | None) -> None:
        """Take the sizes and imperfections to start from."""
        assert self.random is not None
        if sizes is not None:
            self.take(sizes)
        elif isinstance(start, Fit) and start.built is not None:
            self.take(start.built.sizes)
            self.go_around(start.built.around)
        else:
            self.take(self.random.start)
            self.go_around({})

    def take(self, sizes: Floats) -> None:
        """Take sizes (K,) of the imperfections: their share is then no error any more."""
        assert self.random is not None
        self.sizes = sizes

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
        if self.random is None or self.sizes is None:
            return rows
        n, root = len(self.random.columns), self.random.root(self.sizes)
        return np.concatenate([self.random.lift(root, rows[:n]), rows[n:]])

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
            moved = _between(here, goal, share)
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
        raw, slopes = search.raw, search.derivative(near=True)
        n = len(self.random.columns)
        weights = np.append(np.full(search.count, 1e-9), 1.0 / search.spread**2)
        return self.random.estimate(raw[:n], slopes[:n], self.sizes, weights)


def _between(here: Members, goal: Members, share: float) -> Members:
    """Return members on the way to others; those that are not there yet start at nothing."""
    return {
        name: (1.0 - share) * here.get(name, np.zeros_like(value)) + share * value
        for name, value in goal.items()
    }


class Descent:
    """
    A fit of an arm as built on its way, round by round.

    Parameters are searched where imperfections are linear, which promises a place for all three
    (parameters, imperfections and their sizes); whether to go there is told by what the model
    predicts there. So the deviance never rises, however little slopes tell of friction that turns
    over.
    """

    def __init__(self, fitter: Fitter, search: Search, turns: int = TURNS) -> None:
        """Search for parameters where a search has begun, the fitter being there."""
        self.fitter, self.turns = fitter, turns
        self.here, self._search = fitter.place(search), search
        self.gain = np.inf  # in the last round
        self.settled = False
        self._rounds = 0
        search.run(turns)

    def at(self, fitter: Fitter) -> Descent:
        """Go on with another fitter, of another thread."""
        self.fitter = self._search.fitter = self.here.search.fitter = fitter
        return self

    def go_on(self, hopeless: float = np.inf) -> None:
        """Do one more round; none is left where what the next ones promise is `hopeless`."""
        fitter, search = self.fitter, self._search
        fitter.take(self.here.sizes)
        fitter.go_around(self.here.around)
        estimated = fitter.estimate(search)
        if estimated.deviance - GAINS_TO_COME * self.gain > hopeless:
            self.settled = True
            return
        fitter.take(estimated.values)
        search.weigh_again()
        search.run(self.turns)
        there = fitter.first_better(self.here, search, estimated.values)
        self._rounds += 1
        self.settled = there is None or self._rounds == ROUNDS
        if there is None:
            return
        self.gain, self.here = self.here.deviance - there.deviance, there
        self._search = fitter.go(there)
        self.settled = self.settled or self.gain < DEVIANCE_SETTLED

    def fit(self) -> Fit:
        """Freeze it where it is."""
        return self.fitter.freeze(self.fitter.go(self.here))
