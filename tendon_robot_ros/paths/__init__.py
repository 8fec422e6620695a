"""
Paths of the tip.

path.py   sampled through given rows, stretched until speeds and tension rates are kept
"""
