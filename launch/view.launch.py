"""
The running robot in RViz: its URDF, its frames, and the saved view.

ros2 launch tendon_robot_ros view.launch.py
ros2 launch tendon_robot_ros view.launch.py fixed_frame:=my_arm_base namespace:=left_arm
"""

from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

ARGUMENTS = {
    'fixed_frame': ('kato_10_1_base', 'frame of the base: ROBOT_base'),
    'controller': ('controller', 'name of the controller node'),
    'namespace': ('', 'of the robot'),
}


def generate_launch_description():
    view = PathJoinSubstitution([FindPackageShare('tendon_robot_ros'), 'config', 'robot.rviz'])
    namespace = LaunchConfiguration('namespace')
    controller = ParameterValue(LaunchConfiguration('controller'), value_type=str)
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            # RViz first: where it is not installed, nothing has been started that would stay
            Node(
                package='rviz2',
                executable='rviz2',
                namespace=namespace,
                arguments=['-d', view, '-f', LaunchConfiguration('fixed_frame')],
                on_exit=[Shutdown(reason='RViz was closed')],
            ),
            Node(
                package='tendon_robot_ros',
                executable='robot-model',
                name='robot_model',
                namespace=namespace,
                parameters=[{'controller': controller}],
                output='screen',
            ),
        ]
    )
