"""
The monitor node: model against measurement; monitoring/ decides.

node.py         topics, services, parameters (docs/ros_interface.md)
measured.py     what a tracker sends, as markers in the base frame; the errors of every frame
watching.py     drift, tip force, identification while running: when, and what is published
"""
