"""Predictions of a model with free parameters for a data set, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from ..common.arrays import Floats, Ints
from ..common.errors import EffectError, TendonRobotError
from ..data import DataSet, Part
from ..data.visits import Visits
from ..effects import Catalogue, Effect, Parameter
from ..model.compile import BEND_TOLERANCE
from ..model.derivatives import Move, ends_of, follow, path_near, tensions_by_pulls
from ..model.model import Model
from ..model.pulls import pull_shapes, transmitted, unknown_slopes
from ..model.shape import FIELDS, ShapeBatch, WireSlopes
from ..robot import Robot
from .statistics import mean_over


@dataclass(frozen=True)
class Conditions:
    """Known loads in some of the postures, as declared by the data set."""

    rows: Ints
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
            if expected := parameters[key].expected(value):
                raise EffectError(f'{where}: {name}.{key}: expected {expected}, got {value:g}')
        settled |= {(name, key): values.get(key, p.neutral) for key, p in parameters.items()}
    return settled


@dataclass(frozen=True)
class Tangent:
    """Derivatives of P equilibria with J markers by q parameters."""

    markers: Floats  # (q, P, J, 3) [m per unit]
    states: Floats  # (q, P, 3n) [rad per unit]
    tensions: Floats  # (q, P, m) [N per unit]
    # values of the q parameters where they were taken
    at: Point = field(default_factory=dict, kw_only=True)

    def of(self, frees: Sequence[FreeParameter]) -> Tangent | None:
        """Return the derivatives by some parameters in their order; None where one is unknown."""
        order = {free: i for i, free in enumerate(self.at)}
        if not order.keys() >= set(frees):
            return None
        rows, at = [order[free] for free in frees], {free: self.at[free] for free in frees}
        return Tangent(self.markers[rows], self.states[rows], self.tensions[rows], at=at)

    def beside(self, markers: Floats, at: Point) -> Tangent:
        """Add the derivatives of the markers by further parameters; those of states count as 0."""
        rates = []
        for one in (self.states, self.tensions):
            rates.append(np.concatenate([one, np.zeros((len(markers), *one.shape[1:]))]))
        return Tangent(np.concatenate([self.markers, markers]), *rates, at={**self.at, **at})


def held(tensions: Floats, rows: Floats, states: Floats, q: int) -> tuple[Floats, Floats, Floats]:
    """
    Eliminate the changes of tensions (b, m) [N] that keep the pulls of taut wires.

    `rows` (q + m, b, m + 3 J), which begins with the pulls, and `states` (q + m, b, 3n) are
    derivatives by q parameters and by the m tensions. Returns both by the parameters alone, and
    the derivatives (q, b, m) [N per unit] of the tensions.
    """
    m = tensions.shape[1]
    inverse = tensions_by_pulls(tensions, rows[q:, :, :m].swapaxes(0, 1))
    answers = -np.einsum('qbm,bmn->qbn', rows[:q, :, :m], inverse)
    return (
        rows[:q] + np.einsum('qbm,mbx->qbx', answers, rows[q:]),
        states[:q] + np.einsum('qbm,mbx->qbx', answers, states[q:]),
        answers,
    )


PATH_STAGES = {'hysteresis', 'transmission'}  # that `derivatives.path_near` follows
# No effects: every cell's own deviation where a tolerance declares it, one soft cell, a taper.
CELLS, SOFT_CELL, TAPER = 'cell_stiffness', 'soft_cell', 'taper'
STIFFNESS = (SOFT_CELL, TAPER)


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
        """Name within its effect, as in files; see `common.words.spoken` for sentences."""
        return f'{self.parameter.name}[{self.label}]' if self.label else self.parameter.name

    def clip(self, value: float) -> float:
        """Return a value within the bounds of a fit."""
        return float(np.clip(value, self.parameter.low, self.parameter.high))


def free_parameters(effect: Effect, robot: Robot) -> tuple[FreeParameter, ...]:
    """
    All parameters of an effect: one per section where sections have their own.

    A base plate, which does not bend, has none. Tendons have their own where the description
    lists one each, else they share one.
    """
    frees: list[FreeParameter] = []
    for parameter in effect.parameters:
        described = robot.effects.get(effect.name, {}).get(parameter.name)
        if parameter.only_described and described in (None, parameter.neutral):
            continue
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
    """Equilibria of P postures, the initial guess for nearby parameters."""

    tensions: Floats  # (P, m) [N]
    state: Floats  # (P, 3n) [rad], bends and twists
    slopes: WireSlopes | None = None  # by the tensions, where wire pulls are commanded

    def of(self, rows: Ints | slice) -> SettledShapes:
        """Return those of some postures."""
        slopes = None if self.slopes is None else self.slopes.of(rows)
        return SettledShapes(self.tensions[rows], self.state[rows], slopes)


class Predictor:
    """A model whose parameters move."""

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
        own = (arrays.values, arrays.on, arrays.cells)
        self._values, self._on, self._cells = (array.copy() for array in own)
        self.inputs = mean_inputs(dataset)
        self.visits = None if dataset.visits is None else dataset.visits.masked(dataset.trial_mask)
        self._shown = (dataset.trials > 0) | (dataset.thinned_from == 0)
        self._shown[[part.rows[0] for part in self.parts]] = True  # for those behind it
        self.around: Mapping[str, Floats] = {}  # imperfections by kind; see `BuiltPredictor`
        self.settled: SettledShapes | None = None  # of the last prediction
        self._first: SettledShapes | None = None

    def value(self, free: FreeParameter) -> float:
        """Value that the description gives a parameter (neutral where it is not listed)."""
        if free.effect not in self.model.catalogue:
            return 0.0
        arrays, name = self.model.arrays, free.parameter.name
        columns = arrays.columns(free.effect, name, free.column)
        return float(self._values[arrays.layout.rows[free.effect, name], columns.start or 0])

    def start(self, free: FreeParameter) -> float:
        """Value in the description, moved inside the bounds of a fit."""
        return free.clip(self.value(free))

    def markers(
        self, point: Point, inputs: Floats | None = None, near: SettledShapes | None = None
    ) -> Floats | None:
        """
        Predict marker positions (P, J, 3) [m]; None where a posture has no equilibrium.

        Parameters
        ----------
        point : mapping
            Values of freed parameters; all others as described.
        inputs : (P, m) [N] or [m], optional
            Instead of the data set's.
        near : SettledShapes, optional
            To start from (`settled` of a neighbouring point); default: the first one.

        Where nothing is remembered, postures that only lie on the path of a thinned sequence are
        those before them.
        """
        inputs, near = self.given(self.inputs if inputs is None else inputs), near or self._first
        P, n = len(inputs), self.model.arrays.chain.n
        placed, stand_in = np.empty((P, len(self.dataset.markers), 3)), np.zeros(P, dtype=int)
        settled = SettledShapes(np.empty(inputs.shape), np.empty((P, 3 * n)))
        for part, shapes in self.settle(point, inputs, near):
            if shapes is None:
                return None
            last = shapes.of(self.last_visits(part))
            settled.tensions[part.rows], settled.state[part.rows] = last.inputs, last.state
            if last.slopes is not None:
                slopes = settled.slopes or unknown_slopes(self.model, P)
                slopes.put(part.rows, last.slopes)
                settled = replace(settled, slopes=slopes)
            shown, visits = self.see(shapes), self._visits(part)
            placed[part.rows] = shown if visits is None else visits.mean(shown)
            stand_in[part.rows] = part.rows
        stand_in = np.maximum.accumulate(stand_in)  # where a posture is not predicted
        placed, self.settled = placed[stand_in], settled.of(stand_in)
        if self._first is None:  # later ones would make results depend on the order
            self._first = self.settled
        return placed

    def given(self, inputs: Floats) -> Floats:
        """Return the inputs (P, m) [N] or [m] that reach the arm."""
        return inputs

    def tangent(
        self, point: Point, frees: Sequence[FreeParameter], settled: SettledShapes
    ) -> Tangent | None:
        """
        Return the derivatives of equilibria by freed parameters, without solving again.

        By the implicit function theorem (`model.derivatives.follow`); where wire pulls are
        commanded, tensions answer so that taut wires keep theirs. None where friction remembers
        and pulls are commanded: only further solutions show it.
        """
        catalogue = self.model.catalogue
        stages = {catalogue[free.effect].stage for free in frees if free.effect in catalogue}
        follows = 'memory' in stages or self.model.friction_remembers  # the way to a posture
        if follows and self.dataset.input == 'displacement':
            return None
        remembers = self.carries or (stages & PATH_STAGES and self.dataset.path != 'from_straight')
        if follows or remembers:
            return self._path_tangent(point, frees, settled)

        def moves(part: Conditions) -> list[Move]:
            return [self.moved(point, part, free) for free in frees]

        return self.tangent_by(moves, point, settled)

    def tangent_by(
        self,
        moves_of: Callable[[Conditions], list[Move]],
        point: Point,
        settled: SettledShapes | None = None,
    ) -> Tangent:
        """
        Return the derivatives of equilibria by moves of each part; see `tangent`.

        Default: of those that were predicted last.
        """
        settled = settled or self.settled
        assert settled is not None
        P, by_pulls, tangents = len(settled.state), self.dataset.input == 'displacement', []
        for part in self.parts:
            self.set_parameters(point, part)
            rows = self.predicted(part).rows
            start, count = settled.of(rows), len(rows)
            moves = moves_of(part)
            q, m = len(moves), start.tensions.shape[1]
            if by_pulls:
                moves += [Move.of_tension(j, start.tensions) for j in range(m)]

            def pulls_and_markers(shapes: ShapeBatch, rows: Ints = rows) -> Floats:
                """Return (k b, m + 3 J) [m], pulls beyond the requested ones."""
                passed = transmitted(self.model, self.given(self.inputs)[rows], None)
                gaps = shapes.pulls.reshape(-1, *passed.shape) - passed
                seen = self.see(shapes).reshape(len(shapes), -1)
                return np.hstack([np.nan_to_num(gaps).reshape(len(shapes), -1), seen])

            output = pulls_and_markers if by_pulls else self.see
            rates, states = follow(self.model, start.tensions, start.state, moves, output)
            answers = np.zeros((q, *start.tensions.shape))
            if by_pulls:
                rates, states, answers = held(start.tensions, rates, states, q)
                rates = rates[..., m:]
            tangents.append((rows, rates.reshape(q, count, -1, 3), states, answers))
        whole = [np.zeros((q, P, *one.shape[2:])) for one in tangents[0][1:]]
        for rows, *own in tangents:
            for every, one in zip(whole, own, strict=True):
                every[:, rows] = one
        return Tangent(*whole)

    @property
    def carries(self) -> bool:
        """Whether a posture depends on the one before, by what the model is set to remember."""
        return self.remembers and self.dataset.path != 'from_straight'

    @property
    def remembers(self) -> bool:
        """Whether the model remembers, its transmission where wire pulls are commanded."""
        by_pulls = self.dataset.input == 'displacement'
        return self.model.remembers or (by_pulls and self.model.transmission_remembers)

    def has_slopes(self, effect: Effect) -> bool:
        """Whether derivatives show an effect that is absent; else only further solutions do."""
        return effect.stage not in ('torsion', 'memory')

    def along_path(
        self, point: Point, settled: SettledShapes
    ) -> Callable[[Point], tuple[Floats, SettledShapes]]:
        """
        Return a function that predicts markers (P, J, 3) [m] of a path near a point.

        To first order, at the cost of one step for every visit (`derivatives.path_near`).
        Postures that only lie on the way are not shown.
        """
        paths, by_pulls = [], self.dataset.input == 'displacement'
        for part, order, visits in self._on_the_way(point, settled):
            legs = []
            for leg in order.legs():
                start = visits.of(leg)
                legs.append((leg, path_near(self.model, start.tensions, start.state, by_pulls)))
            paths.append((part, order, legs))

        def near_point(moved: Point) -> tuple[Floats, SettledShapes]:
            placed = np.zeros((len(self.inputs), len(self.dataset.markers), 3))
            then = SettledShapes(np.empty_like(settled.tensions), np.empty_like(settled.state))
            for part, order, legs in paths:
                self.set_parameters(moved, part)
                inputs = self.given(self.inputs)[part.rows[order.rows]]
                along = ShapeBatch.joined([near(inputs[leg]) for leg, near in legs])
                seen = np.zeros((len(inputs), *placed.shape[1:]))
                seen[order.counts] = self.see(along.of(order.counts))
                placed[part.rows], last = order.mean(seen), along.of(order.last)
                then.tensions[part.rows], then.state[part.rows] = last.inputs, last.state
            return placed, then

        return near_point

    def _on_the_way(
        self, point: Point, settled: SettledShapes
    ) -> Iterator[tuple[Conditions, Visits, SettledShapes]]:
        """Yield each part, its path and the equilibria of its visits; the model is set to them."""
        every = copy(self)
        every._shown = np.ones_like(self._shown)  # those between the measured ones included
        known, inputs = self._shown.all() or self.carries, self.given(self.inputs)
        if not known and every.markers(point, near=settled) is not None:
            assert every.settled is not None
            settled = every.settled
        for part in self.parts:
            self.set_parameters(point, part)
            order = self._order(part)
            visits = settled.of(part.rows[order.rows])
            if self.carries and len(order.rows) > len(part.rows):  # each time it is another one
                shapes = self._along(part, inputs, settled)
                visits = visits if shapes is None else SettledShapes(shapes.inputs, shapes.state)
            yield part, order, visits

    def _order(self, part: Conditions) -> Visits:
        """Return the visits to a part, or its sequence: what is on the way does not count."""
        if self.visits is not None:
            return self.visits.among(part.rows)
        rows, names = np.arange(len(part.rows)), self.dataset.postures
        commands = tuple(names[row] for row in part.rows.tolist())
        fresh = (rows == 0) | (self.dataset.path == 'from_straight')
        return Visits(commands, rows, fresh, self._shown[part.rows], rows)

    def _path_tangent(
        self, point: Point, frees: Sequence[FreeParameter], settled: SettledShapes
    ) -> Tangent:
        """Return the derivatives of a path of an arm that remembers its bends; see `tangent`."""
        known = (free for free in frees if free.effect in self.model.catalogue)
        start = {**{free: self.value(free) for free in known}, **point}
        near, columns = self.along_path(start, settled), []
        here = _moved(near(start))
        for free in frees:
            value = start.get(free, 0.0)
            side = max(ends_of(free.parameter, value), key=abs)
            there = _moved(near({**start, free: value + side}))
            columns.append([(then - now) / side for now, then in zip(here, there, strict=True)])
        return Tangent(*(np.array(part) for part in zip(*columns, strict=True)))

    def moved(self, point: Point, part: Conditions, free: FreeParameter) -> Move:
        """Return the move of a parameter about a point; the model is set to the point."""
        value, own = point.get(free, self.value(free)), free.parameter
        ends, is_effect = ends_of(own, value), free.effect in self.model.catalogue
        if is_effect and (free.effect, own.name) not in part.known:
            return Move.of_parameter(self.model, free.effect, own.name, free.column, ends)

        def set_to(side: float) -> None:
            self.set_parameters({**point, free: value + side}, part)

        return Move.by(self.model, ends, set_to)

    def unsettled(self, point: Point | None = None) -> tuple[str, ...]:
        """Name the postures without an equilibrium (as described), each loaded from straight."""
        names = []
        for part in self.parts:
            self.set_parameters(point or {}, part)
            names += [
                self.dataset.postures[row]
                for row in part.rows.tolist()
                if self.shapes(self.inputs[row : row + 1], None) is None
            ]
        return tuple(names)

    def settle(
        self, point: Point, inputs: Floats, near: SettledShapes | None = None
    ) -> Iterator[tuple[Conditions, ShapeBatch | None]]:
        """
        Yield each part of the postures and its shapes, the model as it is set there.

        Where friction depends on the history and postures were visited in any order, there is a
        shape for every visit.
        """
        for conditions in self.parts:
            self.set_parameters(point, conditions)
            part = self.predicted(conditions)
            yield part, self._along(part, inputs, near)

    def _along(
        self, part: Conditions, inputs: Floats, near: SettledShapes | None
    ) -> ShapeBatch | None:
        """Return the shapes of all visits to a part; None where one has no equilibrium."""
        start = None if near is None else near.of(part.rows)
        visits, own = self._visits(part), inputs[part.rows]
        if visits is None:
            return self.shapes(own, start)
        rows = [visits.rows[leg] for leg in visits.legs()]
        legs = [self.shapes(own[leg], start and start.of(leg)) for leg in rows]
        settled = [leg for leg in legs if leg is not None]
        return ShapeBatch.joined(settled) if len(settled) == len(legs) else None

    def predicted(self, part: Conditions) -> Conditions:
        """Return a part with those of its postures that the present model has to predict."""
        if self.remembers:
            return part
        rows = part.rows[self._shown[part.rows]]
        return replace(part, rows=rows) if len(rows) else part

    def _visits(self, part: Conditions) -> Visits | None:
        """Return the visits to the postures of a part; None where the arm keeps no memory."""
        remembered = self.visits is not None and self.remembers
        return self.visits.among(part.rows) if remembered and self.visits else None

    def last_visits(self, part: Conditions) -> Ints | slice:
        """Return the indices of the settled shapes of a part that belong to its postures."""
        visits = self._visits(part)
        return slice(None) if visits is None else visits.last

    def shapes(self, inputs: Floats, near: SettledShapes | None) -> ShapeBatch | None:
        """Shapes (b) of the model as it is set, under inputs (b, m); None without equilibrium."""
        if self.dataset.input == 'displacement':
            try:
                return self.pulled(inputs, near)
            except TendonRobotError:
                return None
        if self.model.remembers:
            batch, changes = self.model.solve(inputs, carry=self.carries)
            return batch if (changes < BEND_TOLERANCE).all() else None
        batch, changes = self.model.solve(inputs, None if near is None else near.state)
        far = np.flatnonzero(~(changes < BEND_TOLERANCE))
        if near is None or not len(far):
            return None if len(far) else batch
        for b in far:  # once more, from straight
            retried, changes = self.model.solve(inputs[b : b + 1])
            if not changes[0] < BEND_TOLERANCE:
                return None
            for name in FIELDS:
                getattr(batch, name)[b] = getattr(retried, name)[0]
        return batch

    def pulled(self, inputs: Floats, near: SettledShapes | None = None) -> ShapeBatch:
        """Return shapes (b) of the model as it is set, under wire pulls (b, m) [m], or raise."""
        memory = self.model.arrays.fresh_memory() if self.carries else None
        tensions, bends = (None, None) if near is None else (near.tensions, near.state)
        slopes = None if near is None else near.slopes
        return pull_shapes(self.model, inputs, tensions, bends, memory, slopes)

    def refused(self, posture: str) -> str | None:
        """Say why the wire pulls of a posture cannot be (as described), loaded from straight."""
        row = self.dataset.postures.index(posture)
        for part in self.parts if self.dataset.input == 'displacement' else ():
            if row in part.rows:
                self.set_parameters({}, part)
                try:
                    self.pulled(self.inputs[row : row + 1])
                except TendonRobotError as refusal:
                    return str(refusal)
        return None

    def see(self, shapes: ShapeBatch) -> Floats:
        """Return where the tracker sees the markers (b, J, 3) [m] of shapes."""
        placed = shapes.markers(self.dataset.arc_lengths, self.dataset.offsets)
        return self.model.measured(placed)

    def set_parameters(self, point: Point, part: Conditions) -> None:
        """Set the parameters of the model for one part of the postures; see `markers`."""
        arrays = self.model.arrays
        arrays.values[:], arrays.on[:], arrays.cells[:] = self._values, self._on, self._cells
        arrays.gravity[:] = part.gravity
        for free, value in point.items():
            if free.effect in STIFFNESS:
                arrays.cells[:, 1] *= stiffness_factors(free, value, len(arrays.cells))
            else:
                arrays.set(free.effect, free.parameter.name, free.column, value)
        for (effect, parameter), value in part.known.items():
            arrays.set(effect, parameter, None, value)


def _moved(predicted: tuple[Floats, SettledShapes]) -> tuple[Floats, Floats, Floats]:
    """Return markers, states and tensions of a prediction, in the order of `Tangent`."""
    markers, settled = predicted
    return markers, settled.state, settled.tensions


def slope(before: Floats, after: Floats | None, step: float) -> Floats:
    """Return the slope of markers (P, J, 3) over a step; 0 without an equilibrium after it."""
    return np.zeros_like(before) if after is None else (after - before) / step


def stiffness_factors(free: FreeParameter, value: float, n: int) -> Floats:
    """Return the factors (n,) of the cells' stiffness by a parameter that is no effect."""
    if free.effect == TAPER:
        along = np.linspace(-1.0, 1.0, n) if free.parameter.name == 'slope' else np.ones(n)
        return np.asarray(np.exp(value * along))
    return np.where(np.arange(n) == free.column, np.exp(-value), 1.0)


def mean_inputs(dataset: DataSet) -> Floats:
    """Return the inputs (P, m) of the postures, the mean of the trials' where measured."""
    if dataset.trial_inputs is None:
        return np.array(dataset.inputs)
    measured = np.where(dataset.trial_mask[..., None], dataset.trial_inputs, np.nan)
    means = mean_over(measured, 1)
    return np.where(np.isfinite(means), means, dataset.inputs)


def frees_of(names: Iterable[str], catalogue: Catalogue, robot: Robot) -> Iterator[FreeParameter]:
    """Yield the free parameters of several effects."""
    for name in names:
        yield from free_parameters(catalogue[name], robot)
