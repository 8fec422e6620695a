"""The catalogue of physical effects: one small file each."""

from .catalogue import BUILT_IN, Catalogue, load_catalogue
from .effect import IMPLICIT_STAGES, STAGES, Effect, Parameter

__all__ = [
    'BUILT_IN',
    'IMPLICIT_STAGES',
    'STAGES',
    'Catalogue',
    'Effect',
    'Parameter',
    'load_catalogue',
]
