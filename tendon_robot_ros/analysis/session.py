"""One diagnosis at work: noise, weights, base fit, and the fits of all candidates."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ..data import DataSet
from ..effects import Catalogue
from ..robot import Robot
from .candidates import (
    CONTAINS,
    Candidate,
    Ranked,
    candidates_of,
    gain_probability,
    is_tested,
    nuisances_of,
)
from .cells import cell_slopes
from .fit import Fit
from .noise import Noise, Whitener, estimate_noise, input_slopes
from .predict import Point, Predictor
from .search import Fitter

SINGLE, SEVERAL = 0.001, 0.01  # p-values above which one effect, or several, are adequate
APART = 9.21  # chi² + 2 k within which candidates cannot be told apart
SAME = 0.5  # chi² below which two predictions are the same
TIE = 0.5  # chi² + 2 k below which the order of the catalogue decides
Progress = Callable[[str, int, int], None]


class Session:
    """Fits of one data set and description; weights move to the best candidate's fit."""

    def __init__(
        self,
        dataset: DataSet,
        robot: Robot,
        catalogue: Catalogue,
        workers: int = 2,
        progress: Progress | None = None,
    ) -> None:
        """Build a predictor per worker."""
        self.dataset, self.robot, self.catalogue = dataset, robot, catalogue
        self.workers = max(1, workers)
        self.progress = progress or (lambda what, done, total: None)
        self.predictors = [Predictor(dataset, robot, catalogue) for _ in range(self.workers)]
        self.predictor = self.predictors[0]
        self.nuisances = nuisances_of(robot, catalogue, self.predictor)
        self.candidates = candidates_of(robot, catalogue)
        self.accuracy = dataset.accuracy or 0.0
        self.use_accuracy = False
        self.noise: Noise | None = None

    def weigh(self, point: Point) -> bool:
        """Estimate the noise and set the weights at a point; False: nothing tells the noise."""
        slopes = input_slopes(self.predictor, point)
        self.noise = estimate_noise(self.dataset, slopes)
        if self.noise is None:
            return False
        self.whitener = Whitener(
            self.dataset, self.noise, slopes, self.accuracy if self.use_accuracy else 0.0
        )
        changes = cell_slopes(self.predictor, self.nuisances, point)
        self._columns = {free: -self.whitener.white(change) for free, change in changes.items()}
        self.fitters = [self.fitter(predictor) for predictor in self.predictors]
        return True

    def fitter(self, predictor: Predictor) -> Fitter:
        """Return a fitter with the weights of now."""
        return Fitter(predictor, self.whitener, self.nuisances, self._columns)

    @property
    def freedom(self) -> float:
        """Degrees of freedom behind the noise."""
        assert self.noise is not None
        return self.noise.freedom

    def rank(self, candidate: Candidate, fit: Fit) -> Ranked:
        """Judge a fit."""
        return Ranked(
            candidate, fit, fit.probability(self.freedom), *fit.held_out(self.whitener.owners)
        )

    def fit_all(
        self,
        candidates: Sequence[Candidate],
        starts: Mapping[str, Point] | None = None,
        what: str = 'effects',
    ) -> list[Ranked]:
        """Fit candidates, spread over the workers; those without equilibrium drop out."""
        found: list[Ranked | None] = [None] * len(candidates)
        done = 0

        def work(worker: int) -> None:
            nonlocal done
            for i in range(worker, len(candidates), self.workers):
                candidate = candidates[i]
                start = None if starts is None else starts.get(candidate.label)
                try:
                    fit = self.fitters[worker].fit(candidate.frees, start)
                except (ArithmeticError, np.linalg.LinAlgError):
                    continue
                finally:
                    done += 1
                    self.progress(what, done, len(candidates))
                found[i] = self.rank(candidate, fit)

        if self.workers == 1 or len(candidates) == 1:
            for worker in range(self.workers):
                work(worker)
        else:
            with ThreadPoolExecutor(self.workers) as pool:
                list(pool.map(work, range(self.workers)))
        return [ranked for ranked in found if ranked is not None]

    def holds(self, ranked: Ranked) -> bool:
        """Tell whether several effects are adequate, for left-out postures as well."""
        return ranked.probability > SEVERAL and ranked.trust > SINGLE

    def base_fit(self) -> Fit:
        """Fit the declared tolerances alone."""
        return self.fitters[0].fit(())

    def split_tested(self, point: Point) -> tuple[list[Candidate], list[Candidate]]:
        """Split the candidates into those that these postures show at a point, and the rest."""
        here = self.predictor.markers(point)
        tested = [
            c
            for c in self.candidates
            if here is not None and is_tested(c, self.predictor, self.whitener, point, here)
        ]
        return tested, [c for c in self.candidates if c not in tested]

    def luck(self, base: Fit, ranked: Ranked) -> float:
        """Chance of a candidate's gain by luck."""
        described = [self.predictor.value(free) for free in ranked.candidate.frees]
        return gain_probability(base, ranked.fit, described)

    def best(self, ranked: Sequence[Ranked]) -> Ranked:
        """Return the best by score; within a tie the first of the catalogue."""
        top = min(r.score for r in ranked)
        return next(r for r in ranked if r.score <= top + TIE)


def indistinct(session: Session, ranked: Sequence[Ranked], gate: float) -> list[Ranked]:
    """
    Return the adequate candidates that cannot be told apart, the best first.

    Within chi² + 2 k of 9.21 of the best; a larger candidate that contains a smaller one of the
    class drops out; among ties the first of the catalogue is best.
    """
    adequate = [r for r in ranked if r.probability > gate]
    top = min(r.score for r in adequate)
    near = [r for r in adequate if r.score <= top + APART]
    kept = [
        r
        for r in near
        if not any(small is not r and contains(session, r, small) for small in near)
    ]
    best = session.best(kept)
    return sorted(kept, key=lambda r: r is not best)


def contains(session: Session, large: Ranked, small: Ranked) -> bool:
    """Tell whether the larger candidate can predict just what the smaller one predicts here."""
    if small.candidate.names[0] in CONTAINS.get(large.candidate.names[0], ()):
        return True
    if set(small.candidate.names) < set(large.candidate.names):
        return True
    if large.fit.rank <= small.fit.rank:
        return False
    fitter = session.fitter(session.predictor)
    fitter.measured = small.fit.markers
    mimic = fitter.fit(large.candidate.frees, large.fit.point)
    return mimic.chi2 < SAME


def several(session: Session, singles: Sequence[Ranked]) -> Ranked | None:
    """
    Search two or three effects that are adequate together: greedy, then pairs and swaps.

    Returns the best combination found, adequate or not; None when nothing could be combined.
    """
    order = sorted(singles, key=lambda r: r.score)
    current: Ranked = order[0]
    best: Ranked | None = None
    for size in (2, 3):
        found = _extended(session, current)
        if not found:
            break
        if size == 2 and not any(session.holds(f) for f in found):
            found += _pairs(session, order[:7], {f.candidate.label for f in found})
        current = best = min(found, key=lambda r: r.score)
        if session.holds(best):
            best = reweighed(session, best)
            if session.holds(best):
                break
    return best


def reweighed(session: Session, ranked: Ranked) -> Ranked:
    """Fit a candidate again with noise and weights taken at its own fit."""
    for _ in range(2):
        session.weigh(ranked.fit.point)
        ranked = session.fit_all([ranked.candidate], {ranked.candidate.label: ranked.fit.point})[0]
    return ranked


def _extended(session: Session, current: Ranked) -> list[Ranked]:
    """Fit the current effects with each other one that the postures show there."""
    tested, _ = session.split_tested(current.fit.point)
    have = set(current.candidate.names)
    combined = [
        current.candidate.with_(c)
        for c in tested
        if not have & set(c.names) and not _overlaps(c, have)
    ]
    starts = {c.label: current.fit.point for c in combined}
    return session.fit_all(combined, starts, f'{len(have) + 1} effects')


def _pairs(session: Session, order: Sequence[Ranked], known: set[str]) -> list[Ranked]:
    """Fit the pairs among the best single effects that are not fitted yet."""
    pairs, starts = [], {}
    for i, first in enumerate(order):
        for second in order[i + 1 :]:
            pair = first.candidate.with_(second.candidate)
            names = set(pair.names)
            if any(set(label.split(' + ')) == names for label in known) or _overlaps(
                second.candidate, set(first.candidate.names)
            ):
                continue
            pairs.append(pair)
            starts[pair.label] = first.fit.point
    return session.fit_all(pairs, starts, 'pairs')


def _overlaps(candidate: Candidate, have: set[str]) -> bool:
    """Tell whether a candidate contains, or is contained in, one that is already there."""
    name = candidate.names[0]
    return bool(set(CONTAINS.get(name, ())) & have) or any(
        name in CONTAINS.get(other, ()) for other in have
    )
