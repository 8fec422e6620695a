"""What acts on the arm in some of the postures of a data set, as far as it is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..common.errors import EffectError
from ..data import Part
from ..effects import Catalogue

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Conditions:
    """What acts on the arm in some of the postures."""

    rows: npt.NDArray[np.int64]
    gravity: Floats  # (3,) [m/s²]
    known: Mapping[tuple[str, str], float]  # (effect, parameter) -> value, whatever is freed


def known_values(part: Part, catalogue: Catalogue) -> dict[tuple[str, str], float]:
    """
    Return the parameters of the effects that a data set calls known; unnamed ones are neutral.

    Raises
    ------
    EffectError
        An effect or parameter is not in the catalogue, or a value is out of its bounds.

    """
    settled: dict[tuple[str, str], float] = {}
    for name, values in part.known.items():
        where = f'{part.name}: known'
        if name not in catalogue:
            raise EffectError(f'{where}: unknown effect {name!r}; known: {catalogue.names}')
        parameters = {p.name: p for p in catalogue[name].parameters}
        for key, value in values.items():
            if key not in parameters:
                expected = ', '.join(parameters)
                raise EffectError(f'{where}: {name}: expected one of {expected}, got {key!r}')
            low, high = parameters[key].described_bounds
            if not low <= value <= high:
                raise EffectError(
                    f'{where}: {name}.{key}: expected a number from {low:g} to {high:g} '
                    f'[{parameters[key].unit}], got {value:g}'
                )
        settled |= {(name, key): values.get(key, p.neutral) for key, p in parameters.items()}
    return settled
