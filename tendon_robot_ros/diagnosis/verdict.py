"""
The rule by which a verdict is reached: thresholds, gates, and the table of the verdicts.

`decide` is a pure function of the evidence, and the only place where a verdict is reached; the
reports, the monitor and the live page read sentences and colours from the table here. A threshold
of a single test is defined beside that test: contradicted readings in inference/outliers.py, the
noise of trials in inference/noise.py, drift in monitoring/watch.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from ..inference.statistics import RARE, SIGNIFICANCE
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
        colour: str = '',
        advice: str = '',
        guide: str = '',
        may_add: bool = False,
        judged: bool = True,
    ) -> Verdict:
        """Create a row of the table."""
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
    )
    MISSING_EFFECT = (
        'missing_effect',
        '{missing}: {findings}.\nIt explains {share}.{as_written}',
        'found',
        ADD,
        CLICK_3,
        True,
    )
    SEVERAL = (
        'several',
        '{missing}: {findings}.\nTogether they explain {share}.{as_written}',
        'found',
        ADD,
        CLICK_3,
        True,
    )
    WRONG_PARAMETER = (
        'wrong_parameter',
        '{off}: {findings}{instead}.\n{why_off}{as_written}',
        'found',
        ADD,
        CLICK_3,
        True,
    )
    AMBIGUOUS = (
        'ambiguous',
        '{missing}: one of these, and {these_postures} do not tell which:\n'
        '{alike}\nThe first explains {share}; the others do about as well.',
        'warn',
        'Until that is measured, the first of them will do: `{command} --add better.yaml`',
        CLICK_3,
        True,
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


class Hypothesis(Protocol):
    """The part of a fit of effects that the rule reads."""

    @property
    def names(self) -> tuple[str, ...]:
        """Effects."""

    @property
    def present(self) -> bool:
        """Whether the description has them already."""

    @property
    def probability(self) -> float:
        """Chance of so large a misfit if it is the truth."""

    @property
    def trust(self) -> float:
        """Chance of predicting left-out postures so much worse than fitted ones if it is."""

    @property
    def score(self) -> float:
        """Deviance plus twice the number of parameters."""

    @property
    def misfit(self) -> float:
        """Chi² over its degrees of freedom."""


class Rival(Protocol):
    """The part of a pattern outside the catalogue that the rule reads."""

    @property
    def everywhere(self) -> bool:
        """Whether the pattern is the same in every posture."""

    @property
    def score(self) -> float:
        """Deviance plus twice the number of parameters."""

    def gain_p_value(self, deviance: float) -> float:
        """P-value of the gain over a deviance without the pattern."""


class Described(Protocol):
    """The part of the fit of the unchanged description that the rule reads."""

    @property
    def as_built(self) -> bool:
        """Whether imperfections of the arm are estimated."""

    @property
    def deviance(self) -> float:
        """-2 log likelihood of the measurements."""

    @property
    def prior_z(self) -> Mapping[str, float]:
        """Change of each declared quantity, in its declared standard deviations [1]."""

    def probability(self, noise_freedom: float) -> float:
        """Chance of so large a misfit if it is the truth."""


class Weighing[H](Protocol):
    """Comparison of hypotheses."""

    @property
    def freedom(self) -> float:
        """Degrees of freedom behind the noise."""

    @property
    def brief(self) -> bool:
        """Whether the remainder is not described where no effect explains the data."""

    def best(self, ranked: Sequence[H]) -> H:
        """Return the best by score; within a tie the first of the catalogue."""

    def contains(self, large: H, small: H) -> bool:
        """Return whether a candidate can imitate the predictions of a smaller one."""

    def twin_of(self, quantity: str) -> str | None:
        """Return the effect with the same influence as a declared quantity."""


class Facts[H, R](Protocol):
    """Evidence on a data set; expensive parts are computed on first access."""

    @property
    def session(self) -> Weighing[H]:
        """Comparison of hypotheses."""

    @property
    def base(self) -> Described:
        """Fit of the unchanged description."""

    @property
    def singles(self) -> Sequence[H]:
        """Single effects."""

    @property
    def best(self) -> H | None:
        """The best of them."""

    @property
    def helpful(self) -> Sequence[H]:
        """Those that may be a part of the cause: where errors differ at equal inputs, memories."""

    @property
    def patterns(self) -> Sequence[R]:
        """Patterns outside the catalogue."""

    def rivals(self, score: float) -> Sequence[R]:
        """Return the patterns outside the catalogue, except those far behind a score."""

    def gain_is_significant(self, ranked: H) -> bool:
        """Return whether its gain is significant, the number of candidates considered."""

    def differs(self, ranked: H, scale: float = 1.0) -> bool:
        """Return whether each of its effects differs significantly from the description."""

    def joined(self, best: H) -> H | None:
        """Add effects while the gain of each is significant; None where one is enough."""

    def combined(self) -> tuple[Facts[H, R], H | None]:
        """Return the best combination, and the facts with weights taken at its fit."""


@dataclass(frozen=True)
class Conclusion[H, R]:
    """A verdict and its reasons."""

    verdict: Verdict
    chosen: H | None = None  # effects to add
    together: tuple[str, ...] = ()  # names that cannot be told apart
    out_of_tolerance: tuple[str, ...] = ()  # declared quantities that moved too far
    alike: tuple[H, ...] = ()  # hypotheses that another posture may separate
    rival: R | None = None  # the cause from outside that won
    scale: float = 1.0  # chi² over freedom of the best, where nothing is adequate


def is_alarming[H, R: Rival](facts: Facts[H, R]) -> bool:
    """Return whether the description misfits: as a whole, beyond a tolerance, or by one cause."""
    level = MISFIT_ALARM_LEVEL if facts.base.as_built else ALARM_LEVEL
    return (
        facts.base.probability(facts.session.freedom) < level
        or any(abs(z) > TOLERANCE_SD_MAX for z in facts.base.prior_z.values())
        or (facts.base.as_built and outside_by_itself(facts) is not None)
        or any(facts.gain_is_significant(ranked) for ranked in facts.singles)
    )


def outside_by_itself[H, R: Rival](facts: Facts[H, R]) -> R | None:
    """Return the best pattern whose gain over no effect is significant, if any."""
    likely = [
        rival
        for rival in facts.patterns
        if rival.everywhere and rival.gain_p_value(facts.base.deviance) < ALARM_LEVEL
    ]
    return min(likely, key=lambda rival: rival.score, default=None)


def decide[H: Hypothesis, R: Rival](facts: Facts[H, R]) -> tuple[Facts[H, R], Conclusion[H, R]]:
    """
    Conclude what explains the error: nothing, one effect, a class, several, or no effect at all.

    Returns
    -------
    facts
        Those behind the decision: with a combination the measurements are weighed at its fit.
    decision : Conclusion

    """
    if not is_alarming(facts):
        return facts, Conclusion(Verdict.ADEQUATE)
    group = [r for r in indistinct(facts.session, facts.singles) if facts.differs(r)]
    if group:
        rival = _competing(facts.rivals(group[0].score), group[0].score)
        if rival is None and facts.base.as_built and not facts.gain_is_significant(group[0]):
            alone = outside_by_itself(facts)  # what raised the alarm, the effect would not have
            rival = alone if alone is not None and alone.score < group[0].score else None
        if rival is not None:
            return facts, _outside(facts, group[0], rival)
        more = facts.joined(group[0]) if facts.base.as_built else None
        if more is not None and facts.differs(more):
            return facts, Conclusion(Verdict.SEVERAL, more)
        return facts, _named(facts, group)
    facts, combined = facts.combined()
    holds = combined is not None and holds_together(combined) and facts.differs(combined)
    scores = [r.score for r in (combined, facts.best) if r is not None]
    rival = None
    if scores and (holds or not facts.session.brief):
        rival = _competing(facts.rivals(min(scores)), min(scores))
    if combined is not None and holds and rival is None:
        return facts, Conclusion(Verdict.SEVERAL, combined)
    helpful = facts.session.best(facts.helpful) if facts.helpful else None
    return facts, _outside(facts, helpful, rival)


def holds_together(hypothesis: Hypothesis) -> bool:
    """Return whether several effects are adequate, on left-out postures as well."""
    return hypothesis.probability > P_SEVERAL_MIN and hypothesis.trust > P_SINGLE_MIN


def indistinct[H: Hypothesis](session: Weighing[H], ranked: Sequence[H]) -> list[H]:
    """
    Return the adequate single effects that cannot be told apart, the best first.

    Those within `APART_FROM_SCORE` of the best; a larger candidate that contains a smaller one of
    the class drops out; among ties the first of the catalogue is best.
    """
    adequate = [r for r in ranked if r.probability > P_SINGLE_MIN]
    if not adequate:
        return []
    top = min(r.score for r in adequate)
    near = [r for r in adequate if r.score <= top + APART_FROM_SCORE]
    kept = [
        r for r in near if not any(small is not r and session.contains(r, small) for small in near)
    ]
    best = session.best(kept)
    return sorted(kept, key=lambda r: r is not best)


def _competing[R: Rival](rivals: Sequence[R], score: float) -> R | None:
    """Return the pattern whose score is significantly better than a given one, if any."""
    top = min(rivals, key=lambda rival: rival.score, default=None)
    return top if top is not None and top.score < score - APART_FROM_SCORE else None


def _named[H: Hypothesis, R](facts: Facts[H, R], group: Sequence[H]) -> Conclusion[H, R]:
    """Decide for a class of adequate single effects, best first."""
    best, names = group[0], [r.names[0] for r in group]
    twins = {quantity: facts.session.twin_of(quantity) for quantity in facts.base.prior_z}
    out_of_tolerance = tuple(
        quantity
        for quantity, z in facts.base.prior_z.items()
        if abs(z) > TOLERANCE_SD_MAX and twins[quantity] in names
    )
    if out_of_tolerance or all(r.present for r in group):
        verdict = Verdict.WRONG_PARAMETER
    else:
        verdict = Verdict.MISSING_EFFECT if len(group) == 1 else Verdict.AMBIGUOUS
    if out_of_tolerance:  # the declared quantity is what moved: its twin is what to add
        best = next(r for r in group if r.names[0] == twins[out_of_tolerance[0]])
    several = len(group) > 1
    together = tuple(names) if several or out_of_tolerance else ()
    return Conclusion(verdict, best, together, out_of_tolerance, tuple(group) if several else ())


def _outside[H: Hypothesis, R](
    facts: Facts[H, R], best: H | None, rival: R | None
) -> Conclusion[H, R]:
    """Nothing in the catalogue is adequate, or something simpler outside it is better."""
    if best is None:
        return Conclusion(Verdict.OUTSIDE_CATALOGUE, rival=rival)
    scale = max(1.0, best.misfit)
    apart = APART_FROM_SCORE * scale
    if not (best.score < facts.base.deviance - apart and facts.differs(best, scale)):
        return Conclusion(Verdict.OUTSIDE_CATALOGUE, rival=rival, scale=scale)
    near = [
        ' + '.join(r.names)
        for r in facts.helpful
        if r.score <= best.score + apart and r is not best
    ]
    together = (' + '.join(best.names), *near) if near else ()
    return Conclusion(Verdict.OUTSIDE_CATALOGUE, best, together, rival=rival, scale=scale)
