"""Columns of inputs.csv beside the inputs: drums that wind several wires, visits, origins."""

from __future__ import annotations

import numpy as np

from ...common.words import listing
from ...robot import Robot
from ..dataset import FloatArray
from ..visits import STRAIGHT
from .csv_file import CsvFile, IntArray, Table

VISIT, ORIGIN = HISTORY = ('visit', 'previous')  # columns that tell how the arm came to a posture


def check_drums(file: CsvFile, robot: Robot) -> None:
    """Refuse a drum beside its wires, and one of which neither stands there."""
    for drum, wound in robot.drums.items():
        there = [wire for wire in wound if wire in file.header]
        if drum in file.header and there:
            problem = f'drum {drum!r} and its wire {there[0]!r} both have a column'
            raise file.error(1, problem, 'keep one of them')
        if drum not in file.header and len(there) < len(wound):
            missing = next(wire for wire in wound if wire not in there)
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
    """Refuse columns of a history that dataset.yaml does not speak of, and the reverse."""
    there = [name for name in HISTORY if name in file.header]
    if there and not visits:
        remedy = 'write path: visits in dataset.yaml, or remove the column'
        raise file.error(1, f'column {there[0]!r} tells of visits', remedy)
    if visits and len(there) != 1:
        problem = 'visit and previous both' if there else 'neither visit nor previous'
        remedy = 'write visit (its number in the order of visits) or previous (posture before)'
        raise file.error(1, f'with path: visits there is {problem}', remedy)
    if VISIT in there and 'trial' not in file.header:
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
    """Return the index of the posture before (R,), None where the file does not say."""
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
