"""One loader for every way in which measurements are named: folder, recording, object, several."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..common.errors import DataSetError
from ..common.given import place, refusal
from ..robot import RobotLike, load_robot
from .dataset import EXPECTED, DataSet, HasDataSet, as_dataset
from .folder.folder import read_folder
from .joining import join as join_read
from .recording.importing import import_bag
from .recording.reader import is_bag

DataSetLike = DataSet | HasDataSet | str | Path | Sequence['DataSet | HasDataSet | str | Path']


def load_dataset(data: DataSetLike, robot: RobotLike | None = None) -> DataSet:
    """
    Read and check measurements; nothing in their files is ever executed.

    Parameters
    ----------
    data : path, DataSet, or a list of these
        A folder with dataset.yaml, inputs.csv and shapes.csv; a recording (rosbag2 folder, .mcap
        or .db3), of which every still segment is a measurement; a data set or an import as it
        is. Several of one robot are joined.
    robot : Robot, name, path, text or dict, optional
        The robot to use instead of the one that the measurements name.

    Raises
    ------
    DataSetError, InputError
        With file, row, what is wrong and what to do.
    RobotDescriptionError
        The robot description is not valid.

    """
    other = None if robot is None else load_robot(robot)
    if isinstance(data, str | os.PathLike):
        path = place('data', data)
        return import_bag(path, other).dataset if is_bag(path) else read_folder(path, other)
    if isinstance(data, list | tuple) and data:
        return join_read([load_dataset(one, other) for one in data])
    dataset = as_dataset(data)
    if other is None:
        return dataset
    if other.inputs != dataset.robot.inputs:
        raise DataSetError(
            dataset.name,
            f'has the inputs {", ".join(dataset.robot.inputs)}, not {", ".join(other.inputs)} '
            f'of {other.name}',
            'name the robot that was measured',
        )
    return replace(dataset, robot=other)


def join(datasets: Sequence[DataSetLike]) -> DataSet:
    """
    Return the postures of several data sets as one data set.

    Each posture keeps the gravity and the `known` effects of its data set; of declared noises the
    largest holds. Postures are named `data set/posture`.

    Parameters
    ----------
    datasets : list of DataSet or path
        As `load_dataset` takes each.

    Raises
    ------
    DataSetError
        They differ in robot, markers, inputs, or in how the arm was loaded.

    """
    if not isinstance(datasets, list | tuple) or not datasets:
        raise refusal('data', f'a list, each {EXPECTED}', datasets)
    return join_read([load_dataset(one) for one in datasets])
