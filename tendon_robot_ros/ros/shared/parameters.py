"""
Parameters: declared as parameters.yaml lists them; refusals; parameters of other nodes.

A parameter that a node is started with and does not declare is refused, too: ROS would ignore a
misspelt `-p`, or a file of parameters for other nodes, and the node would run with its defaults.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

from rcl_interfaces.msg import (
    FloatingPointRange,
    ParameterDescriptor,
    ParameterType,
    SetParametersResult,
)
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter, parameter_value_to_python

from ...common.errors import InputError, TendonRobotError, suggestion
from ...common.files import named_file, read_text
from ...common.yaml_reading import parse_yaml
from ...robot import Robot, load_robot
from ...robot.description import DESCRIPTION_MAX
from .messages import Request
from .runtime import Runnable, given, repeat
from .timing import STATUS_PERIOD_S

TABLE = Path(__file__).parent.parent / 'parameters.yaml'  # the parameters of all nodes
TYPES = {  # type of a default -> type of ROS, and what a refusal expects
    bool: (ParameterType.PARAMETER_BOOL, 'true or false'),
    float: (ParameterType.PARAMETER_DOUBLE, 'a number'),
    str: (ParameterType.PARAMETER_STRING, 'text'),
    list: (ParameterType.PARAMETER_STRING_ARRAY, 'a list of text'),
}


@dataclass(frozen=True)
class Spec:
    """A parameter of a node; a list is a list of strings."""

    name: str
    default: Any  # bool, float, str or list of str
    text: str
    unit: str = ''
    low: float = -math.inf
    high: float = math.inf
    read_only: bool = False
    choices: Sequence[str] = ()

    def checked(self, value: Any) -> Any:
        """Return the value converted to its type; InputError: it has another type or range."""
        kind = type(self.default)
        if kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)  # so that 10 may be written for 10.0
        if kind is list and isinstance(value, (list, tuple)):
            value = [str(item) for item in value if str(item)]
        expected = ''
        if not isinstance(value, kind):
            expected, value = TYPES[kind][1], repr(value)
        elif isinstance(value, float) and not self.low <= value <= self.high:
            expected, value = f'{self.low:g} to {self.high:g} {self.unit}', f'{value:g}'
        elif self.choices and value not in self.choices:
            expected, value = f'one of {", ".join(self.choices)}', repr(value)
        if expected:
            raise InputError(f'{self.name}: expected {expected}, got {value}')
        return value

    def descriptor(self) -> ParameterDescriptor:
        """Return the description of the parameter for ROS."""
        unit = f' [{self.unit}]' if self.unit else ''
        descriptor = ParameterDescriptor(
            name=self.name,
            description=self.text + unit,
            read_only=self.read_only,
            type=TYPES[type(self.default)][0],
            dynamic_typing=True,  # so that `checked` may accept 10 for 10.0
            additional_constraints=' | '.join(self.choices),
        )
        if math.isfinite(self.low) and math.isfinite(self.high):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=self.low, to_value=self.high)
            ]
        return descriptor


@cache
def declared() -> dict[str, dict[str, Spec]]:
    """Return the parameters of every node of this package by their names, as declared."""
    nodes = parse_yaml(TABLE.read_text(encoding='utf-8'))
    return {
        node: {name: Spec(name, **entry) for name, entry in parameters.items()}
        for node, parameters in nodes.items()
    }


Hook = Callable[[Any], object]  # is called with a new value, and may refuse it


class Parameters:
    """The parameters of a node, by name; always valid."""

    def __init__(self, node: Node, table: str) -> None:
        """Declare those of a node in the table; InputError: it was started with an invalid one."""
        self._node, self._specs = node, declared()[table]
        self._values: dict[str, Any] = {}
        self._hooks: dict[str, Hook] = {}
        self._changed: Callable[[Collection[str]], None] | None = None
        for spec in self._specs.values():
            try:
                value = node.declare_parameter(spec.name, spec.default, spec.descriptor()).value
            except ParameterException as error:
                raise InputError(f'{spec.name}: {error}') from None
            self._values[spec.name] = spec.checked(value)
        check_overrides(node._parameter_overrides, self._specs, node.get_name(), given)
        for passed_over in check_files(given, node.get_fully_qualified_name()):
            node.get_logger().warning(passed_over)
        node.add_on_set_parameters_callback(self._set)

    def __getitem__(self, name: str) -> Any:
        """Return the value."""
        return self._values[name]

    def fill[T](self, kind: type[T], prefix: str = '', **others: Any) -> T:
        """Return a dataclass; fields named as a parameter without `prefix` have its value."""
        names = [f.name for f in fields(cast(Any, kind)) if prefix + f.name in self._specs]
        return kind(**{name: self[prefix + name] for name in names} | others)

    def watch(self, hooks: Mapping[str, Hook], changed: Callable[[Collection[str]], None]) -> None:
        """
        Set callbacks for changes at run time.

        Parameters
        ----------
        hooks : dict
            Name -> called with the new value; a TendonRobotError refuses it with its text, and
            what was to be set together with it.
        changed : callable
            Called with the names after any accepted change.

        """
        self._hooks, self._changed = dict(hooks), changed

    def put_back(self, name: str, value: Any) -> None:
        """Restore an earlier value of a parameter without calling any hook."""
        hooks, changed = self._hooks, self._changed
        self._hooks, self._changed = {}, None
        self._node.set_parameters([Parameter(name, value=value)])
        self._hooks, self._changed = hooks, changed

    def _set(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        known = [one for one in parameters if one.name in self._specs]
        try:
            accepted = {one.name: self._specs[one.name].checked(one.value) for one in known}
            for name, value in accepted.items():
                if name in self._hooks:
                    self._hooks[name](value)
        except TendonRobotError as error:
            return SetParametersResult(successful=False, reason=' '.join(str(error).split()))
        self._values.update(accepted)
        if self._changed is not None:
            self._changed(accepted)
        return SetParametersResult(successful=True)


class ParameterNode(Runnable):
    """A node as `run` expects it, with the parameters that the table lists under its name."""

    def __init__(self, name: str) -> None:
        """Create the node; InputError: it was started with an invalid parameter."""
        super().__init__(name)
        self.parameters = Parameters(self, name)


def base_frame(parameters: Parameters | Mapping[str, Any], robot: str) -> str:
    """Return the frame of the base of a robot of this name."""
    return str(parameters['frame_prefix'] + (parameters['base_frame'] or f'{robot}_base'))


ALL = '/**'
# declared by every node
OF_ROS = 'use_sim_time', 'start_type_description_service', 'qos_overrides.'


def check_overrides(
    overrides: Collection[str], known: Collection[str], node: str, arguments: Sequence[str] = ()
) -> None:
    """
    Refuse parameters that a node does not declare.

    Parameters
    ----------
    overrides : collection of str
        Names that the node was started with.
    known : collection of str
        Names that the node declares.
    node : str
        Name of the node, for the message.
    arguments : sequence of str
        ROS arguments: the section for all nodes in a file may have parameters of another node of
        this package.

    """
    for_all = {name for _, sections in _files(arguments) for name in sections.get(ALL, ())}
    of_others = for_all & set().union(*declared().values())
    for name in sorted({*overrides} - {*known} - of_others):
        if not name.startswith(OF_ROS):
            raise InputError(
                f'parameter {name}: {node} has none of that name; {suggestion(name, known)}known: '
                f'{", ".join(sorted(known))}'
            )


def check_files(arguments: Sequence[str], node: str) -> Iterator[str]:
    """
    Find files of parameters that have none for a node.

    Parameters
    ----------
    arguments : sequence of str
        ROS arguments.
    node : str
        Name of the node, with its namespace.

    Yields
    ------
    str
        Warning about a file for other nodes of this package: a launch file may give one file
        to several nodes.

    Raises
    ------
    InputError
        A file is for no node of this package.

    """
    for file, keys in _files(arguments):
        # whether one matches this node, by the rules of rcl
        escaped = [re.escape(key) for key in keys]
        patterns = [e.replace(r'/\*\*', '(/.+)?').replace(r'\*', '[^/]+') for e in escaped]
        if not keys or any(re.fullmatch(pattern, node) for pattern in patterns):
            continue
        problem = f'{file}: its parameters are for {", ".join(keys)}, not for {node}'
        names = [key.rpartition('/')[2] for key in keys]
        if node.rpartition('/')[2] in names or not any(name in declared() for name in names):
            raise InputError(f'{problem}; write {node}: or /**: as the first line')
        yield f'{problem}, which takes none of them'


def _files(arguments: Sequence[str]) -> Iterator[tuple[str, dict[str, dict[str, Any]]]]:
    """Yield path and sections of the files of parameters among ROS arguments."""
    for flag, file in pairwise(arguments):
        if flag == '--params-file':
            with contextlib.suppress(OSError, ValueError):  # rclpy has reported it
                yield file, _sections(parse_yaml(Path(file).read_text(encoding='utf-8')))


def _sections(content: Any, before: str = '') -> dict[str, dict[str, Any]]:
    """Return node -> parameters; a node is `/namespace/node`, which may have wildcards."""
    sections: dict[str, dict[str, Any]] = {}
    for key, inside in content.items() if isinstance(content, dict) else ():
        if key == 'ros__parameters':
            sections[before or ALL] = inside if isinstance(inside, dict) else {}
        else:
            sections |= _sections(inside, f'{before}/{str(key).strip("/")}')
    return sections


def read_config(text: str) -> dict[str, Any]:
    """Read the parameter config: a path, a name of a file in config/, or YAML text; '': empty."""
    if (path := named_file(text)) is not None:

        def refuse(reason: str) -> InputError:
            return InputError(f'config: {path}: {reason}; expected a YAML file or text')

        text = read_text(path, refuse, DESCRIPTION_MAX + 1)
    if len(text) > DESCRIPTION_MAX:
        raise InputError(
            f'config: expected at most {DESCRIPTION_MAX:,} characters, got more than that'
        )
    return dict(parsed(text, 'config', dict, 'keys with values'))


def parsed(text: str, what: str, kind: type, expected: str = '') -> Any:
    """Parse YAML text as a list or dict, empty for no text; InputError: it is something else."""
    value = parse_yaml(text, lambda reason: InputError(f'{what}: not valid YAML: {reason}'))
    if value is None:
        return kind()
    if not isinstance(value, kind):
        description = expected or f'a YAML {kind.__name__}'
        raise InputError(f'{what}: expected {description}, got {value!r}')
    return value


class RemoteParameter:
    """A parameter of another node, a text or a list of texts; the node may start and end."""

    def __init__(self, node: Node, other: str, name: str) -> None:
        """Create the clients."""
        self._name, self._other = name, other
        self._answer: Callable[[bool, str], object] | None = None  # to a `put` that is pending
        self._get = Request(node, GetParameters, f'{other}/get_parameters')
        self._set = Request(node, SetParametersAtomically, f'{other}/set_parameters_atomically')

    def ask(self, answer: Callable[[Any], object]) -> None:
        """Request the value; to be called periodically: it repeats overdue requests."""

        def done(response: GetParameters.Response) -> None:
            value = parameter_value_to_python(response.values[0]) if response.values else None
            if value is not None:
                answer(value)

        if not self._get.waiting:
            self._get.ask(GetParameters.Request(names=[self._name]), done)
        for request in (self._get, self._set):
            request.repeat()

    def put(self, value: str, answer: Callable[[bool, str], object]) -> None:
        """Set the value; `answer` gets, in any case, whether it was accepted, and why not."""
        self._answered(False, 'another value took its place')
        self._answer = answer
        message = Parameter(self._name, value=value).to_parameter_msg()
        request = SetParametersAtomically.Request(parameters=[message])
        if not self._set.ask(
            request, lambda given: self._answered(given.result.successful, given.result.reason)
        ):
            self._answered(False, f'{self._other} does not answer: is it running?')

    def _answered(self, accepted: bool, reason: str) -> None:
        answer, self._answer = self._answer, None
        if answer is not None:
            answer(accepted, reason)


def watch_robot(node: Node, controller: str, take: Callable[[Robot], object]) -> None:
    """Have a function called every second with the robot of a controller, while that runs."""
    remote = RemoteParameter(node, controller, 'model')

    def receive(text: str) -> None:
        try:
            robot = load_robot(text)
        except (TendonRobotError, OSError) as error:  # a file that is being written, for one
            node.get_logger().warning(f'the model of the controller: {error}', once=True)
        else:
            take(robot)

    repeat(node, STATUS_PERIOD_S, lambda: remote.ask(receive))
