"""
The ROS 2 nodes and the commands that speak to them; only here is rclpy imported.

controller/, driver/, monitor/, viewer/   one folder per node: node.py, parameters.py (viewer: in
            node.py), its parts
commands/   demo, live and its director, follow, go_to, investigate, record, teleop, robot_model
shared/     messages, parameters, life cycle, files, the client of a running controller
"""
