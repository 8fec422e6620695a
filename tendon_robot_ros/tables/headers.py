"""
The header of a text table, read by its structure, whatever system wrote it.

The header is everything above the first row that looks like the rows below it. Its last row names
the columns, or their axes; rows above it hold the points of these axes, types, quantities and
identifiers, which are recognised by their content. All other cells are words with values.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from ..common.errors import DataSetError, short
from ..common.words import find_unit
from .columns import BODY, BODY_MARKER, DERIVED, MARKER, MISSING, OTHER_UNITS, is_number

Row = list[str]  # cells
AHEAD = 3  # [1] rows, because a header has fewer that look like the data
STAMP = re.compile(r'\d[\d:./T +-]*\d(?:Z|[+-]\d\d:?\d\d)?')  # a date or a time of day
AXIS = re.compile(r'[RTQ]?([XYZW])\d*|Q0', re.IGNORECASE)
COORDINATE = re.compile(r'T?[XYZ]\d*', re.IGNORECASE)
LABELS = ('type', 'name', 'id', 'parent')  # of rows of OptiTrack's, since Motive 1.5
IDENTIFIER = re.compile(r'[0-9A-Fa-f]{16,}(?::[0-9A-Fa-f]+)?|\d+|[0-9A-Fa-f]+:[0-9A-Fa-f]{8,}')
TYPES = {
    *('marker', 'rigid body', 'rigid body marker', 'bone', 'bone marker', 'marker constraint'),
    *('rigid body constraint', 'skeleton', 'skeleton marker', 'skeleton bone', 'asset marker'),
    *('markerset', 'trained markerset', 'trained markerset bone', 'trained markerset marker'),
}
# title of a part of Vicon's exports -> what its points are
VICON = {
    'trajectories': MARKER,
    'objects': BODY,
    'segments': BODY,
    'joints': DERIVED,
    'model outputs': DERIVED,
    'devices': DERIVED,
}
NO_NAMES = ('format version', 'pathfiletype', *VICON)  # begin rows that name no column
PLACE = 'position'
QUANTITIES = {
    *(PLACE, 'rotation', 'mean marker error', 'marker quality', 'marker size', 'error per marker'),
    *('mean error', 'velocity', 'acceleration'),
}
RATES = (
    *('export frame rate', 'capture frame rate', 'frequency', 'datarate', 'frame rate'),
    *('framerate', 'sampling rate', 'sample rate', 'rate'),
)
LENGTHS = ('length units', 'units', 'unit')


@dataclass(frozen=True)
class Maker:
    """A motion capture system: how its files are recognised, and defaults that they omit."""

    name: str
    head_words: tuple[str, ...]  # a row of the header begins with one of these words
    up: str | None = None  # axis that points up by default
    unit: str = ''  # default unit of length


UNKNOWN = Maker('', ())
MAKERS = (
    Maker('OptiTrack', ('format version', 'take name'), up='y'),
    Maker('Vicon', tuple(VICON), up='z', unit='mm'),
    Maker('Qualisys', ('no_of_frames', 'no_of_markers', 'marker_names', 'body_names'), unit='mm'),
    Maker('Motion Analysis (.trc)', ('pathfiletype',)),
    Maker('NDI', ('tools', 'number of frames', 'number of tools'), unit='mm'),
)


def is_decimal(cell: str) -> bool:
    """Return whether a cell holds a number, with a decimal point or comma."""
    return is_number(cell.replace(',', '.'))


def is_value(cell: str) -> bool:
    """Return whether a cell holds a number or a time."""
    return is_decimal(cell) or bool(STAMP.fullmatch(cell))


def _filled(row: Row) -> list[int]:
    return [i for i, cell in enumerate(row) if cell and cell not in MISSING]


def first_row_of_data(rows: Sequence[Row]) -> int | None:
    """
    Return the index of the first row of data among rows without empty ones, None for no data.

    The last quarter of the rows shows which columns hold values.
    """
    sample = rows[-max(len(rows) // 4, 1) :]
    count = Counter(i for row in sample for i in _filled(row))
    values = Counter(i for row in sample for i in _filled(row) if is_value(row[i]))
    numeric = {i for i in count if 2 * values[i] > count[i]}
    if not numeric or 2 * values.total() < count.total():
        return None

    def is_head(row: Row) -> bool:
        filled = _filled(row)
        if filled and filled[0] not in count and not is_value(row[filled[0]]):
            return True
        texts = [i for i in filled if i in numeric and not is_value(row[i])]
        among = sum(i in numeric for i in filled)
        is_key = bool(texts) and texts[0] == filled[0]
        return 2 * len(texts) > among or (is_key and 2 * len(texts) >= among)

    heads = [is_head(row) for row in rows]
    first = next((i for i in range(len(rows)) if not any(heads[i : i + AHEAD])), None)
    has_words_only = 0 not in numeric and (first == 0 or numeric == {1})  # each with its value
    return None if has_words_only else first


class Head:
    """
    What stands above the data of a table.

    Parameters
    ----------
    shown : str
        The file, for messages.
    first : int
        The row of the file, from 1, that the last row of the head stands in, for messages.
    rows : sequence of list of str
        All rows of the head that are not empty, their cells stripped.
    width : int
        Columns of the data.

    Attributes
    ----------
    names : list of str
        Of the columns.
    units, kinds : dict of str
        By column: its unit, and what its point is.
    maker : Maker
        `UNKNOWN` where no system is recognised.
    title : str
        Of a part of the file.
    rate : float or None [Hz]
    frames : int or None
        Number of frames stated in the file.

    Raises
    ------
    DataSetError
        There are no names for the columns.

    """

    def __init__(self, shown: str, first: int, rows: Sequence[Row], width: int) -> None:
        rows = [row for row in rows if any(row)]
        self.maker = maker = maker_of(rows)
        marked = [row for row in rows if row[0][:1] in ('#', '%')]
        labels = [row for row in rows if row not in marked and row[0].lower() not in NO_NAMES]
        if not labels:  # as numpy writes it
            bare = [[row[0].lstrip('#% '), *row[1:]] for row in marked]
            labels = [row for row in bare[-1:] if len(row) == width]
        values_by_word = _values_by_word(rows)
        self.title = ''
        if maker.name == 'Vicon':
            self.title = next((row[0] for row in rows if row[0].lower() in VICON), '')
        if maker.name == 'Qualisys':
            keys = {row[0]: row[1:] for row in labels if re.fullmatch(r'[A-Z][A-Z_]+', row[0])}
            labels = [row for row in labels if row[0] not in keys]
            labels = labels or [_qualisys_names(shown, keys, width)]
            bodies = 'BODY_NAMES' in keys and 'MARKER_NAMES' not in keys
            self.title = 'objects' if bodies else ''
        # the last row of labels holds units if all of its cells do
        cells = [cell for cell in labels[-1] if cell] if len(labels) > 1 else ['']
        has_units = all(find_unit(cell) or cell in OTHER_UNITS for cell in cells)
        units_row: Row = labels.pop() if has_units else []
        if not labels:
            raise unnamed(shown, max(first, 1), maker)
        row = first - bool(has_units)
        self.names, self.kinds = _names(shown, row, labels, width, maker, self.title)
        padded = zip(self.names, _padded(units_row, width), strict=True)
        self.units = {name: unit for name, unit in padded if unit}
        length = _first(values_by_word, LENGTHS, find_unit) or maker.unit
        if length and (unit := find_unit(length)) and unit.kind == 'length' and not units_row:
            places = [n for n in self.names if self.kinds.get(n, DERIVED) != DERIVED]
            self.units |= dict.fromkeys(places, unit.text)
        rate = _first(values_by_word, RATES, is_decimal)
        if maker.name == 'Vicon':
            alone = (row[0] for row in rows if len(_filled(row)) == 1 and is_decimal(row[0]))
            rate = next(alone, '')
        self.rate = float(rate.replace(',', '.')) or None if rate else None
        frames = _first(values_by_word, ('no_of_frames',), str.isdecimal)
        self.frames = int(frames) if frames else None


def maker_of(rows: Sequence[Row]) -> Maker:
    """Return the system whose exports have such a header, `UNKNOWN` for none."""
    begins = {cell.lower().rstrip(':') for row in rows for cell in row[:3:2] if cell}
    return next((maker for maker in MAKERS if begins & set(maker.head_words)), UNKNOWN)


def _values_by_word(rows: Sequence[Row]) -> dict[str, list[str]]:
    """Return every word with the cells to its right and below it."""
    values_by_word: dict[str, list[str]] = {}
    for row, below in pairwise([*rows, []]):
        parts = [part.strip() for cell in row for part in cell.lstrip('#% ').split(':', 1)]
        beside = pairwise([part for part in parts if part])
        for word, value in (*beside, *zip(row, below, strict=False)):
            values_by_word.setdefault(word.rstrip(':').lower(), []).append(value)
    return values_by_word


def _first(
    values_by_word: Mapping[str, list[str]], words: Sequence[str], fits: Callable[[str], Any]
) -> str:
    """Return the first accepted value of the first word that has one, '' for none."""
    return next(
        (value for word in words for value in values_by_word.get(word, ()) if fits(value)), ''
    )


def _padded(row: Row, width: int) -> Row:
    return [*row, *([''] * width)][:width]


def unnamed(shown: str, row: int, maker: Maker) -> DataSetError:
    """Build the error for a table whose columns have no names."""
    problem = 'is no header, it holds numbers'
    remedy = 'start the file with the names of the columns'
    if maker.name:
        problem = f'is an export of {maker.name} without rows that name the points'
        remedy = 'export it again with its header rows'
    return DataSetError(f'{shown}, row {row}', problem, remedy)


def _qualisys_names(shown: str, keys: Mapping[str, Row], width: int) -> Row:
    """Return the names of the columns of a Qualisys file without a row of names."""
    markers = [name for name in keys.get('MARKER_NAMES', []) if name]
    before = min(width - 3 * len(markers), 2)  # without a tab at the end of every row
    if not markers or before < 0:
        named = f'MARKER_NAMES ({len(markers)})'
        problem = f'is an export of Qualisys whose {named} do not fit to its {width} columns'
        remedy = 'export 3D data from QTM as TSV with the TSV header, or as C3D'
        raise DataSetError(shown, problem, remedy)
    places = [f'{marker} {axis}' for marker in markers for axis in 'XYZ']
    return [*('Frame', 'Time')[:before], *places]


def _names(
    shown: str, row: int, labels: Sequence[Row], width: int, maker: Maker, title: str
) -> tuple[list[str], dict[str, str]]:
    """Return a name for each column, and the kind of point of the columns of points."""
    tracked = bool(maker.name)
    types, quantities, owners, axes, above = _sorted_labels(labels, width, tracked, title)
    names: list[str] = []
    for i in range(width):
        quantity = quantities[i] if quantities[i].lower() != PLACE else ''
        parts = [owners[i], quantity, axes[i]]
        if owners[i] and (axis := AXIS.fullmatch(axes[i])) and axis[1]:
            parts[2] = axes[i].rstrip('0123456789')
        name = ' '.join(part for part in parts if part)
        if not name and tracked:
            name = next((one[i] for one in reversed(above) if one[i]), '')
            name = name or ('Frame', 'Time')[i] if i < 2 else name
        if tracked and not owners[i]:
            first = name.partition(' ')[0].lower().rstrip('#')
            name = first if first in ('frame', 'time') else name
        names.append(name)
    is_place = [
        tracked and q.lower() in ('', PLACE) and bool(COORDINATE.fullmatch(a.split(' ')[-1]))
        for q, a in zip(quantities, axes, strict=True)
    ]
    twice = {name for name, count in Counter(names).items() if count > 1 and name}
    names = [f'{n} {types[i]}'.strip() if n in twice else n for i, n in enumerate(names)]
    for i, name in enumerate(names):  # the axis follows a type that distinguishes columns
        words = name.split(' ')
        at = max((k for k, word in enumerate(words) if word in ('X', 'Y', 'Z', 'W')), default=None)
        if name not in axes and at is not None:
            names[i] = ' '.join([*words[:at], *words[at + 1 :], words[at]])
    _check(f'{shown}, row {row}', names)
    placed = zip(names, types, is_place, strict=True)
    return names, {name: _kind(text, title) for name, text, is_one in placed if is_one}


def _sorted_labels(
    labels: Sequence[Row], width: int, tracked: bool, title: str
) -> tuple[Row, Row, Row, Row, list[Row]]:
    """Return types, quantities, owners and axes of the columns, and all rows above the axes."""
    labelled = [next((cell.lower() for cell in one[:2] if cell), '') for one in labels]
    row_names = LABELS if tracked else ()  # stand before a row
    rows = [['' if c.lower() in row_names else c for c in _padded(one, width)] for one in labels]
    axes, above = rows[-1], rows[:-1]
    types, quantities, owners, numbered = ([''] * width for _ in range(4))
    for one, label in zip(above, labelled, strict=False):  # the lowest of each kind counts
        words = {cell.lower() for cell in one if cell}
        if words and words <= TYPES:
            types = one
        elif words and words <= QUANTITIES:
            quantities = one
        elif label == 'parent':
            continue
        elif label == 'id' or (words and all(IDENTIFIER.fullmatch(word) for word in words)):
            numbered = one
        elif len(_filled(one)) > 1 or title:
            owners = one
    if not any(owners) and any(types):
        owners = numbered
    bare = axes[: 1 + max((i for i, name in enumerate(axes) if name), default=-1)]
    if all(bare) and len(set(bare)) == len(bare) and not any(types) and not title:
        owners = [''] * width
    elif any(owners):
        owners = _spread(owners, axes, quantities)
    elif not any(quantities):
        owners = _leading(axes)
    subjects = {owner.rpartition(':')[0] for owner in owners if owner}
    if title and len(subjects) == 1:  # a single subject distinguishes nothing
        owners = [owner.rpartition(':')[2] for owner in owners]
    return types, quantities, owners, axes, above


def _check(where: str, names: list[str]) -> None:
    """Refuse missing or repeated names of columns; name the empty ones at the end of a row."""
    last = max((i for i, name in enumerate(names) if name), default=-1)
    for i, name in enumerate(names):
        if not name and i > last:  # a delimiter at the end of every row
            names[i] = f'column {i + 1}'
        elif not name:
            raise DataSetError(where, f'column {i + 1} has no name', 'give it one')
        elif names.index(name) != i:
            raise DataSetError(where, f'column {short(name)} stands twice', 'rename one of them')


def _spread(owners: Row, axes: Row, quantities: Row) -> Row:
    """Repeat the owner given above the first of its columns above all of them."""
    spread: Row = []
    owner, named = '', set[tuple[str, str]]()
    for i, cell in enumerate(owners):
        what = quantities[i], axes[i]
        if cell and cell != owner:
            owner, named = cell, set()
        elif not cell and (what in named or not axes[i]):  # a point without a name
            owner = f'Unlabeled {i + 1}' if axes[i] else ''
            named = set()
        named.add(what)
        is_own = owner and (axes[i] or quantities[i]) and axes[i].lower() not in ('frame',)
        spread.append(owner if is_own and (cell or axes[i]) else '')
    return spread


def _leading(names: Row) -> Row:
    """Return the owner of every repeated name: the name before the group."""
    count = Counter(names)
    owners, owner = [], ''
    for name, follows in pairwise([*names, '']):
        if count[name] == 1 and count[follows] > 1:
            owner = name
        owners.append(owner if count[name] > 1 else '')
    return owners


def _kind(text: str, title: str) -> str:
    if title:
        return VICON[title.lower()]
    words = set(text.lower().split())
    if words & {'marker', 'constraint'}:
        return BODY_MARKER if len(words) > 1 else MARKER
    return BODY if words else MARKER
