"""A picture of a robot: its cross-section, and the postures that each input alone gives."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..common.colours import COLOURS, ERROR, FLOOR
from ..common.errors import NoEquilibriumError
from ..model.model import Model
from ..robot.estimates import bend_rates

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = npt.NDArray[np.float64]
BEND_RAD = 0.5 * np.pi  # [rad] that a posture of the picture bends a section by, if it may
SIZE_IN, DPI, FONT = (8.0, 13.0), 150, 14.0  # 1200 px wide; at 400 px a letter has 9 px
BELOW = {'loc': 'upper center', 'bbox_to_anchor': (0.5, -0.12), 'ncols': 2, 'frameon': False}


def draw_robot(model: Model, path: Path) -> Figure:
    """Draw the robot into an image file, and return the figure; legends stand below the axes."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    spatial = bool(np.any(model.arrays.offset[..., 1]))
    with rc_context({'font.size': FONT}):
        figure = Figure(figsize=SIZE_IN, layout='constrained')
        side = figure.add_subplot(2, 1, 1, projection='3d' if spatial else None)
        _postures(side, model, spatial)
        _cross_section(figure.add_subplot(2, 1, 2), model)
        figure.suptitle(model.robot.name)
        figure.savefig(path, dpi=DPI)
    return figure


def postures(model: Model) -> list[tuple[str, Floats]]:
    """Return positions (n + 1, 3) [m] under each input alone, base included."""
    low, high = model.limits.T
    bends, rows = bend_rates(model.robot), []
    for j, name in enumerate(model.inputs):
        tensions = low.copy()
        rate = float(np.linalg.norm(bends[j]))  # [rad/N] of the section that it ends in (PCCA)
        tensions[j] = np.clip(BEND_RAD / rate if rate > 0.0 else 0.0, low[j], high[j])
        try:
            shape = model.shape(tensions)
        except NoEquilibriumError:  # the description may still lack a sensible load
            continue
        points = np.concatenate([np.zeros((1, 3)), shape.positions])
        rows.append((f'{name} {tensions[j]:.2g} N', points))
    return rows


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
        axes.plot(*along, '.-', color=colour, label=label, markersize=6, linewidth=1.8)
    axes.set_aspect('equal')
    axes.set_xlabel('x [mm]', labelpad=10.0 if spatial else None)
    if spatial:
        axes.view_init(elev=22.0, azim=-42.0)  # no tendon of three or six hides another
        axes.locator_params(nbins=4)
        axes.set_ylabel('y [mm]', labelpad=10.0)
        axes.set_zlabel('z [mm]', labelpad=10.0)
    else:
        axes.set_ylabel('z [mm]')
        axes.grid(alpha=0.3)
    axes.set_title('each input alone, the others at their lower limit', fontsize=FONT)
    axes.legend(**BELOW)


def _cross_section(axes: Any, model: Model) -> None:
    robot = model.robot
    colours = {s.name: COLOURS[i % len(COLOURS)] for i, s in enumerate(robot.own_sections)}
    places = (model.arrays.offset, model.arrays.cells[:, 6:])
    largest = 1e3 * max(float(np.abs(at).max()) for at in places)
    angle = np.linspace(0.0, 2.0 * np.pi, 100)
    axes.plot(1.3 * largest * np.cos(angle), 1.3 * largest * np.sin(angle), color=FLOOR)
    holes: dict[tuple[float, float], list[str]] = {}  # [mm], tendons that begin there
    for k, tendon in enumerate(robot.tendons):
        route = 1e3 * model.arrays.offset[: robot.tendon_cells[k], k]
        axes.plot(*route.T, '-', color=colours[tendon.section], linewidth=1.5)
        own = holes.setdefault((1e3 * tendon.base[0], 1e3 * tendon.base[1]), [])
        ring = 9.0 + 6.0 * len(own)  # [pt] around what begins at the same place
        style: dict[str, Any] = {'markersize': ring, 'markeredgewidth': 2.0}
        style['fillstyle'] = 'none' if own else 'full'
        axes.plot(*route[0], 'o', color=colours[tendon.section], **style)
        own.append(tendon.name)
    for hole, names in holes.items():
        size = max(float(np.hypot(*hole)), 1e-9)
        beyond = 1.42 * largest * np.array(hole) / size  # outside of the arm
        side = ('right', 'center', 'left')[round(hole[0] / size) + 1]
        line = {'arrowstyle': '-', 'color': FLOOR}
        axes.annotate('\n'.join(names), hole, beyond, va='center', ha=side, arrowprops=line)
    beside = 1e3 * model.arrays.cells[:, 6:]
    if beside.any():
        axes.plot(*beside.T, 'x', color=ERROR, label='weight of the cells')
    for name, colour in colours.items():
        axes.plot([], [], 'o', color=colour, label=f'ends in {name}')
    across = np.array(robot.gravity or (0.0, 0.0, 0.0))[:2]
    if across.any():  # a level arm: the way in which weights pull
        end = 0.8 * largest * across / np.linalg.norm(across)
        axes.annotate('', end, (0.0, 0.0), arrowprops={'arrowstyle': '->', 'color': ERROR})
        axes.annotate('down', (0.0, 0.0), -0.35 * end, color=ERROR, ha='center', va='center')
    axes.set_aspect('equal')
    axes.set_xlim(-2.7 * largest, 2.7 * largest)
    axes.set_ylim(-1.7 * largest, 1.7 * largest)
    axes.set_xlabel('x [mm]')
    axes.set_ylabel('y [mm]')
    axes.grid(alpha=0.3)
    axes.set_title('tendons from the base (dot) on, seen from the tip', fontsize=FONT)
    axes.legend(**BELOW)
