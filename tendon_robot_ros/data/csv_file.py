"""
Strict reading of CSV files: columns at a million rows a second; refusals name rows.

A file is read in blocks of lines, each parsed at once; only a block that cannot be parsed is read
cell by cell, so that the error names the row.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Sequence
from itertools import batched
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.arrays import ROWS_AT_ONCE, Bools, Floats, Ints
from ..common.errors import DataSetError, short
from ..common.words import listing

NEEDED = 'every data set needs this file'
EMPTY_CELL = re.compile(r',(?=[,\n]|\Z)')
EMPTY_ROW = re.compile('^,+$', re.M)
Block = NDArray[np.void]  # rows of a CSV file: names as text, numbers as floats


def csv_text(path: Path, remedy: str) -> str:
    """
    Return the text of a CSV file.

    Raises
    ------
    DataSetError
        There is no such file, or it is no text: with what to do.

    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise DataSetError(str(path), f'cannot be read ({error.strerror})', remedy) from None
    is_text = content.partition(b'\0')[0]  # up to where it is no text
    try:
        text = content.decode('utf-8')
    except UnicodeDecodeError as error:
        is_text = is_text[: error.start]
    if len(is_text) < len(content):
        where = f'{path}, row {is_text.count(b"\n") + 1}'
        raise DataSetError(where, 'this is no UTF-8 text', 'save the file as "CSV UTF-8"')
    return text.removeprefix('\ufeff').replace('\r\n', '\n').replace('\r', '\n')


class CsvFile:
    """
    A CSV file with a header; once it is read, its columns of n rows, row i in line i + 2.

    Attributes
    ----------
    header : list of str
        Names of the columns.
    codes : dict of (n,)
        Indices into `labels`, per column of names.
    labels : dict of tuple of str
        In the order in which they appear.
    numbers : dict of (n,)
        NaN where the cell is empty.

    """

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
        line, _, self._rows = csv_text(path, remedy).partition('\n')
        if not line.strip():
            remedy = f'start it with the line {",".join(required)}'
            raise DataSetError(str(path), 'is empty', remedy)
        self.header = self._header(line, required, known)
        self.codes: dict[str, Ints] = {}
        self.labels: dict[str, tuple[str, ...]] = {}
        self.numbers: dict[str, Floats] = {}

    def error(self, row: int, problem: str, remedy: str) -> DataSetError:
        """Build the error for a row, counted from 1 for the header."""
        return DataSetError(f'{self.path}, row {row}', problem, remedy)

    def refuse(self, where: Bools, problem: str, remedy: str) -> None:
        """Raise the error for the first row (n,) where something holds."""
        if where.any():
            raise self.error(int(where.argmax()) + 2, problem, remedy)

    def columns(self, names: Iterable[str]) -> Floats:
        """Return columns of numbers, (n, c)."""
        return np.stack([self.numbers[name] for name in names], axis=1)

    def all_or_none(self, names: Sequence[str], problem: str, remedy: str) -> Floats:
        """Return columns of numbers, (n, c); refuse a row where only some of them are empty."""
        values = self.columns(names)
        empty = np.isnan(values)
        self.refuse(empty.any(axis=1) & ~empty.all(axis=1), problem, remedy)
        return values

    def name(self, row: int, *keys: str) -> str:
        """Name a row for a message by its names (in all name columns by default)."""
        return ', '.join(f'{key} {self.label(row, key)!r}' for key in keys or self.labels)

    def label(self, row: int, key: str) -> str:
        """Return the name in a cell."""
        return self.labels[key][int(self.codes[key][row])]

    def translate(self, key: str, known: tuple[str, ...]) -> Ints:
        """Return the index of each row's name among the known ones, (n,), -1 for others."""
        places = {name: place for place, name in enumerate(known)}
        table = np.array([places.get(label, -1) for label in self.labels[key]], dtype=np.int64)
        return table[self.codes[key]]

    def read(self, names: Sequence[str], remarks: Sequence[str] = ()) -> CsvFile:
        """
        Read the rows below the header, and return the file.

        Parameters
        ----------
        names, remarks : sequence of str
            Columns to read as names, and as names that may be empty and repeat; all others
            hold numbers.

        Raises
        ------
        DataSetError
            A row has too many or too few cells, a name is empty, a number is none, or the same
            names stand in two rows.

        """
        text = self._rows.rstrip()
        if not text:
            raise self.error(2, 'there is no row below the header', 'write one row per value')
        texts = (*names, *remarks)
        numbers = [key for key in self.header if key not in texts]
        labels: dict[str, dict[str, int]] = {key: {} for key in texts}
        parts: dict[str, list[Any]] = {key: [] for key in self.header}
        dtype = np.dtype([(key, float if key in numbers else object) for key in self.header])
        row = 2
        for lines in batched(text.split('\n'), ROWS_AT_ONCE):
            block = _parse(lines, dtype)
            if block is None:
                block = self._parse_exactly(lines, row, dtype)
            for key, known in labels.items():
                cells = block[key].tolist()
                codes = [known.setdefault(cell.strip(), len(known)) for cell in cells]
                parts[key].append(np.array(codes))
            for key in numbers:
                parts[key].append(block[key].copy())  # contiguous, and frees the block
            row += len(lines)
        self.codes = {key: np.concatenate(parts[key]) for key in texts}
        self.labels = {key: tuple(known) for key, known in labels.items()}
        self.numbers = {key: np.concatenate(parts[key]) for key in numbers}
        for key in names:
            if '' in labels[key]:
                empty = self.codes[key] == labels[key]['']
                self.refuse(empty, f'{key} is empty', f'write a {key}')
        if names:
            self._refuse_repeated(names)
        return self

    def _refuse_repeated(self, names: Sequence[str]) -> None:
        """Refuse rows of the same names."""
        sizes = [len(self.labels[key]) for key in names]
        index = np.ravel_multi_index([self.codes[key] for key in names], sizes)
        first = np.unique(index, return_index=True)[1]
        if len(first) < len(index):
            row = int(np.setdiff1d(np.arange(len(index)), first)[0])
            before = int(np.flatnonzero(index == index[row])[0])
            problem = f'{self.name(row, *names)} stands in row {before + 2} too'
            raise self.error(row + 2, problem, 'remove one of them')

    def _header(self, line: str, required: Sequence[str], known: Sequence[str]) -> list[str]:
        for mark, name in ((';', 'semicolons'), ('\t', 'tabs')):
            if mark in line and ',' not in line:
                remedy = 'export with commas between columns and points in numbers'
                raise self.error(1, f'columns are separated by {name}', remedy)
        header = [cell.strip(' "\n') for cell in line.split(',')]
        if not set(header) & set(required):
            remedy = f'start the file with the line {",".join(required)}'
            raise self.error(1, 'this is no header', remedy)
        for name in header:
            if header.count(name) > 1:
                raise self.error(1, f'column {short(name)} stands twice', 'keep one of them')
            if name not in known:
                remedy = f'rename it to one of {listing(known)}'
                raise self.error(1, f'column {short(name)} is unknown', remedy)
        for name in required:
            if name not in header:
                raise self.error(1, f'column {name!r} is missing', 'add it to the header')
        return header

    def _parse_exactly(self, lines: Sequence[str], row: int, dtype: np.dtype[Any]) -> Block:
        """Parse lines cell by cell; the error names the row and column of a bad cell."""
        reader = csv.reader(lines, strict=True)
        try:
            rows = list(reader)
        except csv.Error:
            rows = []
        if len(rows) != len(lines):
            odd = (i for i, line in enumerate(lines) if line.count('"') % 2)
            place = next(odd, reader.line_num - 1)
            problem, remedy = 'the quotation marks do not fit', 'remove all that are on this line'
            raise self.error(row + place, problem, remedy)
        numbers = [key for key in self.header if dtype[key].kind == 'f']
        block = np.empty(len(rows), dtype)
        for place, cells in enumerate(rows):
            if not ''.join(cells).strip():
                raise self.error(row + place, 'the line is empty', 'remove it')
            if len(cells) != len(self.header):
                problem = f'{len(cells)} cells under {len(self.header)} columns'
                remedy = 'write every column, missing values as empty cells, and points in numbers'
                raise self.error(row + place, problem, remedy)
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


def _parse(lines: Sequence[str], dtype: np.dtype[Any]) -> Block | None:
    """Parse lines of valid numbers; empty cells become NaN. None: use `_parse_exactly`."""
    text, missing = '\n'.join(lines), 0
    if ',,' in text or ',\n' in text or text.endswith(','):
        if '"' in text or 'nan' in text.lower() or EMPTY_ROW.search(text):
            return None
        text, missing = EMPTY_CELL.subn(',nan', text)
        lines = text.split('\n')
    try:
        block = np.loadtxt(lines, dtype, delimiter=',', comments=None, quotechar='"', ndmin=1)
    except ValueError:
        return None
    keys = [key for key in dtype.names or () if dtype[key].kind == 'f']
    finite = sum(np.count_nonzero(np.isfinite(block[key])) for key in keys)
    if len(block) != len(lines) or finite + missing != len(keys) * len(block):
        return None  # a line is blank, a name is missing, or a number is not finite
    return block
