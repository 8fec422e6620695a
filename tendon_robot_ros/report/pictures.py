"""
Pictures that are files: a robot with its cross-section; a path that was followed.

The second as a table, too.
"""

from __future__ import annotations

from itertools import chain, cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.arrays import Floats, evenly, interpolated
from ..common.colours import COLOURS, ERROR, FLOOR, INK, MEASURED, PREDICTED
from ..common.errors import NoEquilibriumError
from ..common.files import write_picture
from ..common.words import columns
from ..data.path_files import PathRun
from ..model.shape import plot_arms
from ..robot.estimates import bend_rates
from .page import Shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..model.model import Model

# kind of picture -> width and height [in], dots per inch, and [pt] letters: about 1200 px wide, so
# that letters have 9 px on a phone
STYLES = {
    'robot': ((8.0, 13.0), 150, 14.0),
    'path': ((11.0, 6.5), 110, 10.0),
    'lines': ((6.0, 4.0), 150, 10.0),
}


def draw_robot(model: Model, path: Path) -> Figure:
    """Draw the robot into an image file, and return the figure; legends stand below the axes."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    size, dots, letters = STYLES['robot']
    spatial = bool(np.any(model.arrays.offset[..., 1]))
    with rc_context({'font.size': letters, 'axes.titlesize': letters}):
        figure = Figure(figsize=size, layout='constrained')
        side = figure.add_subplot(2, 1, 1, projection='3d' if spatial else None)
        draw_postures(side, model, spatial)
        draw_cross_section(figure.add_subplot(2, 1, 2), model)
        figure.suptitle(model.robot.name)
        write_picture(figure, path, dots)
    return figure


def postures(model: Model) -> list[tuple[str, Floats]]:
    """
    Return positions (n, 3) [m] of the ends of the cells under each input alone.

    Each bends its section by a right angle, where its limits allow that.
    """
    low, high = model.limits.T
    bends, rows = bend_rates(model.robot), []
    for j, name in enumerate(model.inputs):
        tensions = low.copy()
        rate = float(np.linalg.norm(bends[j]))  # [rad/N] of the section that it ends in (PCCA)
        tensions[j] = np.clip(0.5 * np.pi / rate if rate > 0.0 else 0.0, low[j], high[j])
        try:
            shape = model.shape(tensions)
        except NoEquilibriumError:  # the description may still lack a sensible load
            continue
        rows.append((f'{name} {tensions[j]:.2g} N', shape.positions))
    return rows


def draw_postures(axes: Any, model: Model, spatial: bool) -> None:
    """Draw the straight arm, and the arm under each input alone."""
    ends = np.cumsum(model.arrays.cells[:, 0])
    arms = [('straight', np.outer(ends, [0.0, 0.0, 1.0])), *postures(model)]
    colours = chain([FLOOR], cycle(COLOURS))
    for (label, points), colour in zip(arms, colours, strict=False):
        plot_arms(points[None], axes, color=colour, label=label, markersize=6, linewidth=1.8)
    if spatial:
        axes.view_init(elev=22.0, azim=-42.0)  # no tendon of three or six hides another
        axes.locator_params(nbins=4)
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
            axis.labelpad = 10.0
    else:
        axes.grid(alpha=0.3)
    axes.set_title('each input alone, the others at their lower limit')
    legend_below(axes)


def draw_cross_section(axes: Any, model: Model) -> None:
    """Draw the routes of the tendons from base to tip, with their names around the arm."""
    from matplotlib.patches import Circle

    robot = model.robot
    colours = {s.name: COLOURS[i % len(COLOURS)] for i, s in enumerate(robot.own_sections)}
    places = (model.arrays.offset, model.arrays.cells[:, 5:])
    largest = 1e3 * max(float(np.abs(at).max()) for at in places)
    axes.add_patch(Circle((0.0, 0.0), 1.3 * largest, fill=False, color=FLOOR))
    holes: dict[tuple[float, float], list[str]] = {}  # [mm], tendons that begin there
    for k, tendon in enumerate(robot.tendons):
        route = 1e3 * model.arrays.offset[: robot.tendon_cells[k], k]
        axes.plot(*route.T, '-', color=colours[tendon.section], linewidth=1.5)
        own = holes.setdefault((1e3 * tendon.base[0], 1e3 * tendon.base[1]), [])
        ring = 9.0 + 6.0 * len(own)  # [pt] around what begins at the same place
        style = {'color': colours[tendon.section], 'fillstyle': 'none' if own else 'full'}
        axes.plot(*route[0], 'o', markersize=ring, markeredgewidth=2.0, **style)
        own.append(tendon.name)
    for hole, names in holes.items():
        size = max(float(np.hypot(*hole)), 1e-9)
        beyond = 1.42 * largest * np.array(hole) / size  # outside of the arm
        side = ('right', 'center', 'left')[round(hole[0] / size) + 1]
        line = {'arrowstyle': '-', 'color': FLOOR}
        axes.annotate('\n'.join(names), hole, beyond, va='center', ha=side, arrowprops=line)
    beside = 1e3 * model.arrays.cells[:, 5:]
    if beside.any():
        axes.plot(*beside.T, 'x', color=ERROR, label='weight of the cells')
    for name, colour in colours.items():
        axes.plot([], [], 'o', color=colour, label=f'ends in {name}')
    across = np.array(robot.gravity or (0.0, 0.0, 0.0))[:2]
    if across.any():  # a level arm: the direction in which weights pull
        end = 0.8 * largest * across / np.linalg.norm(across)
        axes.annotate('', end, (0.0, 0.0), arrowprops={'arrowstyle': '->', 'color': ERROR})
        axes.annotate('down', (0.0, 0.0), -0.35 * end, color=ERROR, ha='center', va='center')
    x, y = 2.7 * largest, 1.7 * largest
    axes.set(aspect='equal', xlim=(-x, x), ylim=(-y, y), xlabel='x [mm]', ylabel='y [mm]')
    axes.set_title('tendons from the base (dot) on, seen from the tip')
    axes.grid(alpha=0.3)
    legend_below(axes)


def legend_below(axes: Any) -> None:
    """Add a legend below its axes: beside them it would take half of the width."""
    below = (0.5, -0.12)  # [1] of the axes
    axes.legend(loc='upper center', bbox_to_anchor=below, ncols=2, frameon=False)


def path_lines(run: PathRun) -> list[str]:
    """Return the table, and what was between the rows."""
    head, *body = tip_rows(run) if run.target_values is None else tendon_rows(run)
    shown = evenly(len(body), Shown.ROWS)
    text = [] if run.target_values is None else [f'tendons: {", ".join(run.inputs)}']
    text.append(columns([head, *(body[i] for i in shown)]))
    if len(shown) < len(body):
        text.append(f'{len(shown)} of {len(body)} rows')
    if run.target_values is None:
        rms, worst, across = run.distances()
        text.append(
            f'on the way: {_mm(rms)} rms and {_mm(worst)} at most from the target of the moment, '
            f'{_mm(across)} at most from the path'
        )
    if not run.measured:
        text.append('no tracker: the tip is where the model sees it')
    return text


def tip_rows(run: PathRun) -> list[list[str]]:
    """Return the rows of a path of the tip: what was requested and what was reached."""
    errors, rotations = run.errors(run.row_times)
    goals, views = run.targets.at(run.row_times)
    reached, _ = run.tips.at(run.row_times)
    rows = [['row', 'time [s]', 'asked x, y, z [mm]', 'reached [mm]', 'error', 'turned by']]
    for i, time in enumerate(run.row_times):
        angle = '' if np.isnan(views[i]).any() else f'{np.degrees(rotations[i]):.2f}°'
        places = [place(goals[i]), place(reached[i])]
        rows.append([str(i + 1), f'{time:.2f}', *places, _mm(errors[i]), angle])
    return rows


def tendon_rows(run: PathRun) -> list[list[str]]:
    """Return the rows of a path of tensions or wire pulls: requested, commanded, and the tip."""
    assert run.target_values is not None
    scale, unit = (1e3, 'mm') if run.pull else (1.0, 'N')
    reached, _ = run.tips.at(run.row_times)
    commanded = interpolated(run.row_times, run.command_times, run.commands)
    rows = [['row', 'time [s]', f'asked [{unit}]', f'commanded [{unit}]', 'tip [mm]']]
    for i, time in enumerate(run.row_times):
        goals, sent = (
            ', '.join(f'{scale * v:.2f}' for v in values)
            for values in (run.target_values[i], commanded[i])
        )
        rows.append([str(i + 1), f'{time:.2f}', goals, sent, place(reached[i])])
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

    size, dots, _ = STYLES['path']
    figure = Figure(figsize=size, layout='constrained')
    spans = np.ptp(run.tips.positions, axis=0)
    # of a path in the x-z plane the other side shows nothing
    left = ['xz'] if spans[1] < Shown.FLAT_FRACTION * spans.max() else ['xz', 'yz']
    widths = [*[2.0 / len(left)] * len(left), 1.5]
    parts = figure.subplot_mosaic([[*left, 'error'], [*left, 'command']], width_ratios=widths)
    for axis, name in enumerate(left):
        draw_side(parts[name], run, axis)
    draw_errors(parts['error'], run)
    draw_commands(parts['command'], run)
    for axes in parts.values():
        axes.spines[['top', 'right']].set_visible(False)
        axes.grid(alpha=0.25)
    figure.suptitle(title, x=0.01, ha='left', fontsize='medium')
    return write_picture(figure, path, dots)


def draw_side(axes: Any, run: PathRun, axis: int) -> None:
    """Draw the requested and the reached path, with arrows where a row requests a direction."""
    reached, _ = run.tips.at(run.row_times)
    if len(run.targets):
        goals, views = run.targets.at(run.row_times)
        axes.plot(
            *_flat(run.targets.positions, axis), '--', color=FLOOR, linewidth=1.2, label='asked'
        )
        if len(goals) <= Shown.MARKED_ROWS:
            axes.plot(*_flat(goals, axis), 'o', color=FLOOR, markersize=5, fillstyle='none')
        shown = evenly(len(goals), Shown.ARROWS)
        for place, view in zip(goals[shown], views[shown], strict=True):
            if np.isfinite(view).all() and np.hypot(view[axis], view[2]) > 0.1:
                (x, z), tip = _flat(place, axis), 8.0 * view[[axis, 2]]
                arrow = {'arrowstyle': '->', 'color': FLOOR}
                axes.annotate('', (x + tip[0], z + tip[1]), (x, z), arrowprops=arrow)
    label = 'measured' if run.measured else 'as the model sees it'
    colour = _tip_colour(run)
    axes.plot(*_flat(run.tips.positions, axis), '-', color=colour, linewidth=1.0, label=label)
    if len(reached) <= Shown.MARKED_ROWS:
        axes.plot(*_flat(reached, axis), 'x', color=colour, markersize=5)
    axes.set(xlabel=f'{"xy"[axis]} [mm]', ylabel='z [mm]')
    axes.set_aspect('equal', adjustable='datalim')
    if axis == 0:
        axes.legend(fontsize='small', loc='lower right')


def _tip_colour(run: PathRun) -> str:
    return MEASURED if run.measured else PREDICTED


def _flat(places: Any, axis: int) -> tuple[Any, Any]:
    return 1e3 * places[..., axis], 1e3 * places[..., 2]


def draw_errors(axes: Any, run: PathRun) -> None:
    """Draw the distance from the target over time; the tip itself where no target is known."""
    if not len(run.targets):
        axes.plot(run.tips.times, 1e3 * run.tips.positions, linewidth=1.0, label=['x', 'y', 'z'])
        axes.set_ylabel('tip [mm]')
        axes.legend(fontsize='small', ncols=3, loc='upper right')
        return
    errors, _ = run.errors(run.tips.times)
    colour, label = _tip_colour(run), 'from the target of the moment'
    axes.plot(run.tips.times, 1e3 * errors, color=colour, label=label)
    axes.plot(run.tips.times, 1e3 * run.across(), ':', color=INK, label='from the path')
    at, _ = run.errors(run.row_times)
    if len(at) <= Shown.MARKED_ROWS:
        axes.plot(run.row_times, 1e3 * at, 'x', color=COLOURS[2], label='at the rows')
    axes.set(ylabel='error of the tip [mm]', ylim=(0.0, None))
    axes.legend(fontsize='small', loc='upper right')


def draw_commands(axes: Any, run: PathRun) -> None:
    """Draw the commanded tensions or wire pulls over time, and those that were requested."""
    scale = 1e3 if run.pull else 1.0
    for i, name in enumerate(run.inputs):
        colour = COLOURS[i % len(COLOURS)]
        axes.plot(run.command_times, scale * run.commands[:, i], color=colour, label=name)
        if run.target_values is not None:
            requested = scale * run.target_values[:, i]
            axes.plot(run.row_times, requested, 'o', color=colour, ms=4, fillstyle='none')
    axes.set(xlabel='time [s]', ylabel='wire pull [mm]' if run.pull else 'tension [N]')
    axes.legend(fontsize='small', ncols=2, loc='upper right')
