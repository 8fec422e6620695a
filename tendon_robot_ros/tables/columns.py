"""Named columns of numbers, as they were found in a file, and what each is, by name and unit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.errors import DataSetError, short
from ..common.units import Unit, find_unit, split_name
from ..common.words import listing

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


WORDS = re.compile(r'[^\W\d_]+|\d+')
AXES = ('x', 'y', 'z')
TIMES = {'time', 'timestamp', 'seconds', 'sec', 'zeit', 'stamp'}
FILLERS = {'pos', 'position', 'coord', 'coordinate', 'marker', 'markers', 'm', 'point', 'p'}
OTHER_TRIPLES = {'rotation', 'rot', 'quat', 'acc', 'gyro', 'force', 'moment', 'torque', 'vel',
                 'velocity', 'mag', 'unused'}  # fmt: skip
COMMANDED = {'cmd', 'command', 'commanded', 'set', 'setpoint', 'ref', 'target', 'des', 'desired',
             'goal', 'soll'}  # fmt: skip
# kinds of inputs, the first that is there is taken: tension acts on the arm, the others only
# tell it; then the words by which a column without a unit is one
KINDS: dict[str, set[str]] = {
    'force': {'tension', 'force', 't', 'f', 'load', 'loadcell', 'kraft', 'zugkraft'},
    'length': {'pull', 'displacement', 'disp', 'wire', 'cable', 'tendon', 'length'},
    'angle': {'angle', 'motor', 'servo'},
    'counts': {'encoder', 'enc', 'ticks', 'counts'},
    'current': {'current', 'i'},
}


@dataclass(frozen=True)
class ColumnUse:
    """A column that is taken, and its unit; '' where nobody says it."""

    column: str
    unit: str


@dataclass(frozen=True)
class ColumnName:
    """The name of a column, taken apart."""

    column: str
    words: tuple[str, ...]  # in lower case, letters and digits apart
    unit: Unit | None

    @property
    def axis(self) -> str:
        """Which coordinate it is by its last or first word, '' for none."""
        for word in (self.words[-1:], self.words[:1]):
            if word and word[0] in AXES:
                return word[0]
        return ''

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers in the name."""
        return tuple(int(word) for word in self.words if word.isdigit())

    @property
    def stem(self) -> tuple[str, ...]:
        """Words without numbers."""
        return tuple(word for word in self.words if not word.isdigit())


def names_of(table: RawTable) -> list[ColumnName]:
    """Take the names of all columns apart; units that the file says go before."""
    found = []
    for column in (*table.columns, *table.texts):
        name, unit = split_name(column)
        if column in table.units:
            unit = find_unit(table.units[column])
        words = tuple(word.lower() for word in WORDS.findall(name))
        found.append(ColumnName(column, words, unit))
    return found


def guess_time(names: Sequence[ColumnName]) -> ColumnUse | None:
    """Return the column of times, None where there is none."""
    for exact in (True, False):
        for name in names:
            if name.unit is not None and name.unit.kind != 'time':
                continue
            timed = name.words in (('t',), *((word,) for word in TIMES))
            timed = timed or (not exact and bool(TIMES & set(name.words)))
            timed = timed or (not exact and name.unit is not None and name.words[:1] == ('t',))
            if timed:
                return ColumnUse(name.column, '' if name.unit is None else name.unit.text)
    return None


def guess_markers(names: Sequence[ColumnName]) -> dict[str, tuple[str, str, str]]:
    """Return marker -> columns of x, y and z, in the order of the table."""
    groups: dict[tuple[str, ...], dict[str, str]] = {}
    for name in names:
        axis = name.axis
        if not axis or (name.unit is not None and name.unit.kind != 'length'):
            continue
        words = name.words[:-1] if name.words[-1] == axis else name.words[1:]
        if OTHER_TRIPLES & set(words):
            continue
        groups.setdefault(words, {}).setdefault(axis, name.column)
    whole = {words: axes for words, axes in groups.items() if set(axes) == set(AXES)}
    return {
        _marker_name(words, whole): (axes['x'], axes['y'], axes['z'])
        for words, axes in whole.items()
    }


def _marker_name(words: tuple[str, ...], all_of: Mapping[tuple[str, ...], object]) -> str:
    """Name a marker by the words that tell it from the others."""
    short = [word for word in words if word not in FILLERS] or list(words) or ['marker']
    others = [tuple(w for w in other if w not in FILLERS) for other in all_of]
    return ' '.join(short if others.count(tuple(short)) <= 1 else words)


def marker_label(columns: Sequence[str]) -> str:
    """Name a marker by the name of its first column without the axis."""
    words = WORDS.findall(split_name(columns[0])[0])
    if words and words[-1].lower() in AXES:
        words.pop()
    elif words and words[0].lower() in AXES:
        words.pop(0)
    return ' '.join(words) or columns[0]


@dataclass(frozen=True)
class InputGuess:
    """Columns of the inputs, and by what they were recognised."""

    columns: dict[str, ColumnUse]  # input -> column
    kind: str
    reason: str


def guess_inputs(names: Sequence[ColumnName], inputs: Sequence[str]) -> InputGuess | None:
    """
    Return the column of every input of a robot; None where they are not all found.

    Tensions go before wire pulls, these before angles and currents of motors; what was measured
    goes before what was commanded.
    """
    for kind in KINDS:
        groups: dict[tuple[str, ...], list[ColumnName]] = {}
        for name in names:
            if name.axis == '' and _kind(name) == kind:
                groups.setdefault(tuple(sorted(COMMANDED & set(name.words))), []).append(name)
        for group in sorted(groups):  # without such a word first: measured
            for find in (_by_name, _by_number, _by_order):
                if (found := find(groups[group], inputs, kind)) is not None:
                    return found
    named = [name for name in names if name.unit is None and not name.axis]
    return _by_name(named, inputs, '')


def _kind(name: ColumnName) -> str:
    if name.unit is not None:
        return name.unit.kind
    words = set(name.words)
    if TIMES & words:
        return 'time'
    return next((kind for kind, known in KINDS.items() if known & words), '')


def _guess(found: Sequence[ColumnName], inputs: Sequence[str], kind: str, why: str) -> InputGuess:
    uses = [ColumnUse(n.column, '' if n.unit is None else n.unit.text) for n in found]
    return InputGuess(dict(zip(inputs, uses, strict=True)), kind, why)


def _by_name(names: Sequence[ColumnName], inputs: Sequence[str], kind: str) -> InputGuess | None:
    """Find each input's own name in the name of one column."""
    found = []
    for name in inputs:
        words = tuple(word.lower() for word in WORDS.findall(name))
        exact = [n for n in names if n.words == words]
        having = exact or [n for n in names if set(words) <= set(n.words)]
        if len(having) != 1:
            return None
        found.append(having[0])
    return _guess(found, inputs, kind, 'its name') if len(set(found)) == len(found) else None


def _by_number(names: Sequence[ColumnName], inputs: Sequence[str], kind: str) -> InputGuess | None:
    """Take columns that are alike but for a number in the order of these numbers."""
    stems: dict[tuple[str, ...], list[ColumnName]] = {}
    for name in names:
        if len(name.numbers) == 1:
            stems.setdefault(name.stem, []).append(name)
    for alike in stems.values():
        if len(alike) == len(inputs) and len({n.numbers for n in alike}) == len(inputs):
            order = sorted(alike, key=lambda name: name.numbers)
            return _guess(order, inputs, kind, "its number, in the order of the robot's inputs")
    return None


def _by_order(names: Sequence[ColumnName], inputs: Sequence[str], kind: str) -> InputGuess | None:
    if len(names) != len(inputs):
        return None
    return _guess(names, inputs, kind, "its place, in the order of the robot's inputs")


def need_column(table: RawTable, column: str, option: str) -> None:
    """
    Refuse a column that is not in a table.

    Raises
    ------
    DataSetError
        It is not there; with the names that are.

    """
    if column not in table.columns and column not in table.texts:
        known = (*table.columns, *table.texts)
        raise DataSetError(
            table.name, f'no column {column!r} ({option})', f'use one of {listing(known)}'
        )
