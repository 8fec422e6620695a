"""Measurements however they are named: a folder, a recording, an object, or several of these."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..common.errors import DataSetError, place, refusal
from ..robot import RobotLike, load_robot
from .dataset import EXPECTED, DataSet, FloatArray, HasDataSet, IntArray, Part, as_dataset
from .folder import read_folder
from .recording.importing import import_bag
from .recording.reader import is_bag
from .visits import joined

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
        return _joined([load_dataset(one, other) for one in data])
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
    return _joined([load_dataset(one) for one in datasets])


ALIKE = ('markers', 'input', 'path', 'input_names')  # what data sets must have in common
NOISES = ('position_noise', 'setting_noise', 'trial_noise', 'accuracy')


def _joined(datasets: Sequence[DataSet]) -> DataSet:
    """
    Return the postures of several data sets as one data set.

    Each posture keeps the gravity and the `known` effects of its data set; of declared noises the
    largest holds. Postures are named `data set/posture`.

    Raises
    ------
    DataSetError
        They differ in robot, markers, inputs, or in how the arm was loaded.

    """
    first = datasets[0]
    if len(datasets) == 1:
        return first
    for other in datasets[1:]:
        for key in ALIKE:
            if getattr(first, key) != getattr(other, key):
                remedy = f'data sets that are used together have the same {", ".join(ALIKE)}'
                raise DataSetError(other.name, f'has other {key} than {first.name}', remedy)
        ours, theirs = (replace(d.robot, source='', fitted={}) for d in (first, other))
        if ours != theirs:
            problem = f'has another robot description than {first.name}'
            raise DataSetError(other.name, problem, 'name the one that holds for all with --robot')
    names = [dataset.name.rstrip('/').rpartition('/')[2] for dataset in datasets]
    if len(set(names)) < len(names):  # the last parts of two folders are the same
        names = [dataset.name for dataset in datasets]
    parts: list[Part] = []
    part: list[IntArray] = []  # index of the part of every posture
    for name, dataset in zip(names, datasets, strict=True):
        part.append(np.zeros(len(dataset.postures), dtype=np.int64))
        for one, rows in dataset.divided:
            part[-1][rows] = len(parts)
            parts.append(one if dataset.parts else replace(one, name=name))
    trials = max((d.trial_names for d in datasets), key=len)
    visits = [dataset.visits for dataset in datasets if dataset.visits is not None]
    noises: dict[str, Any] = {}
    for key in NOISES:
        given = [getattr(dataset, key) for dataset in datasets]
        noises[key] = max((value for value in given if value is not None), default=None)

    turned = [d.orientations for d in datasets if d.orientations is not None]
    by_trial = any(dataset.trial_inputs is not None for dataset in datasets)
    return replace(
        first,
        name=' '.join(dataset.name for dataset in datasets),
        postures=tuple(
            f'{name}/{posture}'
            for name, dataset in zip(names, datasets, strict=True)
            for posture in dataset.postures
        ),
        inputs=np.concatenate([d.inputs for d in datasets]),
        positions=_stacked([d.positions for d in datasets], len(trials)),
        orientations=_stacked(turned, len(trials)) if len(turned) == len(datasets) else None,
        trial_inputs=_stacked([d.inputs_by_trial for d in datasets], len(trials))
        if by_trial
        else None,
        trial_names=trials,
        gravity=next((d.gravity for d in datasets if d.gravity is not None), None),
        known={},
        parts=tuple(parts),
        part=np.concatenate(part),
        visits=joined(visits) if visits else None,
        **noises,
    )


def _stacked(arrays: Sequence[FloatArray], trials: int) -> FloatArray:
    """Join arrays (P, Q, ...) of postures, each padded with NaN to the same number of trials."""
    padded = []
    for array in arrays:
        lacking = np.zeros((array.ndim, 2), dtype=int)
        lacking[1, 1] = trials - array.shape[1]
        padded.append(np.pad(array, lacking, constant_values=np.nan))
    return np.concatenate(padded)
