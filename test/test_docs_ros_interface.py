"""What is declared of topics and services is what nodes create; the page names every status."""

import ast
import re
from importlib import import_module

import pytest
import yaml
from source_tree import ROOT

pytest.importorskip('rclpy')

from trajectory_msgs.msg import JointTrajectoryPoint

from tendon_robot_ros.ros.shared.interface import declared

TYPED = (ROOT / 'docs' / 'ros_interface.md').read_text(encoding='utf-8')
DOC = (ROOT / 'docs' / 'ros_nodes.md').read_text(encoding='utf-8')


def section(node):
    return DOC.split(f'\n## {node}\n')[1].split('\n## ')[0]


def sources_of(node):
    """Return the source of a node, and of what all nodes share."""
    folder, name = ROOT / 'tendon_robot_ros' / 'ros', node.replace('-', '_')
    own = [folder / 'commands' / f'{name}.py', *(folder / name).glob('*.py')]
    paths = [path for path in own if path.exists()]
    assert paths, node
    return ''.join(path.read_text() for path in [*paths, *(folder / 'shared').glob('*.py')])


def test_every_declared_topic_is_created_by_the_nodes_that_it_names():
    for name, topic in declared()['topics'].items():
        for node in {*topic.get('from', ()), *topic.get('to', ())} - {'tracker'}:
            assert f"'{name}'" in sources_of(node), (name, node)


def test_every_declared_service_and_action_is_offered():
    for name in [*declared()['services'], *declared()['actions']]:
        node, _, own = name.partition('/')
        offered = sources_of(node)
        assert name in declared()['actions'] or re.search(rf"'(~/)?{own}'", offered), name


def test_nodes_create_topics_and_services_as_they_are_declared():
    """What is created by another name is a topic whose name a user gives."""
    nodes = '\n'.join(p.read_text() for p in (ROOT / 'tendon_robot_ros/ros').glob('*/*.py'))
    assert re.findall(r"create_(?:publisher|subscription)\(\s*\w+,\s*f?'([^']+)'", nodes) == []
    services = re.findall(r"(?:offer_trigger\(\w+|Service\(self), '~/(\w+)'", nodes)
    assert len(services) >= 5
    known = {name.partition('/')[2] for name in declared()['services']}
    assert {*services} <= known


def test_every_status_code_is_documented():
    sources = [
        path.read_text()
        for folder in ('control', 'ros')
        for path in (ROOT / 'tendon_robot_ros' / folder).glob('**/*.py')
    ]
    text = '\n'.join(sources)
    codes = set(re.findall(r"Refusal\(\s*'(\w+)'", text))
    codes |= set(re.findall(r"ControllerStatus\((?:OK|WARN|ERROR), '(\w+)'", text))
    codes |= set(re.findall(r"status\.publish\(\s*[^,]+, '(\w+)'", text))
    assert len(codes) > 15
    assert [code for code in codes - {'mock_fault', 'reset'} if f'`{code}`' not in DOC] == []


def told_in(path, function):
    """List the keys that a function gives a status, in dicts or by assignment."""
    tree = ast.parse((ROOT / 'tendon_robot_ros' / path).read_text())
    bodies = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and node.name == function
    ]
    for node in (node for body in bodies for node in ast.walk(body)):
        keys = node.keys if isinstance(node, ast.Dict) else []
        if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store):
            keys = [node.slice]
        yield from filter(None, map(written, keys))


def written(key):
    """Return a key as it is written, names in f-strings in capitals; None: it is computed."""
    if isinstance(key, ast.JoinedStr):
        return ''.join(
            part.value if isinstance(part, ast.Constant) else part.value.id.upper()
            for part in key.values
        )
    return key.value if isinstance(key, ast.Constant) else None


@pytest.mark.parametrize(
    ('node', 'path', 'function', 'count'),
    [
        ('controller', 'control/status.py', 'controller_values', 8),
        ('controller', 'control/modes.py', 'values', 2),
        ('controller', 'control/tip_loop.py', 'values', 3),
        ('controller', 'ros/controller/node.py', '_publish_status', 4),
        ('driver', 'ros/driver/node.py', '_publish_status', 9),
        ('monitor', 'ros/monitor/node.py', '_values', 8),
        ('monitor', 'ros/monitor/watching.py', 'values', 7),
    ],
)
def test_every_value_of_a_status_is_documented(node, path, function, count):
    told = set(told_in(path, function))
    assert len(told) >= count
    assert [key for key in told if f'`{key}`' not in section(node)] == []


def fill(message, content):
    """Put YAML into a message as `ros2 topic pub` does: only what its type has."""
    for name, value in content.items():
        field = getattr(message, name)
        if isinstance(value, dict):
            fill(field, value)
        elif name == 'points':
            setattr(message, name, [fill(JointTrajectoryPoint(), one) for one in value])
        else:
            setattr(message, name, value)
    return message


def test_what_a_person_types_is_a_message_of_that_topic():
    typed = re.findall(
        r'^\$ ros2 topic pub (?:--once|-r \d+) (\S+) (\S+)/msg/(\S+) "(.*)"$', TYPED, re.M
    )
    assert len(typed) == 5
    for topic, package, kind, text in typed:
        message = fill(getattr(import_module(f'{package}.msg'), kind)(), yaml.safe_load(text))
        assert declared()['topics'][topic]['type'] == f'{package}/{kind}'
        if hasattr(message, 'twist') or hasattr(message, 'pose') or hasattr(message, 'point'):
            assert message.header.frame_id == 'kato_10_1_base'
