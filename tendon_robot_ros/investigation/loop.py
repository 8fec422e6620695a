"""
The loop of an investigation: choose the most informative posture, measure it, diagnose.

After a drift alarm the first postures are those that separate the suspected changes. The loop ends
when one effect is named with an interval as narrow as requested, when the remaining effects are
inseparable, when the model is adequate, when nothing in the catalogue fits, or when the budget is
spent. The result is then verified on postures that were not used to find it, and written: data,
recording, diagnosis, page, description.
"""

from __future__ import annotations

import importlib.util
import shutil
import time
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..common.arrays import Floats
from ..common.files import write_text
from ..common.words import digits, listed
from ..data import DataSet, save_dataset
from ..data.bag_writer import export_bag
from ..diagnosis.add import Addition, add_effect
from ..diagnosis.diagnose import diagnose
from ..diagnosis.result import Diagnosis, found_values
from ..diagnosis.verdict import Verdict
from ..effects import Catalogue, Effect, load_catalogue
from ..inference.candidates import acts
from ..inference.noise import Noise
from ..model.model import Model
from ..monitoring.change import ChangeFinder
from ..report.diagnosis_page import diagnosis_page, with_effects
from ..report.diagnosis_text import addition_warnings, never_used
from ..robot import dump_robot
from ..robot.estimates import MODEL_ERROR_MAX, natural_sizes
from ..robot.keep_out import KeepOut
from . import measuring
from .choice import OpenQuestion, Room, choose, fresh, pool
from .goal import (
    IN_QUESTION_MAX,
    Goal,
    InvestigationEnd,
    Round,
    in_question,
    may_act,
    names_of,
    only_wide,
    possible,
    settled,
    short,
    twice,
    widest,
)

RECORDING, RESULT, REPORT = 'recording.mcap', 'diagnosis.json', 'report.html'
# [nat] information below which a posture is useless: an interval that it narrows would become
# shorter by 2 %
GAIN_MIN = 0.02
# [nat] information below which a posture hardly narrows what may act unseen (docs/investigate.md)
NARROWING_MIN = 0.5
# [1] postures from which that ends the search of an adequate model (docs/investigate.md)
NARROWING_FROM = 8


class Investigation:
    """One investigation of an arm, and its result."""

    def __init__(
        self,
        arm: measuring.MeasurableArm,
        goal: Goal,
        folder: Path | None = None,
        regions: KeepOut | None = None,
        report: measuring.Report = lambda kind, text, content: None,
        resume: bool = False,
        change: ChangeFinder | None = None,
    ) -> None:
        """
        Begin an investigation, or resume one from a folder.

        Parameters
        ----------
        arm : MeasurableArm
        goal : Goal
        folder : Path, optional
            Where it is written, after every posture.
        regions : KeepOut, optional
            Where no part of the arm may be.
        report : callable, optional
            Called with every event: see `Report`.
        resume : bool
        change : ChangeFinder, optional
            The change detector of a drift alarm: its suspects are separated first.

        Raises
        ------
        InputError

        """
        self.arm, self.goal, self.report, self.change = arm, goal, report, change
        self.catalogue: Catalogue = load_catalogue(goal.effect_files).sized(
            natural_sizes(arm.robot)
        )
        trials = goal.trials if arm.path == 'from_straight' else 1
        begin = measuring.Record.resume if resume else measuring.Record.begin
        self.record = begin(arm, folder, trials)  # type: ignore[arg-type]
        self.diagnosis: Diagnosis | None = None
        self.outcome: InvestigationEnd | None = None
        self.addition: Addition | None = None  # fitted effects, and their error on fresh postures
        self.check: DataSet | None = None
        self._suspected: list[str] = []  # effects that have appeared since an alarm
        room = Room(regions or KeepOut(), MODEL_ERROR_MAX * arm.robot.length)
        self.measurer = measuring.Measurer(arm, self.record, room, trials, goal, report)
        self._deadline = time.monotonic() + 60.0 * goal.minutes

    @property
    def dataset(self) -> DataSet:
        """What was measured, the fresh postures apart."""
        return self.record.dataset

    def to_json(self) -> dict[str, Any]:
        """Return why it ended, the verdict, and what was added."""
        return {
            **self.record.outcome,
            'diagnosis': None if self.diagnosis is None else self.diagnosis.to_json(),
            'added': None if self.addition is None else self.addition.to_json(),
        }

    def run(self) -> Self:
        """
        Ask until enough is known, verify, and let the arm go whatever happens; return itself.

        Raises
        ------
        TendonRobotError
            The robot is gone or stopped, or nothing could be measured.
        KeyboardInterrupt

        """
        try:
            self.outcome = self.ask()
            self.report_end(self.outcome)
            self.verify()
            return self
        finally:
            try:
                self.arm.release()
            finally:
                self.record.save()

    def ask(self) -> InvestigationEnd:
        """Measure and diagnose until the goal is reached or the budget spent."""
        if self.change is not None:
            suspects = measuring.separate_changes(self.change, self.measurer, self.offered)
            self.record.changed = [vars(suspect) for suspect in suspects]
            self.record.save()
            self._suspected = [suspect.name for suspect in suspects if suspect.is_effect]
            if suspects and not self._suspected:  # a cell, a gain, the tracker
                return InvestigationEnd.CHANGED
        while True:
            have = len(self.dataset.postures)
            if have >= self.goal.start and (outcome := self.judge()) is not None:
                return outcome
            if have >= self.goal.postures or time.monotonic() > self._deadline:
                return InvestigationEnd.BUDGET
            count = self.goal.start - have if have < self.goal.start else self.goal.at_once
            if self.arm.path == 'sequence':  # the next one depends on where this one was
                count = 1
            offered, count = self.offered(), min(count, self.goal.postures - have)
            choices = choose(self.question(), self.dataset, offered, self.catalogue, count)
            gain = choices[0][1] if choices else 0.0
            least = NARROWING_MIN if have >= NARROWING_FROM else GAIN_MIN
            if twice(Verdict.ADEQUATE, self.record.rounds) and gain < least:
                return InvestigationEnd.ADEQUATE
            if not choices or (have >= self.goal.start and gain < GAIN_MIN):
                return InvestigationEnd.POOL
            sought = self.sought
            names = listed(sought, 'or') if len(sought) <= 3 else f'{len(sought)} effects'
            what = f'the widest interval of {names}' if self._only_wide else names
            for inputs, gain in choices:
                why = f'tells {digits(gain)} nat of {what}'
                self.measurer.next(inputs, why, {'gain': gain, 'asked': sought})

    def offered(self) -> Floats:
        """Return the postures (b, m) [N] or [m] that may be chosen now."""
        rows = pool(self.guess, self.goal, self.measurer.room, self.dataset)
        return self.measurer.untried(rows)

    def question(self) -> OpenQuestion:
        """Return the question that the next posture is to answer."""
        effects = () if self.diagnosis is None else self.diagnosis.effects
        point = found_values(effects, self.catalogue, self.arm.robot)
        return OpenQuestion(tuple(self.sought), point, self.noise, self._only_wide)

    @property
    def _only_wide(self) -> bool:
        """Whether only an interval is too wide."""
        rounds = self.record.rounds
        return self.diagnosis is not None and only_wide(self.diagnosis, rounds, self.goal)

    @property
    def sought(self) -> list[str]:
        """Names of the effects on which the next posture is to give information."""
        known, rounds = self.diagnosis, self.record.rounds
        if known is not None and self._only_wide:
            return [effect.name for effect in known.effects]
        if known is None and self._suspected:
            return self._suspected[:IN_QUESTION_MAX]
        if rounds and rounds[-1].possible:
            return list(rounds[-1].possible)[:IN_QUESTION_MAX]
        names = [] if known is None else in_question(known)
        if not names or (known is not None and not known.effects):
            names += [e.name for e in self.catalogue if e.name not in names and self.shows(e)]
        return names

    @property
    def guess(self) -> Model:
        """The model with the effects of the last diagnosis."""
        robot, known = self.arm.robot, self.diagnosis
        better = robot if known is None else with_effects(known, robot, self.catalogue)
        return Model(better, self.catalogue)

    def shows(self, effect: Effect) -> bool:
        """Return whether an effect has any influence on this arm, if it is not at some place."""
        has = {
            'history': self.arm.path == 'sequence',
            'pulls': self.arm.input == 'displacement',
            'gravity': bool(np.any(self.arm.robot.gravity or 0.0)),
        }
        return acts(effect, self.arm.robot, [need for need, given in has.items() if given])

    @property
    def noise(self) -> Noise:
        """The noise to plan with."""
        setting, trial = self.arm.input_noise
        position = self.arm.position_noise or self.goal.tracker_noise
        if self.diagnosis is not None and self.diagnosis.verdict.judged:
            position = self.diagnosis.details['noise']['position'] or position
        return Noise(position, trial, setting, np.inf, 'declared')

    def judge(self) -> InvestigationEnd | None:
        """Diagnose the measurements; return why the investigation ends, None if it goes on."""
        dataset = self.dataset
        diagnosis = diagnose(dataset, None, self.catalogue, progress=lambda *_: self.arm.attend())
        self.diagnosis = diagnosis
        length = self.arm.robot.length
        if diagnosis.verdict.judged and np.isfinite(diagnosis.error_after):
            # as far from the regions as the best model is off (3 sd), but no farther than before
            margin = min(3.0 * diagnosis.error_after, MODEL_ERROR_MAX * length)
            self.measurer.room = Room(self.measurer.room.regions, margin)
        now = Round(
            len(dataset.postures),
            str(diagnosis.verdict),
            names_of(diagnosis),
            in_question(diagnosis),
            widest(diagnosis, self.catalogue),
            short(diagnosis),
            possible(diagnosis, dataset, self.catalogue, self.goal.visible * length),
        )
        # an earlier one of the same postures confirms nothing: none came, or it was resumed
        earlier = [one for one in self.record.rounds if one.postures < now.postures]
        self.record.rounds = [*earlier, now]
        self.record.save()
        outcome = settled(diagnosis, self.record.rounds, self.goal)
        width = '' if now.widest is None else f', to {100.0 * now.widest:.0f} %'
        text = f'  {now.postures} postures: {now.text}{width}{may_act(now)}'
        self.report('diagnosis', text, {**vars(now), 'enough': outcome is not None})
        return outcome

    def report_end(self, outcome: InvestigationEnd) -> None:
        """Record and report why the investigation ended."""
        record, named = self.record, [] if self.diagnosis is None else names_of(self.diagnosis)
        if outcome is InvestigationEnd.CHANGED:
            named = [one['name'] for one in record.changed]
        postures = len(record.dataset.postures)
        record.outcome = {'why': str(outcome), 'names': named, 'postures': postures}
        sentence = f'{postures} postures: {outcome.sentence}'
        if record.rounds:
            sentence += may_act(record.rounds[-1])
        if record.skipped:
            sentence += f'; {len(record.skipped)} could not be measured'
        self.report('end', sentence, record.outcome)

    def verify(self) -> None:
        """Fit the named effects, and compute their error on fresh postures."""
        found, confirmed = self.diagnosis, self.outcome is InvestigationEnd.NAMED or self.goal.add
        if found is None or not (confirmed and found.effects and found.adds):
            return
        check = self.check = self.measure_fresh() if self.goal.checks else None
        names = [effect.name for effect in found.effects]
        added = add_effect(self.dataset, found.effects, None, self.catalogue, check)
        before, after = added.check.before, added.check.after
        self.report(
            'added',
            f'{listed(names)}: error on {"fresh" if check else "left-out"} postures '
            f'{1e3 * before:.2f} -> {1e3 * after:.2f} mm',
            {'before': before, 'after': after, 'names': names},
        )
        self.addition = added

    def measure_fresh(self) -> DataSet | None:
        """Measure random postures that no choice has selected."""
        self.arm.release()
        rows = fresh(self.arm.robot, self.goal, self.arm.input, self.guess, self.measurer.room)
        check = measuring.empty_dataset(self.arm, measuring.CHECK, self.measurer.trials)
        for row in rows:
            if len(check.postures) == self.goal.checks:
                break
            if (measured := self.measurer.attempted(row)) is not None:
                check = measuring.with_posture(check, row, measured, self.arm.position_noise)
                self.report('check', f'  fresh posture {len(check.postures)} measured', {})
        return check if len(check.postures) else None

    def write_results(self) -> list[str]:
        """
        Write everything beside the data; return the lines to print.

        Recording and report need their extras (rosbags, plotly) and are left out without.
        """
        folder, diagnosis, added = self.record.folder, self.diagnosis, self.addition
        assert folder is not None
        text, written = list[str](), [measuring.DATA] if len(self.dataset.postures) else []
        (folder / measuring.BETTER).unlink(missing_ok=True)  # of an earlier run that was resumed
        shutil.rmtree(folder / measuring.CHECK, ignore_errors=True)
        if self.check is not None:
            save_dataset(self.check, folder / measuring.CHECK, True)
            written.append(measuring.CHECK)
        if written and importlib.util.find_spec('rosbags') is not None:
            (folder / RECORDING).unlink(missing_ok=True)
            export_bag(self.dataset, folder / RECORDING)
            written.append(RECORDING)
        if diagnosis is not None:
            text += ['', diagnosis.text()]
            diagnosis.save(folder / RESULT)
            written.append(RESULT)
        send = ''
        if added is not None:
            text += [never_used(added), *addition_warnings(added)]
            if added.helps:
                write_text(folder / measuring.BETTER, dump_robot(added.robot))
                written.append(measuring.BETTER)
                better = folder / measuring.BETTER
                send = f'send it to the robot: controller parameter model := {better}'
                text.append(send)
        if diagnosis is not None and importlib.util.find_spec('plotly') is not None:
            page = diagnosis_page(diagnosis, self.dataset, self.catalogue, added, send)
            page.write(folder / REPORT)
            written.append(REPORT)
        return [*text, f'written: {folder}: {", ".join(written)}']
