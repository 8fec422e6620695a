"""Small exports of trackers as their makers' programs write them, with the truth inside."""

import numpy as np

RATE = 50.0
NAMES = ('disk1', 'disk2', 'disk3', 'disk4')
MOTIVE_WORDS = {
    'marker': 'Marker',
    'body': 'Rigid Body',
    'body marker': 'Rigid Body Marker',
}


def truth(frames=8, points=4):
    """Return places (T, J, 3) [mm] that move, of points 30 mm apart."""
    phase = np.linspace(0.0, 1.0, frames)
    along = 30.0 * (1.0 + np.arange(points))
    x = 0.004 * phase[:, None] * along**2
    y = np.broadcast_to(150.0 + np.arange(points), x.shape)
    z = np.sqrt(along**2 - (0.5 * x) ** 2)
    return np.stack([x, y, z], axis=2).round(3)


def times(frames=8):
    """Return the times [s] of frames."""
    return np.arange(frames) / RATE


def rim(places, radius=12.0, angles=(0.0, 80.0, 200.0)):
    """Return markers (T, J, K, 3) around places (T, J, 3), unevenly, in a plane."""
    turn = np.radians(angles)
    around = radius * np.stack([0.96 * np.cos(turn), np.sin(turn), 0.28 * np.cos(turn)], axis=1)
    return places[:, :, None] + around


def lines(rows, delimiter=',', decimal='.'):
    """Write rows of cells."""
    return ''.join(
        delimiter.join(
            f'{cell:.6f}'.replace('.', decimal) if isinstance(cell, float) else str(cell)
            for cell in row
        )
        + '\n'
        for row in rows
    )


def motive(
    columns,
    at=None,
    version='1.23',
    delimiter=',',
    decimal='.',
    labels=True,
    parent=False,
    unit='Millimeters',
):
    """Write columns (type, name, quantity, axis, values (T,)) as Motive does."""
    at = times(len(columns[0][4])) if at is None else at
    said = ['Type', 'Name', 'ID', 'Parent'] if labels else ['', '', '', '']
    head = [
        ['Format Version', version, 'Take Name', 'Take 1', 'Export Frame Rate', '50.000000',
         'Rotation Type', 'Quaternion', 'Length Units', unit, 'Coordinate Space', 'Global'],
        [],
        ['', said[0], *(MOTIVE_WORDS[c[0]] for c in columns)],
        ['', said[1], *(c[1] for c in columns)],
        ['', said[2], *(f'{abs(hash(c[:2])):032X}' if labels else len(c[1]) for c in columns)],
        *([['', said[3], *('' for c in columns)]] if parent else []),
        ['', '', *(c[2] for c in columns)],
        ['Frame', 'Time (Seconds)', *(c[3] for c in columns)],
    ]  # fmt: skip
    rows = [[i, float(t), *(float(c[4][i]) if np.isfinite(c[4][i]) else '' for c in columns)]
            for i, t in enumerate(at)]  # fmt: skip
    return lines([*head, *rows], delimiter, decimal)


def triple(kind, name, places):
    """Return the columns of a point's x, y and z [mm], of a body its rotation before."""
    turned = [(kind, name, 'Rotation', axis, np.full(len(places), float(axis == 'W')))
              for axis in 'XYZW']  # fmt: skip
    moved = [(kind, name, 'Position', axis, places[:, i]) for i, axis in enumerate('XYZ')]
    return [*(turned if kind == 'body' else []), *moved]


def ghosts(count, frames, first=1000):
    """Return markers that nobody named, each seen in one frame."""
    found = []
    for i in range(count):
        places = np.full((frames, 3), np.nan)
        places[i % frames] = 7.0
        found += triple('marker', f'Unlabeled {first + i}', places)
    return found


def vicon_part(title, owners, axes, units, values, rate=50):
    """Return the rows of a part of an export of Nexus or Tracker: values (T, columns)."""
    per = len(axes)
    return [
        [title],
        [rate],
        ['', '', *(cell for owner in owners for cell in (owner, *[''] * (per - 1)))],
        ['Frame', 'Sub Frame', *axes * len(owners)],
        ['', '', *units * len(owners)],
        *([i + 1, 0, *map(float, row)] for i, row in enumerate(values)),
    ]


def vicon(parts, delimiter=',', decimal='.', padded=False):
    """Write parts one below the other, with an empty line between."""
    rows = [row for i, part in enumerate(parts) for row in ([[]] * (i > 0) + part)]
    width = max(map(len, rows))
    rows = [[*row, *[''] * (width - len(row))] for row in rows] if padded else rows
    return lines(rows, delimiter, decimal)


def qualisys(places, names=NAMES, counted=True, thinned=1):
    """Write the TSV of QTM, with its header; older ones have no Frame and Time."""
    kept = places[::thinned]
    head = [
        ['NO_OF_FRAMES', len(places)], ['NO_OF_CAMERAS', 8], ['NO_OF_MARKERS', len(names)],
        ['FREQUENCY', 50], ['NO_OF_ANALOG', 0], ['DESCRIPTION', '--'],
        ['TIME_STAMP', '2024-01-01, 10:00:00.000', '1234.5'], ['DATA_INCLUDED', '3D'],
        *[['EVENT', 'push', i, 0.1 * i] for i in range(3)],
        ['MARKER_NAMES', *names],
    ]  # fmt: skip
    if counted:
        head = [['FILE_VERSION', '2.0.0'], *head, ['TRAJECTORY_TYPES', *['Measured'] * len(names)]]
        head.append(['Frame', 'Time', *(f'{name} {axis}' for name in names for axis in 'XYZ')])
    rows = [[*((thinned * i + 1, thinned * i / RATE) if counted else ()), *row.ravel().tolist()]
            for i, row in enumerate(kept)]  # fmt: skip
    return lines([*head, *rows], '\t')


def trc(places, names=NAMES, unit='mm'):
    """Write the .trc of Cortex, an empty line below its head."""
    frames = len(places)
    head = [
        ['PathFileType', 4, '(X/Y/Z)', 'run.trc'],
        ['DataRate', 'CameraRate', 'NumFrames', 'NumMarkers', 'Units', 'OrigDataRate'],
        [RATE, RATE, frames, len(names), unit, RATE],
        ['Frame#', 'Time', *(cell for name in names for cell in (name, '', ''))],
        ['', '', *(f'{axis}{j + 1}' for j in range(len(names)) for axis in 'XYZ')],
        [],
    ]
    rows = [[i + 1, i / RATE, *row.ravel().tolist()] for i, row in enumerate(places)]
    return lines([*head, *rows], '\t')


def ndi_toolbox(places):
    """Write the CSV of NDI ToolBox: the names of columns come again for every tool."""
    tools = range(places.shape[1])
    each = ['Frame', 'Face', 'State', 'Q0', 'Qx', 'Qy', 'Qz', 'Tx', 'Ty', 'Tz', 'Error']
    head = ['Tools', *(cell for j in tools for cell in (f'Port {j + 1}', *each))]
    rows = [
        [places.shape[1], *(cell for j in tools for cell in
         (f'Port {j + 1}', 100 + i, 0, 'OK', 1.0, 0.0, 0.0, 0.0, *row[j].tolist(), 0.1))]
        for i, row in enumerate(places)
    ]  # fmt: skip
    return lines([head, *rows])


def ndi_first_principles(places, names=NAMES):
    """Write the CSV of NDI First Principles."""
    head = [
        ['Number of frames:', len(places)],
        ['Frequency:', RATE],
        ['Units:', 'mm'],
        [],
        ['Frame', *(f'{name} {axis}' for name in names for axis in 'xyz')],
    ]
    return lines([*head, *([i + 1, *row.ravel().tolist()] for i, row in enumerate(places))])
