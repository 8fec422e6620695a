"""Imports run one way, ROS stays in nodes/, and what controls motors loads no compiler."""

import ast
import subprocess
import sys

from source_tree import files, parse

PACKAGE = 'tendon_robot_ros'
ROS = {'rclpy', 'rcl_interfaces', 'std_srvs', 'tf2_ros', 'lifecycle_msgs', 'action_msgs'}

# part -> the parts it may import besides itself
ALLOWED = {'__init__': set(), 'exceptions': set()}
ALLOWED['robot'] = ALLOWED['effects'] = {'exceptions'}
ALLOWED['data'] = ALLOWED['drivers'] = {'exceptions', 'robot'}
ALLOWED['model'] = {'exceptions', 'robot', 'effects'}
ALLOWED['control'] = ALLOWED['model'] | {'model', 'drivers'}
ALLOWED['analysis'] = ALLOWED['model'] | {'model', 'data'}
ALLOWED['report'] = ALLOWED['analysis'] | {'analysis'}
ALLOWED['monitoring'] = ALLOWED['report'] | {'report'}
ALLOWED['cli'] = ALLOWED['monitoring'] | {'drivers', 'control'}
ALLOWED['nodes'] = ALLOWED['cli'] | {'monitoring'}
ALLOWED['__main__'] = {'cli'}
MODULES = files(f'{PACKAGE}/*.py')


def part(name):
    """Name the part that a module belongs to: robot_checks.py belongs to robot."""
    return name if name.startswith('__') else name.split('_')[0]


def imported(path):
    """List the absolute names of all modules that a file imports, wherever in it."""
    package = path.with_suffix('').parts[:-1]
    for node in ast.walk(parse(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = list(package[: len(package) - node.level + 1]) if node.level else []
            base += node.module.split('.') if node.module else []
            if base == [PACKAGE]:  # from .. import robot
                yield from ('.'.join([*base, alias.name]) for alias in node.names)
            else:
                yield '.'.join(base)


def test_imports_run_one_way():
    wrong = []
    for path in MODULES:
        own = part(path.with_suffix('').parts[1])
        assert own in ALLOWED, f'{path}: say in ALLOWED what this part may import'
        for name in imported(path):
            top, other = [*name.split('.'), '__init__'][:2]
            if top == PACKAGE and part(other) not in ALLOWED[own] | {own, '__init__'}:
                wrong.append(f'{path} imports {name}')
    assert not wrong, '\n'.join(wrong)


def test_ros_is_imported_in_nodes_only():
    wrong = []
    for path in MODULES:
        tops = {name.split('.')[0] for name in imported(path)}
        if path.parts[1] != 'nodes':
            wrong += [f'{path} imports {n}' for n in tops if n in ROS or n.endswith('_msgs')]
    assert not wrong, '\n'.join(wrong)


def light_modules():
    """List what a process that drives motors imports, and what every command pays for."""
    for path in MODULES:
        light = path.parts[1] in ('drivers', 'data') or len(path.parts) == 2 or path.stem == 'main'
        if light and path.stem not in ('__main__', 'mock'):
            yield '.'.join(path.with_suffix('').parts).removesuffix('.__init__')


def test_drivers_data_and_the_command_line_load_neither_compiler_nor_ros():
    code = (
        'import importlib, sys\n'
        'for name in sys.argv[1:]: importlib.import_module(name)\n'
        'print(sorted({"llvmlite", "numba", "rclpy"} & set(sys.modules)))'
    )
    run = subprocess.run(
        [sys.executable, '-c', code, *light_modules()], capture_output=True, text=True
    )
    assert run.stdout.strip() == '[]', run.stdout + run.stderr
