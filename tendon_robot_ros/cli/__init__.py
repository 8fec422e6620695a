"""
The command line: a class per command, chosen in main.py.

main.py        the list of commands, and how one is run
options.py     arguments that several commands share, measurements, progress, results
robot.py       new-robot, describe
model.py       shape, reach, workspace, sweep
data.py        import-bag, import-table, export-bag, plot
simulate.py    simulate
diagnosis.py   compare, diagnose, add, remove, improve
motors.py      calibrate, emulate
"""
