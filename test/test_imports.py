"""Imports run one way between folders and files, ROS stays in ros/, motors load no compiler."""

import ast
import sys
from collections import defaultdict
from graphlib import CycleError, TopologicalSorter

import processes
import pytest
from source_tree import files, parse

PACKAGE = 'tendon_robot_ros'
ROS = {'rclpy', 'rcl_interfaces', 'std_srvs', 'tf2_ros', 'lifecycle_msgs', 'action_msgs'}

# folder -> the folders it may import besides itself
ALLOWED = {'common': set()}
ALLOWED['robot'] = ALLOWED['effects'] = {'common'}
ALLOWED['data'] = ALLOWED['drivers'] = {'common', 'robot'}
ALLOWED['emulator'] = ALLOWED['drivers'] | {'drivers'}
ALLOWED['model'] = {'common', 'robot', 'effects'}
ALLOWED['control'] = ALLOWED['model'] | {'model', 'drivers'}
ALLOWED['paths'] = ALLOWED['control'] | {'control'}
ALLOWED['workspace'] = ALLOWED['paths'] | {'paths'}
ALLOWED['inference'] = ALLOWED['model'] | {'model', 'data'}
ALLOWED['comparison'] = ALLOWED['inference'] | {'inference'}
ALLOWED['diagnosis'] = ALLOWED['comparison'] | {'comparison', 'workspace'}
ALLOWED['simulation'] = ALLOWED['diagnosis'] | {'diagnosis'}
ALLOWED['tables'] = ALLOWED['diagnosis'] | {'diagnosis'}
ALLOWED['report'] = ALLOWED['simulation'] | {'simulation', 'paths'}
ALLOWED['monitoring'] = ALLOWED['diagnosis'] | {'diagnosis', 'report'}
ALLOWED['investigation'] = ALLOWED['report'] | {'report', 'monitoring'}
ALLOWED['cli'] = ALLOWED['report'] | ALLOWED['emulator'] | {'report', 'emulator', 'control'}
ALLOWED['cli'] |= {'tables', 'investigation'}
ALLOWED['ros'] = ALLOWED['report'] | {
    'report',
    'control',
    'drivers',
    'monitoring',
    'investigation',
}
# what is asked of many robots; nothing that runs on one imports it
ALLOWED['studies'] = ALLOWED['cli'] | {'cli'}
# the package itself says what a notebook needs, and imports it when it is asked for
ALLOWED['__init__'] = set(ALLOWED) - {'cli', 'ros', 'studies'}
ALLOWED['__main__'] = {'cli'}
MODULES = files(f'{PACKAGE}/*.py')


def name_of(path):
    """Return the dotted name of a module."""
    return '.'.join(path.with_suffix('').parts).removesuffix('.__init__')


NAMES = {name_of(path): path for path in MODULES}


def imported(path):
    """List the absolute names of all modules that a file imports, wherever in it."""
    package = path.with_suffix('').parts[:-1]
    for node in ast.walk(parse(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = list(package[: len(package) - node.level + 1]) if node.level else []
            base += node.module.split('.') if node.module else []
            # from . import messages: a module; from .link import ask: not
            for alias in node.names:
                inner = '.'.join([*base, alias.name])
                yield inner if inner in NAMES else '.'.join(base)


def folder(path):
    """Name the folder of the layout that a module lies in."""
    return path.with_suffix('').parts[1]


def test_imports_between_folders_run_one_way():
    wrong = []
    for path in MODULES:
        own = folder(path)
        assert own in ALLOWED, f'{path}: say in ALLOWED what this folder may import'
        for name in imported(path):
            top, *rest = name.split('.')
            if top == PACKAGE and rest and rest[0] not in ALLOWED[own] | {own}:
                wrong.append(f'{path} imports {name}')
    assert not wrong, '\n'.join(wrong)


def test_what_the_table_allows_has_no_circle():
    list(TopologicalSorter(ALLOWED).static_order())


def test_nothing_that_runs_on_a_robot_imports_the_studies():
    assert [folder for folder, allowed in ALLOWED.items() if 'studies' in allowed] == []


def test_no_files_import_each_other():
    graph = {name: {n for n in imported(path) if n in NAMES} for name, path in NAMES.items()}
    graph[PACKAGE] = set()  # what it offers is imported when it is asked for
    try:
        list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        raise AssertionError(' imports '.join(reversed(error.args[1]))) from None


def test_nodes_know_nothing_of_each_other():
    wrong = []
    for path in files(f'{PACKAGE}/ros/*/*.py'):
        own = path.parts[2]
        for name in imported(path):
            _, *rest = name.split('.')
            if rest[:1] == ['ros'] and rest[1:] and own != 'commands':
                wrong += [] if rest[1] in (own, 'shared') else [f'{path} imports {name}']
    assert not wrong, '\n'.join(wrong)


def test_ros_is_imported_in_its_folder_only():
    wrong = []
    for path in MODULES:
        tops = {name.split('.')[0] for name in imported(path)}
        if folder(path) != 'ros':
            wrong += [f'{path} imports {n}' for n in tops if n in ROS or n.endswith('_msgs')]
    assert not wrong, '\n'.join(wrong)


def test_a_class_name_means_one_thing():
    places = defaultdict(list)
    for path in MODULES:
        for node in parse(path).body:
            if isinstance(node, ast.ClassDef):
                places[node.name].append(str(path))
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


def light_modules():
    """List what a process that drives motors imports, and what every command pays for."""
    for path in MODULES:
        light = folder(path) in ('common', 'data', 'drivers', 'emulator', 'robot')
        light = light or len(path.parts) == 2 or path.stem == 'main'
        if light and path.stem not in ('__main__', 'mock'):
            yield name_of(path)


LIGHT = {  # what is imported, and what must not come with it
    'the package': (['tendon_robot_ros'], 'numpy numba scipy yaml'),
    # who is on this computer is stopped before the middleware is loaded
    'the command stop': (['tendon_robot_ros.ros.commands.stop'], 'rclpy numpy yaml'),
    'drivers, data and the command line': ([*light_modules()], 'llvmlite numba rclpy'),
}


@pytest.mark.parametrize('what', LIGHT)
def test_what_has_to_be_quick_loads_nothing_heavy(what):
    modules, heavy = LIGHT[what]
    code = (
        'import importlib, sys\n'
        'for name in sys.argv[2:]: importlib.import_module(name)\n'
        'print([name for name in sys.argv[1].split() if name in sys.modules])'
    )
    run = processes.run([sys.executable, '-c', code, heavy, *modules])
    assert run.stdout.strip() == '[]', run.stdout + run.stderr
