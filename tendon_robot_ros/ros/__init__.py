"""
The ROS 2 nodes and the commands that speak to them; only here is rclpy imported.

controller/, driver/, monitor/, viewer/   one folder per node: node.py with its parameters (the
            controller's have a file), and its parts
commands/   demo, live, follow, go_to, investigate, record, stop, teleop, robot_model
shared/     messages, parameters, timings, life cycle, the client of a running controller
"""
