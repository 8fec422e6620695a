"""
What every part uses, and what knows nothing of robots.

errors.py         every error that a user can meet, and checks of arguments that raise them
files.py          files and folders that are written whole or not at all; the cache folder
yaml_reading.py   checked reading of YAML; every refusal names file, key, expectation and value
words.py          numbers, units and names as people write and read them
results.py        results that say themselves in words, in notebooks, as DataFrames and JSON
workers.py        chunks of independent work: here, in processes, on a cluster
processes.py      children that end with who started them; who goes first; one thread
local_stop.py     a stop on the same computer, without discovery
estimation.py     Gaussian estimates: the update by a linear measurement, the fit of a model
arrays.py         types of arrays
rotations.py      rotation matrices, rotation vectors and quaternions
colours.py        the colours of measured, predicted and the rest, for pages and pictures
"""
