"""A workspace as files: a CSV table of the kept postures, and all their cells as npz."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from .workspace import Workspace

FILES = ('postures.csv', 'workspace.npz')


def save_workspace(workspace: Workspace, folder: Path) -> None:
    """
    Write `postures.csv` and `workspace.npz` into a folder.

    The arrays of the npz have one row per kept posture: `tensions` [N], `bend` [rad],
    `positions` [m], `angle` [rad], `view` [rad], `side`, `pair` (index into `pairs`).
    """
    inputs = workspace.robot.inputs
    with (folder / FILES[0]).open('w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        writer.writerow(['view', 'pair', *inputs, 'angle', 'x', 'y', 'z'])
        for family in workspace.families:
            for tensions, angle, tip in zip(
                family.tensions.tolist(), family.angle, family.tips, strict=True
            ):
                numbers = [f'{value:.6g}' for value in (*tensions, angle, *tip)]
                writer.writerow([f'{family.view:.6g}', ' + '.join(family.pair.inputs), *numbers])
    np.savez_compressed(folder / FILES[1], **_arrays(workspace))  # type: ignore[arg-type]


def _arrays(workspace: Workspace) -> dict[str, object]:
    families = workspace.families
    n, m = workspace.robot.cells, len(workspace.robot.inputs)

    def joined(name: str, empty: tuple[int, ...]) -> object:
        parts = [getattr(family, name) for family in families]
        return np.concatenate(parts) if parts else np.zeros(empty)

    def repeated(values: list[float]) -> object:
        return np.repeat(values, [len(family) for family in families])

    pairs = [pair.inputs for pair in workspace.pairs]
    return {
        'inputs': np.array(workspace.robot.inputs),
        'pairs': np.array([' + '.join(names) for names in pairs]),
        'tensions': joined('tensions', (0, m)),
        'bend': joined('bend', (0, n, 2)),
        'positions': joined('positions', (0, n, 3)),
        'angle': joined('angle', (0,)),
        'view': repeated([family.view for family in families]),
        'side': repeated([family.side for family in families]),
        'pair': repeated([pairs.index(family.pair.inputs) for family in families]),
    }
