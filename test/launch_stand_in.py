"""
A small stand-in for launch and launch_ros, with what Jazzy's first release had (3.4.0, 0.26.0).

It calls a launch file's `generate_launch_description`, resolves the substitutions, and gives the
processes that launch would start, in order, with their command lines. What it does not know, it
refuses, as that release would: a nested list in PathJoinSubstitution, an argument of Node that
came later, a value that is no choice.
"""

import contextlib
import importlib.util
import math
import os
import sys
import types
from dataclasses import dataclass, field
from pathlib import Path

import yaml

STARTED = (  # what ExecuteLocal takes, as far as launch files of this package may use it
    'additional_env', 'condition', 'emulate_tty', 'on_exit', 'output', 'respawn', 'respawn_delay',
    'respawn_max_retries', 'sigkill_timeout', 'sigterm_timeout',
)  # fmt: skip


class Substitution:
    def perform(self, context):
        raise NotImplementedError


def parts(value):
    """Normalize text, a substitution or a flat list of them, as launch does."""
    given = [value] if isinstance(value, str | Substitution) else list(value)
    for one in given:
        if not isinstance(one, str | Substitution):
            raise TypeError(f'expected str or Substitution, got {type(one)}')
    return given


def text(context, value):
    """Perform what was normalized, to one text."""
    return ''.join(one if isinstance(one, str) else one.perform(context) for one in parts(value))


@dataclass
class Context:
    """The configurations that are set, and where the packages' shares are."""

    launch_configurations: dict[str, str]
    shares: dict[str, Path]
    folder: Path
    started: list['Process'] = field(default_factory=list)


class LaunchConfiguration(Substitution):
    def __init__(self, name, *, default=None):
        self._name, self._default = name, default

    def perform(self, context):
        known = context.launch_configurations
        if self._name not in known and self._default is None:
            raise LookupError(f"launch configuration '{self._name}' does not exist")
        return known[self._name] if self._name in known else text(context, self._default)


class PathJoinSubstitution(Substitution):
    def __init__(self, substitutions):
        self._parts = parts(substitutions)

    def perform(self, context):
        return os.path.join(*(text(context, one) for one in self._parts))


class EqualsSubstitution(Substitution):
    def __init__(self, left, right):
        self._sides = parts(left), parts(right)

    def perform(self, context):
        left, right = (text(context, side) for side in self._sides)
        return str(left == right).lower()


class PythonExpression(Substitution):
    def __init__(self, expression):
        self._expression = parts(expression)

    def perform(self, context):
        return str(eval(text(context, self._expression), {}, vars(math)))


class FindPackageShare(Substitution):
    def __init__(self, package):
        self._package = parts(package)

    def perform(self, context):
        return str(context.shares[text(context, self._package)])


class IfCondition:
    def __init__(self, predicate_expression):
        self._parts = parts(predicate_expression)

    def holds(self, context):
        return {'true': True, '1': True, 'false': False, '0': False}[
            text(context, self._parts).strip().lower()
        ]


class ParameterValue:
    def __init__(self, value, *, value_type=None):
        self._value, self._type = parts(value), value_type

    def evaluate(self, context):
        said = text(context, self._value)
        return said if self._type is str else yaml.safe_load(said)


class DeclareLaunchArgument:
    def __init__(self, name, *, default_value=None, description=None, choices=None):
        if choices is not None and default_value not in choices:
            raise RuntimeError(f'default {default_value} of {name} is not one of {choices}')
        self.name, self.default, self.description = name, default_value, description
        self._choices = choices

    def visit(self, context):
        value = context.launch_configurations.setdefault(self.name, self.default)
        if value is None:
            raise RuntimeError(f'required launch argument {self.name} was not provided')
        if self._choices is not None and value not in self._choices:
            raise RuntimeError(f'{self.name}: {value} is not one of {self._choices}')
        return []


class OpaqueFunction:
    def __init__(self, *, function, args=(), kwargs=None):
        self._call = lambda context: function(context, *args, **(kwargs or {}))

    def visit(self, context):
        return self._call(context) or []


class Shutdown:
    def __init__(self, *, reason='reason not given'):
        self.reason = reason


class LaunchDescription:
    def __init__(self, entities):
        self.entities = list(entities)

    def visit(self, context):
        return self.entities


@dataclass
class Process:
    """What launch would start: package, executable, arguments, and what else was said."""

    package: str
    executable: str
    arguments: list[str]
    settings: dict

    @property
    def ends_all(self):
        """Whether everything ends when this process does."""
        actions = self.settings.get('on_exit') or []
        return any(isinstance(action, Shutdown) for action in actions)

    def parameters(self, node):
        """Return them as rcl weighs them: the full name before a wildcard, then the later."""
        after = zip(self.arguments, self.arguments[1:], strict=False)
        files = [yaml.safe_load(Path(path).read_text()) for flag, path in after
                 if flag == '--params-file']  # fmt: skip
        found = {}
        for key in ('/**', node):
            for content in files:
                found.update((content.get(key) or {}).get('ros__parameters') or {})
        return found


class Node:
    def __init__(self, *, executable, package, name=None, namespace=None, parameters=(),
                 remappings=(), ros_arguments=(), arguments=(), **settings):  # fmt: skip
        if unknown := set(settings) - set(STARTED):
            raise TypeError(f'Node knows no {unknown}')
        self._process = package, executable, settings
        self._name, self._namespace = name, namespace
        self._parameters, self._remappings = parameters, remappings
        self._said = arguments, ros_arguments

    def visit(self, context):
        package, executable, settings = self._process
        condition = settings.get('condition')
        if condition is None or condition.holds(context):
            told = {key: value for key, value in settings.items() if key != 'condition'}
            for key in ('sigterm_timeout', 'sigkill_timeout'):
                if key in told:
                    told[key] = text(context, told[key])
            context.started.append(Process(package, executable, self._arguments(context), told))
        return []

    def _arguments(self, context):
        arguments, ros_arguments = self._said
        said = [text(context, one) for one in arguments]
        if ros_arguments:
            said += ['--ros-args', *(text(context, one) for one in ros_arguments)]
        said.append('--ros-args')
        if self._name is not None:
            said += ['-r', f'__node:={text(context, self._name)}']
        space = None
        if self._namespace is not None:
            space = '/' + text(context, self._namespace).strip('/')
            said += ['-r', f'__ns:={space}']
        for one in self._parameters:
            said += ['--params-file', self._file(context, one, space)]
        for before, after in self._remappings:
            said += ['-r', f'{text(context, before)}:={text(context, after)}']
        return said

    def _file(self, context, one, space):
        """Return the path of a parameter file; write one for what is given as a mapping."""
        if not isinstance(one, dict):
            path = text(context, one)
            assert Path(path).is_file(), f'launch would only warn: {path}'
            return path
        full = self._name is not None and space is not None
        node = f'{space.rstrip("/")}/{text(context, self._name)}' if full else '/**'
        given = {text(context, key): evaluated(context, value) for key, value in one.items()}
        path = context.folder / f'launch_params_{len(list(context.folder.iterdir()))}.yaml'
        path.write_text(yaml.dump({node: {'ros__parameters': given}}))
        return str(path)


def evaluated(context, value):
    """Return the value of a parameter; a plain substitution is read as YAML."""
    if isinstance(value, ParameterValue):
        return value.evaluate(context)
    if isinstance(value, Substitution):
        return yaml.safe_load(text(context, value) or "''")
    return value


WORLD = {
    'launch': [LaunchDescription],
    'launch.actions': [DeclareLaunchArgument, OpaqueFunction, Shutdown],
    'launch.conditions': [IfCondition],
    'launch.substitutions': [
        EqualsSubstitution, LaunchConfiguration, PathJoinSubstitution, PythonExpression,
    ],
    'launch_ros': [],
    'launch_ros.actions': [Node],
    'launch_ros.parameter_descriptions': [ParameterValue],
    'launch_ros.substitutions': [FindPackageShare],
}  # fmt: skip


@contextlib.contextmanager
def in_place():
    """Let `import launch` and `import launch_ros` find the stand-in."""
    before = {name: sys.modules.pop(name, None) for name in WORLD}
    for name, classes in WORLD.items():
        sys.modules[name] = types.ModuleType(name)
        vars(sys.modules[name]).update({one.__name__: one for one in classes})
    try:
        yield
    finally:
        for name, module in before.items():
            sys.modules.pop(name)
            if module is not None:
                sys.modules[name] = module


def load(path):
    """Return the module of a launch file."""
    spec = importlib.util.spec_from_file_location('launched', path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def launch(path, folder, shares, **arguments):
    """Return the processes that `ros2 launch PATH NAME:=VALUE...` would start."""
    with in_place():
        description = load(path).generate_launch_description()
        context = Context(dict(arguments), shares, folder)
        waiting = [description]
        while waiting:
            waiting = [*waiting.pop(0).visit(context), *waiting]
    return context.started
