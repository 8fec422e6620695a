"""
Undeclared imperfections of an arm as built, the model of an arm with them, and its derivatives.

Cells scatter in stiffness or are kinked at rest, tensions, holes and the frame of the tracker
deviate a little. Imperfections are the same in every posture. A cell (or tendon) is a column: the
derivative of all markers by its imperfection.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from ..common.arrays import RESOLUTION, Floats, Ints
from ..data import DataSet
from ..model.derivatives import Entries, Move
from ..model.shape import ShapeBatch
from ..robot.description import planar_axis
from .predict import CELLS, Conditions, Point, Predictor, SettledShapes

KINK, ACROSS, GAIN, HOLE = 'cell_kink', 'cell_kink_across', 'channel_gain', 'hole_radius'
ZERO, POSITION, ROTATION = 'pull_zero', 'position', 'rotation'
# Kinds that also differ from recording to recording, since zeros are found and trackers are placed
# anew -> the kind of these differences
ANEW = {kind: f'{kind}_anew' for kind in (ZERO, POSITION, ROTATION)}
EARLIER = 'earlier'  # what an earlier recording leaves open of all kinds, in unit normals
REMAINDER = 'remainder'  # error without a cause, independent in every posture
# Those of few members, or of known size
KINDS_WITH_FEW_MEMBERS = (GAIN, HOLE, ZERO, POSITION, ROTATION, *ANEW.values(), EARLIER)
REMAINDER_SHAPES = 4  # [1] along the arm, because the others have a twentieth of the variance
# Kind -> (unit, plausible sd where none is declared, step of its derivative)
PLAUSIBLE_SIZES: dict[str, tuple[str, float, float]] = {
    CELLS: ('1', 0.03, 0.01),
    KINK: ('rad', math.radians(0.1), 1e-3),
    ACROSS: ('rad', math.radians(0.1), 1e-3),
    GAIN: ('1', 0.01, 5e-3),
    HOLE: ('1', 0.01, 1e-2),
    ZERO: ('m', 2e-4, 1e-4),
    POSITION: ('m', 5e-4, 1e-3),
    ROTATION: ('rad', math.radians(0.3), 1e-3),
}
PLAUSIBLE_SIZES |= {anew: PLAUSIBLE_SIZES[kind] for kind, anew in ANEW.items()}
PLAUSIBLE_LENGTH = 0.2  # [m] of an arm; of a longer one lengths grow because its parts do
STEP = 1e-6  # [1], [rad], [m] of differences without solving, because rounding is 1e-16
BEND_MAX_RAD = 0.5  # [rad] of one cell, else the whole arm would be wrong: docs/inference.md
REST = 'pre_curvature'  # the effect whose parameters are the bends at rest
Members = Mapping[str, Floats]  # kind -> size of each of its members


@dataclass(frozen=True)
class Kind:
    """One kind of imperfection; its members share one standard deviation."""

    name: str
    unit: str
    plausible: float  # scale of the prior of that standard deviation [unit]
    members: tuple[str, ...]
    beside: float = 0.0  # sd [unit] of imperfections with the same influence; widens intervals
    allowed: float = 0.0  # sd [unit] of a remainder up to which nothing is missing

    def __len__(self) -> int:
        """Return the number of members."""
        return len(self.members)


@dataclass(frozen=True)
class Imperfections:
    """The kinds of imperfections of a data set, and the slopes of the markers by each member."""

    kinds: tuple[Kind, ...]
    moves: Floats  # (q, P, J, 3) [m per unit], the members of all kinds one after the other

    @classmethod
    def none(cls, dataset: DataSet) -> Imperfections:
        """Return those of an exact arm."""
        return cls((), np.zeros((0, *dataset.mean.shape)))

    @cached_property
    def owners(self) -> Ints:
        """Index (q,) of the kind of each column."""
        lengths = np.array([len(kind) for kind in self.kinds], dtype=np.int64)
        return np.repeat(np.arange(len(self.kinds)), lengths)

    def moved(self, members: Members) -> Floats | float:
        """Return the change of the markers (P, J, 3) [m] by members, linear by these slopes."""
        if not members:
            return 0.0
        own = [kind for kind in self.kinds if kind.name != REMAINDER]  # it is the last
        sizes = np.concatenate([members.get(kind.name, np.zeros(len(kind))) for kind in own])
        return np.asarray(np.tensordot(sizes, self.moves[: len(sizes)], 1))

    def growing(self, distances: Floats, steady: float) -> Imperfections:
        """
        Return them with a remainder that grows with the distances (P,) of postures from straight.

        `steady` [1] is its sd in a straight posture, relative to the rms over all postures, which
        stays.
        """
        mean = max(float((distances**2).mean()), RESOLUTION**2)
        factors = np.sqrt(steady**2 + (1.0 - steady**2) * distances**2 / mean)
        own = self.owners == len(self.kinds) - 1
        moves = np.where(own[:, None, None, None], factors[:, None, None] * self.moves, self.moves)
        return Imperfections(self.kinds, moves)


def remainders(predictor: Predictor) -> Floats:
    """
    Return columns (q, P, J, 3) of a remainder of 1 m sd at the tip, posture by posture.

    An error that grows along the arm like a random walk, as of a `Whitener`: its
    `REMAINDER_SHAPES` principal shapes in each direction.
    """
    dataset = predictor.dataset
    positions = dataset.arc_lengths / predictor.robot.length
    values, shapes = np.linalg.eigh(np.minimum.outer(positions, positions))
    shapes = (shapes * np.sqrt(np.maximum(values, 0.0)))[:, ::-1][:, :REMAINDER_SHAPES]
    P, J, q = len(dataset.postures), shapes.shape[0], shapes.shape[1]
    columns = np.zeros((P, q, 3, P, J, 3))
    for p in np.flatnonzero(dataset.trials > 0):
        for xyz in range(3):
            columns[p, :, xyz, p, :, xyz] = shapes.T
    return columns[dataset.trials > 0].reshape(-1, P, J, 3)


class BuiltPredictor(Predictor):
    """A predictor of the arm with the imperfections `around`; without any, as described."""

    def __init__(self, predictor: Predictor) -> None:
        """Build the model of a predictor again."""
        super().__init__(predictor.dataset, predictor.robot, predictor.model.catalogue)
        self.axis = planar_axis(self.robot)
        self._offsets = self.model.arrays.offset.copy()
        self._recordings = np.zeros(len(self.inputs), dtype=int)  # (P,) index of the part
        for i, part in enumerate(self.parts):
            self._recordings[part.rows] = i
        self._recording = 0  # that the model is set to
        layout, effect = self.model.arrays.layout, self.model.catalogue[REST]
        self.rests = [layout.rows[REST, parameter.name] for parameter in effect.parameters]

    @property
    def members(self) -> Members:
        """The imperfections `around`, those of an earlier recording by their kinds."""
        own, reference = self.around.get(EARLIER), self.dataset.reference
        if own is None or reference is None:
            return self.around
        rest = {name: sizes for name, sizes in self.around.items() if name != EARLIER}
        return rest | {name: root @ own for name, root in reference.spread.items()}

    def kinds(self, every: bool = True) -> tuple[Kind, ...]:
        """
        Return the kinds of imperfections; a declared registration is a parameter of the fit.

        Unless `every` is asked for, an arm that is described as exact has declared kinds only.
        Under tensions misplaced holes act like gains. They widen intervals but not the test of an
        effect, because both rarely add up; a declared gain includes them.
        """
        cells = self.robot.cell_names
        axis = self.axis
        kinks = [f'{cell} towards {xy}' for cell in cells for xy in 'xy']
        labels = {CELLS: list(cells), KINK: kinks}
        if axis is not None:
            labels |= {KINK: kinks[axis::2], ACROSS: kinks[1 - axis :: 2]}
        labels[GAIN] = list(self.robot.inputs)  # under tensions, holes act as gains too
        if self.dataset.input == 'displacement':
            labels |= {HOLE: [t.name for t in self.robot.tendons], ZERO: list(self.robot.inputs)}
        recordings = [part.name for part, _ in self.dataset.divided]
        anew = {name: list('xyz') for name in (POSITION, ROTATION) if len(recordings) > 1}
        if ZERO in labels and (anew or self.dataset.reference is not None):
            anew[ZERO] = labels[ZERO]  # a tracker that was moved since a reference is named
        for name, own in anew.items():
            labels[ANEW[name]] = [f'{one} in {where}' for where in recordings for one in own]
        known = self.robot.tolerances
        labels |= {name: list('xyz') for name in (POSITION, ROTATION) if name not in known}
        if self.robot.exact and not every:
            labels = {name: labels[name] for name in (CELLS,) if name in known}
        described = {ACROSS: KINK} | {anew: kind for kind, anew in ANEW.items()}
        kinds, larger = [], max(self.robot.length / PLAUSIBLE_LENGTH, 1.0)
        for name, members in labels.items():
            unit, plausible, _ = PLAUSIBLE_SIZES[name]
            usual = plausible * (larger if unit == 'm' else 1.0)
            size = float(known.get(described.get(name, name), usual))
            if size > 0.0:
                holes = name == GAIN and name not in known and self.dataset.input == 'tension'
                beside = float(known.get(HOLE, PLAUSIBLE_SIZES[HOLE][1])) if holes else 0.0
                kinds.append(Kind(name, unit, size, tuple(members), beside))
        return tuple(kinds)

    def set_parameters(self, point: Point, part: Conditions) -> None:
        """Set the parameters and imperfections; see `Predictor.set_parameters`."""
        off, arrays, axis = self.members, self.model.arrays, self.axis
        super().set_parameters(point, part)
        self._recording = int(self._recordings[part.rows[0]])
        arrays.cells[:, 1] *= 1.0 + off.get(CELLS, 0.0)
        arrays.offset[:] = self._offsets * (1.0 + off.get(HOLE, np.zeros(1))[None, :, None])
        kinks = np.zeros((self.robot.cells, 2))  # [rad] bends at rest
        if axis is None:
            kinks += off.get(KINK, kinks).reshape(-1, 2)
        else:
            kinks[:, axis], kinks[:, 1 - axis] = off.get(KINK, 0.0), off.get(ACROSS, 0.0)
        if kinks.any():
            arrays.values[self.rests, : len(kinks)] += kinks.T
            arrays.on[arrays.layout.index[REST]] = 1

    def member(self, name: str, i: int, part: Conditions) -> Move:
        """Return the move of member i of a kind of `around`; the model is set to a point."""
        arrays, own, axis, sides = self.model.arrays, self.around[name], self.axis, (STEP, -STEP)
        if name in (KINK, ACROSS):
            cell, xy = divmod(i, 2) if axis is None else (i, axis if name == KINK else 1 - axis)
            entries = Entries.shifted(arrays.values, (self.rests[xy], cell), sides)
            return Move(*sides, (entries,), REST)
        if name in (CELLS, HOLE):
            array, which = arrays.cells, np.s_[i : i + 1, 1:2]
            if name == HOLE:
                array, which = arrays.offset, np.s_[0 : len(arrays.offset), i : i + 1]
            entries = Entries.shifted(array, which, sides, array[which] / (1.0 + own[i]))
            return Move(*sides, (entries,))
        move = Move(*sides, (Entries.shifted(own, [i], sides),), beside=True)
        if name != GAIN or self.dataset.input != 'tension':
            return move
        rows, tensions = self.predicted(part).rows, list[Floats]()
        for side in (True, False):
            with move.applied(self.model, side):
                tensions.append(self.given(self.inputs)[rows])
        return Move(*sides, tensions=np.array(tensions))

    def given(self, inputs: Floats) -> Floats:
        """Return the inputs (P, m) [N] or [m] that reach the arm."""
        off = self.members
        zeros = self._in_recordings(ZERO, inputs.shape[1])[self._recordings]
        return np.asarray(inputs * (1.0 + off.get(GAIN, 0.0)) + zeros)

    def see(self, shapes: ShapeBatch) -> Floats:
        """Return the markers (b, J, 3) [m] in the frame of the tracker, with its imperfections."""
        placed = super().see(shapes)
        x, y, z = self._in_recordings(ROTATION, 3)[self._recording].tolist()
        across = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # p @ it: turn x p
        if across.any():
            placed = placed + (placed.reshape(-1, 3) @ across).reshape(placed.shape)
        return np.asarray(placed + self._in_recordings(POSITION, 3)[self._recording])

    def _in_recordings(self, kind: str, count: int) -> Floats:
        """Return the sizes (recordings, count) of a kind that may differ between recordings."""
        off, none = self.members, np.zeros((len(self.parts), count))
        anew = off.get(ANEW[kind], none)
        if anew.size != none.size:  # found in other recordings
            anew = none
        return none + off.get(kind, 0.0) + anew.reshape(none.shape)


def imperfections(
    arm: Predictor,
    point: Point,
    at: Members | None = None,
    changed: bool = False,
    near: SettledShapes | None = None,
) -> Imperfections | None:
    """
    Return the kinds and slopes of imperfections at a point, linearised around given ones (`at`).

    Of two recordings of an arm both have the same ones, which cancel but for what the earlier one
    leaves open: it decides how the arm answers a change. What is set anew in each of several new
    recordings stands beside it, and how far the deviations of the arm have changed themselves,
    which may be as much as they are. With `changed`, imperfections may be
    new. An arm that is no `BuiltPredictor` is exact: it has none of any kind.
    None where the model has no equilibrium, which is looked for from `near`.
    """
    if not isinstance(arm, BuiltPredictor):
        return Imperfections.none(arm.dataset)
    reference = arm.dataset.reference
    kinds, arm.around = arm.kinds(changed), at or {}
    if reference is not None and not changed:
        count = max((root.shape[1] for root in reference.spread.values()), default=0)
        between = (kind for kind in kinds if kind.name in ANEW.values())
        earlier = [Kind(EARLIER, '1', 1.0, tuple(map(str, range(count))))] if count else []
        kinds = (*earlier, *between)
    if arm.markers(point, near=near) is None:
        return None
    moves = member_moves(arm, point, kinds)
    columns = remainders(arm)
    allowed = 0.0 if reference is None else reference.error / np.sqrt(3.0)
    rest = Kind(REMAINDER, 'm', np.inf, tuple(map(str, range(len(columns)))), allowed=allowed)
    return Imperfections((*kinds, rest), np.concatenate([moves, columns]))


def between_recordings(arm: BuiltPredictor, near: SettledShapes | None) -> Imperfections | None:
    """
    Return what several recordings differ in as set anew for each: zeros and the tracker's frame.

    Their mean belongs to the description, so that the slopes by a member are those of its
    difference from the mean of all recordings; see `from_mean`. Of one recording, and of an exact
    arm, there is nothing.
    None where the model has no equilibrium, which is looked for from `near`.
    """
    count, around = len(arm.dataset.divided), arm.around
    every = arm.kinds(every=False) if count > 1 else ()
    kinds = tuple(kind for kind in every if kind.name in ANEW.values())
    if not kinds:
        return Imperfections.none(arm.dataset)
    if arm.markers({}, near=near) is None:
        return None
    moves = np.split(member_moves(arm, {}, kinds), np.cumsum([len(kind) for kind in kinds])[:-1])
    arm.around = around
    return Imperfections(kinds, np.concatenate([_from_mean(own, count) for own in moves]))


def from_mean(members: Members, recordings: int) -> Members:
    """Return how far what was set anew in each of so many recordings differs from their mean."""
    anew = ((kind, members[kind]) for kind in ANEW.values() if kind in members)
    return {kind: _from_mean(own, recordings) for kind, own in anew}


def _from_mean(rows: Floats, recordings: int) -> Floats:
    """Return rows (q, ...), those of one recording after the other, less their mean."""
    each = rows.reshape(recordings, -1, *rows.shape[1:])
    return np.asarray(each - each.mean(axis=0)).reshape(rows.shape)


def member_moves(arm: BuiltPredictor, point: Point, kinds: Sequence[Kind]) -> Floats:
    """
    Return the slopes (q, P, J, 3) [m per unit] of the markers by all members of kinds.

    At the postures that were predicted last, linearised around the imperfections set.
    """
    reference = arm.dataset.reference
    if reference is not None and EARLIER in (kind.name for kind in kinds):
        own = [kind for kind in arm.kinds() if kind.name in reference.spread]
        root = np.concatenate([reference.spread[kind.name] for kind in own])
        around, arm.around = arm.around, arm.members
        each = member_moves(arm, point, [*own, *kinds[1:]])  # of the reference they come first
        arm.around = around
        return np.concatenate([np.tensordot(root.T, each[: len(root)], 1), each[len(root) :]])
    named = [(kind.name, i, len(kind)) for kind in kinds for i in range(len(kind))]
    if not named:
        return np.empty((0, len(arm.inputs), len(arm.dataset.markers), 3))
    if arm.model.friction_remembers or arm.carries:
        return _differences(arm, point, named)
    arm.around = {k.name: np.zeros(len(k)) + arm.around.get(k.name, 0.0) for k in kinds}

    def moves(part: Conditions) -> list[Move]:
        return [arm.member(name, i, part) for name, i, _ in named]

    slopes = arm.tangent_by(moves, point).markers
    # a singular equilibrium has no slope: no member moves a marker by the length of the arm
    sizes = np.array([PLAUSIBLE_SIZES[name][1] for name, _, _ in named])
    reach = sizes[:, None] * np.sqrt(np.square(slopes).sum(axis=3)).max(axis=2)
    slopes[reach > arm.robot.length] = 0.0
    return slopes


def forces_along(
    predictor: Predictor, point: Point, effect: str, step: float, arc_lengths: Floats
) -> Floats:
    """
    Return the slopes (n, 3, P, J, 3) [m/N] of the markers by forces at n places [m].

    By an effect of a force at a place, with a step [N] to both sides, at the postures that were
    predicted last.
    """
    arrays = predictor.model.arrays
    first = arrays.layout.rows[effect, 'arc_length']  # the components of the force follow
    place_row, *force_rows = np.repeat(np.eye(4), arrays.values.shape[1], axis=1)

    def moves(part: Conditions) -> list[Move]:
        which = np.s_[first : first + 4]
        entries = [
            Entries.shifted(arrays.values, which, (step, -step), row, about=place * place_row)
            for place in arc_lengths
            for row in force_rows
        ]
        return [Move(step, -step, (one,), effect) for one in entries]

    slopes = predictor.tangent_by(moves, point).markers
    return slopes.reshape(-1, 3, *slopes.shape[1:])


def _differences(
    arm: BuiltPredictor, point: Point, named: Sequence[tuple[str, int, int]]
) -> Floats:
    """Return central differences (q, P, J, 3) of the markers by members of kinds."""
    near, at = arm.settled, arm.around
    assert near is not None
    predict: Callable[[], Floats | None] = partial(arm.markers, point, near=near)
    if arm.dataset.input == 'tension' or not arm.model.friction_remembers:
        along = arm.along_path(point, near)

        def predict() -> Floats:
            return along(point)[0]

    moves, zero = [], np.zeros((len(arm.inputs), len(arm.dataset.markers), 3))
    for name, i, count in named:
        step, centre, sides = PLAUSIBLE_SIZES[name][2], at.get(name, np.zeros(count)), []
        for side in (step, -step):
            arm.around = {**at, name: centre + side * np.eye(count)[i]}
            sides.append(predict())
        up, down = sides
        moves.append(zero if up is None or down is None else (up - down) / (2.0 * step))
    arm.around = at
    return np.array(moves)
