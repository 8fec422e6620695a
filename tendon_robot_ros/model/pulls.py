"""Displacement input: wire pulls to tensions to shape, with slack wires."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..exceptions import InputError, NoEquilibriumError
from .inputs import Given, wire_pulls

if TYPE_CHECKING:
    from .model import Model
    from .shape import Shape, ShapeBatch

Floats = npt.NDArray[np.float64]
SETTLED = 1e-8  # [m]
MOST = 60  # steps of the search


def pull_shape(model: Model, pulls: Given, guess: Shape | None = None) -> Shape:
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
    target = wire_pulls(model.robot, pulls)
    start = None if guess is None else (guess.inputs, guess.bend)
    inputs, bend = _tensions(model, target, start, model.arrays.fresh_memory())
    return model.shape(inputs, bend)


def pull_shapes(
    model: Model,
    pulls: Floats,
    tensions: Floats | None = None,
    bends: Floats | None = None,
    memory: Floats | None = None,
) -> ShapeBatch:
    """
    Return the shapes under wire pulls (b, m) [m], NaN for slack.

    Parameters
    ----------
    tensions : (b, m) [N], optional
        To start from, together with `bends`.
    bends : (b, n, 2) [rad], optional
    memory : optional
        Friction memory of the posture before; postures then follow each other and it moves on.
        Default: every posture is loaded from straight.

    Raises
    ------
    InputError, NoEquilibriumError

    """
    first = None if memory is None else memory.copy()
    targets = [wire_pulls(model.robot, row) for row in pulls]
    inputs, found = np.empty((len(targets), len(model.inputs))), []
    for b, target in enumerate(targets):
        start = None if tensions is None or bends is None else (tensions[b], bends[b])
        past = model.arrays.fresh_memory() if memory is None else memory
        inputs[b], bend = _tensions(model, target, start, past)
        found.append(bend)
        if memory is not None:
            model.solve(inputs[b : b + 1], bend[None], memory, carry=True)
    if first is not None:
        return model.sequence(inputs, first)
    return model.shapes(inputs, np.array(found))


def _shares(model: Model) -> Floats:
    """Share (m, k) of each tendon in the wire pull of its input."""
    shares = np.zeros((len(model.inputs), len(model.robot.tendons)))
    for j, members in enumerate(model.robot.input_tendons):
        shares[j, list(members)] = 1.0 / len(members)
    return shares


def _tensions(
    model: Model, target: Floats, start: tuple[Floats, Floats] | None, past: Floats
) -> tuple[Floats, Floats]:
    """Find tensions (m,) [N] and bends (n, 2) [rad] that meet wire pulls (m,) [m]."""
    straight, shares = np.zeros((model.arrays.chain.n, 2)), _shares(model)
    pulled = np.where(target > 0.0, 0.1, 0.0), straight
    taut = np.where(np.isnan(target), 0.0, 0.3), straight
    gap = np.inf
    for tensions, bend in (pulled, taut) if start is None else (start, pulled, taut):
        inputs, bends = np.array(tensions), np.array([bend, bend])
        left = model.arrays.part('pulls').pulled(
            model.arrays.address, inputs, shares, target, bends, past, model.scratch, MOST
        )
        gap = min(gap, left)
        if gap < SETTLED:
            return inputs, bends[0]
    if not np.isfinite(gap):
        raise NoEquilibriumError('these wire pulls', model.implicit_effects, gap)
    named = ', '.join(
        f'{name} {1e3 * value:g} mm'
        for name, value in zip(model.inputs, target, strict=True)
        if np.isfinite(value)
    )
    raise InputError(
        f'pulls: no tensions give {named} together (off by {1e3 * gap:.2g} mm); '
        'release one of the wires'
    )
