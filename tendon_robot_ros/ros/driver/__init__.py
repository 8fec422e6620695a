"""
The driver node: tendon commands in, states out; drivers/ does the work.

node.py         topics, services, status
parameters.py   its parameters, and the driver behind them (docs/ros_interface.md)
motor_loop.py   the one thread that talks to the motors
mock_arm.py     the arm and the tracker of the mock
"""
