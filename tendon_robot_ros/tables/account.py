"""What an import tells: which column is what, what was taken, and how the frame lies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..common.words import mm
from ..data import DataSet
from ..robot import Robot
from .choices import Taken
from .columns import marker_label
from .measuring import StillMeasurements
from .recipe import Recipe
from .registration import TrackerFrame, angle_of

MARKERS_MAX = 12  # rows of the table; of more the first and the last are shown
METHODS = {
    'model': "turned and shifted onto the model's postures",
    'level': "the tracker's up laid onto the robot's, turned about it onto the model's postures",
    'straight': "the straight posture laid onto +z, turned about it onto the model's postures",
    'given': 'as given',
    'base': "taken to be the robot's base frame",
}


def told(word: str, lines: Sequence[str]) -> list[str]:
    """Put a word before the first of some lines."""
    return [f'{word if i == 0 else "":9}{line}' for i, line in enumerate(lines)]


def columns_table(recipe: Recipe, taken: Taken) -> str:
    """Return the table of columns: as what each was taken, its unit, and why."""
    rows = [['column', 'taken as', 'unit', 'because']]
    for column, unit in (recipe.time or {}).items():
        rows.append([column, 'time', unit, taken.reasons.get(column, '')])
    for name, use in (recipe.inputs or {}).items():
        rows.append([use.column, f'input {name}', use.unit, taken.reasons.get(use.column, '')])
    placed = []
    for marker in recipe.markers or ():
        why = f'{1e3 * (marker.arc_length or 0.0):.4g} mm from the base along the arm'
        label = f'{marker_label(marker.columns)} x, y, z'
        placed.append([label, f'marker {marker.name}', recipe.positions or '', why])
    if len(placed) > MARKERS_MAX:
        placed = [*placed[: MARKERS_MAX // 2], ['...', '', '', ''], *placed[-MARKERS_MAX // 2 :]]
    return _left_columns([*rows, *placed])


def _left_columns(rows: Sequence[Sequence[str]]) -> str:
    """Align columns of text to the left."""
    widths = [max(len(row[c]) for row in rows) for c in range(len(rows[0]))]
    return '\n'.join(
        '  '.join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    )


def taken_line(dataset: DataSet, measured: StillMeasurements) -> str:
    """Say how many measurements there are, and from how many still segments."""
    trials = dataset.trials
    each = (
        f'{trials.min()}' if trials.min() == trials.max() else f'{trials.min()} to {trials.max()}'
    )
    rule = measured.rule
    found = len(measured.segments) + sum(len(piece.resting) for piece in measured.pieces)
    still = f'{len(measured.segments)} of {found} times that the arm stood still'
    if measured.pieces[0].motion is None:
        return (
            f'{len(trials)} postures x {each} trials x {len(dataset.markers)} markers, a row each'
        )
    return (
        f'{len(trials)} postures x {each} trials x {len(dataset.markers)} markers: {still} '
        f'(slower than {1e3 * rule.speed:.2g} mm/s for {rule.duration:g} s)'
    )


def frame_lines(frame: TrackerFrame, robot: Robot) -> list[str]:
    """Say how the tracker's frame lies, how well that fits, and what a diagnosis makes of it."""
    shift = ', '.join(f'{1e3 * x:.1f}' for x in frame.shift)
    angle = np.degrees(angle_of(frame))
    straight = '' if frame.straight is None else f', {mm(frame.straight)} where it is straight'
    lines = [
        METHODS[frame.method],
        f'turned by {angle:.1f}°, shifted by {shift} mm; off the model as described by '
        f'{mm(frame.residual)} rms{straight}',
    ]
    if frame.method != 'base':
        position, rotation = robot.tolerances['position'], robot.tolerances['rotation']
        lines.append(
            f'known to {mm(position, 2)} and {np.degrees(rotation):.2g}° (tolerances in '
            'robot.yaml): within that a diagnosis moves it'
        )
    return lines
