"""
Selection of effects: fits of every candidate, of pairs and of larger combinations.

All have the same score: deviance plus twice the number of parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..common.arrays import Floats
from ..comparison.predict import Point
from ..comparison.statistics import chi2_sf
from .candidates import Candidate, Ranked
from .fit import Fit
from .fitter import FAILURES, REVERSAL_GAIN_MIN, ROUNDS_MAX
from .intervals import QUANTILE
from .patterns import Pattern, patterns_of
from .search import DIFFERENCE_STEP, LADDER
from .session import Session, better
from .verdict import (
    APART_FROM_SCORE,
    BEST_FEW,
    EFFECTS_MAX,
    NEAR_SCORE,
    P_SINGLE_MIN,
    SIGNIFICANCE,
)


@dataclass(frozen=True)
class Evidence:
    """All that the verdict looks at, with the weights that the session has."""

    session: Session
    base: Fit
    singles: list[Ranked]
    not_tested: list[Candidate]
    reversed: bool = False  # whether a fit was better beyond a reversal of friction
    _reported: dict[str, Fit] = field(default_factory=dict)

    @property
    def best(self) -> Ranked | None:
        """The best single effect."""
        return self.session.best(self.singles) if self.singles else None

    def reported(self, ranked: Ranked) -> Fit:
        """Return the fit whose values are reported, and written; see `Fitter.for_values`."""
        label = ranked.candidate.label
        if label not in self._reported:
            self._reported[label] = self.session.fitters[0].for_values(ranked.fit)
        return self._reported[label]

    def is_there(self, ranked: Ranked, scale: float = 1.0) -> bool:
        """
        Tell whether each effect of a candidate is other than described, by 95 % intervals.

        By that of one of its parameters, or of all of them together; `scale` is of the
        covariance. An effect that is always on has no absence.
        """
        session, fit = self.session, self.reported(ranked)
        for name in ranked.names:
            if session.catalogue[name].always_on and name not in session.robot.effects:
                continue
            own = [i for i, free in enumerate(fit.frees) if free.effect == name]
            known = fit.interval_covariance[np.ix_(own, own)] * scale
            seen = np.isfinite(np.diag(known)) & (np.diag(known) > 0.0)
            described = np.array([session.predictor.value(fit.frees[i]) for i in own])
            off, known = (fit.values[own] - described)[seen], known[np.ix_(seen, seen)]
            alone = np.abs(off) > QUANTILE * np.sqrt(np.diag(known))
            far = float(off @ np.linalg.pinv(known) @ off)
            if not alone.any() and chi2_sf(far, max(len(off), 1)) > SIGNIFICANCE:
                return False
        return True

    def stands_out(self, ranked: Ranked) -> bool:
        """Tell whether an effect gains more than the best of all would by chance."""
        return self.session.stands_out(self.base, ranked, len(self.singles))

    @cached_property
    def patterns(self) -> list[Pattern]:
        """What from outside may compete with the effects, on top of the base."""
        return self.patterns_on(self.base)

    def rivals(self, score: float) -> list[Pattern]:
        """Return the same, but those far behind a score that is far better than the base."""
        if self.base.deviance < score + NEAR_SCORE:
            return self.patterns
        return self.patterns_on(self.base, score)

    def patterns_on(self, fit: Fit, line: float = np.inf) -> list[Pattern]:
        """Return what from outside competes on top of a fit; see `patterns_of`."""
        session = self.session
        return patterns_of(session.fitters, fit, session.progress, line, self.reversed)

    def joined(self, best: Ranked) -> Ranked | None:
        """
        Join a second effect, and a third, while the gain is more than chance would bring.

        An arm as built may scatter as much as a second effect needs; that it need not is told by
        the likelihood. None where one is enough.
        """
        session, current = self.session, best
        while len(current.names) < EFFECTS_MAX:
            more = [
                r
                for r in extended(session, current)
                if session.stands_out(current.fit, r, len(session.candidates))
                and r.score < current.score - APART_FROM_SCORE
            ]
            if not more:
                break
            current = reweighed(session, min(more, key=lambda r: r.score))
        return None if current is best else current

    def combined(self) -> tuple[Evidence, Ranked | None]:
        """Return the best combination, and the evidence weighed at it."""
        session = self.session
        combined = several(session, self.singles) if self.singles else None
        if combined is None:
            return self, None
        base = session.base_fit((self.base,))
        singles = session.refit(self.singles, base)
        return Evidence(session, base, singles, self.not_tested, self.reversed), combined


def gather(session: Session) -> Evidence:
    """
    Fit the base and every candidate; weights are taken at the best candidate's fit.

    Twice, and again while it is better beyond a reversal of friction: weights there are others.
    """
    session.weigh({})
    base = session.base_fit()
    tested, not_tested = session.split_tested(base.point)
    race = session.race(tested)
    first = [session.rank(*one) for one in race.run()]
    singles = over_reversals(session, first)
    reversed_once = singles is not first
    for turn in range(ROUNDS_MAX):
        if not singles:
            break
        best = session.best(singles)
        far = base.deviance > best.score + NEAR_SCORE
        session.weigh(best.fit.point, best.fit.built.around)
        if far:  # it is out of the race: from where it was is enough
            try:
                base = session.fitters[0].fit((), base if base.as_built else None)
            except FAILURES:
                base = session.base_fit()
        else:
            near = session.base_fit((base, best.fit))
            base = session.fitters[0].over_reversals(near)
            reversed_once |= base.deviance < near.deviance - REVERSAL_GAIN_MIN
        again = session.refit(singles, base)
        singles = over_reversals(session, again)
        reversed_once |= singles is not again
        if turn > 0 and singles is again:
            break
    if not any(r.probability > P_SINGLE_MIN for r in singles):  # combinations need their ends
        left = [fit for _, fit in race.behind()]
        late = {candidate.label: session.rank(candidate, fit) for candidate, fit in race.go_on()}
        singles = [
            late.get(r.candidate.label, r) if any(r.fit is fit for fit in left) else r
            for r in singles
        ]
    return Evidence(session, base, singles, not_tested, reversed_once)


def over_reversals(session: Session, singles: list[Ranked]) -> list[Ranked]:
    """
    Fit again those that are better beyond a reversal of friction.

    The best few are looked at; where one of them is better there, all that are near it are tried.
    """
    near = sorted((r for r in singles if r.fit.as_built), key=lambda r: r.score)
    if not near:
        return singles
    near = [r for r in near if r.score <= near[0].score + NEAR_SCORE]
    fitter, beyond = session.fitters[0], list[Ranked]()
    for ranked in near[:BEST_FEW]:
        fit = fitter.over_reversals(ranked.fit)
        if fit.deviance < ranked.fit.deviance - REVERSAL_GAIN_MIN:
            beyond.append(session.rank(ranked.candidate, fit))
    if not beyond:
        return singles
    there = min(beyond, key=lambda r: r.score).fit.built
    starts = {
        r.candidate.label: replace(
            r.fit, built=replace(r.fit.built, around=there.around, sizes=there.sizes)
        )
        for r in near
    }
    again = session.fit_all([r.candidate for r in near], starts, 'effects again')
    return better(better(singles, again), beyond)


def several(session: Session, singles: Sequence[Ranked]) -> Ranked | None:
    """
    Search two or three effects that are adequate together: greedy, then pairs and swaps.

    Returns the best combination, adequate or not; None when nothing could be combined.
    """
    order = sorted(singles, key=lambda r: r.score)
    current: Ranked = order[0]
    best: Ranked | None = None
    for size in range(2, EFFECTS_MAX + 1):
        more = extended(session, current)
        if size == 2 and not any(session.holds(f) for f in more):
            more += _pairs(session, order[1 : 2 * BEST_FEW + 1])
        if not more:
            break
        current = best = min(more, key=lambda r: r.score)
        if session.holds(best):
            best = _pruned(session, reweighed(session, best))
            if session.holds(best):
                break
    return best


def _pruned(session: Session, ranked: Ranked) -> Ranked:
    """Take out of three effects one that the other two make needless: by it the score falls."""
    while len(ranked.names) > 2:
        fewer = [ranked.candidate.without(name) for name in ranked.names]
        starts = {
            c.label: {free: ranked.fit.point[free] for free in c.frees if free in ranked.fit.point}
            for c in fewer
        }
        best = min(session.fit_all(fewer, starts, 'fewer effects'), key=lambda r: r.score)
        if best.score > ranked.score:
            break
        ranked = best
    return ranked


def reweighed(session: Session, ranked: Ranked) -> Ranked:
    """Fit a candidate again with noise and weights taken at its own fit."""
    for _ in range(2):
        session.weigh(ranked.fit.point, ranked.fit.built.around)
        ranked = session.fit_all([ranked.candidate], {ranked.candidate.label: ranked.fit})[0]
    return ranked


def hints(session: Session, current: Ranked, larger: Candidate) -> bool:
    """
    Tell whether further parameters would gain, by a test that costs much less than a fit.

    A first step of each; of an effect whose neutral value is no absence a ladder of sizes, where
    nothing but linear parameters follows, so that it may even look a little worse.
    """
    if not session.random.kinds:
        return True
    fitter, point = session.fitters[0], current.fit.point
    fitter.resume(current.fit)
    more = [free for free in larger.frees if free not in point]
    value = session.predictor.value
    if any(session.catalogue[free.effect].always_on for free in more):
        for factor in LADDER:
            sizes = {}
            for free in more:
                own = free.parameter
                size = value(free) if own.has_default else factor * own.typical
                sizes[free] = float(np.clip(size, own.low, own.high))
            if _gain(session, current, sizes) > -NEAR_SCORE:
                return True
        return False
    here, columns = fitter.predictor.markers(point), list[Floats]()
    near = fitter.predictor.settled
    for free in more:
        step = DIFFERENCE_STEP * free.parameter.typical
        if value(free) + step > free.parameter.high:
            step = -step
        moved = fitter.predictor.markers({**point, free: value(free) + step}, near=near)
        if here is None or moved is None:
            return True
        columns.append(session.whitener.white(here - moved)[:, None] / step)
    return _gain(session, current, {}, columns) > 0.5 * APART_FROM_SCORE


def _gain(
    session: Session, current: Ranked, point: Point, columns: Sequence[Floats] = ()
) -> float:
    """
    Return what the deviance falls by at other values, as far as linear parameters go along.

    Those of the fit, with derivatives as they are there, and more with `columns` (N,).
    """
    fitter, n = session.fitters[0], session.whitener.size
    markers = fitter.predictor.markers({**current.fit.point, **point})
    if markers is None:
        return -np.inf
    slopes = current.fit.jacobian[:n, : len(current.fit.all_frees)]
    slopes = np.column_stack([slopes, *(column[:n] for column in columns)])
    sizes = current.fit.built.sizes
    estimated = session.random.estimate(fitter.residual(markers), slopes, sizes)
    return float(current.fit.deviance - estimated.deviance)


def extended(session: Session, current: Ranked) -> list[Ranked]:
    """Fit the current effects with each other one that the postures show, and that hints at it."""
    tested, _ = session.split_tested(current.fit.point)
    larger = [
        current.candidate.with_(c)
        for c in tested
        if not set(current.names) & set(c.names) and not _overlaps(session, c, current.names)
    ]
    order = [c for c in larger if hints(session, current, c)]
    starts = {c.label: current.fit for c in order}
    return session.fit_joint(order, starts, f'{len(current.names) + 1} effects')


def _pairs(session: Session, order: Sequence[Ranked]) -> list[Ranked]:
    """Fit the pairs among good single effects."""
    pairs, starts = [], {}
    for i, first in enumerate(order):
        for second in order[i + 1 :]:
            if not _overlaps(session, second.candidate, first.names):
                pairs.append(first.candidate.with_(second.candidate))
                starts[pairs[-1].label] = first.fit
    return session.fit_joint(pairs, starts, 'pairs')


def _overlaps(session: Session, candidate: Candidate, have: Sequence[str]) -> bool:
    """Tell whether a candidate contains, or is contained in, one that is already there."""
    name, catalogue = candidate.names[0], session.catalogue
    return bool(set(catalogue[name].contains) & set(have)) or any(
        name in catalogue[other].contains for other in have
    )
