"""
The search behind `improve`: effects join one after the other, judged on postures left out.

At each step joins what lowers the error on left-out postures most, all parameters fitted together
again, with weak priors around what is described, so that what the postures do not tell stays
there; what is no longer needed leaves. Left out is one posture at a time, in closed form from the
slopes of a fit. The fits weigh what they cannot explain: beside the noise an error of every
posture that grows along the arm, and one of every marker, of likely sizes where a step ended.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError
from ..comparison.noise import Noise, Whitener, estimate_noise, input_slopes, rms
from ..comparison.predict import FreeParameter, Point
from ..comparison.statistics import chi2_sf, f_sf, minimum
from ..data import DataSet
from ..effects import Catalogue
from ..robot import Robot
from ..robot.estimates import natural_sizes
from .add import changed_robot
from .candidates import Candidate, candidates_of
from .decide import P_SINGLE_MIN
from .described_arm import OF_THE_ARM, DescribedArm, arm_with, blocks_of_the_arm
from .fit import Fit, Nuisance, covariance_of, covariance_root, shares
from .fitter import Fitter
from .outliers import find_outliers
from .prediction_errors import predict
from .setup_mistakes import find_mistake

Floats = npt.NDArray[np.float64]
Held = Sequence[int] | npt.NDArray[np.int64]
POSTURES_MIN = 4  # that must be measured
PRIOR_TYPICALS = 10.0  # sd of the priors, in typical sizes of the parameters
STEPS_MAX = 12  # effects that may join
TRIED_MAX = 2  # effects that are fitted at a step: those that promise most
TURNS_TRIED, TURNS = 3, 25  # of fits that are tried, and of the one that is made
FALL_MIN = 0.005  # of the squared error on left-out postures, for a step to be made at all
JOINING_STEP = 0.02  # typical sizes from which a fit begins, where laws have kinks
TELLS_ITSELF = 1e-3  # share of a reading that the other postures tell, at least


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
        outliers = find_outliers(predict(dataset, robot, catalogue)[0], {})
        self.dataset = outliers.without(dataset) if outliers.any else dataset
        self.predictor = DescribedArm(self.dataset, robot, self.catalogue)
        self.measured = self.dataset.mean
        self.slopes = input_slopes(self.predictor, {})
        self.noise = _noise(self.dataset, self.slopes)
        self.plain = Whitener(self.dataset, self.noise, self.slopes)
        self._refuse_mistakes()
        self.blocks = [*candidates_of(robot, self.catalogue), *blocks_of_the_arm(robot)]

    def _refuse_mistakes(self) -> None:
        markers = self.predictor.markers({})
        mistake = find_mistake(self.predictor, self.plain.floor())
        if mistake is not None and markers is not None:
            raise InputError(f'{self.dataset.name}: {mistake.text(rms(self.measured - markers))}')

    def again(self) -> Stepwise:
        """Return the same with a model of its own, for another thread."""
        other = copy(self)
        other.predictor = DescribedArm(self.dataset, self.robot, self.catalogue)
        return other

    def path(self, held: Held = (), show: Callable[[int], None] | None = None) -> list[State]:
        """Return the states of a search that knows nothing of the postures held; first: bare."""
        whitener = self.weights(self.predictor.markers({}), held)
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
        promising = sorted(self.joining(here), key=lambda pair: pair[0])[:TRIED_MAX]
        found = []
        for _, block in promising:
            blocks, start = (*here.blocks, block), self.beginning(here, block)
            made = self.tried(blocks, start, here.whitener, block.label, TURNS_TRIED)
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
            if self.promise(state, leaves=block) > state.score:
                continue
            rest = tuple(one for one in state.blocks if one is not block)
            point = {f: value for f, value in state.fit.point.items() if f not in block.frees}
            fewer = self.tried(rest, point, state.whitener, state.joined)
            if fewer is not None and fewer.score <= state.score:
                state = replace(fewer, left=(*state.left, block.label))
        return state

    def joining(self, here: State) -> Iterator[tuple[float, Candidate]]:
        """Yield the error that each block promises which may join."""
        own = here.names - set(OF_THE_ARM)
        for block in self.blocks:
            name = block.label
            if name in here.names:
                continue
            if name not in OF_THE_ARM:
                contained = any(name in self.catalogue[other].contains for other in own)
                if contained or set(self.catalogue[name].contains) & own:
                    continue
            promised = self.promise(here, joins=block)
            if promised < here.score:
                yield promised, block

    def promise(
        self,
        state: State,
        joins: Candidate | None = None,
        leaves: Candidate | None = None,
    ) -> float:
        """Return the error [m²] on left-out postures, by slopes, if a block joined or left."""
        residual, jacobian, frees = state.fit.residual, state.fit.jacobian, state.fit.frees
        if joins is not None:
            columns, priors = self.columns(state, joins), _priors(joins.frees)
            below = np.zeros((len(residual) - len(columns), len(priors)))
            beside = np.zeros((len(priors), len(frees)))
            jacobian = np.block([[jacobian, np.vstack([columns, below])], [beside, priors]])
            residual = np.append(residual, np.zeros(len(priors)))
        if leaves is not None:
            own = np.array([free in leaves.frees for free in frees])
            back = np.array([self.described(free) for free in frees]) - state.fit.values
            residual = residual + jacobian[:, own] @ back[own]
            jacobian = jacobian[:, ~own]
        step = covariance_of(jacobian, blind=0.0) @ (jacobian.T @ residual)
        off, groups = residual - jacobian @ step, self.dataset.groups
        return float(np.nanmean(left_out_errors(off, jacobian, state.whitener, groups)))

    def columns(self, state: State, block: Candidate) -> Floats:
        """Return the derivative (N, q) of the whitened residual by the parameters of a block."""
        columns, near, fit = [], self.predictor.settled, state.fit
        for free in block.frees:
            value, step = self.described(free), self.off(free)
            moved = self.predictor.markers({**fit.point, free: value + step}, near=near)
            change = np.zeros_like(fit.markers) if moved is None else moved - fit.markers
            columns.append(-state.whitener.white(change) / step)
        return np.array(columns).T

    def beginning(self, here: State, block: Candidate) -> dict[FreeParameter, float]:
        """Return where a fit begins when a block joins."""
        return here.fit.point | {
            free: self.described(free) + self.off(free) for free in block.frees
        }

    def described(self, free: FreeParameter) -> float:
        """Value in the description, moved inside the bounds of a fit."""
        return float(np.clip(self.predictor.value(free), free.parameter.low, free.parameter.high))

    def off(self, free: FreeParameter) -> float:
        """Return a small step from the described value that stays inside the bounds."""
        step = JOINING_STEP * free.parameter.typical
        return step if self.described(free) + step <= free.parameter.high else -step

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
        priors = [
            Nuisance(f.effect, f, self.described(f), PRIOR_TYPICALS * f.parameter.typical)
            for f in frees
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

    def weights(self, markers: Floats | None, held: Held) -> Whitener:
        """Return weights that know what a prediction does not explain, of likely sizes."""
        assert markers is not None
        off = np.where(self.dataset.counts[..., None] > 0, self.measured - markers, 0.0)
        size = rms(np.delete(self.measured - markers, held, axis=0)) / np.sqrt(3.0)

        def cost(smooth: float, rough: float) -> float:
            made = self._whitener(size, smooth, rough, held)
            white = made.white(off)
            return float(white @ white) + made.log_determinant

        smooth = rough = 0.0
        for _ in range(2):
            smooth, _ = minimum(lambda x, y=rough: cost(x, y), -6.0, 3.0, 0.1)  # type: ignore[misc]
            rough, _ = minimum(lambda x, y=smooth: cost(y, x), -6.0, 3.0, 0.1)  # type: ignore[misc]
        return self._whitener(size, smooth, rough, held)

    def _whitener(self, size: float, smooth: float, rough: float, held: Held) -> Whitener:
        sizes = (size * float(np.exp(smooth)), size * float(np.exp(rough)))
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


def left_out_errors(
    residual: Floats, jacobian: Floats, whitener: Whitener, groups: npt.NDArray[np.int64]
) -> Floats:
    """
    Return the mean squared error (P,) [m²] of each posture predicted from other inputs.

    Exact where the model is linear, the hat matrix H: (1 - H_gg)^-1 r_g (Cook and Weisberg 1982).
    Postures of the same group (P,) tell of each other and are left out together.
    """
    owners, (root, _) = whitener.owners, covariance_root(jacobian)
    errors = np.full(len(groups), np.nan)
    for group in np.unique(groups[owners]):
        rows = np.flatnonzero(groups[owners] == group)
        share, vectors = shares(jacobian[rows] @ root)
        along = vectors.T @ residual[rows]
        told = np.maximum(1.0 - share, TELLS_ITSELF)
        left = residual[rows] + vectors @ (along / told - along)
        for p in np.unique(owners[rows]):
            metres = np.linalg.solve(whitener.root(p), left[owners[rows] == p])
            errors[p] = 3.0 * float(np.mean(metres**2))
    return errors


def _priors(frees: Sequence[FreeParameter]) -> Floats:
    """Return the rows (q, q) that the priors of parameters add to a Jacobian."""
    return np.diag([1.0 / (PRIOR_TYPICALS * free.parameter.typical) for free in frees])


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
