"""
Jog the running robot with a gamepad or a SpaceMouse; `ros2 run tendon_robot_ros stop` stops it.

ros2 launch tendon_robot_ros joystick.launch.py
ros2 launch tendon_robot_ros joystick.launch.py device:=spacemouse frame:=my_arm_tip
"""

from launch.actions import DeclareLaunchArgument, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import EqualsSubstitution, LaunchConfiguration, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

ARGUMENTS = {
    'device': ('gamepad', 'gamepad or spacemouse'),
    'frame': ('kato_10_1_base', 'axes: ROBOT_base or ROBOT_tip'),
    'controller': ('controller', 'name of the controller node'),
    'namespace': ('', 'of the robot'),
}
REASON = 'a stick without its reader, or the reader without a stick, is of no use'
CHOICES = {'device': ['gamepad', 'spacemouse']}


def generate_launch_description():
    arguments = [
        DeclareLaunchArgument(
            name, default_value=default, description=description, choices=CHOICES.get(name)
        )
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, *nodes()])


def nodes():
    device = LaunchConfiguration('device')
    space = LaunchConfiguration('namespace')
    spacemouse = EqualsSubstitution(device, 'spacemouse')
    gamepad = EqualsSubstitution(device, 'gamepad')
    config = [FindPackageShare('tendon_robot_ros'), '/config/teleop_', device, '.yaml']
    frame = ParameterValue(LaunchConfiguration('frame'), value_type=str)
    topic = PythonExpression(["'spacenav/joy' if '", device, "' == 'spacemouse' else 'joy'"])
    return [
        Node(
            package='joy',
            executable='joy_node',
            namespace=space,
            parameters=[{'autorepeat_rate': 50.0}],
            condition=IfCondition(gamepad),
            on_exit=[Shutdown(reason=REASON)],
        ),
        Node(
            package='spacenav',
            executable='spacenav_node',
            namespace=space,
            condition=IfCondition(spacemouse),
            on_exit=[Shutdown(reason=REASON)],
        ),
        Node(
            package='teleop_twist_joy',
            executable='teleop_node',
            namespace=space,
            parameters=[config, {'frame': frame}],
            remappings=[
                ('joy', topic),
                ('cmd_vel', [LaunchConfiguration('controller'), '/delta_twist']),
            ],
            on_exit=[Shutdown(reason=REASON)],
        ),
    ]
