"""Settings that nobody uses are refused, with the nearest name."""

import pytest

from tendon_robot_ros.common.errors import InputError
from tendon_robot_ros.ros.shared.overrides import check_files, check_overrides

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


FILES = {
    'driver: {ros__parameters: {rate: 50.0}}': ('/driver', True),
    '/**: {ros__parameters: {rate: 50.0}}': ('/a/b/driver', True),
    '/**/driver: {ros__parameters: {rate: 50.0}}': ('/driver', True),
    '/*/driver: {ros__parameters: {rate: 50.0}}': ('/left/driver', True),
    'left: {driver: {ros__parameters: {rate: 50.0}}}': ('/left/driver', True),
    '/left/driver: {ros__parameters: {rate: 50.0}}': ('/left/driver', True),
    'controller: {ros__parameters: {rate: 50.0}}': ('/driver', True),  # one file for a launch
    'tendon_driver: {ros__parameters: {rate: 50.0}}': ('/driver', False),
    'driver:  {ros__parameters: {rate: 50.0}}': ('/left/driver', False),
    '/right/driver: {ros__parameters: {rate: 50.0}}': ('/left/driver', False),
}


@pytest.mark.parametrize('content', FILES)
def test_a_file_for_other_nodes_is_refused(content, tmp_path):
    node, taken = FILES[content]
    file = tmp_path / 'parameters.yaml'
    file.write_text(content, encoding='utf-8')
    arguments = ['--ros-args', '--params-file', str(file)]
    if taken:
        check_files(arguments, node)
    else:
        with pytest.raises(InputError, match=f'parameters.yaml: its parameters .* not for {node}'):
            check_files(arguments, node)


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
