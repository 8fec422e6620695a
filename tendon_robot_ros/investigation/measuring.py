"""
Measure postures of an arm, and record them: the data set is on disk after every posture.

A failed posture is repeated once, then skipped; regions are kept out. After a drift alarm, the
postures that separate the suspected changes are measured.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError, TendonRobotError
from ..common.files import read_text, write_text
from ..common.words import commands
from ..data import DataSet, Marker, load_dataset, save_dataset
from ..data.loading import stacked
from ..inference.statistics import SIGNIFICANCE, mean_over
from ..monitoring.change import ChangeFinder, Suspect, described
from ..robot import Robot, dump_robot
from .choice import Room
from .goal import Goal, Round

DATA, CHECK, LOG, BETTER = 'data', 'check', 'investigation.json', 'better.yaml'
FORMAT = 'tendon_robot_ros/investigation@1'


class BrokenMeasurementError(TendonRobotError):
    """A posture could not be measured: tracker lost, arm not at rest, tendon slipped."""


@dataclass(frozen=True)
class PostureMeasured:
    """One posture as it was measured."""

    positions: Floats  # (Q, J, 3) [m], nan where a marker was not seen
    inputs: Floats | None = None  # (Q, m) [N] or [m] as measured; None: as commanded
    frames: int = 1  # of the tracker, of all trials together


class MeasurableArm(Protocol):
    """An arm that goes to postures and is measured; it keeps its own limits, stop and watchdog."""

    robot: Robot  # the description that is to be judged
    markers: Sequence[Marker]  # of the tracker
    input: str  # 'tension' or 'displacement': what the motors set
    path: str  # 'from_straight' (it lets go before every posture) or 'sequence'
    # relative 1 sd of an input: shared by the trials of a posture, and per trial [1]
    input_noise: tuple[float, float]

    @property
    def position_noise(self) -> float | None:
        """Standard deviation [m] of a coordinate of one trial, if it is known."""

    def measure(self, inputs: Floats, trials: int) -> PostureMeasured:
        """
        Go to a posture, wait until it stands, and record trials.

        Raises
        ------
        BrokenMeasurementError
            It was not measured; another attempt may do.
        TendonRobotError
            The robot is stopped or gone.

        """

    def attend(self) -> None:
        """Serve what has come during a diagnosis; raise TendonRobotError to end it."""

    def release(self) -> None:
        """Release the arm to its safe state."""


@dataclass(frozen=True)
class Skipped:
    """A posture that could not be measured."""

    inputs: list[float]
    reason: str


@dataclass
class Record:
    """The data set so far, the skipped postures, and the diagnoses."""

    dataset: DataSet
    folder: Path | None = None
    skipped: list[Skipped] = field(default_factory=list)
    rounds: list[Round] = field(default_factory=list)
    outcome: dict[str, Any] = field(default_factory=dict)
    changed: list[dict[str, Any]] = field(default_factory=list)  # since an alarm, likeliest first

    @classmethod
    def begin(cls, arm: MeasurableArm, folder: Path | None, trials: int) -> Record:
        """
        Begin with an empty data set.

        Raises
        ------
        InputError
            The folder is there already.

        """
        if folder is not None:
            if folder.exists():
                remedy = 'use --resume or another folder' if (folder / LOG).exists() else ''
                raise InputError(f'{folder}: is there already; {remedy or "name another folder"}')
            folder.mkdir(parents=True)
        return cls(empty_dataset(arm, DATA, trials), folder)

    @classmethod
    def resume(cls, arm: MeasurableArm, folder: Path, trials: int) -> Record:
        """
        Resume from a folder.

        Raises
        ------
        InputError
            There is nothing, or it is of another robot, or measured otherwise.

        """
        log = folder / LOG
        if not log.exists():
            raise InputError(f'{folder}: no {LOG} there: nothing to resume')

        def refuse(reason: object) -> InputError:
            return InputError(f'{log}: cannot be read ({reason}); begin a new folder')

        text = read_text(log, refuse)
        try:
            content = json.loads(text)
            skipped = [Skipped(**one) for one in content['skipped']]
            rounds = [Round(**one) for one in content['rounds']]
            changed = [dict(one) for one in content['changed']]
        except (ValueError, LookupError, TypeError) as error:
            raise refuse(error) from None
        record = cls(empty_dataset(arm, DATA, trials), folder, skipped, rounds, changed=changed)
        if (folder / DATA).exists():
            record.dataset = replace(load_dataset(folder / DATA), name=DATA)
        dataset = record.dataset
        same = dump_robot(dataset.robot) == dump_robot(arm.robot)
        if not same or (dataset.input, dataset.path) != (arm.input, arm.path):
            raise InputError(
                f'{folder}: was measured with another description, input or path than now; '
                'begin a new folder'
            )
        return record

    def take(self, inputs: Floats, measured: PostureMeasured, noise: float | None) -> None:
        """Append a posture, measured with a noise [m] if that is known, and write it."""
        self.dataset = with_posture(self.dataset, inputs, measured, noise)
        self.save()

    def skip(self, inputs: Floats, reason: str) -> None:
        """Record a posture that could not be measured."""
        self.skipped.append(Skipped(np.asarray(inputs).tolist(), reason))
        self.save()

    def save(self) -> None:
        """Write data set and log."""
        if self.folder is None:
            return
        if len(self.dataset.postures):
            save_dataset(self.dataset, self.folder / DATA, True)
        content = {
            'format': FORMAT,
            'postures': len(self.dataset.postures),
            'skipped': [asdict(one) for one in self.skipped],
            'rounds': [asdict(one) for one in self.rounds],
            'changed': self.changed,
            'outcome': self.outcome,
        }
        write_text(self.folder / LOG, json.dumps(content, indent=1) + '\n')


def empty_dataset(arm: MeasurableArm, name: str, trials: int) -> DataSet:
    """Return a data set of an arm without postures."""
    setting, trial = arm.input_noise
    return DataSet(
        name=name,
        robot=arm.robot,
        markers=tuple(arm.markers),
        postures=(),
        inputs=np.zeros((0, len(arm.robot.inputs))),
        positions=np.zeros((0, trials, len(arm.markers), 3)),
        input=arm.input,
        path=arm.path,
        gravity=arm.robot.gravity,
        position_noise=arm.position_noise,
        setting_noise=setting,
        trial_noise=trial,
    )


def with_posture(
    old: DataSet, inputs: Floats, measured: PostureMeasured, noise: float | None
) -> DataSet:
    """Return a data set with one posture more; missing trials are nan."""
    # one that is resumed may have had fewer
    trials = max(old.positions.shape[1], len(measured.positions))
    trial_inputs: Floats | None = None
    if old.trial_inputs is not None or measured.inputs is not None:
        as_commanded = np.tile(inputs, (len(measured.positions), 1))
        now = as_commanded if measured.inputs is None else measured.inputs
        trial_inputs = stacked([old.inputs_by_trial, now[None]], trials)
    return replace(
        old,
        postures=(*old.postures, str(len(old.postures) + 1)),
        inputs=np.vstack([old.inputs, inputs]),
        positions=stacked([old.positions, measured.positions[None]], trials),
        trial_inputs=trial_inputs,
        trial_names=(),
        position_noise=noise,
    )


# called with what has happened ('posture', 'broken', 'skipped', 'change', 'changed', 'diagnosis',
# 'end', 'added', 'check'), a line to print, and plain data for a page
Report = Callable[[str, str, dict[str, Any]], None]


@dataclass
class Measurer:
    """Commands postures to an arm, and records the measurements."""

    arm: MeasurableArm
    record: Record
    room: Room
    trials: int
    goal: Goal
    report: Report

    def next(self, inputs: Floats, why: str, content: dict[str, Any]) -> PostureMeasured | None:
        """Announce, measure and record a posture; None if it was skipped."""
        number = len(self.record.dataset.postures) + 1
        named = dict(zip(self.arm.robot.inputs, inputs.tolist(), strict=True))
        data = {'number': number, 'inputs': inputs.tolist(), 'most': self.goal.postures, **content}
        text = f'posture {number}: {commands(named, self.arm.input)}   {why}'
        self.report('posture', text, data)
        if (measured := self.attempted(inputs)) is not None:
            self.record.take(inputs, measured, self.arm.position_noise)
        return measured

    def attempted(self, inputs: Floats) -> PostureMeasured | None:
        """
        Return what was measured; None after the last attempt.

        Raises
        ------
        TendonRobotError
            Too many postures could not be measured, or a marker was seen in a region.

        """
        reason = ''
        for is_last in (False, True):
            try:
                measured = checked(self.arm.measure(inputs, self.trials))
                self.room.refuse_inside(measured.positions)
                return measured
            except BrokenMeasurementError as error:
                reason = str(error)
                if not is_last:
                    self.report('broken', f'  not measured: {reason}; once more', {})
        self.record.skip(inputs, reason)
        self.report('skipped', f'  skipped: {reason}', {})
        if len(self.record.skipped) >= self.goal.skipped + len(self.record.dataset.postures):
            raise TendonRobotError(
                f'{len(self.record.skipped)} postures could not be measured, the last one: '
                f'{reason}; look at the robot, then go on with --resume'
            )
        return None

    def untried(self, offered: Floats) -> Floats:
        """Return the postures (b, m) not skipped, nor measured but in a sequence."""
        skipped = (np.array(one.inputs) for one in self.record.skipped)
        measured = self.record.dataset.inputs if self.arm.path == 'from_straight' else ()
        for row in (*measured, *skipped):
            same = np.isclose(np.nan_to_num(offered), np.nan_to_num(row), atol=1e-9).all(axis=1)
            offered = offered[~same]
        return offered


def checked(measured: PostureMeasured) -> PostureMeasured:
    """
    Refuse a measurement that lacks most of its markers.

    Raises
    ------
    BrokenMeasurementError

    """
    visible = np.isfinite(measured.positions).all(axis=2)  # (Q, J)
    good = visible.mean(axis=1) >= 0.5
    if not good.any():
        lost = 100.0 * (1.0 - visible.mean())
        raise BrokenMeasurementError(f'the tracker lost {lost:.0f} % of the markers')
    positions = np.where(good[:, None, None], measured.positions, np.nan)
    return replace(measured, positions=positions)


def separate_changes(
    finder: ChangeFinder, measurer: Measurer, offered: Callable[[], Floats]
) -> list[Suspect]:
    """
    Measure the postures that separate what may have changed since a drift alarm.

    The monitor knows what it may be after the postures that happened to come. Here the arm is
    driven to the posture at which the likely changes lie farthest apart, until one of them is
    likely enough, nothing separates the rest, or the postures are used up. They are the first
    postures of the investigation that follows; after each it is said what the change looks like.

    Parameters
    ----------
    finder : ChangeFinder
        With the postures since the alarm; those that are measured are added.
    measurer : Measurer
    offered : callable
        Returns the tensions (b, m) [N] that may be chosen now.

    Returns
    -------
    list of Suspect
        The remaining changes, the likeliest first; see `likely`.

    """
    suspects = finder.suspects()
    report_suspects(measurer, suspects)
    for _ in range(min(measurer.goal.after_alarm, measurer.goal.postures)):
        rows = offered()
        best = finder.most_informative(rows) if len(rows) else None
        if best is None:
            break
        names = [suspect.name for suspect in likely(suspects)]
        more = f' and {len(names) - 3} more' if len(names) > 3 else ''
        first = ', '.join(names[:3])
        why = f'separates {first}{more}' if len(names) > 1 else f'is to confirm {first}'
        inputs = rows[best]
        if (measured := measurer.next(inputs, why, {'asked': names})) is not None:
            if measured.inputs is not None:
                inputs = np.nanmean(measured.inputs, axis=0)
            # all trials of a posture are one measurement
            finder.take(inputs, mean_over(measured.positions, 0), measured.frames)
            suspects = finder.suspects()
            report_suspects(measurer, suspects)
    if rest := likely(suspects):
        have = len(measurer.record.dataset.postures)
        content = {'names': [suspect.name for suspect in rest], 'postures': have}
        measurer.report('changed', f'  {have} postures: has changed: {sizes(rest)}', content)
    return rest


def likely(suspects: Sequence[Suspect]) -> list[Suspect]:
    """Return the fewest likeliest changes whose total probability is large enough."""
    sums = np.cumsum([suspect.probability for suspect in suspects])
    return list(suspects[: int(np.searchsorted(sums, 1.0 - SIGNIFICANCE)) + 1])


def sizes(suspects: Sequence[Suspect]) -> str:
    """Describe up to three alternative changes with their sizes."""
    texts = [f'{suspect.name} ({suspect.size})' for suspect in suspects[:3]]
    more = f' or {len(suspects) - 3} more' if len(suspects) > 3 else ''
    return ' or '.join(texts) + more


def report_suspects(measurer: Measurer, suspects: Sequence[Suspect]) -> None:
    """Report the likeliest changes after the postures so far."""
    have = len(measurer.record.dataset.postures)
    content = {'suspects': [vars(suspect) for suspect in likely(suspects)], 'postures': have}
    measurer.report('change', f'  looks like {described(suspects)}', content)
