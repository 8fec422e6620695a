"""
A model against measurements: how far off, where, and how much of that is noise.

compare.py     `compare`: models and a data set to a comparison
result.py      what a comparison holds, and pictures of it; to JSON and back
"""
