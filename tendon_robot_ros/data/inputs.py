"""inputs.csv: what was commanded, or measured, in every posture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..robot import Robot
from .csv_file import CsvFile
from .dataset import FloatArray
from .table import Table

STRONGEST = 3.0  # tension limits; a larger tension is in another unit


@dataclass(frozen=True)
class Commands:
    """The R rows of inputs.csv."""

    file: CsvFile
    table: Table
    values: FloatArray  # (R, m) [N] or [m], NaN = slack

    @property
    def postures(self) -> tuple[str, ...]:
        """Names of the postures (P,), in the order of the file."""
        return self.table.labels['posture']

    @property
    def trials(self) -> tuple[str, ...] | None:
        """Names of the trials, None where the values hold for all trials of a posture."""
        return self.table.labels.get('trial')

    def by_posture(self) -> FloatArray:
        """
        Return the values of every posture, the mean over its trials, (P, m) [N] or [m].

        Raises
        ------
        DataSetError
            A tendon is slack in some trials of a posture and pulled in others.

        """
        posture = self.table.codes['posture']
        shape = (len(self.postures), self.values.shape[1])
        total, pulled, rows = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        slack = np.isnan(self.values)
        np.add.at(total, posture, np.where(slack, 0.0, self.values))
        np.add.at(pulled, posture, ~slack)
        np.add.at(rows, posture, 1.0)
        mixed = (pulled > 0) & (pulled < rows)
        if mixed.any():
            row = int(np.argmax((slack & mixed[posture]).any(axis=1)))
            raise self.file.error(
                row + 2,
                'a tendon is slack here and pulled in other trials of '
                f'posture {self.postures[posture[row]]!r}',
                'give postures of different inputs different names',
            )
        return np.where(pulled > 0, total / np.maximum(pulled, 1), np.nan)

    def by_trial(self, trials: tuple[str, ...]) -> FloatArray | None:
        """Return the values of every trial, (P, Q, m), None where the file has none."""
        if self.trials is None:
            return None
        values = np.full((len(self.postures), len(trials), self.values.shape[1]), np.nan)
        values[self.table.codes['posture'], self.table.translate('trial', trials)] = self.values
        return values


def read_inputs(path: Path, robot: Robot, kind: str) -> Commands:
    """
    Read and check inputs.csv.

    Parameters
    ----------
    path : Path
        The file.
    robot : Robot
        Says which columns there must be, and which tensions can be.
    kind : str
        'tension' [N] or 'displacement' [m].

    Raises
    ------
    DataSetError
        With row and remedy.

    """
    required, known = ('posture', *robot.inputs), ('posture', 'trial', *robot.inputs)
    file = CsvFile(path, required, known, 'write the value that was set')
    names = ('posture', 'trial') if 'trial' in file.header else ('posture',)
    table = file.read(names, robot.inputs)
    values = np.stack([table.numbers[name] for name in robot.inputs], axis=1)
    _check(file, values, robot, kind)
    return Commands(file, table, values)


def _check(file: CsvFile, values: FloatArray, robot: Robot, kind: str) -> None:
    def refuse(where: NDArray[np.bool_], problem: str, remedy: str) -> None:
        if where.any():
            row, column = np.argwhere(where)[0]
            text = problem.format(name=robot.inputs[column], value=values[row, column])
            raise file.error(int(row) + 2, text, remedy)

    if kind == 'displacement':
        refuse(
            np.abs(values) > robot.length,
            f'{{name}} is pulled by {{value:g}} m, but the robot is only {robot.length:g} m long',
            'write metres (is it in mm?)',
        )
        return
    limit = robot.tension_limits[1]
    refuse(
        np.isnan(values),
        '{name} is empty',
        'write 0 for a slack tendon (an empty cell means slack only with input: displacement)',
    )
    refuse(values < 0.0, '{name} is {value:g} N', 'a tendon cannot push: write 0 or more')
    refuse(
        values > STRONGEST * limit,
        f'{{name}} is {{value:g}} N, but tension_limits end at {limit:g} N',
        'write newtons (is it in g or mN?)',
    )
