"""A robot from a name, a path, YAML text, a dict or an object; a robot back to YAML."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ..common.errors import InputError, RobotDescriptionError, refusal, suggestion
from ..common.files import named_file, read_text, shared_file
from ..common.yaml_reading import Reader, dump_yaml
from .description import DESCRIPTION_MAX, Robot, Section, Tendon, check_robot, parse_robot

EXPECTED = (
    'the name of a robot in config/robots, the path of a description, its YAML text or its keys '
    'as a dict'
)


class HasRobot(Protocol):
    """Anything with a robot: a model, a plant, a data set, a result."""

    @property
    def robot(self) -> Robot:
        """The robot."""


RobotLike = Robot | HasRobot | str | Path | Mapping[str, Any]


def load_robot(robot: RobotLike) -> Robot:
    """
    Return the robot of a name, a path, YAML text, a dict or an object.

    Parameters
    ----------
    robot : str, Path, dict, Robot or Model
        The name of a robot in config/robots, the path of a description, its YAML text, its keys
        as a dict; a robot, or what has one (a model, a data set, an addition), gives that.

    Raises
    ------
    RobotDescriptionError
        With file, key, what was expected and what came.
    InputError
        No robot has that name, or the argument is none of these.

    """
    if isinstance(robot, Robot):
        return robot
    if isinstance(robot, Path):
        return _read(robot)
    if isinstance(robot, str):
        if not robot.strip():
            raise InputError(f'robot: expected {EXPECTED}, got nothing')
        file = robot_file(robot)
        return parse_robot(robot, 'robot given as text') if file is None else _read(file)
    if isinstance(robot, Mapping):
        return check_robot(Reader('robot given as dict', '', _plain(robot)))
    if isinstance(own := getattr(robot, 'robot', None), Robot):
        return own
    raise refusal('robot', EXPECTED, robot)


def robot_file(text: str) -> Path | None:
    """Return the file of a path or a name; None where the text is the description itself."""
    path = named_file(text, 'robots')
    if path is not None and not (path.suffix or os.sep in text or path.exists()):
        first = shared_file('config/robots/kato_10_1.yaml')
        names = [] if first is None else sorted(path.stem for path in first.parent.glob('*.yaml'))
        raise InputError(
            f'{text}: expected a path or the name of a robot, no such file; '
            f'{suggestion(text, names)}known names: {", ".join(names) or "none installed"}'
        )
    return path


def _read(path: Path) -> Robot:
    """Read a description from a file."""
    if path.is_dir():
        own = path / 'robot.yaml'
        hint = f'its {own}' if own.is_file() else 'a robot description in it'
        raise InputError(f'{path}: is a folder; name {hint}')

    def refuse(reason: str) -> RobotDescriptionError:
        return RobotDescriptionError(str(path), 'file', 'a readable YAML file', reason)

    return parse_robot(read_text(path, refuse, DESCRIPTION_MAX + 1), str(path))


def _plain(value: Any) -> Any:
    """Return plain values as in YAML: tuples and arrays as lists, numpy scalars as numbers."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def dump_robot(robot: RobotLike) -> str:
    """Write a robot description as YAML text; `parse_robot` reads the same robot back."""
    robot = load_robot(robot)
    usual = Robot(robot.name, robot.sections, robot.tendons, robot.tension_limits)
    content: dict[str, Any] = {
        'name': robot.name,
        'sections': [section_to_yaml(section) for section in robot.sections],
        'tendons': [tendon_to_yaml(tendon) for tendon in robot.tendons],
        'tension_limits': robot.tension_limits,
    }
    for key in ('gravity', 'tolerances', 'exact', 'model_error', 'effects', 'fitted'):
        value = getattr(robot, key)
        if key == 'effects' or value != getattr(usual, key):
            content[key] = value
    return dump_yaml(_plain(content))


def section_to_yaml(section: Section) -> dict[str, Any]:
    """Return the keys of a section but for usual masses; what all cells share stands once."""
    usual = {'mass_profile': 1.0, 'mass_offset': ()}
    plain = {
        key: value[0] if isinstance(value, tuple) and len(set(value)) == 1 else value
        for key, value in vars(section).items()
    }
    return {key: value for key, value in plain.items() if value != usual.get(key)}


def tendon_to_yaml(tendon: Tendon) -> dict[str, Any]:
    """Return the keys of a tendon, but for those that have their default."""
    offset: Any = tendon.base
    if tendon.offsets:
        offset = {'cells': tendon.offsets}
    elif tendon.base != tendon.end or tendon.helix:
        offset = {'base': tendon.base, 'end': tendon.end}
        if tendon.helix:
            offset['helix'] = tendon.helix
    own = {key: getattr(tendon, key) for key in ('drum', 'winding', 'group')}
    own = {key: value for key, value in own.items() if value != getattr(Tendon, key)}
    return {'name': tendon.name, 'offset': offset, 'section': tendon.section, **own}
