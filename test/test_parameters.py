"""Parameters of a node, as started and as set at run time."""

import os
import sys

import pytest

pytest.importorskip('rclpy')
os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from tendon_robot_ros.ros.controller import parameters as controller
from tendon_robot_ros.ros.driver import node as driver
from tendon_robot_ros.ros.monitor import node as monitor
from tendon_robot_ros.ros.shared.parameters import Parameters

pytestmark = pytest.mark.ros
NODES = {'controller': controller.SPECS, 'driver': driver.SPECS, 'monitor': monitor.SPECS}


def whole(spec):
    """Return an integer within the range of a parameter, None where there is none."""
    return next((n for n in range(1, 101) if spec.low <= n <= spec.high), None)


@pytest.mark.parametrize('source', ['command line', 'file', 'set'])
@pytest.mark.parametrize('name', NODES)
def test_integers_are_taken_for_every_double(name, source, tmp_path):
    doubles = [spec for spec in NODES[name] if isinstance(spec.default, float)]
    given = {spec.name: whole(spec) for spec in doubles if whole(spec) is not None}
    assert len(given) > 3
    arguments = []
    if source == 'command line':
        arguments = [word for key, n in given.items() for word in ('-p', f'{key}:={n}')]
    elif source == 'file':
        lines = [f'    {key}: {n}\n' for key, n in given.items()]
        (tmp_path / 'given.yaml').write_text('/**:\n  ros__parameters:\n' + ''.join(lines))
        arguments = ['--params-file', str(tmp_path / 'given.yaml')]
    context = Context()
    rclpy.init(args=['node', '--ros-args', *arguments] if arguments else [], context=context)
    try:
        node = Node(name, context=context, start_parameter_services=False)
        parameters = Parameters(node, NODES[name])
        if source == 'set':
            fixed = {s.name for s in NODES[name] if s.read_only}
            given = {key: n for key, n in given.items() if key not in fixed}
            results = node.set_parameters([Parameter(key, value=n) for key, n in given.items()])
            assert [one.reason for one in results if not one.successful] == []
        for key, n in given.items():
            assert isinstance(parameters[key], float)
            assert parameters[key] == n
        node.destroy_node()
    finally:
        context.shutdown()
