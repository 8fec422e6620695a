"""
Improve a description effect by effect, while the error on postures left out keeps falling.

On a real arm nothing is adequate and several effects are at work. `stepwise` lets them join one
after the other by the error on left-out postures; but an error that has chosen the effects is too
good. So the whole search is made again without each posture (or group of postures), and predicts
it: nested cross-validation. The error of these predictions after every step is what is reported.
How many steps are taken a search says by its own left-out errors: the last one that lowers them by
more than their scatter between postures. The last step of all is the arm as it was found (cells,
inputs, the tracker's frame), where it lowers them as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError, NoEquilibriumError, Progress, listener, whole
from ..common.processes import one_thread
from ..comparison.predict import FreeParameter, Predictor
from ..data import DataSet, DataSetLike, load_dataset
from ..effects import Catalogue, CatalogueLike, load_catalogue
from ..robot import Robot, RobotLike, load_robot
from .add import Addition, fit_effects, more_at_work, settle, with_origin
from .crossval import (
    Errors,
    described_by,
    fall,
    last_worthwhile,
    left_out_markers,
    predict,
    written_markers,
)
from .description import OF_THE_ARM, route_changes, stiffness_change
from .fit import Fit, covariance_of
from .imperfections import POSITION, ROTATION, SplitPredictor
from .intervals import QUANTILE, loads_of, values_of
from .local_tests import faults_of, local_faults
from .report_rows import arm_report, left_out
from .result import AS_FOUND, Improvement, ImprovementStep, LoadVector, Value, total
from .session import Session
from .slopes import imperfections
from .stepwise import (
    POSTURES_MIN,
    PRIOR_TYPICALS,
    STEPS_MAX,
    Held,
    Joining,
    State,
    Stepwise,
    Ways,
    grown,
)
from .verdict import P_SINGLE_MIN, STRAY_SD_MAX

Floats = npt.NDArray[np.float64]
Values = dict[str, dict[str, Value]]
FRAME = (POSITION, ROTATION)
NO_FIT = (ArithmeticError, np.linalg.LinAlgError, NoEquilibriumError)
GROUPS_MAX = 16  # groups of postures that the search is made without


@dataclass(frozen=True)
class AsFound:
    """A state of a search, fitted again with the arm as it is built."""

    search: Stepwise
    state: State
    session: Session
    fit: Fit
    scale: float = 1.0  # chi² over freedom where the fit is not adequate

    @property
    def robot(self) -> Robot:
        """The description with the effects, and the arm as it was found."""
        return described_by(self.session, self.fit, beside=True)

    @cached_property
    def markers(self) -> Floats:
        """What that description predicts (P, J, 3) [m]; nan without equilibrium."""
        shown = written_markers(self.session.fitters[0], self.fit, self.fit.values)
        return np.full_like(self.fit.markers, np.nan) if shown is None else shown

    @property
    def squares(self) -> Floats:
        """Squared errors (P, J) [m²] of that description."""
        return np.asarray(((self.search.measured - self.markers) ** 2).sum(axis=2))

    @cached_property
    def left_out(self) -> Floats:
        """Squared errors (P, J) [m²] of postures left out in turn, of those that it knows."""
        shown = left_out_markers(self.session.fitters[0], self.fit)
        squares = ((self.search.measured - shown) ** 2).sum(axis=2)
        squares[list(self.session.held)] = np.nan
        return np.asarray(squares)

    @property
    def is_worthwhile(self) -> bool:
        """Whether it lowers the left-out error of its search by more than that scatters."""
        before = self.state.left_out[:, None]
        told = np.isfinite(self.left_out[np.isfinite(before[:, 0])]).any(axis=1)
        if not (told.all() and np.isfinite(self.markers).all()):
            return False  # a posture has no equilibrium
        gain, scatter = fall(before, self.left_out)
        return gain > scatter

    @property
    def scatter(self) -> dict[str, Any] | None:
        """The scatter of the arm, as reports read it."""
        return arm_report(self.session, self.fit)

    @property
    def local_faults(self) -> tuple[dict[str, Any], ...]:
        """Where it is still wrong by more than what remains everywhere."""
        return tuple(faults_of(self.session, self.fit))

    @cached_property
    def values(self) -> Values:
        """Values of the effects, with 95 % intervals; the arm itself may change where it did."""
        made = values_of(self._freed, self.scale, self._freed.covariance)
        for free in self.state.effects.frees:
            if (found := self._with_its_like(free)) is not None:
                made.setdefault(free.effect, {})[free.key] = found
        return made

    def _with_its_like(self, free: FreeParameter) -> Value | None:
        """
        Return a parameter of the frame with the imperfection that it stands for, if there is one.

        Where both are in the fit only their sum is told.
        """
        fit, built = self.fit, self.fit.built
        names = [] if built is None else [kind.name for kind in built.kinds]
        if (
            built is None
            or free.parameter.tolerance not in FRAME
            or free.parameter.tolerance not in names
        ):
            return None
        k = names.index(free.parameter.tolerance)
        mix, size = built.random.mixtures[k]['xyz'.index(free.parameter.name[-1])], built.sizes[k]
        ahead = np.zeros(len(fit.values))
        ahead[len(fit.all_frees) + np.flatnonzero(built.random.owners == k)] = size * mix
        value = float(ahead @ fit.values)
        if free in fit.frees:
            ahead[fit.frees.index(free)] = 1.0
            value += float(fit.values[fit.frees.index(free)])
        else:
            value += self.session.predictor.value(free)
        variance = float(ahead @ fit.covariance @ ahead) + float(size**2 * (1.0 - mix @ mix))
        half = QUANTILE * math.sqrt(self.scale * max(variance, 0.0))
        return Value(value, value - half, value + half, free.parameter.unit)

    @cached_property
    def _freed(self) -> Fit:
        """The fit with what joined of the arm itself as further parameters."""
        fit = self.fit
        for joining in self._ways_of_the_arm():
            frees = joining.block.frees
            spread = np.array([PRIOR_TYPICALS * free.parameter.typical for free in frees])
            residual, jacobian = grown(fit, joining, np.zeros(len(frees)), spread)
            fit = replace(fit, residual=residual, jacobian=jacobian)
        return fit

    def _ways_of_the_arm(self) -> list[Joining]:
        """Return how the stiffness along the arm and the routes that joined move the markers."""
        blocks = [block for block in self.state.blocks if block.label in OF_THE_ARM]
        if not blocks:
            return []
        whitener = self.session.whitener
        off = whitener.white(self.search.measured - self.state.fit.markers)
        return list(
            Ways(self.search.predictor, whitener, replace(self.state.fit, residual=off)).of(blocks)
        )

    @property
    def loads(self) -> dict[str, LoadVector]:
        """Size and direction of the effects that are forces."""
        known = self._freed.covariance
        return loads_of(self._freed, self.session.predictor, self.scale, known)

    @property
    def values_of_the_search(self) -> Values:
        """Values that the search has found; their intervals are those of here and hold them."""
        point, found = self.state.fit.point, Values()
        for free in self.state.effects.frees:
            own, value = self.values[free.effect][free.key], point[free]
            moved = replace(own, value=value, low=min(own.low, value), high=max(own.high, value))
            found.setdefault(free.effect, {})[free.key] = moved
        return found

    @property
    def loads_of_the_search(self) -> dict[str, LoadVector]:
        """Forces that the search has found; the covariance knows how far they are from these."""
        values = np.array([self.state.fit.point[free] for free in self.fit.frees])
        q, off = len(values), values - self.fit.values[: len(values)]
        spread = self.scale * self._freed.covariance[:q, :q] + np.outer(off, off)
        moved = replace(self.fit, values=values)
        return loads_of(moved, self.session.predictor, covariance=spread)


def as_found(search: Stepwise, state: State) -> AsFound | None:
    """Fit what a search found again; None where that has no equilibrium."""
    session, names = _session(search, state)
    try:
        session.weigh({})
        found = settle(session, names, {})
    except NO_FIT:
        return None
    return AsFound(search, state, session, _as_plausible(session, found.fit), found.scale)


def as_found_without(
    search: Stepwise, state: State, held: Held, by_accuracy: bool
) -> AsFound | None:
    """Fit what a search found again that does not know some postures; weighed by a rule."""
    session, names = _session(search, state)
    session.held, session.use_accuracy = held, by_accuracy
    try:
        session.weigh({})
        fit = fit_effects(session, names, {})
    except NO_FIT:
        return None
    return AsFound(search, state, session, _as_plausible(session, fit))


def of_the_search(state: State) -> Fit:
    """Return the effects of a state, as far as the search tells their values: of an exact arm."""
    spread = covariance_of(state.fit.jacobian)
    own = np.flatnonzero([free.effect not in OF_THE_ARM for free in state.fit.frees])
    jacobian = np.linalg.inv(np.linalg.cholesky(spread[np.ix_(own, own)]))
    effects = tuple(state.fit.frees[i] for i in own)
    nothing = np.zeros(len(own))
    return replace(state.fit, frees=effects, values=state.fit.values[own], residual=nothing,
                   jacobian=jacobian)  # fmt: skip


def _session(search: Stepwise, state: State) -> tuple[Session, list[str]]:
    """
    Return a session of the description with what was found, and the effects that it fits.

    A frame that is off by no more than any tracker's is no effect but an imperfection: free, it
    would take the errors of kinks, whose size would then be estimated as too small.
    """
    robot, before = search.written(state), search.robot
    names = [name for block in state.blocks for name in block.names if name not in OF_THE_ARM]
    frame = [free for free in state.fit.frees if free.parameter.tolerance in FRAME]
    if frame and not set(FRAME) & set(before.tolerances):
        sizes = {kind.name: kind.plausible for kind in SplitPredictor(search.predictor).kinds()}
        off = [
            (state.fit.point[free] - search.predictor.value(free))
            / sizes[free.parameter.tolerance]
            for free in frame
        ]
        name = frame[0].effect
        if np.abs(off).max() <= STRAY_SD_MAX:
            names.remove(name)
            robot = robot.without_effect(name)
            if name in before.effects:
                robot = robot.with_effect(name, before.effects[name], before.fitted.get(name))
    return Session(search.dataset, robot, search.catalogue, workers=1), names


def _as_plausible(session: Session, fit: Fit) -> Fit:
    """
    Return a fit whose imperfections are as large as is plausible, where they are not larger.

    Several effects that were chosen by the same measurements take from the imperfections what
    those did: their estimated sizes are too small, and so would the intervals be.
    """
    if fit.built is None:
        return fit
    usual = np.nan_to_num(fit.built.random.plausible, posinf=0.0)
    fitter = session.fitters[0]
    fitter.resume(fit)
    return fitter.fit(fit.frees, fit.point, sizes=np.maximum(fit.built.sizes, usual))


@one_thread()
def improve(
    dataset: DataSetLike,
    robot: RobotLike | None = None,
    catalogue: CatalogueLike | None = None,
    check: DataSetLike | None = None,
    workers: int = 2,
    progress: Progress | None = None,
) -> Improvement:
    """
    Add effects one after the other while the error on left-out postures falls.

    Parameters
    ----------
    dataset : DataSet, path, or a list of these
        As `load_dataset` takes them.
    robot : Robot, name, path, text or dict, optional
        Default: the data set's.
    catalogue : Catalogue or paths, optional
    check : DataSet or path, optional
        Other postures, whose error is shown at every step; they have no part in anything.
    workers : int
        Threads.
    progress : callable, optional
        Called with (what, done, total).

    Raises
    ------
    InputError
        Fewer than four postures, nothing tells the noise, or a mistake of the set-up explains the
        error: that is to be mended first.
    NoEquilibriumError

    """
    show = listener(progress)
    dataset, workers = load_dataset(dataset), whole('workers', workers, 1)
    before = dataset.robot if robot is None else load_robot(robot)
    other = None if check is None else load_dataset(check, before)
    search = Stepwise(dataset, before, load_catalogue(catalogue))
    held = _held(search.dataset)
    most = STEPS_MAX * (1 + len(held))
    states = search.path(show=lambda k: show('searching', k, most))
    search.refuse_mistake(states[-1])
    paths = _paths(search, held, len(states), workers, show)
    errors, chosen = _predicted(search, paths, len(states))
    way = _Way(search, states, errors, how_many(states, errors), chosen)
    if not search.robot.exact:
        way = replace(way, found=as_found(search, way.final))
    if way.found is not None and way.found.is_worthwhile:
        way = _with_the_arm(way, way.found, paths, workers)
    return _result(way, other)


@dataclass(frozen=True)
class _Way:
    """The steps of a search, and the errors of those that did not know some postures."""

    search: Stepwise
    states: list[State]
    errors: Floats  # (K, P, J) [m²] after every step
    taken: int
    chosen: Floats  # (P, J) [m²] where the number of steps was chosen without them as well
    found: AsFound | None = None  # the arm after the steps that are taken; None: it is exact
    last: Floats | None = None  # (P, J) [m²] with the arm as found; None: not tried
    arm_taken: bool = False  # whether the arm as it was found is the last step

    @property
    def final(self) -> State:
        """The last step that is taken, the arm as it was found apart."""
        return self.states[self.taken]


def _held(dataset: DataSet) -> list[npt.NDArray[np.int64]]:
    """Return groups of postures to leave out; those of the same inputs go together."""
    seen = np.flatnonzero(dataset.trials > 0)
    groups = np.unique(dataset.groups[seen])
    if len(groups) < POSTURES_MIN:
        raise InputError(
            f'{dataset.name}: {len(groups)} different inputs, expected {POSTURES_MIN} or more'
        )
    folds = min(GROUPS_MAX, len(groups))
    return [seen[np.isin(dataset.groups[seen], groups[fold::folds])] for fold in range(folds)]


def _paths(
    search: Stepwise,
    held: Sequence[npt.NDArray[np.int64]],
    steps: int,
    workers: int,
    show: Progress,
) -> list[tuple[npt.NDArray[np.int64], list[State]]]:
    """Return the way of a search that does not know them, for every group of postures."""
    done = steps

    def work(worker: int) -> list[tuple[npt.NDArray[np.int64], list[State]]]:
        nonlocal done
        own, found = search.again(), []
        for group in held[worker::workers]:
            found.append((group, own.path(group)))
            done += steps
            show('searching without some postures', done, steps * (1 + len(held)))
        return found

    with ThreadPoolExecutor(workers) as pool:
        return [one for found in pool.map(work, range(workers)) for one in found]


def _predicted(
    search: Stepwise, paths: Sequence[tuple[npt.NDArray[np.int64], list[State]]], count: int
) -> tuple[Floats, Floats]:
    """
    Return squared errors [m²] of predictions by searches that did not know the posture.

    Returns
    -------
    errors : (K, P, J)
        After 0, 1, ... steps.
    chosen : (P, J)
        After as many steps as the search itself would take, without the posture.

    """
    errors = np.full((count, *search.measured.shape[:2]), np.nan)
    chosen = np.full(errors.shape[1:], np.nan)
    for group, path in paths:
        own = [((search.measured - state.fit.markers) ** 2).sum(axis=2)[group] for state in path]
        for k in range(count):
            errors[k, group] = own[min(k, len(path) - 1)]
        chosen[group] = own[last_worthwhile(inner(path))]
    return errors, chosen


def inner(states: Sequence[State]) -> Floats:
    """Return the squared errors (K, P, 1) [m²] by which a search chooses, postures left out."""
    return np.array([state.left_out[:, None] for state in states])


def how_many(states: Sequence[State], errors: Floats) -> int:
    """
    Choose how many steps are written: by the errors of the search itself, as each search did.

    Never further than lowers the error (K, P, J) of the searches that did not know the posture.
    """
    most = last_worthwhile(inner(states))
    return int(np.argmin(np.nanmean(errors[: most + 1], axis=(1, 2))))


def shown(errors: Floats, taken: int) -> list[int]:
    """
    Return which steps are shown: of those taken only such as lower the left-out error.

    A step that needs a later one to help is shown with that one; `errors` (K, P, J) [m²].
    """
    squares = np.nanmean(errors, axis=(1, 2))
    kept = [0]
    for k in range(1, taken + 1):
        if k == taken or squares[taken] < squares[k] < squares[kept[-1]]:
            kept.append(k)
    return [*kept, *range(taken + 1, len(squares))]


def _with_the_arm(
    way: _Way, found: AsFound, paths: Sequence[tuple[npt.NDArray[np.int64], list[State]]],
    workers: int,
) -> _Way:  # fmt: skip
    """
    Judge the arm as it was found as a last step, by searches that did not know the posture.

    Every search takes it by its own left-out errors, as any other step. That of all postures
    does; it is written where the error of the column falls as well.
    """
    search, by_accuracy = way.search, found.session.use_accuracy
    last, chosen = way.errors[way.taken].copy(), way.chosen.copy()

    def work(worker: int) -> None:
        for held, path in paths[worker::workers]:
            own, k = last_worthwhile(inner(path)), min(way.taken, len(path) - 1)
            there = as_found_without(search, path[k], held, by_accuracy)
            if there is not None and np.isfinite(there.markers[held]).all():
                last[held] = there.squares[held]
            if own != k:
                there = as_found_without(search, path[own], held, by_accuracy)
            if there is not None and there.is_worthwhile:
                chosen[held] = there.squares[held]

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, range(workers)))
    lower = float(np.nanmean(last)) < float(np.nanmean(way.errors[way.taken]))
    return replace(way, last=last, chosen=chosen, arm_taken=lower)


def _together(states: Sequence[State]) -> tuple[str, tuple[str, ...]]:
    """Return what joined in some steps, taken as one, and what left of what was there before."""
    joined = [state.joined for state in states]
    left = [name for state in states for name in state.left]
    stayed = [name for name in joined if name and name not in left]
    return ' + '.join(stayed), tuple(name for name in left if name not in joined)


def _result(way: _Way, check: DataSet | None) -> Improvement:
    """Write the description, and say how the error fell."""
    search, states, final = way.search, way.states, way.final
    robots = [search.written(state) for state in states]
    kept = shown(way.errors, way.taken)
    steps = _steps(way, robots, check, kept)
    own = kept.index(way.taken)
    errors, robot = way.errors[way.taken], robots[way.taken]
    if way.last is not None and way.found is not None:
        step = _arm_step(way, way.last, way.found.robot, check)
        place = own + 1 if way.arm_taken else len(steps)
        steps = (*steps[:place], step, *steps[place:])
        if way.arm_taken:
            own, errors, robot = place, way.last, way.found.robot
    predictor, markers = predict(search.dataset, robot, search.catalogue)
    made = _addition(way, steps[: own + 1], robot, markers, check)
    postures, tips = search.dataset.postures, np.sqrt(errors[:, -1])
    return Improvement(
        robot=with_origin(made, search.robot),
        steps=steps,
        taken=own,
        chosen=np.sqrt(np.nanmean(way.chosen, axis=0)),
        values=made.values,
        loads=made.loads,
        profile=stiffness_change(search.robot, final.fit.point),
        routes=route_changes(final.fit.point),
        markers=tuple(marker.name for marker in search.dataset.markers),
        data=search.dataset.name,
        check='' if check is None else check.name,
        noise_floor=search.plain.floor(),
        probability=made.probability,
        more_at_work=made.more_at_work,
        tips={postures[p]: float(tips[p]) for p in np.flatnonzero(np.isfinite(tips))},
        local_faults=_faults(way, predictor),
        left_out=left_out(search.dataset, search.outliers, search.unsettled),
        as_built=way.found.scatter if way.found is not None and way.arm_taken else None,
    )


def _steps(
    way: _Way, robots: Sequence[Robot], check: DataSet | None, kept: Sequence[int]
) -> tuple[ImprovementStep, ...]:
    """Return the steps that are shown, with those before them that are not."""
    return tuple(
        _step(way, _together(way.states[begin + 1 : k + 1]), robots[k], check,
              way.errors[min(max(begin, 0), way.taken)], way.errors[k])
        for begin, k in zip([-1, *kept], kept, strict=False)
    )  # fmt: skip


def _arm_step(way: _Way, last: Floats, robot: Robot, check: DataSet | None) -> ImprovementStep:
    """Return the arm as it was found as a step."""
    return _step(way, (AS_FOUND, ()), robot, check, way.errors[way.taken], last)


def _step(
    way: _Way,
    what: tuple[str, tuple[str, ...]],
    robot: Robot,
    check: DataSet | None,
    before: Floats,
    after: Floats,
) -> ImprovementStep:
    """Return a step with its errors, those left out (P, J) [m²] before and after it."""
    search = way.search
    return ImprovementStep(
        *what,
        _errors(search.dataset, robot, search.catalogue),
        np.sqrt(np.nanmean(after, axis=0)),
        None if check is None else _errors(check, robot, search.catalogue),
        *fall(before, after),
    )


def _errors(dataset: DataSet, robot: Robot, catalogue: Catalogue) -> Floats:
    """Return the rms error (J,) [m] of a description, just as it stands."""
    left = dataset.mean - predict(dataset, robot, catalogue)[1]
    return np.asarray(np.sqrt(np.nanmean((left**2).sum(axis=2), axis=0)))


def _addition(
    way: _Way,
    steps: Sequence[ImprovementStep],
    robot: Robot,
    markers: Floats,
    check: DataSet | None,
) -> Addition:
    """Return what was added, with its errors, as descriptions hold it."""
    search, kind = way.search, 'left out' if check is None else 'check'
    floor, count = search.plain.floor(), int((search.dataset.trials > 0).sum())
    first, last = steps[0], steps[-1]
    fitted = Errors(
        'fitted', search.dataset.name, count, total(first.fitted), total(last.fitted), floor
    )
    judged = Errors(
        kind,
        search.dataset.name if check is None else check.name,
        count if check is None else int((check.trials > 0).sum()),
        total(first.errors[kind]),
        total(last.errors[kind]),
        floor if check is None else None,
    )
    fit = replace(way.final.fit, markers=markers)
    chance = search.chance(replace(way.final, fit=fit))
    more = more_at_work(fitted, chance) if chance <= P_SINGLE_MIN else ''
    values, loads = _known(way)
    return Addition(
        robot, values, fitted, judged, chance, {}, more, beside=way.arm_taken, loads=loads
    )


def _known(way: _Way) -> tuple[dict[str, dict[str, Value]], dict[str, LoadVector]]:
    """Return the values and loads that are written, with their intervals."""
    if way.found is None:
        known = of_the_search(way.final)
        return values_of(known), loads_of(known, way.search.predictor)
    if way.arm_taken:
        return way.found.values, way.found.loads
    return way.found.values_of_the_search, way.found.loads_of_the_search


def _faults(way: _Way, predictor: Predictor) -> tuple[dict[str, Any], ...]:
    """Return where the improved description is wrong by more than what remains everywhere."""
    if way.found is not None and way.arm_taken:
        return way.found.local_faults
    found = imperfections(SplitPredictor(predictor), {})
    if found is None:
        return ()
    search, final = way.search, way.final
    faults = local_faults(
        found.kinds, found.moves, final.whitener, final.fit, search.noise.freedom
    )
    return tuple(fault.to_json(predictor.robot, search.dataset.postures) for fault in faults)
