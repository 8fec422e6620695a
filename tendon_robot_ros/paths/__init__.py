"""
Paths of the tip.

path.py   a path between given rows, smooth or straight, sampled finely
plan.py   when the tip is where: stretched until speeds and tension rates are kept
run.py    what was reached against what was asked
"""
