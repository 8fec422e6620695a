"""
The command line: a class per command, chosen in main.py.

main.py        the list of commands, and how one is run
options.py     arguments that several commands share, measurements, progress, results
robot.py       robot new, robot describe
model.py       model shape, model reach, model workspace, model sweep; export mjcf
data.py        import bag, import table, export bag, plot
simulate.py    simulate
live.py        live --headless without ROS
diagnosis.py   compare, diagnose, effect add, effect remove, improve
motors.py      motors calibrate, motors emulate
completion.py  completion
"""
