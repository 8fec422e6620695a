"""
The controller node: targets of the tip in, tendon commands out; control/ decides.

node.py         topics, services, the cycle
actions.py      goals with feedback, result and cancel: trajectories, poses
driver_link.py  what the driver says, and what is asked of it after a release
parameters.py   its parameters (docs/ros_interface.md holds the same table)
incoming.py     what comes in, checked and brought into the base frame
model.py        loading a model on request, and publishing its prediction
"""
