"""Derivatives of what an equilibrium shows, by tensions and by any parameter of any effect."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..common.errors import InputError
from ..effects import Parameter
from .compile import LEAST_TENSION_N, PARTS
from .pulls import transmitted
from .shape import EPSILON, Shape, ShapeBatch

if TYPE_CHECKING:
    from .forward import ForwardModel

Output = Callable[[ShapeBatch], Floats]
Column = str | tuple[str, str] | tuple[str, str, int | None]
# [1] of a parameter or its typical size, [N] of a tension: a central difference errs by the square
# of its step and by EPSILON over it, and would be worse with any other
DIFFERENCE_STEP = math.cbrt(EPSILON)
# [1] times as long steps where whole paths are solved twice, because an equilibrium is only known
# to 1e-10 rad
REMEMBERED_STEP = 16.0
SHOWN_AT_ONCE = 1024  # [1] shapes, because more, of 2 to 7 kB each, leave a processor's cache
# of effects on which commands and measurements depend, not only shapes
STAGES_BESIDE = 'transmission', 'measurement'
RIGID_BELOW = EPSILON / DIFFERENCE_STEP  # [m/N] rounding of places of 1 m, and no compliance


def tensions_by_pulls(tensions: Floats, slopes: Floats) -> Floats:
    """Return the derivatives (b, m, m) [N/m] of tensions by pulls, of taut wires; else zero."""
    taut = tensions > LEAST_TENSION_N
    both = taut[:, :, None] & taut[:, None, :]
    # lengths of opposite wires do not determine how hard these pull on each other; slopes are
    # differences to one side, which are known to the root of rounding
    inverse = np.linalg.pinv(np.where(both, slopes, 0.0), rcond=math.sqrt(EPSILON))
    return np.where(both, inverse, 0.0)  # exactly, else rounding would pull slack wires taut


def tip_slopes(model: ForwardModel, shape: Shape, past: Floats) -> tuple[Floats, Floats]:
    """
    Return the derivatives of an equilibrium by tensions: of its tip, and of its state.

    Of tip position [m/N] and tip direction [1/N] (6, m), and of the state (m, u) [rad/N].

    Parameters
    ----------
    shape : Shape
    past : ndarray
        Friction memory of the posture before, from which tensions went there in a straight line.
        That of the shape itself gives the mean of both directions in which tendons may slide on.

    """
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
        Motion of the state, by `tip_slopes`.

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
        The function to differentiate: these b shapes, moved, to an array (b, ...). Default: the
        positions in the tracker's frame, (b, n, 3) [m].
    memory : optional
        Friction memory of these shapes (`Shape.memory`): small changes start there, with the mean
        of both directions in which tendons may slide.

    Raises
    ------
    EffectError, InputError
        An effect or an input is not known.

    """
    output = output or (lambda batch: model.measured(batch.positions))
    moves = [move_of(model, shapes, column) for column in columns]
    if not len(shapes):
        return np.repeat(output(shapes)[..., None], len(moves), axis=-1)
    if memory is not None or not model.friction_remembers:

        def outputs(batch: ShapeBatch) -> Floats:
            """Return the output of several times those b shapes."""
            begins = range(0, len(batch), len(shapes))
            return np.concatenate([output(batch.of(slice(a, a + len(shapes)))) for a in begins])

        rates, _ = follow(model, shapes.inputs, shapes.state, moves, outputs, memory)
        return np.moveaxis(rates, 0, -1)

    def solved(move: Move, up: bool) -> Floats:
        moved = shapes.inputs if move.tensions is None else move.tensions[0 if up else 1]
        return output(model.shapes(moved, shapes.state))

    return np.stack([_per_unit(model, move, partial(solved, move)) for move in moves], axis=-1)


def path_near(
    model: ForwardModel, inputs: Floats, states: Floats, by_pulls: bool
) -> Callable[[Floats], ShapeBatch]:
    """
    Return a function that gives the shapes (b) of a sequence from straight, to first order.

    For a model that is a little other than now: by a step of Newton at every posture, each after
    the memory that the step before leaves. Friction that remembers follows the tensions between
    the postures, too: there the parts of that way count as postures, for commanded tensions only.
    The function takes tensions (b, m) [N], or wire pulls [m] where the motors hold these; NaN: a
    slack wire.

    Parameters
    ----------
    inputs, states : (b, m) [N], (b, 3n) [rad]
        Equilibria of the model as it is now, which follow one another.
    by_pulls : bool
        Whether the motors hold wire pulls, else tensions.

    """
    model.arrays.link()
    (b, m), u, address = inputs.shape, model.arrays.unknowns, model.arrays.address
    ends = np.zeros((b, PARTS), dtype=np.int64)
    ends[:, -1] = 1
    if model.friction_remembers:
        way, past = np.ascontiguousarray(inputs), model.arrays.fresh_memory()
        model.arrays.part('shape').parts(address, way, past, model.scratch, ends)
    posture, part_of = np.nonzero(ends)
    share, last = (1.0 + part_of[:, None]) / PARTS, part_of == PARTS - 1

    def along(values: Floats) -> Floats:
        """Return values (b, q) at the ends of all parts, from zero before the first posture."""
        before = np.concatenate([np.zeros_like(values[:1]), values[:-1]])[posture]
        return np.asarray(before + share * (values[posture] - before))

    inputs, states = along(inputs), along(states)
    b = len(inputs)
    answers, by_tension = np.empty((b, u, u)), np.empty((b if by_pulls else 0, m, u))
    pulls = np.empty((len(by_tension), m, m))
    past, part = model.arrays.fresh_memory(), model.arrays.part('derivatives')
    part.path_slopes(address, inputs, states, past, model.scratch, answers, by_tension, pulls)
    held = tensions_by_pulls(inputs, pulls) if by_pulls else pulls

    def shapes(commanded: Floats) -> ShapeBatch:
        past = model.arrays.fresh_memory()
        moved = inputs.copy() if by_pulls else along(commanded), states.copy()
        passed = transmitted(model, commanded, past) if by_pulls else moved[0]
        slopes = answers, by_tension, held
        part.path_steps(address, *moved, np.nan_to_num(passed), past, model.scratch, *slopes)
        return shown(model, *moved, carry=True).of(last)

    return shapes


@dataclass(frozen=True)
class Entries:
    """Entries of an array that change, (r,) each: where they are, and what they are instead."""

    array: npt.NDArray[Any]  # contiguous
    index: npt.NDArray[np.intp]  # in the flat array
    up: Floats
    down: Floats

    @classmethod
    def shifted(
        cls,
        array: Floats,
        which: Any,
        sides: tuple[float, float],
        slope: Floats | float = 1.0,
        about: Floats | None = None,
    ) -> Entries:
        """Vary array[which] about its value, or another one, by a slope times both sides."""
        index = np.arange(array.size).reshape(array.shape)[which].ravel()
        middle = array.reshape(-1)[index] if about is None else about
        up, down = (middle + side * np.ravel(slope) for side in sides)
        return cls(array, index, up, down)

    @property
    def places(self) -> npt.NDArray[np.int64]:
        """Addresses of the entries."""
        return self.array.ctypes.data + self.array.itemsize * self.index

    def put(self, values: Floats) -> Floats:
        """Set the entries; return what they were."""
        flat = self.array.reshape(-1)
        was = flat[self.index]
        flat[self.index] = values
        return was


@dataclass(frozen=True)
class Move:
    """One quantity that moves: how far up and down, and what a model and its inputs are then."""

    up: Floats | float  # of every posture (b,), or of all alike
    down: Floats | float
    entries: tuple[Entries, ...] = ()
    effect: str = ''  # that acts meanwhile; '': none beside those that do
    tensions: Floats | None = None  # (2, b, m) [N] up and down; None: they stay
    # whether the output depends on it beside the shapes: what is commanded or measured changes
    beside: bool = False

    @classmethod
    def of_tension(cls, j: int, tensions: Floats, step: float = DIFFERENCE_STEP) -> Move:
        """Move an input of tensions (b, m) [N], never to zero or below, where laws may jump."""
        slack, moved = tensions[:, j] < step, np.array([tensions, tensions])
        up, down = np.where(slack, 2.0 * step, step), np.where(slack, step, -step)
        moved[0, :, j] += up
        moved[1, :, j] += down
        return cls(up, down, tensions=moved)

    @classmethod
    def of_parameter(
        cls,
        model: ForwardModel,
        effect: str,
        name: str,
        owner: int | None,
        ends: tuple[float, float],
    ) -> Move:
        """Move a parameter, of one section or tendon or of all, to both ends (down, up)."""
        arrays, (low, high) = model.arrays, ends
        which = arrays.layout.rows[effect, name], arrays.columns(effect, name, owner)
        entries = Entries.shifted(arrays.values, which, (high, low))
        beside = model.catalogue[effect].stage in STAGES_BESIDE
        return cls(high, low, (entries,), effect, beside=beside)

    @classmethod
    def by(
        cls, model: ForwardModel, ends: tuple[float, float], set_to: Callable[[float], None]
    ) -> Move:
        """Move what a function changes in the model's arrays, to both ends (down, up) and to 0."""
        arrays = model.arrays
        every = arrays.values, arrays.cells, arrays.gravity, arrays.offset, arrays.helix
        kept = []
        for end in (*ends, 0.0):
            set_to(end)
            kept.append([array.ravel().copy() for array in every])
        entries = []
        for array, low, high, now in zip(every, *kept, strict=True):
            index = np.flatnonzero((low != now) | (high != now))
            entries.append(Entries(array, index, high[index], low[index]))
        return cls(ends[1], ends[0], tuple(entries))

    @contextmanager
    def applied(self, model: ForwardModel, up: bool) -> Iterator[None]:
        """Change the model to one side while the block runs."""
        on, arrays = model.arrays.on.copy(), model.arrays
        were = [one.put(one.up if up else one.down) for one in self.entries]
        if self.effect:
            arrays.act(self.effect)
        try:
            yield
        finally:
            for one, was in zip(self.entries, were, strict=True):
                one.put(was)
            arrays.on[:] = on


def variants(
    model: ForwardModel, inputs: Floats, moves: Sequence[Move]
) -> tuple[Floats, tuple[npt.NDArray[Any], ...]]:
    """
    Return inputs (2q, b, m) [N] and changes of a model with each of q moves, up and down.

    The changes as the kernel reads them (`shape.variants`): which effects act (2q, effects), where
    the entries of each variant start (2q + 1,), and addresses and values of entries. Without moves
    it is the model itself.
    """
    arrays, sides = model.arrays, max(2 * len(moves), 1)
    tensions = np.repeat(inputs[None], sides, axis=0)
    acting = np.repeat(arrays.on[None], sides, axis=0)
    counts = np.zeros(sides + 1, dtype=np.int64)  # of entries, behind the first start
    places, values = [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
    for q, move in enumerate(moves):
        if move.tensions is not None:
            tensions[2 * q : 2 * q + 2] = move.tensions
        if move.effect:
            acting[2 * q : 2 * q + 2, arrays.layout.index[move.effect]] = 1
        for up in (True, False):
            places += [one.places for one in move.entries]
            values += [one.up if up else one.down for one in move.entries]
        counts[2 * q + 1 : 2 * q + 3] = sum(len(one.index) for one in move.entries)
    changes = acting, np.cumsum(counts), np.concatenate(places), np.concatenate(values)
    return tensions, changes


def off_balance(
    model: ForwardModel,
    inputs: Floats,
    changes: tuple[npt.NDArray[Any], ...],
    states: Floats,
    past: Floats,
    shows: bool = False,
) -> tuple[Floats, ShapeBatch]:
    """
    Return how far states (2q, b, 3n) or (b, 3n) [rad] are from balance, and their shapes.

    Of `variants`. The former (2q, b, 3n) [rad] are the states minus those that their own moments
    ask for. Of the shapes (2q b) only inputs, states and tensions are filled; with `shows` all
    fields.
    """
    model.arrays.link()
    rows = inputs.shape[0] * inputs.shape[1]
    states = np.broadcast_to(states, (*inputs.shape[:2], states.shape[-1]))
    out = np.empty(states.shape)
    block, batch, _ = model.form.filled(inputs.reshape(rows, -1), states.reshape(rows, -1))
    fixed = model.arrays.address, block, past, model.scratch
    model.arrays.part('shape').variants(*fixed, *changes, out.reshape(rows, -1), int(shows))
    return out, batch


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
        The function to differentiate: shapes, several times those b, to an array (k b, ...).
    memory : optional
        Friction memory of these shapes; without it nothing may remember. See `derivatives`.

    """
    arrays, b = model.arrays, len(inputs)
    past = arrays.fresh_memory() if memory is None else memory
    sides = np.empty((len(moves), 2, b))
    for own, move in zip(sides, moves, strict=True):
        own[0], own[1] = move.up, move.down
    widths = sides[:, 0] - sides[:, 1]
    at_once = max(SHOWN_AT_ONCE // (2 * b), 1)
    places = [slice(begin, begin + at_once) for begin in range(0, len(moves), at_once)]
    parts = [variants(model, inputs, moves[some]) for some in places]
    before = arrays.on.copy()
    try:  # cells twist for all if they do for one, else their twist would follow nothing
        arrays.on[:] = np.concatenate([changes[0] for _, changes in parts]).max(axis=0)
        arrays.link()
        arrays.on[:] = before | (arrays.on & arrays.twisting)
        off = np.concatenate([off_balance(model, *part, states, past)[0] for part in parts])
        rates = (off[0::2] - off[1::2]) / widths[:, :, None]
        state_slopes = responses(model, inputs, states, past, rates.swapaxes(0, 1)).swapaxes(0, 1)
    finally:
        arrays.on[:] = before
    slopes = list[Floats]()
    for some, part in zip(places, parts, strict=True):
        moved = states + sides[some, :, :, None] * state_slopes[some, None]
        moved = moved.reshape(-1, *states.shape)
        ends = output(off_balance(model, *part, moved, past, shows=True)[1])
        ends = ends.reshape(-1, 2, b, *ends.shape[1:])
        slopes.append((ends[:, 0] - ends[:, 1]) / _like(widths[some], ends[:, 0]))
    outputs = np.concatenate(slopes)
    if any(move.beside for move in moves):
        batch = shown(model, inputs, states, past)
        for q, move in enumerate(moves):
            if move.beside:
                outputs[q] += _per_unit(model, move, lambda up: output(batch))
    return outputs, state_slopes


def _like(values: Floats, array: Floats) -> Floats:
    """Return values with axes of length 1 behind theirs, as many as those of an array."""
    return values.reshape(*values.shape, *[1] * (array.ndim - values.ndim))


def _per_unit(model: ForwardModel, move: Move, value_at: Callable[[bool], Floats]) -> Floats:
    """Return the difference quotient of a value (b, ...) on both sides of a move."""
    ends = []
    for up in (True, False):
        with move.applied(model, up):
            ends.append(value_at(up))
    return np.asarray((ends[0] - ends[1]) / _like(np.asarray(move.up - move.down), ends[0]))


def move_of(model: ForwardModel, shapes: ShapeBatch, column: Column) -> Move:
    """Return the move of an input or parameter, one-sided at zero tension and at a bound."""
    longer = REMEMBERED_STEP if model.friction_remembers else 1.0
    if isinstance(column, str):
        if column not in model.inputs:
            raise InputError(f'unknown input {column!r}; known: {", ".join(model.inputs)}')
        return Move.of_tension(model.inputs.index(column), shapes.inputs, longer * DIFFERENCE_STEP)
    effect, name = column[:2]
    owner: int | None = column[2] if len(column) == 3 else None
    known = {p.name: p for p in model.catalogue[effect].parameters}
    if name not in known:
        raise InputError(f'{effect}: unknown parameter {name!r}; known: {", ".join(known)}')
    ends = ends_of(known[name], model.arrays.get(effect, name, owner), longer)
    return Move.of_parameter(model, effect, name, owner, ends)


def ends_of(parameter: Parameter, value: float, longer: float = 1.0) -> tuple[float, float]:
    """Return how far a parameter moves down and up about a value, one-sided at a bound."""
    step = longer * DIFFERENCE_STEP * max(abs(value), parameter.typical)
    # a description may say more than a fit may: from there one-sided, too
    low, high = min(parameter.low, value), max(parameter.high, value)
    return max(-step, low - value), min(step, high - value)


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
    b, (block, batch, _) = len(inputs), model.form.filled(inputs, states)
    past = model.arrays.fresh_memory() if memory is None else memory
    model.arrays.part('shape').postures(
        model.arrays.address, block, b, 0, b, past.ctypes.data, model.scratch, int(carry), 0
    )
    return batch


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
    shape = model.own_shape('shape', shape)
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
