"""One picture of an import: raw traces, what was cut out, and the markers on the arm."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.colours import COLOURS, GOOD, LEFT_OUT, MEASURED, PREDICTED, REST
from ..data import DataSet
from .measuring import Piece, StillMeasurements
from .raw_table import FloatArray
from .recipe import Recipe

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIZE_IN, DPI, FONT = (8.0, 12.5), 150, 14.0  # 1200 px wide; at 400 px a letter has 9 px
POINTS_MAX = 4000  # of a line


def draw(
    dataset: DataSet,
    measured: StillMeasurements,
    recipe: Recipe,
    members: Sequence[int],
    predicted: FloatArray,
) -> Figure:
    """
    Draw inputs and markers over time, and the postures beside those of the model.

    Parameters
    ----------
    dataset : DataSet
        In the base frame.
    measured : StillMeasurements
        Raw recordings and their still segments.
    recipe : Recipe
        Says what was left out.
    members : sequence of int
        Which of the recordings' markers are on the arm, from base to tip.
    predicted : (P, J, 3) [m]
        The same markers by the robot as described.

    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context({'font.size': FONT, 'axes.spines.top': False, 'axes.spines.right': False}):
        figure = Figure(figsize=SIZE_IN, dpi=DPI, layout='constrained')
        heights = figure.add_gridspec(3, 2, height_ratios=[1.0, 1.0, 1.6])
        _inputs(figure.add_subplot(heights[0, :]), dataset, measured)
        _markers(figure.add_subplot(heights[1, :]), measured, recipe, members)
        for place, axis in ((0, 0), (1, 1)):
            _arm(figure.add_subplot(heights[2, place]), dataset, predicted, axis)
        _key(figure, any(len(piece.cut.times) for piece in measured.pieces))
    return figure


def picture_file(figure: Figure) -> bytes:
    """Return a figure as a PNG file."""
    content = io.BytesIO()
    figure.savefig(content, format='png')
    return content.getvalue()


def _pieces(measured: StillMeasurements) -> list[tuple[float, Piece]]:
    """Return the recordings one after the other, with the time [s] at which each begins."""
    placed, begin = [], 0.0
    for piece in measured.pieces:
        placed.append((begin, piece))
        begin += float(piece.recording.tracks[0].times[-1]) * 1.02
    return placed


def _shade(axes: Axes, measured: StillMeasurements) -> None:
    for begin, piece in _pieces(measured):
        for group, colour in ((piece.resting, REST), (piece.segments, GOOD)):
            for one in group:
                axes.axvspan(
                    begin + one.begin, begin + one.end, color=colour, alpha=0.3, linewidth=0
                )


def _thinned(times: FloatArray) -> slice:
    return slice(None, None, max(len(times) // POINTS_MAX, 1))


def _inputs(axes: Axes, dataset: DataSet, measured: StillMeasurements) -> None:
    tension = dataset.input == 'tension'
    names = dataset.input_names
    for begin, piece in _pieces(measured):
        part = _thinned(piece.recording.state_times)
        times = begin + piece.recording.state_times[part]
        for j, values in enumerate(piece.inputs[part].T):
            scale = 1.0 if tension else 1e3
            axes.plot(times, scale * values, color=COLOURS[j % len(COLOURS)], linewidth=1.0)
    for j, name in enumerate(names[:6]):
        axes.plot([], [], color=COLOURS[j % len(COLOURS)], label=name)
    _shade(axes, measured)
    axes.set_ylabel('tension [N]' if tension else 'wire pull [mm]')
    axes.legend(loc='lower left', bbox_to_anchor=(0.0, 1.0), ncols=6, frameon=False,
                handlelength=1.0, columnspacing=1.0, borderpad=0.0)  # fmt: skip
    axes.margins(x=0.0)


def _markers(
    axes: Axes, measured: StillMeasurements, recipe: Recipe, members: Sequence[int]
) -> None:
    """Draw how far every marker is from where it began, and what was cut out or left out."""
    from matplotlib import colormaps

    out = set(recipe.leave_out or ())
    colours = colormaps['viridis']
    cut: list[FloatArray] = []  # (K, 2) [s] and [mm]
    for begin, piece in _pieces(measured):
        track = piece.recording.tracks[0]
        part = _thinned(track.times)
        for place, j in enumerate(members):
            here = track.positions[part, j]
            seen = np.flatnonzero(np.isfinite(here[:, 0]))
            if not len(seen):
                continue
            away = 1e3 * np.linalg.norm(here - here[seen[0]], axis=1)
            axes.plot(begin + track.times[part], away, color=colours(place / len(members)),
                      linewidth=0.6)  # fmt: skip
            mine = piece.cut.markers == j
            far = 1e3 * np.linalg.norm(piece.cut.places[mine] - here[seen[0]], axis=1)
            cut.append(np.column_stack([begin + piece.cut.times[mine], far]))
    _cut(axes, np.concatenate(cut) if cut else np.zeros((0, 2)))
    _shade(axes, measured)
    segments = iter(measured.segments)
    for begin, piece in _pieces(measured):
        for one in (next(segments) for _ in piece.segments):
            if (one.posture, one.trial) in out:
                axes.axvspan(begin + one.begin, begin + one.end, color=LEFT_OUT, alpha=0.8)
    axes.set_ylabel('markers moved [mm]')
    axes.set_xlabel('time [s]' if recipe.time else 'row')
    axes.margins(x=0.0)


def _cut(axes: Axes, readings: FloatArray) -> None:
    """Draw readings (K, 2) [s, mm] that were cut out; what is far off lies at the upper edge."""
    if len(readings):
        top = axes.get_ylim()[1]
        axes.plot(readings[:, 0], np.minimum(readings[:, 1], top), 'x', color=LEFT_OUT,
                  markersize=6.0, clip_on=False, zorder=3.0)  # fmt: skip
        axes.set_ylim(top=top)


def _arm(axes: Axes, dataset: DataSet, predicted: FloatArray, axis: int) -> None:
    """Draw all postures from the side, measured and predicted."""
    for places, colour, width in ((predicted, PREDICTED, 1.8), (dataset.mean, MEASURED, 0.6)):
        for posture in 1e3 * places:
            x, z = np.concatenate([np.zeros((1, 3)), posture])[:, [axis, 2]].T
            axes.plot(x, z, color=colour, linewidth=width)
    x, z = 1e3 * dataset.mean[..., axis], 1e3 * dataset.mean[..., 2]
    axes.plot(x.ravel(), z.ravel(), 'o', color=MEASURED, markersize=4.5)
    axes.plot(0.0, 0.0, 's', color='black', markersize=7.0)
    axes.set_aspect('equal', adjustable='datalim')
    axes.set_xlabel(f'{"xy"[axis]} [mm]')
    if axis == 0:
        axes.set_ylabel('z [mm]')
    axes.grid(alpha=0.3)


def _key(figure: Figure, has_cut: bool) -> Any:
    """Say what colours mean."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Patch(color=GOOD, alpha=0.3, label='taken'),
        Patch(color=REST, alpha=0.6, label='rest'),
        Patch(color=LEFT_OUT, label='left out'),
        Line2D([], [], color=MEASURED, marker='o', linestyle='', label='measured'),
        Line2D([], [], color=PREDICTED, label='model'),
    ]
    if has_cut:
        handles.insert(
            3, Line2D([], [], color=LEFT_OUT, marker='x', linestyle='', label='cut out')
        )
    return figure.legend(
        handles=handles,
        loc='outside lower center',
        ncols=3 if has_cut else 5,
        frameon=False,
        handlelength=1.2,
        columnspacing=1.2,
    )
