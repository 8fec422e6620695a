"""A file to wide tables of named columns: text of any tracker or logger, Parquet, .c3d."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..common.errors import DataSetError, of_extra, reason_of, short
from ..common.files import TABLE_ENDINGS, TEXT_ENDINGS
from ..common.results import arrow, pandas
from ..common.words import find_unit, listing
from .columns import (
    DERIVED,
    FRAMES,
    MISSING,
    ROWS_MAX,
    UPS,
    RawTable,
    guess_time,
    is_number,
    kind_of_flag,
    names_of,
    table_of,
    triples_of,
)
from .headers import Head, first_row_of_data, maker_of, unnamed

# endings -> system that writes them, and the format to export instead
MAKERS_OWN = {
    '.tak .tra': (
        'Motive (OptiTrack)',
        'export the take as CSV, with header information, or as C3D',
    ),
    '.qtm': ('Qualisys Track Manager', 'export it as TSV, with its header, or as C3D'),
    '.x1d .x2d': ('Vicon Nexus', 'export the trajectories as ASCII (CSV) or C3D'),
    '.cap .trb': ('Cortex (Motion Analysis)', 'export it as .trc or C3D'),
    '.fbx .bvh': ('animation programs', 'export the markers as CSV or C3D'),
    '.xlsx .xls': ('Excel', 'save the sheet as CSV'),
    '.mat': ('MATLAB', 'write it with writetable as CSV'),
}
BYTES_MAX = 1_000_000_000  # [1] bytes, so that a file and its numbers fit into memory
DELIMITERS = {';': 'semicolons', '\t': 'tabs', ',': 'commas'}  # commas may be decimal ones
EMPTY_LINES = re.compile(rb'(?:\A|\n)(?:[ \t\r,;]*\n)+')  # between the parts of a file


def read_tables(path: str | Path) -> list[RawTable]:
    """
    Read a file by its ending: .csv (.txt, .tsv, .dat, .trc), .parquet or .c3d.

    An export with several parts, each with its own head, gives a table of each.

    Raises
    ------
    DataSetError
        It cannot be read: one line with the row, where there is one.
    MissingExtraError
        A package for this format is not installed.

    """
    shown, path = str(path), Path(path)
    if not path.is_file():
        problem = 'is a folder' if path.is_dir() else 'is not there'
        remedy = f'name a file that ends with {", ".join(TABLE_ENDINGS)}'
        raise DataSetError(shown, problem, remedy)
    size = path.stat().st_size
    if size > BYTES_MAX:
        problem = f'has {size / 1e9:.1f} GB, more than {BYTES_MAX / 1e9:g} GB are not read at once'
        remedy = 'export 50 frames a second and the columns you need, or one file per recording'
        raise DataSetError(shown, problem, remedy)
    if size == 0:
        raise DataSetError(shown, 'is empty', 'export it again')
    ending = path.suffix.lower()
    if ending == '.parquet':
        arrow()  # by which pandas reads it
        package = pandas()
        try:
            frame = package.read_parquet(path)
        except Exception as error:  # a damaged file can fail anywhere in the parser
            problem = f'is no Parquet file ({reason_of(error)})'
            raise DataSetError(shown, problem, 'export it again') from None
        return [table_of(shown, frame)]
    if ending == '.c3d':
        return [read_c3d(shown, path)]
    for endings, (maker, remedy) in MAKERS_OWN.items():
        if ending in endings.split():
            raise DataSetError(shown, f'is a file of {maker} and cannot be read', remedy)
    if ending not in TEXT_ENDINGS:
        problem = f'is no table that can be read ({ending or "no ending"})'
        remedy = f'save it as CSV; known endings: {", ".join(TABLE_ENDINGS)}'
        raise DataSetError(shown, problem, remedy)
    return _read_text(shown, path)


@dataclass
class TextPart:
    """A part of a text file that has a head of its own."""

    head: list[tuple[int, list[str]]]  # line number from 0, cells
    begin: int  # first byte of its data
    end: int  # byte behind them
    line: int  # number, from 0, of its first line of data
    width: int  # cells in its first row of data
    sample: list[list[str]]  # first rows of data


def _read_text(shown: str, path: Path) -> list[RawTable]:
    data = path.read_bytes()
    if b'\0' in data:
        raise DataSetError(shown, 'is no text file', 'export it as CSV (UTF-8)')
    if not data.strip():
        raise DataSetError(shown, 'is empty', 'export it again')
    data, notes = data.removeprefix(codecs.BOM_UTF8), tuple[str, ...]()
    try:
        data.decode()
    except UnicodeDecodeError:
        data = data.decode('cp1252', 'replace').encode()
        notes = ('text is taken as Windows-1252: it is no UTF-8',)
    delimiter = _delimiter(shown, _first_lines(data))
    if delimiter != ',':
        notes = (*notes, f'columns are separated by {DELIMITERS[delimiter]}')
    parts = _parts(shown, data, delimiter)
    return [_read_part(shown, data, part, delimiter, notes) for part in parts]


def _first_lines(data: bytes) -> list[str]:
    return [line.decode() for line in data.split(b'\n', ROWS_MAX)[:ROWS_MAX]]


def _delimiter(shown: str, rows: Sequence[str]) -> str:
    """Return the delimiter in most rows; a comma beside another delimiter is a decimal comma."""
    lines = [line for line in rows if line.strip()]
    for mark in DELIMITERS:
        if 2 * sum(mark in line for line in lines) >= len(lines):
            return mark
    if (maker := maker_of([[line.strip()] for line in lines])).name:
        raise unnamed(shown, 1, maker)
    problem = f'has one column only ({short(lines[0].strip()[:40])})'
    remedy = 'separate columns by commas, semicolons or tabs'
    raise DataSetError(f'{shown}, row {1 + rows.index(lines[0])}', problem, remedy)


def _parts(shown: str, data: bytes, delimiter: str) -> list[TextPart]:
    """Split a file at empty lines that are followed by another header."""
    parts: list[TextPart] = []
    head: list[tuple[int, list[str]]] = []
    for begin, end, line in _blocks(data):
        lines = _first_lines(data[begin:end].rstrip(b'\r\n'))
        rows = [[c.strip() for c in row] for row in csv.reader(lines, delimiter=delimiter)]
        first = first_row_of_data(rows)
        if first == 0 and not head and parts:
            parts[-1].end = end
        elif first is None:
            head += enumerate(rows, line)
        else:
            head += enumerate(rows[:first], line)
            at = begin + sum(len(one.encode()) + 1 for one in lines[:first])
            parts.append(TextPart(head, at, end, line + first, len(rows[first]), rows[first:]))
            head = []
    if not parts:
        raise DataSetError(shown, 'has no row below its header', 'export it again')
    return parts


def _blocks(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield first byte, end and first line of each block between empty lines."""
    begin = line = 0
    for gap in [*EMPTY_LINES.finditer(data), None]:
        end = len(data) if gap is None else gap.start() + (gap.start() > 0)
        if data[begin:end].strip():
            yield begin, end, line
        if gap is not None:
            line += data[begin : gap.end()].count(b'\n')
            begin = gap.end()


def _read_part(
    shown: str, data: bytes, part: TextPart, delimiter: str, notes: tuple[str, ...]
) -> RawTable:
    """Parse the rows below a head."""
    last = part.head[-1][0] + 1 if part.head else 0
    head = Head(shown, last, [row for _, row in part.head], part.width)
    commas = {c for row in part.sample for c in row if ',' in c} if delimiter != ',' else ()
    decimal = ',' if any(is_number(cell.replace(',', '.')) for cell in commas) else '.'
    notes = (*notes, 'numbers have decimal commas') if decimal == ',' else notes
    content = data[part.begin : part.end]
    rows = _count_rows(shown, content, part, delimiter)
    try:
        frame = pandas().read_csv(
            io.BytesIO(content),
            sep=delimiter,
            decimal=decimal,
            header=None,
            names=list(head.names),
            na_values=list(MISSING),
            keep_default_na=False,
            skipinitialspace=True,
            index_col=False,
            low_memory=False,
            nrows=rows,
        )
    except (ValueError, OSError) as error:  # ParserError is a ValueError
        problem = f'cannot be read ({reason_of(error)})'
        raise DataSetError(shown, problem, 'export it again') from None
    if rows is not None:
        notes = (*notes, f'the last row, {part.line + rows + 1}, is cut short: left out')
    blank = [name for name in frame.columns if name.startswith('column ')]
    if frame[blank].notna().any(axis=None):
        raise _bad_row(shown, delimiter, len(head.names) - len(blank), part.line + 1, part.width)
    table = table_of(shown, frame.drop(columns=blank), head.units, part.line + 1, notes)
    return _with_times(replace(table, kinds=head.kinds, part=head.title), head)


def _with_times(table: RawTable, head: Head) -> RawTable:
    """Add times to an export that only counts frames, and the defaults of its system."""
    if not head.maker.name:
        return table
    columns, units = table.columns, table.units
    remarks = [f'exported by {head.maker.name}{f", {head.title}" if head.title else ""}']
    known = {n: find_unit(u) for n, u in units.items() if n in head.kinds}
    lengths = {u.text for u in known.values() if u is not None and u.kind == 'length'}
    remarks += [f'lengths in {next(iter(lengths))}'] if len(lengths) == 1 else []
    unit, note = 's', ''
    if 'time' in columns:
        unit = '' if table.is_text('time') else units.get('time', 's')
    elif head.rate is not None:
        frames, note = _frames(table, head)
        columns = {'time': frames / head.rate, **columns}
    elif set(head.kinds.values()) - {DERIVED}:
        counted = next((n for n in columns if n.lower().split(' ')[-1] == 'frame'), None)
        if counted is None:
            export = f'is an export of {head.maker.name}'
            remedy = 'export it again with its header rows, or add a column time [s]'
            problem = f'{export} that says neither times nor frames per second'
            raise DataSetError(table.name, problem, remedy)
        columns, unit = {'time': columns[counted], **columns}, FRAMES
    up = head.maker.up
    remarks += [remark for remark in (note, up and f'{up} up') if remark]
    notes = (*table.notes, ', '.join(remarks))
    return replace(table, columns=columns, units={**units, 'time': unit}, up=up, notes=notes)


def _frames(table: RawTable, head: Head) -> tuple[Floats, str]:
    """Return the frame number (R,) of each row, and a note of the rate."""
    note, every = f'{head.rate:g} frames a second', 1
    if 'frame' in table.columns:
        sub = table.numbers('Sub Frame') if table.holds('Sub Frame') else np.zeros(len(table))
        per = float(np.nanmax(sub)) + 1.0  # samples of a device in each frame
        return table.numbers('frame') * per + sub, note
    if head.frames is not None and head.frames > len(table):
        every = -(-head.frames // len(table))
        if -(-head.frames // every) != len(table):
            problem = f'says that it has {head.frames:,} frames and has {len(table):,} rows'
            remedy = 'export it again, with the columns of frames and times'
            raise DataSetError(table.name, problem, remedy)
        note += f', every {every}th of {head.frames:,} frames' if every > 1 else ''
    return every * np.arange(len(table), dtype=float), note


def _count_rows(shown: str, raw: bytes, part: TextPart, delimiter: str) -> int | None:
    """
    Refuse a row with too few or too many cells; None: all rows are complete.

    Delimiters are counted, which takes a tenth of the time of reading; only where they do not
    come out the rows are looked at one by one. Returns how many are whole where the last, as a
    logger that was switched off leaves it, is cut short.
    """
    lines = raw.count(b'\n') + (raw[-1:] != b'\n')
    plain = b'"' not in raw and b'\n\n' not in raw and b'\n\r' not in raw
    if plain and raw.count(delimiter.encode()) == (part.width - 1) * lines:
        return None
    text = io.TextIOWrapper(io.BytesIO(raw), 'utf-8', newline='')
    reader = csv.reader(text, delimiter=delimiter)
    whole, bad = 0, None
    for cells in filter(any, reader):
        row = part.line + reader.line_num, len(cells)
        if bad is not None or len(cells) > part.width or (len(cells) < part.width and not whole):
            raise _bad_row(shown, delimiter, part.width, *(bad or row))
        if len(cells) < part.width:
            bad = row
        else:
            whole += 1
    return None if bad is None else whole


def _bad_row(shown: str, delimiter: str, width: int, row: int, cells: int) -> DataSetError:
    remedy = 'write every row with the same columns, empty cells where there is nothing'
    if cells > width and delimiter == ',':
        remedy += ' (decimal commas? export with points)'
    return DataSetError(f'{shown}, row {row}', f'has {cells} cells under {width} columns', remedy)


def read_c3d(shown: str, path: Path) -> RawTable:
    """
    Read the points of a .c3d file, and its analog channels as means over each frame.

    Raises
    ------
    DataSetError
        It is no .c3d file, or holds no points.
    MissingExtraError
        The package ezc3d is not installed.

    """
    ezc3d = of_extra('tables', 'ezc3d')
    try:
        content = ezc3d.c3d(str(path))
    except Exception as error:  # a damaged file can fail anywhere in the parser
        problem = f'is no .c3d file ({reason_of(error)})'
        raise DataSetError(shown, problem, 'export it again') from None

    def values(group: str, key: str) -> list[Any]:
        return list(content['parameters'].get(group, {}).get(key, {}).get('value', []))

    def names(group: str, count: int) -> list[str]:
        """Return the names of points or channels; beyond 255 they go on in further parameters."""
        labels = [one for n in ('', *range(2, 10)) for one in values(group, f'LABELS{n}')]
        labels = [*labels, *[''] * count][:count]
        return [one.strip() or f'{group.lower()} {i + 1}' for i, one in enumerate(labels)]

    points = content['data']['points']  # (4, J, F)
    rate, count = (values('POINT', 'RATE') or [0.0])[0], points.shape[2]
    if not points.shape[1] or not count or rate <= 0.0:
        raise DataSetError(shown, 'holds no frames of points', 'export the markers, too')
    columns: dict[str, Floats] = {'time': np.arange(count) / rate}
    units = {'time': 's'}
    length = str((values('POINT', 'UNITS') or ['mm'])[0])
    written = names('POINT', points.shape[1])
    labels = _apart(written)
    axes = [f'{label} {axis}' for label in labels for axis in 'xyz']
    columns |= zip(axes, np.concatenate(points[:3].swapaxes(0, 1)).astype(float), strict=True)
    units |= dict.fromkeys(axes, length)
    analogs = content['data']['analogs'][0]  # (A, F times frames per point)
    channels = _apart(names('ANALOG', len(analogs)))
    means = (one.reshape(count, -1).mean(axis=1) for one in analogs)
    columns |= zip(channels, means, strict=True)
    written_units = zip(channels, values('ANALOG', 'UNITS'), strict=False)
    units |= {channel: unit.strip() for channel, unit in written_units if find_unit(unit)}
    screen = str((values('POINT', 'Y_SCREEN') or [''])[0]).strip().lower().lstrip('+')
    up = screen if screen in UPS else None
    notes = [f'.c3d, lengths in {length}' + (f', {up} up' if up else '')]
    for twice in dict.fromkeys(label for label in written if written.count(label) > 1):
        own = [new for new, old in zip(labels, written, strict=True) if old == twice]
        notes.append(f'{len(own)} points are called {twice!r}: taken as {listing(own)}')
    return RawTable(shown, columns, units=units, up=up, notes=tuple(notes))


def _apart(labels: Sequence[str]) -> list[str]:
    """Make labels unique: the second `disk` becomes `disk no 2`."""
    apart: list[str] = []
    for label in labels:
        number, name = 1, label
        while name in apart or (number > 1 and name in labels):
            number += 1
            name = f'{label} no {number}'
        apart.append(name)
    return apart


WHOSE = {
    *('id', 'ids', 'name', 'tag', 'marker', 'label', 'body', 'object', 'tool', 'sensor', 'point'),
    *('target', 'landmark', 'tracker', 'child', 'rigidbody', 'idx', 'index'),
}
ROUND = 'round of markers'


def widened(table: RawTable) -> RawTable:
    """
    Convert a long table to a row for each time; a wide table is returned as it is.

    A table is long where it has one place in a row, and a column that says whose place it is:
    with several values, whose times overlap. Other columns that differ between rows of one time
    are the marker's own.
    """
    if sum(not triple.quantity for triple in triples_of(table)) != 1:
        return table
    time = guess_time(names_of(table))
    whose = None if time is None else _whose(table, time.column)
    if time is None or whose is None:
        return table
    frame = pandas().DataFrame(table.columns)
    number = frame[time.column].to_numpy()
    if len(set(number)) == len(number):  # rows have times of their own
        in_round, count, number = set[Hashable](), 0, []  # a round has each marker once at most
        for value in frame[whose]:
            if value in in_round:
                count, in_round = count + 1, set()
            in_round.add(value)
            number.append(count)
    keys = frame.assign(**{ROUND: number}).drop_duplicates([ROUND, whose])
    rounds = keys.groupby(ROUND, sort=True)
    others = [c for c in frame.columns if c not in (whose, time.column)]
    own = [c for c in others if (rounds[c].nunique(dropna=False) > 1).any()]
    shared = rounds[[c for c in frame.columns if c not in (*own, whose)]].first()
    wide = keys.pivot(index=ROUND, columns=whose, values=own)
    names = {}
    for c, w in wide.columns:
        text = str(int(w)) if isinstance(w, float) and w.is_integer() else str(w)
        names[c, w] = f'{f"marker {text}" if text.isdigit() else text} {c}'
    wide.columns = [names[key] for key in wide.columns]
    units = dict(table.units)
    units |= {named: table.units[c] for (c, _), named in names.items() if c in table.units}
    markers = len(frame[whose].unique())
    note = f'a row for each {whose} and time: {markers} markers, {len(wide):,} times'
    joined = shared.join(wide).reset_index(drop=True)
    result = table_of(table.name, joined.infer_objects(), units, None, (*table.notes, note))
    return replace(result, up=table.up, part=table.part)


def _whose(table: RawTable, time: str) -> str | None:
    """Return the column that names the marker of each row, None if there is none."""
    others = {time, *(column for triple in triples_of(table) for column in triple.columns)}
    stamps = _numbered(table, time)
    best, many = None, 1
    for name in names_of(table):
        if not WHOSE & set(name.words) or name.column in others or kind_of_flag(name):
            continue
        values = _numbered(table, name.column)
        if not np.isfinite(values).all() or np.any(values != np.round(values)):
            continue
        known = np.unique(values)
        if not many < len(known) <= min(ROWS_MAX, len(table) // 2):
            continue
        spans = sorted((stamps[values == v].min(), stamps[values == v].max()) for v in known)
        if any(b[0] <= a[1] for a, b in pairwise(spans)):
            best, many = name.column, len(known)
    return best


def _numbered(table: RawTable, column: str) -> Floats:
    """Return the numbers (R,) of a column; of texts their numbers in alphabetical order."""
    if table.is_text(column):
        return np.unique(table.columns[column], return_inverse=True)[1].astype(float)
    return table.columns[column]
