"""Displacement input: wire pulls to tensions to shape, with slack wires."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..exceptions import InputError, NoEquilibriumError

if TYPE_CHECKING:
    from .model import Model
    from .shape import Shape

Floats = npt.NDArray[np.float64]
SETTLED = 1e-8  # [m]


def wire_pulls(model: Model, given: Mapping[str, float] | Sequence[float] | Floats) -> Floats:
    """Return wire pulls (m,) [m], NaN for slack, from names or numbers; names left out: slack."""
    if isinstance(given, Mapping):
        unknown = [name for name in given if name not in model.inputs]
        if unknown:
            raise InputError(f'pulls: unknown {", ".join(map(repr, unknown))}; '
                             f'{model.robot.name} has {", ".join(model.inputs)}')
        given = [given.get(name, np.nan) for name in model.inputs]
    values = np.array(given, dtype=float).reshape(-1)
    if values.shape != (len(model.inputs),) or np.isinf(values).any():
        raise InputError(f'pulls: expected {len(model.inputs)} lengths [m] (blank: slack), '
                         f'got {given!r}')
    return values


def pull_shape(model: Model, pulls: Mapping[str, float] | Sequence[float] | Floats,
               guess: Shape | None = None) -> Shape:
    """
    Return the shape whose wire pulls are met by tensions >= 0.

    A wire without a pull is slack; so is one whose pull is less than the geometry asks for.

    Raises
    ------
    InputError
        The wires cannot have these pulls together.
    NoEquilibriumError
        The model finds no equilibrium on the way.

    """
    target = wire_pulls(model, pulls)
    chain = model.arrays.chain
    starts = [np.where(target > 0.0, 0.1, 0.0), np.where(np.isnan(target), 0.0, 0.3)]
    if guess is not None:
        starts.insert(0, guess.inputs)
    gap = np.inf
    for start in starts:
        inputs, bends = start.astype(float).copy(), np.zeros((2, chain.n, 2))
        if guess is not None:
            bends[:] = guess.bend
        gap = model.arrays.part('pulls').pulled(
            chain, inputs, model.shares, target, bends, model.arrays.fresh_memory(),
            model.scratch(), 60)
        if gap < SETTLED:
            return model.shape(inputs, bends[0])
    if not np.isfinite(gap):
        raise NoEquilibriumError('these wire pulls', model.implicit_effects, gap)
    named = ', '.join(f'{name} {1e3 * value:g} mm' for name, value
                      in zip(model.inputs, target, strict=True) if np.isfinite(value))
    raise InputError(f'pulls: no tensions give {named} together (off by {1e3 * gap:.2g} mm); '
                     'release one of the wires')
