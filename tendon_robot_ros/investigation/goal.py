"""The goal of an investigation, its budget, and its criteria to stop."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from ..common.errors import InputError
from ..common.results import JSON_OPTION
from ..common.words import listed, mm
from ..data import DataSet
from ..diagnosis.result import Diagnosis
from ..diagnosis.verdict import POSTURES_ENOUGH, POSTURES_MIN, SEPARABLE_FROM_SD, Verdict
from ..effects import Catalogue
from ..inference.predict import Predictor, frees_of
from ..inference.statistics import rms


@dataclass(frozen=True)
class Goal:
    """The required accuracy of an investigation, and its budget."""

    interval: float = 0.25  # [1] half a 95 % interval, of the value or of a typical size
    visible: float = 0.015  # [1] tip motion, of the length, that no effect may make unseen
    postures: int = 16  # at most, those of the check apart
    minutes: float = math.inf
    start: int = 4  # postures before the first diagnosis
    at_once: int = 1  # postures between two diagnoses
    trials: int = 3  # of every posture
    checks: int = 3  # fresh postures to verify on
    after_alarm: int = 12  # postures at most that separate what has changed
    # postures more that were skipped than measured: with more, something is wrong with the robot
    skipped: int = 5
    add: bool = False  # write what is found even where the verdict is a class
    tension_max: float = math.inf  # [N] besides the limits of the description
    tracker_noise: float = 2e-4  # [m] to plan with until there are measurements
    effect_files: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        """
        Refuse what cannot be done.

        Raises
        ------
        InputError

        """
        for name, option in OPTIONS.items():
            high = self.postures if name == 'start' else option.high
            if not option.low <= (value := self.typed(name)) <= high:
                expected = f'expected {option.low:g} to {high:g}'
                raise InputError(f'{flag(name)}: {expected}, got {value:g}')

    def typed(self, name: str) -> float:
        """Return a number as it is typed."""
        value: float = getattr(self, name)
        return 100.0 * value if OPTIONS[name].metavar == 'PERCENT' else value


class Option(NamedTuple):
    """A number of a goal on the command line: its limits as typed, its metavar and its help."""

    low: float
    high: float
    metavar: str
    help: str


NARROW = 'half a 95 %% interval that is narrow enough, of the value or of a typical size'
VISIBLE = 'tip motion of the length: adequate is a model when no effect may make more unseen'
OPTIONS = {
    'interval': Option(0.1, 1000.0, 'PERCENT', NARROW),
    'visible': Option(0.01, 100.0, 'PERCENT', VISIBLE),
    'postures': Option(POSTURES_MIN, 1000, 'N', 'at most so many'),
    'start': Option(POSTURES_MIN, 1000, 'N', 'so many before the first diagnosis'),
    'at_once': Option(1, 100, 'N', 'so many between two diagnoses'),
    'trials': Option(1, 100, 'N', 'of every posture'),
    'checks': Option(0, 100, 'N', 'fresh postures to verify on'),
    'minutes': Option(0.01, math.inf, 'M', 'at most so long'),
    'tension_max': Option(1e-6, math.inf, 'N', '[N] besides the limits of the description'),
}


def add_goal(parser: argparse.ArgumentParser, trials: int) -> None:
    """Declare the goal, where results go, and what is kept out; `trials` is the default."""
    add, default = parser.add_argument, Goal(trials=trials)
    add('--output', required=True, metavar='DIR', help='new folder')
    for name, option in OPTIONS.items():
        value = default.typed(name)
        text = option.help + (f' (default: {value:g})' if math.isfinite(value) else '')
        add(flag(name), type=type(value), default=value, metavar=option.metavar, help=text)
    text = 'write what is found though a class or more is left'
    add('--add', action='store_true', help=text)
    add('--resume', action='store_true', help='go on with what DIR has')
    add('--keep-out', metavar='YAML', help='regions where no part of the arm may be')
    add('--json', **JSON_OPTION)


def flag(name: str) -> str:
    """Return the option of a number of a goal."""
    return '--' + name.replace('_', '-')


def goal_of(args: argparse.Namespace, effect_files: tuple[str, ...] = ()) -> Goal:
    """
    Return the goal that was typed.

    Raises
    ------
    InputError

    """
    values = {name: getattr(args, name) for name in OPTIONS}
    percent = {name: values[name] / 100.0 for name in ('interval', 'visible')}
    return Goal(**(values | percent), add=args.add, effect_files=effect_files)


@dataclass(frozen=True)
class Round:
    """One diagnosis during an investigation."""

    postures: int
    verdict: str
    names: list[str]
    in_question: list[str]
    widest: float | None  # half of the widest interval, relative; None: nothing named
    text: str
    possible: dict[str, float] = field(default_factory=dict)  # [m] at the tip, though adequate


REJECTED = 'rejected'  # status of a candidate that is out
# [1] effects that the next posture is chosen for: more would cost a derivative each, and the
# likeliest come first
IN_QUESTION_MAX = 6
NAMING = (Verdict.MISSING_EFFECT, Verdict.WRONG_PARAMETER, Verdict.SEVERAL)
# [1] diagnoses in a row that name the same class before it counts as inseparable; two in a row
# would also come by chance
CLASS_ROUNDS = 3


class InvestigationEnd(StrEnum):
    """Why an investigation ended, and the sentence that says it."""

    sentence: str

    def __new__(cls, name: str, sentence: str) -> InvestigationEnd:
        """Create a row of the table."""
        self = str.__new__(cls, name)
        self._value_, self.sentence = name, sentence
        return self

    NAMED = 'named', 'one name is left, its interval is as narrow as asked'
    INSEPARABLE = 'inseparable', 'no posture within the limits separates what is left'
    ADEQUATE = 'model_adequate', 'the model is adequate'
    OUTSIDE = 'nothing_fits', 'nothing in the catalogue fits'
    MISTAKE = 'mistake_of_the_set_up', 'the set-up has a mistake: mend it, then begin again'
    CHANGED = (
        'change_named',
        'no effect of the catalogue is needed: mend it, or call monitor/learn to take the arm '
        'as it is now',
    )
    BUDGET = 'budget_spent', 'the budget is spent'
    POOL = 'nothing_left_to_measure', 'no posture within the limits tells more'


def names_of(diagnosis: Diagnosis) -> list[str]:
    """Return the names in a diagnosis: effects, or the members of a class."""
    return sorted({*(e.name for e in diagnosis.effects), *diagnosis.cannot_tell_apart})


def in_question(diagnosis: Diagnosis) -> list[str]:
    """
    Return the effects that may still be the cause, the likeliest first.

    Those that are named; then those that fit as well though less likely; while nothing is settled
    (adequate, outside, cannot judge) all that these postures hardly show, too.
    """
    names = [effect.name for effect in diagnosis.effects]
    names += diagnosis.cannot_tell_apart
    likely = [row.name for row in diagnosis.candidates if row.status != REJECTED]
    names += [name for label in likely for name in label.split(' + ')]
    if not diagnosis.effects:
        names += diagnosis.not_tested
    return list(dict.fromkeys(names))[:IN_QUESTION_MAX]


def widest(diagnosis: Diagnosis, catalogue: Catalogue) -> float | None:
    """
    Half of the widest 95 % interval, of the value or of a typical size; None: nothing named.

    That of a component of a force counts relative to the size of the force, whatever the axes.
    """
    halves = []
    for effect in diagnosis.effects:
        parameters = {p.name: p for p in catalogue[effect.name].parameters}
        force = 0.0 if effect.load is None else effect.load.size.value
        for key, value in effect.parameters.items():
            parameter = parameters[key.split('[')[0]]
            size = max(abs(value.value - parameter.neutral), parameter.typical)
            size = max(size, force) if parameter.unit == 'N' else size
            half = 0.5 * (value.high - value.low)
            halves.append(half / size if np.isfinite(half) else np.inf)
    return float(max(halves)) if halves else None


def possible(
    diagnosis: Diagnosis, dataset: DataSet, catalogue: Catalogue, visible: float
) -> dict[str, float]:
    """
    Return the effects that are not excluded where the model is adequate, the largest first.

    An effect may act while an end of a 95 % interval of its parameters, the others at their best
    values, moves the tip by more than is asked, rms over the postures.

    Parameters
    ----------
    diagnosis : Diagnosis
    dataset : DataSet
    catalogue : Catalogue
    visible : float
        Tip motion [m] below which an effect is irrelevant.

    Returns
    -------
    dict of str to float
        Largest tip motion [m] that is not excluded, by effect.

    """
    predictor = Predictor(dataset, dataset.robot, catalogue)
    described = predictor.markers({})
    if described is None or diagnosis.verdict is not Verdict.ADEQUATE:
        return {}
    motions: dict[str, float] = {}
    for row in diagnosis.candidates:
        frees = frees_of(row.name.split(' + '), predictor.model.catalogue, dataset.robot)
        fitted = {f: row.parameters[f.key] for f in frees if f.key in row.parameters}
        best = {free: value.value for free, value in fitted.items()}
        for free, value in fitted.items():
            for end in (value.low, value.high):
                changed = predictor.markers({**best, free: end}) if np.isfinite(end) else None
                if changed is not None:
                    tip = rms((changed - described)[:, -1])
                    motions[row.name] = max(motions.get(row.name, 0.0), tip)
    exceeding = {name: tip for name, tip in motions.items() if tip > visible}
    return dict(sorted(exceeding.items(), key=lambda item: -item[1]))


def settled(diagnosis: Diagnosis, rounds: Sequence[Round], goal: Goal) -> InvestigationEnd | None:
    """
    Return why the investigation ends, None if it goes on; the last round is this diagnosis.

    A verdict counts when the one before, on fewer postures, was the same; a name, or a class,
    when its interval is as narrow as asked. Adequate is the model when no effect is left that may
    move the tip visibly.
    """
    verdict, now = diagnosis.verdict, rounds[-1]
    if verdict is Verdict.CANNOT_JUDGE:
        return InvestigationEnd.MISTAKE if 'mistake' in diagnosis.details else None
    narrow = now.widest is not None and now.widest <= goal.interval
    if verdict in NAMING and not diagnosis.cannot_tell_apart:
        same = [(one.verdict, one.names) == (now.verdict, now.names) for one in rounds[-2:]]
        return InvestigationEnd.NAMED if same == [True, True] and narrow else None
    if verdict is Verdict.ADEQUATE:
        confirmed = twice(verdict, rounds) and not now.possible
        return InvestigationEnd.ADEQUATE if confirmed else None
    if verdict is Verdict.OUTSIDE_CATALOGUE:
        return InvestigationEnd.OUTSIDE if twice(verdict, rounds) else None
    return InvestigationEnd.INSEPARABLE if narrow and _inseparable(diagnosis, rounds) else None


def only_wide(diagnosis: Diagnosis, rounds: Sequence[Round], goal: Goal) -> bool:
    """Return whether an effect or inseparable class is named, and only its interval too wide."""
    now = rounds[-1]
    if now.widest is None or now.widest <= goal.interval:
        return False
    if diagnosis.cannot_tell_apart:
        return _inseparable(diagnosis, rounds)
    named_before = len(rounds) > 1 and rounds[-2].names == now.names
    return diagnosis.verdict in NAMING and (named_before or set(now.in_question) <= set(now.names))


def twice(verdict: Verdict, rounds: Sequence[Round]) -> bool:
    """Return whether the last two diagnoses, on enough postures, came to a verdict."""
    same = [one.verdict == verdict for one in rounds[-2:]] == [True, True]
    return same and rounds[-1].postures >= POSTURES_ENOUGH


def _inseparable(diagnosis: Diagnosis, rounds: Sequence[Round]) -> bool:
    """Return whether a class is inseparable: by any posture, or in three rounds."""
    last = [one.names for one in rounds[-CLASS_ROUNDS:]]
    same = len(last) > 1 and last[-1] == last[-2]
    following = diagnosis.next_measurement
    alike = (
        following is None
        or following.gravity is not None  # the arm would have to be turned
        or following.difference < SEPARABLE_FROM_SD * following.noise
    )
    always = len(last) == CLASS_ROUNDS and all(names == last[0] for names in last)
    return same and (alike or always)


def may_act(now: Round) -> str:
    """Describe the largest effects that are not excluded; '' if there is none."""
    texts = [f'{name} of {mm(tip)} at the tip' for name, tip in now.possible.items()]
    more = f' and {len(texts) - 2} more effects' if len(texts) > 2 else ''
    return f', but not excluded: {", ".join(texts[:2])}{more}' if texts else ''


def short(diagnosis: Diagnosis) -> str:
    """Describe a verdict in a few words."""
    names = names_of(diagnosis)
    if diagnosis.verdict in NAMING:
        return f'consistent with {listed(names)}'
    if diagnosis.cannot_tell_apart and diagnosis.verdict.may_add:
        return f'{listed(diagnosis.cannot_tell_apart, "or")} explain it equally well'
    if not diagnosis.verdict.judged:
        return f'cannot judge: {diagnosis.remainder}'
    return str(diagnosis.verdict).replace('_', ' ')
