"""
The next posture to measure: the allowed ones, and the most informative of them.

The value of a posture is the expected information about the effects in question. The markers are
linearised about the current estimate, y = F theta + B b + noise: theta are the parameters of the
effects in question, b the imperfections of the arm as built and the declared tolerances, both with
their prior. The value of a posture is the information that it adds about theta with b unknown,

    1/2 log det(P' / P) - 1/2 log det(Pbb' / Pbb),

where P is the precision of theta and b, Pbb its block of b, and a prime marks the values with the
posture (Bayesian D-optimality for a subset, Chaloner and Verdinelli 1995). Effects with the same
displacements in the measured postures leave a direction of theta undetermined, so that a posture
which separates them has the highest value; a posture in which imperfections act like the effects
has a low one.

If only an interval is still too wide, the determinant may decrease without narrowing the widest
interval. The value is then 1/2 log(v / v'), with v the largest variance of theta in units of its
prior, to which the goal compares the intervals.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError, NoEquilibriumError, TendonRobotError
from ..common.estimation import STEP_LENGTHS
from ..data import DataSet
from ..diagnosis.next_measurement import as_if_measured
from ..diagnosis.stepwise import PRIOR_TYPICALS
from ..effects import Catalogue
from ..inference.candidates import nuisances_of
from ..inference.imperfections import BuiltPredictor, member_moves
from ..inference.noise import Noise, Whitener, input_slopes
from ..inference.predict import FreeParameter, Point, Predictor, frees_of
from ..model.model import Model
from ..model.pulls import pull_shapes
from ..robot import Robot
from ..robot.estimates import natural_sizes
from ..robot.keep_out import KeepOut
from ..workspace.postures import default_postures
from .goal import Goal

# [1] postures to choose from; a third of these of wire pulls, because each is a search
POOL_POSTURES = 120
# [1] places on the path to a posture at which the arm has to keep clear of regions; between two of
# them a point may come closer by half of its motion, so that more places leave more room
PATH_POINTS = 16


@dataclass(frozen=True)
class Room:
    """The keep-out regions of the arm, and the error of the model that predicts its place."""

    regions: KeepOut = field(default_factory=KeepOut)
    margin: float = 0.0  # [m]

    def keeps(self, points: Floats) -> bool:
        """
        Return whether an arm keeps clear on a path (w, n, 3) [m] of its points, base first.

        The model may be off the more the farther from the base; between two places of the path a
        point leaves both by at most half of the distance between them.
        """
        off = self.margin * np.linspace(0.0, 1.0, points.shape[1])
        moved = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=0, initial=0.0)
        return bool((self.regions.distances(points) >= off + 0.5 * moved).all())

    def refuse_inside(self, positions: Floats) -> None:
        """
        Refuse a posture in which a marker (..., 3) [m] was seen in a region that is kept out.

        Raises
        ------
        TendonRobotError

        """
        clear = self.regions.clearance(positions[np.isfinite(positions).all(axis=-1)])
        if clear.distance < 0.0:
            raise TendonRobotError(
                f'a marker was seen {1e3 * -clear.distance:.1f} mm inside {clear.region}, where '
                'the model says that it is not: the arm was released; look at the robot, and at '
                'where the tracker says its base is'
            )


def pool(model: Model, goal: Goal, room: Room, measured: DataSet) -> Floats:
    """
    Return postures (b, m) [N] or [m] that may be chosen.

    Parameters
    ----------
    model : Model
        What is known of the arm now: says where it is at a posture.
    goal : Goal
    room : Room
    measured : DataSet
        What was measured already.

    """
    robot, input = model.robot, measured.input
    count = POOL_POSTURES // 3 if input == 'displacement' else POOL_POSTURES
    rows = [default_postures(robot, max(count // 5, 3), 0, input)]
    rows.append(default_postures(robot, count - len(rows[0]), 1, input))
    if measured.path == 'sequence':  # letting go is what shows a memory
        rows.append(default_postures(robot, count // 2, 2, input, 'sequence'))
    every = np.unique(np.vstack(rows), axis=0)
    return allowed(every, goal, input, model, room, coming_from(measured))


def coming_from(measured: DataSet) -> Floats | None:
    """Return the inputs (m,) from which the arm goes to the next posture; None: it was let go."""
    in_turn = measured.path == 'sequence' and len(measured.postures)
    return measured.inputs[-1] if in_turn else None


def fresh(robot: Robot, goal: Goal, input: str, model: Model, room: Room) -> Floats:
    """Return allowed postures outside the pool of this goal, for verification."""
    rows = default_postures(robot, 4 * goal.checks + 4, 3, input)
    return allowed(rows, goal, input, model, room)


def allowed(
    rows: Floats, goal: Goal, input: str, model: Model, room: Room, start: Floats | None = None
) -> Floats:
    """Return the postures whose tensions and shape are allowed, and the path to it."""
    if input == 'tension':
        rows = rows[(rows <= goal.tension_max + 1e-9).all(axis=1)]
    elif np.isfinite(goal.tension_max):
        tensions = [_tension_of(model, row) for row in rows]
        rows = rows[np.array(tensions) <= goal.tension_max]
    rows = rows.reshape(-1, len(model.inputs))
    if not room.regions or not len(rows):
        return rows
    return rows[[_keeps_out(model, row, input, room, start) for row in rows]]


def _tension_of(model: Model, pulls: Floats) -> float:
    """Return the highest tension [N] of wire pulls; infinite without an equilibrium."""
    try:
        return float(model.pull_shape(pulls).inputs.max())
    except (NoEquilibriumError, InputError):
        return np.inf


def _keeps_out(model: Model, row: Floats, input: str, room: Room, start: Floats | None) -> bool:
    """Return whether the arm keeps out of the regions on its straight path to a posture."""
    if start is None:
        start = model.limits[:, 0] if input == 'tension' else np.zeros_like(row)
    fractions = np.linspace(0.0, 1.0, PATH_POINTS)[:, None]
    try:
        if np.isnan(start).any():  # a slack wire begins as long as the arm needs it there
            start = np.where(np.isnan(start), model.pull_shape(start).pulls, start)
        path = np.where(np.isnan(row), np.nan, start + fractions * (row - start))
        shapes = model.shapes(path) if input == 'tension' else pull_shapes(model, path)
    except (NoEquilibriumError, InputError):
        return False
    points = np.concatenate([np.zeros((len(path), 1, 3)), shapes.positions], axis=1)
    return room.keeps(points)


@dataclass(frozen=True)
class OpenQuestion:
    """The effects in question, and the current estimate of their parameters."""

    effects: tuple[str, ...]  # that may act
    point: Point  # estimates of their parameters; the others have their described values
    noise: Noise
    narrows: bool = False  # only their widest interval is still too wide


def choose(
    question: OpenQuestion, measured: DataSet, pool: Floats, catalogue: Catalogue, count: int = 1
) -> list[tuple[Floats, float]]:
    """
    Choose the most informative postures, one after the other.

    Parameters
    ----------
    question : OpenQuestion
    measured : DataSet
        What was measured already; its robot is the description that is judged. No posture of it
        may be measured yet.
    pool : (b, m) [N] or [m]
        Postures that may be chosen. Of a sequence each is judged as the next one.
    catalogue : Catalogue
    count : int
        How many; of a sequence one at a time is exact, the later ones are taken as coming after
        the same posture.

    Returns
    -------
    list
        Inputs (m,) [N] or [m], and the information [nat] that they add about what is in question.

    Raises
    ------
    NoEquilibriumError
        The model has no shape where it was measured.

    """
    design = LinearDesign(question, measured, catalogue)
    pool, offered = design.offered(pool) if len(pool) else (pool, [])
    if not offered:
        return []
    precision = np.eye(offered[0].shape[1])
    for rows in design.rows(measured) if len(measured.postures) else ():
        precision += rows.T @ rows
    choices = list[tuple[Floats, float]]()
    remaining = list(range(len(offered)))
    for _ in range(min(count, len(remaining))):
        gains = [design.gain(precision, offered[i]) for i in remaining]
        best = remaining.pop(int(np.argmax(gains)))
        choices.append((pool[best], float(max(gains))))
        precision += offered[best].T @ offered[best]
    return choices


class LinearDesign:
    """The linearised model of a question: columns in units of their prior, effects first."""

    def __init__(self, question: OpenQuestion, measured: DataSet, catalogue: Catalogue) -> None:
        self.question, self.measured = question, measured
        self.robot: Robot = measured.robot
        self.catalogue = catalogue.sized(natural_sizes(self.robot))
        self.frees = tuple(dict.fromkeys(frees_of(question.effects, self.catalogue, self.robot)))

    def offered(self, pool: Floats) -> tuple[Floats, list[Floats]]:
        """Return the postures of a pool that have an equilibrium, and their whitened rows."""
        old = self.measured
        trials = max(old.positions.shape[1], 1)
        as_if, shown = as_if_measured(old, pool, coming_from(old), trials)
        predictor = Predictor(as_if, self.robot, self.catalogue)
        if predictor.markers(self.question.point) is None:
            each = 1 if shown == slice(None) else 2  # with the one before it
            bad = {int(name) // each for name in predictor.unsettled(self.question.point)}
            keep = [i for i in range(len(pool)) if i not in bad]
            return self.offered(pool[keep]) if 0 < len(keep) < len(pool) else (pool[:0], [])
        return pool, self.rows(as_if)[shown]

    def rows(self, dataset: DataSet) -> list[Floats]:
        """Return whitened derivatives (values, columns) for every posture of a data set."""
        point, predictor = self.question.point, Predictor(dataset, self.robot, self.catalogue)
        if (markers := predictor.markers(point)) is None:
            return []
        slopes = []
        for free in self.frees:
            offset = abs(point.get(free, predictor.value(free)) - free.parameter.neutral)
            prior = PRIOR_TYPICALS * max(free.parameter.typical, offset)
            slopes.append(prior * self._slope(predictor, free, markers))
        slopes += [
            n.spread * self._slope(predictor, n.free, markers)
            for n in nuisances_of(self.robot, self.catalogue, predictor)
        ]
        arm = BuiltPredictor(predictor)
        if not self.robot.exact and arm.markers(point) is not None:
            kinds = arm.kinds(every=False)
            sizes = np.repeat([kind.plausible for kind in kinds], [len(kind) for kind in kinds])
            slopes += list(member_moves(arm, point, kinds) * sizes[:, None, None, None])
        whitener = Whitener(dataset, self.question.noise, input_slopes(predictor, point))
        white = whitener.white(np.array(slopes))
        return [white[:, whitener.owners == p].T for p in range(len(markers))]

    def gain(self, precision: Floats, rows: Floats) -> float:
        """Information [nat] about the effects that a posture adds to a precision."""
        k = len(self.frees)
        if self.question.narrows:
            units = np.eye(len(precision))[:, :k]
            before, after = (
                np.diag(np.linalg.solve(one, units)).max()
                for one in (precision, precision + rows.T @ rows)
            )
            return 0.5 * float(np.log(before / after))
        return 0.5 * (information(precision, rows) - information(precision[k:, k:], rows[:, k:]))

    def _slope(self, predictor: Predictor, free: FreeParameter, markers: Floats) -> Floats:
        """Return the derivative (P, J, 3) [m per unit] of the markers by a parameter."""
        point = self.question.point
        value = point.get(free, predictor.value(free))
        # a long step, so that laws with a threshold show; shorter where there is no equilibrium
        for fraction in STEP_LENGTHS[1:]:
            step = free.parameter.step(value, fraction)
            if (moved := predictor.markers({**point, free: value + step})) is not None:
                return (moved - markers) / step
        return np.zeros_like(markers)


def information(precision: Floats, rows: Floats) -> float:
    """Return the increase of the log determinant of a precision by additional rows."""
    middle = rows @ np.linalg.solve(precision, rows.T)
    return float(np.linalg.slogdet(np.eye(len(rows)) + middle)[1])
