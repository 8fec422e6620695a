"""What an import of tables gives: a data set, and how it came out of them, in words."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..common.words import mm
from ..data import DataSet, save_dataset
from .choices import Taken
from .marker_order import MarkerOrder
from .measuring import StillMeasurements
from .picture import draw, picture_file
from .raw_table import FloatArray
from .recipe import Recipe, dump_recipe
from .registration import TrackerFrame

if TYPE_CHECKING:
    from matplotlib.figure import Figure
from collections.abc import Sequence

import numpy as np

from ..robot import Robot
from .columns import marker_label
from .registration import angle_of

RECIPE, PICTURE = 'import.yaml', 'import.png'


@dataclass(frozen=True)
class ImportedTable:
    """
    A data set, and how it came out of tables.

    Attributes
    ----------
    dataset : DataSet
        In the robot's base frame.
    recipe : Recipe
        Every choice: importing again with it gives the same data set.
    taken : Taken
        Columns, and how they were recognised.
    measured : StillMeasurements
        Still segments in the tracker's frame, and what was cut out.
    order : MarkerOrder
        Which marker is where.
    frame : TrackerFrame
        How the tracker stands.
    source : str
        The tables, with their sizes.
    predicted : (P, J, 3) [m]
        What the robot as described does in these postures.
    dropped, assumed, look : tuple of str
        What was not used; what nobody said; what asks for a look.

    """

    dataset: DataSet
    recipe: Recipe
    taken: Taken
    measured: StillMeasurements
    order: MarkerOrder
    frame: TrackerFrame
    source: str
    predicted: FloatArray
    dropped: tuple[str, ...]
    assumed: tuple[str, ...]
    look: tuple[str, ...]

    def __repr__(self) -> str:
        """Say what came out."""
        P, Q, J = self.dataset.positions.shape[:3]
        return (
            f'<ImportedTable {self.dataset.name}: {P} postures x up to {Q} trials x {J} markers; '
            f'frame by {self.frame.method}, residual {mm(self.frame.residual)}>'
        )

    def save(self, folder: str | Path, overwrite: bool = False) -> Path:
        """
        Write the data set, its import.yaml and a picture, whole or not at all.

        Raises
        ------
        DataSetError
            The folder is not empty or cannot be written.

        """
        recipe = dump_recipe(self.recipe, Path(folder)).encode()
        return save_dataset(
            self.dataset, folder, overwrite, {RECIPE: recipe, PICTURE: picture_file(self.plot())}
        )

    def plot(self) -> Figure:
        """Draw the raw traces, what was cut out, and the markers on the arm (matplotlib)."""
        members = self.order.members
        return draw(self.dataset, self.measured, self.recipe, members, self.predicted)

    def text(self) -> str:
        """Say which columns were taken, what was dropped and assumed, and how the frame lies."""
        lines = [
            f'{self.dataset.robot.name} from {self.source}',
            columns_table(self.recipe, self.taken),
            '',
        ]
        lines += told('taken', [taken_line(self.dataset, self.measured)])
        lines += told('dropped', self.dropped)
        lines += told('assumed', self.assumed)
        lines += told('frame', frame_lines(self.frame, self.dataset.robot))
        return '\n'.join([*lines, *told('LOOK', self.look)])


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
