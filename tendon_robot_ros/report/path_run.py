"""What was reached along a path against what was asked: as a table and as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..common.colours import COLOURS, FLOOR, INK, MEASURED, PREDICTED
from ..common.files import new_file
from ..common.words import columns
from ..paths.path import PathRun

ROWS_PRINTED_MAX = 30  # rows of a table for a person: a screen
FLAT_WITHIN_SHARE = 0.03  # [1] of the largest extent within which all of it is in one plane
ROWS_DRAWN_MAX = 60  # rows up to which each is marked: more marks would hide the path
ARROWS_MAX = 15  # directions that are drawn, so that they do not cross


def lines(run: PathRun) -> list[str]:
    """Return the table, and what was between the rows."""
    rows = _tendon_rows(run) if run.wanted is not None else _tip_rows(run)
    head, *body = rows
    shown = _chosen(len(body), ROWS_PRINTED_MAX)
    text = [columns([head, *(body[i] for i in shown)])]
    if len(shown) < len(body):
        text.append(f'{len(shown)} of {len(body)} rows')
    if run.wanted is not None:
        text.insert(0, f'tendons: {", ".join(run.inputs)}')
    else:
        rms, worst, across = run.distances()
        text.append(
            f'on the way: {_mm(rms)} rms and {_mm(worst)} at most from the target of the moment, '
            f'{_mm(across)} at most from the path'
        )
    if not run.measured:
        text.append('no tracker: the tip is where the model sees it')
    return text


def _chosen(count: int, most: int) -> np.ndarray:
    """Return which of so many to show, evenly spread, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def _tip_rows(run: PathRun) -> list[list[str]]:
    errors, turns = run.errors(run.row_times)
    asked, views = run.asked_at(run.row_times)
    reached, _ = run.tip_at(run.row_times)
    rows = [['row', 'time [s]', 'asked x, y, z [mm]', 'reached [mm]', 'error', 'turned by']]
    for i, time in enumerate(run.row_times):
        turn = '' if np.isnan(views[i]).any() else f'{np.degrees(turns[i]):.2f}°'
        rows.append(
            [str(i + 1), f'{time:.2f}', place(asked[i]), place(reached[i]), _mm(errors[i]), turn]
        )
    return rows


def _tendon_rows(run: PathRun) -> list[list[str]]:
    assert run.wanted is not None
    scale, unit = (1e3, 'mm') if run.pull else (1.0, 'N')
    reached, _ = run.tip_at(run.row_times)
    commanded = run.commanded_at(run.row_times)
    rows = [['row', 'time [s]', f'asked [{unit}]', f'commanded [{unit}]', 'tip [mm]']]
    for i, time in enumerate(run.row_times):
        asked, came = (
            ', '.join(f'{scale * v:.2f}' for v in values)
            for values in (run.wanted[i], commanded[i])
        )
        rows.append([str(i + 1), f'{time:.2f}', asked, came, place(reached[i])])
    return rows


def place(position: np.ndarray) -> str:
    """Show a position in mm, without a minus before a zero."""
    return ', '.join(f'{round(1e3 * value, 1) + 0.0:.1f}' for value in position)


def _mm(metres: float) -> str:
    return f'{1e3 * metres:.2f} mm'


def draw_run(run: PathRun, path: str | Path, title: str) -> Path:
    """
    Draw the path from two sides, the distance from the target, and the commands.

    Parameters
    ----------
    run : PathRun
        What was followed.
    path : str or Path
        Where the picture goes; the ending says the format: .png, .svg or .pdf.
    title : str
        Stands above.

    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 6.5), layout='constrained')
    sides = {'xz': 0, 'yz': 1}
    spans = np.ptp(run.tips, axis=0)
    if spans[1] < FLAT_WITHIN_SHARE * spans.max():
        del sides['yz']  # all of it is in the x-z plane
    left = [*sides]
    parts = figure.subplot_mosaic(
        [[*left, 'error'], [*left, 'command']], width_ratios=[*[2.0 / len(left)] * len(left), 1.5]
    )
    for name, axis in sides.items():
        _draw_side(parts[name], run, axis)
    _draw_errors(parts['error'], run)
    _draw_commands(parts['command'], run)
    for axes in parts.values():
        axes.spines[['top', 'right']].set_visible(False)
        axes.grid(alpha=0.25)
    figure.suptitle(title, x=0.01, ha='left', fontsize='medium')
    with new_file(Path(path)) as draft:
        figure.savefig(draft, dpi=110)
    return Path(path)


def _draw_side(axes: Any, run: PathRun, axis: int) -> None:
    """Draw asked and reached path, with arrows where a row asks for a direction."""
    reached, _ = run.tip_at(run.row_times)
    if len(run.asked):
        asked, views = run.asked_at(run.row_times)
        axes.plot(*_seen(run.asked, axis), '--', color=FLOOR, linewidth=1.2, label='asked')
        if len(asked) <= ROWS_DRAWN_MAX:
            axes.plot(*_seen(asked, axis), 'o', color=FLOOR, markersize=5, fillstyle='none')
        shown = _chosen(len(asked), ARROWS_MAX)
        for place, view in zip(asked[shown], views[shown], strict=True):
            if np.isfinite(view).all() and np.hypot(view[axis], view[2]) > 0.1:
                (x, z), tip = _seen(place, axis), 8.0 * view[[axis, 2]]
                arrow = {'arrowstyle': '->', 'color': FLOOR}
                axes.annotate('', (x + tip[0], z + tip[1]), (x, z), arrowprops=arrow)
    label = 'measured' if run.measured else 'as the model sees it'
    colour = _tip_colour(run)
    axes.plot(*_seen(run.tips, axis), '-', color=colour, linewidth=1.0, label=label)
    if len(reached) <= ROWS_DRAWN_MAX:
        axes.plot(*_seen(reached, axis), 'x', color=colour, markersize=5)
    axes.set(xlabel=f'{"xy"[axis]} [mm]', ylabel='z [mm]')
    axes.set_aspect('equal', adjustable='datalim')
    if axis == 0:
        axes.legend(fontsize='small', loc='lower right')


def _tip_colour(run: PathRun) -> str:
    return MEASURED if run.measured else PREDICTED


def _seen(places: Any, axis: int) -> tuple[Any, Any]:
    return 1e3 * places[..., axis], 1e3 * places[..., 2]


def _draw_errors(axes: Any, run: PathRun) -> None:
    if not len(run.asked):
        axes.plot(run.tip_times, 1e3 * run.tips, linewidth=1.0, label=['x', 'y', 'z'])
        axes.set_ylabel('tip [mm]')
        axes.legend(fontsize='small', ncols=3, loc='upper right')
        return
    errors, _ = run.errors(run.tip_times)
    axes.plot(
        run.tip_times,
        1e3 * errors,
        color=_tip_colour(run),
        label='from the target of the moment',
    )
    axes.plot(run.tip_times, 1e3 * run.across(), ':', color=INK, label='from the path')
    at, _ = run.errors(run.row_times)
    if len(at) <= ROWS_DRAWN_MAX:
        axes.plot(run.row_times, 1e3 * at, 'x', color=COLOURS[2], label='at the rows')
    axes.set(ylabel='error of the tip [mm]', ylim=(0.0, None))
    axes.legend(fontsize='small', loc='upper right')


def _draw_commands(axes: Any, run: PathRun) -> None:
    scale = 1e3 if run.pull else 1.0
    for i, name in enumerate(run.inputs):
        colour = COLOURS[i % len(COLOURS)]
        axes.plot(run.command_times, scale * run.commands[:, i], color=colour, label=name)
        if run.wanted is not None:
            wanted = scale * run.wanted[:, i]
            axes.plot(run.row_times, wanted, 'o', color=colour, ms=4, fillstyle='none')
    axes.set(xlabel='time [s]', ylabel='wire pull [mm]' if run.pull else 'tension [N]')
    axes.legend(fontsize='small', ncols=2, loc='upper right')
