"""A picture of a robot: its cross-section, and the postures that each input alone gives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.colours import COLOURS, ERROR, FLOOR
from ..common.errors import NoEquilibriumError
from ..model.model import Model
from ..robot.estimates import bend_rates

Floats = npt.NDArray[np.float64]
BEND_RAD = 0.5 * np.pi  # [rad] that a posture of the picture bends a section by, if it may


def draw_robot(model: Model, path: Path) -> None:
    """Draw the robot into an image file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5), layout='constrained')
    FigureCanvasAgg(figure)
    spatial = bool(np.any(model.arrays.offset[..., 1]))
    side = figure.add_subplot(1, 2, 1, projection='3d' if spatial else None)
    _postures(side, model, spatial)
    _cross_section(figure.add_subplot(1, 2, 2), model)
    figure.suptitle(model.robot.name)
    figure.savefig(path, dpi=120)


def postures(model: Model) -> list[tuple[str, Floats]]:
    """Return positions (n + 1, 3) [m] under each input alone, base included."""
    low, high = model.limits.T
    rows = []
    for j, name in enumerate(model.inputs):
        tensions = low.copy()
        tensions[j] = np.clip(_tension_for(model, j), low[j], high[j])
        try:
            shape = model.shape(tensions)
        except NoEquilibriumError:  # the description may still lack a sensible load
            continue
        rows.append((f'{name} {tensions[j]:.2g} N', _with_base(shape.positions)))
    return rows


def _tension_for(model: Model, j: int) -> float:
    """Tension [N] at which input j alone bends the section it ends in by `BEND_RAD` (PCCA)."""
    rate = float(np.linalg.norm(bend_rates(model.robot)[j]))
    return BEND_RAD / rate if rate > 0.0 else 0.0


def _with_base(positions: Floats) -> Floats:
    return np.concatenate([np.zeros((1, 3)), positions])


def _postures(axes: Any, model: Model, spatial: bool) -> None:
    lengths = model.arrays.cells[:, 0]
    straight = np.zeros((len(lengths) + 1, 3))
    straight[1:, 2] = np.cumsum(lengths)
    lines = [('straight', straight, FLOOR)]
    for j, (label, points) in enumerate(postures(model)):
        lines.append((label, points, COLOURS[j % len(COLOURS)]))
    for label, points, colour in lines:
        x, y, z = 1e3 * points.T
        along = (x, y, z) if spatial else (x, z)
        axes.plot(*along, '.-', color=colour, label=label, markersize=4, linewidth=1.2)
    axes.set_aspect('equal')
    axes.set_xlabel('x [mm]')
    if spatial:
        axes.view_init(elev=22.0, azim=-42.0)  # no tendon of three or six hides another
        axes.set_ylabel('y [mm]')
        axes.set_zlabel('z [mm]')
    else:
        axes.set_ylabel('z [mm]')
        axes.grid(alpha=0.3)
    axes.set_title('each input alone, the others at their lower limit', fontsize=10)
    axes.legend(fontsize=8)


def _cross_section(axes: Any, model: Model) -> None:
    robot = model.robot
    colours = {section.name: COLOURS[i % len(COLOURS)] for i, section in enumerate(robot.sections)}
    places = (model.arrays.offset, model.arrays.cells[:, 6:])
    largest = 1e3 * max(float(np.abs(at).max()) for at in places)
    angle = np.linspace(0.0, 2.0 * np.pi, 100)
    axes.plot(1.3 * largest * np.cos(angle), 1.3 * largest * np.sin(angle), color=FLOOR)
    for k, tendon in enumerate(robot.tendons):
        route = 1e3 * model.arrays.offset[: robot.tendon_cells[k], k]
        axes.plot(*route.T, '-', color=colours[tendon.section], linewidth=1.0)
        x, y = 1e3 * np.array(tendon.base)
        axes.plot(x, y, 'o', color=colours[tendon.section])
        axes.annotate(tendon.name, (x, y), xytext=(5, 5), textcoords='offset points', fontsize=8)
    beside = 1e3 * model.arrays.cells[:, 6:]
    if beside.any():
        axes.plot(*beside.T, 'x', color=ERROR, label='weight of the cells')
    for name, colour in colours.items():
        axes.plot([], [], 'o', color=colour, label=f'ends in {name}')
    across = np.array(robot.gravity or (0.0, 0.0, 0.0))[:2]
    if across.any():  # a level arm: the way in which weights pull
        end = 1.15 * largest * across / np.linalg.norm(across)
        axes.annotate('', end, (0.0, 0.0), arrowprops={'arrowstyle': '->', 'color': ERROR})
        axes.annotate('down', 0.5 * end, color=ERROR, fontsize=8)
    axes.set_aspect('equal')
    axes.set_xlim(-1.8 * largest, 1.8 * largest)
    axes.set_xlabel('x [mm]')
    axes.set_ylabel('y [mm]')
    axes.grid(alpha=0.3)
    axes.set_title('tendons from the base (dot) on, seen from the tip', fontsize=10)
    axes.legend(fontsize=8, loc='lower right')
