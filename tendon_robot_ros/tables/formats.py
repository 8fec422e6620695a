"""Files that are no text: .c3d, and those that only their maker's program reads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..common.errors import DataSetError, MissingExtraError
from ..common.units import find_unit
from ..common.words import listing
from .columns import FloatArray, RawTable

# ending -> whose files have it, and what to export instead
MAKERS_OWN = {
    '.tak': ('Motive (OptiTrack)', 'export the take as CSV, with header information, or as C3D'),
    '.tra': ('Motive (OptiTrack)', 'export the take as CSV, with header information, or as C3D'),
    '.qtm': ('Qualisys Track Manager', 'export it as TSV, with its header, or as C3D'),
    '.x1d': ('Vicon Nexus', 'export the trajectories as ASCII (CSV) or C3D'),
    '.x2d': ('Vicon Nexus', 'export the trajectories as ASCII (CSV) or C3D'),
    '.cap': ('Cortex (Motion Analysis)', 'export it as .trc or C3D'),
    '.trb': ('Cortex (Motion Analysis)', 'export it as .trc or C3D'),
    '.fbx': ('animation programs', 'export the markers as CSV or C3D'),
    '.bvh': ('animation programs', 'export the markers as CSV or C3D'),
    '.xlsx': ('Excel', 'save the sheet as CSV'),
    '.xls': ('Excel', 'save the sheet as CSV'),
    '.mat': ('MATLAB', 'write it with writetable as CSV'),
}
# of a .c3d file: the axis that points up on the screen, as it is written
UP_OF_SCREEN = {axis.upper(): axis for axis in ('x', 'y', 'z', '-x', '-y', '-z')}
UP_OF_SCREEN |= {f'+{axis}': axis.lower() for axis in 'XYZ'}
REASON_MAX = 160  # letters of what a parser says: a message stays one line


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
        reason = ' '.join(str(error).split())[:REASON_MAX]
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
    return RawTable(shown, columns, units=units, up=up, notes=tuple(notes))


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
