"""Alternating fits of parameters, of the imperfections of an arm, and of their sizes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass

import numpy as np

from ..common.arrays import Floats
from ..common.estimation import STEP_LENGTHS
from .fit import Fit, Nuisance, with_imperfections
from .imperfections import GAIN, KINDS_WITH_FEW_MEMBERS, Imperfections, Members
from .marginal import STEPS_MAX, Prior, RandomEffects, Sizes
from .noise import Whitener
from .predict import FreeParameter, Point, Predictor, SettledShapes
from .search import Search

FAILURES = (ArithmeticError, np.linalg.LinAlgError)  # no equilibrium at a start, or on the path
BEST_FEW = 3  # [1] of an order by a cheap estimate that are fitted, because the estimate may err
ROUNDS_MAX = 8  # [1] of parameters, imperfections and sizes in turn, else one that creeps goes on
DEVIANCE_CONVERGED = 0.1  # [1] of a round, because a likelihood ratio of 5 % decides nothing
GAINS_TO_COME = 4.0  # [1] of the last round, so that gains falling by a fifth a round all count
REVERSAL_GAIN_MIN = 2.0  # [1] of deviance: one parameter more would have to gain as much


@dataclass(frozen=True)
class FitPlace:
    """State of a fit: parameters, imperfections and their sizes, and the deviance of all three."""

    search: Search
    around: Members
    sizes: Floats  # (K,)
    deviance: float  # predicted by the model, not by slopes; priors and log |V| included


class Fitter:
    """
    Fits any set of parameters on one data set with one set of weights.

    Parameters
    ----------
    predictor : Predictor
        A `BuiltPredictor` for an arm as built.
    whitener : Whitener
    nuisances : sequence of Nuisance
    imperfections : Imperfections, optional
        Default: none, the description is exact.
    response : float
        Known relative error of the model's response, which widens intervals.

    """

    def __init__(
        self,
        predictor: Predictor,
        whitener: Whitener,
        nuisances: Sequence[Nuisance] = (),
        imperfections: Imperfections | None = None,
        response: float = 0.0,
    ) -> None:
        self.response = response
        self.predictor, self.whitener = predictor, whitener
        self.imperfections = imperfections or Imperfections.none(predictor.dataset)
        self.random = RandomEffects.of(self.imperfections, whitener)
        self.sizes = self.random.start  # (K,) of the running fit
        self.nuisances = tuple(nuisances)
        self.linearise_around({})

    def fit(
        self,
        frees: Sequence[FreeParameter],
        start: Fit | Point | None = None,
        steps: int = STEPS_MAX,
        sizes: Floats | None = None,
        hopeless: float = np.inf,
    ) -> Fit:
        """
        Fit free parameters, and the nuisances for which none of them stands.

        Imperfections and their sizes (K,) are estimated in turn with the parameters.

        Parameters
        ----------
        frees : sequence of FreeParameter
        start : Fit or Point, optional
            Initial values; default: the best of `Search.starts`.
        steps : int
            Of a search in a round.
        sizes : (K,), optional
            Fixed sizes; imperfections are then linear around those of the fitter.
        hopeless : float
            Deviance; a fit that is not expected to fall below it stops early.

        Raises
        ------
        ArithmeticError
            No start has an equilibrium.

        """
        if sizes is not None:
            search = self.search(frees, start, sizes)
            search.run(steps)
            return self.freeze(search)
        descent = Descent(self, self.search(frees, start), steps)
        while not descent.converged:
            descent.go_on(hopeless)
        return descent.fit()

    def search(
        self,
        frees: Sequence[FreeParameter],
        start: Fit | Point | None = None,
        sizes: Floats | None = None,
        near: SettledShapes | None = None,
    ) -> Search:
        """Return a started search of free parameters and the other nuisances; see `fit`."""
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
            self.linearise_around({})
        search = Search(self, tuple(frees), nuisances)
        if start is not None:
            search.settled = start.settled if isinstance(start, Fit) else near
            point = start.point if isinstance(start, Fit) else start
            start_of = self.predictor.start
            search.begin([np.array([point.get(f, start_of(f)) for f in search.all])])
            if isinstance(start, Fit) and not self.random.kinds:  # else others move the arm, too
                search.take(start.tangent and start.tangent.of(search.all))
        else:
            search.begin(search.starts())
        return search

    def linear_chi2(self, frees: Sequence[FreeParameter], start: Point) -> float:
        """Return the minimum of chi² of an exact arm, linearised at a start."""
        search = self.search(frees, start)
        slopes = search.derivative() * search.scale
        return float(np.square(search.r - slopes @ np.linalg.lstsq(slopes, search.r)[0]).sum())

    def for_values(self, fit: Fit) -> Fit:
        """
        Fit again under the likeliest logarithms of the sizes: for values and intervals.

        The likelihood rewards an effect that makes a kind of imperfections small; its value
        would otherwise include part of what that kind causes. Values of single tendons or sections
        that the postures do not determine stay as described, the least determined first.
        """
        if not fit.as_built or not fit.frees:
            return fit
        sizes = fit.estimate(prior=Prior.LOGARITHMS).values
        self.resume(fit)
        told = self.fit(fit.frees, fit.point, sizes=sizes)
        while loose := told.undetermined:
            frees = [free for free in told.frees if free != loose[0]]
            point = {free: value for free, value in told.point.items() if free != loose[0]}
            told = self.fit(frees, point, sizes=sizes)
        return told

    def over_reversals(self, fit: Fit) -> Fit:
        """
        Return the best fit from both sides of reversals of friction in the neighbourhood.

        A small error of an input may move a posture across a reversal, where its slopes change;
        the stiffness of cells would then be fitted to the difference. Each such fit starts from
        cells and kinks as described, and with the gain of one input one plausible sd off.
        """
        gains = {kind.name: kind for kind in fit.built.kinds}.get(GAIN)
        self.resume(fit)
        near, around = fit.settled, fit.built.around
        markers = None if gains is None else self.predictor.markers(fit.point, near=near)
        if gains is None or markers is None or not self.predictor.model.rubs:
            return fit
        few = {name: own for name, own in around.items() if name in KINDS_WITH_FEW_MEMBERS}
        reversals: list[tuple[float, Members]] = []
        for one in gains.plausible * np.eye(len(gains)):
            sides = [around.get(GAIN, 0.0 * one) + side for side in (one, -one)]
            bend = -2.0 * markers
            for values in sides:
                self.linearise_around({**around, GAIN: values})
                moved = self.predictor.markers(fit.point, near=near)
                bend = bend + (np.nan if moved is None else moved)
            white = self.whitener.white(bend)
            curved = float(white @ white)  # of the nonlinearity
            if curved > 2.0 * REVERSAL_GAIN_MIN:
                reversals += [(curved, {**few, GAIN: values}) for values in sides]
        best = fit
        for _, members in sorted(reversals, key=lambda row: -row[0])[: 2 * BEST_FEW]:
            with suppress(*FAILURES):
                start = fit.started_from(members, self.random.start)
                other = self.fit(fit.frees, start, hopeless=best.deviance)
                best = min(best, other, key=lambda one: one.deviance)
        self.resume(best)
        return best

    def go(self, place: FitPlace) -> Search:
        """Return a search that continues from a state, and set the fitter to that state."""
        self.sizes = place.sizes
        self.linearise_around(place.around)
        search = copy(place.search)
        search.update_residual()
        return search

    def place(self, search: Search) -> FitPlace:
        """Return the state of a search, with the present imperfections and sizes."""
        deviance = self._deviance(search.raw, self.around, self.sizes)
        return FitPlace(copy(search), self.around, self.sizes, deviance)

    def _deviance(self, raw: Floats, around: Members, sizes: Floats) -> float:
        """Return the deviance at a residual (N + nuisances,) predicted with imperfections."""
        random, n = self.random, self.whitener.size
        moved = np.broadcast_to(self.imperfections.moved(around), self.measured.shape)
        errors, rest = raw[:n] - self.whitener.white(moved), raw[n:]
        chi2 = random.misfit(errors, sizes) + random.cost(around, sizes) + float(rest @ rest)
        return chi2 + random.log_determinant(sizes) + random.prior(sizes)

    def first_better(self, place: FitPlace, search: Search, sizes: Floats) -> FitPlace | None:
        """Return the first better state on the way back from the predicted optimum, if any."""
        likely = self.random.best(search.raw[: self.whitener.size], sizes)
        goal = self.random.named(likely, sizes)
        for fraction in STEP_LENGTHS:
            around = _between(place.around, goal, fraction)
            self.linearise_around(around)
            moved = copy(search)
            step = search.values - place.search.values
            if not moved.go(place.search.values + fraction * step):
                continue
            for own in (sizes, place.sizes):
                deviance = self._deviance(moved.raw, around, own)
                if deviance < place.deviance:
                    return FitPlace(moved, around, own, deviance)
        return None

    def freeze(self, search: Search, near: bool = False) -> Fit:
        """
        Return the fit of a search; its markers are those of the model without imperfections.

        Where derivatives of a neighbour suffice, `near` spares those at the fit.
        """
        slopes, markers = search.derivative(near), search.markers
        if self.around:
            self.predictor.around = {}
            try:
                described = self.predictor.markers(search.point, near=search.settled)
            finally:
                self.predictor.around = self.around
            markers = markers if described is None else described
        plain = Fit(
            search.frees,
            search.nuisances,
            search.values,
            search.raw,
            slopes,
            markers,
            response=self.response,
            described=np.array([self.predictor.value(free) for free in search.frees]),
            settled=search.settled,
            tangent=search.tangent,
        )
        return with_imperfections(plain, self.random, self.sizes, self.around)

    def linearise_around(self, members: Members) -> None:
        """Linearise the imperfections around given ones."""
        self.around = self.predictor.around = members
        # corrected for what imperfections do beyond their slopes
        self.measured = self.predictor.dataset.mean + self.imperfections.moved(members)

    def resume(self, fit: Fit) -> None:
        """Set the imperfections and their sizes to those of a fit."""
        self.sizes = fit.built.sizes
        self.linearise_around(fit.built.around)

    def residual(self, markers: Floats) -> Floats:
        """Whitened residual (N,) for predicted markers."""
        return self.whitener.white(self.measured - markers)

    def lift(self, rows: Floats) -> Floats:
        """Remove from whitened rows (N + nuisances, ...) what imperfections explain."""
        n, root = self.whitener.size, self.random.root(self.sizes)
        return np.concatenate([self.random.lift(root, rows[:n]), rows[n:]])

    def estimate(self, search: Search) -> Sizes:
        """Estimate the sizes of the imperfections where a search is."""
        n = self.whitener.size
        weights = np.append(np.full(search.count, 1e-9), 1.0 / search.spread**2)
        slopes = search.derivative(near=True)
        return self.random.estimate(search.raw[:n], slopes[:n], self.sizes, weights)


def _between(start: Members, goal: Members, fraction: float) -> Members:
    """Interpolate linearly between members; a kind that is missing at the start is zero there."""
    return {
        name: (1.0 - fraction) * start.get(name, np.zeros_like(value)) + fraction * value
        for name, value in goal.items()
    }


class Descent:
    """
    A running fit, round by round; of an exact arm the first round is the last.

    A round searches parameters with linearised imperfections, which yields a step of all three
    (parameters, imperfections and their sizes). The step is accepted if the deviance that the
    model itself predicts there is lower, so that it never rises, even where friction reverses.
    """

    def __init__(self, fitter: Fitter, search: Search, steps: int = STEPS_MAX) -> None:
        """Run the first search from its start, to which the fitter is set."""
        self.fitter, self.steps, self._search = fitter, steps, search
        self.place = fitter.place(search)
        self.gain = np.inf  # in the last round
        self.converged = not fitter.random.kinds  # the search was all
        self._rounds = 0
        search.run(steps)
        if self.converged:
            self.place = fitter.place(search)

    def go_on(self, hopeless: float = np.inf) -> None:
        """Do one more round; converged too where the expected deviance stays above `hopeless`."""
        fitter, search = self.fitter, self._search
        fitter.sizes = self.place.sizes
        fitter.linearise_around(self.place.around)
        estimated = fitter.estimate(search)
        gain = min(self.gain, self.place.deviance - estimated.deviance)
        if estimated.deviance - GAINS_TO_COME * gain > hopeless:
            self.converged = True
            return
        fitter.sizes = estimated.values
        search.update_residual()
        search.run(self.steps)
        better = fitter.first_better(self.place, search, estimated.values)
        self._rounds += 1
        self.converged = better is None or self._rounds == ROUNDS_MAX
        if better is None:
            return
        self.gain, self.place = self.place.deviance - better.deviance, better
        self._search = fitter.go(better)
        self.converged = self.converged or self.gain < DEVIANCE_CONVERGED

    def fit(self) -> Fit:
        """Return the present fit."""
        return self.fitter.freeze(self.fitter.go(self.place))
