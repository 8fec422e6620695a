"""
Commands that speak to running nodes, or start them.

demo.py, live.py   whole demonstrations, with their processes
follow.py          along a path
go_to.py           to one place
investigate.py     the robot chooses its own postures
stop.py            stops all there is
record.py          a recording of all that is said
teleop.py          the keyboard
robot_model.py     the arm for RViz and Foxglove
"""
