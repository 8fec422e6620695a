"""
The controller node: targets of the tip in, tendon commands out; control/ computes them.

node.py         topics, services, the cycle
actions.py      goals with feedback, result and cancel: trajectories, poses
parameters.py   its parameters (ros/parameters.yaml), and its model
topics.py       messages received, checked and in the base frame; the published prediction
"""
