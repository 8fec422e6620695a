"""
Jog the running robot with a gamepad or a SpaceMouse.

ros2 launch tendon_robot_ros joystick.launch.py
ros2 launch tendon_robot_ros joystick.launch.py device:=spacemouse frame:=my_arm_tip
"""

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import (
    EqualsSubstitution,
    LaunchConfiguration,
    PathJoinSubstitution,
    PythonExpression,
)
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

ARGUMENTS = {
    'device': ('gamepad', 'gamepad or spacemouse'),
    'frame': ('kato_10_1_base', 'axes: ROBOT_base or ROBOT_tip'),
    'controller': ('controller', 'name of the controller node'),
    'namespace': ('', 'of the robot'),
}


def generate_launch_description():
    device = LaunchConfiguration('device')
    space = LaunchConfiguration('namespace')
    spacemouse = EqualsSubstitution(device, 'spacemouse')
    gamepad = EqualsSubstitution(device, 'gamepad')
    told = PathJoinSubstitution(
        [FindPackageShare('tendon_robot_ros'), 'config', ['teleop_', device, '.yaml']]
    )
    heard = PythonExpression(["'spacenav/joy' if '", device, "' == 'spacemouse' else 'joy'"])
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            Node(
                package='joy',
                executable='joy_node',
                namespace=space,
                parameters=[{'autorepeat_rate': 50.0}],
                condition=IfCondition(gamepad),
            ),
            Node(
                package='spacenav',
                executable='spacenav_node',
                namespace=space,
                condition=IfCondition(spacemouse),
            ),
            Node(
                package='teleop_twist_joy',
                executable='teleop_node',
                namespace=space,
                parameters=[told, {'frame': LaunchConfiguration('frame')}],
                remappings=[
                    ('joy', heard),
                    ('cmd_vel', [LaunchConfiguration('controller'), '/delta_twist']),
                ],
            ),
        ]
    )
