"""
The one compiled kernel: sweep, equilibrium, derivatives, inverse, wire pull, friction memory.

These modules are not imported from here. `model.compile` copies them, together with a generated
`stages.py` that calls the laws of a catalogue of effects, into a cache folder whose name covers
every source, and imports the copy: so numba's cache can never serve a stale law. README.md
has the call graph and a table of the arrays.
"""

from typing import Any

stages: Any  # the laws of a catalogue, a module that `model.compile` writes
