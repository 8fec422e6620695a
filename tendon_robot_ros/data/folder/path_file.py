"""Paths to follow: rows of tip targets, or of tensions or wire pulls, from a CSV file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...common.errors import DataSetError
from ..dataset import FloatArray
from .csv_file import CsvFile

PLACE, VIEW = ('x', 'y', 'z'), ('dx', 'dy', 'dz')
NO_PATH = 'name a CSV file of targets, or a recording'


@dataclass(frozen=True)
class TipRows:
    """Targets of the tip; `held` says that each one stands until the next."""

    times: FloatArray | None  # (n,) [s] from 0, None: as fast as the limits allow
    positions: FloatArray  # (n, 3) [m]
    directions: FloatArray  # (n, 3) unit vectors, NaN where none is asked
    held: bool = False


@dataclass(frozen=True)
class TendonRows:
    """Values of the robot's inputs over time."""

    times: FloatArray  # (n,) [s] from 0
    values: FloatArray  # (n, m) [N] or [m]


def read_path(path: str | Path, inputs: tuple[str, ...]) -> TipRows | TendonRows:
    """
    Read a CSV file of targets.

    Columns are x, y, z [m] in the base frame, and as you like dx, dy, dz (approach direction, of
    any length; empty cells: none) and time [s]; or time [s] and the robot's inputs [N] or [m].

    Parameters
    ----------
    path : str or Path
        The file.
    inputs : tuple of str
        Names of the robot's inputs.

    Raises
    ------
    DataSetError
        With row, what is wrong, and what to do.

    """
    path = Path(path)
    missing = 'write a number, or leave dx, dy and dz empty for no direction'
    if _names(path) & set(inputs):
        columns = ('time', *inputs)
        file = CsvFile(path, columns, columns, 'write a number', NO_PATH)
        table = file.read((), file.header).numbers
        values = np.column_stack([table[name] for name in inputs])
        _no_gaps(file, np.column_stack([table['time'], values]))
        return TendonRows(_times(file, table['time']), values)
    file = CsvFile(path, PLACE, ('time', *PLACE, *VIEW), missing, NO_PATH)
    table = file.read((), file.header).numbers
    positions = np.column_stack([table[name] for name in PLACE])
    times = table.get('time')
    _no_gaps(file, positions if times is None else np.column_stack([times, positions]))
    return TipRows(
        None if times is None else _times(file, times),
        positions,
        _directions(file, [table.get(name) for name in VIEW], len(positions)),
    )


def _names(path: Path) -> set[str]:
    """Look at the header; what is wrong with the file is said when it is read."""
    try:
        with path.open(encoding='utf-8-sig') as file:
            return {cell.strip(' "\n') for cell in file.readline().split(',')}
    except (OSError, UnicodeDecodeError):
        return set()


def _no_gaps(file: CsvFile, values: FloatArray) -> None:
    empty = np.flatnonzero(np.isnan(values).any(axis=1))
    if len(empty):
        raise file.error(int(empty[0]) + 2, 'a cell is empty', 'write a number')


def _times(file: CsvFile, times: FloatArray) -> FloatArray:
    back = np.flatnonzero(np.diff(times) <= 0.0)
    if len(back):
        raise file.error(
            int(back[0]) + 3, 'time does not grow', 'write the time of every row after the last'
        )
    shifted: FloatArray = times - times[0]
    return shifted


def _directions(file: CsvFile, columns: list[FloatArray | None], count: int) -> FloatArray:
    if all(column is None for column in columns):
        return np.full((count, 3), np.nan)
    present = [column for column in columns if column is not None]
    if len(present) < 3:
        raise DataSetError(str(file.path), 'a direction needs dx, dy and dz', 'add the columns')
    values = np.column_stack(present)
    missing = np.isnan(values)
    half = np.flatnonzero(missing.any(axis=1) & ~missing.all(axis=1))
    if len(half):
        raise file.error(int(half[0]) + 2, 'half a direction', 'write dx, dy and dz, or none')
    sizes = np.linalg.norm(values, axis=1)
    if np.any(sizes < 1e-6):
        row = int(np.flatnonzero(sizes < 1e-6)[0])
        raise file.error(row + 2, 'the direction is zero', 'write where the tip looks')
    return values / sizes[:, None]


def write_path(path: Path, rows: TipRows | TendonRows, inputs: tuple[str, ...]) -> None:
    """Write a CSV file that `read_path` gives back."""
    if isinstance(rows, TendonRows):
        names, values = list(inputs), rows.values
    else:
        names, values = [*PLACE, *VIEW], np.hstack([rows.positions, rows.directions])
    if rows.times is not None:
        names, values = ['time', *names], np.column_stack([rows.times, values])
    lines = [','.join(names)]
    values = np.round(values, 9) + 0.0  # no minus before a zero
    lines += [','.join('' if np.isnan(v) else f'{v:.9g}' for v in row) for row in values]
    path.write_text('\n'.join(lines) + '\n', encoding='utf-8')
