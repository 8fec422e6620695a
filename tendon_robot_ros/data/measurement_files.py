"""inputs.csv and shapes.csv: the commands, and the measured positions of the markers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..common.errors import DataSetError
from ..common.words import listing
from ..robot import Robot
from .arrays import PLAUSIBLE_FACTOR, POSITION, QUATERNION, VALUES_MAX, too_tense
from .csv_file import NEEDED, CsvFile, IntArray, Table
from .dataset import FloatArray
from .visits import STRAIGHT

VISIT, ORIGIN = HISTORY = ('visit', 'previous')  # columns of the history of a posture


@dataclass(frozen=True)
class Commands:
    """The R rows of inputs.csv."""

    file: CsvFile
    table: Table
    values: FloatArray  # (R, m) [N] or [m], NaN = slack
    visit: IntArray | None = None  # (R,) order of the visits; None: not in the file
    origin: IntArray | None = None  # (R,) index of the posture before, `STRAIGHT` for none

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
        """
        Return the values of every trial, (P, Q, m), None where the file has none.

        Visits need a row per trial; equal rows of a posture are commands and no measurements.
        """
        if self.trials is None:
            return None
        if self.visit is not None or self.origin is not None:
            first = self.values[np.unique(self.table.codes['posture'], return_index=True)[1]]
            if np.array_equal(first[self.table.codes['posture']], self.values, equal_nan=True):
                return None
        values = np.full((len(self.postures), len(trials), self.values.shape[1]), np.nan)
        values[self.table.codes['posture'], self.table.translate('trial', trials)] = self.values
        return values


def read_inputs(
    path: Path, robot: Robot, kind: str, visits: bool = False, remedy: str = NEEDED
) -> Commands:
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
    visits : bool
        A column says in which order, or from where, the arm came.
    remedy : str
        What to do where there is no such file.

    Raises
    ------
    DataSetError
        With row and remedy.

    """
    wires = {wire for wound in robot.drums.values() for wire in wound}
    required = ('posture', *(name for name in robot.inputs if name not in wires))
    drums = tuple(robot.drums) if kind == 'displacement' else ()
    known = ('posture', 'trial', *robot.inputs, *drums, *HISTORY)
    file = CsvFile(path, required, known, 'write the value that was set', remedy)
    check_history(file, visits)
    check_drums(file, robot)
    names = ('posture', 'trial') if 'trial' in file.header else ('posture',)
    numbers = [name for name in (*robot.inputs, *drums, VISIT) if name in file.header]
    table = file.read(names, numbers, [ORIGIN] if ORIGIN in file.header else [])
    values = wound(file, table, robot)
    _check(file, values, robot, kind)
    return Commands(file, table, values, visits_of(file, table), origins(file, table))


def check_drums(file: CsvFile, robot: Robot) -> None:
    """Refuse a drum together with its wires, and a drum for which neither has a column."""
    for drum, wound in robot.drums.items():
        present = [wire for wire in wound if wire in file.header]
        if drum in file.header and present:
            problem = f'drum {drum!r} and its wire {present[0]!r} both have a column'
            raise file.error(1, problem, 'keep one of them')
        if drum not in file.header and len(present) < len(wound):
            missing = next(wire for wire in wound if wire not in present)
            remedy = f'add it to the header, or with input: displacement its drum {drum!r}'
            raise file.error(1, f'column {missing!r} is missing', remedy)


def wound(file: CsvFile, table: Table, robot: Robot) -> FloatArray:
    """Return the values of the inputs (R, m); a drum winds each of its wires."""
    columns = {name: table.numbers[name] for name in robot.inputs if name in table.numbers}
    for drum, wound in robot.drums.items():
        if drum in table.numbers:
            turned = table.numbers[drum]
            if np.isnan(turned).any():
                row = int(np.isnan(turned).argmax()) + 2
                raise file.error(row, f'{drum} is empty', 'a drum is never slack: write its pull')
            columns |= {wire: winding * turned for wire, winding in wound.items()}
    return np.stack([columns[name] for name in robot.inputs], axis=1)


def check_history(file: CsvFile, visits: bool) -> None:
    """Refuse columns of a history that dataset.yaml does not announce, and the reverse."""
    present = [name for name in HISTORY if name in file.header]
    if present and not visits:
        remedy = 'write path: visits in dataset.yaml, or remove the column'
        raise file.error(1, f'column {present[0]!r} tells of visits', remedy)
    if visits and len(present) != 1:
        problem = 'visit and previous both' if present else 'neither visit nor previous'
        remedy = 'write visit (its number in the order of visits) or previous (posture before)'
        raise file.error(1, f'with path: visits there is {problem}', remedy)
    if VISIT in present and 'trial' not in file.header:
        raise file.error(1, "visits are counted, but column 'trial' is missing", 'add it')


def visits_of(file: CsvFile, table: Table) -> IntArray | None:
    """Return the numbers of the visits (R,), None where the file has none."""
    if VISIT not in table.numbers:
        return None
    visit = table.numbers[VISIT]
    whole = np.isfinite(visit) & (visit == np.round(visit)) & (np.abs(visit) < 2**53)
    if not whole.all():
        raise file.error(int(whole.argmin()) + 2, 'visit is no whole number', 'count the visits')
    first = np.unique(visit, return_index=True)[1]
    if len(first) < len(visit):
        row = int(np.setdiff1d(np.arange(len(visit)), first)[0])
        remedy = 'give every visit its own number'
        raise file.error(row + 2, f'visit {visit[row]:.0f} stands twice', remedy)
    return np.asarray(visit, dtype=np.int64)


def origins(file: CsvFile, table: Table) -> IntArray | None:
    """Return the index of the posture before (R,), None if the file has no such column."""
    if ORIGIN not in table.labels:
        return None
    postures, names = table.labels['posture'], table.labels[ORIGIN]
    origin = table.translate(ORIGIN, postures)
    unknown = (origin < 0) & np.array([name != '' for name in names])[table.codes[ORIGIN]]
    if unknown.any():
        row = int(unknown.argmax())
        raise file.error(
            row + 2,
            f'previous is {names[table.codes[ORIGIN][row]]!r}, which no row describes',
            f'use one of {listing(postures)}, or leave it empty: from the straight arm',
        )
    return np.where(origin < 0, STRAIGHT, origin)


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
    beyond = values > PLAUSIBLE_FACTOR * limit
    if beyond.any():
        refuse(beyond, *too_tense('{name}', float(values[beyond][0]), limit))


KEYS = ('posture', 'trial', 'marker')
Places = tuple[IntArray, IntArray, NDArray[np.bool_], tuple[str, ...]]


@dataclass(frozen=True)
class Shapes:
    """Arrays in the order of the postures of inputs.csv; NaN where nothing was seen."""

    trials: tuple[str, ...]  # (Q,)
    positions: FloatArray  # (P, Q, J, 3) [m]
    orientations: FloatArray | None  # (P, Q, J, 4), unit quaternions


def read_shapes(
    path: Path, robot: Robot, markers: tuple[str, ...], commands: Commands, sequence: bool
) -> Shapes:
    """
    Read and check shapes.csv.

    Parameters
    ----------
    path : Path
        The file.
    robot : Robot
        Says how far a marker can be.
    markers : tuple of str
        Names that may occur.
    commands : Commands
        What inputs.csv says.
    sequence : bool
        Every trial replays the postures in order: one may stand without a measurement.

    Raises
    ------
    DataSetError
        With row and remedy.

    """
    required = (*KEYS, *POSITION)
    missing = 'leave the cell empty where the marker was not seen'
    file = CsvFile(path, required, (*required, *QUATERNION), missing)
    turned = tuple(name for name in QUATERNION if name in file.header)
    if turned and turned != QUATERNION:
        raise file.error(
            1,
            f'{", ".join(turned)} alone are no quaternion',
            f'write {", ".join(QUATERNION)}, or none of them',
        )
    table = file.read(KEYS, (*POSITION, *turned))
    xyz = np.stack([table.numbers[name] for name in POSITION], axis=1)
    _check_positions(file, xyz, robot)
    trials = sort_trials((*table.labels['trial'], *(commands.trials or ())))
    posture = _known(file, table, 'posture', commands.postures, 'inputs.csv has no such posture')
    marker = _known(file, table, 'marker', markers, 'dataset.yaml has no such marker')
    trial = table.translate('trial', trials)
    sizes = len(commands.postures), len(trials), len(markers)
    if np.prod(sizes, dtype=float) > VALUES_MAX:
        raise DataSetError(
            str(path),
            '{} postures x {} trials x {} markers are too many'.format(*sizes),
            'count the trials of every posture from 0',
        )
    visible = ~np.isnan(xyz[:, 0])
    _check_trials(file, table, commands, (posture, trial, visible, trials), sequence)
    positions = np.full((*sizes, 3), np.nan)
    positions[posture, trial, marker] = xyz
    orientations = None
    if turned:
        orientations = np.full((*sizes, 4), np.nan)
        orientations[posture, trial, marker] = _quaternions(file, table, visible)
    return Shapes(trials, positions, orientations)


def _refuse(file: CsvFile, where: NDArray[np.bool_], problem: str, remedy: str) -> None:
    """Raise the error for the first row where something holds."""
    if where.any():
        raise file.error(int(where.argmax()) + 2, problem, remedy)


def _known(
    file: CsvFile, table: Table, key: str, known: tuple[str, ...], problem: str
) -> IntArray:
    places = table.translate(key, known)
    if (places < 0).any():
        row = int((places < 0).argmax())
        name = table.labels[key][table.codes[key][row]]
        raise file.error(row + 2, f'{key} {name!r}: {problem}', f'use one of {listing(known)}')
    return places


def _check_positions(file: CsvFile, xyz: FloatArray, robot: Robot) -> None:
    missing = np.isnan(xyz)
    _refuse(
        file,
        missing.any(axis=1) & ~missing.all(axis=1),
        'only part of x, y, z is there',
        'write all three, or leave all three empty where the marker was not seen',
    )
    beyond = (np.abs(xyz) > PLAUSIBLE_FACTOR * robot.length).any(axis=1)
    far = np.abs(xyz[int(beyond.argmax())]).max()
    _refuse(
        file,
        beyond,
        f'the marker is {far:g} m away, but the robot is only {robot.length:g} m long',
        'write metres in the base frame (are these mm?)',
    )


def sort_trials(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return each trial name once: numbers in order, others as they appear."""
    unique = tuple(dict.fromkeys(names))
    if all(name.isascii() and name.isdigit() and len(name) < 19 for name in unique):
        return tuple(sorted(unique, key=int))
    return unique


def _check_trials(
    file: CsvFile, table: Table, commands: Commands, places: Places, sequence: bool
) -> None:
    """Refuse trials without a measurement, measurements without inputs and the reverse."""
    posture, trial, visible, trials = places
    measured = np.zeros((len(commands.postures), len(trials)), dtype=bool)
    measured[posture[visible], trial[visible]] = True
    empty = ~measured[posture, trial]
    _refuse(
        file,
        empty,
        f'{table.name(int(empty.argmax()), *KEYS[:2])}: no marker was seen in this trial',
        'remove its rows',
    )
    codes = commands.table.codes
    if commands.trials is None:
        is_measured = measured.any(axis=1)[codes['posture']]
    else:
        rows = codes['posture'], commands.table.translate('trial', trials)
        commanded = np.zeros_like(measured)
        commanded[rows] = True
        alone = ~commanded[posture, trial]
        _refuse(
            file,
            alone,
            f'{table.name(int(alone.argmax()), *KEYS[:2])}: inputs.csv has no row for this trial',
            'add its inputs there or remove its rows here',
        )
        is_measured = measured[rows]
    if not sequence and not is_measured.all():
        row = int(is_measured.argmin())
        raise commands.file.error(
            row + 2,
            f'{commands.table.name(row)}: {file.path.name} has no such measurement',
            'add it there or remove this row',
        )


def _quaternions(file: CsvFile, table: Table, visible: NDArray[np.bool_]) -> FloatArray:
    """Return unit quaternions, (n, 4)."""
    q = np.stack([table.numbers[name] for name in QUATERNION], axis=1)
    missing = np.isnan(q)
    _refuse(
        file,
        missing.any(axis=1) & ~missing.all(axis=1),
        'only part of the quaternion is there',
        'write qx, qy, qz and qw, or leave all four empty',
    )
    _refuse(
        file,
        ~missing.all(axis=1) & ~visible,
        'an orientation without a position',
        'write x, y, z too, or leave the quaternion empty',
    )
    norm = np.linalg.norm(q, axis=1)
    _refuse(file, norm < 1e-6, 'the quaternion is zero', 'leave it empty where it is unknown')
    _refuse(
        file,
        np.abs(norm - 1.0) > 0.05,
        'the quaternion is not of length 1',
        'write qx, qy, qz, qw of a unit quaternion, in this order',
    )
    return q / norm[:, None]
