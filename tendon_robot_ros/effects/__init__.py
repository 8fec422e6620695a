"""The catalogue of physical effects: one small file each."""

from .catalogue import BUILT_IN, Catalogue, load_catalogue
from .effect import Effect, Parameter
from .stage import STAGES, Quantity, Stage

__all__ = [
    'BUILT_IN',
    'STAGES',
    'Catalogue',
    'Effect',
    'Parameter',
    'Quantity',
    'Stage',
    'load_catalogue',
]
