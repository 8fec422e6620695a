"""
What every part uses, and what knows nothing of robots.

errors.py         every error that a user can meet: one line that says what to do
files.py          files and folders that are there whole, or not at all
cache.py          where compiled code is kept, between one process and the next
given.py          what a caller gives a public function, taken as what it means or refused
told.py           results that say themselves, in words and in notebooks
yaml_reading.py   checked reading of YAML; every refusal names file, key, expectation and value
workers.py        chunks of independent work: here, in processes, on a cluster
processes.py      children that end with who started them; who goes first; one thread
local_stop.py     a stop on the same computer, without discovery
rotations.py      rotation matrices, rotation vectors and quaternions
units.py          units as people write them, to SI
words.py          numbers as people read them: millimetres, degrees, names in a list
dataframes.py     tables of pandas, for those who have it
colours.py        the colours of measured, predicted and the rest, for pages and pictures
"""
