"""What a diagnosis gathers before it decides: fits of the base model and of every candidate."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..comparison.statistics import chi2_sf
from .candidates import Candidate, Ranked
from .decide import (
    ALARM_LEVEL,
    APART_FROM_SCORE,
    MISFIT_ALARM_LEVEL,
    NEAR_SCORE,
    NOISE_WITHIN_FLOORS,
    P_SINGLE_MIN,
    PATTERN_SHARE_MIN,
    STRAY_SD_MAX,
    Verdict,
)
from .fit import Fit
from .fitter import TURN_GAIN_MIN
from .interval import QUANTILE
from .load import load_of
from .patterns import Pattern, patterns_of
from .race import Race
from .session import Session, better

SAME_EVERYWHERE = ('contact', 'soft_cell', 'taper')  # patterns that a remainder is not

NEUTRAL_LEVEL = 0.05  # of the intervals in which no effect has the value that is described
ROUNDS = 4  # of weights and fits
TURNED_MAX = 3  # best effects whose fits are tried beyond turns of friction
TELLING_RATIO = 1.25  # up to which a cell bends by so many per cent more, not times as much


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


# -----------------------------------------------------------------------------
# What remains unexplained, in plain words from the patterns that fit it.


def remainder_text(
    evidence: Evidence, chosen: Ranked | None, verdict: Verdict, left: float
) -> str:
    """Say that so much [m] remains after the chosen effects (or none), and what it looks like."""
    session = evidence.session
    fit = chosen.fit if chosen else evidence.base
    floor = session.whitener.floor()
    is_noise = left < NOISE_WITHIN_FLOORS * floor
    text = f'What is left ({1e3 * left:.2f} mm) ' + (
        f'equals your repeatability ({1e3 * floor:.2f} mm).'
        if is_noise
        else f'is {left / floor:.1f} times your repeatability ({1e3 * floor:.2f} mm).'
    )
    if session.brief and verdict is Verdict.OUTSIDE_CATALOGUE:
        return text
    if verdict is not Verdict.OUTSIDE_CATALOGUE:
        built = session.random is not None and not is_noise
        return f'{text} How an arm is built accounts for that: see its scatter.' if built else text
    pattern = evidence.competing or best_pattern(evidence, chosen)
    return (
        f'{text} {pattern_text(evidence, pattern)}'
        if pattern
        else f'{text} {_worst(evidence, fit)}'
    )


def best_pattern(evidence: Evidence, chosen: Ranked | None) -> Pattern | None:
    """Return the pattern that takes a third or more of what is left, if there is one."""
    fit = evidence.base if chosen is None else chosen.fit
    fitters, turns = evidence.session.fitters, evidence.turns
    patterns = evidence.patterns if chosen is None else patterns_of(fitters, fit, turns=turns)
    top = min(patterns, key=lambda pattern: pattern.score, default=None)
    excess = fit.chi2 - fit.freedom
    if top is None or fit.deviance - top.deviance < PATTERN_SHARE_MIN * excess:
        return None
    return top


def _much(ratio: float) -> str:
    """Say 'twice as much as' or '4 % more than'."""
    if TELLING_RATIO > ratio > 1.0 / TELLING_RATIO:
        way = 'more' if ratio > 1.0 else 'less'
        return f'{100.0 * abs(ratio - 1.0):.2g} % {way} than'
    return f'{ratio:.1f} times as much as'


def pattern_text(evidence: Evidence, pattern: Pattern) -> str:
    """Describe a pattern so that a person knows where to look."""
    names = evidence.session.dataset.postures
    if pattern.name == 'contact':
        angle = load_of(pattern.values).from_axis
        way = '' if angle is None else f", {np.degrees(angle.value):.0f}° from the arm's axis"
        return (
            f'The remainder looks like a force of {1e3 * pattern.size:.2g} mN{way}, at cell '
            f'{pattern.cell}, the same in every posture: does a cable pull there, or something '
            'touch?'
        )
    if pattern.name == 'soft_cell':
        return (
            f'The remainder is the same in every posture: cell '
            f'{" or ".join(map(str, pattern.alike))} bends {_much(pattern.size)} it should. '
            'Look at that cell.'
        )
    if pattern.name == 'taper':
        way = 'stiffer' if pattern.size > 0.0 else 'softer'
        return (
            f'The remainder is the same in every posture: the arm is {way} towards the tip, '
            f'by {100.0 * abs(pattern.size):.0f} % from base to tip.'
        )
    values = np.array(pattern.values)
    worst = names[int(np.argmax(np.abs(values)))]
    if pattern.name == 'gain_per_posture':
        return (
            f'The remainder looks like tensions that were not what was set: by '
            f'{100.0 * np.std(values):.1f} % (sd) from posture to posture, most in {worst}. '
            'Check how tensions are set, or declare tension_noise: setting.'
        )
    return (
        'The remainder looks like a base that turns from posture to posture: by '
        f'{np.degrees(np.max(np.abs(values))):.1f}° in {worst}. Check the mount.'
    )


def _worst(evidence: Evidence, fit: Fit) -> str:
    dataset = evidence.session.dataset
    distance = np.linalg.norm(dataset.mean - fit.markers, axis=2)
    posture, marker = np.unravel_index(np.nanargmax(distance), distance.shape)
    return (
        f'No pattern fits it. It is largest in posture {dataset.postures[posture]} at marker '
        f'{dataset.markers[marker].name} ({1e3 * distance[posture, marker]:.1f} mm).'
    )
