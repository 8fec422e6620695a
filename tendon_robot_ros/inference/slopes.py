"""
How imperfections move the markers: derivatives of an arm as it is built.

By the implicit function theorem. The stiffness of a cell changes its own balance only, and so does
its bend at rest where the travel of tendons does not matter: one difference of residuals gives the
rates of all cells, and one elimination the responses of all bends. Where wire pulls are commanded,
tensions respond as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np

from ..common.arrays import Floats
from ..model.compile import LEAST_TENSION_N
from ..model.derivatives import HELD_RCOND, residuals, responses, shown
from ..model.shape import ShapeBatch
from .imperfections import (
    ACROSS,
    GAIN,
    HOLE,
    KINK,
    PLAUSIBLE_SIZES,
    POSITION,
    REMAINDER,
    REST,
    ROTATION,
    WEIGHT,
    Imperfections,
    Kind,
    Members,
    SplitPredictor,
    planar_axis,
    remainders,
)
from .predict import CELLS, Point, Predictor

STEP = 1e-6  # [1], [rad], [N] of differences without solving, because rounding is 1e-16


def imperfections(
    split: Predictor, point: Point, at: Members | None = None, changed: bool = False
) -> Imperfections | None:
    """
    Return the kinds and slopes of imperfections at a point, linearised around given ones (`at`).

    Of two recordings of an arm both have the same ones, which cancel; what remains is how far its
    deviations themselves have changed, which may be as much as they are. With `changed`,
    imperfections may be new. An arm that is no `SplitPredictor` is exact: it has none of any kind.
    None where the model has no equilibrium.
    """
    if not isinstance(split, SplitPredictor):
        return Imperfections.none(split.dataset)
    reference = split.dataset.reference
    kinds, split.around = split.kinds() if reference is None or changed else (), at or {}
    if split.markers(point) is None:
        return None
    if not kinds:
        moves = np.empty((0, len(split.inputs), len(split.dataset.markers), 3))
    elif split.model.friction_remembers or split.carries:
        moves = _differences(split, point, kinds)
    else:
        moves = _all_parts(split, [slopes.of(kinds) for slopes in _settled(split, point)])
    columns = remainders(split)
    allowed = 0.0 if reference is None else reference.error / np.sqrt(3.0)
    rest = Kind(REMAINDER, 'm', np.inf, tuple(map(str, range(len(columns)))), allowed=allowed)
    return Imperfections((*kinds, rest), np.concatenate([moves, columns]))


def pushes(split: SplitPredictor, point: Point, size: float) -> Floats | None:
    """
    Return the slopes of the markers by forces at every cell, (n, 3, P, J, 3) [m/N].

    None where the model has no equilibrium. `size` [N] is the step of the differences.
    """
    if split.markers(point) is None or split.model.remembers:
        return None
    moves = _all_parts(split, [slopes.by_forces(size) for slopes in _settled(split, point)])
    return moves.reshape(-1, 3, *moves.shape[1:])


def _settled(split: SplitPredictor, point: Point) -> Iterator[_Slopes]:
    """Yield the slopes at every part of the settled postures, the model as it is set there."""
    given, near = split.given(split.inputs), split.settled
    assert near is not None
    for part, shapes in split.settle(point, given, near=near):
        assert shapes is not None
        yield _Slopes(split, shapes, split.inputs[part.rows])


def _all_parts(split: SplitPredictor, parts: Sequence[Floats]) -> Floats:
    """Assemble the postures (q, b, J, 3) of all parts into (q, P, J, 3)."""
    moves = np.zeros((len(parts[0]), len(split.inputs), *parts[0].shape[2:]))
    for part, own in zip(split.parts, parts, strict=True):
        moves[:, split.predicted(part).rows] = own
    return moves


def _differences(split: SplitPredictor, point: Point, kinds: Sequence[Kind]) -> Floats:
    """Return central differences (q, P, J, 3) of the markers by the members of all kinds."""
    near, at = split.settled, split.around
    assert near is not None
    predict: Callable[[], Floats | None] = partial(split.markers, point, near=near)
    if not split.model.friction_remembers and split.visits is None:
        along = split.along_path(point, near)

        def predict() -> Floats:
            return along(point)[0]

    moves, zero = [], np.zeros((len(split.inputs), len(split.dataset.markers), 3))
    for kind in kinds:
        step, centre = PLAUSIBLE_SIZES[kind.name][2], at.get(kind.name, np.zeros(len(kind)))
        for unit in step * np.eye(len(kind)):
            sides = []
            for moved in (centre + unit, centre - unit):
                split.around = {**at, kind.name: moved}
                sides.append(predict())
            up, down = sides
            moves.append(zero if up is None or down is None else (up - down) / (2.0 * step))
    split.around = at
    return np.array(moves)


@dataclass(frozen=True)
class _Changes:
    """Derivatives by q variables at constant tensions."""

    markers: Floats  # (P, q, J, 3) [m]
    pulls: Floats  # (P, q, m) [m]


class _Slopes:
    """Derivatives at settled shapes."""

    def __init__(self, split: SplitPredictor, shapes: ShapeBatch, commanded: Floats) -> None:
        """Take the response (P, u, u) of the state to a residual, and slopes by each entry."""
        self.split, self.shapes, self.model = split, shapes, split.model
        self.state, self.commanded = np.ascontiguousarray(shapes.state), commanded
        self.cells = shapes.state.shape[1] // 3
        size = (3 if self.model.arrays.twists else 2) * self.cells
        rates = np.broadcast_to(np.eye(size, 3 * self.cells), (len(shapes), size, 3 * self.cells))
        self.fresh = self.model.arrays.fresh_memory()
        answers = responses(self.model, shapes.inputs, self.state, self.fresh, rates)
        self.answers = answers[..., :size]
        self.by_state = self._by_state()
        self.by_tension = self._by_tension()

    def of(self, kinds: tuple[Kind, ...]) -> Floats:
        """Return the derivatives (q, P, J, 3) by the members of all kinds."""
        parts, markers = [], self.split.see(self.shapes)
        for kind in kinds:
            if kind.name == POSITION:
                parts.append(np.array([np.ones_like(markers) * axis for axis in np.eye(3)]))
            elif kind.name == ROTATION:
                parts.append(np.array([np.cross(axis, markers) for axis in np.eye(3)]))
            else:
                parts.append(self.held(self.by_kind(kind)).swapaxes(0, 1))
        return np.concatenate(parts)

    def by_kind(self, kind: Kind) -> _Changes:
        """Return the derivatives by the members of a kind at constant tensions."""
        if kind.name == CELLS:
            return self.by_cells()
        if kind.name == HOLE:
            return self.by_holes()
        if kind.name in (KINK, ACROSS):
            return self.by_kinks(kind)
        given = np.nan_to_num(self.commanded)
        if self.split.dataset.input == 'tension':
            own = self.by_tension
            return _Changes(own.markers * given[..., None, None], own.pulls * given[..., None])
        sizes = given if kind.name == GAIN else np.ones_like(given)  # else the zeros of pulls
        commands = -np.eye(given.shape[1]) * sizes[:, None]  # a larger pull lowers the residual
        return _Changes(np.zeros_like(self.by_tension.markers), commands)

    def held(self, moved: _Changes) -> Floats:
        """Return derivatives (P, q, J, 3) of the markers; tensions adjust to commanded pulls."""
        if self.split.dataset.input == 'tension':
            return moved.markers
        markers = moved.markers.copy()
        for p, tensions in enumerate(self.shapes.inputs):
            taut = np.flatnonzero(tensions > LEAST_TENSION_N)
            by_tension = self.by_tension.pulls[p][np.ix_(taut, taut)]
            answer = -moved.pulls[p][:, taut] @ np.linalg.pinv(by_tension, rcond=HELD_RCOND)
            markers[p] += np.tensordot(answer, self.by_tension.markers[p, taut], 1)
        return markers

    def _shown(self, inputs: Floats, state: Floats) -> _Changes:
        """Return markers and pulls at inputs (b, m) [N] and states (b, 3n) [rad], not settled."""
        batch = shown(self.model, inputs, state)
        return _Changes(self.split.see(batch), batch.pulls)

    def _by_state(self) -> _Changes:
        """Return the derivatives by every entry of the state, tensions constant: (P, u, ...)."""
        b, size = self.answers.shape[:2]
        steps = STEP * np.eye(self.state.shape[1])[:size]
        moved = self.state[:, None] + np.concatenate([np.zeros((1, len(steps[0]))), steps])
        inputs = np.repeat(self.shapes.inputs, size + 1, axis=0)
        shown = self._shown(inputs, moved.reshape(-1, self.state.shape[1]))
        markers = shown.markers.reshape(b, size + 1, *shown.markers.shape[1:])
        pulls = shown.pulls.reshape(b, size + 1, -1)
        return _Changes(
            (markers[:, 1:] - markers[:, :1]) / STEP, (pulls[:, 1:] - pulls[:, :1]) / STEP
        )

    def _by_tension(self) -> _Changes:
        """Return the derivatives by every input tension: (P, m, ...) per N."""
        inputs, moved = self.shapes.inputs, []
        for unit in np.eye(inputs.shape[1]):
            up, down = inputs + STEP * unit, np.maximum(inputs - STEP * unit, 0.0)
            moved.append(self._difference(up, down, (up - down) @ unit))
        return _joined(moved)

    def by_holes(self) -> _Changes:
        """Return the derivatives by the relative radius of every tendon."""
        offset, inputs, moved = self.model.arrays.offset, self.shapes.inputs, []
        was, radii = offset.copy(), np.ones(offset.shape[1])
        radii += self.split.around.get(HOLE, 0.0)
        for k, radius in enumerate(radii):

            def arrange(side: float, k: int = k, radius: float = radius) -> None:
                offset[:, k] = was[:, k] * (radius + side * STEP) / radius

            moved.append(
                self._difference(inputs, inputs, np.full(len(inputs), 2.0 * STEP), arrange)
            )
            offset[:] = was
        return _joined(moved)

    def _difference(
        self,
        up: Floats,
        down: Floats,
        width: Floats,
        arrange: Callable[[float], None] = lambda side: None,
    ) -> _Changes:
        """Return a total derivative (P, 1, ...): by the response of bends, and the direct part."""
        sides = []
        for inputs, side in ((up, 1.0), (down, -1.0)):
            arrange(side)
            sides.append((self._residual(inputs), self._shown(inputs, self.state)))
        (rate, shown), (low, below) = sides
        along = self._along(((rate - low) / width[:, None])[:, None])
        markers = (shown.markers - below.markers) / width[:, None, None]
        pulls = (shown.pulls - below.pulls) / width[:, None]
        return _Changes(along.markers + markers[:, None], along.pulls + pulls[:, None])

    def by_forces(self, size: float) -> Floats:
        """Return the derivatives (3 n, P, J, 3) [m/N] by a force at every cell."""
        model, inputs = self.model, self.shapes.inputs
        arrays, effect = model.arrays, model.catalogue[WEIGHT]
        row = arrays.layout.rows[WEIGHT, effect.parameters[0].name]
        before, rates = self._residual(inputs), []
        gravity, values, on = arrays.gravity.copy(), arrays.values[row].copy(), arrays.on.copy()
        arrays.act(WEIGHT)
        for mass, axis in product(enumerate(arrays.cells[:, 2].tolist()), np.eye(3)):
            arrays.gravity[:] = axis
            arrays.values[row] = 0.0
            arrays.values[row, mass[0]] = size / mass[1]
            rates.append((self._residual(inputs) - before) / size)
        arrays.gravity[:], arrays.values[row], arrays.on[:] = gravity, values, on
        return self._along(np.stack(rates, axis=1)).markers.swapaxes(0, 1)

    def _residual(self, inputs: Floats) -> Floats:
        """Residual (P, u) [rad] at the settled states, with the present arrays of the model."""
        values = residuals(self.model, inputs, self.state, self.fresh)
        return values[:, : self.answers.shape[1]]

    def _along(self, rates: Floats) -> _Changes:
        """Return the derivatives through the state by rates (P, q, u) of the residual."""
        states, by = rates @ self.answers, self.by_state.markers
        markers = states @ by.reshape(*by.shape[:2], -1)
        return _Changes(
            markers.reshape(*states.shape[:2], *by.shape[2:]), states @ self.by_state.pulls
        )

    def _own(self, arrange: Callable[[float], None]) -> Floats:
        """Return rates (P, n, u) of the residual by a change of each cell's own bending."""
        sides = []
        for side in (1.0, -1.0):
            arrange(side)
            sides.append(self._residual(self.shapes.inputs))
        rates = (sides[0] - sides[1]) / (2.0 * STEP)
        own, n = np.zeros((len(rates), self.cells, rates.shape[1])), np.arange(self.cells)
        for xy in range(2):
            own[:, n, 2 * n + xy] = rates[:, 2 * n + xy]
        return own

    def by_cells(self) -> _Changes:
        """Return the derivatives by the relative stiffness of every cell."""
        stiffness = self.model.arrays.cells[:, 1]
        was, off = stiffness.copy(), 1.0 + self.split.around.get(CELLS, np.zeros(len(stiffness)))

        def arrange(side: float) -> None:
            stiffness[:] = was * (off + side * STEP) / off

        rates = self._own(arrange)
        stiffness[:] = was
        return self._along(rates)

    def by_kinks(self, kind: Kind) -> _Changes:
        """Return the derivatives by the bend at rest of every cell."""
        arrays, axis = self.model.arrays, planar_axis(self.split.whole)
        rests = self.split.rests
        if axis is not None:
            rests = [rests[axis if kind.name == KINK else 1 - axis]]
        values, on = arrays.values.copy(), arrays.on.copy()
        arrays.on[arrays.layout.index[REST]] = 1

        def kinked(side: float, row: int, cell: int | slice) -> None:
            arrays.values[row] = values[row]
            arrays.values[row, cell] += side * STEP

        if self.model.sticks or self.split.dataset.input == 'displacement':
            changes = self.by_each_kink(kinked, rests)
        else:
            every = slice(None)
            rates = [self._own(partial(kinked, row=row, cell=every)) for row in rests]
            each = np.stack(rates, axis=2)  # x and y of a cell one after the other
            changes = self._along(each.reshape(len(each), -1, each.shape[-1]))
        arrays.values[:], arrays.on[:] = values, on
        return changes

    def by_each_kink(self, kinked: Callable[..., None], rests: Sequence[int]) -> _Changes:
        """
        Return the derivatives by every kink, one at a time.

        Travel of tendons counts from the shape at rest: a kink changes the wire pull, and, where
        travel beyond an eyelet decides the direction of friction, the balance of other cells.
        """
        inputs = self.shapes.inputs
        width = np.full(len(inputs), 2.0 * STEP)
        moved = [
            self._difference(inputs, inputs, width, partial(kinked, row=row, cell=cell))
            for cell, row in product(range(self.cells), rests)
        ]
        return _joined(moved)


def _joined(moved: Sequence[_Changes]) -> _Changes:
    return _Changes(
        np.concatenate([one.markers for one in moved], axis=1),
        np.concatenate([one.pulls for one in moved], axis=1),
    )
