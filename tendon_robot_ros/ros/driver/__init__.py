"""
The driver node: tendon commands in, states out; drivers/ does the work.

node.py         topics, services, status, parameters (docs/ros_nodes.md)
backend.py      the driver behind it, the rules that it holds; the arm and the tracker of the mock
motor_loop.py   the one thread that talks to the motors
"""
