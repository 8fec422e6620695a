"""
Commands that use running nodes, or start them.

demo.py, live.py   whole demonstrations, with their processes
follow.py          moves the tip: along a path, or to one position
investigate.py     the robot chooses its own postures
stop.py            stops every controller and driver
record.py          records all topics
teleop.py          moves the tip by the keyboard
robot_model.py     the arm for RViz and Foxglove
"""
