"""
Named columns of numbers as read from a file, and the role of each by its name and unit.

A role is a time, an input, a coordinate, or to say whether a marker was visible (State of NDI,
visible, occluded and the like).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..common.arrays import Bools, Floats
from ..common.errors import DataSetError, short
from ..common.results import pandas
from ..common.words import Unit, find_unit, grouped, split_name

# [1] times what is usual, because what is more is something else: motion, or another marker
UNUSUAL_FACTOR = 10.0
# [1] rows that show how columns behave; a table without times has no more, because nobody measures
# more by hand
ROWS_MAX = 500
# kinds of points, according to the header of an export
MARKER, BODY_MARKER, BODY, DERIVED = 'markers', 'markers of bodies', 'bodies', 'derived points'
# units of other quantities than places, inputs and times
OTHER_UNITS = {
    unit: what
    for what, units in {
        'velocities': 'm/s mm/s',
        'accelerations': 'm/s^2 m/s² m/s2 mm/s^2 mm/s² deg/s^2 rad/s^2',
        'angular velocities': 'deg/s rad/s',
        'torques': 'N.mm N.m Nm Nmm mNm',
        'magnetic fields': 'T uT µT',
        'voltages': 'V mV uV',
        'pixels': 'px pixel pixels',
        'rates': 'Hz',
        'shares': '%',
    }.items()
    for unit in units.split()
}
FRAMES = 'frames'  # unit of a time that only counts them
MISSING = ('', 'nan', 'NaN', 'NAN', 'NA', 'N/A', 'null', 'None', '-', '--')


@dataclass(frozen=True, eq=False)
class RawTable:
    """Named columns of R rows, as read from a file."""

    name: str  # the file, as the user wrote it
    columns: dict[str, NDArray[Any]]  # (R,) numbers, NaN = missing, or texts (objects)
    units: dict[str, str] = field(default_factory=dict)  # column -> unit given in the file
    first: int | None = None  # row number in the file of the first row of numbers
    kinds: dict[str, str] = field(default_factory=dict)  # column -> kind of its point
    part: str = ''  # of a file that has several
    up: str | None = None  # axis that points up, if the format defines one
    notes: tuple[str, ...] = ()  # assumptions of the reader

    def __len__(self) -> int:
        """Count the rows."""
        return len(next(iter(self.columns.values())))

    def holds(self, *columns: str) -> bool:
        """Return whether the table has all of these columns."""
        return set(columns) <= self.columns.keys()

    def is_text(self, column: str) -> bool:
        """Return whether a column holds something else than numbers."""
        return bool(self.columns[column].dtype == object)

    def places(self, points: Sequence[Sequence[str]], some: bool = False) -> Floats:
        """Return the places (R, K, 3) in columns of x, y and z; of `some` rows where many."""
        step = max(len(self) // ROWS_MAX, 1) if some else 1
        rows = [[self.numbers(column)[::step] for column in point] for point in points]
        return np.array(rows).transpose(2, 0, 1)

    def where(self, row: int) -> str:
        """Name a row for a message, counted as an editor does."""
        return f'{self.name}, row {row + (1 if self.first is None else self.first)}'

    def numbers(self, column: str, expected: str = 'a number') -> Floats:
        """
        Return a column (R,) of numbers.

        Raises
        ------
        DataSetError
            A cell is no number; the message names the cell and its content.

        """
        values = self.columns[column]
        if not self.is_text(column):
            return values
        for row, text in enumerate(values):
            if text not in MISSING and not is_number(text):
                remedy = f'expected {expected}, or an empty cell where there is none'
                raise DataSetError(self.where(row), f'{column} is {short(text)}', remedy)
        return np.array([float(text) if text not in MISSING else np.nan for text in values])


def is_number(text: str) -> bool:
    """Tell whether a cell holds a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def table_of(
    name: str,
    frame: Any,
    units: Mapping[str, str] | None = None,
    first: int | None = None,
    notes: tuple[str, ...] = (),
) -> RawTable:
    """Sort the columns of a frame into numbers and texts."""
    if not len(frame):
        raise DataSetError(name, 'has no row below its header', 'export it again')
    for column in frame.columns[frame.columns.duplicated()]:
        raise DataSetError(name, f'column {short(str(column))} stands twice', 'rename one of them')
    columns, units = {}, dict(units or {})
    for column in frame.columns:
        values = frame[column]
        if values.dtype.kind in 'fiub':
            columns[str(column)] = values.to_numpy(dtype=float)
        elif values.dtype.kind in 'mM':
            columns[str(column)] = (values - values.iloc[0]).dt.total_seconds().to_numpy()
            units[str(column)] = 's'
        else:
            texts = values.astype(object).fillna('').astype(str).str.strip()
            columns[str(column)] = texts.to_numpy(dtype=object)
    return RawTable(name, columns, units, first, notes=notes)


WORDS = re.compile(r'[^\W\d_]+|\d+')
HUMP = re.compile(r'(?<=[a-zß-öø-ÿ])(?=[A-Z])')  # in tagRvecX
AXIS = re.compile(r'([tprqvawgfm]?)([xyz])')
AXES = ('x', 'y', 'z')
UPS = (*AXES, '-x', '-y', '-z')  # axes of a tracker that point up
TIMES = {'time', 'timestamp', 'seconds', 'sec', 'zeit', 'stamp'}
FILLERS = {
    *('pos', 'position', 'coord', 'coordinate', 'marker', 'markers', 'm', 'point', 'p', 'tvec'),
    *('translation', 'trans', 'tag', 't'),
}
# quantities with x, y and z other than measured positions, and the words that identify them
QUANTITIES = {
    what: set(words.split())
    for what, words in {
        'rotations': 'rvec rot rotation rotvec orientation orient ori euler rpy roll pitch yaw '
        'quat quaternion q angle angles attitude rodrigues',
        'accelerations': 'acc accel acceleration accelerometer gravity',
        'angular velocities': 'gyro gyroscope omega angular',
        'velocities': 'vel velocity speed twist',
        'magnetic fields': 'mag magnetic magnetometer compass',
        'forces': 'force forces kraft',
        'torques': 'moment torque wrench torques moments',
        'directions': 'normal direction dir',
        'errors': 'error err std stddev sigma cov covariance variance residual uncertainty '
        'quality',
        'commanded places': 'cmd command commanded setpoint desired des goal soll',
        'predicted places': 'predicted pred sim simulated',
    }.items()
}
# quantity of tx, rx, vx ...; a position has an empty name
PREFIXES = dict.fromkeys(('', 't', 'p'), '') | dict.fromkeys('rq', 'rotations')
PREFIXES |= dict.fromkeys('wg', 'angular velocities')
PREFIXES |= {'v': 'velocities', 'a': 'accelerations', 'f': 'forces', 'm': 'torques'}
OF_UNITS = {
    **{'angle': 'rotations', 'force': 'forces', 'current': 'currents'},
    **{'counts': 'counts', 'time': 'times'},
}
BRACKETED = re.compile(r'^(?P<name>.+?)\s*[\[(]\s*(?P<unit>[^\])]+?)\s*[\])]$')
COMMANDED = QUANTITIES['commanded places'] | {'set', 'ref', 'target'}  # inputs
# kinds of inputs in order of preference: tension acts on the arm, the others only determine it;
# then the words by which a column without a unit is one
KINDS: dict[str, set[str]] = {
    'force': {'tension', 'force', 't', 'f', 'load', 'loadcell', 'kraft', 'zugkraft'},
    'length': {'pull', 'displacement', 'disp', 'wire', 'cable', 'tendon', 'length'},
    'angle': {'angle', 'motor', 'servo'},
    'counts': {'encoder', 'enc', 'ticks', 'counts'},
    'current': {'current', 'i'},
}


@dataclass(frozen=True)
class ColumnName:
    """The name of a column, split into words and a unit."""

    column: str
    words: tuple[str, ...]  # in lower case, letters and digits apart
    unit: Unit | None
    other: str = ''  # quantity implied by its unit, if that is no length

    @property
    def component(self) -> tuple[str, str, tuple[str, ...]]:
        """Return the axis of a coordinate ('' for none), its quantity, and its other words."""
        for at in (len(self.words) - 1, 0):
            match = AXIS.fullmatch(self.words[at]) if self.words else None
            if match is None:
                continue
            rest = self.words[:at] + self.words[at + 1 :]
            quantity = PREFIXES[match[1]] or self.other
            for name, words in QUANTITIES.items():
                quantity = quantity or (name if words & set(rest) else '')
            if not quantity and self.unit is not None:
                quantity = OF_UNITS.get(self.unit.kind, '')
            return match[2], quantity, (match[1], *rest) if match[1] else rest
        return '', '', self.words

    @property
    def axis(self) -> str:
        """The coordinate axis named by the last or first word, '' for none."""
        return self.component[0]

    @property
    def kind(self) -> str:
        """Kind of an input or a time, by its unit or else its words; '' for none."""
        if self.unit is not None:
            return self.unit.kind
        if TIMES & set(self.words):
            return 'time'
        return next((kind for kind, known in KINDS.items() if known & set(self.words)), '')


def words_of(name: str) -> tuple[str, ...]:
    """Split a name into words in lower case and numbers."""
    return tuple(word.lower() for word in WORDS.findall(HUMP.sub(' ', name)))


def names_of(table: RawTable) -> list[ColumnName]:
    """Split the names of all columns; a unit given in the file has precedence over the name."""
    parsed = []
    for column in table.columns:
        name, unit = split_name(column)
        text = table.units.get(column, '')
        if unit is None and (marked := BRACKETED.match(column)) and marked['unit'] in OTHER_UNITS:
            name, text = marked['name'], text or marked['unit']
        if text:
            unit = find_unit(text)
        other = '' if unit is not None else OTHER_UNITS.get(text, text and f'values in {text}')
        parsed.append(ColumnName(column, words_of(name), unit, other))
    return parsed


def guess_time(names: Sequence[ColumnName]) -> ColumnName | None:
    """Return the column of times, None where there is none."""
    known = [name for name in names if name.unit is None or name.unit.kind == 'time']
    exact = [name for name in known if name.words in (('t',), *((word,) for word in TIMES))]
    marked = [n for n in known if TIMES & set(n.words) or (n.unit and n.words[:1] == ('t',))]
    return next(iter([*exact, *marked]), None)


@dataclass(frozen=True)
class Triple:
    """Three columns x, y and z."""

    name: tuple[str, ...]  # words
    columns: tuple[str, str, str]
    quantity: str  # other than a measured position, '' for a position
    kind: str  # MARKER by default
    table: RawTable  # that it is in

    def places(self) -> Floats:
        """Return some of its places (R, 3), NaN where it was not seen."""
        places = self.table.places([self.columns], some=True)[:, 0]
        places[(places == 0.0).all(axis=1)] = np.nan
        return places


def triples_of(table: RawTable) -> list[Triple]:
    """Return all triples of columns that differ only in x, y and z, in the order of the table."""
    groups: dict[tuple[tuple[str, ...], str], dict[str, str]] = {}
    for name in names_of(table):
        axis, quantity, words = name.component
        if axis:
            groups.setdefault((words, quantity), {}).setdefault(axis, name.column)
    complete = {
        key: [axes[axis] for axis in AXES] for key, axes in groups.items() if len(axes) == 3
    }
    return [
        Triple(words, (x, y, z), quantity, table.kinds.get(x, MARKER), table)
        for (words, quantity), (x, y, z) in complete.items()
    ]


def marker_label(columns: Sequence[str]) -> str:
    """Name a point by the common beginning of the names of its columns, without the axis."""
    names = [WORDS.findall(HUMP.sub(' ', split_name(column)[0])) for column in columns[::3]]
    for words in names:
        if len(words) > 1 and AXIS.fullmatch(words[-1].lower()):
            words.pop()
        elif len(words) > 1 and AXIS.fullmatch(words[0].lower()):
            words.pop(0)
    alike = takewhile(lambda words: len(set(words)) == 1, zip(*names, strict=False))
    return ' '.join(words[0] for words in alike) or columns[0]


def guess_inputs(
    names: Sequence[ColumnName], inputs: Sequence[str]
) -> tuple[list[ColumnName], str] | None:
    """
    Return the columns of the inputs of a robot, and why; None if one of them is missing.

    Tensions are preferred to wire pulls, these to angles and currents of motors, and measured
    values to commanded ones.
    """
    for kind in KINDS:
        fitting = [name for name in names if name.axis == '' and name.kind == kind]
        groups = grouped(fitting, lambda name: tuple(sorted(COMMANDED & set(name.words))))
        for group in sorted(groups):  # without such a word first: measured
            own = groups[group]
            if named := _by_name(own, inputs):
                return named, 'its name'
            if numbered := _by_number(own, inputs):
                return numbered, "its number, in the order of the robot's inputs"
            if len(own) == len(inputs):
                return own, "its place, in the order of the robot's inputs"
    named = _by_name([name for name in names if name.unit is None and not name.axis], inputs)
    return (named, 'its name') if named else None


def _by_name(names: Sequence[ColumnName], inputs: Sequence[str]) -> list[ColumnName]:
    """Return for each input the one column whose name contains that of the input; else none."""
    columns = []
    for name in inputs:
        words = words_of(name)
        exact = [n for n in names if n.words == words]
        matches = exact or [n for n in names if set(words) <= set(n.words)]
        if len(matches) != 1:
            return []
        columns.append(matches[0])
    return columns if len(set(columns)) == len(columns) else []


def _by_number(names: Sequence[ColumnName], inputs: Sequence[str]) -> list[ColumnName]:
    """Return columns whose names differ only in a number, in the order of these numbers."""
    stems: dict[tuple[str, ...], dict[int, ColumnName]] = {}
    for name in names:
        numbers = [word for word in name.words if word.isdecimal()]
        if len(numbers) == 1:
            stem = tuple(word for word in name.words if word != numbers[0])
            stems.setdefault(stem, {})[int(numbers[0])] = name
    alike = next((one for one in stems.values() if len(one) == len(inputs)), {})
    return [alike[number] for number in sorted(alike)]


# words in the name of a column that says whether a marker was visible, then in its cells
VISIBLE = {'visible', 'visibility', 'seen', 'valid', 'tracked', 'detected'}  # 0: hidden
HIDDEN = {'occluded', 'occlusion', 'hidden', 'missing', 'lost', 'invalid'}  # 0: visible
STATE = {'state', 'status'}  # in words
YES, NO = {'1', 'true', 'yes', 'y', 't'}, {'0', 'false', 'no', 'n', 'f'}
LOST = HIDDEN | {'disabled', 'unseen', 'untracked', 'out', 'not', 'bad', 'none', 'unknown'}


def kind_of_flag(name: ColumnName) -> set[str] | None:
    """Return the set of words that the name matches: `VISIBLE`, `HIDDEN` or `STATE`; else None."""
    return next((kind for kind in (VISIBLE, HIDDEN, STATE) if kind & set(name.words)), None)


def flag_columns(
    table: RawTable, markers: Sequence[Sequence[str]]
) -> Iterator[tuple[ColumnName, set[str], list[int]]]:
    """
    Find the columns that say whether markers were visible.

    Parameters
    ----------
    table : RawTable
    markers : sequence of columns
        Of x, y and z of each marker.

    Yields
    ------
    name : ColumnName
    kind : set of str
        `VISIBLE`, `HIDDEN` or `STATE`.
    of : list of int
        Indices of its markers: the one with the same words, or all if it names none.

    """
    names = names_of(table)
    used = {column for columns in markers for column in columns}
    own = {name.column: name for name in names if name.column in used}
    owners = [_words(own[c[0]].component[2]) if c[0] in own else () for c in markers]
    for name in names:
        kind = kind_of_flag(name)
        is_number_of_state = kind is STATE and not table.is_text(name.column)
        if kind is None or name.column in used or is_number_of_state:
            continue  # what a number of a state means only its maker knows
        owner = _words(word for word in name.words if word not in kind)
        of = [j for j, words in enumerate(owners) if words == owner]
        if of or not owner:
            yield name, kind, of or list(range(len(markers)))


def not_visible(table: RawTable, markers: Sequence[Sequence[str]]) -> dict[str, Bools]:
    """Return masks (R, J) of the readings that a column marks as hidden, by reason."""
    masks = {}
    for name, kind, of in flag_columns(table, markers):
        index, cells = pandas().factorize(table.columns[name.column], use_na_sentinel=False)
        hidden = np.array([_is_hidden(str(cell), kind) for cell in cells])[index]
        if hidden.any() and not hidden.all():
            mask = np.zeros((len(table), len(markers)), dtype=bool)
            mask[:, of] = hidden[:, None]
            masks[f'the column {name.column} says so'] = mask
    return masks


def _words(words: Iterable[str]) -> tuple[str, ...]:
    return tuple(word for word in words if word not in FILLERS)


def _is_hidden(text: str, kind: set[str]) -> bool:
    words = set(text.lower().replace('_', ' ').split())
    if text in MISSING:
        return False
    if is_number(text):
        return kind is not STATE and (float(text) == 0.0) == (kind is VISIBLE)
    if words & LOST:
        return True
    return bool(words & NO) if kind is VISIBLE else kind is HIDDEN and bool(words & YES)
