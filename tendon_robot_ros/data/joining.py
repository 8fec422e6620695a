"""Several data sets of one robot as one; postures apart by where the arm came from."""

from __future__ import annotations

from collections.abc import Sequence
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
    names = _short_names(datasets)
    trials = max((d.trial_names for d in datasets), key=len)
    parts, part = _divided(names, datasets)
    visits = [dataset.visits for dataset in datasets if dataset.visits is not None]
    noises: dict[str, Any] = {key: _largest([getattr(d, key) for d in datasets]) for key in NOISES}
    return replace(
        first,
        name=' '.join(dataset.name for dataset in datasets),
        postures=tuple(
            f'{name}/{posture}'
            for name, dataset in zip(names, datasets, strict=True)
            for posture in dataset.postures
        ),
        inputs=np.concatenate([d.inputs for d in datasets]),
        positions=np.concatenate([_padded(d.positions, len(trials)) for d in datasets]),
        orientations=_together([d.orientations for d in datasets], len(trials)),
        trial_inputs=_trial_inputs(datasets, len(trials)),
        trial_names=trials,
        gravity=next((d.gravity for d in datasets if d.gravity is not None), None),
        known={},
        parts=parts,
        part=part,
        visits=joined(visits) if visits else None,
        **noises,
    )


def _divided(
    names: Sequence[str], datasets: Sequence[DataSet]
) -> tuple[tuple[Part, ...], IntArray]:
    """Return all parts, and the index of the part of every posture."""
    parts: list[Part] = []
    owners = []
    for name, dataset in zip(names, datasets, strict=True):
        owner = np.zeros(len(dataset.postures), dtype=np.int64)
        for one, rows in dataset.divided:
            owner[rows] = len(parts)
            parts.append(one if dataset.parts else replace(one, name=name))
        owners.append(owner)
    return tuple(parts), np.concatenate(owners)


def _refuse_unlike(first: DataSet, other: DataSet) -> None:
    for key in ALIKE:
        if getattr(first, key) != getattr(other, key):
            raise DataSetError(
                other.name,
                f'has other {key} than {first.name}',
                f'data sets that are used together have the same {", ".join(ALIKE)}',
            )
    if replace(first.robot, source='', fitted={}) != replace(other.robot, source='', fitted={}):
        raise DataSetError(
            other.name,
            f'has another robot description than {first.name}',
            'name the one that holds for all with --robot',
        )


def _short_names(datasets: Sequence[DataSet]) -> list[str]:
    """Return the last part of each folder, numbered where two are the same."""
    names = [dataset.name.rstrip('/').rpartition('/')[2] for dataset in datasets]
    return names if len(set(names)) == len(names) else [d.name for d in datasets]


def _padded(array: FloatArray, trials: int) -> FloatArray:
    lacking = [(0, trials - array.shape[1] if axis == 1 else 0) for axis in range(array.ndim)]
    return np.pad(array, lacking, constant_values=np.nan)


def _together(arrays: Sequence[FloatArray | None], trials: int) -> FloatArray | None:
    """Join what all data sets have; None where one lacks it."""
    present = [array for array in arrays if array is not None]
    if len(present) < len(arrays):
        return None
    return np.concatenate([_padded(array, trials) for array in present])


def _trial_inputs(datasets: Sequence[DataSet], trials: int) -> FloatArray | None:
    if all(dataset.trial_inputs is None for dataset in datasets):
        return None
    return np.concatenate([_padded(dataset.inputs_by_trial, trials) for dataset in datasets])


def _largest(values: Sequence[float | None]) -> float | None:
    return max((value for value in values if value is not None), default=None)


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
