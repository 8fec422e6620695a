"""
The command line: one module per command, chosen in main.py.

main.py           the list of commands, and how one is run
options.py        arguments that several commands share, and where results go
questions.py      questions on a terminal or a pipe
"""
