"""
Selection of effects: fits of every candidate, of pairs and of larger combinations.

All have the same score: deviance plus twice the number of parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..effects import Catalogue
from ..inference.candidates import Candidate, Ranked, gain_p_value, likelihood_ratio_p_value
from ..inference.fit import Fit
from ..inference.fitter import BEST_FEW, FAILURES, REVERSAL_GAIN_MIN, ROUNDS_MAX
from ..inference.predict import Point
from ..inference.search import DIFFERENCE_STEP, LADDER, sized
from ..inference.session import NEAR_SCORE, Question, Session
from ..inference.statistics import first_of_best
from .patterns import Pattern, Patterns
from .placed import fit_placed, ways
from .verdict import (
    ALARM_LEVEL,
    APART_FROM_SCORE,
    EFFECTS_MAX,
    RESIDUAL_RATIO_MAX,
    Conclusion,
    Departure,
    Evidence,
    Hypothesis,
    Missing,
    Names,
    Rival,
    contenders,
    decide,
    gains,
    holds_together,
)

Concluded = Conclusion[Ranked, Pattern]
# [1] of what an effect gains that the `hint` of one as good tells at least: far below 0.84, the
# least of 55 that were measured at half to twice the typical sizes
FIRST_STEP_SHARE_MIN = 0.5


@dataclass
class Fits:
    """Fits from which the verdict follows, with the weights of the session."""

    session: Session
    base: Fit
    singles: list[Ranked]
    not_tested: list[Candidate]
    reversed: bool = False  # whether a fit was better beyond a reversal of friction
    joint: list[Ranked] = field(default_factory=list)  # effects fitted together
    swapped: list[Ranked] = field(default_factory=list)  # with another effect in place of one
    rivals: list[Pattern] = field(default_factory=list)  # that compete with the best effects
    alone: list[Pattern] = field(default_factory=list)  # beside the base
    placed: list[Ranked] | None = None  # effects at places that had to be found
    placed_line: float = -np.inf  # score above which those fits stopped early
    _reported: dict[str, Fit] = field(default_factory=dict)

    @property
    def remembers(self) -> bool:
        """Whether errors at equal inputs differ by more than noise, so that no function fits."""
        repeats = self.session.repeats
        return repeats is not None and repeats.is_told(ALARM_LEVEL)

    def reported(self, ranked: Ranked) -> Fit:
        """Return the fit whose values are reported and written; see `Fitter.for_values`."""
        label = ranked.candidate.label
        if label not in self._reported:
            self._reported[label] = self.session.fitter.for_values(ranked.fit)
        return self._reported[label]

    @property
    def patterns(self) -> list[Pattern]:
        """Patterns outside the catalogue, fitted on top of the base."""
        self.alone = self.alone or self.patterns_on(self.base)
        return self.alone

    def patterns_on(self, fit: Fit, line: float = np.inf) -> list[Pattern]:
        """Return the patterns on top of a fit; see `Patterns`."""
        session = self.session
        return Patterns(session.fitter, fit, line, self.reversed).fitted(session.progress)

    def answer[T](self, rule: Callable[[Evidence], T]) -> T:
        """Return what a rule says; what it asks for is fitted."""
        evidence = self.evidence()
        while True:
            try:
                return rule(evidence)
            except Missing as missing:
                evidence = replace(evidence, **self._found(evidence, missing))

    def judge(self) -> Concluded:
        """Return the conclusion, with the fits behind it."""
        said: Conclusion[Any, Any] = self.answer(decide)
        rivals = {one.name: one for one in (*self.alone, *self.rivals)}
        return replace(
            said,
            chosen=said.chosen and self.fit_of(said.chosen.names),
            alike=tuple(self.fit_of(one.names) for one in said.alike),
            rival=said.rival and rivals[said.rival.name],
        )

    def fit_of(self, names: Names) -> Ranked:
        """Return the fit of effects."""
        return next(r for r in (*self.joint, *self.swapped, *self.every) if r.names == names)

    @property
    def every(self) -> list[Ranked]:
        """Fits of all single effects, those at places that had to be found included."""
        return [*self.singles, *(self.placed or ())]

    def evidence(self) -> Evidence:
        """Return what is known before anything is asked."""
        session, base = self.session, self.base
        twins = {q: twin[0] if (twin := session.catalogue.twin(q)) else None for q in base.prior_z}
        return Evidence(
            base.as_built,
            base.deviance,
            base.probability(session.noise.freedom),
            tuple(map(_numbers, self.singles, gain_p_values(session, base, self.singles))),
            base.prior_z,
            twins,
        )

    def _found(self, known: Evidence, missing: Missing) -> dict[str, Any]:
        """Return a part of the evidence that is missing."""
        session, base, found = self.session, self.base, dict[str, Any]()
        match missing.part:
            case 'wider':
                near = [self.fit_of(one.names) for one in contenders(known.singles)]
                found['wider'] = frozenset(r.names for r in containing(session, near))
            case 'departures':
                told = {missing.names: self.departures(self.fit_of(missing.names))}
                found['departures'] = {**known.departures, **told}
            case 'patterns' | 'rivals' if not self.remembers and self._places(missing.score):
                found |= self._refitted(known)
            case 'patterns':
                found['patterns'] = self._numbers(self.patterns, base)
            case 'rivals' if self.remembers:  # no pattern does
                self.rivals, found['rivals'] = [], ()
            case 'rivals':
                close = base.deviance < missing.score + NEAR_SCORE  # else not fitted to the end
                self.rivals = self.patterns if close else self.patterns_on(base, missing.score)
                over = self.fit_of(missing.names).fit if missing.names else base
                found['rivals'] = self._numbers(self.rivals, over)
            case 'helpful':
                memories = session.catalogue.needing('history')
                own = [one for one in known.singles if memories & set(one.names)]
                found['helpful'] = tuple(own if own and self.remembers else known.singles)
            case 'further':
                self.joint = self._joined(self.fit_of(missing.names))
                found['further'] = tuple(map(_numbers, self.joint))
            case 'swapped':
                self.swapped = swapped(session, self.fit_of(missing.names))
                found['swapped'] = tuple(map(_numbers, self.swapped))
            case 'combined':
                self.session, self.joint = several(session, self.singles)
                if self.joint:
                    found |= self._refitted(known)
                found['combined'] = tuple(map(_numbers, self.joint))
        return found

    def _refitted(self, known: Evidence) -> dict[str, Any]:
        """Refit all with the present weights; return what is known then, of combinations too."""
        session = self.session
        self.base = session.base_fit((self.base,))
        fits = [*self.singles, *self.joint, *(self.placed or ())]
        again = {r.names: r for r in session.refit(fits, self.base)}
        self.singles, self.joint = (
            [again[r.names] for r in own if r.names in again] for own in (self.singles, self.joint)
        )
        if self.placed is not None:
            self.placed = [again[r.names] for r in self.placed if r.names in again]
        self.alone.clear()
        self._reported.clear()
        joint = None if known.combined is None else tuple(map(_numbers, self.joint))
        return vars(self.evidence()) | {'combined': joint}

    def _places(self, score: float) -> bool:
        """
        Fit the effects at places that had to be found; return whether weights are now others.

        They need not be fitted to the end above a score, or where they gain too little. Where one
        is much better than all else, weights are taken at its fit: imperfections move an arm that
        is held somewhere in another way.
        """
        session, base = self.session, self.base
        line = min(base.deviance - APART_FROM_SCORE, score)
        if self.placed is not None and self.placed_line >= line:
            return False
        if self.placed is None:
            self.placed = fit_placed(session, base, line)
        else:  # those that stopped early go on
            starts = {r.candidate.label: r.fit for r in self.placed}
            self.placed = session.fit_all([r.candidate for r in self.placed], starts)
        self.placed_line = line
        line = min(line, *(r.score - APART_FROM_SCORE for r in self.singles))
        best = min(self.placed, key=lambda r: r.score, default=None)
        if best is None or best.score > line:
            return False
        self.placed_line = np.inf
        self.session, refitted = reweighed(session, best)
        self.placed = [refitted, *(r for r in self.placed if r is not best)]
        return True

    def _numbers(self, patterns: Sequence[Pattern], over: Fit) -> tuple[Rival, ...]:
        """
        Return the numbers of patterns, and of the effects at places that had to be found.

        The latter also have to gain significantly over a fit that has fewer parameters.
        """
        session, base = self.session, self.base
        postures = int((session.dataset.trials > 0).sum())
        rivals = [Rival(p.name, p.score, p.everywhere, p.gain_p) for p in patterns]
        placed = self.placed or []
        chances = (gain_p_values(session, one, placed) for one in (base, over))
        for r, by_chance, beside in zip(placed, *chances, strict=True):
            if over.rank < r.fit.rank:
                by_chance = max(by_chance, beside)
            by_chance *= ways(r.names[0], postures)
            rivals.append(Rival(r.names[0], r.score, True, by_chance, _numbers(r)))
        return tuple(rivals)

    def departures(self, ranked: Ranked) -> list[Departure]:
        """
        Return how far each effect of a candidate is from the description.

        At the likeliest sizes of imperfections. An effect that is always on has no neutral value
        to depart from.
        """
        session, fit, departures = self.session, self.reported(ranked), []
        for name in ranked.names:
            if session.catalogue[name].always_on and name not in session.robot.effects:
                continue
            own = [i for i, free in enumerate(fit.frees) if free.effect == name]
            known = fit.covariance[np.ix_(own, own)]
            finite = np.isfinite(np.diag(known)) & (np.diag(known) > 0.0)
            described = np.array([session.predictor.value(fit.frees[i]) for i in own])
            off, known = (fit.values[own] - described)[finite], known[np.ix_(finite, finite)]
            farthest = float((np.abs(off) / np.sqrt(np.diag(known))).max(initial=0.0))
            together = float(off @ np.linalg.pinv(known) @ off)
            departures.append(Departure(farthest, together, len(off)))
        return departures

    def _joined(self, best: Ranked) -> list[Ranked]:
        """
        Add a second effect, and a third, while the gain is significant; empty: one is enough.

        Imperfections may explain as much as a second effect: the likelihood compares both. So may
        deviations of the arm that have changed since an earlier recording.
        """
        current = best
        while len(current.names) < EFFECTS_MAX:
            session, trials = self.session, len(self.session.candidates)
            larger = extended(session, current)
            chances = gain_p_values(session, current.fit, larger)
            if session.dataset.reference is not None:
                beside = beside_deviations(session, current.fit, larger)
                chances = list(map(max, chances, beside))
            more = [
                r
                for r, by_chance in zip(larger, chances, strict=True)
                if gains(by_chance, trials) and r.score < current.score - APART_FROM_SCORE
            ]
            if not more:
                break
            self.session, current = reweighed(self.session, min(more, key=lambda r: r.score))
        return [] if current is best else [current]


def _numbers(ranked: Ranked, gain_p: float = 1.0) -> Hypothesis:
    """Return the numbers of a fit by which it is judged."""
    r = ranked
    return Hypothesis(r.names, r.score, r.probability, r.trust, r.misfit, r.present, gain_p)


def gain_p_values(session: Session, base: Fit, ranked: Sequence[Ranked]) -> list[float]:
    """Return the p-value of each gain, halved where the one parameter has only one side."""

    def chance(fit: Fit) -> float:
        rank = max(fit.rank, 1)
        p_value = gain_p_value(base, session.whitener, fit.deviance, fit.markers, rank)
        return 0.5 * p_value if fit.one_sided else p_value

    return [chance(r.fit) for r in ranked]


def beside_deviations(session: Session, base: Fit, ranked: Sequence[Ranked]) -> list[float]:
    """Return the p-value of each gain, deviations having changed by as much as is allowed."""
    allowed = np.array([kind.allowed for kind in session.imperfections.kinds])

    def chi2(fit: Fit) -> float:
        off = session.whitener.white(session.dataset.mean - fit.markers)
        return session.random.misfit(off, allowed)

    return [
        likelihood_ratio_p_value(chi2(base) - chi2(r.fit), max(r.fit.rank - base.rank, 1))
        for r in ranked
    ]


def gather(question: Question) -> Fits:
    """
    Fit the base and every candidate; weights are taken at the best candidate's fit.

    Twice, and again while that makes its fit likelier or another one is now much better: a fit is
    judged by its own weights. The base is also fitted from beyond reversals of friction.
    """
    session = question.weigh()
    base = session.base_fit()
    tested = session.tested(session.candidates, base.point)
    not_tested = [c for c in session.candidates if c not in tested]
    singles, reversed_once = session.fit_all(tested), False
    for iteration in range(ROUNDS_MAX):
        if not singles:
            break
        best = first_of_best(singles)
        before = session.score(best.score)
        far = base.deviance > best.score + NEAR_SCORE
        session = session.weigh(best.fit).growing(best.fit)
        if far:  # it cannot win: one start is enough
            try:
                base = session.fitter.fit((), base)
            except FAILURES:
                base = session.base_fit()
        else:
            base = session.base_fit((base, best.fit))
        singles = session.refit(singles, base)
        if iteration == 0:
            continue
        if not far:
            near, base = base, session.fitter.over_reversals(base)
            if base.deviance < near.deviance - REVERSAL_GAIN_MIN:
                singles, reversed_once = session.refit(singles, base), True
        own = min((r.score for r in singles if r.names == best.names), default=np.inf)
        likelier = session.score(own) < before - REVERSAL_GAIN_MIN
        beaten = own > first_of_best(singles).score + APART_FROM_SCORE
        if not (likelier or beaten):
            break
    return Fits(session, base, singles, not_tested, reversed_once)


def several(session: Session, singles: Sequence[Ranked]) -> tuple[Session, list[Ranked]]:
    """
    Search two or three effects that are adequate together: greedy, then pairs and swaps.

    Returns the best combination, adequate or not, with weights taken there if it is; empty when
    nothing could be combined.
    """
    order, best = sorted(singles, key=lambda r: r.score), list[Ranked]()
    current = order[:1]
    for size in range(2, EFFECTS_MAX + 1) if order else ():
        more = extended(session, current[0])
        enough = session.dataset.thinned_from or any(holds_together(_numbers(f)) for f in more)
        if size == 2 and not enough:
            more += _pairs(session, order[1 : 2 * BEST_FEW + 1])
        if not more:
            break
        current = best = [min(more, key=lambda r: r.score)]
        if holds_together(_numbers(best[0])):
            session, reached = reweighed(session, best[0])
            best = [_pruned(session, reached)]
            if holds_together(_numbers(best[0])):
                break
    return session, best


def swapped(session: Session, best: Ranked) -> list[Ranked]:
    """
    Fit several effects with another one in place of each, as far as these may do as well.

    One whose first step gains less than half of what it has to is not fitted. Where more
    parameters stay undetermined than before, two of the effects do the same.
    """

    def undetermined(ranked: Ranked) -> int:
        return len(ranked.fit.frees) - ranked.fit.rank

    point, larger = best.fit.point, list[Candidate]()
    others = [c for c in session.tested(session.candidates, point) if c.names[0] not in best.names]
    for fewer in _with_fewer(session, best):
        needed = fewer.fit.deviance - best.fit.deviance
        least = FIRST_STEP_SHARE_MIN * needed - NEAR_SCORE
        for c in others:
            if not overlaps(session.catalogue, c.names[0], fewer.names):
                both = fewer.candidate.with_(c)
                if hint(session, fewer, both).gain > least:
                    larger.append(both)
    starts: dict[str, Fit | Point] = {
        c.label: {free: point[free] for free in c.frees if free in point} for c in larger
    }
    starts[best.candidate.label] = best.fit
    fits = session.fit_all([best.candidate, *larger], starts, 'other effects')
    near = [
        r
        for r in fits
        if r.score <= best.score + APART_FROM_SCORE and undetermined(r) <= undetermined(best)
    ]
    wider = containing(session, near)
    return [r for r in near if r.names != best.names and r not in wider]


def containing(session: Session, near: Sequence[Ranked]) -> list[Ranked]:
    """Return the candidates that can imitate another one of them."""
    return [r for r in near if any(r is not s and session.contains(r, s) for s in near)]


def _pruned(session: Session, ranked: Ranked) -> Ranked:
    """Remove one of three effects while the score falls by that."""
    while len(ranked.names) > 2:
        best = min(_with_fewer(session, ranked), key=lambda r: r.score)
        if best.score > ranked.score:
            break
        ranked = best
    return ranked


def _with_fewer(session: Session, ranked: Ranked) -> list[Ranked]:
    """Fit all but each one of several effects, from the values that they have together."""
    fewer, point = [ranked.candidate.without(name) for name in ranked.names], ranked.fit.point
    starts = {c.label: {f: point[f] for f in c.frees if f in point} for c in fewer}
    return session.fit_all(fewer, starts, 'fewer effects')


def reweighed(session: Session, ranked: Ranked) -> tuple[Session, Ranked]:
    """Refit a candidate with noise and weights taken at its own fit."""
    for _ in range(2):
        session = session.weigh(ranked.fit).growing(ranked.fit)
        ranked = session.fit_all([ranked.candidate], {ranked.candidate.label: ranked.fit})[0]
    return session, ranked


@dataclass(frozen=True)
class Hint:
    """What further parameters promise, told without a fit."""

    gain: float  # of the deviance, above what is worth a fit
    columns: list[Floats]  # whitened changes (N,) of the markers, per unit or at a size


def hint(session: Session, current: Ranked, larger: Candidate) -> Hint:
    """
    Estimate what further parameters may gain, which is much cheaper than a fit.

    By one linearised step of each; of an effect that remembers, which is another function of the
    path for every size, by the best of several, with the other parameters adjusted linearly, so
    that its deviance may even rise a bit.
    """
    fitter, point = session.fitter, current.fit.point
    fitter.resume(current.fit)
    more = [free for free in larger.frees if free not in point]
    value, near = session.predictor.value, fitter.predictor.settled
    markers, columns = fitter.predictor.markers(point, near=near), list[Floats]()
    near = fitter.predictor.settled
    remembers = bool(session.catalogue.needing('history') & {free.effect for free in more})
    steps = {free: free.parameter.step(value(free), DIFFERENCE_STEP) for free in more}
    moves = [({free: value(free) + step}, step) for free, step in steps.items()]
    if remembers:
        predictor = session.predictor
        moves = [({free: sized(free, f, predictor) for free in more}, 1.0) for f in LADDER]
    gains = [-np.inf]
    for sizes, unit in moves:
        moved = fitter.predictor.markers({**point, **sizes}, near=near)
        if moved is not None and markers is not None:
            columns.append(session.whitener.white(markers - moved) / unit)
            if remembers:
                gains.append(_gain(session, current, moved) + NEAR_SCORE)
        elif not remembers:
            return Hint(np.inf, [])
    if not remembers and markers is not None:
        gains.append(_gain(session, current, markers, columns) - 0.5 * APART_FROM_SCORE)
    return Hint(max(gains), columns)


def is_hopeless(session: Session, current: Ranked, hints: Iterable[Hint]) -> bool:
    """
    Return whether even all effects at once leave most of the error of a fit, to first order.

    Of the error beyond noise. Most: more than what a fit of the right ones would leave because the
    effects are not linear.
    """
    fitter, n = session.fitter, session.whitener.size
    fitter.resume(current.fit)
    markers = fitter.predictor.markers(current.fit.point, near=fitter.predictor.settled)
    if markers is None:
        return False
    residual = fitter.residual(markers)
    more = (column for hint in hints for column in hint.columns)
    columns = np.column_stack([current.fit.slopes, *more])
    rest = residual - columns @ np.linalg.lstsq(columns, residual)[0]
    left, error = rest @ rest - n + columns.shape[1], residual @ residual - n
    return bool(left > RESIDUAL_RATIO_MAX**2 * error)


def _gain(
    session: Session, current: Ranked, markers: Floats, columns: Sequence[Floats] = ()
) -> float:
    """
    Return the fall of the deviance at predicted markers (P, J, 3), linear parameters adjusted.

    These are the parameters of the fit, by its Jacobian, and further ones by `columns` (N,).
    """
    slopes, sizes = np.column_stack([current.fit.slopes, *columns]), current.fit.built.sizes
    estimated = session.random.estimate(session.fitter.residual(markers), slopes, sizes)
    return float(current.fit.deviance - estimated.deviance)


def extended(session: Session, current: Ranked) -> list[Ranked]:
    """
    Fit the current effects with each other one that passes the tests of visibility and gain.

    Of a long recording with the few that promise most; with none where all would not suffice.
    """
    larger = [
        current.candidate.with_(c)
        for c in session.tested(session.candidates, current.fit.point)
        if not set(current.names) & set(c.names)
        and not overlaps(session.catalogue, c.names[0], current.names)
    ]
    order, is_long = larger, bool(session.dataset.thinned_from)
    if session.random.kinds or is_long:
        hints = {c.label: hint(session, current, c) for c in larger}
        order = [c for c in larger if hints[c.label].gain > 0.0]
        if is_long and is_hopeless(session, current, hints.values()):
            return []
        if is_long:  # many measurements tell the best few by their gains
            order = sorted(order, key=lambda c: -hints[c.label].gain)[:BEST_FEW]
    starts = {c.label: current.fit for c in order}
    return session.fit_joint(order, starts, f'{len(current.names) + 1} effects')


def _pairs(session: Session, order: Sequence[Ranked]) -> list[Ranked]:
    """Fit the pairs among good single effects."""
    pairs, starts = [], {}
    for i, first in enumerate(order):
        for second in order[i + 1 :]:
            if not overlaps(session.catalogue, second.names[0], first.names):
                pairs.append(first.candidate.with_(second.candidate))
                starts[pairs[-1].label] = first.fit
    return session.fit_joint(pairs, starts, 'pairs')


def overlaps(catalogue: Catalogue, name: str, others: Collection[str]) -> bool:
    """Return whether an effect contains, or is contained in, one of the others."""
    within = any(name in catalogue[other].contains for other in others)
    return within or not set(catalogue[name].contains).isdisjoint(others)
