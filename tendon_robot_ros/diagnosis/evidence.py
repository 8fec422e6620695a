"""What a diagnosis gathers before it decides: fits of the base model and of every candidate."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from .candidates import Candidate, Ranked
from .decide import (
    ALARM_LEVEL,
    APART_FROM_SCORE,
    MISFIT_ALARM_LEVEL,
    NEAR_SCORE,
    NOISE_WITHIN_FLOORS,
    PATTERN_SHARE_MIN,
    STRAY_SD_MAX,
    TIE_WITHIN_SCORE,
    Verdict,
)
from .fit import Fit
from .load import load_of
from .patterns import Pattern, Patterns
from .session import Session, better

SAME_EVERYWHERE = ('contact', 'soft_cell', 'taper')  # patterns that a remainder is not

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
    _told: dict[str, Fit] = field(default_factory=dict)

    def told(self, ranked: Ranked) -> Fit:
        """Return the fit whose values are told, and written; see `Fitter.told`."""
        label = ranked.candidate.label
        if label not in self._told:
            self._told[label] = self.session.fitters[0].told(ranked.fit)
        return self._told[label]

    @cached_property
    def patterns(self) -> list[Pattern]:
        """What from outside may compete with the effects, on top of the base."""
        return Patterns(self.session.fitters[0], self.base).all(self.session.progress)


def gather(session: Session) -> Evidence:
    """Fit the base and every candidate; weights are taken twice at the best candidate's fit."""
    session.weigh({})
    base = session.base_fit()
    tested, not_tested = session.split_tested(base.point)
    singles = session.fit_all(tested)
    for _ in range(2):
        if not singles:
            break
        singles = over_turns(session, singles)
        best = session.best(singles)
        session.weigh(best.fit.point, best.fit.around)
        base = session.fitters[0].over_turns(session.base_fit((base, best.fit)))
        singles = session.refit(singles, base)
    evidence = Evidence(session, base, singles, not_tested)
    evidence.best = session.best(singles) if singles else None
    return evidence


def over_turns(session: Session, singles: list[Ranked]) -> list[Ranked]:
    """Fit again where the best is better beyond a turn of friction: all that are near it."""
    best = session.best(singles)
    there = session.fitters[0].over_turns(best.fit)
    if there.built is None or there.deviance > best.fit.deviance - TIE_WITHIN_SCORE:
        return singles
    beyond = {'around': there.built.around, 'sizes': there.built.sizes}
    starts = {
        r.candidate.label: replace(r.fit, built=replace(r.fit.built, **beyond))
        for r in singles
        if r.fit.built is not None and r.score <= best.score + NEAR_SCORE
    }
    again = [r.candidate for r in singles if r.candidate.label in starts]
    found = session.fit_all(again, starts, 'effects again')
    return better(better(singles, found), [session.rank(best.candidate, there)])


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
    top = min(evidence.patterns, key=lambda pattern: pattern.score, default=None)
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
    fit, patterns = evidence.base, evidence.patterns
    if chosen is not None:
        fit, patterns = chosen.fit, Patterns(evidence.session.fitters[0], chosen.fit).all()
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
