"""A data set to a folder of plain files: whole, or not at all."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from ..exceptions import DataSetError
from ..robot import dump_robot
from .atomic import new_folder
from .dataset import DataSet
from .description import dump_description
from .shapes import KEYS, ORIENTATION, POSITION

FILES = ('dataset.yaml', 'inputs.csv', 'robot.yaml', 'shapes.csv')


def save_dataset(dataset: DataSet, folder: str | Path, overwrite: bool = False) -> Path:
    """
    Write a data set with its robot description; `load_dataset` reads the same values back.

    Parameters
    ----------
    dataset : DataSet
        Markers that no trial saw are left out.
    folder : str or Path
        A new or empty folder.
    overwrite : bool
        Replace a data set; a folder with any other file in it is never replaced.

    Raises
    ------
    DataSetError
        The folder is not empty or cannot be written, or there is no measurement to write.

    """
    unmeasured = dataset.trials == 0
    if unmeasured.all() or (unmeasured.any() and dataset.path == 'from_straight'):
        posture = dataset.postures[int(unmeasured.argmax())]
        raise DataSetError(
            f'{dataset.name}: posture {posture!r}',
            'has no measurement to write',
            'select the measured postures',
        )
    if not overwrite and (Path(folder) / 'dataset.yaml').is_file():
        raise DataSetError(
            str(folder), 'holds a data set already', 'name a new folder or allow --overwrite'
        )
    dataset = _without_unseen(dataset)
    with new_folder(Path(folder), FILES if overwrite else ()) as new:
        (new / 'dataset.yaml').write_text(dump_description(dataset), encoding='utf-8')
        (new / 'robot.yaml').write_text(dump_robot(dataset.robot), encoding='utf-8')
        _write(new / 'inputs.csv', _input_rows(dataset))
        _write(new / 'shapes.csv', _shape_rows(dataset))
    return Path(folder)


def _without_unseen(dataset: DataSet) -> DataSet:
    seen = dataset.mask.any(axis=(0, 1))
    if seen.all():
        return dataset
    turned = dataset.orientations
    return replace(
        dataset,
        markers=tuple(m for m, one in zip(dataset.markers, seen, strict=True) if one),
        positions=dataset.positions[:, :, seen],
        orientations=None if turned is None else turned[:, :, seen],
    )


def _write(path: Path, rows: Iterable[Iterable[object]]) -> None:
    with path.open('w', encoding='utf-8', newline='') as file:
        csv.writer(file, lineterminator='\n').writerows(rows)


def _cells(values: Iterable[float]) -> list[object]:
    """Show floats so that reading gives the same ones; NaN as an empty cell."""
    return ['' if math.isnan(value) else value for value in values]


def _input_rows(dataset: DataSet) -> Iterator[Iterable[object]]:
    if dataset.trial_inputs is None:
        yield ('posture', *dataset.input_names)
        for posture, values in zip(dataset.postures, dataset.inputs.tolist(), strict=True):
            yield (posture, *_cells(values))
        return
    yield ('posture', 'trial', *dataset.input_names)
    for p, posture in enumerate(dataset.postures):
        measured = dataset.trial_mask[p] if dataset.path == 'from_straight' else ...
        for q in range(len(dataset.trial_names)):
            if measured is ... or measured[q]:
                yield (
                    posture,
                    dataset.trial_names[q],
                    *_cells(dataset.trial_inputs[p, q].tolist()),
                )


def _shape_rows(dataset: DataSet) -> Iterator[Iterable[object]]:
    turned = dataset.orientations
    yield (*KEYS, *POSITION, *(ORIENTATION if turned is not None else ()))
    for p, posture in enumerate(dataset.postures):
        positions = dataset.positions[p].tolist()
        quaternions = [] if turned is None else turned[p].tolist()
        for q, trial in enumerate(dataset.trial_names):
            for j, marker in enumerate(dataset.markers):
                if dataset.mask[p, q, j]:
                    rest = quaternions[q][j] if quaternions else ()
                    yield (posture, trial, marker.name, *positions[q][j], *_cells(rest))
