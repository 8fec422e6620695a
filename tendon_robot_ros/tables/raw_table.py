"""Named columns of numbers, as they were found in a file."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.errors import DataSetError, short

FloatArray = NDArray[np.float64]
MISSING = ('', 'nan', 'NaN', 'NAN', 'NA', 'N/A', 'null', 'None', '-', '--')


@dataclass(frozen=True, eq=False)
class RawTable:
    """Named columns of R rows, as they were found."""

    name: str  # the file, as the user wrote it
    columns: dict[str, FloatArray]  # (R,) numbers, NaN = not there
    texts: dict[str, tuple[str, ...]] = field(default_factory=dict)  # (R,) other columns
    units: dict[str, str] = field(default_factory=dict)  # column -> unit, where the file says it
    first: int | None = None  # row of the file that the first row of numbers stands in
    up: str | None = None  # axis that points up, where the format has one
    notes: tuple[str, ...] = ()  # what was assumed on reading

    def __len__(self) -> int:
        """Count the rows."""
        sizes = [len(values) for values in self.columns.values()]
        return (sizes or [len(texts) for texts in self.texts.values()])[0]

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.columns) + len(self.texts)

    def where(self, row: int) -> str:
        """Name a row for a message, counted as an editor does."""
        return f'{self.name}, row {row + (1 if self.first is None else self.first)}'

    def numbers(self, column: str, expected: str = 'a number') -> FloatArray:
        """
        Return a column (R,) of numbers.

        Raises
        ------
        DataSetError
            A cell is none: which, and what stands there.

        """
        if column in self.columns:
            return self.columns[column]
        for row, text in enumerate(self.texts[column]):
            if text not in MISSING and not is_number(text):
                raise DataSetError(
                    self.where(row),
                    f'{column} is {short(text)}',
                    f'expected {expected}, or an empty cell where there is none',
                )
        return np.array([float(t) if t not in MISSING else np.nan for t in self.texts[column]])


def is_number(text: str) -> bool:
    """Tell whether a cell holds a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def from_frame(frame: Any, name: str = 'DataFrame') -> RawTable:
    """Return the table of a pandas DataFrame."""
    return table_of(name, frame, {}, None, ())


def table_of(
    name: str, frame: Any, units: dict[str, str], first: int | None, notes: tuple[str, ...]
) -> RawTable:
    """Sort the columns of a frame into numbers and texts."""
    if not len(frame):
        raise DataSetError(name, 'has no row below its header', 'export it again')
    columns, texts = {}, {}
    for column in frame.columns:
        values = frame[column]
        if values.dtype.kind in 'fiub':
            columns[str(column)] = values.to_numpy(dtype=float)
        elif values.dtype.kind in 'mM':
            columns[str(column)] = (values - values.iloc[0]).dt.total_seconds().to_numpy()
            units[str(column)] = 's'
        else:
            texts[str(column)] = tuple(values.astype(object).fillna('').astype(str).str.strip())
    return RawTable(name, columns, texts, units, first, notes=notes)
