"""
Choose a command by its name and run it.

A command is a class (``module:Class``), or a module of its own, with ``HELP`` (one line),
``add_arguments(parser)`` and ``run(args) -> int`` (the exit code); in ``ros/`` it has ``HELP`` and
``main(argv) -> int``, or ``add_arguments`` and ``run(args, ros_arguments) -> int`` where it takes
more than parameters.
Only the chosen module is imported, so that no command pays for another one's dependencies;
for the list of commands, ``HELP`` is read from the source.
"""

from __future__ import annotations

import argparse
import ast
import importlib
import importlib.util
import os
import re
import sys
from collections.abc import Sequence
from enum import IntEnum
from pathlib import Path
from typing import Any, NoReturn

from ..common.errors import InputError, MissingExtraError, TendonRobotError, suggestion
from ..common.files import keep_bytecode
from ..common.words import PROGRAM

# The one list of commands: `python -m`, `ros2 run` and setup.py all read it.
COMMANDS: dict[str, str] = {
    'demo': 'tendon_robot_ros.ros.commands.demo',
    'new-robot': 'tendon_robot_ros.cli.robot:NewRobot',
    'describe': 'tendon_robot_ros.cli.robot:Describe',
    'shape': 'tendon_robot_ros.cli.model:ShapeCommand',
    'reach': 'tendon_robot_ros.cli.model:ReachCommand',
    'workspace': 'tendon_robot_ros.cli.model:WorkspaceCommand',
    'friction': 'tendon_robot_ros.studies.friction',
    'paper': 'tendon_robot_ros.studies.paper',
    'controller': 'tendon_robot_ros.ros.controller.node',
    'driver': 'tendon_robot_ros.ros.driver.node',
    'stop': 'tendon_robot_ros.ros.commands.stop',
    'teleop': 'tendon_robot_ros.ros.commands.teleop',
    'go-to': 'tendon_robot_ros.ros.commands.follow:GoTo',
    'follow': 'tendon_robot_ros.ros.commands.follow:Follow',
    'sweep': 'tendon_robot_ros.cli.model:Sweep',
    'record': 'tendon_robot_ros.ros.commands.record',
    'plot': 'tendon_robot_ros.cli.data:Plot',
    'robot-model': 'tendon_robot_ros.ros.commands.robot_model',
    'monitor': 'tendon_robot_ros.ros.monitor.node',
    'viewer': 'tendon_robot_ros.ros.viewer.node',
    'live': 'tendon_robot_ros.ros.commands.live',
    'investigate': 'tendon_robot_ros.ros.commands.investigate',
    'compare': 'tendon_robot_ros.cli.diagnosis:Compare',
    'diagnose': 'tendon_robot_ros.cli.diagnosis:Diagnose',
    'add': 'tendon_robot_ros.cli.diagnosis:Add',
    'remove': 'tendon_robot_ros.cli.diagnosis:Remove',
    'improve': 'tendon_robot_ros.cli.diagnosis:Improve',
    'fleet': 'tendon_robot_ros.studies.fleet',
    'campaign': 'tendon_robot_ros.studies.campaign',
    'simulate': 'tendon_robot_ros.cli.simulate',
    'rehearse': 'tendon_robot_ros.studies.rehearse',
    'export-bag': 'tendon_robot_ros.cli.data:ExportBag',
    'import-bag': 'tendon_robot_ros.cli.data:ImportBag',
    'import-table': 'tendon_robot_ros.cli.data:ImportTable',
    'emulate': 'tendon_robot_ros.cli.motors:Emulate',
    'calibrate': 'tendon_robot_ros.cli.motors:Calibrate',
}

PACKAGE = Path(__file__).parent.parent
NODE_OPTIONS = '[--ros-args [-p PARAMETER:=VALUE] [--params-file FILE] [-r FROM:=TO] ...]'


class ExitCode(IntEnum):
    """What a command returns to the shell."""

    DONE = 0
    ERROR = 1
    REFUSED = 2  # nothing was written because that would not help
    INTERRUPTED = 130  # Ctrl-C, as shells say it: 128 and the number of the signal


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
        unknown = re.match(r'unrecognized arguments: (--[\w-]+)', message)
        hint = suggestion(unknown[1], self._option_string_actions) if unknown else ''
        raise InputError(f'{message}; {hint}see {self.prog} --help')


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command that the arguments name; return the exit code."""
    name, *arguments = (sys.argv[1:] if argv is None else argv) or ['--help']
    return _guarded(name, arguments, f'{PROGRAM} {name}')


def run_named() -> int:
    """Run the command after which this executable is named (``ros2 run``, ``ros2 launch``)."""
    name = Path(sys.argv[0]).name
    return _guarded(name, sys.argv[1:], name)


def _guarded(name: str, arguments: list[str], program: str) -> int:
    """Run a command; a known error becomes one line and exit code 1."""
    keep_bytecode()
    try:
        code = run_command(name, arguments, program)
        sys.stdout.flush()
    except BrokenPipeError:  # the reader, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return ExitCode.DONE
    except KeyboardInterrupt:
        return ExitCode.INTERRUPTED
    except (TendonRobotError, OSError) as error:
        message = str(error)
        if isinstance(error, OSError) and error.filename:
            message = f'{error.filename}: {error.strerror}'
        print('error:', ' '.join(message.split()), file=sys.stderr)
        return ExitCode.ERROR
    return code


def run_command(name: str, arguments: list[str], program: str) -> int:
    """Run a command; return its exit code."""
    if name in ('-h', '--help'):
        width = max((len(command) for command in COMMANDS), default=0)
        print(f'usage: {PROGRAM} COMMAND [ARGUMENTS]\n\ncommands:')
        for known, place in COMMANDS.items():
            print(f'  {known:{width}}  {_help_line(place)}')
        return 0
    if name not in COMMANDS:
        hint = suggestion(name, COMMANDS)
        raise InputError(f'no command {name!r}; {hint}known: {", ".join(COMMANDS)}')
    if '.ros.' in COMMANDS[name]:
        return run_node(COMMANDS[name], arguments, program)
    command = command_of(COMMANDS[name])
    parser = Parser(prog=program, description=_documentation(COMMANDS[name]))
    command.add_arguments(parser)
    return int(command.run(parser.parse_args(arguments)))


def command_of(place: str) -> Any:
    """Import the module of a command, or make an instance of its class there."""
    module_name, _, class_name = place.partition(':')
    module = importlib.import_module(module_name)
    return getattr(module, class_name)() if class_name else module


def run_node(place: str, arguments: list[str], program: str) -> int:
    """Run a command of ROS; of its arguments, those from --ros-args on are for ROS."""
    at = arguments.index('--ros-args') if '--ros-args' in arguments else len(arguments)
    own, ros_arguments = arguments[:at], arguments[at:]
    missing = importlib.util.find_spec('rclpy') is None
    functions = {n.name for n in _source(place).body if isinstance(n, ast.FunctionDef)}
    takes_more = 'add_arguments' in functions
    if ('-h' in own or '--help' in own) and (missing or not takes_more):
        print(f'usage: {program} {NODE_OPTIONS}\n\n{_documentation(place)}')
        return 0
    if missing:
        raise MissingExtraError('rclpy', 'ros')
    # the wheels of rclpy find their middleware through this; a sourced ROS has set it
    os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
    command = command_of(place)
    if not takes_more:
        return int(command.main(arguments))
    parser = Parser(prog=program, description=_documentation(place))
    parser.epilog = f'and, as every node: {NODE_OPTIONS}'
    command.add_arguments(parser)
    return int(command.run(parser.parse_args(own), ros_arguments))


def source_of(place: str) -> Path:
    """Find the file of a command without importing the packages around it."""
    module_name = place.partition(':')[0]
    return PACKAGE.joinpath(*module_name.split('.')[1:]).with_suffix('.py')


def _source(place: str) -> ast.Module | ast.ClassDef:
    """Parse the module of a command, or its class there."""
    tree, name = ast.parse(source_of(place).read_text(encoding='utf-8')), place.partition(':')[2]
    classes = (node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == name)
    return next(classes) if name else tree


def _help_line(place: str) -> str:
    """Read HELP from the source of a command."""
    for node in _source(place).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == 'HELP':
            return str(ast.literal_eval(node.value))
    raise AssertionError(f'{place} defines no HELP')


def _documentation(place: str) -> str:
    """Join HELP and the docstring of a command."""
    return f'{_help_line(place)}\n\n{ast.get_docstring(_source(place)) or ""}'
