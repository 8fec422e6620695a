"""
Strict reading of CSV files: columns at a million rows a second; refusals name rows.

A file is read in blocks of lines, each parsed at once; only a block that cannot be parsed is read
cell by cell, so that the error names the row.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from ..common.errors import DataSetError, short
from ..common.words import listing
from .dataset import FloatArray

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Table:
    """Columns of n rows; row i stands in line i + 2 of the file."""

    codes: dict[str, IntArray]  # (n,) index into labels, per name column
    labels: dict[str, tuple[str, ...]]  # in the order in which they appear
    numbers: dict[str, FloatArray]  # (n,), NaN where the cell is empty

    def name(self, row: int, *keys: str) -> str:
        """Name a row for a message by its names (in all name columns by default)."""
        return ', '.join(
            f'{key} {self.labels[key][self.codes[key][row]]!r}' for key in keys or self.labels
        )

    def repeated(self, keys: Sequence[str]) -> tuple[int, int] | None:
        """Return the first row whose names repeat those of an earlier row, and that row."""
        if not keys:
            return None
        index = np.zeros(len(self.codes[keys[0]]), dtype=np.int64)
        for key in keys:
            index = index * len(self.labels[key]) + self.codes[key]
        order = np.argsort(index, kind='stable')
        same = np.flatnonzero(index[order][1:] == index[order][:-1])
        if not len(same):
            return None
        row = int(order[same + 1].min())
        return row, int(np.flatnonzero(index == index[row])[0])

    def translate(self, key: str, known: tuple[str, ...]) -> IntArray:
        """Return the index of each row's name among the known ones, (n,), -1 for others."""
        places = {name: place for place, name in enumerate(known)}
        table = np.array([places.get(label, -1) for label in self.labels[key]], dtype=np.int64)
        return table[self.codes[key]]


class Labels(dict[str, int]):
    """Cell text to code; a new text gets the next code, spaces around it do not count."""

    def __init__(self) -> None:
        super().__init__()
        self.index: dict[str, int] = {}

    def __missing__(self, cell: str) -> int:
        code = self[cell] = self.index.setdefault(cell.strip(), len(self.index))
        return code


NEEDED = 'every data set needs this file'
BLOCK_CHARACTERS = 1 << 19  # [1] that are parsed at once, so that they stay in the cache
Block = NDArray[np.void]  # rows of a CSV file: names as text, numbers as floats


def first_line(path: Path, remedy: str) -> str:
    """
    Return the first line of a CSV file.

    Raises
    ------
    DataSetError
        There is no such file, or it is no text: with what to do.

    """
    try:
        with path.open(encoding='utf-8-sig') as file:
            line = file.readline()
    except UnicodeDecodeError:
        raise _no_text(path) from None
    except OSError as error:
        raise DataSetError(str(path), f'cannot be read ({error.strerror})', remedy) from None
    if '\0' in line:
        raise _no_text(path)
    return line


def _no_text(path: Path) -> DataSetError:
    """Build the error for a file that is no text, with the row where that begins."""
    content = path.read_bytes()
    place = content.find(b'\0') % (len(content) + 1)  # the end when there is none
    try:
        content.decode('utf-8')
    except UnicodeDecodeError as error:
        place = min(place, error.start)
    row = content[:place].count(b'\n') + 1
    return DataSetError(
        f'{path}, row {row}', 'this is no UTF-8 text', 'save the file as "CSV UTF-8"'
    )


class CsvFile:
    """A CSV file with a header; remembers its path for messages."""

    def __init__(
        self,
        path: Path,
        required: Sequence[str],
        known: Sequence[str],
        missing: str,
        remedy: str = NEEDED,
    ) -> None:
        """
        Read and check the header.

        Parameters
        ----------
        path : Path
            The file.
        required, known : sequence of str
            Columns that there must be, and that there may be.
        missing : str
            What to do where somebody wrote nan, for the message.
        remedy : str
            What to do where there is no such file.

        Raises
        ------
        DataSetError
            The file is missing, empty or no CSV text, or its columns are not the known ones.

        """
        self.path, self._missing = path, missing
        line = first_line(path, remedy)
        if not line.strip():
            raise DataSetError(
                str(path), 'is empty', f'start it with the line {",".join(required)}'
            )
        self.header = self._header(line, required, known)

    def error(self, row: int, problem: str, remedy: str) -> DataSetError:
        """Build the error for a row, counted from 1 for the header."""
        return DataSetError(f'{self.path}, row {row}', problem, remedy)

    def read(
        self, names: Sequence[str], numbers: Sequence[str], remarks: Sequence[str] = ()
    ) -> Table:
        """
        Read the rows below the header.

        Parameters
        ----------
        names, numbers, remarks : sequence of str
            Columns to read as names, as numbers, and as names that may be empty and repeat:
            together all columns of the file.

        Raises
        ------
        DataSetError
            A row has too many or too few cells, a name is empty, a number is none, or the same
            names stand in two rows.

        """
        texts = (*names, *remarks)
        labels = {key: Labels() for key in texts}
        codes: dict[str, list[IntArray]] = {key: [] for key in texts}
        values: dict[str, list[FloatArray]] = {key: [] for key in numbers}
        dtype = np.dtype([(key, float if key in numbers else object) for key in self.header])
        row = 2
        try:
            with self.path.open(encoding='utf-8-sig') as file:
                file.readline()
                for lines in _blocks(file):
                    block = _parse(lines, dtype)
                    if block is None:
                        block = self._parse_exactly(lines, row, dtype)
                    for key in texts:
                        cells = block[key].tolist()
                        codes[key].append(np.array([*map(labels[key].__getitem__, cells)]))
                    for key in numbers:
                        values[key].append(block[key].copy())  # contiguous, and frees the block
                    row += len(lines)
        except UnicodeDecodeError:
            raise _no_text(self.path) from None
        if row == 2:
            raise self.error(2, 'there is no row below the header', 'write one row per value')
        table = Table(
            {key: np.concatenate(parts) for key, parts in codes.items()},
            {key: tuple(label.index) for key, label in labels.items()},
            {key: np.concatenate(parts) for key, parts in values.items()},
        )
        for key in names:
            if '' in table.labels[key]:
                empty = table.codes[key] == table.labels[key].index('')
                raise self.error(int(empty.argmax()) + 2, f'{key} is empty', f'write a {key}')
        if repeated := table.repeated(names):
            row, first = repeated
            raise self.error(
                row + 2,
                f'{table.name(row, *names)} stands in row {first + 2} too',
                'remove one of them',
            )
        return table

    def _header(self, line: str, required: Sequence[str], known: Sequence[str]) -> list[str]:
        for mark, name in ((';', 'semicolons'), ('\t', 'tabs')):
            if mark in line and ',' not in line:
                raise self.error(
                    1,
                    f'columns are separated by {name}',
                    'export with commas between columns and points in numbers',
                )
        header = [cell.strip(' "\n') for cell in line.split(',')]
        if not set(header) & set(required):
            raise self.error(
                1, 'this is no header', f'start the file with the line {",".join(required)}'
            )
        for name in header:
            if header.count(name) > 1:
                raise self.error(1, f'column {short(name)} stands twice', 'keep one of them')
            if name not in known:
                raise self.error(
                    1, f'column {short(name)} is unknown', f'rename it to one of {listing(known)}'
                )
        for name in required:
            if name not in header:
                raise self.error(1, f'column {name!r} is missing', 'add it to the header')
        return header

    def _parse_exactly(self, lines: list[str], row: int, dtype: np.dtype[Any]) -> Block:
        """Parse lines cell by cell; the error names the row and column of a bad cell."""
        if any('\0' in line for line in lines):
            raise _no_text(self.path)
        try:
            rows = list(csv.reader(lines, strict=True))
        except csv.Error:
            rows = []
        if len(rows) != len(lines):
            place = next((i for i, line in enumerate(lines) if line.count('"') % 2), 0)
            raise self.error(
                row + place, 'the quotation marks do not fit', 'remove all that are on this line'
            )
        numbers = [key for key in self.header if dtype[key].kind == 'f']
        block = np.empty(len(rows), dtype)
        for place, cells in enumerate(rows):
            if not ''.join(cells).strip():
                raise self.error(row + place, 'the line is empty', 'remove it')
            if len(cells) != len(self.header):
                raise self.error(
                    row + place,
                    f'{len(cells)} cells under {len(self.header)} columns',
                    'write every column, missing values as empty cells, and points in numbers',
                )
            block[place] = tuple(
                self._float(cell.strip(), key, row + place) if key in numbers else cell
                for key, cell in zip(self.header, cells, strict=True)
            )
        return block

    def _float(self, cell: str, key: str, row: int) -> float:
        if not cell:
            return math.nan
        remedy = 'write a number with a decimal point'
        if cell.strip('+-').lower() in ('nan', 'inf', 'infinity', 'na', 'n/a', 'null', 'none'):
            remedy = self._missing
        try:
            value = float(cell) if cell.isascii() and '_' not in cell else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.error(row, f'{key} is {short(cell)}', remedy)
        return value


def _parse(lines: list[str], dtype: np.dtype[Any]) -> Block | None:
    """Parse lines of valid numbers; empty cells become NaN. None: use `_parse_exactly`."""
    text = ''.join(lines)
    filled = text
    if ',,' in text or ',\n' in text or not text.endswith('\n'):
        if '"' in text or 'nan' in text.lower():
            return None
        for empty in (',,', ',,', ',\n'):
            filled = filled.replace(empty, f',nan{empty[1]}')
        filled += 'nan' * filled.endswith(',')
        lines = filled.removesuffix('\n').split('\n')
    try:
        block = np.loadtxt(lines, dtype, delimiter=',', comments=None, quotechar='"', ndmin=1)
    except ValueError:
        return None
    keys = [key for key in dtype.names or () if dtype[key].kind == 'f']
    finite = sum(np.count_nonzero(np.isfinite(block[key])) for key in keys)
    missing = (len(filled) - len(text)) // len('nan')
    if len(block) != len(lines) or finite + missing != len(keys) * len(block):
        return None  # a line is blank, a name is missing, or a number is not finite
    return block


def _blocks(file: TextIO) -> Iterator[list[str]]:
    """Yield blocks of lines, without the blank lines at the end of the file."""
    blank: list[str] = []
    while more := file.readlines(BLOCK_CHARACTERS):
        lines, blank = blank + more, []
        while lines and not lines[-1].strip():
            blank.append(lines.pop())
        if lines:
            yield lines
