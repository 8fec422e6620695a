"""Displacement input: wire pulls to tensions to shape, with slack wires."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError, NoEquilibriumError
from ..common.estimation import ITERATIONS_MAX
from ..common.words import FAR_M
from ..robot.estimates import SAME_TENSION_N
from ..robot.inputs import TensionsLike, input_rows, wire_pulls
from .compile import LEAST_TENSION_N
from .shape import ShapeBatch, WireSlopes

if TYPE_CHECKING:
    from .forward import ForwardModel
    from .shape import Shape
    from .tip_task import TipTask

Aim = Callable[[Floats, Floats, Floats], tuple[float, Floats]]
# [m] gap of a wire that ends a search, because friction near rest changes sign within 2e-6
GAP_ACCEPTED_M = 5e-6
# [1] stretch of the wires over the arm's compliance: from so soft that each wire finds its tension
# to so stiff that only 1e-4 of the pulls stretches, each so that the next search begins near
SPRING_COMPLIANCES = (1e-1, 1e-2, 1e-3, 1e-4)
# [1] of the limits, of a last search; measured: it solves 4 of 40 postures of spatial_3 with
# friction memory that no other search does
PRETENSION = 0.25


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
    past = model.arrays.fresh_memory() if memory is None else memory
    if not model.transmission_remembers:
        return held_shape(model, commanded, guess, past)
    past = past.copy()
    passed = transmitted(model, commanded[None], past)[0]
    shape = held_shape(model, passed, guess, past)
    shape.pulls[:] += np.nan_to_num(commanded - passed)
    return shape


def held_shape(model: ForwardModel, pulls: Floats, guess: Shape | None, past: Floats) -> Shape:
    """Return the shape under pulls (m,) [m] behind the transmission, which follow a memory."""
    start = None if guess is None else (guess.inputs, guess.state)
    slopes = unknown_slopes(model, 1)
    inputs, bend = _tensions(model, pulls, start, past, _compliance(model), slopes, 0)
    return model.shape(inputs, bend, past)


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
    inputs, shapes = np.empty((len(targets), len(model.inputs))), list[Floats]()
    compliance, straight = _compliance(model), model.arrays.fresh_memory()
    part = model.arrays.part('pulls')
    if slopes is None or slopes.states.shape[2] != model.arrays.unknowns:
        slopes = unknown_slopes(model, len(targets))
    for b, target in enumerate(targets):
        start = None if tensions is None or bends is None else (tensions[b], bends[b])
        if start is None and memory is not None and shapes and slopes.sprung:
            start = inputs[b - 1], shapes[-1]
        past = straight if memory is None else memory
        inputs[b], bend = _tensions(model, target, start, past, compliance, slopes, b)
        shapes.append(bend)
        if memory is not None:
            part.keep_memory(model.arrays.address, memory, model.scratch)
    states = np.array(shapes)
    batch = (
        model.shapes(inputs, states) if first is None else model.sequence(inputs, first, states)
    )
    batch.pulls[:] += np.nan_to_num(commanded - targets)
    return replace(batch, slopes=slopes)


def _tensions(
    model: ForwardModel,
    target: Floats,
    start: tuple[Floats, Floats] | None,
    past: Floats,
    compliance: float,
    slopes: WireSlopes,
    b: int,
) -> tuple[Floats, Floats]:
    """
    Find tensions (m,) [N] and state (3n,) [rad] that meet wire pulls (m,) [m].

    Wires that stretch come first, from soft to stiff: lengths alone often do not determine how
    hard two wires pull against each other, springs do. `b`: the place of the posture in `slopes`.
    """
    gap, best = np.inf, (np.zeros_like(target), np.zeros(3 * model.arrays.chain.n))
    for search in searches(model, target, start, slopes.sprung):
        inputs, bends = np.array(search.tensions), np.array([search.bend, search.bend])
        known = slopes.near(b, target, search.bend)
        problem = (model.arrays.address, inputs, target, bends, past, *known, model.scratch)
        part, stretched = model.arrays.part('pulls'), True
        for ratio in search.springs:
            stretch = ratio * compliance
            error = part.solve_elastic_wires(*problem, stretch, ITERATIONS_MAX)
            stretched = error < part.STRETCH_ERROR_N * stretch
            if not stretched:
                break  # stiffer springs would do no better
        if not stretched and search.held:
            continue
        error = float(part.solve_stiff_wires(*problem, ITERATIONS_MAX))
        if error < gap:
            gap, best = error, (inputs, bends[0])
        if gap < GAP_ACCEPTED_M:
            return best
    if not np.isfinite(gap):
        raise NoEquilibriumError('these wire pulls', model.implicit_effects, gap)
    if gap > GAP_ACCEPTED_M:
        named = ', '.join(
            f'{name} {1e3 * value:g} mm'
            for name, value in zip(model.inputs, target, strict=True)
            if np.isfinite(value)
        )
        raise InputError(
            f'pulls: no tensions give {named} together (off by {1e3 * gap:.2g} mm); '
            'release one of the wires'
        )
    return best


def unknown_slopes(model: ForwardModel, count: int) -> WireSlopes:
    """Return the slopes of so many postures of which nothing is known."""
    m, arrays = len(model.inputs), model.arrays
    sprung = bool(arrays.part('pulls').wires_are_springs(arrays.address))
    return WireSlopes(
        np.full((count, m, m), np.nan), np.zeros((count, m, arrays.unknowns)), sprung
    )


@dataclass(frozen=True)
class _PullSearch:
    """Start of a search, and the springs it goes through."""

    tensions: Floats
    bend: Floats
    springs: tuple[float, ...] = SPRING_COMPLIANCES
    held: bool = True  # stiff wires are tried only where every spring converged


def searches(
    model: ForwardModel,
    target: Floats,
    start: tuple[Floats, Floats] | None,
    sprung: bool = False,
) -> Iterator[_PullSearch]:
    """
    Yield the searches: from the guess, from straight, and for wires that do not stretch.

    Wires that are springs by themselves (`sprung`) need no others near a guess.

    Springs that stretch by less than the travel over which friction changes sign (some µm) may
    have no solution; wires that do not stretch have one there all the same, if not always the same
    tensions: they come last. Of 980 postures of six robots without a guess, springs solve 906,
    wires that do not stretch 35, from more tension 15, both at last 14 and 4; 6 have no solution.
    """
    if start is not None:
        yield _PullSearch(*start, () if sprung else SPRING_COMPLIANCES[-1:])
    straight = np.zeros(3 * model.arrays.chain.n)
    pulled, taut = (np.where(on, 0.1, 0.0) for on in (target > 0.0, ~np.isnan(target)))
    yield _PullSearch(pulled, straight)
    yield _PullSearch(pulled, straight, ())
    yield _PullSearch(3.0 * taut, straight, ())
    last_resort = partial(_PullSearch, bend=straight, held=False)
    yield last_resort(pulled)
    yield last_resort(PRETENSION * model.limits[:, 1] * (taut > 0.0), springs=())


def _compliance(model: ForwardModel) -> float:
    """Wire pull per tension [m/N] of the tendon that bends the arm most, in PCCA."""
    cells, offset = model.arrays.cells, model.arrays.offset
    return float(((offset**2).sum(axis=2) / cells[:, 1:2]).sum(axis=0).max())


def aim_by_pulls(task: TipTask, aim: Aim, inputs: Floats, bend: Floats) -> tuple[float, Floats]:
    """
    Improve inputs (m,) [N] in place among those that wire lengths can hold.

    Wires of given lengths keep no tension against each other: of the states with these lengths,
    the arm takes the one in which the loose wires are slack. So the wires that the lengths do not
    hold are set slack, one after the other, and the search is repeated with the others.

    Parameters
    ----------
    aim : callable
        Inputs (m,) [N], state (3n,) [rad] and limits (m, 2) [N] to the cost [m²] and the state.

    Returns
    -------
    cost : float [m²]
        Infinite where no tensions are held.
    bends : (3n,) [rad]
        State, bends and twists.

    """
    model, taut = task.model, inputs > LEAST_TENSION_N
    for _ in range(len(inputs)):
        limits = task.limits * taut[:, None]
        np.clip(inputs, *limits.T, out=inputs)
        cost, bends = aim(inputs, bend, limits)
        if not np.isfinite(cost):
            break
        try:
            shape = task.shape(inputs, bends)
            held = held_shape(model, shape.pulls, shape, task.past)
        except (NoEquilibriumError, InputError):
            break
        if np.allclose(held.inputs, inputs, rtol=0.0, atol=SAME_TENSION_N):
            return cost, bends
        lost = taut & (held.inputs < inputs - SAME_TENSION_N)
        if not lost.any():
            break
        taut[np.argmin(np.where(lost, held.inputs, np.inf))] = False
        inputs[:], bend = held.inputs, held.state
    return np.inf, bend
