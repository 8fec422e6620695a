"""
An arm that finds out by itself what its description lacks.

loop.py           choose, measure, diagnose, until enough is known; verify; the files at the end
measuring.py      what is needed of an arm; measure a posture, again if it breaks; skip it, say so;
                  after a drift alarm: the postures that separate what has changed; the record,
                  on disk after every posture; resume
choice.py         the posture that tells most (expected information), and which may be chosen:
                  tension, bend, regions kept out
goal.py           what is to be found out, and the budget; when it is enough, what is in question
"""
