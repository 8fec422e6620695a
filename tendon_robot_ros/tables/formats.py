"""What the systems that track markers write: CSV exports of OptiTrack and Vicon, and .c3d."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..common.errors import DataSetError, MissingExtraError
from ..common.units import find_unit
from ..common.words import listing
from .columns import FloatArray, RawTable

BEGINS = 'Format Version'  # the first cell that Motive writes
UNUSED = 'unused'  # columns that are named so get no role
HEADER_LINES_MAX = 20
# of a .c3d file: the axis that points up on the screen, as it is written
UP_OF_SCREEN = {f'{sign}{axis}': f'{sign}{axis}'.replace('+', '').lower()
                for sign in ('', '+', '-') for axis in 'XYZ'}  # fmt: skip


def is_optitrack(lines: Sequence[str]) -> bool:
    """Tell whether a text file was exported by OptiTrack's Motive."""
    return bool(lines) and lines[0].lstrip('"').startswith(BEGINS)


def optitrack_header(
    shown: str, lines: Sequence[str]
) -> tuple[tuple[str, ...], dict[str, str], int, tuple[str, ...]]:
    """
    Read the header rows of Motive's CSV export.

    Its rows say type, name, id and quantity of every column, above `Frame, Time (Seconds), X, Y`.

    Returns
    -------
    names, units, skip, notes
        Names of the columns, their units, the lines before the numbers, and what was assumed.

    Raises
    ------
    DataSetError
        A row is missing.

    """
    rows = [[cell.strip() for cell in row] for row in csv.reader(lines[:HEADER_LINES_MAX])]
    number = next((i for i, row in enumerate(rows) if row[:1] == ['Frame']), None)
    kinds = {row[1]: row for row in rows[:number] if len(row) > 2 and not row[0]}
    if number is None or 'Name' not in kinds:
        raise DataSetError(
            shown,
            'begins as an export of OptiTrack, but has no rows Name and Frame',
            'export markers from Motive with header information',
        )
    axes, name = rows[number], kinds['Name']
    quantity = kinds.get('', rows[number - 1])
    kind = kinds.get('Type', [''] * len(axes))
    only = 'Marker' if 'Marker' in kind else None
    names = ['frame', 'time']
    for i in range(2, len(axes)):
        is_place = quantity[i] == 'Position' and (only is None or kind[i] == only)
        names.append(f'{name[i]} {axes[i]}' if is_place else f'{UNUSED} {i + 1} {name[i]}')
    stands = [n for i, n in enumerate(names) if names.index(n) != i]
    if stands:
        raise DataSetError(shown, f'column {stands[0]!r} stands twice', 'rename that marker')
    told = dict(zip(rows[0][::2], rows[0][1::2], strict=False)).get('Length Units', '')
    unit = find_unit(told)
    notes = (f'exported by OptiTrack, lengths in {told or "an unknown unit"}, y up',)
    units = {'time': 's'}
    if unit is not None:
        units |= {n: unit.text for n in names[2:] if not n.startswith(UNUSED)}
    return tuple(names), units, number + 1, notes


def is_vicon(lines: Sequence[str]) -> bool:
    """Tell an export of Nexus by its first line, the name of a section."""
    return bool(lines) and lines[0].strip().strip(',"') in ('Trajectories', 'Devices', 'Joints')


def vicon_header(
    shown: str, lines: Sequence[str]
) -> tuple[tuple[str, ...], dict[str, str], int, tuple[str, ...], float]:
    """
    Read the header rows of the section Trajectories of Vicon Nexus' CSV export.

    Below the name of the section stand frames per second, a marker above its x, the axes, units.

    Returns
    -------
    names, units, skip, notes, rate
        As of `optitrack_header`; `time` counts frames, `rate` of them a second.

    Raises
    ------
    DataSetError
        A row is missing, or another section begins the file.

    """
    rows = [[cell.strip() for cell in row] for row in csv.reader(lines[:5])]
    try:
        rate = float(rows[1][0])
        axes, told = rows[3], rows[4]
        owners = [*rows[2], *([''] * len(axes))]
    except (ValueError, IndexError):
        rate, axes, told, owners = 0.0, [], [], []
    if rows[0][0] != 'Trajectories' or rate <= 0.0 or axes[:1] != ['Frame']:
        raise DataSetError(
            shown,
            'begins as an export of Vicon, but not with frames of trajectories',
            'export from Nexus the section Trajectories alone, with its header rows',
        )
    names, owner = ['time', UNUSED], ''
    for i in range(2, len(axes)):
        owner = owners[i].rpartition(':')[2] or owner
        is_place = axes[i] in ('X', 'Y', 'Z')
        names.append(f'{owner} {axes[i]}' if is_place else f'{UNUSED} {i + 1} {axes[i]}')
    stands = [n for i, n in enumerate(names) if names.index(n) != i]
    if stands:
        raise DataSetError(shown, f'column {stands[0]!r} stands twice', 'rename that marker')
    units = {'time': 's'}
    for name, unit in zip(names[2:], told[2:], strict=False):
        if find_unit(unit) is not None:
            units[name] = unit
    notes = (f'exported by Vicon, {rate:g} frames a second, z up',)
    return tuple(names), units, 5, notes, rate


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
    try:
        import ezc3d
    except ImportError:
        raise MissingExtraError('ezc3d', 'tables') from None
    try:
        content = ezc3d.c3d(str(path))
    except Exception as error:  # a damaged file can fail anywhere in the parser
        reason = ' '.join(str(error).split())[:160]
        raise DataSetError(shown, f'is no .c3d file ({reason})', 'export it again') from None
    points = content['data']['points']  # (4, J, F)
    rate, count = _value(content, 'POINT', 'RATE', 0.0), points.shape[2]
    if not points.shape[1] or not count or rate <= 0.0:
        raise DataSetError(shown, 'holds no frames of points', 'export the markers, too')
    columns: dict[str, FloatArray] = {'time': np.arange(count) / rate}
    units = {'time': 's'}
    length = str(_value(content, 'POINT', 'UNITS', 'mm'))
    written = _labels(content, 'POINT', points.shape[1])
    labels = _apart(written)
    for j, label in enumerate(labels):
        for axis, values in zip('xyz', points[:3, j], strict=True):
            columns[f'{label} {axis}'] = values.astype(float)
            units[f'{label} {axis}'] = length
    analogs = content['data']['analogs'][0]  # (A, F times frames per point)
    many = content['parameters'].get('ANALOG', {}).get('UNITS', {}).get('value', [])
    for a, label in enumerate(_apart(_labels(content, 'ANALOG', len(analogs)))):
        columns[label] = analogs[a].reshape(count, -1).mean(axis=1)
        if a < len(many) and find_unit(many[a]):
            units[label] = many[a].strip()
    up = UP_OF_SCREEN.get(str(_value(content, 'POINT', 'Y_SCREEN', '')).strip().upper())
    notes = [f'.c3d, lengths in {length}' + (f', {up} up' if up else '')]
    for twice in dict.fromkeys(label for label in written if written.count(label) > 1):
        own = [new for new, old in zip(labels, written, strict=True) if old == twice]
        notes.append(f'{len(own)} points are called {twice!r}: taken as {listing(own)}')
    return RawTable(shown, columns, {}, units, None, up, tuple(notes))


def _value(content: Any, group: str, key: str, default: Any) -> Any:
    values = content['parameters'].get(group, {}).get(key, {}).get('value', [])
    return values[0] if len(values) else default


def _apart(labels: Sequence[str]) -> list[str]:
    """Return labels of which none stands twice: the second `disk` is `disk no 2`."""
    apart: list[str] = []
    for label in labels:
        number, name = 1, label
        while name in apart or (number > 1 and name in labels):
            number += 1
            name = f'{label} no {number}'
        apart.append(name)
    return apart


def _labels(content: Any, group: str, count: int) -> list[str]:
    """Return the names of points or channels; more than 255 stand in several parameters."""
    parameters = content['parameters'].get(group, {})
    labels: list[str] = []
    for number in ('', *map(str, range(2, 10))):
        labels += list(parameters.get(f'LABELS{number}', {}).get('value', []))
    labels = [label.strip() or f'{group.lower()} {i + 1}' for i, label in enumerate(labels)]
    labels += [f'{group.lower()} {i + 1}' for i in range(len(labels), count)]
    return labels[:count]
