"""What a model with free parameters predicts for the postures of a data set, and its gradient."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..common.errors import EffectError, TendonRobotError
from ..data import DataSet, Part
from ..data.visits import Visits
from ..effects import Catalogue, Effect, Parameter
from ..model.compile import KernelArrays
from ..model.derivatives import TENSION_STEP, Move, follow
from ..model.forward import TOLERANCE, ForwardModel
from ..model.model import Model
from ..model.pulls import SLACK_BELOW_N, pull_shapes
from ..model.shape import FIELDS, ShapeBatch
from ..robot import Robot


@dataclass(frozen=True)
class Conditions:
    """What acts on the arm in some of the postures, as far as the data set says it."""

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


@dataclass(frozen=True)
class Tangent:
    """How q parameters move P settled postures with J markers."""

    markers: Floats  # (q, P, J, 3) [m per unit]
    states: Floats  # (q, P, 3n) [rad per unit]
    tensions: Floats  # (q, P, m) [N per unit]


class Freed:
    """A parameter that moves a little to both sides, as far as its bounds let it."""

    def __init__(
        self,
        arrays: KernelArrays,
        ends: tuple[float, float],
        count: int,
        set_to: Callable[[float], None],
    ) -> None:
        """Note what `set_to` makes of the model's arrays at both ends, for `count` postures."""
        self.down, self.up = (np.full(count, end) for end in ends)
        self._moved: tuple[npt.NDArray[Any], ...] = (
            arrays.values,
            arrays.on,
            arrays.cells,
            arrays.gravity,
            arrays.offset,
            arrays.helix,
        )
        self._kept: dict[float, list[npt.NDArray[Any]]] = {}
        for side in (*ends, 0.0):
            set_to(side)
            self._kept[side] = [array.copy() for array in self._moved]

    def inputs(self, inputs: Floats, side: Floats) -> Floats:
        """Return the input tensions (b, m) [N]: they stay."""
        return inputs

    @contextmanager
    def applied(self, model: ForwardModel, side: Floats) -> Iterator[None]:
        """Let the parameter be on one side while the block runs."""
        self._put(float(side[0]))
        try:
            yield
        finally:
            self._put(0.0)

    def _put(self, side: float) -> None:
        for array, kept in zip(self._moved, self._kept[side], strict=True):
            array[:] = kept


class Shifted:
    """The same of a parameter of an effect, that the model's arrays hold as it is now."""

    def __init__(
        self,
        arrays: KernelArrays,
        ends: tuple[float, float],
        count: int,
        effect: str,
        parameter: str,
        columns: slice,
    ) -> None:
        """Note where its values lie, and how far it moves in `count` postures."""
        self.down, self.up = (np.full(count, end) for end in ends)
        self._arrays, self._effect = arrays, effect
        self._values = arrays.values[arrays.layout.rows[effect, parameter], columns]
        self._here = self._values.copy()

    def inputs(self, inputs: Floats, side: Floats) -> Floats:
        """Return the input tensions (b, m) [N]: they stay."""
        return inputs

    @contextmanager
    def applied(self, model: ForwardModel, side: Floats) -> Iterator[None]:
        """Let the parameter be on one side, its effect on, while the block runs."""
        on = self._arrays.on.copy()
        self._arrays.act(self._effect)
        self._values[:] = self._here + side[0]
        try:
            yield
        finally:
            self._values[:], self._arrays.on[:] = self._here, on


class Pulled:
    """An input tension that moves a little to both sides, never below zero."""

    def __init__(self, j: int, tensions: Floats) -> None:
        """Take the index of the input and its tensions (b,) [N]."""
        self.j, step = j, np.full(len(tensions), TENSION_STEP)
        self.up, self.down = step, -np.minimum(step, tensions)

    def inputs(self, inputs: Floats, side: Floats) -> Floats:
        """Return the input tensions (b, m) [N] of one side."""
        moved = inputs.copy()
        moved[:, self.j] += side
        return moved

    def applied(self, model: ForwardModel, side: Floats) -> AbstractContextManager[None]:
        """Leave the model as it is."""
        return nullcontext()


def held(tensions: Floats, seen: Floats, states: Floats, q: int) -> tuple[Floats, Floats, Floats]:
    """
    Let tensions (b, m) [N] answer q parameters so that the pulls of taut wires stay.

    `seen` (q + m, b, m + 3 J) begins with the pulls, `states` is (q + m, b, 3n); the last m by the
    tensions. Returns both for the parameters alone, and the answers (q, b, m) [N per unit].
    """
    m = tensions.shape[1]
    answers = np.zeros((q, len(tensions), m))
    for b, own in enumerate(tensions):
        taut = np.flatnonzero(own > SLACK_BELOW_N)
        by_tension = seen[q:, b, :m][np.ix_(taut, taut)]
        answers[:, b, taut] = -seen[:q, b, taut] @ np.linalg.pinv(by_tension, rcond=1e-9)
    return (
        seen[:q] + np.einsum('qbm,mbx->qbx', answers, seen[q:]),
        states[:q] + np.einsum('qbm,mbx->qbx', answers, states[q:]),
        answers,
    )


# No effects: every cell's own deviation where a tolerance declares it, one soft cell, a taper.
CELLS, SOFT_CELL, TAPER = 'cell_stiffness', 'soft_cell', 'taper'
STIFFNESS = (CELLS, SOFT_CELL, TAPER)
# [1] of a parameter or its typical size: about the cube root of the rounding error, so that
# rounding and truncation of a central difference are alike
TANGENT_STEP = 1e-5


@dataclass(frozen=True)
class FreeParameter:
    """One parameter of an effect that a fit may move: of the robot, a section, tendon or cell."""

    effect: str
    parameter: Parameter
    column: int | None = None  # index of the section, tendon or cell whose value it is
    label: str = ''  # the name of the section or tendon

    def __hash__(self) -> int:
        """Hash the few fields that identify it, because it is looked up often."""
        return hash((self.effect, self.parameter.name, self.column))

    @property
    def key(self) -> str:
        """Name within its effect, as files hold it; `common.words.spoken` says it to people."""
        return f'{self.parameter.name}[{self.label}]' if self.label else self.parameter.name


def free_parameters(effect: Effect, robot: Robot) -> tuple[FreeParameter, ...]:
    """
    All parameters of an effect: one per section where sections have their own.

    A base plate, which does not bend, has none. Tendons have their own where the description
    lists one each, else they share one.
    """
    frees: list[FreeParameter] = []
    for parameter in effect.parameters:
        described = robot.effects.get(effect.name, {}).get(parameter.name)
        if parameter.per_section or (parameter.per_tendon and isinstance(described, tuple)):
            sections = [(i, s.name) for i, s in enumerate(robot.sections) if not s.is_plate]
            tendons = list(enumerate(tendon.name for tendon in robot.tendons))
            frees += [
                FreeParameter(effect.name, parameter, i, owner)
                for i, owner in (sections if parameter.per_section else tendons)
            ]
        else:
            frees.append(FreeParameter(effect.name, parameter))
    return tuple(frees)


Point = Mapping[FreeParameter, float]


@dataclass(frozen=True)
class SettledShapes:
    """Where the equilibria of P postures were found: a start for their neighbours."""

    tensions: Floats  # (P, m) [N]
    state: Floats  # (P, 3n) [rad], bends and twists

    def of(self, rows: npt.NDArray[np.int64]) -> SettledShapes:
        """Return those of some postures."""
        return SettledShapes(self.tensions[rows], self.state[rows])


class Predictor:
    """A model whose parameters move; one per thread."""

    def __init__(self, dataset: DataSet, robot: Robot, catalogue: Catalogue) -> None:
        """
        Build the model under the gravity of the data set.

        Raises
        ------
        EffectError
            An effect or parameter that the data set calls known is not in the catalogue.

        """
        self.dataset = dataset
        self.robot = replace(robot, gravity=dataset.gravity_for(robot))
        self.model = Model(self.robot, catalogue)
        self.parts = [
            Conditions(
                rows,
                np.array(part.gravity or robot.gravity or (0.0, 0.0, 0.0)),
                known_values(part, self.model.catalogue),
            )
            for part, rows in dataset.divided
        ]
        arrays = self.model.arrays
        self._values, self._on, self._cells = (
            arrays.values.copy(),
            arrays.on.copy(),
            arrays.cells.copy(),
        )
        self.inputs = mean_inputs(dataset)
        self.visits = None if dataset.visits is None else dataset.visits.seen(dataset.trial_mask)
        self.settled: SettledShapes | None = None  # of the last prediction
        self._first: SettledShapes | None = None

    def value(self, free: FreeParameter) -> float:
        """Value that the description gives a parameter (neutral where it is not listed)."""
        if free.effect not in self.model.catalogue:
            return 0.0
        return float(
            self._values[
                self.model.arrays.layout.rows[free.effect, free.parameter.name], free.column or 0
            ]
        )

    def markers(
        self,
        point: Point,
        inputs: Floats | None = None,
        stiffness: Floats | None = None,
        near: SettledShapes | None = None,
    ) -> Floats | None:
        """
        Predict marker positions (P, J, 3) [m]; None where a posture has no equilibrium.

        Parameters
        ----------
        point : mapping
            Values of freed parameters; all others as described.
        inputs : (P, m) [N] or [m], optional
            Instead of the data set's.
        stiffness : (n,) [1], optional
            Factor on the bending stiffness of every cell.
        near : SettledShapes, optional
            To start from (`settled` of a neighbouring point); default: the first one.

        """
        inputs, near = self.inputs if inputs is None else inputs, near or self._first
        P, n = len(inputs), self.model.arrays.chain.n
        placed = np.empty((P, len(self.dataset.markers), 3))
        settled = SettledShapes(np.empty(inputs.shape), np.empty((P, 3 * n)))
        for part, shapes in self.settle(point, inputs, stiffness, near):
            if shapes is None:
                return None
            rows = self.last_visits(part)
            settled.tensions[part.rows] = shapes.inputs[rows]
            settled.state[part.rows] = shapes.state[rows]
            shown, visits = self.see(shapes), self._visits(part)
            placed[part.rows] = shown if visits is None else visits.mean(shown)
        self.settled = settled
        if self._first is None:  # later ones would make results depend on the order
            self._first = settled
        return placed

    def tangent(
        self, point: Point, frees: Sequence[FreeParameter], settled: SettledShapes
    ) -> Tangent | None:
        """
        Return how freed parameters move what settled at a point, without solving again.

        By the implicit function theorem (`model.derivatives.follow`); where wire pulls are
        commanded, tensions answer so that taut wires keep theirs. None where friction remembers:
        only further solutions show it.
        """
        P, n, q = len(settled.state), self.model.arrays.chain.n, len(frees)
        moved = Tangent(
            np.empty((q, P, len(self.dataset.markers), 3)),
            np.empty((q, P, 3 * n)),
            np.zeros((q, *settled.tensions.shape)),
        )
        for part in self.parts:
            there, count = settled.of(part.rows), len(part.rows)
            self.set_parameters(point, part)
            if self.model.remembers:
                return None
            moves: list[Move] = [self._freed(point, part, free) for free in frees]
            if self.dataset.input == 'displacement':
                m = there.tensions.shape[1]
                moves += [Pulled(j, there.tensions[:, j]) for j in range(m)]

                def pulls_and_markers(shapes: ShapeBatch) -> Floats:  # (b, m + 3 J) [m]
                    return np.hstack([shapes.pulls, self.see(shapes).reshape(len(shapes), -1)])

                seen, states = follow(
                    self.model, there.tensions, there.state, moves, pulls_and_markers
                )
                seen, states, answers = held(there.tensions, seen, states, q)
                moved.tensions[:, part.rows], seen = answers, seen[..., m:]
            else:
                seen, states = follow(self.model, there.tensions, there.state, moves, self.see)
            moved.markers[:, part.rows] = seen.reshape(q, count, -1, 3)
            moved.states[:, part.rows] = states
        return moved

    def _freed(self, point: Point, part: Conditions, free: FreeParameter) -> Freed | Shifted:
        """Return a parameter that is ready to move a little; the model is at the point."""
        here, own, count = point.get(free, self.value(free)), free.parameter, len(part.rows)
        step = TANGENT_STEP * max(abs(here), own.typical)
        ends = (max(-step, own.low - here), min(step, own.high - here))
        if free.effect in self.model.catalogue and (free.effect, own.name) not in part.known:
            return Shifted(
                self.model.arrays, ends, count, free.effect, own.name, self.columns(free)
            )

        def set_to(side: float) -> None:
            self.set_parameters({**point, free: here + side}, part)

        return Freed(self.model.arrays, ends, count, set_to)

    def columns(self, free: FreeParameter) -> slice:
        """Return the sections or tendons whose values a free parameter is."""
        return slice(None) if free.column is None else slice(free.column, free.column + 1)

    def unsettled(self) -> tuple[str, ...]:
        """Name the postures without an equilibrium as described, each loaded from straight."""
        names = []
        for part in self.parts:
            self.set_parameters({}, part)
            names += [
                self.dataset.postures[row]
                for row in part.rows.tolist()
                if self.shapes(self.inputs[row : row + 1], None) is None
            ]
        return tuple(names)

    def settle(
        self,
        point: Point,
        inputs: Floats,
        stiffness: Floats | None = None,
        near: SettledShapes | None = None,
    ) -> Iterator[tuple[Conditions, ShapeBatch | None]]:
        """
        Yield each part of the postures and its shapes, the model as it is set there.

        Where friction depends on the history and postures were visited in any order, there is a
        shape for every visit.
        """
        for part in self.parts:
            self.set_parameters(point, part, stiffness)
            there = None if near is None else near.of(part.rows)
            visits, own = self._visits(part), inputs[part.rows]
            if visits is None:
                yield part, self.shapes(own, there)
                continue
            legs = []
            for leg in visits.legs():
                rows = visits.rows[leg]
                legs.append(self.shapes(own[rows], None if there is None else there.of(rows)))
            yield part, together(legs)

    def _visits(self, part: Conditions) -> Visits | None:
        """Return the visits to the postures of a part; None where the arm keeps no memory."""
        remembered = self.visits is not None and self.model.remembers
        return self.visits.among(part.rows) if remembered and self.visits else None

    def last_visits(self, part: Conditions) -> npt.NDArray[np.int64] | slice:
        """Return which of the settled shapes of a part stand for its postures."""
        visits = self._visits(part)
        return slice(None) if visits is None else visits.last

    def shapes(self, inputs: Floats, near: SettledShapes | None) -> ShapeBatch | None:
        """Shapes (b) of the model as it is set, under inputs (b, m); None without equilibrium."""
        carry = self.model.remembers and self.dataset.path != 'from_straight'
        if self.dataset.input == 'displacement':
            memory = self.model.arrays.fresh_memory() if carry else None
            tensions, bends = (None, None) if near is None else (near.tensions, near.state)
            try:
                return pull_shapes(self.model, inputs, tensions, bends, memory)
            except TendonRobotError:
                return None
        if self.model.remembers:
            batch, changes = self.model.solve(inputs, carry=carry)
            return batch if (changes < TOLERANCE).all() else None
        batch, changes = self.model.solve(inputs, None if near is None else near.state)
        far = np.flatnonzero(~(changes < TOLERANCE))
        if near is None or not len(far):
            return None if len(far) else batch
        for b in far:  # once more, from straight
            again, changes = self.model.solve(inputs[b : b + 1])
            if not changes[0] < TOLERANCE:
                return None
            for name in FIELDS:
                getattr(batch, name)[b] = getattr(again, name)[0]
        return batch

    def see(self, shapes: ShapeBatch) -> Floats:
        """Return where the tracker sees the markers (b, J, 3) [m] of shapes."""
        placed = shapes.markers(self.dataset.arc_lengths, self.dataset.offsets)
        return self.model.measured(placed)

    @contextmanager
    def under_gravity(self, vector: Floats) -> Iterator[None]:
        """Let a gravity (3,) [m/s²] act on all postures while the block runs."""
        before = self.parts
        self.parts = [replace(part, gravity=vector) for part in before]
        try:
            yield
        finally:
            self.parts = before

    def set_parameters(
        self, point: Point, part: Conditions, stiffness: Floats | None = None
    ) -> None:
        """Set the parameters of the model for one part of the postures; see `markers`."""
        arrays = self.model.arrays
        arrays.values[:], arrays.on[:], arrays.cells[:] = self._values, self._on, self._cells
        arrays.gravity[:] = part.gravity
        if stiffness is not None:
            arrays.cells[:, 1] *= stiffness
        for free, value in point.items():
            if free.effect in STIFFNESS:
                arrays.cells[:, 1] *= stiffness_factors(free, value, len(arrays.cells))
            else:
                arrays.set(free.effect, free.parameter.name, free.column, value)
        for (effect, parameter), value in part.known.items():
            arrays.set(effect, parameter, None, value)


def together(batches: Sequence[ShapeBatch | None]) -> ShapeBatch | None:
    """Return shapes one after the other; None where one part of them has no equilibrium."""
    found = [batch for batch in batches if batch is not None]
    if len(found) < len(batches):
        return None
    fields = {name: np.concatenate([getattr(one, name) for one in found]) for name in FIELDS}
    return replace(found[0], **fields)


def stiffness_factors(free: FreeParameter, value: float, n: int) -> Floats:
    """Return the factors (n,) by which a parameter that is no effect changes the cells."""
    if free.effect == TAPER:
        along = np.linspace(-1.0, 1.0, n) if free.parameter.name == 'slope' else np.ones(n)
        return np.asarray(np.exp(value * along))
    own = 1.0 + value if free.effect == CELLS else np.exp(-value)
    return np.where(np.arange(n) == free.column, own, 1.0)


def mean_inputs(dataset: DataSet) -> Floats:
    """Return the inputs (P, m) of the postures, the mean of the trials' where measured."""
    if dataset.trial_inputs is None:
        return np.array(dataset.inputs)
    seen = dataset.trial_mask[..., None]
    total = np.where(seen, dataset.trial_inputs, 0.0).sum(axis=1)
    counts = seen.sum(axis=1)
    return np.where(counts > 0, total / np.maximum(counts, 1), dataset.inputs)


def frees_of(names: Iterable[str], catalogue: Catalogue, robot: Robot) -> Iterator[FreeParameter]:
    """Yield the free parameters of several effects."""
    for name in names:
        yield from free_parameters(catalogue[name], robot)
