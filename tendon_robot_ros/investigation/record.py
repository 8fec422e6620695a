"""
The interface of an arm, simulated or real, to an investigation, and the record of postures.

The record is a data set that grows; it is on disk after every posture.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError, TendonRobotError
from ..common.files import read_text, write_text
from ..data import DataSet, Marker, load_dataset, save_dataset
from ..robot import Robot, dump_robot

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

    @property
    def robot(self) -> Robot:
        """The description that is to be judged."""

    @property
    def markers(self) -> Sequence[Marker]:
        """The markers of the tracker."""

    @property
    def input(self) -> str:
        """'tension' or 'displacement': what the motors set."""

    @property
    def path(self) -> str:
        """'from_straight' (it lets go before every posture) or 'sequence'."""

    @property
    def position_noise(self) -> float | None:
        """Standard deviation [m] of a coordinate of one trial, if it is known."""

    @property
    def input_noise(self) -> tuple[float, float]:
        """Relative 1 sd of an input: shared by the trials of a posture, and per trial."""

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

    def release(self) -> None:
        """Release the arm to its safe state."""


@dataclass(frozen=True)
class Skipped:
    """A posture that could not be measured."""

    inputs: list[float]
    reason: str


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
        except (ValueError, LookupError, TypeError) as error:
            raise refuse(error) from None
        record = cls(empty_dataset(arm, DATA, trials), folder, skipped, rounds)
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
    trials = max(old.positions.shape[1], len(measured.positions))
    positions = _stacked([*old.positions, measured.positions], trials)
    trial_inputs: Floats | None = None
    if old.trial_inputs is not None or measured.inputs is not None:
        before = [] if not len(old.postures) else list(old.inputs_by_trial)
        now = measured.inputs
        if now is None:
            now = np.tile(inputs, (len(measured.positions), 1))
        trial_inputs = _stacked([*before, now], trials)
    return replace(
        old,
        postures=(*old.postures, str(len(old.postures) + 1)),
        inputs=np.vstack([old.inputs, inputs]),
        positions=positions,
        trial_inputs=trial_inputs,
        trial_names=(),
        position_noise=noise,
    )


def _stacked(rows: Sequence[Floats], trials: int) -> Floats:
    """Stack arrays whose first axis are trials; nan where one is missing."""
    stacked = np.full((len(rows), trials, *rows[-1].shape[1:]), np.nan)
    for row, values in zip(stacked, rows, strict=True):
        row[: len(values)] = values
    return stacked
