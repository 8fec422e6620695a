"""
The controller node: targets of the tip in, tendon commands out; control/ decides.

node.py         topics, services, the cycle
actions.py      goals with feedback, result and cancel: trajectories, poses
parameters.py   its parameters (docs/ros_interface.md holds the same table), and its model
topics.py       what comes in, checked and in the base frame; the prediction, which goes out
"""
