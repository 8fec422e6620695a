"""dataset.yaml: how a data set was taken, checked on reading."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ...common import files
from ...common.errors import DataSetError, short
from ...common.yaml_reading import Reader, parse_yaml
from ...robot import Robot, load_robot
from ..dataset import INPUTS, PATHS, DataSet, Known
from ..markers import Marker, Vector, default_markers

KEYS = (
    'robot',
    'input',
    'path',
    'gravity',
    'position_noise',
    'tension_noise',
    'accuracy',
    'known',
    'markers',
)
GRAVITY_MAX = 30.0  # [m/s²]; Jupiter has 25


class DatasetFields(Reader):
    """Checked reading of dataset.yaml."""

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


@dataclass(frozen=True)
class Description:
    """What dataset.yaml says; see `DataSet` for the meaning of each value."""

    input: str
    path: str
    gravity: Vector | None
    position_noise: float | None
    setting_noise: float
    trial_noise: float
    accuracy: float | None
    known: Known
    markers: tuple[Marker, ...] | None  # None = one per cell


NO_FOLDER = (
    'name a folder with dataset.yaml, inputs.csv and shapes.csv; of a table import-table makes one'
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
    """
    Read the text of a dataset.yaml.

    Raises
    ------
    DataSetError
        It is no YAML, or has unknown keys.

    """
    try:
        content = parse_yaml(text)
    except ValueError as error:
        raise DataSetError(source, f'is no valid YAML ({error})', 'correct that line') from None
    fields = DatasetFields(source, '', content)
    fields.only(*KEYS)
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
        raise DataSetError(
            f'{fields.source}: robot',
            f'no file {name if len(name) < 256 else name[:256] + "..."}',
            'put the robot description there or correct the path',
        )
    return load_robot(path)


def describe(fields: DatasetFields, robot: Robot) -> Description:
    """
    Check the values of a dataset.yaml against the robot.

    Raises
    ------
    DataSetError
        A value is missing, of the wrong kind, or cannot be in the unit it should be in.

    """
    noise = fields.child('tension_noise', optional=True)
    noise.only('setting', 'trial')
    return Description(
        input=fields.choice('input', INPUTS, default='tension'),
        path=fields.choice('path', PATHS, default='from_straight'),
        gravity=_gravity(fields) if fields.has('gravity') else None,
        position_noise=fields.distance('position_noise', robot.length / 10),
        setting_noise=_relative(noise, 'setting'),
        trial_noise=_relative(noise, 'trial'),
        accuracy=fields.distance('accuracy', robot.length),
        known=_known(fields),
        markers=_markers(fields, robot) if fields.has('markers') else None,
    )


def _relative(noise: DatasetFields, key: str) -> float:
    return noise.number(key, 0.0, 0.5) if noise.has(key) else 0.0


def _known(fields: DatasetFields) -> Known:
    """Read effects that acted while this was measured; what they mean the catalogue says."""
    known: dict[str, dict[str, float]] = {}
    for name in fields.mapping('known'):
        effect = fields.child('known').child(str(name))
        if not effect.content:
            raise fields.error(
                'known', 'parameters such as tip_load: {force_z: 0.98}', effect.content
            )
        known[str(name)] = {str(key): effect.number(str(key)) for key in effect.content}
    return known


def _gravity(fields: DatasetFields) -> Vector:
    x, y, z = fields.vector('gravity', 3)
    if x * x + y * y + z * z > GRAVITY_MAX**2:
        raise fields.error('gravity', 'an acceleration in m/s², such as [0, 0, 9.81]', [x, y, z])
    return x, y, z


def _markers(fields: DatasetFields, robot: Robot) -> tuple[Marker, ...]:
    markers = []
    for item in fields.items('markers'):
        item.only('name', 'arc_length', 'offset')
        arc_length = item.number('arc_length', 0.0, robot.length + 1e-9, 'm')
        offset = item.vector('offset', 3) if item.has('offset') else (0.0, 0.0, 0.0)
        if max(map(abs, offset)) > 3.0 * robot.length:
            raise item.error(
                'offset', 'at most three robot lengths [m] (is it in mm?)', list(offset)
            )
        markers.append(Marker(item.label('name'), arc_length, offset))
    fields.unique('markers', [marker.name for marker in markers])
    return tuple(markers)


def dump_description(dataset: DataSet, robot: str = 'robot.yaml') -> str:
    """Write a dataset.yaml that names `robot`; reading it gives the same values."""
    content: dict[str, Any] = {'robot': robot, 'input': dataset.input, 'path': dataset.path}
    if dataset.gravity is not None:
        content['gravity'] = list(dataset.gravity)
    if dataset.position_noise is not None:
        content['position_noise'] = dataset.position_noise
    noise = {'setting': dataset.setting_noise, 'trial': dataset.trial_noise}
    if any(noise.values()):
        content['tension_noise'] = noise
    if dataset.accuracy is not None:
        content['accuracy'] = dataset.accuracy
    if dataset.known:
        content['known'] = {name: dict(values) for name, values in dataset.known.items()}
    if dataset.markers != default_markers(dataset.robot):
        content['markers'] = [_plain(marker) for marker in dataset.markers]
    return str(
        yaml.safe_dump(content, sort_keys=False, default_flow_style=None, allow_unicode=True)
    )


def _plain(marker: Marker) -> Mapping[str, Any]:
    plain = {'name': marker.name, 'arc_length': marker.arc_length}
    return {**plain, 'offset': list(marker.offset)} if any(marker.offset) else plain
