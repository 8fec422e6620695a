"""One data set and description: noise, weights, the base fit, and the fits of all candidates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Self

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError, NoEquilibriumError, Progress, listener
from ..data import DataSet
from ..effects import Catalogue
from ..robot import Robot
from ..robot.estimates import natural_sizes
from .candidates import Candidate, Ranked, candidates_of, is_tested, nuisances_of
from .fit import Fit, Nuisance
from .fitter import FAILURES, GAINS_TO_COME, Descent, Fitter
from .imperfections import REMAINDER, BuiltPredictor, Imperfections, imperfections
from .marginal import RandomEffects
from .noise import VARIANCE_GAIN_MIN, Noise, Whitener, estimate_noise, input_slopes, relative_error
from .outliers import Outliers, find_outliers, without_unsettled
from .predict import CELLS, Point, Predictor
from .repeats import Repeats, repeats
from .statistics import TIE_SCORE, mean_over, minimum

# [1] postures of a long recording that fits use, because a fit takes its time for each, and the
# errors of more are alike
POSTURES_MAX = 100
STEADY_PRECISION = 0.05  # [1] because a dozen postures tell a size to a tenth
NEAR_SCORE = 60.0  # [1] of deviance + 2 k behind the best: docs/inference.md
NOISE_UNKNOWN = (
    'one trial per posture and no position_noise in dataset.yaml: repeat the postures, or declare '
    'the noise of the tracker'
)
Starts = Mapping[str, Fit | Point]


@dataclass(frozen=True)
class Question:
    """What a data set says of a description, before anything is weighed: `weigh`."""

    dataset: DataSet  # that fits use
    robot: Robot
    catalogue: Catalogue  # sized for the robot
    progress: Progress
    recorded: DataSet
    predictor: Predictor
    arm: Predictor  # with imperfections, where the arm has any
    use_accuracy: bool = False
    outliers: Outliers | None = None
    unsettled: tuple[str, ...] = ()  # excluded postures

    @classmethod
    def of(
        cls, dataset: DataSet, robot: Robot, catalogue: Catalogue, progress: Progress | None = None
    ) -> Question:
        """Build the predictors; a long recording is thinned."""
        used, sized = dataset.thinned(POSTURES_MAX), catalogue.sized(natural_sizes(robot))
        made = predictors_of(used, robot, sized)
        return cls(used, robot, sized, listener(progress), dataset, *made)

    def mended(self, dataset: DataSet) -> Question:
        """Return the question of corrected measurements."""
        return Question.of(dataset, dataset.robot, self.catalogue, self.progress)

    def about(self, dataset: DataSet) -> Self:
        """Return the same question of a part of the measurements."""
        predictor, arm = predictors_of(dataset, self.robot, self.catalogue)
        return replace(self, dataset=dataset, predictor=predictor, arm=arm)

    @cached_property
    def nuisances(self) -> list[Nuisance]:
        """Declared tolerances as parameters."""
        return nuisances_of(self.robot, self.catalogue, self.predictor)

    @cached_property
    def candidates(self) -> list[Candidate]:
        """Effects that may be missing."""
        return candidates_of(self.robot, self.catalogue)

    @property
    def whole(self) -> DataSet:
        """The data set, the postures of a long recording included that are not used."""
        return self.recorded if self.dataset.thinned_from else self.dataset

    def prepared(self) -> Session:
        """
        Leave out what has no equilibrium and what other trials contradict, and weigh the rest.

        Raises
        ------
        InputError
            The noise is not known.
        NoEquilibriumError

        """
        return self.settled().weigh().without_outliers()

    def settled(self) -> Question:
        """
        Exclude the few postures in which the description has no equilibrium.

        Raises
        ------
        NoEquilibriumError
            They are many, or one belongs to a sequence, in which the next posture depends on it.

        """
        settled, unsettled = without_unsettled(self.predictor)
        return replace(self.about(settled), unsettled=unsettled) if unsettled else self

    def weigh(self, fit: Fit | None = None) -> Session:
        """
        Estimate the noise and weigh the measurements at a fit; default: as described.

        Imperfections are linearised around those of the fit; the slopes by inputs belong to an
        arm with these, because a kink can reverse the direction of friction.

        Raises
        ------
        InputError
            The noise is not known.
        NoEquilibriumError
            The model has none there.

        """
        arm, point = self.arm, {} if fit is None else fit.point
        around = {} if fit is None else fit.built.around
        near, arm.around = None if fit is None else fit.settled, around
        slopes = input_slopes(arm if around else self.predictor, point, near)
        noise = estimate_noise(self.dataset, slopes)
        if noise is None:
            raise InputError(f'{self.dataset.name}: {NOISE_UNKNOWN}')
        taken = self.dataset.reference
        rough = 0.0 if taken is None else taken.noise
        whitener = Whitener(self.dataset, noise, slopes, self.model_error, rough)
        built = imperfections(arm, point, around, near=near)
        if built is None:
            effects = arm.model.implicit_effects
            raise NoEquilibriumError(f'a posture of {self.dataset.name}', effects, np.inf)
        arm.around = {}
        own = {one.name: getattr(self, one.name) for one in fields(Question)}
        return Session(**own, noise=noise, whitener=whitener, imperfections=built)

    @property
    def model_error(self) -> Floats | float:
        """Return the error [m] of the model, of each posture (P,) or of all, that is known."""
        accuracy = self.dataset.accuracy or 0.0 if self.use_accuracy else 0.0
        reference = self.dataset.reference
        known = self.robot.model_error or 0.0 if reference is None else reference.doubt
        return np.maximum(known, accuracy)

    @property
    def response_error(self) -> float:
        """Return the known error of the model relative to what the tip moves [1]."""
        reference, dataset = self.dataset.reference, self.dataset
        known = self.robot.model_error or 0.0 if reference is None else reference.error
        heights = np.where(dataset.counts.any(axis=0), dataset.arc_lengths, -np.inf)
        return relative_error(known, dataset.mean[:, int(np.argmax(heights))])

    @cached_property
    def described(self) -> tuple[Predictor, Floats | None]:
        """Predictor of the description on the whole data set, and its markers (P, J, 3) [m]."""
        predictor = Predictor(self.whole, self.robot, self.catalogue)
        return predictor, predictor.markers({})


def predictors_of(
    dataset: DataSet, robot: Robot, catalogue: Catalogue
) -> tuple[Predictor, Predictor]:
    """Return a predictor, and one with the imperfections that the arm may have."""
    predictor = Predictor(dataset, robot, catalogue)
    scatters = not robot.exact or robot.tolerances.get(CELLS) or dataset.reference is not None
    return predictor, BuiltPredictor(predictor) if scatters else predictor


@dataclass(frozen=True, kw_only=True)
class Session(Question):
    """Fits of one data set and description, with weights taken at a point."""

    noise: Noise
    whitener: Whitener
    imperfections: Imperfections

    def growing(self, fit: Fit) -> Session:
        """
        Let the remainder grow with the distance from straight, if that is likelier at a fit.

        A model that is wrong by a fraction of what it says is more wrong where the arm bends more.
        """
        if not fit.built.sizes[-1:].any():
            return self
        straight = self.dataset.offsets + self.dataset.arc_lengths[:, None] * [0.0, 0.0, 1.0]
        distances = np.sqrt(np.square(fit.markers - straight).sum(axis=2).mean(axis=1))
        off = self.whitener.white(self.dataset.mean - fit.markers)

        def cost(steady: float) -> float:
            grown = self.imperfections.growing(distances, steady)
            random = RandomEffects.of(grown, self.whitener)
            return random.estimate(off, np.zeros((len(off), 0)), fit.built.sizes).deviance

        steady, least = minimum(cost, 0.0, 1.0, STEADY_PRECISION)
        if cost(1.0) - least < VARIANCE_GAIN_MIN:
            return self
        return replace(self, imperfections=self.imperfections.growing(distances, steady))

    def without_outliers(self) -> Session:
        """Exclude measurements that the other trials contradict, and weigh the others."""
        outliers = find_outliers(self.predictor, {})
        session = replace(self, outliers=outliers)
        return session.about(outliers.without(self.dataset)).weigh() if outliers.any else session

    @cached_property
    def fitter(self) -> Fitter:
        """Fitter with the weights of the session."""
        weights = self.whitener, self.nuisances, self.imperfections
        return Fitter(self.arm, *weights, self.response_error)

    @property
    def random(self) -> RandomEffects:
        """The imperfections, whitened."""
        return self.fitter.random

    def floor_with(self, sizes: Floats) -> float:
        """Return the expected rms [m] of a perfect model, imperfections having the sizes (K,)."""
        built = self.imperfections
        own = np.array([kind.name != REMAINDER for kind in built.kinds], dtype=bool)
        spread = np.where(own, sizes, 0.0)[built.owners]
        lengths = np.linalg.norm(built.moves, axis=3)
        moved = ((spread[:, None, None] * lengths) ** 2).sum(axis=0)
        return float(np.sqrt(self.whitener.floor() ** 2 + moved[self.dataset.counts > 0].mean()))

    @property
    def known_floor(self) -> float:
        """Expected rms [m] of the noise and of the known error of the model together."""
        height = float(self.dataset.arc_lengths.mean()) / self.robot.length
        known = float(np.mean(np.square(self.model_error))) * height
        return float(np.sqrt(self.whitener.floor() ** 2 + known))

    @property
    def usual_floor(self) -> float:
        """Expected rms [m] of a perfect model of an arm with imperfections of plausible sizes."""
        return self.floor_with(self.random.plausible)

    @cached_property
    def repeats(self) -> Repeats | None:
        """How far errors of the description differ at equal inputs; None: not told."""
        whole, (predictor, markers) = self.whole, self.described
        if markers is None or whole.path != 'sequence':
            return None
        variance = Whitener(whole, self.noise, input_slopes(predictor, {})).variance
        noise = 3.0 * np.nan_to_num(mean_over(variance.reshape(len(variance), -1), 1))
        return repeats(whole, whole.mean - markers, noise, POSTURES_MAX)

    def rank(self, candidate: Candidate, fit: Fit) -> Ranked:
        """Return a candidate with its fit, for a ranking."""
        return Ranked(candidate, fit, self.noise.freedom, self.whitener.owners)

    def fit_all(
        self, candidates: Sequence[Candidate], starts: Starts | None = None, what: str = 'effects'
    ) -> list[Ranked]:
        """
        Fit candidates; those without equilibrium drop out.

        `starts`, by label, are fits of the candidates or of a part of their effects. Round by
        round, a fit stops if its score, less its expected further gain, is more than `NEAR_SCORE`
        behind the best one.
        """
        descents, fits, starts = dict[int, Descent](), list[Ranked](), starts or {}
        for i, candidate in enumerate(candidates):
            with suppress(*FAILURES):
                search = self.fitter.search(candidate.frees, starts.get(candidate.label))
                descents[i] = Descent(self.fitter, search)

        def score(i: int) -> float:
            return descents[i].place.deviance + 2.0 * len(candidates[i].frees)

        running = list(descents)
        while running:
            for i in running:
                try:
                    if not descents[i].converged:  # an exact arm's first search was all
                        descents[i].go_on()
                except FAILURES:
                    del descents[i]
            limit = min(map(score, descents), default=np.inf) + NEAR_SCORE
            running = [
                i
                for i, descent in descents.items()
                if i in running
                and not descent.converged
                and score(i) - GAINS_TO_COME * descent.gain <= limit
            ]
            self.progress(what, len(candidates) - len(running), len(candidates))
        for i, descent in descents.items():
            with suppress(*FAILURES):
                fits.append(self.rank(candidates[i], descent.fit()))
        return fits

    def fit_joint(
        self, candidates: Sequence[Candidate], starts: Mapping[str, Fit], what: str
    ) -> list[Ranked]:
        """Fit combinations from fits of a part; the best also from no imperfections."""
        fits = self.fit_all(candidates, starts, what)
        if not self.random.kinds or not fits:
            return fits
        top = min(r.score for r in fits) + NEAR_SCORE
        near = [r.candidate for r in fits if r.score <= top]
        return better(fits, self.fit_all(near, {c.label: starts[c.label].point for c in near}))

    def score(self, score: float) -> float:
        """Return a score that is comparable with other sessions on the same measurements."""
        return score + self.whitener.log_determinant

    def base_fit(self, starts: Sequence[Fit] = ()) -> Fit:
        """
        Fit the declared tolerances and the imperfections alone, also from `starts`.

        Friction is not smooth, so that the result depends on where imperfections start.
        """
        fits = [self.fitter.fit(())]
        for start in starts:
            with suppress(*FAILURES):
                fits.append(self.fitter.fit((), start))
        return min(fits, key=lambda fit: fit.deviance)

    def refit(self, ranked: Sequence[Ranked], base: Fit) -> list[Ranked]:
        """
        Refit candidates; from the base fit, which they contain, where that is better.

        Of an arm as built candidates far from the best are not refitted.
        """
        top = min(r.score for r in ranked) + (NEAR_SCORE if self.random.kinds else np.inf)
        near = [r for r in ranked if r.score <= top]
        starts = {r.candidate.label: r.fit for r in near}
        fits = self.fit_all([r.candidate for r in near], starts, 'effects again')
        worse = [r.candidate for r in fits if r.fit.deviance > base.deviance + TIE_SCORE]
        from_base = self.fit_all(worse, {c.label: base for c in worse}, 'effects again')
        return better(fits, from_base) + [r for r in ranked if r.score > top]

    def tested(self, candidates: Sequence[Candidate], point: Point) -> list[Candidate]:
        """Return the candidates whose effect the postures show at a point."""
        markers, weighed = self.predictor.markers(point), (self.predictor, self.whitener, point)
        if markers is None:
            return []
        near = self.predictor.settled
        return [c for c in candidates if is_tested(c, *weighed, markers, near)]

    def contains(self, large: Ranked, small: Ranked) -> bool:
        """Return whether the larger candidate can imitate the predictions of the smaller one."""
        contained = {within for name in large.names for within in self.catalogue[name].contains}
        if set(small.names) <= contained | set(large.names):
            return True
        if large.fit.rank <= small.fit.rank:
            return False
        fitter = copy(self.fitter)
        fitter.linearise_around({})
        fitter.measured = small.fit.markers  # these were predicted without imperfections
        start, sizes = large.fit.point, small.fit.built.sizes
        return fitter.fit(large.candidate.frees, start, sizes=sizes).chi2 < TIE_SCORE


def better(first: Sequence[Ranked], refitted: Sequence[Ranked]) -> list[Ranked]:
    """Return the better of two fits of every candidate; `refitted` may hold only some."""
    others = {r.candidate.label: r for r in refitted}
    return [min(r, others.get(r.candidate.label, r), key=lambda r: r.fit.deviance) for r in first]
