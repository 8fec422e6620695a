"""Displacement input: wire pulls to tensions to shape, with slack wires."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError, NoEquilibriumError
from ..common.estimation import ITERATIONS_MAX
from ..common.words import FAR_M
from ..robot.inputs import TensionsLike, input_rows, wire_pulls
from .compile import GAP_ACCEPTED_M
from .shape import ShapeBatch, WireSlopes, named_values

if TYPE_CHECKING:
    from .forward import ForwardModel
    from .shape import Shape


def pull_shape(
    model: ForwardModel,
    pulls: TensionsLike,
    guess: Shape | None = None,
    memory: Floats | None = None,
) -> Shape:
    """
    Return the shape that tensions >= 0 give these wire pulls.

    A wire without a pull is slack; so is one whose pull is less than that of the shape.

    Parameters
    ----------
    pulls : mapping or (m,) [m]
    guess : Shape, optional
        Where the search begins.
    memory : optional
        Friction memory of the posture before (`Shape.memory`); default: from straight.

    Raises
    ------
    InputError
        The wires cannot have these pulls together.
    NoEquilibriumError
        The model has no equilibrium during the search.

    """
    commanded = wire_pulls(model.robot, pulls)
    past = model.arrays.fresh_memory() if memory is None else memory.copy()
    passed = transmitted(model, commanded[None], past)[0]
    shape = held_shape(model, passed, guess, past)
    shape.pulls[:] += np.nan_to_num(commanded - passed)
    return shape


def held_shape(model: ForwardModel, pulls: Floats, guess: Shape | None, past: Floats) -> Shape:
    """Return the shape under pulls (m,) [m] behind the transmission, which follow a memory."""
    start = None
    if guess is not None:
        model.own_shape('guess', guess)
        start = guess.inputs[None], guess.state[None]
    inputs, states = _met(model, pulls[None], start, past, unknown_slopes(model, 1), carry=False)
    return model.shape(inputs[0], states[0], past)


def transmitted(model: ForwardModel, pulls: Floats, memory: Floats | None) -> Floats:
    """
    Return the wire pulls (b, m) [m] that pass the transmission; NaN for slack.

    They follow each other and `memory` moves on; None: each comes from an arm at rest.
    """
    passed = np.array(pulls, order='C')
    if model.transmission_remembers:
        past = model.arrays.fresh_memory() if memory is None else memory
        carry = int(memory is not None)
        model.arrays.part('pulls').transmit(model.arrays.address, passed, past, carry)
    return passed


def command(model: ForwardModel, shape: Shape, past: Floats, now: Floats | None = None) -> None:
    """
    Make the pulls of a shape those to command after a memory, which the shape's memory moves on.

    The motors take up what the transmission loses in the direction in which the wires move; those
    whose wires rest stay where they are commanded `now` (m,) [m], by default amid their play.
    """
    if not model.transmission_remembers:
        return
    wanted, kept, play = shape.pulls.copy(), past[-len(model.robot.tendons) :], past.copy()
    if now is None:
        now = np.array([kept[list(members)].mean() for members in model.robot.input_tendons])
    moves = wanted - transmitted(model, now[None], play)[0]
    pulls = now + FAR_M * np.where(np.abs(moves) > GAP_ACCEPTED_M, np.sign(moves), 0.0)
    for _ in range(ITERATIONS_MAX):  # one step, but where tendons of a group slide and stick
        gaps = transmitted(model, pulls[None], play.copy())[0] - wanted
        if np.abs(gaps).max() < GAP_ACCEPTED_M:
            break
        pulls -= gaps
    transmitted(model, pulls[None], play)
    shape.pulls[:], shape.memory[-len(kept) :] = pulls, play[-len(kept) :]


def pull_shapes(
    model: ForwardModel,
    pulls: Floats,
    tensions: Floats | None = None,
    bends: Floats | None = None,
    memory: Floats | None = None,
    slopes: WireSlopes | None = None,
) -> ShapeBatch:
    """
    Return the shapes under wire pulls (b, m) [m], NaN for slack.

    Parameters
    ----------
    tensions : (b, m) [N], optional
        To start from, together with `bends`.
    bends : (b, 3n) [rad], optional
        States, bends and twists.
    memory : optional
        Friction memory of the posture before; postures then follow each other and it moves on.
        Default: every posture is loaded from straight.
    slopes : WireSlopes, optional
        Where the search starts; changed in place to those of the shapes.

    Raises
    ------
    InputError, NoEquilibriumError

    """
    commanded = input_rows(model.robot, pulls, 'displacement')
    targets = transmitted(model, commanded, memory)
    memory = memory if model.remembers else None
    first = None if memory is None else memory.copy()
    start = None if tensions is None or bends is None else (tensions, bends)
    if slopes is None or slopes.states.shape[2] != model.arrays.unknowns:
        slopes = unknown_slopes(model, len(targets))
    past = model.arrays.fresh_memory() if memory is None else memory
    inputs, states = _met(model, targets, start, past, slopes, carry=memory is not None)
    batch = (
        model.shapes(inputs, states) if first is None else model.sequence(inputs, first, states)
    )
    batch.pulls[:] += np.nan_to_num(commanded - targets)
    return replace(batch, slopes=slopes)


def _met(
    model: ForwardModel,
    targets: Floats,
    start: tuple[Floats, Floats] | None,
    past: Floats,
    slopes: WireSlopes,
    carry: bool,
) -> tuple[Floats, Floats]:
    """Return tensions (b, m) [N] and states (b, 3n) [rad] of wire pulls (b, m) [m]."""
    part, count = model.arrays.part('pulls'), len(targets)
    inputs, states = np.empty(targets.shape), np.full((count, 3 * model.arrays.chain.n), np.nan)
    if start is not None:
        inputs[:], states[:] = start
    gaps, high = np.empty(count), np.ascontiguousarray(model.limits[:, 1])
    arrays = inputs, targets, states, past, slopes.pulls, slopes.states, gaps
    # wire pull per tension [m/N] of the tendon that bends the arm most, in PCCA
    squares, stiffness = (model.arrays.offset**2).sum(axis=2), model.arrays.cells[:, 1:2]
    stretch = float((squares / stiffness).sum(axis=0).max())
    settings = model.scratch, high, stretch, int(carry), ITERATIONS_MAX
    met = part.meet_pulls(model.arrays.address, *arrays, *settings)
    if met == count:
        return inputs, states
    if not np.isfinite(gaps[met]):
        raise NoEquilibriumError('these wire pulls', model.implicit_effects, gaps[met])
    named = named_values(model.inputs, 1e3 * targets[met], 'mm')
    raise InputError(
        f'pulls: no tensions give {named} together (off by {1e3 * gaps[met]:.2g} mm); '
        'release one of the wires'
    )


def unknown_slopes(model: ForwardModel, count: int) -> WireSlopes:
    """Return the slopes of so many postures of which nothing is known."""
    m = len(model.inputs)
    return WireSlopes(np.full((count, m, m), np.nan), np.zeros((count, m, model.arrays.unknowns)))
