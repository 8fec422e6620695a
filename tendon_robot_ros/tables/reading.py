"""A file to named columns: CSV, also OptiTrack's and Vicon's, Parquet, .c3d."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ..common.dataframes import pandas
from ..common.errors import DataSetError, MissingExtraError, short
from ..common.files import TABLE_ENDINGS, TEXT_ENDINGS
from ..common.units import find_unit
from .columns import MISSING, RawTable, is_number, table_of
from .formats import is_optitrack, is_vicon, optitrack_header, read_c3d, vicon_header

BYTES_MAX = 1_000_000_000  # of a file: its numbers and their parse must fit into the memory
HEAD = 1 << 16  # bytes that tell what kind of file it is
BLOCK = 1 << 24  # bytes that are counted at once
DELIMITERS = {',': 'commas', ';': 'semicolons', '\t': 'tabs'}


def read_table(path: str | Path) -> RawTable:
    """
    Read a file by its ending: .csv (.txt, .tsv, .dat), .parquet or .c3d.

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
        raise DataSetError(
            shown, problem, f'name a file that ends with {", ".join(TABLE_ENDINGS)}'
        )
    size = path.stat().st_size
    if size > BYTES_MAX:
        raise DataSetError(
            shown,
            f'has {size / 1e9:.1f} GB, more than {BYTES_MAX / 1e9:g} GB are not read at once',
            'export 50 frames a second and the columns you need, or one file per recording',
        )
    if size == 0:
        raise DataSetError(shown, 'is empty', 'export it again')
    ending = path.suffix.lower()
    if ending == '.parquet':
        return _read_parquet(shown, path)
    if ending == '.c3d':
        return read_c3d(shown, path)
    if ending not in TEXT_ENDINGS:
        raise DataSetError(
            shown,
            f'is no table that can be read ({ending or "no ending"})',
            f'save it as CSV; known endings: {", ".join(TABLE_ENDINGS)}',
        )
    return _read_text(shown, path)


def _read_parquet(shown: str, path: Path) -> RawTable:
    try:
        frame = pandas().read_parquet(path)
    except ImportError:
        raise MissingExtraError('pyarrow', 'tables') from None
    except Exception as error:  # a damaged file can fail anywhere in the parser
        reason = ' '.join(str(error).split())[:160]
        raise DataSetError(shown, f'is no Parquet file ({reason})', 'export it again') from None
    return table_of(shown, frame, {}, None, ())


# -----------------------------------------------------------------------------
# Text: which delimiter, where the header ends, and whether all rows are whole.


@dataclass(frozen=True)
class TextLayout:
    """How a text file is laid out."""

    encoding: str
    delimiter: str
    header: tuple[str, ...]
    units: dict[str, str]
    skip: int  # lines before the numbers
    notes: tuple[str, ...]


def _read_text(shown: str, path: Path) -> RawTable:
    head = _head(shown, path)
    encoding, notes = _encoding(head)
    lines = head.decode(encoding, errors='ignore').splitlines()
    if is_optitrack(lines):
        names, units, skip, told = optitrack_header(shown, lines)
        table = _numbers(shown, path, TextLayout(encoding, ',', names, units, skip, told))
        return replace(table, up='y')
    if is_vicon(lines):
        names, units, skip, told, rate = vicon_header(shown, lines)
        table = _numbers(shown, path, TextLayout(encoding, ',', names, units, skip, told))
        columns = {**table.columns, 'time': table.numbers('time') / rate}
        return replace(table, columns=columns, up='z')
    return _numbers(shown, path, _layout(shown, lines, encoding, notes))


def _head(shown: str, path: Path) -> bytes:
    with path.open('rb') as file:
        head = file.read(HEAD)
    if b'\0' in head:
        raise DataSetError(shown, 'is no text file', 'export it as CSV (UTF-8)')
    if not head.strip():
        raise DataSetError(shown, 'is empty', 'export it again')
    return head


def _encoding(head: bytes) -> tuple[str, tuple[str, ...]]:
    try:
        head[: HEAD - 4].decode('utf-8-sig')
    except UnicodeDecodeError as error:
        if error.start < len(head) - 8:
            return 'cp1252', ('text is taken as Windows-1252: it is no UTF-8',)
    return 'utf-8-sig', ()


def _layout(shown: str, lines: Sequence[str], encoding: str, notes: tuple[str, ...]) -> TextLayout:
    """Find the header: the first line that is no comment, and a line of units below it."""
    skip = 0
    while skip < len(lines) and (not lines[skip].strip() or lines[skip].startswith(('#', '%'))):
        skip += 1
    if skip == len(lines):
        raise DataSetError(shown, 'has no header', 'start it with the names of the columns')
    line = lines[skip]
    delimiter = max(DELIMITERS, key=line.count)
    if not line.count(delimiter):
        raise DataSetError(
            f'{shown}, row {skip + 1}',
            f'has one column only ({short(line.strip()[:40])})',
            'separate columns by commas, semicolons or tabs',
        )
    if delimiter != ',':
        notes = (*notes, f'columns are separated by {DELIMITERS[delimiter]}')
    header = _cells(line, delimiter)
    _check_header(shown, skip + 1, header)
    skip += 1
    units: dict[str, str] = {}
    below = _cells(lines[skip], delimiter) if skip < len(lines) else []
    if len(below) == len(header) and any(below) and all(not c or find_unit(c) for c in below):
        units = {name: unit for name, unit in zip(header, below, strict=True) if unit}
        skip += 1
    return TextLayout(encoding, delimiter, tuple(header), units, skip, notes)


def _cells(line: str, delimiter: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]


def _check_header(shown: str, row: int, header: list[str]) -> None:
    where = f'{shown}, row {row}'
    if sum(is_number(cell) for cell in header) > len(header) / 2:
        raise DataSetError(
            where, 'is no header, it holds numbers', 'start the file with the names of the columns'
        )
    while header and not header[-1]:  # a delimiter at the end of every line
        header[-1] = f'column {len(header)}'
    for index, name in enumerate(header):
        if not name:
            raise DataSetError(where, f'column {index + 1} has no name', 'give it one')
        if header.index(name) != index:
            raise DataSetError(where, f'column {short(name)} stands twice', 'rename one of them')


def _numbers(shown: str, path: Path, layout: TextLayout) -> RawTable:
    """Parse the rows below a header."""
    decimal = '.'
    notes = layout.notes
    if layout.delimiter != ',' and _has_decimal_commas(path, layout):
        decimal, notes = ',', (*notes, 'numbers have decimal commas')
    rows = _count_rows(shown, path, layout)
    try:
        frame = pandas().read_csv(
            path,
            sep=layout.delimiter,
            decimal=decimal,
            header=None,
            names=list(layout.header),
            skiprows=layout.skip,
            encoding=layout.encoding,
            encoding_errors='replace',
            na_values=list(MISSING),
            keep_default_na=False,
            skipinitialspace=True,
            index_col=False,
            low_memory=False,
            nrows=rows,
        )
    except (ValueError, OSError) as error:  # ParserError is a ValueError
        reason = ' '.join(str(error).split())[:160]
        raise DataSetError(shown, f'cannot be read ({reason})', 'export it again') from None
    if rows is not None:
        notes = (*notes, f'the last row, {layout.skip + rows + 1}, is cut short: left out')
    empty = [n for n in frame.columns if n.startswith('column ') and frame[n].isna().all()]
    return table_of(shown, frame.drop(columns=empty), dict(layout.units), layout.skip + 1, notes)


def _has_decimal_commas(path: Path, layout: TextLayout) -> bool:
    with path.open(encoding=layout.encoding, errors='ignore') as file:
        lines = [line for _, line in zip(range(layout.skip + 20), file, strict=False)]
    cells = [c for line in lines[layout.skip :] for c in _cells(line, layout.delimiter)]
    return any(',' in cell and is_number(cell.replace(',', '.')) for cell in cells)


def _count_rows(shown: str, path: Path, layout: TextLayout) -> int | None:
    """
    Refuse a row with too few or too many cells; None: all rows are whole.

    Delimiters are counted, which takes a tenth of the time of reading; only where they do not
    come out the rows are looked at one by one. Returns how many are whole where the last, as a
    logger that was switched off leaves it, is cut short.
    """
    wanted, mark = len(layout.header) - 1, layout.delimiter.encode()
    delimiters = lines = 0
    plain, last = True, b'\n'
    with path.open('rb') as file:
        for _ in range(layout.skip):
            file.readline()
        while block := file.read(BLOCK):
            delimiters += block.count(mark)
            lines += block.count(b'\n')
            plain = plain and b'"' not in block and b'\n\n' not in block and b'\n\r' not in block
            last = block[-1:]
    lines += last != b'\n'
    if plain and delimiters == wanted * lines:
        return None
    return _find_bad_row(shown, path, layout)


def _find_bad_row(shown: str, path: Path, layout: TextLayout) -> int | None:
    wanted, whole = len(layout.header), 0
    with path.open(encoding=layout.encoding, errors='replace', newline='') as file:
        for _ in range(layout.skip):
            file.readline()
        reader = csv.reader(file, delimiter=layout.delimiter)
        bad: tuple[int, int] | None = None
        for cells in reader:
            if not cells:
                continue
            if bad is not None:
                raise _bad_row(shown, layout, *bad)
            if len(cells) != wanted:
                bad = layout.skip + reader.line_num, len(cells)
                continue
            whole += 1
    if bad is None:
        return None
    if bad[1] > wanted or not whole:
        raise _bad_row(shown, layout, *bad)
    return whole


def _bad_row(shown: str, layout: TextLayout, row: int, cells: int) -> DataSetError:
    remedy = 'write every row with the same columns, empty cells where there is nothing'
    if cells > len(layout.header) and layout.delimiter == ',':
        remedy += ' (decimal commas? export with points)'
    problem = f'has {cells} cells under {len(layout.header)} columns'
    return DataSetError(f'{shown}, row {row}', problem, remedy)
