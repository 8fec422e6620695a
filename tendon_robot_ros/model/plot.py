"""Pictures of arms for notebooks, with matplotlib; the pages have figures of their own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..common.colours import ERROR, MEASURED, look

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = npt.NDArray[np.float64]
# [1] of the arm's extent, from the x-z plane: an arm farther off is drawn in space, because a
# picture of 500 pixels would hide more than five of them
FLATNESS = 0.01
ELEVATION_DEG = 12.0  # [°] from which arms in space are seen, so that bends towards the eye show


def plot_arms(positions: Floats, axes: Axes | None = None, **style: Any) -> Axes:
    """
    Draw arms (b, n, 3) [m] from the base to the tip.

    Parameters
    ----------
    positions : (b, n, 3) [m]
        Distal ends of the cells.
    axes : matplotlib Axes, optional
        Default: new ones, flat where no arm leaves the x-z plane; else seen across the plane in
        which the arms bend.
    **style
        Of the lines, as for `Axes.plot`.

    """
    arms = 1e3 * np.concatenate([np.zeros((len(positions), 1, 3)), positions], axis=1)
    axes = new_axes(arms) if axes is None else axes
    in_space = hasattr(axes, 'get_zlim')
    for arm in arms:
        axes.plot(*(arm.T if in_space else arm.T[[0, 2]]), **{'marker': '.', **style})
    if in_space:
        axes.set(xlabel='x [mm]', ylabel='y [mm]', zlabel='z [mm]')
    else:
        axes.set(xlabel='x [mm]', ylabel='z [mm]')
    axes.set_aspect('equal')
    return axes


def new_axes(arms: Floats) -> Axes:
    """Return axes for arms (b, n, 3) [mm]: flat, or seen across the plane in which they bend."""
    from matplotlib import pyplot as plt

    in_space = np.abs(arms[..., 1]).max() > FLATNESS * np.ptp(arms, axis=(0, 1)).max()
    figure = plt.figure(layout='constrained')
    made: Any = figure.add_subplot(projection='3d' if in_space else None)
    if in_space:
        made.view_init(elev=ELEVATION_DEG, azim=np.degrees(bending_azimuth(arms)) - 90.0)
    axes: Axes = made
    return axes


def bending_azimuth(points: Floats) -> float:
    """
    Return the direction [rad, from x towards y] in which arms bend that leave the base along z.

    That of the plane through the base's axis to which the points (..., 3) [m] are nearest; points
    that were not seen (nan) do not count, and straight arms bend towards x.
    """
    flat = points.reshape(-1, 3)[:, :2]
    flat = flat[np.isfinite(flat).all(axis=1)]
    x, y = np.linalg.eigh(flat.T @ flat)[1][:, 1] if flat.any() else (1.0, 0.0)
    side = 1.0 if np.sum(flat @ (x, y)) >= 0.0 else -1.0
    return float(np.arctan2(side * y, side * x))


def views_of(points: Floats, azimuth: float) -> Floats:
    """
    Turn points (..., 3) [m] to how they are seen across and along a plane of bending.

    Returns
    -------
    (..., 3) [m]
        In the plane, across it, along the base's axis.

    """
    u = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    return np.stack([points @ u, points @ np.cross([0.0, 0.0, 1.0], u), points[..., 2]], axis=-1)


def plot_sides(measured: Floats, models: Mapping[str, tuple[Floats, Floats]]) -> Figure:
    """
    Draw one posture across the plane in which the arm bends, and along it: no error hides.

    Parameters
    ----------
    measured : (j, 3) [m]
        Markers, nan where not seen.
    models : mapping
        Name -> line (n, 3) and markers (j, 3) [m] as predicted.

    """
    from matplotlib import pyplot as plt

    azimuth = bending_azimuth(measured)
    figure = plt.figure(layout='constrained')
    sides = figure.subplots(1, 2, sharey=True, width_ratios=(2, 1))
    for side, axes in enumerate(sides):

        def draw(points: Floats, axes: Axes = axes, side: int = side, **style: Any) -> None:
            seen = 1e3 * views_of(points, azimuth)
            axes.plot(seen[:, side], seen[:, 2], **style)

        for i, (name, (line, markers)) in enumerate(models.items()):
            for pair in np.stack([measured, markers], axis=1):
                draw(pair, color=ERROR, linewidth=1.0)
            draw(np.vstack([np.zeros((1, 3)), line]), color=look(i).colour, label=name)
        draw(measured, color=MEASURED, marker='o', linestyle='', label='measured')
        axes.set_aspect('equal', adjustable='datalim')
    towards = f'plane of bending, {np.degrees(azimuth):.0f}° from x [mm]'
    sides[0].set(xlabel=towards, ylabel='z [mm]')
    sides[1].set(xlabel='across it [mm]')
    sides[0].legend()
    return figure
