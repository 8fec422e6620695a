"""
The loop: choose the posture that tells most, measure it, diagnose, until enough is known.

After a drift alarm the first postures are those that tell the change most (`changed.py`).
It ends when one name is left with an interval as narrow as asked, when what is left cannot be
separated, when the model is adequate, when nothing in the catalogue fits, or when the budget is
spent. Then what was found is verified on postures that were never chosen for it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.words import digits, listed
from ..comparison.noise import Noise
from ..comparison.predict import FreeParameter, frees_of
from ..data import DataSet
from ..diagnosis.add import Addition, add_effects
from ..diagnosis.diagnose import diagnose
from ..diagnosis.result import Diagnosis
from ..diagnosis.verdict import Verdict
from ..effects import Catalogue, Effect, load_catalogue
from ..model.model import Model
from ..monitoring.change import ChangeFinder
from ..report.diagnosis_page import with_effects
from ..robot import Robot
from ..robot.estimates import natural_sizes
from ..robot.keep_out import KeepOut
from .arm import MeasurableArm
from .changed import look_after, no_effect
from .choice import MARGIN_SHARE, Choice, OpenQuestion, Room, choose, fresh, pool
from .goal import (
    IN_QUESTION_MAX,
    POSTURES_MANY,
    SENTENCES,
    Goal,
    InvestigationEnd,
    adequate_again,
    in_question,
    may_act,
    names_of,
    only_wide,
    possible,
    settled,
    short,
    widest,
)
from .measuring import Measurer, News, Tell
from .record import CHECK, Record, Round, empty_dataset, with_posture

Floats = npt.NDArray[np.float64]
GAIN_MIN = 0.02  # [nat] below which a posture tells nothing
NARROWING_MIN = 0.5  # [nat] below which it hardly narrows what may act unseen


@dataclass(frozen=True)
class Findings:
    """What an investigation came to."""

    outcome: InvestigationEnd
    diagnosis: Diagnosis | None
    dataset: DataSet
    record: Record
    made: Addition | None = None  # fitted, and its error on fresh postures
    check: DataSet | None = None

    @property
    def may_add(self) -> bool:
        """Whether the description that was made is worth writing without asking."""
        return self.outcome is InvestigationEnd.NAMED and self.made is not None and self.made.helps


class Investigation:
    """One investigation of an arm."""

    def __init__(
        self,
        arm: MeasurableArm,
        goal: Goal,
        folder: Path | None = None,
        regions: KeepOut | None = None,
        tell: Tell = lambda news: None,
        resume: bool = False,
        change: ChangeFinder | None = None,
    ) -> None:
        """
        Begin, or go on with what a folder has.

        Parameters
        ----------
        arm : MeasurableArm
        goal : Goal
        folder : Path, optional
            Where it is written, after every posture.
        regions : KeepOut, optional
            Where no part of the arm may be.
        tell : callable, optional
            Hears what happens.
        resume : bool
        change : ChangeFinder, optional
            What a drift alarm knows: it is looked after first.

        Raises
        ------
        InputError

        """
        self.arm, self.goal, self.tell, self.change = arm, goal, tell, change
        self.catalogue: Catalogue = load_catalogue(goal.effect_files).sized(
            natural_sizes(arm.robot)
        )
        trials = goal.trials if arm.path == 'from_straight' else 1
        begin = Record.resume if resume and folder is not None else Record.begin
        self.record = begin(arm, folder, trials)  # type: ignore[arg-type]
        self.diagnosis: Diagnosis | None = None
        self._suspected: list[str] = []  # effects that have appeared since an alarm
        room = Room(regions or KeepOut(), MARGIN_SHARE * arm.robot.length)
        self.measurer = Measurer(arm, self.record, room, trials, goal.postures, tell)
        self._deadline = time.monotonic() + 60.0 * goal.minutes

    def run(self) -> Findings:
        """
        Ask until enough is known, verify, and let the arm go whatever happens.

        Raises
        ------
        TendonRobotError
            The robot is gone or stopped, or nothing could be measured.
        KeyboardInterrupt

        """
        try:
            outcome = self._ask()
            self._end(outcome)
            return self._verified(outcome)
        finally:
            self.record.save()
            self.arm.release()

    # -------------------------------------------------------------------------
    # Asking.

    def _ask(self) -> InvestigationEnd:
        """Measure and diagnose until it is enough."""
        if self.change is not None and self._change_named(self.change):
            return InvestigationEnd.CHANGED
        while True:
            have = len(self.record.dataset.postures)
            if have >= self.goal.start:
                outcome = self._diagnose()
                if outcome is not None:
                    return outcome
            if have >= self.goal.postures or time.monotonic() > self._deadline:
                return InvestigationEnd.BUDGET
            wanted = self.goal.start - have if have < self.goal.start else self.goal.at_once
            if self.arm.path == 'sequence':  # the next one depends on where this one was
                wanted = 1
            choices = self.choices(min(wanted, self.goal.postures - have))
            gain = choices[0].gain if choices else 0.0
            many = have >= POSTURES_MANY
            if adequate_again(self.record.rounds) and gain < (NARROWING_MIN if many else GAIN_MIN):
                return InvestigationEnd.ADEQUATE
            if not choices or (have >= self.goal.start and gain < GAIN_MIN):
                return InvestigationEnd.POOL
            for choice in choices:
                self._measure(choice)

    def choices(self, count: int) -> list[Choice]:
        """Choose the next postures."""
        offered = self.offered()
        if not len(offered):
            return []
        return choose(self.question(), self.record.dataset, offered, self.catalogue, count)

    def offered(self) -> Floats:
        """Return the postures (b, m) [N] or [m] that may be chosen now."""
        dataset, robot = self.record.dataset, self.guess
        start = None
        if self.arm.path == 'sequence' and len(dataset.postures):
            start = dataset.inputs[-1]
        model, room = Model(robot, self.catalogue), self.measurer.room
        rows = pool(robot, self.goal, self.arm.input, self.arm.path, model, room, start)
        return self.measurer.untried(rows)

    def _change_named(self, change: ChangeFinder) -> bool:
        """Look after a change; tell whether it is named, and none that a description can have."""
        left = look_after(change, self.measurer, self.offered)
        self.record.changed = [vars(suspect) for suspect in left]
        self.record.save()
        self._suspected = [suspect.name for suspect in left if suspect.is_effect]
        return no_effect(left)

    def question(self) -> OpenQuestion:
        """Return what is not known yet."""
        found: Sequence[Any] = () if self.diagnosis is None else self.diagnosis.effects
        values = {
            (effect.name, key): value.value
            for effect in found
            for key, value in effect.parameters.items()
        }
        point: dict[FreeParameter, float] = {
            free: values[free.effect, free.key]
            for free in frees_of([e.name for e in found], self.catalogue, self.arm.robot)
            if (free.effect, free.key) in values
        }
        return OpenQuestion(tuple(self.asked), point, self._noise(), self._only_wide)

    @property
    def _only_wide(self) -> bool:
        """Whether only an interval is too wide."""
        rounds = self.record.rounds
        return self.diagnosis is not None and only_wide(self.diagnosis, rounds, self.goal)

    @property
    def asked(self) -> list[str]:
        """Names of the effects that the next posture is to tell of."""
        if self.diagnosis is not None and self._only_wide:
            return [effect.name for effect in self.diagnosis.effects]
        if self.diagnosis is None and self._suspected:
            return self._suspected[:IN_QUESTION_MAX]
        names = [] if self.diagnosis is None else in_question(self.diagnosis)
        left = self.record.rounds[-1].possible if self.record.rounds else {}
        if left:
            return list(left)[:IN_QUESTION_MAX]
        if not names or (self.diagnosis is not None and not self.diagnosis.effects):
            names += [e.name for e in self.catalogue if e.name not in names and self._shows(e)]
        return names

    @property
    def guess(self) -> Robot:
        """The description with what is thought to be missing."""
        robot = self.arm.robot
        return robot if self.diagnosis is None else with_effects(self.diagnosis, robot)

    def _shows(self, effect: Effect) -> bool:
        """Tell whether an effect can show at all on this arm."""
        robot = self.arm.robot
        if effect.acts_on and effect.acts_on not in robot.effects:
            return False
        return {
            'history': self.arm.path == 'sequence',
            'pulls': self.arm.input == 'displacement',
            'gravity': robot.gravity is not None and bool(np.any(robot.gravity)),
        }.get(effect.needs or '', True)

    def _noise(self) -> Noise:
        """Return the noise to plan with."""
        setting, trial = self.arm.input_noise
        position = self.arm.position_noise or self.goal.tracker_noise
        if self.diagnosis is not None and self.diagnosis.verdict.judged:
            position = self.diagnosis.details['noise']['position'] or position
        return Noise(position, trial, setting, np.inf, 'declared')

    def _measure(self, choice: Choice) -> None:
        """Measure a posture that was chosen."""
        asked = self.asked
        names = listed(asked, 'or') if len(asked) <= 3 else f'{len(asked)} effects'
        what = f'the widest interval of {names}' if self._only_wide else names
        why = f'tells {digits(choice.gain)} nat of {what}'
        self.measurer.next(choice.inputs, why, {'gain': choice.gain, 'asked': asked})

    # -------------------------------------------------------------------------
    # Judging.

    def _diagnose(self) -> InvestigationEnd | None:
        """Diagnose what there is, and tell whether it is enough."""
        dataset = self.record.dataset
        found = diagnose(dataset, None, self.catalogue, 1)
        self.diagnosis = found
        self._narrow_margin(found)
        now = Round(
            len(dataset.postures),
            str(found.verdict),
            names_of(found),
            in_question(found),
            widest(found, self.catalogue),
            short(found),
            self._possible(found),
        )
        self.record.rounds.append(now)
        self.record.save()
        outcome = settled(found, self.record.rounds, self.goal, now.postures)
        width = '' if now.widest is None else f', to {100.0 * now.widest:.0f} %'
        text = f'  {now.postures} postures: {now.text}{width}{may_act(now)}'
        self.tell(News('diagnosis', text, {**vars(now), 'enough': outcome is not None}))
        return outcome

    def _possible(self, found: Diagnosis) -> dict[str, float]:
        """Return what may act unseen though the model is adequate [m] at the tip."""
        if found.verdict is not Verdict.ADEQUATE:
            return {}
        visible = self.goal.visible * self.arm.robot.length
        return possible(found, self.record.dataset, self.catalogue, visible)

    def _narrow_margin(self, found: Diagnosis) -> None:
        """Keep as far from the regions as the best model is off, and more."""
        if found.verdict.judged and np.isfinite(found.error_after):
            tips = 3.0 * found.error_after
            margin = min(tips, MARGIN_SHARE * self.arm.robot.length)
            self.measurer.room = Room(self.measurer.room.regions, margin)

    def _end(self, outcome: InvestigationEnd) -> None:
        """Say why it ended."""
        record, named = self.record, [] if self.diagnosis is None else names_of(self.diagnosis)
        if outcome is InvestigationEnd.CHANGED:
            named = [one['name'] for one in record.changed]
        record.outcome = {'why': str(outcome), 'names': named,
                          'postures': len(record.dataset.postures)}  # fmt: skip
        sentence = f'{len(record.dataset.postures)} postures: {SENTENCES[outcome]}'
        if record.rounds:
            sentence += may_act(record.rounds[-1])
        if record.skipped:
            sentence += f'; {len(record.skipped)} could not be measured'
        self.tell(News('end', sentence, record.outcome))

    # -------------------------------------------------------------------------
    # Verifying.

    def _verified(self, outcome: InvestigationEnd) -> Findings:
        """Fit what was found and see what it does on fresh postures."""
        found, dataset = self.diagnosis, self.record.dataset
        adds = found is not None and bool(found.effects) and found.verdict.may_add
        sure = outcome is InvestigationEnd.NAMED or self.goal.add
        if found is None or not adds or not sure:
            return Findings(outcome, found, dataset, self.record)
        check = self._fresh() if self.goal.checks else None
        names = [effect.name for effect in found.effects]
        made = add_effects(dataset, names, None, self.catalogue, check, found.effects)
        self.tell(
            News(
                'added',
                f'{listed(names)}: error on {"fresh" if check else "left-out"} postures '
                f'{1e3 * made.check.before:.2f} -> {1e3 * made.check.after:.2f} mm',
                {'before': made.check.before, 'after': made.check.after, 'names': names},
            )
        )
        return Findings(outcome, found, dataset, self.record, made, check)

    def _fresh(self) -> DataSet | None:
        """Measure postures that were not chosen for anything."""
        self.arm.release()
        model = Model(self.guess, self.catalogue)
        rows = fresh(self.arm.robot, self.goal, self.arm.input, model, self.measurer.room)
        check = empty_dataset(self.arm, CHECK, self.measurer.trials)
        for row in rows:
            if len(check.postures) == self.goal.checks:
                break
            measured = self.measurer.attempted(row)
            if measured is not None:
                check = with_posture(check, row, measured, self.arm.position_noise)
                self.tell(News('check', f'  fresh posture {len(check.postures)} measured'))
        return check if len(check.postures) else None
