"""Several data sets of one robot as one; postures apart by where the arm came from."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..common.errors import DataSetError
from .dataset import BoolArray, DataSet, FloatArray, IntArray, Part
from .visits import Split, joined

ALIKE = ('markers', 'input', 'path', 'input_names')  # what data sets must have in common
NOISES = ('position_noise', 'setting_noise', 'trial_noise', 'accuracy')


def join(datasets: Sequence[DataSet]) -> DataSet:
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
        _refuse_unlike(first, other)
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

    def together(arrays: Iterable[FloatArray | None]) -> FloatArray | None:
        """Join what all data sets have, each trial in its column; None where one lacks it."""
        joined_up = []
        for array in arrays:
            if array is None:
                return None
            lacking = np.zeros((array.ndim, 2), dtype=int)
            lacking[1, 1] = len(trials) - array.shape[1]
            joined_up.append(np.pad(array, lacking, constant_values=np.nan))
        return np.concatenate(joined_up)

    positions = together(d.positions for d in datasets)
    assert positions is not None
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
        positions=positions,
        orientations=together(d.orientations for d in datasets),
        trial_inputs=together(d.inputs_by_trial for d in datasets) if by_trial else None,
        trial_names=trials,
        gravity=next((d.gravity for d in datasets if d.gravity is not None), None),
        known={},
        parts=tuple(parts),
        part=np.concatenate(part),
        visits=joined(visits) if visits else None,
        **noises,
    )


def _refuse_unlike(first: DataSet, other: DataSet) -> None:
    for key in ALIKE:
        if getattr(first, key) != getattr(other, key):
            raise DataSetError(
                other.name,
                f'has other {key} than {first.name}',
                f'data sets that are used together have the same {", ".join(ALIKE)}',
            )
    ours, theirs = (replace(d.robot, source='', fitted={}) for d in (first, other))
    if ours != theirs:
        raise DataSetError(
            other.name,
            f'has another robot description than {first.name}',
            'name the one that holds for all with --robot',
        )


def divide(dataset: DataSet, split: Split, own: BoolArray) -> DataSet:
    """Return the postures apart by where the arm came from; `own` (P, Q) are their trials."""
    inputs = dataset.inputs[split.command]

    def part(array: FloatArray | None, other: FloatArray | float = np.nan) -> FloatArray | None:
        if array is None:
            return None
        wide = own.reshape(*own.shape, *(1,) * (array.ndim - 2))
        return np.where(wide, array[split.command], other)

    positions = part(dataset.positions)
    assert positions is not None
    return replace(
        dataset,
        postures=split.postures,
        inputs=inputs,
        positions=positions,
        orientations=part(dataset.orientations),
        trial_inputs=part(dataset.trial_inputs, inputs[:, None]),
        path='visits',
        visits=split.visits,
    )
