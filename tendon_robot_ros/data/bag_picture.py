"""A picture of what an import took from a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .atomic import new_file
from .bag_import import Imported

PICTURES = ('.png', '.svg', '.pdf')
MOST_NAMES = 80  # more do not fit beside each other
WIDEST = 40.0  # [inches]


def draw_segments(imported: Imported, path: str | Path) -> Path:
    """
    Draw speed and inputs over time with the segments that became measurements.

    Parameters
    ----------
    imported : Imported
        What `import_bag` returned.
    path : str or Path
        Where the picture goes; the ending says the format, one of `PICTURES`.

    Raises
    ------
    DataSetError
        Nothing can be written there.

    """
    from matplotlib.figure import Figure

    width = min(max(8.0, 0.22 * len(imported.segments)), WIDEST)
    figure = Figure(figsize=(width, 5.5), layout='constrained')
    above, below = figure.subplots(2, 1, sharex=True)
    _draw_speed(above, imported)
    _draw_inputs(below, imported)
    for axes in (above, below):
        for one in imported.segments:
            axes.axvspan(one.begin, one.end, color='tab:green', alpha=0.25, linewidth=0)
        axes.spines[['top', 'right']].set_visible(False)
    figure.legend(loc='outside lower right', ncols=6, fontsize='small')
    figure.suptitle(summary(imported), x=0.01, ha='left', fontsize='large')
    with new_file(Path(path)) as draft:
        figure.savefig(draft, dpi=110)
    return Path(path)


def summary(imported: Imported) -> str:
    """Say in one line what was found."""
    trials = imported.dataset.trials
    each = f'{trials.min()}' if trials.min() == trials.max() else f'{trials.min()}..{trials.max()}'
    return (
        f'{len(imported.segments)} still segments: {len(trials)} postures x {each} trials x '
        f'{len(imported.dataset.markers)} markers'
    )


def _draw_speed(axes: Any, imported: Imported) -> None:
    moved, limit = imported.motion, 1e3 * imported.rule.speed
    speed = np.where(np.isfinite(moved.speed), 1e3 * moved.speed, np.nan)
    lowest = limit / 100
    axes.semilogy(moved.times, np.maximum(speed, lowest), color='tab:blue', linewidth=0.8)
    axes.axhline(limit, color='tab:red', linestyle='--', linewidth=0.8)
    axes.annotate(
        f'{limit:g} mm/s for {imported.rule.duration:g} s counts as still',
        (0.005, limit),
        xycoords=('axes fraction', 'data'),
        xytext=(0, 3),
        textcoords='offset points',
        color='tab:red',
        fontsize='small',
        bbox={'color': 'white', 'alpha': 0.7, 'pad': 1},
    )
    axes.set_ylabel('speed [mm/s]')
    if len(imported.segments) > MOST_NAMES:
        return
    single = len(imported.dataset.trial_names) == 1
    for one in imported.segments:
        axes.annotate(
            one.posture if single else f'{one.posture}, {one.trial}',
            ((one.begin + one.end) / 2, 1.0),
            xycoords=('data', 'axes fraction'),
            xytext=(0, 2),
            textcoords='offset points',
            rotation=90,
            ha='center',
            va='bottom',
            fontsize='x-small',
        )


def _draw_inputs(axes: Any, imported: Imported) -> None:
    data = imported.dataset
    tension = data.input == 'tension'
    for name, values in zip(data.input_names, imported.inputs.T, strict=True):
        axes.plot(
            imported.state_times, values * (1 if tension else 1e3), linewidth=0.9, label=name
        )
    axes.set_ylabel('tension [N]' if tension else 'wire pull [mm]')
    axes.set_xlabel('time [s]')
