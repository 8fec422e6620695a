"""
Which posture to measure next: those that may be chosen, and which of them tells most.

Worth is the expected information about the effects that are in question. What the markers show
is taken as linear around the best guess, y = F theta + B b + noise: theta
are the parameters of the effects that are in question, b the imperfections of the arm as built and
the declared tolerances, both with their prior. A posture is worth the information that it adds
about theta with b unknown,

    1/2 log det(P' / P) - 1/2 log det(Pbb' / Pbb),

P the precision of theta and b, Pbb its block of b, primed with the posture (Bayesian D-optimal for
a subset, Chaloner and Verdinelli 1995). Effects that look alike in what was measured leave a
direction of theta unknown, so that the posture that separates them tells most; so does the one
that narrows a parameter, and one is chosen less where imperfections do what the effects do.

Once it is only an interval that is too wide, the widest one counts, which a volume may leave as it
is: worth is then 1/2 log(v / v'), v the largest variance of theta in units of the prior, whose
sizes are those that an interval is compared with.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError, NoEquilibriumError
from ..comparison.noise import Noise, Whitener, input_slopes
from ..comparison.predict import FreeParameter, Point, Predictor, frees_of
from ..data import DataSet
from ..diagnosis.candidates import nuisances_of
from ..diagnosis.imperfections import REMAINDER, SplitPredictor
from ..diagnosis.slopes import imperfections
from ..effects import Catalogue
from ..model.model import Model
from ..model.pulls import pull_shapes
from ..robot import Robot
from ..robot.estimates import natural_sizes
from ..robot.keep_out import KeepOut
from ..workspace.postures import default_postures
from .goal import Goal

Floats = npt.NDArray[np.float64]

# -----------------------------------------------------------------------------
# Postures that may be chosen: within tension, bend and the regions that are kept out.

POOL_POSTURES = 120
PULL_POSTURES = 40  # of wire pulls: those take longer
FRESH_SEED = 7919  # of the postures to verify on: none of the pool
WAY_POINTS = 16  # that are looked at on the way to a posture
MARGIN_SHARE = 0.05  # of the length: how far an arm may be from an untried model


@dataclass(frozen=True)
class Room:
    """Where the arm may be, and how far off the model may be that says where it is."""

    regions: KeepOut = field(default_factory=KeepOut)
    margin: float = 0.0  # [m]

    def keeps(self, points: Floats) -> bool:
        """
        Tell whether an arm keeps clear on a way (w, n, 3) [m] of its points, base first.

        The model may be off the more the farther from the base; between two steps of the way a
        point goes at most half of what it moved.
        """
        if not self.regions:
            return True
        off = self.margin * np.linspace(0.0, 1.0, points.shape[1])
        moved = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=0, initial=0.0)
        return bool((self.regions.distances(points) >= off + 0.5 * moved).all())


def pool(
    robot: Robot,
    goal: Goal,
    input: str,
    path: str,
    model: Model,
    room: Room,
    start: Floats | None = None,
) -> Floats:
    """
    Return postures (b, m) [N] or [m] that may be chosen.

    Parameters
    ----------
    robot : Robot
    goal : Goal
    input, path : str
        As of a data set.
    model : Model
        What is known of the arm now: says where it is at a posture.
    room : Room
    start : (m,), optional
        Where the arm comes from; default: it was let go.

    """
    count = PULL_POSTURES if input == 'displacement' else POOL_POSTURES
    singles = default_postures(robot, max(count // 5, 3), 0, input)
    rows = np.vstack(
        [singles, default_postures(robot, count - len(singles), 1 + goal.seed, input)]
    )
    if path == 'sequence':  # letting go is what shows a memory
        loops = default_postures(robot, count // 2, 2 + goal.seed, input, 'sequence')
        rows = np.vstack([rows, loops])
    return allowed(np.unique(rows, axis=0), goal, input, model, room, start)


def fresh(robot: Robot, goal: Goal, input: str, model: Model, room: Room) -> Floats:
    """Return allowed postures that no pool has, to verify on."""
    rows = default_postures(robot, 4 * goal.checks + 4, FRESH_SEED + goal.seed, input)
    return allowed(rows, goal, input, model, room)


def allowed(
    rows: Floats, goal: Goal, input: str, model: Model, room: Room, start: Floats | None = None
) -> Floats:
    """Return the postures whose tensions and whose shape, and the way to it, may be."""
    if input == 'tension':
        rows = rows[(rows <= goal.tension_max + 1e-9).all(axis=1)]
    elif np.isfinite(goal.tension_max):
        rows = np.array([row for row in rows if _pulls_gently(model, row, goal.tension_max)])
    rows = rows.reshape(-1, len(model.inputs))
    if not room.regions or not len(rows):
        return rows
    return rows[[_stays(model, row, input, room, start) for row in rows]]


def _pulls_gently(model: Model, pulls: Floats, most: float) -> bool:
    """Tell whether wire pulls take no more tension [N]."""
    try:
        return bool(model.pull_shape(pulls).inputs.max() <= most)
    except (NoEquilibriumError, InputError):
        return False


def _stays(model: Model, row: Floats, input: str, room: Room, start: Floats | None) -> bool:
    """Tell whether the arm keeps out on its straight way to a posture."""
    begin = model.limits[:, 0] if input == 'tension' else np.where(np.isnan(row), np.nan, 0.0)
    if start is not None:
        begin = start
    shares = np.linspace(0.0, 1.0, WAY_POINTS)[:, None]
    way = np.where(np.isnan(row), np.nan, begin + shares * (row - begin))
    try:
        shapes = model.shapes(way) if input == 'tension' else pull_shapes(model, way)
    except (NoEquilibriumError, InputError):
        return False
    points = np.concatenate([np.zeros((len(way), 1, 3)), shapes.positions], axis=1)
    return room.keeps(points)


# -----------------------------------------------------------------------------
# Which of them tells most.

STEP_SHARES = (0.3, 0.03)  # of a typical size, that a parameter moves for its derivative
WIDE = 3.0  # typical sizes of 1 sd that an effect in question may have


@dataclass(frozen=True)
class OpenQuestion:
    """What is not known yet."""

    effects: tuple[str, ...]  # that may act
    point: Point  # the best guess of their parameters; those that it lacks are as described
    noise: Noise
    narrows: bool = False  # it is their widest interval that is too wide, nothing else


@dataclass(frozen=True)
class Choice:
    """A posture worth measuring."""

    inputs: Floats  # (m,) [N] or [m]
    gain: float  # [nat] information about what is in question that it adds


def choose(
    question: OpenQuestion,
    measured: DataSet,
    pool: Floats,
    catalogue: Catalogue,
    count: int = 1,
) -> list[Choice]:
    """
    Choose the postures that tell most, one after the other.

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

    Raises
    ------
    NoEquilibriumError
        The model has no shape where it was measured.

    """
    design = _LinearDesign(question, measured, catalogue)
    offered, where = design.offered(pool)
    precision = np.eye(design.size)
    for rows in design.rows(measured) if len(measured.postures) else ():
        precision += rows.T @ rows
    choices = list[Choice]()
    left = list(range(len(offered)))
    for _ in range(min(count, len(left))):
        gains = [design.gain(precision, offered[i]) for i in left]
        best = left.pop(int(np.argmax(gains)))
        choices.append(Choice(pool[where[best]], float(max(gains))))
        precision += offered[best].T @ offered[best]
    return choices


class _LinearDesign:
    """The linear picture of a question: columns in units of their prior, effects first."""

    def __init__(self, question: OpenQuestion, measured: DataSet, catalogue: Catalogue) -> None:
        self.question, self.measured = question, measured
        self.robot: Robot = measured.robot
        self.catalogue = catalogue.sized(natural_sizes(self.robot))
        self.frees = tuple(dict.fromkeys(frees_of(question.effects, self.catalogue, self.robot)))
        self.size = 0

    def offered(self, pool: Floats) -> tuple[list[Floats], list[int]]:
        """Return what each posture of the pool shows, and which of them have an equilibrium."""
        as_if, shown = self._as_if(pool)
        predictor = Predictor(as_if, self.robot, self.catalogue)
        if predictor.markers(self.question.point) is None:
            if shown != slice(None):
                return [], []
            bad = {int(name) for name in predictor.unsettled()}
            keep = [i for i in range(len(pool)) if i not in bad]
            if len(keep) in (0, len(pool)):
                return [], []
            rows, where = self.offered(pool[keep])
            return rows, [keep[i] for i in where]
        rows = self.rows(as_if)[shown]
        return rows, list(range(len(pool)))

    def rows(self, dataset: DataSet) -> list[Floats]:
        """Return whitened derivatives (values, columns) for every posture of a data set."""
        point, predictor = self.question.point, Predictor(dataset, self.robot, self.catalogue)
        here = predictor.markers(point)
        if here is None:
            return []
        slopes = [
            self._prior(free, predictor) * self._slope(predictor, free, here)
            for free in self.frees
        ]
        slopes += [
            n.spread * self._slope(predictor, n.free, here)
            for n in nuisances_of(self.robot, self.catalogue, predictor)
        ]
        slopes += self._as_built(dataset)
        self.size = len(slopes)
        whitener = Whitener(dataset, self.question.noise, input_slopes(predictor, point))
        columns = np.array(slopes).reshape(len(slopes), len(here), -1)
        return [whitener.root(p) @ columns[:, p, rows].T for p, rows in enumerate(whitener.rows)]

    def gain(self, precision: Floats, rows: Floats) -> float:
        """Information [nat] about the effects that a posture adds to a precision."""
        k = len(self.frees)
        if self.question.narrows:
            before, after = (_largest(p, k) for p in (precision, precision + rows.T @ rows))
            return 0.5 * float(np.log(before / after))
        return 0.5 * (_added(precision, rows) - _added(precision[k:, k:], rows[:, k:]))

    def _as_if(self, pool: Floats) -> tuple[DataSet, slice]:
        """Return a data set of the pool as if measured, and which of its postures are the pool."""
        old, inputs, shown = self.measured, pool, slice(None)
        if old.path == 'sequence' and len(old.postures):
            last = np.broadcast_to(np.nan_to_num(old.inputs[-1]), pool.shape)
            inputs = np.stack([last, pool], axis=1).reshape(-1, pool.shape[1])
            shown = slice(1, None, 2)
        trials = max(old.positions.shape[1], 1)
        made = replace(
            old,
            postures=tuple(map(str, range(len(inputs)))),
            inputs=inputs,
            positions=np.zeros((len(inputs), trials, len(old.markers), 3)),
            orientations=None,
            trial_inputs=None,
            trial_names=(),
        )
        return made, shown

    def _prior(self, free: FreeParameter, predictor: Predictor) -> float:
        """Return 1 sd that a parameter in question may be off the guess."""
        value = self.question.point.get(free, predictor.value(free))
        return WIDE * max(free.parameter.typical, abs(value - free.parameter.neutral))

    def _slope(self, predictor: Predictor, free: FreeParameter, here: Floats) -> Floats:
        """Return the derivative (P, J, 3) [m per unit] of the markers by a parameter."""
        point, parameter = self.question.point, free.parameter
        value = point.get(free, predictor.value(free))
        for share in STEP_SHARES:
            step = share * parameter.typical
            if value + step > parameter.high:
                step = -step
            moved = predictor.markers({**point, free: value + step})
            if moved is not None:
                return (moved - here) / step
        return np.zeros_like(here)

    def _as_built(self, dataset: DataSet) -> list[Floats]:
        """Return what each imperfection of a plausible size does (P, J, 3) [m]."""
        if self.robot.exact:
            return []
        unmeasured = replace(dataset, positions=np.full_like(dataset.positions, np.nan))
        split = SplitPredictor(Predictor(unmeasured, self.robot, self.catalogue))
        built = imperfections(split, self.question.point)
        if built is None:
            return []
        sizes = [kind.plausible for kind in built.kinds if kind.name != REMAINDER]
        members = [len(kind) for kind in built.kinds if kind.name != REMAINDER]
        return list(built.moves * np.repeat(sizes, members)[:, None, None, None])


def _largest(precision: Floats, count: int) -> float:
    """Return the largest variance of the first so many."""
    units = np.eye(len(precision))[:, :count]
    return float(np.diag(np.linalg.solve(precision, units)).max())


def _added(precision: Floats, rows: Floats) -> float:
    """Return by how much the log determinant of a precision grows with rows."""
    if not precision.size:
        return 0.0
    middle = rows @ np.linalg.solve(precision, rows.T)
    return float(np.linalg.slogdet(np.eye(len(rows)) + middle)[1])
