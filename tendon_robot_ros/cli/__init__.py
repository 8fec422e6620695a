"""
The command line: one module per command, chosen in main.py.

main.py           the list of commands, and how one is run
options.py        arguments that several commands share, measurements, progress, results
"""
