"""
Choose a command by its name and run it.

A command in ``cli/`` is a module with ``HELP`` (one line), ``add_arguments(parser)`` and
``run(args) -> int`` (the exit code); a node in ``nodes/`` has ``HELP`` and ``main(argv) -> int``.
Only the chosen module is imported, so that no command pays for another one's dependencies;
for the list of commands, ``HELP`` is read from the source.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import importlib
import importlib.util
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

from ..exceptions import InputError, MissingExtraError, TendonRobotError

# The one list of commands: `python -m`, `ros2 run` and setup.py all read it.
COMMANDS: dict[str, str] = {}

PROGRAM = 'python -m tendon_robot_ros'
NODE_OPTIONS = (
    'usage: {program} [--ros-args [-p PARAMETER:=VALUE ...] [--params-file FILE] '
    '[-r FROM:=TO ...]]'
)


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line, and that takes vectors like -0.1,0,0.2."""

    def __init__(self, *, prog: str, description: str) -> None:
        """Name the program and say what it does."""
        super().__init__(
            prog=prog,
            description=description,
            allow_abbrev=False,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        # argparse takes a leading minus for an option unless it sees a plain number
        self._negative_number_matcher = re.compile(r'^-[0-9.]')

    def error(self, message: str) -> NoReturn:
        """Raise the error instead of printing the usage and ending with 2."""
        raise InputError(f'{message}; see {self.prog} --help')


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that the arguments name; return the exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] in ('-h', '--help'):
        print(overview())
        return 0
    return _guarded(arguments[0], arguments[1:], f'{PROGRAM} {arguments[0]}')


def run_named() -> int:
    """Run the command after which this executable is named (``ros2 run``, ``ros2 launch``)."""
    name = Path(sys.argv[0]).stem
    return _guarded(name, sys.argv[1:], name)


def overview() -> str:
    """List the commands with one line each."""
    width = max((len(name) for name in COMMANDS), default=0)
    lines = [f'  {name:{width}}  {_documentation(COMMANDS[name])[0]}' for name in COMMANDS]
    return '\n'.join([f'usage: {PROGRAM} COMMAND [ARGUMENTS]', '', 'commands:', *lines])


def _guarded(name: str, arguments: list[str], program: str) -> int:
    """Run a command; a known error becomes one line and exit code 1."""
    try:
        return _run(name, arguments, program)
    except TendonRobotError as error:
        message = str(error)
    except BrokenPipeError:  # the reader, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        message = f'{error.filename}: {error.strerror}' if error.filename else str(error)
    except KeyboardInterrupt:
        return 130
    print('error:', ' '.join(message.split()), file=sys.stderr)
    return 1


def _run(name: str, arguments: list[str], program: str) -> int:
    module_name = COMMANDS.get(name)
    if module_name is None:
        near = difflib.get_close_matches(name, COMMANDS, n=1)
        hint = f'did you mean {near[0]}? ' if near else ''
        raise InputError(f'no command {name!r}; {hint}known: {", ".join(COMMANDS)}')
    summary, details = _documentation(module_name)
    if '.nodes.' in module_name:
        return _run_node(module_name, arguments, program, f'{summary}\n\n{details}')
    module = importlib.import_module(module_name)
    parser = Parser(prog=program, description=f'{summary}\n\n{details}')
    module.add_arguments(parser)
    return int(module.run(parser.parse_args(arguments)))


def _run_node(module_name: str, arguments: list[str], program: str, description: str) -> int:
    if any(option in arguments for option in ('-h', '--help')):
        print(f'{NODE_OPTIONS.format(program=program)}\n\n{description}')
        return 0
    if importlib.util.find_spec('rclpy') is None:
        raise MissingExtraError('rclpy', 'ros')
    # the wheels of rclpy find their middleware through this; a sourced ROS has set it
    os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
    return int(importlib.import_module(module_name).main(arguments) or 0)


def _documentation(module_name: str) -> tuple[str, str]:
    """Read HELP and the docstring of a module without importing it."""
    path = Path(__file__).parents[1].joinpath(*module_name.split('.')[1:]).with_suffix('.py')
    tree = ast.parse(path.read_text(encoding='utf-8'))
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == 'HELP':
            return ast.literal_eval(node.value), ast.get_docstring(tree) or ''
    raise AssertionError(f'{path} defines no HELP')
