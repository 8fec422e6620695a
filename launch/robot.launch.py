"""
Controller and driver of one robot.

ros2 launch tendon_robot_ros robot.launch.py robot:=kato_10_1
ros2 launch tendon_robot_ros robot.launch.py robot:=/path/to/mine.yaml namespace:=left_arm
ros2 launch tendon_robot_ros robot.launch.py params_file:=/path/to/my_parameters.yaml

When one of the two ends, so does the other: the driver without a controller releases the arm and
holds it for nobody. With respawn:=true a controller that died is started again.
"""

import os
from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

NEITHER = 'default, without a params_file'
ARGUMENTS = {
    'robot': ('', f'a path, or the name of a robot in config/robots; {NEITHER}: kato_10_1'),
    'backend': ('', f'mock, dynamixel, serial or ros2_control; {NEITHER}: mock'),
    'config': (
        '',
        f'of the backend: a path, or the name of a file in config; {NEITHER}, for the mock: mock',
    ),
    'command_mode': ('', f'tension or pull; {NEITHER}: tension'),
    'params_file': ('', 'parameters of both nodes; the arguments above count more'),
    'namespace': ('', 'put before the names of topics and nodes'),
    'log_level': ('info', 'debug, info, warn, error or fatal'),
    'respawn': (
        'false',
        'true: a controller that died starts again; never the driver, whose start moves motors',
    ),
    'sigterm_timeout': (
        '60',
        '[s] after which a driver that still releases is ended: longer than the longest release',
    ),
}
CHOICES = {'respawn': ['false', 'true']}
RESPAWN_DELAY = 2.0  # [s] as between two attempts of a node to start, else it would fill the log
# launch ends at once when it is told to with SIGTERM or killed; a node that knows its parent then
# releases the arm and ends, too
PARENT = {'TENDON_ROBOT_ROS_PARENT': str(os.getpid())}


def node(name, parameters, files, **more):
    given = {
        key: ParameterValue(value, value_type=str) for key, value in parameters.items() if value
    }
    defaults = PathJoinSubstitution(
        [FindPackageShare('tendon_robot_ros'), 'config', f'{name}.yaml']
    )
    return Node(
        package='tendon_robot_ros',
        executable=name,
        name=name,
        namespace=LaunchConfiguration('namespace'),
        parameters=[defaults, *files, *([given] if given else [])],
        ros_arguments=['--log-level', LaunchConfiguration('log_level')],
        output='screen',
        sigterm_timeout=LaunchConfiguration('sigterm_timeout'),
        **more,
    )


def nodes(context):
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    files = [given['params_file']] if given['params_file'] else []
    if files and not Path(files[0]).is_file():
        raise RuntimeError(f'params_file: {files[0]}: no such file')
    if not files:
        given['robot'] = given['robot'] or 'kato_10_1'
        if given['backend'] in ('', 'mock'):
            given['config'] = given['config'] or 'mock'
    debugged = 'launch-prefix' in context.launch_configurations  # then launch is no parent
    family = {} if debugged else {'additional_env': PARENT}
    driver = {key: given[key] for key in ('robot', 'backend', 'config', 'command_mode')}
    controller = {'model': given['robot'], 'command_mode': given['command_mode']}
    watched = {'on_exit': [Shutdown(reason='the controller ended')]}
    if given['respawn'] == 'true':
        watched = {'respawn': True, 'respawn_delay': RESPAWN_DELAY}
    return [
        node('driver', driver, files, on_exit=[Shutdown(reason='the driver ended')], **family),
        node('controller', controller, files, **watched, **family),
    ]


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument(
            name, default_value=default, description=description, choices=CHOICES.get(name)
        )
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=nodes)])
