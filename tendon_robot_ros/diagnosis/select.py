"""
Selection of effects: fits of every candidate, of pairs and of larger combinations.

All have the same score: deviance plus twice the number of parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..comparison.predict import FreeParameter, Point
from ..comparison.statistics import chi2_sf
from ..effects import Catalogue
from .candidates import Candidate, Ranked
from .fit import Fit
from .fitter import TURN_GAIN_MIN
from .intervals import QUANTILE
from .patterns import Pattern, patterns_of
from .search import LADDER
from .session import Race, Session, better
from .verdict import (
    ALARM_LEVEL,
    APART_FROM_SCORE,
    EFFECTS_MAX,
    FIRST_STEP_GAIN_MIN,
    MISFIT_ALARM_LEVEL,
    NEAR_SCORE,
    P_SINGLE_MIN,
    PAIRED_MAX,
    STRAY_SD_MAX,
)

SAME_EVERYWHERE = ('contact', 'soft_cell', 'taper')  # patterns that a remainder is not
NEUTRAL_LEVEL = 0.05  # of the intervals in which no effect has the value that is described
ROUNDS = 4  # of weights and fits
TURNED_MAX = 3  # best effects whose fits are tried beyond turns of friction
Floats = npt.NDArray[np.float64]


@dataclass
class Evidence:
    """All that the decision looks at."""

    session: Session
    base: Fit
    singles: list[Ranked]
    not_tested: list[Candidate]
    best: Ranked | None = None
    competing: Pattern | None = None
    scale: float = 1.0  # chi² over freedom of the best, where nothing is adequate
    turns: bool = False  # whether a fit was better beyond a turn of friction
    _told: dict[str, Fit] = field(default_factory=dict)

    def told(self, ranked: Ranked) -> Fit:
        """Return the fit whose values are told, and written; see `Fitter.told`."""
        label = ranked.candidate.label
        if label not in self._told:
            self._told[label] = self.session.fitters[0].told(ranked.fit)
        return self._told[label]

    def is_there(self, ranked: Ranked) -> bool:
        """
        Tell whether each effect of a candidate is other than described, by 95 % intervals.

        By that of one of its parameters, or of all of them together. An effect that is always on
        has no absence.
        """
        session, fit = self.session, self.told(ranked)
        for name in ranked.candidate.names:
            if session.catalogue[name].always_on and name not in session.robot.effects:
                continue
            own = [i for i, free in enumerate(fit.frees) if free.effect == name]
            known = fit.told[np.ix_(own, own)] * self.scale
            seen = np.isfinite(np.diag(known)) & (np.diag(known) > 0.0)
            described = np.array([session.predictor.value(fit.frees[i]) for i in own])
            off, known = (fit.values[own] - described)[seen], known[np.ix_(seen, seen)]
            alone = np.abs(off) > QUANTILE * np.sqrt(np.diag(known))
            far = float(off @ np.linalg.pinv(known) @ off)
            if not alone.any() and chi2_sf(far, max(len(off), 1)) > NEUTRAL_LEVEL:
                return False
        return True

    @cached_property
    def patterns(self) -> list[Pattern]:
        """What from outside may compete with the effects, on top of the base."""
        fitters, progress = self.session.fitters, self.session.progress
        return patterns_of(fitters, self.base, progress, turns=self.turns)

    def rivals(self, score: float) -> list[Pattern]:
        """Return the same, but those far behind a score that is far better than the base."""
        known = 'patterns' in self.__dict__ or self.base.deviance < score + NEAR_SCORE
        fitters, progress = self.session.fitters, self.session.progress
        if known:
            return self.patterns
        return patterns_of(fitters, self.base, progress, score, self.turns)


def gather(session: Session) -> Evidence:
    """
    Fit the base and every candidate; weights are taken at the best candidate's fit.

    Twice, and again while it is found beyond a turn of friction: weights there are others.
    """
    session.weigh({})
    base = session.base_fit()
    tested, not_tested = session.split_tested(base.point)
    race = session.race(tested)
    first = session.ranked(race.run())
    singles = over_turns(session, first)
    turns = singles is not first
    for turn in range(ROUNDS):
        if not singles:
            break
        best = session.best(singles)
        far = base.deviance > best.score + NEAR_SCORE
        session.weigh(best.fit.point, best.fit.around)
        near = _followed(session, base) if far else session.base_fit((base, best.fit))
        base = near if far else session.fitters[0].over_turns(near)
        found = session.refit(singles, base)
        singles = over_turns(session, found)
        turns |= singles is not found or base.deviance < near.deviance - TURN_GAIN_MIN
        if turn > 0 and singles is found:
            break
    if not any(r.probability > P_SINGLE_MIN for r in singles):
        singles = _to_their_ends(session, race, singles)  # combinations need them
    evidence = Evidence(session, base, singles, not_tested, turns=turns)
    evidence.best = session.best(singles) if singles else None
    return evidence


def _to_their_ends(session: Session, race: Race, singles: list[Ranked]) -> list[Ranked]:
    """Return candidates with those that were left behind fitted to their ends."""
    left = [fit for _, fit in race.behind()]
    late = {r.candidate.label: r for r in session.ranked(race.go_on())}
    return [
        late.get(r.candidate.label, r) if any(r.fit is fit for fit in left) else r for r in singles
    ]


def _followed(session: Session, base: Fit) -> Fit:
    """Fit no effect again from where it was: it is out of the race."""
    try:
        return session.fitters[0].fit((), base if base.built is not None else None)
    except (ArithmeticError, np.linalg.LinAlgError):  # no equilibrium there
        return session.base_fit()


def over_turns(session: Session, singles: list[Ranked]) -> list[Ranked]:
    """
    Fit again those that are better beyond a turn of friction.

    The best few are looked at; where one of them is better there, all that are near it are tried.
    """
    near = sorted((r for r in singles if r.fit.built is not None), key=lambda r: r.score)
    if not near:
        return singles
    near = [r for r in near if r.score <= near[0].score + NEAR_SCORE]
    fitter, found = session.fitters[0], list[Ranked]()
    for ranked in near[:TURNED_MAX]:
        fit = fitter.over_turns(ranked.fit)
        if fit.deviance < ranked.fit.deviance - TURN_GAIN_MIN:
            found.append(session.rank(ranked.candidate, fit))
    if not found:
        return singles
    there = min(found, key=lambda r: r.score).fit.built
    assert there is not None
    starts = {
        r.candidate.label: replace(
            r.fit, built=replace(r.fit.built, around=there.around, sizes=there.sizes)
        )
        for r in near
        if r.fit.built is not None
    }
    again = session.fit_all([r.candidate for r in near], starts, 'effects again')
    return better(better(singles, again), found)


def is_alarming(evidence: Evidence) -> bool:
    """Tell whether the base model is off: as a whole, beyond a tolerance, or one effect gains."""
    session, base = evidence.session, evidence.base
    level = ALARM_LEVEL if base.built is None else MISFIT_ALARM_LEVEL
    if base.probability(session.freedom) < level:
        return True
    if any(abs(z) > STRAY_SD_MAX for z in base.prior_z.values()):
        return True
    if base.built is not None and outside_by_itself(evidence) is not None:
        return True
    return any(session.stands_out(base, r, len(evidence.singles)) for r in evidence.singles)


def outside_by_itself(evidence: Evidence) -> Pattern | None:
    """Return the pattern from outside that gains more than chance would over no effect, if any."""
    base = evidence.base
    likely = [
        p
        for p in evidence.patterns
        if p.name in SAME_EVERYWHERE and p.gain_p_value(base.deviance) < ALARM_LEVEL
    ]
    return min(likely, key=lambda pattern: pattern.score, default=None)


def competing_pattern(evidence: Evidence, score: float) -> Pattern | None:
    """Return the pattern from outside that beats a score by more than chance would, if any."""
    top = min(evidence.rivals(score), key=lambda pattern: pattern.score, default=None)
    return top if top is not None and top.score < score - APART_FROM_SCORE else None


def several(session: Session, singles: Sequence[Ranked]) -> Ranked | None:
    """
    Search two or three effects that are adequate together: greedy, then pairs and swaps.

    Returns the best combination found, adequate or not; None when nothing could be combined.
    """
    order = sorted(singles, key=lambda r: r.score)
    current: Ranked = order[0]
    best: Ranked | None = None
    for size in range(2, EFFECTS_MAX + 1):
        extended = _extended(session, current)
        if size == 2 and not any(session.holds(f) for f in extended):
            extended += _pairs(session, order[:PAIRED_MAX], current)
        if not extended:
            break
        current = best = min(extended, key=lambda r: r.score)
        if session.holds(best):
            best = _pruned(session, reweighed(session, best))
            if session.holds(best):
                break
    return best


def _pruned(session: Session, ranked: Ranked) -> Ranked:
    """Take out of three effects one that the other two make needless: by it the score falls."""
    while len(ranked.candidate.names) > 2:
        fewer = [ranked.candidate.without(name) for name in ranked.candidate.names]
        starts = {
            c.label: {free: ranked.fit.point[free] for free in c.frees if free in ranked.fit.point}
            for c in fewer
        }
        best = min(session.fit_all(fewer, starts, 'fewer effects'), key=lambda r: r.score)
        if best.score > ranked.score:
            break
        ranked = best
    return ranked


def joined(session: Session, best: Ranked) -> Ranked | None:
    """
    Join a second effect, and a third, to an adequate one while the gain is more than chance would.

    An arm as built may scatter as much as a second effect needs; that it need not is told by the
    likelihood. None where one is enough.
    """
    current = best
    while len(current.candidate.names) < EFFECTS_MAX:
        more = [
            r
            for r in _extended(session, current)
            if session.stands_out(current.fit, r, len(session.candidates))
            and r.score < current.score - APART_FROM_SCORE
        ]
        if not more:
            break
        current = reweighed(session, min(more, key=lambda r: r.score))
    return None if current is best else current


def reweighed(session: Session, ranked: Ranked) -> Ranked:
    """Fit a candidate again with noise and weights taken at its own fit."""
    for _ in range(2):
        session.weigh(ranked.fit.point, ranked.fit.around)
        ranked = session.fit_all([ranked.candidate], {ranked.candidate.label: ranked.fit})[0]
    return ranked


def hints(session: Session, current: Ranked, larger: Candidate) -> bool:
    """
    Tell whether further parameters would gain, by a look at them that costs much less than a fit.

    A first step of each; of an effect whose neutral value is no absence, a ladder of sizes.
    """
    built = current.fit.built
    if session.random is None or built is None:
        return True
    session.fitters[0].resume(current.fit)
    more = [free for free in larger.frees if free not in current.fit.point]
    if any(session.catalogue[free.effect].always_on for free in more):
        return _ladder_hints(session, current, more)
    columns = _first_steps(session, current, more)
    return columns is None or _gain(session, current, {}, columns) > FIRST_STEP_GAIN_MIN


def _gain(
    session: Session, current: Ranked, point: Point, columns: Sequence[Floats] = ()
) -> float:
    """
    Return what the deviance falls by at other values, as far as linear parameters go along.

    Those of the fit, with derivatives as they are there, and more with `columns` (N,).
    """
    random, built = session.random, current.fit.built
    assert random is not None and built is not None
    fitter, n = session.fitters[0], len(random.columns)
    markers = fitter.predictor.markers({**current.fit.point, **point})
    if markers is None:
        return -np.inf
    slopes = current.fit.jacobian[:n, : len(current.fit.all_frees)]
    slopes = np.column_stack([slopes, *(column[:n] for column in columns)])
    estimated = random.estimate(fitter.residual(markers), slopes, built.sizes)
    return float(current.fit.deviance - estimated.deviance)


def _ladder_hints(session: Session, current: Ranked, more: Sequence[FreeParameter]) -> bool:
    """
    Tell whether an effect that is always on may gain at one of a ladder of sizes.

    Nothing but linear parameters follows there, so that it may even look a little worse.
    """
    for factor in LADDER:
        point = {}
        for free in more:
            own = free.parameter
            size = session.predictor.value(free) if own.has_default else factor * own.typical
            point[free] = float(np.clip(size, own.low, own.high))
        if _gain(session, current, point) > -NEAR_SCORE:
            return True
    return False


def _first_steps(
    session: Session, current: Ranked, more: Sequence[FreeParameter]
) -> list[Floats] | None:
    """Return the derivatives (N,) by further parameters; None where one has no equilibrium."""
    predictor, point = session.fitters[0].predictor, current.fit.point
    here, columns = predictor.markers(point), list[Floats]()
    if here is None:
        return columns
    near = predictor.settled
    for free in more:
        value, step = session.predictor.value(free), 0.05 * free.parameter.typical
        if value + step > free.parameter.high:
            step = -step
        moved = predictor.markers({**point, free: value + step}, near=near)
        if moved is None:
            return None
        columns.append(session.whitener.white(here - moved)[:, None] / step)
    return columns


def _extended(session: Session, current: Ranked) -> list[Ranked]:
    """Fit the current effects with each other one whose first step gains."""
    order = [c for c in _extensions(session, current) if hints(session, current, c)]
    starts = {c.label: current.fit for c in order}
    return session.fit_joint(order, starts, f'{len(current.candidate.names) + 1} effects')


def _extensions(session: Session, current: Ranked) -> list[Candidate]:
    """List the current effects with each other one that the postures show there."""
    tested, _ = session.split_tested(current.fit.point)
    have = set(current.candidate.names)
    return [
        current.candidate.with_(c)
        for c in tested
        if not have & set(c.names) and not _overlaps(session.catalogue, c, have)
    ]


def _pairs(session: Session, order: Sequence[Ranked], known: Ranked) -> list[Ranked]:
    """Fit the pairs among the best single effects; those with one of them are known."""
    pairs, starts = [], {}
    order = [r for r in order if r is not known]
    for i, first in enumerate(order):
        for second in order[i + 1 :]:
            pair = first.candidate.with_(second.candidate)
            if _overlaps(session.catalogue, second.candidate, set(first.candidate.names)):
                continue
            pairs.append(pair)
            starts[pair.label] = first.fit
    return session.fit_joint(pairs, starts, 'pairs')


def _overlaps(catalogue: Catalogue, candidate: Candidate, have: set[str]) -> bool:
    """Tell whether a candidate contains, or is contained in, one that is already there."""
    name = candidate.names[0]
    return bool(set(catalogue[name].contains) & have) or any(
        name in catalogue[other].contains for other in have
    )
