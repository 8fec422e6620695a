"""
The running robot in RViz: its URDF, its frames, and the saved view.

ros2 launch tendon_robot_ros view.launch.py
ros2 launch tendon_robot_ros view.launch.py fixed_frame:=my_arm_base namespace:=left_arm
"""

from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
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
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            Node(
                package='tendon_robot_ros',
                executable='robot-model',
                name='robot_model',
                namespace=namespace,
                parameters=[{'controller': LaunchConfiguration('controller')}],
                output='screen',
            ),
            Node(
                package='rviz2',
                executable='rviz2',
                namespace=namespace,
                arguments=['-d', view, '-f', LaunchConfiguration('fixed_frame')],
            ),
        ]
    )
