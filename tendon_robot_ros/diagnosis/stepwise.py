"""
The search behind `improve`: effects join one after the other, judged on postures left out.

At each step joins what lowers the error on left-out postures most, all parameters fitted together
again, with weak priors around what is described, so that what the postures do not tell stays
there; what is no longer needed leaves. Left out is one posture at a time, in closed form from the
slopes of a fit (`promise`). The fits weigh what they cannot explain (`noise.likely`), of likely
sizes where a step ended.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError
from ..comparison.noise import Noise, Whitener, input_slopes, likely, rms
from ..comparison.outliers import find_outliers, without_unsettled
from ..comparison.predict import Point
from ..comparison.repeatability import estimate_noise
from ..comparison.statistics import chi2_sf, f_sf
from ..data import DataSet
from ..effects import Catalogue
from ..robot import Robot
from ..robot.estimates import natural_sizes
from .candidates import Candidate, joining_effects
from .decide import P_SINGLE_MIN
from .described_arm import OF_THE_ARM, DescribedArm, arm_with, blocks_of_the_arm
from .fit import Fit, Nuisance
from .fitter import Fitter
from .into_description import changed_robot
from .mistake import Mistake
from .prediction_errors import Joining, Ways, described, grown, left_out_errors, predict, promised
from .setup_mistakes import find_mistake

Floats = npt.NDArray[np.float64]
Held = Sequence[int] | npt.NDArray[np.int64]
POSTURES_MIN = 4  # that must be measured
PRIOR_TYPICALS = 10.0  # sd of the priors, in typical sizes of the parameters
STEPS_MAX = 12  # effects that may join
TRIED_MAX = 2  # effects that are fitted at a step: those that promise most
TURNS_TRIED, TURNS = 3, 25  # of fits that are tried, and of the one that is made
FALL_MIN = 0.005  # of the squared error on left-out postures, for a step to be made at all


@dataclass(frozen=True)
class State:
    """Blocks of parameters that have joined, fitted together."""

    blocks: tuple[Candidate, ...]
    fit: Fit  # rows of the priors last
    whitener: Whitener
    left_out: Floats  # (P,) [m²] mean over markers of the squared error, postures left out
    joined: str = ''  # the block that joined last
    left: tuple[str, ...] = ()  # blocks that left thereupon

    @property
    def names(self) -> set[str]:
        """Names of the blocks."""
        return {block.label for block in self.blocks}

    @property
    def effects_in(self) -> set[str]:
        """Names of the effects of the catalogue among them."""
        return {name for block in self.blocks for name in block.names} - set(OF_THE_ARM)

    @property
    def score(self) -> float:
        """Mean squared error [m²] of postures left out one at a time."""
        return float(np.nanmean(self.left_out))

    @property
    def effects(self) -> Fit:
        """The fit of the effects of the catalogue alone."""
        own = np.array([f.effect not in OF_THE_ARM for f in self.fit.frees], dtype=bool)
        frees = tuple(f for f in self.fit.frees if f.effect not in OF_THE_ARM)
        values, jacobian = self.fit.values[own], self.fit.jacobian[:, own]
        return replace(self.fit, frees=frees, values=values, jacobian=jacobian)


class Stepwise:
    """One data set and description: what may join, weights by step, fits."""

    def __init__(self, dataset: DataSet, robot: Robot, catalogue: Catalogue) -> None:
        """
        Look at the measurements before physics: noise, outliers, mistakes of the set-up.

        Raises
        ------
        InputError
            Too few postures, nothing tells the noise, or a mistake that is to be mended first.
        NoEquilibriumError

        """
        if int((dataset.trials > 0).sum()) < POSTURES_MIN:
            raise InputError(f'{dataset.name}: expected {POSTURES_MIN} or more measured postures')
        self.robot, self.catalogue = robot, catalogue.sized(natural_sizes(robot))
        every = DescribedArm(dataset, robot, self.catalogue)
        settled, self.unsettled = without_unsettled(every)
        self.outliers = find_outliers(predict(settled, robot, catalogue)[0], {})
        self.dataset = self.outliers.without(settled) if self.outliers.any else settled
        self.predictor = DescribedArm(self.dataset, robot, self.catalogue)
        self.measured = self.dataset.mean
        self.slopes = input_slopes(self.predictor, {})
        self.noise = _noise(self.dataset, self.slopes)
        self.plain = Whitener(self.dataset, self.noise, self.slopes)
        self.doubt = self._doubtful_mistake()
        self.blocks = [
            *joining_effects(robot, self.catalogue, self.dataset),
            *blocks_of_the_arm(robot),
        ]

    def _doubtful_mistake(self) -> Mistake | None:
        """Return the mistake that effects may explain better; refuse one that they do not."""
        mistake = find_mistake(self.predictor, self.plain.floor())
        if mistake is not None and not mistake.doubtful:
            self._refuse(mistake)
        return mistake

    def _refuse(self, mistake: Mistake) -> None:
        before = rms(self.measured - self.predict({}))
        raise InputError(f'{self.dataset.name}: {mistake.text(before)}')

    def refuse_mistake(self, found: State) -> None:
        """
        Refuse the mistake in doubt where it explains more than what was found.

        Raises
        ------
        InputError

        """
        if self.doubt is not None and rms(self.measured - found.fit.markers) > self.doubt.after:
            self._refuse(self.doubt)

    def predict(self, point: Point) -> Floats:
        """Return the markers (P, J, 3) [m] at a point at which there are some."""
        markers = self.predictor.markers(point)
        assert markers is not None
        return markers

    def again(self) -> Stepwise:
        """Return the same with a model of its own, for another thread."""
        other = copy(self)
        other.predictor = DescribedArm(self.dataset, self.robot, self.catalogue)
        return other

    def path(self, held: Held = (), show: Callable[[int], None] | None = None) -> list[State]:
        """Return the states of a search that knows nothing of the postures held; first: bare."""
        whitener = self.weights(self.predict({}), held)
        states = [self.state((), {}, whitener)]
        for k in range(STEPS_MAX):
            if show is not None:
                show(k)
            if self.chance(states[-1], held) > P_SINGLE_MIN:
                break  # nothing but noise remains
            better = self.step(states[-1])
            if better is None:
                break
            whitener = self.weights(better.fit.markers, held)
            again = self.tried(better.blocks, better.fit.point, whitener, better.joined)
            states.append(replace(again or better, left=better.left))
        return states

    def step(self, here: State) -> State | None:
        """Let the block join that lowers the error most, and idle ones leave; None: none does."""
        found = []
        for joining in self.promising(here):
            blocks, start = (*here.blocks, joining.block), {**here.fit.point, **joining.start}
            label = joining.block.label
            made = self.tried(blocks, start, here.whitener, label, TURNS_TRIED)
            found += [] if made is None else [made]
        if not found:
            return None
        best = min(found, key=lambda state: state.score)
        best = self.tried(best.blocks, best.fit.point, here.whitener, best.joined) or best
        if best.score > (1.0 - FALL_MIN) * here.score:
            return None
        return self.without_idle(best)

    def without_idle(self, state: State) -> State:
        """Let blocks leave without which the error is as small, one after the other."""
        for block in state.blocks[:-1]:
            if self.acted_on(block, state) or self.promise_without(block, state) > state.score:
                continue
            rest = tuple(one for one in state.blocks if one is not block)
            point = {f: value for f, value in state.fit.point.items() if f not in block.frees}
            fewer = self.tried(rest, point, state.whitener, state.joined)
            if fewer is not None and fewer.score <= state.score:
                state = replace(fewer, left=(*state.left, block.label))
        return state

    def acted_on(self, block: Candidate, state: State) -> bool:
        """Tell whether another block that has joined only shapes what this one does."""
        shaped = {self.catalogue[name].acts_on for name in state.effects_in}
        return bool(shaped & set(block.names))

    def promising(self, here: State) -> list[Joining]:
        """Return how the blocks would join that promise the smallest errors."""
        try:
            ways = Ways(self.predictor, here.whitener, here.fit)
        except ArithmeticError:
            return []
        best: dict[str, tuple[float, Joining]] = {}
        for joining in ways.of([block for block in self.blocks if self.may_join(block, here)]):
            error, label = self.promise(here, joining), joining.block.label
            if error < best.get(label, (here.score,))[0]:
                best[label] = (error, joining)
        order = sorted(best.values(), key=lambda pair: pair[0])
        return [joining for _, joining in order[:TRIED_MAX]]

    def may_join(self, block: Candidate, here: State) -> bool:
        """Tell whether a block is new there, and whether anything lets it act."""
        own = here.effects_in
        if block.label in here.names or own & set(block.names):
            return False
        there = own | set(self.robot.effects) | set(block.names)
        for effect in (self.catalogue[name] for name in block.names if name in self.catalogue):
            contained = any(effect.name in self.catalogue[other].contains for other in own)
            if contained or set(effect.contains) & own:
                return False
            if effect.acts_on is not None and effect.acts_on not in there:
                return False
        return True

    def promise(self, state: State, joining: Joining) -> float:
        """Return the error [m²] on left-out postures, by slopes, if a block joined."""
        frees = joining.block.frees
        spread = np.array([PRIOR_TYPICALS * free.parameter.typical for free in frees])
        back = np.zeros(len(frees))
        if np.any(joining.change):
            back += [joining.start[free] - described(self.predictor, free) for free in frees]
        made = grown(state.fit, joining, back, spread)
        return promised(*made, state.whitener, self.dataset.groups)

    def promise_without(self, block: Candidate, state: State) -> float:
        """Return the error [m²] on left-out postures, by slopes, if a block left."""
        residual, jacobian, frees = state.fit.residual, state.fit.jacobian, state.fit.frees
        own = np.array([free in block.frees for free in frees])
        back = np.array([described(self.predictor, free) for free in frees]) - state.fit.values
        residual = residual + jacobian[:, own] @ back[own]
        return promised(residual, jacobian[:, ~own], state.whitener, self.dataset.groups)

    def state(
        self,
        blocks: tuple[Candidate, ...],
        start: Point,
        whitener: Whitener,
        joined: str = '',
        turns: int = TURNS,
    ) -> State:
        """Fit blocks together, with their priors."""
        frees = tuple(free for block in blocks for free in block.frees)
        centres = [described(self.predictor, free) for free in frees]
        priors = [
            Nuisance(free.effect, free, centre, PRIOR_TYPICALS * free.parameter.typical)
            for free, centre in zip(frees, centres, strict=True)
        ]
        found = Fitter(self.predictor, whitener, priors).fit((), start, turns)
        fit = Fit(frees, (), found.values, found.residual, found.jacobian, found.markers)
        free = fit.jacobian[:, ~_pressed(fit)]
        errors = left_out_errors(fit.residual, free, whitener, self.dataset.groups)
        return State(blocks, fit, whitener, errors, joined)

    def tried(self, *arguments: Any) -> State | None:
        """Fit blocks together; None where the arm has no equilibrium there. See `state`."""
        try:
            return self.state(*arguments)
        except (ArithmeticError, np.linalg.LinAlgError):
            return None

    def weights(self, markers: Floats, held: Held) -> Whitener:
        """Return weights that know what a prediction does not explain, of likely sizes."""
        sizes = likely(self.dataset, self.noise, self.slopes, self.measured - markers, held)
        return Whitener(self.dataset, self.noise, self.slopes, *sizes).without(held)

    def chance(self, state: State, held: Held = ()) -> float:
        """Return the chance that noise alone leaves so much unexplained, of postures not held."""
        white = self.plain.without(held).white(self.measured - state.fit.markers)
        chi2, freedom = float(white @ white), max(len(white) - len(state.fit.frees), 1)
        if not np.isfinite(self.noise.freedom):
            return chi2_sf(chi2, freedom)
        return f_sf(chi2 / freedom, freedom, self.noise.freedom)

    def written(self, state: State) -> Robot:
        """Return the description with what a state has fitted."""
        robot = changed_robot(self.robot, self.catalogue, state.effects, self.dataset)
        return arm_with(robot, state.fit.point)


def _pressed(fit: Fit) -> npt.NDArray[np.bool_]:
    """Tell which parameters (q,) stand at a bound that they would pass."""
    low = np.array([free.parameter.low for free in fit.frees])
    high = np.array([free.parameter.high for free in fit.frees])
    slope = fit.jacobian.T @ fit.residual
    return np.asarray(
        ((fit.values <= low) & (slope > 0.0)) | ((fit.values >= high) & (slope < 0.0))
    )


def _noise(dataset: DataSet, slopes: Floats) -> Noise:
    noise = estimate_noise(dataset, slopes)
    if noise is None:
        raise InputError(
            f'{dataset.name}: one trial per posture and no position_noise in dataset.yaml: '
            'repeat the postures, or declare the noise of the tracker'
        )
    return noise
