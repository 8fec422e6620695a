"""A data set as a folder of plain files, read strictly and written whole (docs/data_sets.md)."""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..common import files
from ..common.errors import DataSetError, TendonRobotError, place, short
from ..common.files import TABLE_ENDINGS, new_folder, refuse_other_files
from ..common.words import STANDARD_GRAVITY, typed
from ..common.yaml_reading import Reader, dump_yaml, parse_yaml
from ..robot import Robot, dump_robot, load_robot
from .arrays import PLAUSIBLE_FACTOR, POSITION, QUATERNION, Marker, default_markers
from .dataset import INPUTS, LIMITS, PATHS, DataSet, HasDataSet, as_dataset
from .measurement_files import KEYS, ORIGIN, VISIT, Commands, read_shapes

DESCRIPTION_KEYS = (
    *('robot', 'input', 'path', 'gravity', 'position_noise', 'tension_noise', 'accuracy'),
    *('known', 'markers'),
)


class DatasetFields(Reader):
    """Checked reading of dataset.yaml."""

    @classmethod
    def parse(cls, text: str, source: str) -> Self:
        """Read YAML text; DataSetError where it is none."""

        def refuse(reason: str) -> DataSetError:
            return DataSetError(source, f'is no valid YAML ({reason})', 'correct that line')

        return cls(source, '', parse_yaml(text, refuse))

    def error(self, key: str, expected: str, got: object) -> DataSetError:
        """Build the error for a key."""
        return DataSetError(
            f'{self.source}: {self._where(key)}', f'got {short(got)}', f'expected {expected}'
        )

    def label(self, key: str) -> str:
        """Return a name; a whole number will do, because markers are often counted."""
        value = self.content.get(key)
        if isinstance(value, int) and not isinstance(value, bool):
            return str(value)
        return self.name(key).strip()

    def distance(self, key: str, high: float) -> float | None:
        """Return a positive distance [m], None when absent."""
        return self.number(key, 1e-9, high, 'm') if self.has(key) else None


NO_FOLDER = (
    'name a folder with dataset.yaml, inputs.csv and shapes.csv; of a table '
    '`import table` makes one'
)


def read_text(path: Path, remedy: str = NO_FOLDER) -> str:
    """
    Read a dataset.yaml.

    Raises
    ------
    DataSetError
        There is none, or it is no UTF-8 text.

    """
    return files.read_text(
        path, lambda reason: DataSetError(str(path), f'cannot be read ({reason})', remedy)
    )


def read_fields(text: str, source: str) -> DatasetFields:
    """Read the text of a dataset.yaml; DataSetError where it is no YAML, or has unknown keys."""
    fields = DatasetFields.parse(text, source)
    fields.only(*DESCRIPTION_KEYS)
    return fields


def find_robot(fields: DatasetFields, folder: Path) -> Robot:
    """
    Load the robot description that a data set names, relative to its folder.

    Raises
    ------
    DataSetError
        There is no such file.
    RobotDescriptionError
        The file is not valid.

    """
    path = folder / fields.label('robot') if fields.has('robot') else folder / 'robot.yaml'
    if not os.path.isfile(path):  # Path.is_file raises where a name is too long
        name = str(path)
        problem = f'no file {name if len(name) < 256 else name[:256] + "..."}'
        remedy = 'put the robot description there or correct the path'
        raise DataSetError(f'{fields.source}: robot', problem, remedy)
    return load_robot(path)


def describe(fields: DatasetFields, robot: Robot) -> dict[str, Any]:
    """
    Return the values of a dataset.yaml, checked against the robot, by their names in a `DataSet`.

    Markers that are not listed are None: one per cell.

    Raises
    ------
    DataSetError
        A value is missing, of the wrong kind, or cannot be in the unit it should be in.

    """
    noise = fields.child('tension_noise')
    noise.only('setting', 'trial')
    known: dict[str, dict[str, float]] = {}  # checked later, against the catalogue
    for name in fields.child('known').content:
        effect = fields.child('known').child(str(name))
        if not effect.content:
            expected = 'parameters such as tip_load: {force_z: 0.98}'
            raise fields.error('known', expected, effect.content)
        known[str(name)] = {str(key): effect.number(str(key)) for key in effect.content}
    gravity = None
    if fields.has('gravity'):
        gravity = x, y, z = fields.vector('gravity', 3)
        if math.hypot(x, y, z) > PLAUSIBLE_FACTOR * STANDARD_GRAVITY:
            expected = 'an acceleration in m/s², such as [0, 0, 9.81]'
            raise fields.error('gravity', expected, list(gravity))
    return {
        'input': fields.choice('input', INPUTS, default='tension'),
        'path': fields.choice('path', PATHS, default='from_straight'),
        'gravity': gravity,
        'position_noise': fields.distance('position_noise', robot.length / 10),
        'setting_noise': noise.number('setting', 0.0, *LIMITS['setting_noise'], 0.0),
        'trial_noise': noise.number('trial', 0.0, *LIMITS['trial_noise'], 0.0),
        'accuracy': fields.distance('accuracy', robot.length),
        'known': known,
        'markers': _markers(fields, robot) if fields.has('markers') else None,
    }


def read_markers(rows: list[Any], robot: Robot) -> tuple[Marker, ...]:
    """Return the markers of a list as `markers` of dataset.yaml; none for an empty one."""
    return _markers(DatasetFields('parameter', '', {'markers': rows}), robot) if rows else ()


def _markers(fields: DatasetFields, robot: Robot) -> tuple[Marker, ...]:
    markers = []
    for item in fields.items('markers'):
        item.only('name', 'arc_length', 'offset')
        arc_length = item.number('arc_length', 0.0, robot.length + 1e-9, 'm')
        offset = item.vector('offset', 3) if item.has('offset') else (0.0, 0.0, 0.0)
        if max(map(abs, offset)) > PLAUSIBLE_FACTOR * robot.length:
            expected = 'at most three robot lengths [m] (is it in mm?)'
            raise item.error('offset', expected, list(offset))
        markers.append(Marker(item.label('name'), arc_length, offset))
    fields.unique('markers', [marker.name for marker in markers])
    return tuple(markers)


def dump_description(dataset: DataSet) -> str:
    """Write a dataset.yaml beside a robot.yaml; reading it gives the same values."""
    noise = {'setting': dataset.setting_noise, 'trial': dataset.trial_noise}
    content: dict[str, Any] = {
        'robot': 'robot.yaml',
        'input': dataset.input,
        'path': dataset.path,
        'gravity': None if dataset.gravity is None else list(dataset.gravity),
        'position_noise': dataset.position_noise,
        'tension_noise': noise if any(noise.values()) else None,
        'accuracy': dataset.accuracy,
        'known': {name: dict(values) for name, values in dataset.known.items()} or None,
    }
    if dataset.markers != default_markers(dataset.robot):
        content['markers'] = [
            {'name': marker.name, 'arc_length': marker.arc_length}
            | ({'offset': list(marker.offset)} if any(marker.offset) else {})
            for marker in dataset.markers
        ]
    return dump_yaml({key: value for key, value in content.items() if value is not None})


def read_folder(folder: Path, robot: Robot | None = None) -> DataSet:
    """
    Read and check a data set; nothing in its files is ever executed.

    Parameters
    ----------
    folder : Path
        Holds dataset.yaml, inputs.csv and shapes.csv.
    robot : Robot, optional
        The robot to use instead of the one that dataset.yaml names.

    Raises
    ------
    DataSetError
        With file, row, what is wrong and what to do.
    RobotDescriptionError
        The robot description is not valid.

    """
    refuse_table(folder)
    path = folder / 'dataset.yaml'
    fields = read_fields(read_text(path), str(path))
    robot = robot or find_robot(fields, folder)
    described = describe(fields, robot)
    markers = described['markers'] or default_markers(robot)
    names = tuple(marker.name for marker in markers)
    visits = described['path'] == 'visits'
    try:
        commands = Commands(folder / 'inputs.csv', robot, described['input'], visits)
    except DataSetError:
        try:
            own = find_robot(fields, folder)
        except TendonRobotError:
            own = robot
        if own.inputs != robot.inputs:
            measured = f'was measured with the inputs {", ".join(own.inputs)} of {own.name}'
            problem = f'{measured}, but {robot.source} has {", ".join(robot.inputs)}'
            remedy = 'name a description of the robot that was measured'
            raise DataSetError(str(folder), problem, remedy) from None
        raise
    between = described['path'] != 'from_straight'
    shapes = read_shapes(folder / 'shapes.csv', robot, names, commands, between)
    visible = np.isfinite(shapes['positions'][..., 0]).any(axis=(0, 1))
    if described['markers'] and not visible.all():
        problem = f'{names[int(visible.argmin())]!r} was never seen in shapes.csv'
        raise DataSetError(f'{path}: markers', problem, 'correct the name or remove the marker')
    inputs, trial_inputs = commands.by_posture(shapes['trial_names'])
    dataset = DataSet(
        name=str(folder),
        robot=robot,
        postures=commands.postures,
        inputs=inputs,
        trial_inputs=trial_inputs,
        **shapes,
        **described | {'markers': markers} | ({'path': 'sequence'} if visits else {}),
    ).without_unseen_markers()
    if not visits:
        return dataset
    return dataset.by_origin(*commands.by_history(dataset.trial_names, dataset.trial_mask))


def refuse_table(path: Path) -> None:
    """Raise DataSetError if the folder does not exist or is a file."""
    if not os.path.exists(path):
        raise DataSetError(str(path), 'is not there', 'name the folder of a data set')
    if path.suffix.lower() in TABLE_ENDINGS and os.path.isfile(path):
        command = typed('import', 'table', path, '--robot', 'ARM.yaml', '--output', 'run')
        raise DataSetError(str(path), 'is a table, and no data set', f'make one of it: {command}')
    if os.path.isfile(path):
        remedy = 'name the folder that holds dataset.yaml; robots go behind --model or --robot'
        raise DataSetError(str(path), 'is a file, and no data set', remedy)


def described_robot(folder: str | Path) -> Robot:
    """
    Return the robot that a data set names itself.

    Raises
    ------
    DataSetError, RobotDescriptionError
        As `load_dataset`.

    """
    path = Path(folder) / 'dataset.yaml'
    return find_robot(read_fields(read_text(path), str(path)), Path(folder))


FILES = ('dataset.yaml', 'inputs.csv', 'robot.yaml', 'shapes.csv')
BESIDE = ('import.png', 'import.yaml')  # how it came out of tables


def refuse_dataset_in(folder: str | Path, overwrite: bool) -> None:
    """Raise DataSetError, before any work, where a data set cannot go into a folder."""
    if not overwrite and (Path(folder) / 'dataset.yaml').is_file():
        remedy = 'name a new folder or allow --overwrite'
        raise DataSetError(str(folder), 'holds a data set already', remedy)
    refuse_other_files(Path(folder), (*FILES, *BESIDE) if overwrite else ())


def save_dataset(
    dataset: DataSet | HasDataSet,
    folder: str | Path,
    overwrite: bool = False,
    beside: Mapping[str, bytes] | None = None,
) -> Path:
    """
    Write a data set with its robot description; `load_dataset` reads the same values back.

    Parameters
    ----------
    dataset : DataSet or ImportedTable
        Markers that no trial saw are left out.
    folder : str or Path
        A new or empty folder.
    overwrite : bool
        Replace a data set; a folder with any other file in it is never replaced.
    beside : mapping, optional
        Further files, by their names in `BESIDE`.

    Raises
    ------
    DataSetError
        The folder is not empty or cannot be written, or there is no measurement to write.

    """
    dataset, folder = as_dataset(dataset), place('folder', folder)
    if dataset.parts:
        names = ', '.join(part.name for part in dataset.parts)
        raise DataSetError(dataset.name, f'was joined from {names}', 'write each of them')
    unmeasured = dataset.trials == 0
    if unmeasured.all() or (unmeasured.any() and dataset.path == 'from_straight'):
        posture = dataset.postures[int(unmeasured.argmax())]
        problem = 'has no measurement to write'
        remedy = 'select the measured postures'
        raise DataSetError(f'{dataset.name}: posture {posture!r}', problem, remedy)
    refuse_dataset_in(folder, overwrite)
    dataset = dataset.without_unseen_markers()
    with new_folder(Path(folder), (*FILES, *BESIDE) if overwrite else ()) as new:
        (new / 'dataset.yaml').write_text(dump_description(dataset), encoding='utf-8')
        (new / 'robot.yaml').write_text(dump_robot(dataset.robot), encoding='utf-8')
        _write(new / 'inputs.csv', _input_rows(dataset))
        _write(new / 'shapes.csv', _shape_rows(dataset))
        for name, content in (beside or {}).items():
            (new / name).write_bytes(content)
    return Path(folder)


def _write(path: Path, rows: Iterable[Iterable[object]]) -> None:
    with path.open('w', encoding='utf-8', newline='') as file:
        csv.writer(file, lineterminator='\n').writerows(rows)


def _cells(values: Iterable[float]) -> list[object]:
    """Show floats so that reading gives the same ones; NaN as an empty cell."""
    return ['' if math.isnan(value) else value for value in values]


def _input_rows(dataset: DataSet) -> Iterator[Iterable[object]]:
    """Yield the header and a row per posture, per trial, or per visit in their order."""
    visits, measured = dataset.visits, dataset.trial_mask
    postures = dataset.postures if visits is None else visits.commands
    by_trial = dataset.trial_inputs is not None
    history: dict[str, Sequence[object]] = {}
    if visits is None:
        keep = measured if dataset.path == 'from_straight' else np.ones_like(measured)
        places = np.argwhere(keep)
    elif not visits.fresh[1:].any() and (visits.trials >= 0).all():  # in one go
        by_trial = True
        order = np.lexsort((visits.trials, visits.rows))
        places = np.column_stack([visits.rows, visits.trials])[order]
        history = {VISIT: order.tolist()}
    else:
        by_trial = len(set(visits.commands)) < len(visits.commands)
        places = np.argwhere(measured if by_trial else np.ones_like(measured))
        history = {ORIGIN: [visits.origins[p] for p in places[:, 0].tolist()]}
    if not by_trial:
        first = np.unique(places[:, 0], return_index=True)[1]
        places = places[first]
        history = {key: [past[i] for i in first.tolist()] for key, past in history.items()}
    yield ('posture', *(('trial',) if by_trial else ()), *history, *dataset.input_names)
    for (p, q), *past in zip(places.tolist(), *history.values(), strict=True):
        own = by_trial and (VISIT not in history or measured[p, q])
        values = dataset.inputs_by_trial[p, q] if own else dataset.inputs[p]
        trial = (dataset.trial_names[q],) if by_trial else ()
        yield (postures[p], *trial, *past, *_cells(values.tolist()))


def _shape_rows(dataset: DataSet) -> Iterator[Iterable[object]]:
    turned = dataset.orientations
    yield (*KEYS, *POSITION, *(QUATERNION if turned is not None else ()))
    postures = dataset.postures if dataset.visits is None else dataset.visits.commands
    seen = dataset.mask
    rows = np.hstack([one[seen] for one in (dataset.positions, turned) if one is not None])
    for (p, q, j), values in zip(np.argwhere(seen).tolist(), rows.tolist(), strict=True):
        yield (postures[p], dataset.trial_names[q], dataset.markers[j].name, *_cells(values))
