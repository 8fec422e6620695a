"""
Choose a command by its name and run it.

A command is a class (``module:Class``), or a module of its own, with ``HELP`` (one line),
``add_arguments(parser)`` and ``run(args)``, which returns the exit code where it may be another
than 0; in ``ros/`` it has ``HELP`` and ``main(argv) -> int``, or ``add_arguments`` and
``run(args, ros_arguments)`` where it takes more than parameters.
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
from textwrap import shorten, wrap
from typing import Any, NoReturn

from ..common.errors import InputError, MissingExtraError, TendonRobotError, suggestion
from ..common.files import keep_bytecode
from ..common.words import PROGRAM

# The one list of commands: `python -m`, `ros2 run` and setup.py all read it. A command of two
# words belongs to a group, which is an executable.
COMMANDS: dict[str, str] = {
    'demo': 'tendon_robot_ros.ros.commands.demo',
    'live': 'tendon_robot_ros.ros.commands.live',
    'robot new': 'tendon_robot_ros.cli.robot:NewRobot',
    'robot describe': 'tendon_robot_ros.cli.robot:Describe',
    'model shape': 'tendon_robot_ros.cli.model:ShapeCommand',
    'model reach': 'tendon_robot_ros.cli.model:ReachCommand',
    'model workspace': 'tendon_robot_ros.cli.model:WorkspaceCommand',
    'model sweep': 'tendon_robot_ros.cli.model:Sweep',
    'compare': 'tendon_robot_ros.cli.diagnosis:Compare',
    'diagnose': 'tendon_robot_ros.cli.diagnosis:Diagnose',
    'improve': 'tendon_robot_ros.cli.diagnosis:Improve',
    'effect add': 'tendon_robot_ros.cli.diagnosis:Add',
    'effect remove': 'tendon_robot_ros.cli.diagnosis:Remove',
    'import table': 'tendon_robot_ros.cli.data:ImportTable',
    'import bag': 'tendon_robot_ros.cli.data:ImportBag',
    'export bag': 'tendon_robot_ros.cli.data:ExportBag',
    'export mjcf': 'tendon_robot_ros.cli.model:ExportMjcf',
    'simulate': 'tendon_robot_ros.cli.simulate',
    'investigate': 'tendon_robot_ros.ros.commands.investigate',
    'controller': 'tendon_robot_ros.ros.controller.node',
    'driver': 'tendon_robot_ros.ros.driver.node',
    'monitor': 'tendon_robot_ros.ros.monitor.node',
    'viewer': 'tendon_robot_ros.ros.viewer.node',
    'robot-model': 'tendon_robot_ros.ros.commands.robot_model',
    'stop': 'tendon_robot_ros.ros.commands.stop',
    'go-to': 'tendon_robot_ros.ros.commands.follow:GoTo',
    'follow': 'tendon_robot_ros.ros.commands.follow:Follow',
    'teleop': 'tendon_robot_ros.ros.commands.teleop',
    'record': 'tendon_robot_ros.ros.commands.record',
    'plot': 'tendon_robot_ros.cli.data:Plot',
    'motors calibrate': 'tendon_robot_ros.cli.motors:Calibrate',
    'motors emulate': 'tendon_robot_ros.cli.motors:Emulate',
    'study campaign': 'tendon_robot_ros.studies.campaign',
    'study fleet': 'tendon_robot_ros.studies.fleet',
    'study friction': 'tendon_robot_ros.studies.friction',
    'study paper': 'tendon_robot_ros.studies.paper',
    'study rehearse': 'tendon_robot_ros.studies.rehearse',
    'completion': 'tendon_robot_ros.cli.completion',
}
# what a command of ROS does without it
WITHOUT_ROS = {'tendon_robot_ros.ros.commands.live': 'tendon_robot_ros.cli.live'}
GROUPS = {
    'robot': 'describe a robot: by answers to questions, or what a description says',
    'model': 'ask the model: shape, tensions for a target, range of the tip, a way to look around',
    'effect': 'add physical effects to a description, fitted on measurements; take them out',
    'import': 'make a data set of a table or a ROS 2 recording',
    'export': 'write a data set as a ROS 2 recording, a robot for MuJoCo',
    'motors': 'calibrate tension with known weights; emulate motors on a port',
    'study': 'many simulated robots, fleets, rehearsals; friction from slip angles; the paper',
}
# Names of version 0.1, which go with the release after 1.0
WORDS = [name.partition(' ') for name in COMMANDS]
OLD_NAMES = {
    'new-robot': 'robot new',
    'describe': 'robot describe',
    'import-table': 'import table',
    'import-bag': 'import bag',
    'export-bag': 'export bag',
    **{
        second: f'{first} {second}'
        for first, _, second in WORDS
        if first in ('effect', 'model', 'motors', 'study')
    },
}
# likewise of its options, by command
OLD_OPTIONS = {
    'import bag': {'--change': '--same'},
    'model workspace': {'--limit': '--tension-max'},
    'motors calibrate': {'--out': '--output'},
    'motors emulate': {
        '--model': '--servo',
        '--spool-radius': '--spool',
        '--write-config': '--output',
    },
    'simulate': {'--count': '--postures'},
}
# with hyphens, and with underscores as ROS has them
_NAMES = {*(first for first, _, _ in WORDS), *OLD_NAMES}
EXECUTABLES = sorted(_NAMES | {name.replace('-', '_') for name in _NAMES})

SCREEN_COLUMNS = 100  # [1] of a help, because a terminal hardly has fewer
SCREEN_LINES = 24  # [1] of a help, because a terminal opens with as many
PACKAGE = Path(__file__).parent.parent
NODE_OPTIONS = '[--ros-args [-p NAME:=VALUE] [--params-file FILE] [-r FROM:=TO]]'


class ExitCode(IntEnum):
    """What a command returns to the shell."""

    DONE = 0
    ERROR = 1
    REFUSED = 2  # nothing was written because that would not help
    INTERRUPTED = 130  # Ctrl-C, as shells say it: 128 and the number of the signal


def _call(action: argparse.Action, whole: bool = True) -> str:
    """Return how an argument is typed; a long list of choices by its name unless `whole`."""
    value = str(action.metavar or action.dest.upper())
    if action.metavar is None and action.choices:
        choices = f'{{{",".join(map(str, action.choices))}}}'
        value = choices if whole or len(choices) < 0.5 * SCREEN_COLUMNS else value
    if isinstance(action.metavar, tuple):
        value = ' '.join(action.metavar)
    value += ' ...' if action.nargs in ('+', '*') else ''
    value = f'[{value}]' if action.nargs in ('?', '*') else value
    return ' '.join([*action.option_strings[:1], *([] if action.nargs == 0 else [value])])


class _Help(argparse.Action):
    """Print the help and end."""

    def __call__(self, parser: Any, *_: Any) -> None:
        """Print as much as the option asks for."""
        print(parser.format_help(bool(self.const)), end='')
        parser.exit()


class Parser(argparse.ArgumentParser):
    """
    An argument parser whose errors are one line, and that takes vectors like -0.1,0,0.2.

    `--help` prints the first sentence of the description, the options and an example, so that it
    fits a screen; `--help-all` prints the whole description.
    """

    def __init__(self, *, prog: str, description: str, note: str = '') -> None:
        """Name the program and say what it does; `note` stands below the options."""
        super().__init__(prog=prog, allow_abbrev=False, add_help=False)
        self.text, self.note, self.example = description.split('\n\n'), note, ''
        if self.text[-1].startswith('example: '):
            self.example = self.text.pop()
        hidden: Any = {'default': argparse.SUPPRESS, 'help': argparse.SUPPRESS}
        self.add_argument('-h', '--help', action=_Help, nargs=0, const=False, **hidden)
        self.add_argument('--help-all', action=_Help, nargs=0, const=True, **hidden)
        # argparse takes a leading minus for an option unless it sees a plain number
        self._negative_number_matcher = re.compile(r'^-[0-9.]')

    def format_help(self, whole: bool = False) -> str:
        """Return the help: the first paragraph and a line per option, or all of both."""
        shown = [action for action in self._actions if action.help != argparse.SUPPRESS]
        # the last options are only named where a screen has no line for each
        for named in range(len(shown) + 1):
            text = self._help(shown, shown[len(shown) - named :], whole)
            if whole or text.count('\n') <= SCREEN_LINES:
                break
        return text

    def _help(
        self, shown: list[argparse.Action], named: list[argparse.Action], whole: bool
    ) -> str:
        """Return the help of the arguments that are `shown`, some of which are only `named`."""
        needed = [a for a in shown if not a.option_strings]
        needed += [a for a in shown if a.option_strings and a.required]
        words = [self.prog, *map(_call, needed), *(['[options]'] * (len(shown) > len(needed)))]
        parts = [f'usage: {" ".join(words)}', *(self.text if whole else self.text[:1])]
        for group in self._action_groups:
            own = [a for a in group._group_actions if a in shown and a not in named]
            title = [] if group in self._action_groups[:2] or not own else [f'{group.title}:']
            parts.append('\n'.join([*title, *(self._line(action, whole) for action in own)]))
        also = ', '.join(action.option_strings[0] for action in named)
        more = wrap(f'more: --help-all{", also of " * bool(named)}{also}', SCREEN_COLUMNS)
        parts += [self.note, '\n'.join(filter(None, [*([] if whole else more), self.example]))]
        return '\n\n'.join(filter(None, parts)) + '\n'

    def _line(self, action: argparse.Action, whole: bool) -> str:
        """Return what an argument means: in one line, which may be cut, or whole."""
        text = self._get_formatter()._expand_help(action) if action.help else ''
        head = f'  {_call(action, whole):24} '
        if whole:
            return '\n'.join(wrap(head + text, SCREEN_COLUMNS, subsequent_indent=' ' * 27))
        return (head + shorten(text, SCREEN_COLUMNS - len(head), placeholder=' ...')).rstrip()

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
    """Run a command; return its exit code. Underscores in its name stand for hyphens."""
    name = name.replace('_', '-')
    if name in ('-h', '--help'):
        print(f'usage: {PROGRAM} COMMAND [ARGUMENTS]; COMMAND --help\n\n{_listing("")}')
        return 0
    if name in OLD_NAMES and name not in COMMANDS:
        new = _renamed(name, OLD_NAMES[name])
        program, name = program.removesuffix(name) + new, new
    elif members := [one for one in COMMANDS if one.startswith(f'{name} ')]:
        word, *arguments = arguments or ['--help']
        if word in ('-h', '--help'):
            print(f'usage: {program} COMMAND [ARGUMENTS]\n\n{_listing(name)}')
            return 0
        if f'{name} {word}' not in members:
            known = [one.split()[1] for one in members]
            hint = suggestion(word, known)
            raise InputError(f'{name}: no command {word!r}; {hint}known: {", ".join(known)}')
        program, name = f'{program} {word}', f'{name} {word}'
    if name not in COMMANDS:
        known = list(dict.fromkeys(one.split()[0] for one in COMMANDS))
        hint = suggestion(name, known)
        raise InputError(f'no command {name!r}; {hint}known: {", ".join(known)}')
    if '.ros.' in COMMANDS[name]:
        return run_node(COMMANDS[name], arguments, program)
    command = command_of(COMMANDS[name])
    parser = Parser(prog=program, description=_documentation(COMMANDS[name]))
    command.add_arguments(parser)
    return int(command.run(parser.parse_args(_with_new_options(name, arguments))) or 0)


def _renamed(old: str, new: str) -> str:
    """Say that a name is an old one, and return the new one."""
    end = '(the old name goes with the next release)'
    print(f'{old} is now called: {new} {end}', file=sys.stderr)
    return new


def _with_new_options(name: str, arguments: Sequence[str]) -> list[str]:
    """Return arguments with the present names of options."""
    known, given = OLD_OPTIONS.get(name, {}), []
    for word in arguments:
        option, equals, value = word.partition('=')
        option = _renamed(option, known[option]) if option in known else option
        given.append(f'{option}{equals}{value}')
    return given


def _listing(group: str) -> str:
    """List the commands of a group with a line each, or all of them, a group in one line."""
    lines: dict[str, str] = {}
    for name, place in COMMANDS.items():
        first, _, second = name.partition(' ')
        if group in ('', first):
            title = second if group else first
            lines[title] = GROUPS[first] if second and not group else _help_line(place)
    width = max(map(len, lines))
    return '\n'.join(['commands:', *(f'  {name:{width}}  {line}' for name, line in lines.items())])


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
    note = f'and, as every node: {NODE_OPTIONS}'
    parser = Parser(prog=program, description=_documentation(place), note=note)
    known = takes_more and (place in WITHOUT_ROS or not missing)
    if {'-h', '--help', '--help-all'} & {*own} and not known:
        print(parser.format_help(whole=True), end='')
        return 0
    if missing and place not in WITHOUT_ROS:
        raise MissingExtraError('rclpy', 'ros')
    # the wheels of rclpy find their middleware through this; a sourced ROS has set it
    os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
    command = command_of(WITHOUT_ROS[place] if missing else place)
    if not takes_more:
        return int(command.main(arguments))
    command.add_arguments(parser)
    return int(command.run(parser.parse_args(own), ros_arguments) or 0)


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
    """Return the docstring of a command."""
    return ast.get_docstring(_source(place)) or ''
