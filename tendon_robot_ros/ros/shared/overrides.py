"""
Settings that a node was started with and that it does not know: ROS would swallow them.

A misspelt `-p`, a file of parameters with a misspelt name, or one for nodes of other names, would
have the node run with its defaults, without a word.
"""

from __future__ import annotations

import contextlib
import difflib
import re
from collections.abc import Collection, Iterator, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

from ...common.errors import InputError
from ...common.yaml_reading import parse_yaml

NODES = (
    'driver',
    'controller',
    'monitor',
    'viewer',
    'teleop',
    'robot_model',
)  # of launch files: one file for all
ALL = '/**'
SPEC = re.compile(r"\bSpec\(\s*'(\w+)'")
OF_ROS = ('use_sim_time', 'start_type_description_service', 'qos_overrides.')  # any node has them


def check_overrides(
    given: Collection[str], known: Collection[str], node: str, arguments: Sequence[str] = ()
) -> None:
    """
    Refuse parameters that a node does not declare.

    Parameters
    ----------
    given : collection of str
        Names that the node was started with.
    known : collection of str
        Names that it declares.
    node : str
        Its name, for the message.
    arguments : sequence of str
        The command line, for ROS: a section for all nodes of a file may name parameters of
        another node of this package.

    """
    for name in sorted(given):
        if name in known or name.startswith(OF_ROS):
            continue
        if name in _for_all(arguments) and name in _of_any_node():
            continue
        near = difflib.get_close_matches(name, known, n=1)
        hint = f'did you mean {near[0]}? ' if near else ''
        raise InputError(
            f'parameter {name}: {node} has none of that name; {hint}known: '
            f'{", ".join(sorted(known))}'
        )


def check_files(arguments: Sequence[str], node: str) -> list[str]:
    """
    Look for files of parameters that say nothing to a node.

    Parameters
    ----------
    arguments : sequence of str
        The command line, for ROS.
    node : str
        Name of the node, with its namespace.

    Returns
    -------
    list of str
        What to warn of: files for other nodes of this package. Launch files may give one file to
        several nodes.

    Raises
    ------
    InputError
        A file is for no node of this package.

    """
    found = []
    for file, content in _files(arguments):
        keys = list(_sections(content))
        names = [key.rpartition('/')[2] for key in keys]
        own = node.rpartition('/')[2]
        if not keys or any(_means(key, node) for key in keys):
            continue
        said = f'{file}: its parameters are for {", ".join(keys)}, not for {node}'
        if own in names or not any(name in NODES for name in names):
            raise InputError(f'{said}; write {node}: or /**: as the first line')
        found.append(f'{said}, which takes none of them')
    return found


def _files(arguments: Sequence[str]) -> Iterator[tuple[str, Any]]:
    """Read the files of parameters of a command line."""
    for flag, file in pairwise(arguments):
        if flag == '--params-file':
            with contextlib.suppress(OSError, ValueError):  # rclpy has read it
                yield file, parse_yaml(Path(file).read_text(encoding='utf-8'))


def _sections(content: Any, before: str = '') -> dict[str, Any]:
    """Return node -> parameters; a node is `/namespace/node`, which may have wildcards."""
    found: dict[str, Any] = {}
    for key, inside in content.items() if isinstance(content, dict) else ():
        if key == 'ros__parameters':
            found[before or ALL] = inside
        else:
            found |= _sections(inside, f'{before}/{str(key).strip("/")}')
    return found


def _for_all(arguments: Sequence[str]) -> set[str]:
    """Return what files say to nodes of any name."""
    sections = (_sections(content).get(ALL) for _, content in _files(arguments))
    return {name for section in sections if isinstance(section, dict) for name in section}


@cache
def _of_any_node() -> set[str]:
    """Read the names of all parameters from the sources: to import all nodes takes long."""
    sources = Path(__file__).parents[1].rglob('*.py')
    return {name for file in sources for name in SPEC.findall(file.read_text(encoding='utf-8'))}


def _means(key: str, node: str) -> bool:
    """Whether a key of a file means a node, as rcl has it."""
    pattern = re.escape(key).replace(r'/\*\*', '(/.+)?').replace(r'\*', '[^/]+')
    return re.fullmatch(pattern, node) is not None
