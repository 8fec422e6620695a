"""
The catalogue of physical effects: one small file each, named as the effect.

catalogue.py   the list of the built-in ones, in the order in which their laws apply
effect.py      what an effect is: parameters with bounds and units, one law
stage.py       where laws act: what a law takes there, and what it gives back
"""

from .catalogue import BUILT_IN, Catalogue, CatalogueLike, load_catalogue
from .effect import Effect, Parameter, per_axis
from .stage import STAGES

__all__ = [
    'BUILT_IN',
    'STAGES',
    'Catalogue',
    'CatalogueLike',
    'Effect',
    'Parameter',
    'load_catalogue',
    'per_axis',
]
