"""The pages on ROS name every topic, service, parameter and status code, with its unit."""

import ast
import re
from importlib import import_module

import pytest
import yaml
from source_tree import ROOT

pytest.importorskip('rclpy')

from trajectory_msgs.msg import JointTrajectoryPoint

TYPED = (ROOT / 'docs' / 'ros_interface.md').read_text(encoding='utf-8')
DOC = (ROOT / 'docs' / 'ros_nodes.md').read_text(encoding='utf-8')


def section(node):
    return DOC.split(f'\n## {node}\n')[1].split('\n## ')[0]


@pytest.mark.parametrize('node', ['controller', 'driver'])
def test_every_topic_and_service_is_documented(node):
    files = [f'{node}/node.py', 'shared/lifecycle.py', 'shared/inbox.py']
    files += [f'{node}/topics.py' if node == 'controller' else f'{node}/backend.py']
    source = '\n'.join((ROOT / 'tendon_robot_ros' / 'ros' / name).read_text() for name in files)
    made = r"(?:create_(?:publisher|subscription|service)|subscribe)\(\s*\w+,\s*'([^']+)'"
    made += r"|passing_(?:publisher|subscription)\(\s*\w+,\s*\w+,\s*'([^']+)'"
    made += r"|offer_trigger\(\w+, '([^']+)'"
    made += r"|Inbox\(\S+, \w+, '([^']+)'"
    names = {name for pair in re.findall(made, source) for name in pair if name}
    assert len(names) >= 8
    assert [name for name in names if f'`{name}`' not in section(node)] == []


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
        node, _, name = topic.rpartition('/')
        row = f'| `~/{name}` | {package}/{kind} |' if node else f'| `{name}` | {package}/{kind} |'
        assert row in section(node or 'driver')
        if hasattr(message, 'twist') or hasattr(message, 'pose') or hasattr(message, 'point'):
            assert message.header.frame_id == 'kato_10_1_base'
