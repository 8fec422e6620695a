"""shapes.csv: where the markers were in every trial of every posture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..exceptions import DataSetError
from ..robot import Robot
from .csv_file import CsvFile
from .dataset import FloatArray, listing
from .inputs import Commands
from .table import IntArray, Table

KEYS = ('posture', 'trial', 'marker')
POSITION = ('x', 'y', 'z')  # [m]
ORIENTATION = ('qx', 'qy', 'qz', 'qw')
FARTHEST = 3.0  # robot lengths; a marker farther from the base is in another unit or frame
Places = tuple[IntArray, IntArray, NDArray[np.bool_], tuple[str, ...]]
LARGEST = 20_000_000  # postures x trials x markers that the arrays may hold


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
    file = CsvFile(path, required, (*required, *ORIENTATION), missing)
    turned = tuple(name for name in ORIENTATION if name in file.header)
    if turned and turned != ORIENTATION:
        raise file.error(
            1,
            f'{", ".join(turned)} alone are no quaternion',
            f'write {", ".join(ORIENTATION)}, or none of them',
        )
    table = file.read(KEYS, (*POSITION, *turned))
    xyz = np.stack([table.numbers[name] for name in POSITION], axis=1)
    _check_positions(file, xyz, robot)
    trials = sort_trials((*table.labels['trial'], *(commands.trials or ())))
    posture = _known(file, table, 'posture', commands.postures, 'inputs.csv has no such posture')
    marker = _known(file, table, 'marker', markers, 'dataset.yaml has no such marker')
    trial = table.translate('trial', trials)
    sizes = len(commands.postures), len(trials), len(markers)
    if np.prod(sizes, dtype=float) > LARGEST:
        raise DataSetError(
            str(path),
            '{} postures x {} trials x {} markers are too many'.format(*sizes),
            'count the trials of every posture from 0',
        )
    seen = ~np.isnan(xyz[:, 0])
    _check_trials(file, table, commands, (posture, trial, seen, trials), sequence)
    positions = np.full((*sizes, 3), np.nan)
    positions[posture, trial, marker] = xyz
    orientations = None
    if turned:
        orientations = np.full((*sizes, 4), np.nan)
        orientations[posture, trial, marker] = _quaternions(file, table, seen)
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
    beyond = (np.abs(xyz) > FARTHEST * robot.length).any(axis=1)
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
    posture, trial, seen, trials = places
    measured = np.zeros((len(commands.postures), len(trials)), dtype=bool)
    measured[posture[seen], trial[seen]] = True
    empty = ~measured[posture, trial]
    _refuse(
        file,
        empty,
        f'{table.name(int(empty.argmax()), *KEYS[:2])}: no marker was seen in this trial',
        'remove its rows',
    )
    codes = commands.table.codes
    if commands.trials is None:
        done = measured.any(axis=1)[codes['posture']]
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
        done = measured[rows]
    if not sequence and not done.all():
        row = int(done.argmin())
        raise commands.file.error(
            row + 2,
            f'{commands.table.name(row)}: {file.path.name} has no such measurement',
            'add it there or remove this row',
        )


def _quaternions(file: CsvFile, table: Table, seen: NDArray[np.bool_]) -> FloatArray:
    """Return unit quaternions, (n, 4)."""
    q = np.stack([table.numbers[name] for name in ORIENTATION], axis=1)
    missing = np.isnan(q)
    _refuse(
        file,
        missing.any(axis=1) & ~missing.all(axis=1),
        'only part of the quaternion is there',
        'write qx, qy, qz and qw, or leave all four empty',
    )
    _refuse(
        file,
        ~missing.all(axis=1) & ~seen,
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
