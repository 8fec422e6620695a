"""
The ROS 2 nodes and the commands that speak to them; only here is rclpy imported.

controller/, driver/, monitor/, viewer/   one folder per node: node.py and its parts
parameters.yaml   the parameters of all nodes: default, unit, range, text
interface.yaml    topics, services, actions of all nodes: type, quality of service, text
commands/   demo, live, follow (go-to, too), investigate, record, stop, teleop, robot_model
shared/     messages, parameters, timings, life cycle, the client of a running controller
"""
