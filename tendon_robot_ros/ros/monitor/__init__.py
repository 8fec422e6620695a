"""
The monitor node: model against measurement; monitoring/ decides.

node.py         topics, services, what is published for every frame
parameters.py   its parameters (docs/ros_interface.md)
watching.py     drift and tip force: when they are asked, and what is published
adapting.py     identification while running: what it changes in the controller, and undo
measured.py     what a tracker sends, as markers in the base frame
"""
