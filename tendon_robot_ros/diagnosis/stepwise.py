"""
The search behind `improve`: effects join one after the other, judged on postures left out.

At each step the effect joins that lowers the error on left-out postures most. All parameters are
fitted together again, with weak priors around the described values, so that undetermined ones stay
there; effects that are no longer needed leave. One posture is left out at a time, in closed form
from the Jacobian of a fit (`promise`). The weights include a model error (`noise.likely`), whose
size is estimated after every step, and what several recordings differ in beside the arm: zeros and
the tracker's frame, set anew in each.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..common.arrays import Floats, Ints
from ..common.errors import InputError
from ..data import DataSet
from ..effects import Catalogue
from ..inference.candidates import Candidate, joining_effects
from ..inference.crossval import FOLDS, folds_of, left_out_errors
from ..inference.description import OF_THE_ARM, DescribedArm, blocks_of_the_arm, changed_robot
from ..inference.fit import Fit, Nuisance, Scatter, covariance_of, covariance_root
from ..inference.fitter import DEVIANCE_CONVERGED, FAILURES, Fitter
from ..inference.imperfections import (
    BuiltPredictor,
    Imperfections,
    Members,
    between_recordings,
    from_mean,
)
from ..inference.marginal import NEGLIGIBLE
from ..inference.marginal import STEPS_MAX as ITERATIONS_MAX
from ..inference.noise import Whitener, input_slopes, likely
from ..inference.predict import FreeParameter, Point, Predictor, slope
from ..inference.search import DIFFERENCE_STEP, LADDER
from ..inference.session import Question
from ..inference.statistics import misfit_p_value, rms
from ..robot import Robot
from .select import overlaps
from .setup_hypotheses import Mistake
from .setup_mistakes import find_mistake
from .verdict import P_SINGLE_MIN, POSTURES_MIN

Held = Sequence[int] | Ints
GROUPS_MIN = POSTURES_MIN + 1  # [1] of different inputs, because one is left out
GROUPS_MAX = 16  # [1] of postures, because the whole search is made without each of them
PRIOR_TYPICALS = 10.0  # [1] sd of the priors, so that only what nothing tells stays as described
STEPS_MAX = 12  # [1] effects that may join, else a model that fits nothing would collect them all
TRIED_MAX = 2  # [1] effects fitted at a step, because fits are what a search takes its time for
# [1] tried at a step, because all gain hardly more and take twice the time: the left-out error of
# the trunk's tip is 5.5 mm without, and 4.7, 4.4 and 4.1 mm with 2, 4 and all
EXCHANGES_MAX = 4
STEPS_TRIED = 3  # [1] of a first fit, because the fit of the best block continues from there


@dataclass(frozen=True)
class Joining:
    """A block that may join a fit: its start, and what it does to the markers."""

    block: Candidate
    start: Point
    change: Floats | float  # (P, J, 3) [m] at the start; 0 for a law without a jump
    moves: Floats  # (q, P, J, 3) [m per unit] derivatives


class Promise(NamedTuple):
    """The linearised left-out error [m²] if one block joined, and another one left."""

    error: float
    joining: Joining
    leaving: Candidate | None = None


def jumps(block: Candidate, predictor: Predictor) -> bool:
    """Return whether the description lacks an effect of a block that acts whatever its value."""
    catalogue, present = predictor.model.catalogue, predictor.robot.effects
    return any(n in catalogue and n not in present and catalogue[n].always_on for n in block.names)


def spread_of(frees: Sequence[FreeParameter]) -> Floats:
    """Return the standard deviations (q,) of the priors of parameters."""
    return np.array([PRIOR_TYPICALS * free.parameter.typical for free in frees])


def grown(
    fit: Fit, moves: Floats, whitener: Whitener, spread: Floats, back: Floats | float = 0.0
) -> tuple[Floats, Floats]:
    """
    Return residual (N + p,) and Jacobian (N + p, f) of a fit with more parameters and priors.

    Parameters
    ----------
    moves : (q, P, J, 3) [m per unit]
        Derivatives of the markers by the parameters.
    spread, back : (q,)
        The sd of their priors, and the distance of their start from what these expect.

    """
    n, q = whitener.size, len(moves)
    columns = np.zeros((len(fit.residual), q))
    columns[:n] = -whitener.white(moves).T
    beside = np.zeros((q, fit.jacobian.shape[1]))
    jacobian = np.block([[fit.jacobian, columns], [beside, np.diag(1.0 / spread)]])
    return np.append(fit.residual, np.broadcast_to(back, q) / spread), jacobian


class Weights(NamedTuple):
    """The likely error of a prediction beside the effects."""

    whitener: Whitener  # noise, and the error of a model in every posture
    anew: Imperfections  # what several recordings differ in


@dataclass(frozen=True)
class State:
    """Blocks of parameters that have joined, fitted together."""

    blocks: tuple[Candidate, ...]
    fit: Fit  # rows of the priors last
    weights: Weights
    left_out: Floats  # (P,) [m²] mean over markers of the squared error, postures left out
    joined: str = ''  # the block that joined last
    removed: tuple[str, ...] = ()  # blocks that left after that

    @property
    def names(self) -> frozenset[str]:
        """Names of the blocks."""
        return frozenset(block.label for block in self.blocks)

    @property
    def effects_in(self) -> set[str]:
        """Names of the effects of the catalogue among them."""
        return {name for block in self.blocks for name in block.names} - set(OF_THE_ARM)

    @property
    def whitener(self) -> Whitener:
        """The weights of the fit."""
        return self.weights.whitener

    @property
    def moved(self) -> Floats | float:
        """Change of the markers (P, J, 3) [m] by what was set anew in each recording."""
        return self.weights.anew.moved(self.fit.anew)

    def beside(self, joining: Joining) -> Fit:
        """Return what a fit with a further block begins with: both, and their derivatives."""
        fit, start = self.fit, joining.start
        tangent = fit.tangent and fit.tangent.beside(joining.moves, start)
        values = np.append(fit.values[: len(fit.frees)], list(start.values()))
        return replace(fit, frees=(*fit.frees, *start), values=values, tangent=tangent)

    @property
    def score(self) -> float:
        """Mean squared error [m²] of postures left out one at a time."""
        return float(np.nanmean(self.left_out))

    @property
    def effects(self) -> Fit:
        """The effects of the catalogue with the covariance of the search, of an exact arm."""
        own = np.flatnonzero([free.effect not in OF_THE_ARM for free in self.fit.frees])
        spread = covariance_of(*covariance_root(self.fit.jacobian))[np.ix_(own, own)]
        return replace(
            self.fit,
            frees=tuple(self.fit.frees[i] for i in own),
            values=self.fit.values[own],
            residual=np.zeros(len(own)),
            jacobian=np.linalg.inv(np.linalg.cholesky(spread)),
            built=Scatter.none(),
        )


class Stepwise:
    """The search on one data set and description: blocks that may join, weights and fits."""

    def __init__(self, dataset: DataSet, robot: Robot, catalogue: Catalogue) -> None:
        """
        Check the measurements: noise, outliers, mistakes of the set-up.

        Raises
        ------
        InputError
            Too few postures, unknown noise, or a mistake that has to be corrected first.
        NoEquilibriumError

        """
        if int((dataset.trials > 0).sum()) < GROUPS_MIN:
            raise InputError(f'{dataset.name}: expected {GROUPS_MIN} or more measured postures')
        session = Question.of(dataset, robot, catalogue).prepared()
        self.robot, self.catalogue = robot, session.catalogue
        self.unsettled, self.outliers = session.unsettled, session.outliers
        self.dataset, self.whole, self.noise = session.dataset, session.whole, session.noise
        self.predictor = DescribedArm(self.dataset, robot, self.catalogue)
        self.measured = self.dataset.mean
        self.slopes = input_slopes(self.predictor, {})
        self.plain = Whitener(self.dataset, self.noise, self.slopes)
        # a doubtful mistake is refused only if the search does not explain more
        self.doubt = find_mistake(self.predictor, self.plain.floor())
        if self.doubt is not None and not self.doubt.doubtful:
            self._refuse(self.doubt)
        self.blocks = [
            *joining_effects(robot, self.catalogue, self.dataset),
            *blocks_of_the_arm(robot),
        ]
        self.folds = folds_of(self.dataset, FOLDS if self.dataset.thinned_from else GROUPS_MAX)
        self.held: Held = ()  # postures without weight
        # fits of all postures, and what may join these, by the blocks that have joined
        self.fits = dict[frozenset[str], Fit]()
        self.joinings = dict[frozenset[str], dict[str, Joining | None]]()

    def _refuse(self, mistake: Mistake) -> None:
        before = rms(self.measured - self.predict({}))
        raise InputError(f'{self.dataset.name}: {mistake.text(before)}')

    def refuse_mistake(self, last: State) -> None:
        """
        Refuse a doubtful mistake where it explains more than the last state of a search.

        Raises
        ------
        InputError

        """
        if self.doubt is not None and rms(self.missed(last)) > self.doubt.after:
            self._refuse(self.doubt)

    def predict(self, point: Point) -> Floats:
        """Return the markers (P, J, 3) [m] at a point that has an equilibrium."""
        markers = self.predictor.markers(point)
        assert markers is not None
        return markers

    def missed(self, state: State) -> Floats:
        """Return measured minus predicted markers (P, J, 3) [m]."""
        return np.asarray(self.measured - state.moved - state.fit.markers)

    def anew(self, state: State) -> Members:
        """Return how far what was set anew in each recording differs from their mean."""
        return from_mean(state.fit.anew, len(self.dataset.divided))

    def squares(self, states: Sequence[State]) -> Floats:
        """Return squared errors (P, J) [m²], of each fold those of its state."""
        squares = np.full(self.measured.shape[:2], np.nan)
        for held, state in zip(self.folds, states, strict=True):
            squares[held] = (self.missed(state) ** 2).sum(axis=2)[held]
        return squares

    def without(self, held: Held) -> Stepwise:
        """
        Return the same search without some postures, with a model of its own.

        Its fits begin at those of this one, where it chooses the same blocks.
        """
        other = copy(self)
        other.predictor = DescribedArm(self.dataset, self.robot, self.catalogue)
        other.held, other.plain = held, self.plain.without(held)
        return other

    def path(self) -> Iterator[State]:
        """Yield the states of a search; the first has no blocks."""
        # [m²] that a block was to gain when it was last judged, by its label; see `promising`
        gains = dict[str, float]()
        state = self.fitted((), {}, self.weights())
        assert state is not None  # it has its equilibria
        state = self.fitted((), state.fit, self.weights(state)) or state
        for _ in range(STEPS_MAX):
            yield state
            if self.chance(self.missed(state), len(state.fit.values)) > P_SINGLE_MIN:
                return  # nothing but noise remains
            better = self.step(state, gains)
            if better is None:
                return
            fitted = self.fitted(better.blocks, better.fit, self.weights(better), better.joined)
            state = replace(fitted or better, removed=better.removed)
        yield state

    def step(self, state: State, gains: dict[str, float]) -> State | None:
        """
        Return the best state with a further block, without idle ones; None if none is better.

        Where no further block helps, one may take the place of another, so that what joined first
        does not keep out what explains more.
        """
        best = self.best_of(state, self.promising(state, gains))
        best = best or self.best_of(state, self.exchanges(state))
        return None if best is None else self.without_idle(best)

    def best_of(self, state: State, promises: Sequence[Promise]) -> State | None:
        """
        Return the best state that promises lead to; None if none is better than the present one.

        One that promises less than another one has reached is not fitted.
        """
        best, limit = None, (1.0 - 0.5 * NEGLIGIBLE) * state.score
        for error, joining, leaving in promises:
            if best is not None and best.score < error:
                break
            blocks = *(one for one in state.blocks if one is not leaving), joining.block
            start, label = state.beside(joining), joining.block.label
            fitted = self.fitted(blocks, start, state.weights, label, STEPS_TRIED)
            if fitted is not None and fitted.score <= limit:
                best, limit = fitted, fitted.score
                best = replace(best, removed=() if leaving is None else (leaving.label,))
        return best

    def without_idle(self, state: State) -> State:
        """Remove blocks without which the error is as small, one after the other."""
        for block in state.blocks[:-1]:
            if self.acted_on(block, state) or self.promise(state, leaving=block) > state.score:
                continue
            rest = tuple(one for one in state.blocks if one is not block)
            fewer = self.fitted(rest, state.fit, state.weights, state.joined)
            if fewer is not None and fewer.score <= state.score:
                state = replace(fewer, removed=(*state.removed, block.label))
        return state

    def acted_on(self, block: Candidate, state: State) -> bool:
        """Return whether another block that has joined only modifies this one."""
        shaped = {self.catalogue[name].acts_on for name in state.effects_in}
        return bool(shaped & set(block.names))

    def promising(self, state: State, gains: dict[str, float]) -> list[Promise]:
        """
        Return the blocks whose joining promises the smallest errors.

        Those that only solutions judge come last, and only where they may beat the others: what a
        block gains falls as others join, so that its gain in an earlier step, `gains` [m²] by its
        label, is a bound (lazy greedy search, Minoux 1978).
        """
        best: dict[str, Promise] = {}
        blocks = [block for block in self.blocks if self.may_join(block, state)]
        slow = [block for block in blocks if jumps(block, self.predictor)]
        for joining in self.joining(state, [block for block in blocks if block not in slow]):
            error = self.promise(state, joining)
            if error < state.score:
                best[joining.block.label] = Promise(error, joining)
        for block in slow:
            errors = sorted(promise.error for promise in best.values())
            beaten = state.score if len(errors) < TRIED_MAX else errors[TRIED_MAX - 1]
            if state.score - gains.get(block.label, np.inf) >= beaten:
                continue
            error = state.score
            for joining in self.joining(state, [block]):
                error = self.promise(state, joining)
                if error < state.score:
                    best[block.label] = Promise(error, joining)
            gains[block.label] = state.score - error
        return sorted(best.values(), key=lambda promise: promise.error)[:TRIED_MAX]

    def exchanges(self, state: State) -> list[Promise]:
        """Return the exchanges of one block for a new one that promise the smallest errors."""
        new = (block for block in self.blocks if block.label not in state.names)
        joinings = self.joining(state, [one for one in new if not jumps(one, self.predictor)])
        found = list[Promise]()
        for leaving in state.blocks:
            if self.acted_on(leaving, state):
                continue
            rest = replace(state, blocks=tuple(one for one in state.blocks if one is not leaving))
            for joining in joinings:
                if self.may_join(joining.block, rest):
                    found.append(Promise(self.promise(state, joining, leaving), joining, leaving))
        found = [promise for promise in found if promise.error < state.score]
        return sorted(found, key=lambda promise: promise.error)[:EXCHANGES_MAX]

    def joining(self, state: State, blocks: Sequence[Candidate]) -> list[Joining]:
        """Return what blocks do beside a state; by the fit of all postures, where it is known."""
        known = self.joinings.get(state.names, {})
        new = [block for block in blocks if block.label not in known]
        if new:
            own = {joining.block.label: joining for joining in self.rates(state, new)}
            known = known | {block.label: own.get(block.label) for block in new}
            if not len(self.held):
                self.joinings[state.names] = known
        made = [known[block.label] for block in blocks]
        return [joining for joining in made if joining is not None]

    def rates(self, state: State, blocks: Sequence[Candidate]) -> Iterator[Joining]:
        """Yield what blocks do to the markers beside a fit; those that jump from several sizes."""
        predictor, fit = self.predictor, state.fit
        catalogue = predictor.model.catalogue
        effects = {name: catalogue[name] for b in blocks for name in b.names if name in catalogue}
        smooth = [
            free
            for block in blocks
            for free in block.frees
            if free.effect not in effects or predictor.has_slopes(effects[free.effect])
        ]
        assert fit.settled is not None
        moved = predictor.tangent(fit.point, smooth, fit.settled) if smooth else None
        slopes = dict[FreeParameter, Floats]()
        if moved is not None:
            finite = np.isfinite(moved.markers).all(axis=(1, 2, 3))
            slopes = {free: moved.markers[i] for i, free in enumerate(smooth) if finite[i]}
        for block in blocks:
            if jumps(block, predictor):
                yield from self._jumping(state, block)
                continue
            start, own = {}, []
            for free in block.frees:
                value = predictor.start(free)
                step = free.parameter.step(value, DIFFERENCE_STEP)
                start[free] = value + step
                rate = slopes.get(free)
                if rate is None:
                    rate = slope(fit.markers, self._beside(fit, {free: value + step}), step)
                own.append(rate)
            yield Joining(block, start, 0.0, np.array(own))

    def _jumping(self, state: State, block: Candidate) -> Iterator[Joining]:
        """
        Yield a block whose presence changes the markers at every value, from the best of sizes.

        Sizes grow until a larger one is worse, the parameters of the fit adjusted linearly; they
        stay below the typical ones, from where a fit goes on.
        """
        fit, whitener = state.fit, state.whitener
        slopes = fit.jacobian[: whitener.size]
        best, lowest = None, np.inf
        for size in LADDER[:4:2]:
            start = {free: free.clip(size * free.parameter.typical) for free in block.frees}
            jumped = self._beside(fit, start)
            if jumped is None:
                break
            white = whitener.white(self.measured - jumped)
            rest = white - slopes @ np.linalg.lstsq(slopes, white)[0]
            if float(rest @ rest) > lowest:
                break
            lowest, best = float(rest @ rest), (start, jumped)
        if best is None:
            return
        start, jumped = best
        moves = []
        for free, value in start.items():
            step = DIFFERENCE_STEP * value
            moves.append(slope(jumped, self._beside(fit, {**start, free: value + step}), step))
        yield Joining(block, start, jumped - fit.markers, np.array(moves))

    def _beside(self, fit: Fit, more: Point) -> Floats | None:
        """Return the markers (P, J, 3) [m] at a fit with more; None without equilibrium."""
        return self.predictor.markers({**fit.point, **more}, near=fit.settled)

    def may_join(self, block: Candidate, state: State) -> bool:
        """Return whether a block is new in a state, and the effect that it modifies is present."""
        own = state.effects_in
        if block.label in state.names or own & set(block.names):
            return False
        present = own | set(self.robot.effects) | set(block.names)
        for effect in (self.catalogue[name] for name in block.names if name in self.catalogue):
            alone = effect.acts_on is not None and effect.acts_on not in present
            if alone or overlaps(self.catalogue, effect.name, own):
                return False
        return True

    def promise(
        self, state: State, joining: Joining | None = None, leaving: Candidate | None = None
    ) -> float:
        """
        Return the left-out error [m²] if one block joined and another one left.

        Linearised, after one Gauss-Newton step.
        """
        fit, whitener = state.fit, state.whitener
        residual, jacobian = fit.residual, fit.jacobian
        if joining is not None:
            frees = joining.block.frees
            spread = spread_of(frees)
            back = np.zeros(len(frees))
            if np.any(joining.change):
                back += [joining.start[free] - self.predictor.start(free) for free in frees]
            residual, jacobian = grown(fit, joining.moves, whitener, spread, back)
            if np.any(joining.change):
                residual[: whitener.size] -= whitener.white(np.asarray(joining.change))
        if leaving is not None:
            own = [i for i, free in enumerate(fit.frees) if free in leaving.frees]
            back = np.array([self.predictor.start(fit.frees[i]) for i in own]) - fit.values[own]
            residual = residual + jacobian[:, own] @ back
            jacobian = np.delete(jacobian, own, axis=1)
        step = covariance_of(*covariance_root(jacobian), blind=0.0) @ (jacobian.T @ residual)
        rest = residual - jacobian @ step
        return float(np.nanmean(left_out_errors(rest, jacobian, whitener, self.dataset.groups)))

    def fitted(
        self,
        blocks: tuple[Candidate, ...],
        start: Fit | Point,
        weights: Weights,
        joined: str = '',
        steps: int = ITERATIONS_MAX,
    ) -> State | None:
        """
        Fit blocks together, with their priors, from a point, or from a fit and its derivatives.

        Without some postures a fit begins at the one of all postures, where that is known. None
        where the arm has no equilibrium.
        """
        names, all_count = frozenset(block.label for block in blocks), not len(self.held)
        start = start if all_count else self.fits.get(names, start)
        frees = tuple(free for block in blocks for free in block.frees)
        priors = [
            Nuisance(free.effect, free, self.predictor.start(free), sd)
            for free, sd in zip(frees, spread_of(frees).tolist(), strict=True)
        ]
        fitter = Fitter(self.predictor, weights.whitener, priors, weights.anew)
        low = np.array([free.parameter.low for free in frees])
        high = np.array([free.parameter.high for free in frees])
        try:
            search = fitter.search((), start, fitter.random.plausible)
            if not all_count:  # its errors count, its values are not told
                search.gain_min = DEVIANCE_CONVERGED
            search.run(steps)
            fit = fitter.freeze(search, not all_count or steps < ITERATIONS_MAX)
            fit = replace(fit, frees=frees, nuisances=(), described=0.0)
            values, moves = fit.values[: len(frees)], fit.jacobian[:, : len(frees)]
            slope = moves.T @ fit.residual
            pressed = (values <= low) & (slope > 0.0) | (values >= high) & (slope < 0.0)
            free = np.delete(fit.jacobian, np.flatnonzero(pressed), axis=1)
            groups = self.dataset.groups
            errors = left_out_errors(fit.residual, free, weights.whitener, groups)
        except FAILURES:
            return None
        if all_count:
            self.fits[names] = fit
        return State(blocks, fit, weights, errors, joined)

    def weights(self, state: State | None = None) -> Weights:
        """Return weights with an error of estimated size, at a state; default: as described."""
        off = self.measured - self.predict({}) if state is None else self.missed(state)
        sizes = likely(self.dataset, self.noise, self.slopes, off, self.held)
        whitener = Whitener(self.dataset, self.noise, self.slopes, *sizes).without(self.held)
        robot = self.robot if state is None else self.written(state)
        arm = BuiltPredictor(Predictor(self.dataset, robot, self.catalogue))
        anew = between_recordings(arm, None if state is None else state.fit.settled)
        if anew is None:
            anew = Imperfections.none(self.dataset) if state is None else state.weights.anew
        return Weights(whitener, anew)

    def chance(self, off: Floats, count: int) -> float:
        """
        Return the p-value of what a fit left `off` (P, J, 3) [m] by noise alone.

        Of a fit of so many parameters, on postures not held out.
        """
        white = self.plain.white(off)
        chi2, freedom = float(white @ white), max(len(white) - count, 1)
        return misfit_p_value(chi2, freedom, self.noise.freedom)

    def written(self, state: State) -> Robot:
        """Return the description with the fitted values of a state."""
        return changed_robot(self.robot, self.catalogue, state.fit, self.dataset)
