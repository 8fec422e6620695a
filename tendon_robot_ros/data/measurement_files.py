"""inputs.csv and shapes.csv: the commands, and the measured positions of the markers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..common.arrays import Bools, Floats, Ints
from ..common.errors import DataSetError
from ..common.words import listing
from ..robot import Robot
from .arrays import PLAUSIBLE_FACTOR, POSITION, QUATERNION, VALUES_MAX, mean_inputs, too_tense
from .csv_file import NEEDED, CsvFile
from .visits import STRAIGHT, Split, split_by_order, split_by_origin

VISIT, ORIGIN = HISTORY = ('visit', 'previous')  # columns of the history of a posture


class Commands(CsvFile):
    """
    The R rows of inputs.csv, checked.

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

    def __init__(
        self, path: Path, robot: Robot, kind: str, visits: bool = False, remedy: str = NEEDED
    ) -> None:
        wires = {wire for wound in robot.drums.values() for wire in wound}
        required = ('posture', *(name for name in robot.inputs if name not in wires))
        drums = tuple(robot.drums) if kind == 'displacement' else ()
        known = ('posture', 'trial', *robot.inputs, *drums, *HISTORY)
        super().__init__(path, required, known, 'write the value that was set', remedy)
        check_history(self, visits)
        check_drums(self, robot)
        names = ('posture', 'trial') if 'trial' in self.header else ('posture',)
        self.read(names, [ORIGIN] if ORIGIN in self.header else [])
        self.values = wound(self, robot)  # (R, m) [N] or [m], NaN = slack
        _check(self, self.values, robot, kind)
        self.visit = visits_of(self)  # (R,) order of the visits; None: not in the file
        self.origin = origins(self)  # (R,) index of the posture before, `STRAIGHT` for none
        self.postures = self.labels['posture']  # (P,) in the order of the file
        # None where the values hold for all trials of a posture
        self.trials = self.labels.get('trial')

    def by_posture(self, trials: tuple[str, ...]) -> tuple[Floats, Floats | None]:
        """
        Return the values of postures, (P, m), and of their trials where these differ, (P, Q, m).

        Raises
        ------
        DataSetError
            A tendon is slack in some trials of a posture and pulled in others.

        """
        if self.trials is None:
            return self.values, None
        each = np.full((len(self.postures), len(trials), self.values.shape[1]), np.inf)
        each[self.codes['posture'], self.translate('trial', trials)] = self.values
        return mean_inputs(each, ~np.isinf(each[..., 0]), self.postures, str(self.path))

    def by_history(self, trials: tuple[str, ...], seen: Bools) -> tuple[Split, Ints | None]:
        """
        Split the postures by the command before; return the trial (R,) of each row, too.

        `seen` (P, Q) says in which trials a marker was visible; rows hold for all trials where
        None is returned.
        """
        posture = self.codes['posture']
        trial = None if self.trials is None else self.translate('trial', trials)
        measured = seen.any(axis=1)[posture] if trial is None else seen[posture, trial]
        if self.origin is not None:
            return split_by_origin(self.postures, posture, self.origin, measured), trial
        assert self.visit is not None and trial is not None
        order = np.argsort(self.visit)
        trial = trial[order]
        return split_by_order(self.postures, posture[order], trial, measured[order]), trial


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


def wound(file: CsvFile, robot: Robot) -> Floats:
    """Return the values of the inputs (R, m); a drum winds each of its wires."""
    for drum in (name for name in robot.drums if name in file.numbers):
        remedy = 'a drum is never slack: write its pull'
        file.refuse(np.isnan(file.numbers[drum]), f'{drum} is empty', remedy)
    columns = robot.wound(file.numbers)
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


def visits_of(file: CsvFile) -> Ints | None:
    """Return the numbers of the visits (R,), None where the file has none."""
    if VISIT not in file.numbers:
        return None
    visit = file.numbers[VISIT]
    whole = np.isfinite(visit) & (visit == np.round(visit)) & (np.abs(visit) < 2**53)
    file.refuse(~whole, 'visit is no whole number', 'count the visits')
    again = np.ones(len(visit), dtype=bool)
    again[np.unique(visit, return_index=True)[1]] = False
    problem = f'visit {visit[again.argmax()]:.0f} stands twice'
    file.refuse(again, problem, 'give every visit its own number')
    return np.asarray(visit, dtype=np.int64)


def origins(file: CsvFile) -> Ints | None:
    """Return the index of the posture before (R,), None if the file has no such column."""
    if ORIGIN not in file.labels:
        return None
    postures = file.labels['posture']
    origin = file.translate(ORIGIN, (*postures, ''))
    unknown = origin < 0
    problem = f'previous is {file.label(int(unknown.argmax()), ORIGIN)!r}, which no row describes'
    remedy = f'use one of {listing(postures)}, or leave it empty: from the straight arm'
    file.refuse(unknown, problem, remedy)
    return np.where(origin == len(postures), STRAIGHT, origin)


def _check(file: CsvFile, values: Floats, robot: Robot, kind: str) -> None:
    def refuse(where: Bools, problem: str, remedy: str) -> None:
        if where.any():
            row, column = np.argwhere(where)[0]
            text = problem.format(name=robot.inputs[column], value=values[row, column])
            raise file.error(int(row) + 2, text, remedy)

    if kind == 'displacement':
        long = f'the robot is only {robot.length:g} m long'
        problem = f'{{name}} is pulled by {{value:g}} m, but {long}'
        refuse(np.abs(values) > robot.length, problem, 'write metres (is it in mm?)')
        return
    limit = robot.tension_limits[1]
    remedy = 'write 0 for a slack tendon (an empty cell means slack only with input: displacement)'
    refuse(np.isnan(values), '{name} is empty', remedy)
    refuse(values < 0.0, '{name} is {value:g} N', 'a tendon cannot push: write 0 or more')
    beyond = values > PLAUSIBLE_FACTOR * limit
    if beyond.any():
        refuse(beyond, *too_tense('{name}', float(values[beyond][0]), limit))


KEYS = ('posture', 'trial', 'marker')
Places = tuple[Ints, Ints, Bools, tuple[str, ...]]


def read_shapes(
    path: Path, robot: Robot, markers: tuple[str, ...], commands: Commands, sequence: bool
) -> dict[str, Any]:
    """
    Read and check shapes.csv, in the order of the postures of inputs.csv.

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

    Returns
    -------
    dict
        The trials, positions and orientations of a `DataSet`, NaN where nothing was seen.

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
        problem = f'{", ".join(turned)} alone are no quaternion'
        raise file.error(1, problem, f'write {", ".join(QUATERNION)}, or none of them')
    file.read(KEYS)
    xyz = _positions(file, robot)
    trials = sort_trials((*file.labels['trial'], *(commands.trials or ())))
    posture = _known(file, 'posture', commands.postures, 'inputs.csv has no such posture')
    marker = _known(file, 'marker', markers, 'dataset.yaml has no such marker')
    trial = file.translate('trial', trials)
    sizes = len(commands.postures), len(trials), len(markers)
    if np.prod(sizes, dtype=float) > VALUES_MAX:
        problem = '{} postures x {} trials x {} markers are too many'.format(*sizes)
        raise DataSetError(str(path), problem, 'count the trials of every posture from 0')
    visible = ~np.isnan(xyz[:, 0])
    _check_trials(file, commands, (posture, trial, visible, trials), sequence)
    arrays = {'positions': xyz} | ({'orientations': _quaternions(file, visible)} if turned else {})
    for key, rows in arrays.items():
        arrays[key] = np.full((*sizes, rows.shape[1]), np.nan)
        arrays[key][posture, trial, marker] = rows
    return {'trial_names': trials, **arrays}


def _known(file: CsvFile, key: str, known: tuple[str, ...], problem: str) -> Ints:
    places = file.translate(key, known)
    name = file.label(int((places < 0).argmax()), key)
    file.refuse(places < 0, f'{key} {name!r}: {problem}', f'use one of {listing(known)}')
    return places


def _positions(file: CsvFile, robot: Robot) -> Floats:
    remedy = 'write all three, or leave all three empty where the marker was not seen'
    xyz = file.all_or_none(POSITION, 'only part of x, y, z is there', remedy)
    beyond = (np.abs(xyz) > PLAUSIBLE_FACTOR * robot.length).any(axis=1)
    far = np.abs(xyz[int(beyond.argmax())]).max()
    problem = f'the marker is {far:g} m away, but the robot is only {robot.length:g} m long'
    file.refuse(beyond, problem, 'write metres in the base frame (are these mm?)')
    return xyz


def sort_trials(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return each trial name once: numbers in order, others as they appear."""
    unique = tuple(dict.fromkeys(names))
    if all(name.isascii() and name.isdigit() and len(name) < 19 for name in unique):
        return tuple(sorted(unique, key=int))
    return unique


def _check_trials(file: CsvFile, commands: Commands, places: Places, sequence: bool) -> None:
    """Refuse trials without a measurement, measurements without inputs and the reverse."""
    posture, trial, visible, trials = places
    measured = np.zeros((len(commands.postures), len(trials)), dtype=bool)
    measured[posture[visible], trial[visible]] = True

    def refuse(where: Bools, problem: str, remedy: str) -> None:
        file.refuse(where, f'{file.name(int(where.argmax()), *KEYS[:2])}: {problem}', remedy)

    refuse(~measured[posture, trial], 'no marker was seen in this trial', 'remove its rows')
    rows = commands.codes['posture']
    if commands.trials is None:
        is_measured = measured.any(axis=1)[rows]
    else:
        trial_rows = commands.translate('trial', trials)
        commanded = np.zeros_like(measured)
        commanded[rows, trial_rows] = True
        remedy = 'add its inputs there or remove its rows here'
        refuse(~commanded[posture, trial], 'inputs.csv has no row for this trial', remedy)
        is_measured = measured[rows, trial_rows]
    if not sequence:
        name = commands.name(int(is_measured.argmin()))
        problem = f'{name}: {file.path.name} has no such measurement'
        commands.refuse(~is_measured, problem, 'add it there or remove this row')


def _quaternions(file: CsvFile, visible: Bools) -> Floats:
    """Return unit quaternions, (n, 4)."""
    remedy = 'write qx, qy, qz and qw, or leave all four empty'
    q = file.all_or_none(QUATERNION, 'only part of the quaternion is there', remedy)
    remedy = 'write x, y, z too, or leave the quaternion empty'
    file.refuse(np.isfinite(q[:, 0]) & ~visible, 'an orientation without a position', remedy)
    norm = np.linalg.norm(q, axis=1)
    file.refuse(norm < 1e-6, 'the quaternion is zero', 'leave it empty where it is unknown')
    remedy = 'write qx, qy, qz, qw of a unit quaternion, in this order'
    file.refuse(np.abs(norm - 1.0) > 0.05, 'the quaternion is not of length 1', remedy)
    return q / norm[:, None]
