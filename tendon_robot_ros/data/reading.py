"""A folder of plain files to a data set; nothing is taken that does not fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..exceptions import DataSetError
from ..robot import Robot, load_robot
from .dataset import DataSet, default_markers
from .description import describe, find_robot, read_fields, read_text
from .inputs import read_inputs
from .shapes import read_shapes


def load_dataset(folder: str | Path, robot: Robot | str | Path | None = None) -> DataSet:
    """
    Read and check a data set; nothing in its files is ever executed.

    Parameters
    ----------
    folder : str or Path
        Holds dataset.yaml, inputs.csv and shapes.csv.
    robot : Robot or path, optional
        The robot to use instead of the one that dataset.yaml names.

    Raises
    ------
    DataSetError
        With file, row, what is wrong and what to do.
    RobotDescriptionError
        The robot description is not valid.

    """
    folder = Path(folder)
    path = folder / 'dataset.yaml'
    fields = read_fields(read_text(path), str(path))
    if robot is None:
        robot = find_robot(fields, folder)
    elif not isinstance(robot, Robot):
        robot = load_robot(robot)
    said = describe(fields, robot)
    markers = said.markers or default_markers(robot)
    names = tuple(marker.name for marker in markers)
    commands = read_inputs(folder / 'inputs.csv', robot, said.input)
    shapes = read_shapes(folder / 'shapes.csv', robot, names, commands, said.path == 'sequence')
    seen = np.isfinite(shapes.positions[..., 0]).any(axis=(0, 1))
    if said.markers and not seen.all():
        raise DataSetError(
            f'{path}: markers',
            f'{names[int(seen.argmin())]!r} was never seen in shapes.csv',
            'correct the name or remove the marker',
        )
    turned = shapes.orientations
    return DataSet(
        name=str(folder),
        robot=robot,
        robot_path=Path(robot.source),
        markers=tuple(marker for marker, one in zip(markers, seen, strict=True) if one),
        postures=commands.postures,
        inputs=commands.by_posture(),
        trial_names=shapes.trials,
        trial_inputs=commands.by_trial(shapes.trials),
        positions=shapes.positions[:, :, seen],
        orientations=None if turned is None else turned[:, :, seen],
        input=said.input,
        path=said.path,
        gravity=said.gravity,
        accuracy=said.accuracy,
        position_noise=said.position_noise,
        setting_noise=said.setting_noise,
        trial_noise=said.trial_noise,
    )
