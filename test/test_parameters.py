"""Parameters of a node, as started and as set at run time; settings that nobody uses."""

import os
import sys

import pytest

pytest.importorskip('rclpy')
os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from tendon_robot_ros.common.errors import InputError
from tendon_robot_ros.control.target_search import APPROACHES
from tendon_robot_ros.data.dataset import LOADINGS
from tendon_robot_ros.drivers.interface import BACKENDS
from tendon_robot_ros.drivers.safety import STOP_TIME_MIN_S
from tendon_robot_ros.monitoring.watch import ALARM_POSTURES
from tendon_robot_ros.ros.shared.parameters import (
    Parameters,
    check_files,
    check_overrides,
    declared,
)


def test_the_table_agrees_with_what_the_nodes_do():
    driver, controller, monitor = (declared()[n] for n in ('driver', 'controller', 'monitor'))
    assert list(driver['backend'].choices) == list(BACKENDS)
    assert driver['stop_time'].low == STOP_TIME_MIN_S
    assert list(controller['approach'].choices) == list(APPROACHES)
    assert sorted(monitor['path'].choices) == sorted(LOADINGS)
    assert monitor['alarm_postures'].default == ALARM_POSTURES


def whole(spec):
    """Return an integer within the range of a parameter, None where there is none."""
    return next((n for n in range(1, 101) if spec.low <= n <= spec.high), None)


@pytest.mark.ros
@pytest.mark.parametrize('source', ['command line', 'file', 'set'])
@pytest.mark.parametrize('name', ['controller', 'driver', 'monitor'])
def test_integers_are_taken_for_every_double(name, source, tmp_path):
    specs = declared()[name].values()
    doubles = [spec for spec in specs if isinstance(spec.default, float)]
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
        parameters = Parameters(node, name)
        if source == 'set':
            fixed = {s.name for s in specs if s.read_only}
            given = {key: n for key, n in given.items() if key not in fixed}
            results = node.set_parameters([Parameter(key, value=n) for key, n in given.items()])
            assert [one.reason for one in results if not one.successful] == []
        for key, n in given.items():
            assert isinstance(parameters[key], float)
            assert parameters[key] == n
        node.destroy_node()
    finally:
        context.shutdown()


KNOWN = ('command_mode', 'command_timeout', 'rate', 'robot')


@pytest.mark.parametrize(
    ('name', 'said'),
    [
        ('commnd_mode', r'parameter commnd_mode: driver has none of that name; did you mean '),
        ('comand_timeout', 'did you mean command_timeout'),
        ('zzz', r'none of that name; known: command_mode, command_timeout, rate, robot'),
    ],
)
def test_a_name_that_no_parameter_has_is_refused(name, said):
    with pytest.raises(InputError, match=said):
        check_overrides(['rate', name], KNOWN, 'driver')


def test_names_of_parameters_and_of_ros_are_taken():
    check_overrides([*KNOWN, 'use_sim_time', 'qos_overrides./a.publisher.depth'], KNOWN, 'driver')


TAKEN, WARNED, REFUSED = None, ', which takes none of them', '; write {node}: or /**: as the'
FILES = {
    'driver: {ros__parameters: {rate: 50.0}}': ('/driver', TAKEN),
    '/**: {ros__parameters: {rate: 50.0}}': ('/a/b/driver', TAKEN),
    '/**/driver: {ros__parameters: {rate: 50.0}}': ('/driver', TAKEN),
    '/*/driver: {ros__parameters: {rate: 50.0}}': ('/left/driver', TAKEN),
    'left: {driver: {ros__parameters: {rate: 50.0}}}': ('/left/driver', TAKEN),
    '/left/driver: {ros__parameters: {rate: 50.0}}': ('/left/driver', TAKEN),
    # one file for all nodes of a launch
    '{driver: {ros__parameters: {rate: 50.0}}, controller: {ros__parameters: {rate: 50.0}}}': (
        '/driver',
        TAKEN,
    ),
    'controller: {ros__parameters: {rate: 50.0}}': ('/driver', WARNED),
    'robot_model: {ros__parameters: {rate: 50.0}}': ('/left/driver', WARNED),
    'tendon_driver: {ros__parameters: {rate: 50.0}}': ('/driver', REFUSED),
    'driver:  {ros__parameters: {rate: 50.0}}': ('/left/driver', REFUSED),
    '/right/driver: {ros__parameters: {rate: 50.0}}': ('/left/driver', REFUSED),
}


@pytest.mark.parametrize('content', FILES)
def test_a_file_for_other_nodes_is_named_or_refused(content, tmp_path):
    node, said = FILES[content]
    file = tmp_path / 'parameters.yaml'
    file.write_text(content, encoding='utf-8')
    arguments = ['--ros-args', '--params-file', str(file)]
    if said is REFUSED:
        with pytest.raises(InputError, match=r'parameters.yaml: its parameters are for') as caught:
            list(check_files(arguments, node))
        told = [str(caught.value)]
    else:
        told = list(check_files(arguments, node))
    assert len(told) == (said is not TAKEN)
    for line in told:
        assert content.partition(':')[0].strip('/') in line
        assert f', not for {node}{said.format(node=node)}' in line


@pytest.mark.parametrize(('name', 'taken'), [('tip_gain', True), ('tip_gian', False)])
def test_a_section_for_all_nodes_may_name_parameters_of_another(name, taken, tmp_path):
    file = tmp_path / 'parameters.yaml'
    file.write_text(f'/**: {{ros__parameters: {{{name}: 0.5}}}}', encoding='utf-8')
    arguments = ['--ros-args', '--params-file', str(file)]
    if taken:
        check_overrides([name], KNOWN, 'driver', arguments)
        with pytest.raises(InputError, match='tip_gain: driver has none'):
            check_overrides([name], KNOWN, 'driver', ['--ros-args', '-p', 'tip_gain:=0.5'])
    else:
        with pytest.raises(InputError, match='tip_gian: driver has none'):
            check_overrides([name], KNOWN, 'driver', arguments)
