"""The result of an import of tables: a data set, and its derivation in words and as a picture."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.arrays import Floats
from ..common.colours import COLOURS, GOOD, LEFT_OUT, MEASURED, PREDICTED, REST
from ..common.results import TextResult
from ..common.rotations import rotation_angle
from ..common.words import LISTED_MAX, columns, mm
from ..data import DataSet, save_dataset
from ..data.dataset import extent
from ..inference.session import POSTURES_MAX
from ..robot import Robot
from .columns import marker_label
from .markers import MarkerOrder
from .measuring import Piece, StillMeasurements
from .recipe import Recipe, Selection, dump_recipe
from .registration import TrackerFrame

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class ImportedTable(TextResult):
    """
    A data set, and how it was derived from tables.

    Attributes
    ----------
    dataset : DataSet
        In the robot's base frame.
    recipe : Recipe
        Every choice; an import with this recipe gives the same data set.
    taken : Selection
        Columns, and how they were recognised.
    measured : StillMeasurements
        Still segments in the tracker's frame, and the excluded readings.
    order : MarkerOrder
        The positions of the markers along the arm.
    frame : TrackerFrame
        Pose of the tracker's frame in the base frame.
    source : str
        The tables, with their sizes.
    predicted : (P, J, 3) [m]
        Marker positions of these postures by the robot as described.
    dropped, assumed, look : tuple of str
        Excluded columns and readings; assumptions; contradictions that should be checked.

    """

    dataset: DataSet
    recipe: Recipe
    taken: Selection
    measured: StillMeasurements
    order: MarkerOrder
    frame: TrackerFrame
    source: str
    predicted: Floats
    dropped: tuple[str, ...]
    assumed: tuple[str, ...]
    look: tuple[str, ...]

    def __repr__(self) -> str:
        """Summarise the result."""
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
        recipe, picture = dump_recipe(self.recipe, Path(folder)).encode(), io.BytesIO()
        self.plot().savefig(picture, format='png')
        beside = {'import.yaml': recipe, 'import.png': picture.getvalue()}
        return save_dataset(self.dataset, folder, overwrite, beside)

    def plot(self) -> Figure:
        """
        Draw inputs and markers over time, and the postures beside those of the model (matplotlib).

        Readings and trials that were left out are marked.
        """
        from matplotlib import colormaps, rc_context
        from matplotlib.figure import Figure
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        style: Any = {
            'font.size': 14.0,
            'axes.spines.top': False,
            'axes.spines.right': False,
            'legend.frameon': False,
            'legend.handlelength': 1.1,
            'legend.columnspacing': 1.1,
        }
        with rc_context(style):
            figure = Figure(figsize=(8.0, 12.5), dpi=150, layout='constrained')  # 1200 pixels wide
            heights = figure.add_gridspec(3, 2, height_ratios=[1.0, 1.0, 1.6])
            self._draw_inputs(figure.add_subplot(heights[0, :]))
            self._draw_markers(figure.add_subplot(heights[1, :]))
            drawn = slice(None, None, max(len(self.dataset.postures) // POSTURES_MAX, 1))
            for axis, name in enumerate('xy'):  # postures from two sides
                axes = figure.add_subplot(heights[2, axis])
                predicted, measured = (
                    1e3 * np.insert(places[drawn], 0, 0.0, axis=1).T[[axis, 2]]
                    for places in (self.predicted, self.dataset.mean)
                )
                axes.plot(*predicted, color=PREDICTED, linewidth=1.8)
                axes.plot(*measured, 'o-', color=MEASURED, linewidth=0.6, markersize=4.5)
                axes.plot(0.0, 0.0, 's', color='black', markersize=7.0)
                axes.set_aspect('equal', adjustable='datalim')
                axes.set_xlabel(f'{name} [mm]')
                if axis == 0:
                    axes.set_ylabel('z [mm]')
                axes.grid(alpha=0.3)
            has_cut = any(len(piece.cut) for piece in self.measured.pieces)
            colours = colormaps['plasma']
            handles = [
                Patch(color=GOOD, alpha=0.3, label='taken'),
                Patch(color=REST, alpha=0.6, label='rest'),
                Patch(**EXCLUDED_STYLE, label='left out'),
                *[Line2D([], [], color=LEFT_OUT, marker='x', linestyle='', label='cut out')]
                * has_cut,
                Line2D([], [], color=colours(0.0), label='marker next to the base'),
                Line2D([], [], color=colours(TIP_SHADE), label='marker at the tip'),
                Line2D([], [], color=MEASURED, marker='o', linewidth=0.6, label='measured'),
                Line2D([], [], color=PREDICTED, label='model'),
            ]
            figure.legend(handles=handles, loc='outside lower center', ncols=3)
        return figure

    def text(self) -> str:
        """List the columns in use, exclusions, assumptions and the tracker's frame."""
        table = columns_table(self.recipe, self.taken)
        lines = [f'{self.dataset.robot.name} from {self.source}', table, '']
        lines += labelled_lines('taken', [measurement_line(self.dataset, self.measured)])
        lines += labelled_lines('dropped', self.dropped)
        lines += labelled_lines('assumed', self.assumed)
        lines += labelled_lines('frame', frame_lines(self.frame, self.dataset.robot))
        return '\n'.join([*lines, *labelled_lines('LOOK', self.look)])

    def _pieces(self) -> list[tuple[float, Piece]]:
        """Return the recordings one after the other, with the time [s] at which each begins."""
        pieces = self.measured.pieces
        ends = accumulate(1.02 * float(one.recording.tracks[0].times[-1]) for one in pieces)
        return list(zip([0.0, *ends], pieces, strict=False))

    def _shade(self, axes: Axes) -> None:
        for begin, piece in self._pieces():
            for group, colour in ((piece.resting, REST), (piece.segments, GOOD)):
                spans = [(begin + one.begin, one.end - one.begin) for one in group]
                across = axes.get_xaxis_transform()
                style: Any = {'color': colour, 'alpha': 0.3, 'linewidth': 0}
                axes.broken_barh(spans, (0.0, 1.0), transform=across, **style)

    def _draw_inputs(self, axes: Axes) -> None:
        is_tension = self.dataset.input == 'tension'
        unit, scale = ('tension [N]', 1.0) if is_tension else ('wire pull [mm]', 1e3)
        for begin, piece in self._pieces():
            part = _thinned(axes, piece.recording.state_times)
            axes.set_prop_cycle(color=COLOURS)
            times = begin + piece.recording.state_times[part]
            lines = axes.plot(times, scale * piece.recording.inputs[part], linewidth=1.0)
        place: Any = {'loc': 'lower left', 'bbox_to_anchor': (0.0, 1.0)}  # above
        axes.legend(lines, self.dataset.input_names, ncols=4, borderpad=0.0, **place)
        self._shade(axes)
        axes.set_ylabel(unit)
        axes.margins(x=0.0)

    def _draw_markers(self, axes: Axes) -> None:
        """Draw how far every marker moved since the start, and excluded readings and trials."""
        from matplotlib import colormaps

        out = set(self.recipe.leave_out or ())
        colours = colormaps['plasma']
        cut: list[Floats] = []  # (K, 2) [s] and [mm]
        for begin, piece in self._pieces():
            track = piece.recording.tracks[0]
            part = _thinned(axes, track.times)
            for place, j in enumerate(self.order.members):
                path = track.positions[part, j]
                visible = np.flatnonzero(np.isfinite(path[:, 0]))
                if not len(visible):
                    continue
                distance = 1e3 * np.linalg.norm(path - path[visible[0]], axis=1)
                shade = colours(TIP_SHADE * place / max(len(self.order.members) - 1, 1))
                axes.plot(begin + track.times[part], distance, color=shade, linewidth=1.0)
                mine = piece.cut[piece.cut[:, 1] == j]
                far = 1e3 * np.linalg.norm(mine[:, 2:] - path[visible[0]], axis=1)
                cut.append(np.column_stack([begin + mine[:, 0], far]))
        if sum(map(len, cut)):
            when, far = np.concatenate(cut).T
            top = axes.get_ylim()[1]  # distant readings are drawn at the upper edge
            style: dict[str, Any] = {'color': LEFT_OUT, 'markersize': 6.0, 'clip_on': False}
            axes.plot(when, np.minimum(far, top), 'x', zorder=3.0, **style)
            axes.set_ylim(top=top)
        self._shade(axes)
        segments = iter(self.measured.segments)
        for begin, piece in self._pieces():
            for one in (next(segments) for _ in piece.segments):
                if (one.posture, one.trial) in out:
                    axes.axvspan(begin + one.begin, begin + one.end, **EXCLUDED_STYLE)
        axes.set_ylabel('markers moved [mm]')
        axes.set_xlabel('time [s]' if self.recipe.time else 'row')
        axes.margins(x=0.0)


METHODS = {
    'model': "turned and shifted onto the model's postures",
    'level': "the tracker's up laid onto the robot's, turned about it onto the model's postures",
    'straight': "the straight posture laid onto +z, turned about it onto the model's postures",
    'given': 'as given',
    'base': "taken to be the robot's base frame",
}


def labelled_lines(word: str, lines: Sequence[str]) -> list[str]:
    """Put a label before the first of some lines."""
    return [f'{word if i == 0 else "":9}{line}' for i, line in enumerate(lines)]


def columns_table(recipe: Recipe, chosen: Selection) -> str:
    """Return the table of columns: the role of each, its unit, and the reason."""
    rows = [['column', 'taken as', 'unit', 'because']]
    for column, unit in (recipe.time or {}).items():
        rows.append([column, 'time', unit, chosen.reasons.get(column, '')])
    for name, use in (recipe.inputs or {}).items():
        rows.append([use.column, f'input {name}', use.unit, chosen.reasons.get(use.column, '')])
    placed = []
    for marker in recipe.markers or ():
        why = f'{1e3 * (marker.arc_length or 0.0):.4g} mm from the base along the arm'
        many = len(marker.columns) // 3
        what = 'x, y, z' if many == 1 else f'centre of {many} markers'
        label = f'{marker_label(marker.columns)} {what}'
        placed.append([label, f'marker {marker.name}', recipe.positions or '', why])
    if len(placed) > LISTED_MAX:
        placed = [*placed[: LISTED_MAX // 2], ['...', '', '', ''], *placed[-LISTED_MAX // 2 :]]
    return columns([*rows, *placed], len(rows[0]))


def measurement_line(dataset: DataSet, measured: StillMeasurements) -> str:
    """Describe the number of measurements and of the still segments behind them."""
    rule = measured.rule
    total = len(measured.segments) + sum(len(piece.resting) for piece in measured.pieces)
    still = f'{len(measured.segments)} of {total} times that the arm stood still'
    size = extent(dataset.trials, dataset.inputs, len(dataset.markers))
    if measured.pieces[0].motion is None:
        return f'{size}, a row each'
    return f'{size}: {still} (slower than {1e3 * rule.speed:.2g} mm/s for {rule.duration:g} s)'


def frame_lines(frame: TrackerFrame, robot: Robot) -> list[str]:
    """Describe the pose of the tracker's frame, its residual, and its tolerance in a diagnosis."""
    shift = ', '.join(f'{1e3 * x:.1f}' for x in frame.shift)
    angle = np.degrees(rotation_angle(frame.rotation))
    straight = '' if frame.straight is None else f', {mm(frame.straight)} where it is straight'
    off = f'off the model as described by {mm(frame.residual)} rms{straight}'
    lines = [METHODS[frame.method], f'turned by {angle:.1f}°, shifted by {shift} mm; {off}']
    if frame.method != 'base':
        position, rotation = robot.tolerances['position'], robot.tolerances['rotation']
        known = f'known to {mm(position, 2)} and {np.degrees(rotation):.2g}°'
        lines.append(f'{known} (tolerances in robot.yaml): within that a diagnosis moves it')
    return lines


# [1] of the colours of markers, dark at the base: that of the tip, because lighter ones are hard
# to see on white
TIP_SHADE = 0.62
EXCLUDED_STYLE: Any = {'facecolor': 'none', 'edgecolor': LEFT_OUT, 'hatch': '////'}


def _thinned(axes: Axes, times: Floats) -> slice:
    """Return which of many samples to draw: a few for each column of the picture."""
    return slice(None, None, max(len(times) // int(4.0 * axes.bbox.width), 1))
