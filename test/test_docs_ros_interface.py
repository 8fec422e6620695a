"""docs/ros_interface.md names every topic, service, parameter and status code, with its unit."""

import math
import re

import pytest
from source_tree import ROOT

pytest.importorskip('rclpy')

from tendon_robot_ros.nodes import (
    controller_setup,
    driver_setup,
    monitor_setup,
    robot_model,
    teleop,
    viewer,
)

DOC = (ROOT / 'docs' / 'ros_interface.md').read_text(encoding='utf-8')
NODES = {'controller': controller_setup, 'driver': driver_setup, 'teleop': teleop}
NODES |= {'monitor': monitor_setup, 'viewer': viewer, 'robot-model': robot_model}
KINDS = {bool: 'bool', float: 'double', str: 'string', list: 'string[]'}


def section(node):
    return DOC.split(f'\n## {node}\n')[1].split('\n## ')[0]


def row(spec):
    """Write the line of a parameter."""
    default = spec.default
    if isinstance(default, bool):
        default = str(default).lower()
    elif isinstance(default, float):
        default = f'{default:g}'
    elif isinstance(default, list):
        default = '[]'
    limits = f'{spec.low:g} to {spec.high:g}' if math.isfinite(spec.low) else ''
    change = 'fixed' if spec.read_only else 'any time'
    text = spec.text.replace('<', '&lt;')
    known = ', '.join(spec.choices) or limits
    return (
        f'| `{spec.name}` | {KINDS[type(spec.default)]} | {default or repr(default)} | '
        f'{spec.unit} | {known} | {change} | {text} |'
    )


@pytest.mark.parametrize('node', NODES)
def test_every_parameter_is_documented_as_it_is(node):
    missing = [row(spec) for spec in NODES[node].SPECS if row(spec) not in section(node)]
    assert missing == []
    assert section(node).count(' | fixed | ') + section(node).count(' | any time | ') == len(
        NODES[node].SPECS
    )


@pytest.mark.parametrize('node', ['controller', 'driver'])
def test_every_topic_and_service_is_documented(node):
    files = [f'{node}.py', 'status.py']
    files += ['prediction.py'] if node == 'controller' else ['tracker.py']
    source = '\n'.join((ROOT / 'tendon_robot_ros' / 'nodes' / name).read_text() for name in files)
    made = r"(?:create_(?:publisher|subscription|service)|subscribe)\(\s*\w+,\s*'([^']+)'"
    names = set(re.findall(made, source))
    assert len(names) >= 8
    assert [name for name in names if f'`{name}`' not in DOC] == []


def test_every_status_code_is_documented():
    sources = [
        path.read_text()
        for folder in ('control', 'nodes')
        for path in (ROOT / 'tendon_robot_ros' / folder).glob('*.py')
    ]
    text = '\n'.join(sources)
    codes = set(re.findall(r"Refusal\(\s*'(\w+)'", text))
    codes |= set(re.findall(r"return (?:OK|WARN|ERROR), '(\w+)'", text))
    codes |= set(re.findall(r"status\.say\(\s*[^,]+, '(\w+)'", text))
    assert len(codes) > 15
    assert [code for code in codes - {'mock_fault', 'reset'} if f'`{code}`' not in DOC] == []
