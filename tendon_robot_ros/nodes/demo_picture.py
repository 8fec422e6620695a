"""The picture of the demo."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..control.postures import Posture
from ..model.model import Model
from .demo_sender import Outcome

COLORS = ('#0072b2', '#e69f00', '#009e73', '#cc79a7', '#999999')  # Okabe and Ito


def draw(
    path: Path, model: Model, postures: Sequence[Posture], outcomes: Sequence[Outcome]
) -> None:
    """Draw the arm in every posture, and its targets, in the x-z plane [mm]."""
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(7.0, 6.0), layout='constrained')
    straight = np.cumsum(np.full(model.robot.cells, 1e3 * model.robot.length / model.robot.cells))
    axes.plot(
        np.zeros(len(straight) + 1), [0.0, *straight], ':', color='#555555', label='straight'
    )
    for posture, outcome, color in zip(postures, outcomes, COLORS, strict=True):
        arm = 1e3 * np.vstack([np.zeros(3), model.shape(outcome.tensions).positions])
        label = f'{posture.name}: {1e3 * outcome.miss:.2f} mm'
        axes.plot(arm[:, 0], arm[:, 2], 'o-', color=color, markersize=3, label=label)
        axes.plot(*(1e3 * posture.position[[0, 2]]), 'x', color=color, markersize=10)
        (x, _, z), (u, _, w) = 1e3 * outcome.position, 12.0 * posture.direction
        arrow = {'arrowstyle': '->', 'color': color}
        axes.annotate('', (x + u, z + w), (x, z), arrowprops=arrow)
    axes.set(
        xlabel='x [mm]',
        ylabel='z [mm]',
        aspect='equal',
        title=f'{model.robot.name}: targets (x) and where the mock arm went',
    )
    axes.legend(fontsize='small')
    axes.grid(alpha=0.3)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
    plt.close(figure)
