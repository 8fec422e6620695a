"""
An arm that finds out by itself what its description lacks.

loop.py           choose, measure, diagnose, until enough is known; verify
choice.py         the posture that tells most: expected information
pool.py           postures that may be chosen: tension, bend, regions kept out
stopping.py       when it is enough, and what is still in question
goal.py           what is asked, and what it may spend
arm.py            what it needs of an arm
simulated_arm.py  an arm that is simulated, to rehearse with
record.py         what was measured, on disk after every posture; resume
results.py        the files at the end: data, recording, description, report
"""
