"""Finding the files that come with the package, and reading a robot from a path or from text."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

from ...common.errors import InputError
from ...common.yaml_reading import parse_yaml
from ...robot import Robot, load_robot, parse_robot
from ...robot.description import DESCRIPTION_MAX

PACKAGE = 'tendon_robot_ros'
PATH_CHARACTERS_MAX = 1000


def shared_file(name: str) -> Path | None:
    """
    Find a file such as `config/driver.yaml`.

    Looks in a source tree first, then where pip and colcon install shared files.
    """
    roots = [Path(__file__).resolve().parents[3]]
    prefixes = [sys.prefix, *os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)]
    roots += [Path(prefix) / 'share' / PACKAGE for prefix in prefixes if prefix]
    return next((root / name for root in roots if (root / name).is_file()), None)


def _known_robots() -> str:
    """List the names of the robots in config/robots."""
    first = shared_file('config/robots/kato_10_1.yaml')
    names = [] if first is None else sorted(path.stem for path in first.parent.glob('*.yaml'))
    return ', '.join(names) or 'none installed'


def read_robot(text: str) -> Robot:
    """
    Read a robot from a path, from the name of a robot in config/robots, or from YAML text.

    Raises
    ------
    RobotDescriptionError
        With file, key, what was expected and what came.
    InputError
        The text is empty.

    """
    if not text.strip():
        raise InputError(
            'expected a path, the name of a robot in config/robots or YAML text, got nothing'
        )
    file = robot_file(text)
    return parse_robot(text, 'robot given as text') if file is None else load_robot(file)


def robot_file(text: str) -> Path | None:
    """Return the file that a path or a name means; None where the text is the description."""
    if '\n' in text or ': ' in text or len(text) > PATH_CHARACTERS_MAX:
        return None
    own = shared_file(f'config/robots/{text}.yaml')
    if own is not None and not Path(text).is_file():
        return own
    if not Path(text).suffix and os.sep not in text and not Path(text).exists():
        raise InputError(
            f'{text}: expected a path or the name of a robot, no such file; known names: '
            f'{_known_robots()}'
        )
    return Path(text)


def read_mapping(text: str, what: str) -> dict[str, Any]:
    """Read a configuration: a path, the name of a file in config, or YAML text; '' is empty."""
    if text.strip() and '\n' not in text and ':' not in text:
        own = None if Path(text).is_file() else shared_file(f'config/{text}.yaml')
        try:
            with (own or Path(text)).open(encoding='utf-8') as file:
                text = file.read(DESCRIPTION_MAX + 1)  # of a device there is no end
        except (OSError, UnicodeDecodeError) as error:
            reason = getattr(error, 'strerror', None) or 'not a text file'
            raise InputError(f'{what}: {text}: {reason}; expected a YAML file or text') from None
    if len(text) > DESCRIPTION_MAX:
        raise InputError(
            f'{what}: expected at most {DESCRIPTION_MAX:,} characters, got more than that'
        )
    try:
        content = parse_yaml(text)
    except ValueError as error:
        raise InputError(f'{what}: not valid YAML: {error}') from None
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise InputError(f'{what}: expected keys with values, got {content!r}')
    return content
