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

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError
from ..common.given import Progress, listener, whole
from ..common.processes import one_thread
from ..comparison.predict import Predictor
from ..data import DataSet, DataSetLike, load_dataset
from ..effects import Catalogue, CatalogueLike, load_catalogue
from ..robot import Robot, RobotLike, load_robot
from .add import Addition, more_at_work, with_origin
from .as_built import SplitPredictor
from .as_found import AsFound, as_found, as_found_without, of_the_search
from .decide import P_SINGLE_MIN
from .described_arm import route_changes, stiffness_change
from .improvement import AS_FOUND, Improvement, ImprovementStep, total
from .load import loads_of
from .local_tests import local_faults
from .prediction_errors import Errors, fall, last_worthwhile, predict
from .report_rows import left_out, values_of
from .result import LoadVector, Value
from .slopes import imperfections
from .stepwise import POSTURES_MIN, STEPS_MAX, State, Stepwise

Floats = npt.NDArray[np.float64]
GROUPS_MAX = 16  # groups of postures that the search is made without


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
