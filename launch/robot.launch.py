"""
Controller and driver of one robot.

ros2 launch tendon_robot_ros robot.launch.py robot:=kato_10_1
ros2 launch tendon_robot_ros robot.launch.py robot:=/path/to/mine.yaml namespace:=left_arm
"""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

ARGUMENTS = {
    'robot': ('kato_10_1', 'robot description: a path, or the name of a robot in config/robots'),
    'backend': ('mock', 'mock, dynamixel or serial'),
    'config': ('mock', 'configuration of the backend: a path, or the name of a file in config'),
    'command_mode': ('tension', 'tension or pull'),
    'namespace': ('', 'put before the names of topics and nodes'),
}


def shared(name):
    return PathJoinSubstitution([FindPackageShare('tendon_robot_ros'), 'config', name])


def text(name):
    return ParameterValue(LaunchConfiguration(name), value_type=str)


def node(name, parameters):
    return Node(
        package='tendon_robot_ros',
        executable=name,
        name=name,
        namespace=LaunchConfiguration('namespace'),
        parameters=[shared(f'{name}.yaml'), parameters],
        output='screen',
        sigterm_timeout='10',  # the driver ramps down before it ends
        sigkill_timeout='10',
    )


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    driver = {key: text(key) for key in ('robot', 'backend', 'config', 'command_mode')}
    controller = {'model': text('robot'), 'command_mode': text('command_mode')}
    return LaunchDescription([*arguments, node('driver', driver), node('controller', controller)])
