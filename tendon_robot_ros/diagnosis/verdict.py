"""
The rule by which a verdict is reached: thresholds, gates, and the table of the verdicts.

`decide` is a pure function of `Evidence`, numbers and names only, and the only place where a
verdict is reached; the reports, the monitor and the live page read sentences and colours from the
table here. A threshold of a single test is defined beside that test: contradicted readings in
inference/outliers.py, the noise of trials in inference/noise.py, drift in monitoring/watch.py.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

from ..inference.statistics import QUANTILE, RARE, SIGNIFICANCE, chi2_isf, chi2_sf, first_of_best
from ..robot.estimates import NOISE_FACTOR

# Significance and likelihood
FALSE_DISCOVERY_RATE = SIGNIFICANCE  # among the places at which the best model is said to be wrong
ALARM_LEVEL = 0.005  # [1] p-value of every alarm, so that measurements of a true model raise few
# [1] p-value of the misfit of an arm as built; lower because its scatter is estimated as well
MISFIT_ALARM_LEVEL = 1e-4
P_SINGLE_MIN = RARE  # p-value of one effect, below which the true one falls
P_SEVERAL_MIN = 0.01  # [1] p-value of several; stricter because two imitate more than one does
# [1] of deviance + 2 k: chi² with two degrees of freedom exceeds it by chance in 1 of 100
APART_FROM_SCORE = 9.21
# [1] of deviance + 2 k, by which one parameter more lowers it by chance in 1 of 20
LIKELIER_FROM_SCORE = chi2_isf(SIGNIFICANCE, 1) - 2.0
EFFECTS_MAX = 3  # [1] together, because more of them fit any dozen of postures
TOLERANCE_SD_MAX = NOISE_FACTOR  # declared sd that a quantity may move
# [1] of the repeatability that may be left; else what accounts for it is said: docs/inference.md
REPEATABILITIES_MAX = 3.0
SAME_ERROR_RATIO = 1.25  # [1] of errors that count as equal, because floors are estimates

# Mistakes of the set-up, and measurements that do not suffice: docs/inference.md
POSTURES_MIN = 3  # [1] because nearly every effect explains two
POSTURES_ENOUGH = 6  # [1] because different causes look alike in fewer
COVERAGE_MIN = 0.9  # [1] of the arm that markers reach, else the rest would pass as measured
ODD_FROM_FLOORS = 10.0  # [1] noise floors of error that call for a mistake: docs/inference.md
QUIET_FLOORS = 5.0  # [1] noise floors that an explanation may leave: docs/inference.md
RESIDUAL_RATIO_USUAL = 0.1  # [1] of the error that a mistake may leave, because no arm is exact
RESIDUAL_RATIO_MAX = 0.3  # [1] of the error that a mistake may leave at most: docs/inference.md
RESIDUAL_PARTLY_MAX = 0.6  # [1] the same where effects act as well: docs/inference.md
PLAIN_FLOORS = 1.2  # [1] usual floors of error after a correction, at most: docs/inference.md
MISTAKEN_RATIO_MIN = 1.9  # [1] because a ratio of two, known to 5 %, is a mistake, no tolerance
MISTAKE_HANDICAP = 6.0  # [1] of score: 2 log 20, because some twenty mistakes are tried

# Reported beside the verdict
PATTERN_GAIN_MIN = 0.33  # [1] of the excess in chi², else the pattern would be a minor part
SEPARABLE_FROM_SD = 2.0  # [1] of a mean, else one more posture would hardly tell two effects


ADD = 'Add it to the robot description: `{command} --add better.yaml`'
CLICK_3 = 'Found. Click 3: the model gets the effect while the arm goes on.'


class Verdict(StrEnum):
    """
    The conclusion of a diagnosis; its value is its name in files and topics.

    Attributes
    ----------
    sentence : str
        Text of the report; `report.diagnosis_text` fills in the names, values and errors.
    colour : str
        Key of `common.colours.KINDS`, of the box around the sentence.
    advice : str
        What to type next where effects were found; `{command}` is the diagnosis itself.
    guide : str
        What to click next on the live page.
    may_add : bool
        Whether its effects are added without the user insisting.
    judged : bool
        Whether effects were judged at all.

    """

    sentence: str
    colour: str
    advice: str
    guide: str
    may_add: bool
    judged: bool

    def __new__(
        cls,
        name: str,
        sentence: str = '',
        colour: str = 'found',
        advice: str = ADD,
        guide: str = CLICK_3,
        may_add: bool = True,
        judged: bool = True,
    ) -> Verdict:
        """Create a row of the table; the defaults are those of effects that were found."""
        self = str.__new__(cls, name)
        self._value_, self.sentence, self.colour, self.advice = name, sentence, colour, advice
        self.guide, self.may_add, self.judged = guide, may_add, judged
        return self

    ADEQUATE = (
        'adequate',
        '{nothing} that {judged_by}.',
        'good',
        '',
        'Nothing is missing that these postures could show. Click 1 to record others.',
        False,
    )
    MISSING_EFFECT = 'missing_effect', '{missing}: {findings}.\nIt explains {share}.{as_written}'
    SEVERAL = 'several', '{missing}: {findings}.\nTogether they explain {share}.{as_written}'
    WRONG_PARAMETER = 'wrong_parameter', '{off}: {findings}{instead}.\n{why_off}{as_written}'
    AMBIGUOUS = (
        'ambiguous',
        '{missing}: one of these, and {these_postures} do not tell which:\n'
        '{alike}\nThe first explains {share}; the others do about as well.',
        'warn',
        'Until that is measured, the first of them will do: `{command} --add better.yaml`',
    )
    OUTSIDE_CATALOGUE = (
        'outside_catalogue',
        '{missing}: something that no known effect describes.\n{what_remains}.',
        'bad',
        'Nothing is added by itself; if part of the way helps: '
        '`{command} --add better.yaml --partial`; several, while the error on left-out postures '
        'falls: `improve`',
        'The catalogue has no name for this cause, so nothing is added. What the remainder looks '
        'like is said below.',
        False,
    )
    CANNOT_JUDGE = (
        'cannot_judge',
        '{obstacle}: {remainder}.',
        'warn',
        '',
        'The recording does not suffice. Click 1 to record again.',
        False,
        False,
    )


Names = tuple[str, ...]


@dataclass(frozen=True)
class Departure:
    """How far the parameters of one effect are from the description."""

    farthest: float  # [sd] of its parameters
    together: float  # chi² of all of them (Wald)
    count: int


@dataclass(frozen=True)
class Hypothesis:
    """A fit of one effect or several, in numbers."""

    names: Names
    score: float  # deviance plus twice the number of parameters
    probability: float = 1.0  # of so large a misfit if it is the truth
    trust: float = 1.0  # probability of predicting left-out postures so much worse than fitted
    misfit: float = 1.0  # chi² over its degrees of freedom
    present: bool = False  # whether the description has them already
    gain_p: float = 1.0  # p-value of its gain, were it the only one


@dataclass(frozen=True)
class Rival:
    """A pattern outside the catalogue, or an effect whose place had to be found, in numbers."""

    name: str
    score: float
    everywhere: bool = True  # whether it is the same in every posture
    gain_p: float = 1.0  # p-value of its gain over the description, and over what it competes with
    placed: Hypothesis | None = None  # the effect of the catalogue that it is, at the place found


@dataclass(frozen=True)
class Evidence:
    """What measurements say, in numbers. None: not yet known, see `Missing`."""

    as_built: bool  # whether imperfections of the arm are estimated
    deviance: float  # -2 log likelihood of the description as it stands
    probability: float  # of so large a misfit if that is the truth
    singles: tuple[Hypothesis, ...]  # of single effects, in the order of the catalogue
    moved: Mapping[str, float] = field(default_factory=dict)  # declared quantity -> its own sd
    twins: Mapping[str, str | None] = field(default_factory=dict)  # -> effect of its influence
    wider: frozenset[Names] | None = None  # contenders that can imitate smaller ones
    departures: Mapping[Names, Sequence[Departure]] = field(default_factory=dict)  # of each effect
    patterns: tuple[Rival, ...] | None = None  # outside the catalogue, or at a place to be found
    rivals: tuple[Rival, ...] | None = None  # those that compete with the best effects
    helpful: tuple[Hypothesis, ...] | None = None  # may be a part of the cause
    further: tuple[Hypothesis, ...] | None = None  # the best one with others of significant gain
    combined: tuple[Hypothesis, ...] | None = None  # the best combination; weights are its own
    swapped: tuple[Hypothesis, ...] | None = None  # it with another effect in place of one


class Missing(LookupError):
    """A part of the evidence that the rule asks for, since others do not decide."""

    def __init__(self, part: str, names: Names = (), score: float = math.inf) -> None:
        """Name the part, of which hypothesis, and the score of those that rivals have to beat."""
        super().__init__(part)
        self.part, self.names, self.score = part, names, score


def known[T](value: T | None, part: str, names: Names = (), score: float = math.inf) -> T:
    """Return a part of the evidence; `Missing` where it is not yet known."""
    if value is None:
        raise Missing(part, names, score)
    return value


@dataclass(frozen=True)
class Conclusion[H, R]:
    """A verdict and its reasons."""

    verdict: Verdict
    chosen: H | None = None  # effects to add
    together: Names = ()  # names that cannot be told apart
    out_of_tolerance: Names = ()  # declared quantities that moved too far
    alike: tuple[H, ...] = ()  # hypotheses that another posture may separate
    rival: R | None = None  # the cause from outside that won
    scale: float = 1.0  # chi² over freedom of the best, where nothing is adequate


Concluded = Conclusion[Hypothesis, Rival]


def is_alarming(evidence: Evidence) -> bool:
    """Return whether the description misfits: as a whole, beyond a tolerance, or by one cause."""
    level = MISFIT_ALARM_LEVEL if evidence.as_built else ALARM_LEVEL
    return (
        evidence.probability < level
        or any(abs(z) > TOLERANCE_SD_MAX for z in evidence.moved.values())
        or any(gains(one.gain_p, len(evidence.singles)) for one in evidence.singles)
        or (evidence.as_built and outside_by_itself(evidence) is not None)
    )


def gains(p_value: float, among: int) -> bool:
    """Return whether a gain is significant among so many."""
    return p_value * among < ALARM_LEVEL


def differs(evidence: Evidence, one: Hypothesis, scale: float = 1.0) -> bool:
    """
    Return whether each effect differs from the description, at 95 %.

    In one of its parameters, or in all together (Wald test); `scale` multiplies the covariance.
    """
    return all(
        own.farthest > QUANTILE * math.sqrt(scale)
        or chi2_sf(own.together / scale, max(own.count, 1)) <= SIGNIFICANCE
        for own in known(evidence.departures.get(one.names), 'departures', one.names)
    )


def outside_by_itself(evidence: Evidence) -> Rival | None:
    """
    Return the best pattern whose gain over no effect is significant, if any.

    An effect whose place had to be found is none where single postures determine it, and has to be
    significant among all, because it is a name.
    """
    everywhere = [one for one in known(evidence.patterns, 'patterns') if one.everywhere]
    return _best_beyond_chance(
        [one for one in everywhere if not one.placed or one.placed.trust > P_SINGLE_MIN],
        len(everywhere),
    )


def _best_beyond_chance(rivals: Sequence[Rival], among: int = 1) -> Rival | None:
    """
    Return the best rival whose gain is significant, if any; of effects at places among so many.

    An effect whose place had to be found does not count beside a pattern that explains as much: a
    force at a free place can imitate a cell that is softer than the others.
    """
    likely = [one for one in rivals if gains(one.gain_p, among if one.placed else 1)]
    limit = min((one.score for one in likely), default=-math.inf) + APART_FROM_SCORE
    patterns = [one for one in rivals if not one.placed and one.gain_p < SIGNIFICANCE]
    near = [one for one in (*patterns, *likely) if one.score <= limit]
    return min(near, key=lambda one: (one.placed is not None, one.score), default=None)


def decide(evidence: Evidence) -> Concluded:
    """
    Conclude what explains the error: nothing, one effect, a class, several, or no effect at all.

    An effect whose place had to be found is named where it beats all others, or alone raises the
    alarm, with all that explain as much; where it is not adequate, it may be a part of the cause.

    Raises
    ------
    Missing
        A part of the evidence is not yet known, and the verdict depends on it.

    """
    said = _without_places(evidence)
    best = None if said.rival is None else said.rival.placed
    if best is None:
        return said
    limit = best.score + APART_FROM_SCORE
    near = _places(evidence, limit)
    if not near:
        return _outside(evidence, best, None)
    alike = [one for one in indistinct(evidence) if one.score <= limit and differs(evidence, one)]
    return _named(evidence, _best_first([*alike, *near]))


def _best_first(group: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Put the best first; among ties it is the first of the catalogue."""
    best = first_of_best(group) if group else None
    return sorted(group, key=lambda one: one is not best)


def _places(evidence: Evidence, score: float) -> list[Hypothesis]:
    """Return the adequate effects whose place had to be found, up to a score."""
    rivals = known(evidence.rivals, 'rivals', score=score)
    every = [one.placed for one in rivals if one.placed is not None]
    near = [one for one in every if one.score <= score and one.probability > P_SINGLE_MIN]
    return [one for one in near if differs(evidence, one)]


def _without_places(evidence: Evidence) -> Concluded:
    """Conclude from the effects that act everywhere, and from patterns."""
    if evidence.combined is not None:
        return _of_several(evidence, evidence.combined)
    if not is_alarming(evidence):
        return Conclusion(Verdict.ADEQUATE)
    near, trials = indistinct(evidence), len(evidence.singles)
    group = [one for one in near if differs(evidence, one)]
    best = group[0] if group else None
    rival = best and _competing(evidence, best.score, best.names)
    if near and not rival and evidence.as_built and not (best and gains(best.gain_p, trials)):
        alone = outside_by_itself(evidence)  # what raised the alarm, the effect would not have
        if alone is not None and (best or alone.placed):
            rival = alone
    if rival:
        return _outside(evidence, best, rival)
    if best is None:
        raise Missing('combined')
    if evidence.as_built:
        for more in known(evidence.further, 'further', best.names):
            if differs(evidence, more):
                return _together(evidence, more)
    return _named(evidence, [*group, *_places(evidence, best.score - LIKELIER_FROM_SCORE)])


def _of_several(evidence: Evidence, combined: Sequence[Hypothesis]) -> Concluded:
    """Decide where no single effect is adequate."""
    holding = [one for one in combined if holds_together(one) and differs(evidence, one)]
    best, rival = [first_of_best(evidence.singles)] if evidence.singles else [], None
    tried = [*combined, *best]
    if tried:
        rival = _competing(evidence, min(one.score for one in tried))
    if holding and rival is None:
        return _together(evidence, holding[0])
    helpful = known(evidence.helpful, 'helpful')
    return _outside(evidence, first_of_best(helpful) if helpful else None, rival)


def _together(evidence: Evidence, best: Hypothesis) -> Concluded:
    """Name several effects, and those that explain as much with another one of them."""
    limit = best.score + APART_FROM_SCORE
    swapped = known(evidence.swapped, 'swapped', best.names)
    near = [one for one in swapped if one.score <= limit and one.probability > P_SINGLE_MIN]
    group = [best, *(one for one in near if differs(evidence, one))]
    if len(group) == 1:
        return Conclusion(Verdict.SEVERAL, best)
    in_all = set(best.names).intersection(*(one.names for one in group))
    names = dict.fromkeys(name for one in group for name in one.names if name not in in_all)
    return Conclusion(Verdict.SEVERAL, best, tuple(names), alike=tuple(group))


def holds_together(one: Hypothesis) -> bool:
    """Return whether several effects are adequate, on left-out postures as well."""
    return one.probability > P_SEVERAL_MIN and one.trust > P_SINGLE_MIN


def contenders(singles: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Return the adequate single effects within `APART_FROM_SCORE` of the best."""
    adequate = [one for one in singles if one.probability > P_SINGLE_MIN]
    top = min((one.score for one in adequate), default=math.inf)
    return [one for one in adequate if one.score <= top + APART_FROM_SCORE]


def indistinct(evidence: Evidence) -> list[Hypothesis]:
    """
    Return the adequate single effects that cannot be told apart, the best first.

    Of the `contenders` a larger one that contains a smaller one drops out; among ties the first of
    the catalogue is best.
    """
    near, wider = contenders(evidence.singles), known(evidence.wider, 'wider')
    return _best_first([one for one in near if one.names not in wider])


def _competing(evidence: Evidence, score: float, names: Names = ()) -> Rival | None:
    """Return the rival beyond chance whose score is much better than that of `names`, if any."""
    top = _best_beyond_chance(known(evidence.rivals, 'rivals', names, score))
    return top if top and top.score < score - APART_FROM_SCORE else None


def _named(evidence: Evidence, group: Sequence[Hypothesis]) -> Concluded:
    """Decide for a class of adequate single effects, best first."""
    best, names = group[0], [one.names[0] for one in group]
    out_of_tolerance = tuple(
        quantity
        for quantity, z in evidence.moved.items()
        if abs(z) > TOLERANCE_SD_MAX and evidence.twins[quantity] in names
    )
    if out_of_tolerance or all(one.present for one in group):
        verdict = Verdict.WRONG_PARAMETER
    else:
        verdict = Verdict.MISSING_EFFECT if len(group) == 1 else Verdict.AMBIGUOUS
    if out_of_tolerance:  # the declared quantity is what moved: its twin is what to add
        twin = evidence.twins[out_of_tolerance[0]]
        best = next(one for one in group if one.names[0] == twin)
    several = len(group) > 1
    together = tuple(names) if several or out_of_tolerance else ()
    return Conclusion(verdict, best, together, out_of_tolerance, tuple(group) if several else ())


def _outside(evidence: Evidence, best: Hypothesis | None, rival: Rival | None) -> Concluded:
    """Nothing in the catalogue is adequate, or something simpler outside it is better."""
    if best is None:
        return Conclusion(Verdict.OUTSIDE_CATALOGUE, rival=rival)
    scale = max(1.0, best.misfit)
    apart = APART_FROM_SCORE * scale
    if not (best.score < evidence.deviance - apart and differs(evidence, best, scale)):
        return Conclusion(Verdict.OUTSIDE_CATALOGUE, rival=rival, scale=scale)
    near = [
        ' + '.join(one.names)
        for one in known(evidence.helpful, 'helpful')
        if one.score <= best.score + apart and one.names != best.names
    ]
    together = (' + '.join(best.names), *near) if near else ()
    return Conclusion(Verdict.OUTSIDE_CATALOGUE, best, together, rival=rival, scale=scale)
