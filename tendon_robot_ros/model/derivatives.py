"""Derivatives of what an equilibrium shows, by tensions and by any parameter of any effect."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..common.errors import InputError
from .compile import LEAST_TENSION_N
from .pulls import transmitted
from .shape import EPSILON, Shape, ShapeBatch

if TYPE_CHECKING:
    from .forward import ForwardModel

Output = Callable[[ShapeBatch], Floats]
Column = str | tuple[str, str] | tuple[str, str, int | None]
# [1] of a parameter or of its typical size: a central difference errs by the square of its step
# and by EPSILON over it, and would be worse with any other
DIFFERENCE_STEP = math.cbrt(EPSILON)
TENSION_STEP = DIFFERENCE_STEP  # [N]
# [1] times as long steps where whole paths are solved twice, because an equilibrium is only known
# to 1e-10 rad
REMEMBERED_STEP = 16.0
RIGID_BELOW = EPSILON / DIFFERENCE_STEP  # [m/N] rounding of places of 1 m, and no compliance


def tensions_by_pulls(tensions: Floats, slopes: Floats) -> Floats:
    """Return the derivatives (b, m, m) [N/m] of tensions by pulls, of taut wires; else zero."""
    taut = tensions > LEAST_TENSION_N
    both = taut[:, :, None] & taut[:, None, :]
    # lengths of opposite wires do not determine how hard these pull on each other; slopes are
    # differences to one side, which are known to the root of rounding
    inverse = np.linalg.pinv(np.where(both, slopes, 0.0), rcond=math.sqrt(EPSILON))
    return np.where(both, inverse, 0.0)  # exactly, else rounding would pull slack wires taut


def tip_jacobian(model: ForwardModel, tensions: Floats) -> Floats:
    """Return d (tip position, tip direction) / d tensions, (6, m) [m/N], [1/N], from straight."""
    if model.friction_remembers:

        def tip(batch: ShapeBatch) -> Floats:
            return np.concatenate([batch.tip_position, batch.tip_direction], axis=1)

        tips: Floats = derivatives(model, model.shapes(tensions[None]), model.inputs, tip)[0]
        return tips
    return tip_slopes(model, model.shape(tensions), model.arrays.fresh_memory())


def tip_slopes(model: ForwardModel, shape: Shape, past: Floats) -> Floats:
    """
    Return d (tip position, tip direction) / d tensions, (6, m) [m/N], [1/N], at an equilibrium.

    Parameters
    ----------
    shape : Shape
    past : ndarray
        Friction memory of the posture before, from which tensions went there in a straight line.
        That of the shape itself gives the mean of both directions in which tendons may slide on.

    """
    return tip_and_state_slopes(model, shape, past)[0]


def tip_and_state_slopes(model: ForwardModel, shape: Shape, past: Floats) -> tuple[Floats, Floats]:
    """Return `tip_slopes` (6, m) and the derivatives (m, u) [rad/N] of the state by tensions."""
    m = len(shape.inputs)
    slopes, state_slopes = np.empty((6, m)), np.empty((m, model.arrays.unknowns))
    states, part = np.array([shape.state, shape.state]), model.arrays.part('derivatives')
    inputs, where = shape.inputs.copy(), model.arrays.address
    part.jacobian(where, inputs, states, past, model.scratch, state_slopes, slopes)
    return slopes, state_slopes


def take_sides(model: ForwardModel, shape: Shape, past: Floats, step: Floats) -> int:
    """
    Set the direction of friction at rest to that of a motion; return how many eyelets change.

    Parameters
    ----------
    shape : Shape
    past : ndarray
        Friction memory of the posture before, changed in place: the slopes of an eyelet that has
        not slid since are then those of the side to which it will. See the kernel's `derivatives`.
    step : (u,) [rad]
        Motion of the state, by `tip_and_state_slopes`.

    """
    states, part = np.array([shape.state, shape.state]), model.arrays.part('derivatives')
    where, inputs = model.arrays.address, shape.inputs.copy()
    return int(part.take_sides(where, inputs, states, step, past, model.scratch))


def derivatives(
    model: ForwardModel,
    shapes: ShapeBatch,
    columns: Sequence[Column],
    output: Output | None = None,
    memory: Floats | None = None,
) -> Floats:
    """
    Return the derivatives (b, ..., q) of an output of equilibria, one column per quantity.

    By the implicit function theorem: one linear equation for all columns, no further equilibrium
    (see the kernel's `derivatives`). An effect that is off counts as on at its neutral value.
    Where friction remembers, the path to a posture matters and each side is solved from straight.

    Parameters
    ----------
    shapes : ShapeBatch
        Equilibria of this model, each loaded from straight.
    columns : sequence
        Names of inputs [N], or effect and parameter, or those and the index of a section; without
        one the parameter of all sections moves together.
    output : callable, optional
        The function to differentiate: shapes to an array (b, ...). Default: the positions in the
        tracker's frame, (b, n, 3) [m].
    memory : optional
        Friction memory of these shapes (`Shape.memory`): small changes start there, with the mean
        of both directions in which tendons may slide.

    Raises
    ------
    EffectError, InputError
        An effect or an input is not known.

    """
    output = output or (lambda batch: model.measured(batch.positions))
    moves = [_Move.of(model, shapes, column) for column in columns]
    if memory is not None or not model.friction_remembers:
        rates, _ = follow(model, shapes.inputs, shapes.state, moves, output, memory)
        return np.moveaxis(rates, 0, -1)

    def solved(move: Move, side: Floats) -> Floats:
        return output(model.shapes(move.inputs(shapes.inputs, side), shapes.state))

    return np.stack([_per_unit(model, move, partial(solved, move)) for move in moves], axis=-1)


@dataclass(frozen=True)
class PathSlopes:
    """
    Derivatives of equilibria that follow one another, b in a sequence from straight.

    With them a model that is a little other is solved to first order along the whole path
    (`shapes`): by a step of Newton at every posture, each after the memory that the step before
    leaves. For arms whose bends remember; friction that remembers follows the tensions between
    the postures, too.
    """

    model: ForwardModel
    inputs: Floats  # (b, m) [N]
    states: Floats  # (b, 3n) [rad]
    answers: Floats  # (b, u, u) [1] state by residual
    by_tension: Floats  # (b, m, u) [rad/N] state
    held: Floats  # (b, m, m) [N/m] tensions by the wire pulls that motors hold
    by_pulls: bool  # whether they hold pulls, else tensions

    @classmethod
    def of(cls, model: ForwardModel, inputs: Floats, states: Floats, by_pulls: bool) -> PathSlopes:
        """Take the derivatives at equilibria of the model as it is now, by tensions or pulls."""
        model.arrays.link()
        (b, m), u = inputs.shape, model.arrays.unknowns
        inputs, states = np.ascontiguousarray(inputs), np.ascontiguousarray(states)
        answers, by_tension = np.empty((b, u, u)), np.empty((b, m, u))
        pulls = np.empty((b, m, m))
        past, part = model.arrays.fresh_memory(), model.arrays.part('derivatives')
        part.path_slopes(
            model.arrays.address, inputs, states, past, model.scratch, answers, by_tension, pulls
        )
        held = tensions_by_pulls(inputs, pulls) if by_pulls else np.zeros_like(pulls)
        return cls(model, inputs, states, answers, by_tension, held, by_pulls)

    def shapes(self, commanded: Floats) -> ShapeBatch:
        """Return the shapes (b) of the model as it is now, to first order; see `equilibria`."""
        return shown(self.model, *self.equilibria(commanded), carry=True)

    def equilibria(self, commanded: Floats) -> tuple[Floats, Floats]:
        """
        Return tensions (b, m) [N] and states (b, 3n) [rad] of the model, to first order.

        Parameters
        ----------
        commanded : (b, m)
            Tensions [N], or wire pulls [m] where the motors hold these; NaN: a slack wire.

        """
        model = self.model
        inputs = (self.inputs if self.by_pulls else np.ascontiguousarray(commanded)).copy()
        states, past = self.states.copy(), model.arrays.fresh_memory()
        if self.by_pulls:
            commanded = transmitted(model, commanded, past)
        model.arrays.part('derivatives').path_steps(
            model.arrays.address,
            inputs,
            states,
            np.nan_to_num(commanded),
            past,
            model.scratch,
            self.answers,
            self.by_tension,
            self.held,
        )
        return inputs, states


class Move(Protocol):
    """One quantity that moves, and how far up and down: (b,) each."""

    up: Floats
    down: Floats

    def inputs(self, inputs: Floats, side: Floats) -> Floats:
        """Return the input tensions (b, m) [N] of one side."""

    def applied(self, model: ForwardModel, side: Floats) -> AbstractContextManager[None]:
        """Apply the change of that side to the model while a block runs."""


def follow(
    model: ForwardModel,
    inputs: Floats,
    states: Floats,
    moves: Sequence[Move],
    output: Output,
    memory: Floats | None = None,
) -> tuple[Floats, Floats]:
    """
    Return derivatives of equilibria by quantities: outputs (q, b, ...) and states (q, b, 3n).

    Parameters
    ----------
    inputs, states : (b, m) [N], (b, 3n) [rad]
        Equilibria of the model as it is now, each loaded from straight.
    moves : (q,)
    output : callable
        The function to differentiate: shapes to an array (b, ...).
    memory : optional
        Friction memory of these shapes; without it nothing may remember. See `derivatives`.

    """
    arrays, on, acting = model.arrays, model.arrays.on.copy(), model.arrays.on
    past = arrays.fresh_memory() if memory is None else memory

    def unbalanced(move: Move, side: Floats) -> Floats:
        on[:] |= acting & arrays.twisting
        return residuals(model, move.inputs(inputs, side), states, past)

    rates = np.empty((len(states), len(moves), states.shape[1]))
    for q, move in enumerate(moves):
        rates[:, q] = _per_unit(model, move, partial(unbalanced, move))
    before = acting.copy()
    try:  # cells twist for all if they do for one, else their twist would follow nothing
        acting[:] = on
        state_slopes = responses(model, inputs, states, past, rates).swapaxes(0, 1)
    finally:
        acting[:] = before

    def moved(move: Move, state_slope: Floats, side: Floats) -> Floats:
        state = states + side[:, None] * state_slope
        return output(shown(model, move.inputs(inputs, side), state, past))

    slopes = [
        _per_unit(model, move, partial(moved, move, state_slope))
        for state_slope, move in zip(state_slopes, moves, strict=True)
    ]
    return np.array(slopes), state_slopes


def _per_unit(model: ForwardModel, move: Move, value_at: Callable[[Floats], Floats]) -> Floats:
    """Return the difference quotient of a value (b, ...) on both sides of a move."""
    sides = []
    for side in (move.up, move.down):
        with move.applied(model, side):
            sides.append(value_at(side))
    width = (move.up - move.down).reshape(-1, *[1] * (sides[0].ndim - 1))
    return np.asarray((sides[0] - sides[1]) / width)


class _Move:
    """One quantity and how far it moves up and down, (b,) each."""

    def __init__(self, column: Column, up: Floats, down: Floats, j: int) -> None:
        self.column, self.up, self.down, self.j = column, up, down, j

    @classmethod
    def of(cls, model: ForwardModel, shapes: ShapeBatch, column: Column) -> _Move:
        """Choose the steps: central, one-sided at zero tension and at a parameter's bound."""
        ones, longer = np.ones(len(shapes)), REMEMBERED_STEP if model.friction_remembers else 1.0
        if isinstance(column, str):
            if column not in model.inputs:
                raise InputError(f'unknown input {column!r}; known: {", ".join(model.inputs)}')
            j, step = model.inputs.index(column), longer * TENSION_STEP
            return cls(column, step * ones, -np.minimum(step, shapes.inputs[:, j]), j)
        effect, name = column[:2]
        known = {p.name: p for p in model.catalogue[effect].parameters}
        if name not in known:
            raise InputError(f'{effect}: unknown parameter {name!r}; known: {", ".join(known)}')
        value, parameter = model.arrays.get(effect, name, _section(column)), known[name]
        step = longer * DIFFERENCE_STEP * max(abs(value), parameter.typical)
        up, down = min(step, parameter.high - value), max(-step, parameter.low - value)
        return cls(column, up * ones, down * ones, -1)

    def inputs(self, inputs: Floats, side: Floats) -> Floats:
        """Return the input tensions (b, m) [N] of one side."""
        moved = inputs.copy()
        if self.j >= 0:
            moved[:, self.j] += side
        return moved

    @contextmanager
    def applied(self, model: ForwardModel, side: Floats) -> Iterator[None]:
        """Move the parameter, if it is one, while the block runs."""
        arrays = model.arrays
        values, on = arrays.values.copy(), arrays.on.copy()
        try:
            if not isinstance(self.column, str):
                effect, name = self.column[:2]
                section = _section(self.column)
                row = arrays.layout.rows[effect, name]
                arrays.values[row, slice(None) if section is None else section] += side[0]
                arrays.act(effect)
            yield
        finally:
            arrays.values[:], arrays.on[:] = values, on


def _section(column: Column) -> int | None:
    return column[2] if len(column) == 3 else None  # type: ignore[return-value]


def residuals(model: ForwardModel, inputs: Floats, states: Floats, past: Floats) -> Floats:
    """Return states (b, 3n) minus those that balance their own moments [rad]; 0 for no twist."""
    model.arrays.link()
    inputs, states = np.ascontiguousarray(inputs), np.ascontiguousarray(states)
    part, out = model.arrays.part('derivatives'), np.empty_like(states)
    part.residuals(model.arrays.address, inputs, states, past, model.scratch, out)
    return out


def responses(
    model: ForwardModel, inputs: Floats, states: Floats, past: Floats, rates: Floats
) -> Floats:
    """Return the derivatives (b, q, 3n) of equilibria by those (b, q, 3n) of their residuals."""
    model.arrays.link()
    inputs, states = np.ascontiguousarray(inputs), np.ascontiguousarray(states)
    part, count = model.arrays.part('derivatives'), model.arrays.unknowns
    changes, answers = np.ascontiguousarray(rates[..., :count]), np.zeros(rates.shape)
    rows = np.empty_like(changes)
    part.responses(model.arrays.address, inputs, states, past, model.scratch, changes, rows)
    answers[..., :count] = rows
    return answers


def shown(
    model: ForwardModel,
    inputs: Floats,
    states: Floats,
    memory: Floats | None = None,
    carry: bool = False,
) -> ShapeBatch:
    """
    Return the shapes of inputs (b, m) [N] and states (b, 3n) [rad], without solving.

    After the memory of one posture, or with `carry` one after the other.
    """
    b, form = len(inputs), model.form
    block = np.zeros(b * form.size)
    fields = form.views(block, b)
    fields.pop('change')
    fields['inputs'][:], fields['state'][:] = inputs, states
    past = model.arrays.fresh_memory() if memory is None else memory
    model.arrays.part('shape').postures(
        model.arrays.address, block, b, 0, b, past.ctypes.data, model.scratch, int(carry), 0
    )
    return ShapeBatch(**fields, cell_length=form.cell_length, hinge=form.hinge, slopes=None)


FORCES = ('tip_load', 'force_x'), ('tip_load', 'force_y'), ('tip_load', 'force_z')


@dataclass(frozen=True)
class TipStiffness:
    """The compliance of the tip: its displacement per force on it."""

    compliance: Floats  # (3, 3) [m/N], base frame

    def along(self, direction: npt.ArrayLike) -> float:
        """
        Return the force per displacement along a direction [N/m], free to move across it.

        1 / (uᵀ C u) with the compliance C and the unit vector u; infinite where nothing yields.
        """
        u = np.asarray(direction, dtype=float)
        size = float(np.linalg.norm(u))
        if u.shape != (3,) or not EPSILON < size < np.inf:
            raise InputError(f'direction: expected three numbers, not all 0, got {direction!r}')
        u = u / size
        compliance = float(u @ self.compliance @ u)
        return 1.0 / compliance if abs(compliance) > RIGID_BELOW else np.inf

    @property
    def softest(self) -> tuple[float, Floats]:
        """Stiffness [N/m] along the direction (3,) in which the tip yields most."""
        values, vectors = np.linalg.eigh(0.5 * (self.compliance + self.compliance.T))
        return 1.0 / max(float(values[-1]), RIGID_BELOW), vectors[:, -1]


def tip_stiffness(model: ForwardModel, shape: Shape, wires_held: bool = False) -> TipStiffness:
    """
    Return the compliance of the tip of an equilibrium under a small force on it.

    By the implicit function theorem on the model (`derivatives`). Where friction remembers,
    tendons stick at first, and the mean of both directions counts.

    Parameters
    ----------
    shape : Shape
    wires_held : bool
        The motors hold the lengths of the wires instead of their tensions: C - J P⁺ G, with the
        tip's motion J and the pulls' change P by tensions, and the pulls' change G by the force.
        Slack wires hold nothing.

    """
    taut = [
        name for name, t in zip(model.inputs, shape.inputs, strict=True) if t > LEAST_TENSION_N
    ]
    columns: list[Column] = [*FORCES, *taut] if wires_held else [*FORCES]
    memory = shape.memory if model.remembers else None

    def tip_and_pulls(batch: ShapeBatch) -> Floats:
        return np.concatenate([batch.tip_position, batch.pulls], axis=1)

    slopes = derivatives(model, shape.batch, columns, tip_and_pulls, memory)[0]
    compliance = slopes[:3, :3]
    if wires_held and taut:
        rows = [3 + model.inputs.index(name) for name in taut]
        # below the accuracy of differences nothing is held: wires of equal length are redundant
        held = np.linalg.pinv(slopes[rows, 3:], rcond=DIFFERENCE_STEP)
        compliance = compliance - slopes[:3, 3:] @ held @ slopes[rows, :3]
    return TipStiffness(compliance)
