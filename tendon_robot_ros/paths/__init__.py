"""
Paths of the tip.

path.py   a path between given rows, smooth or straight, sampled finely; what was reached along it
plan.py   when the tip is where: stretched until speeds and tension rates are kept
"""
