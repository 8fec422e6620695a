"""Pictures of arms for notebooks, with matplotlib; the pages have figures of their own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = npt.NDArray[np.float64]
FLATNESS = 0.01  # of the arm's extent: farther from the x-z plane an arm is drawn in space


def plot_arms(positions: Floats, axes: Axes | None = None, **style: Any) -> Axes:
    """
    Draw arms (b, n, 3) [m] from the base to the tip.

    Parameters
    ----------
    positions : (b, n, 3) [m]
        Distal ends of the cells.
    axes : matplotlib Axes, optional
        Default: new ones, flat where no arm leaves the x-z plane.
    **style
        Of the lines, as for `Axes.plot`.

    """
    arms = 1e3 * np.concatenate([np.zeros((len(positions), 1, 3)), positions], axis=1)
    axes = _new_axes(arms) if axes is None else axes
    in_space = hasattr(axes, 'get_zlim')
    for arm in arms:
        axes.plot(*(arm.T if in_space else arm.T[[0, 2]]), **{'marker': '.', **style})
    if in_space:
        axes.set(xlabel='x [mm]', ylabel='y [mm]', zlabel='z [mm]')
    else:
        axes.set(xlabel='x [mm]', ylabel='z [mm]')
    axes.set_aspect('equal')
    return axes


def _new_axes(arms: Floats) -> Axes:
    from matplotlib import pyplot as plt

    in_space = np.abs(arms[..., 1]).max() > FLATNESS * np.ptp(arms, axis=(0, 1)).max()
    figure = plt.figure(layout='constrained')
    made: Axes = figure.add_subplot(projection='3d' if in_space else None)
    return made
