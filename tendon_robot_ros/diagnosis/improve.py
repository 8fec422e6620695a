"""
Improve a description effect by effect, while the error on postures left out keeps falling.

On a real arm nothing is adequate and several effects are at work. `stepwise` lets them join one
after the other by the error on left-out postures; but an error that has chosen the effects is too
good. So the whole search is made again without each posture (or group of postures), and predicts
it: nested cross-validation. The error of these predictions after every step is what is reported.
How many steps are taken a search says by its own left-out errors: the last one that lowers them by
more than their scatter between postures.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError
from ..comparison.predict import Predictor
from ..data import DataSet
from ..effects import Catalogue, load_catalogue
from ..robot import Robot
from .add import Addition, more_at_work, with_origin
from .as_built import Imperfections, SplitPredictor
from .decide import P_SINGLE_MIN
from .described_arm import route_changes, stiffness_change
from .fit import Fit
from .improved_values import as_known
from .improvement import Improvement, ImprovementStep, total
from .load import loads_of
from .local_tests import local_faults
from .prediction_errors import Errors, predict
from .report_rows import left_out, values_of
from .slopes import imperfections
from .stepwise import POSTURES_MIN, STEPS_MAX, State, Stepwise

Floats = npt.NDArray[np.float64]
Progress = Callable[[str, int, int], None]
GROUPS_MAX = 16  # groups of postures that the search is made without


def improve(
    dataset: DataSet,
    robot: Robot | None = None,
    catalogue: Catalogue | None = None,
    check: DataSet | None = None,
    workers: int = 2,
    progress: Progress | None = None,
) -> Improvement:
    """
    Add effects one after the other while the error on left-out postures falls.

    Parameters
    ----------
    dataset : DataSet
    robot : Robot, optional
        Default: the data set's.
    catalogue : Catalogue, optional
    check : DataSet, optional
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
    show = progress or (lambda what, done, total: None)
    search = Stepwise(dataset, robot or dataset.robot, catalogue or load_catalogue())
    held = _held(search.dataset)
    most = STEPS_MAX * (1 + len(held))
    states = search.path(show=lambda k: show('searching', k, most))
    search.refuse_mistake(states[-1])
    paths = _paths(search, held, len(states), workers, show)
    return _result(search, states, *_predicted(search, paths, len(states)), check)


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


def fall(before: Floats, after: Floats) -> tuple[float, float]:
    """Return how far the rms falls between squared errors (P, J) of postures, and its scatter."""
    seen = np.isfinite(before).any(axis=1)
    old, new = (np.nanmean(squares[seen], axis=1) for squares in (before, after))
    width = float(np.sqrt(old.mean()) + np.sqrt(new.mean()))
    change = old - new
    scatter = float(change.std(ddof=1)) / np.sqrt(len(change))
    return float(change.mean()) / width, scatter / width


def last_worthwhile(errors: Floats) -> int:
    """
    Return the last step that lowers the error of what was taken before by more than its scatter.

    Parameters
    ----------
    errors : (K, P, J) [m²]
        Squared errors of the predictions of left-out postures after 0, 1, ... steps.

    """
    taken = 0
    for k in range(1, len(errors)):
        gain, scatter = fall(errors[taken], errors[k])
        if gain > scatter:
            taken = k
    return taken


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


def _together(states: Sequence[State]) -> tuple[str, tuple[str, ...]]:
    """Return what joined in some steps, taken as one, and what left of what was there before."""
    joined = [state.joined for state in states]
    left = [name for state in states for name in state.left]
    stayed = [name for name in joined if name and name not in left]
    return ' + '.join(stayed), tuple(name for name in left if name not in joined)


def _result(
    search: Stepwise,
    states: Sequence[State],
    errors: Floats,
    chosen: Floats,
    check: DataSet | None,
) -> Improvement:
    """Choose the steps that are taken, and write the description."""
    taken = how_many(states, errors)
    robots = [search.written(state) for state in states]
    kept = shown(errors, taken)
    steps = _steps(search, states, robots, errors, check, kept, taken)
    final, tips = states[taken], np.sqrt(errors[taken, :, -1])
    own = kept.index(taken)
    predictor, _ = predict(search.dataset, robots[taken], search.catalogue)
    exact = search.robot.exact
    built = None if exact else imperfections(SplitPredictor(predictor), {})
    known = as_known(search, final, predictor, built)
    made = _addition(search, steps[: own + 1], final, known, robots[taken], check)
    postures = search.dataset.postures
    return Improvement(
        robot=with_origin(made, search.robot),
        steps=steps,
        taken=own,
        chosen=np.sqrt(np.nanmean(chosen, axis=0)),
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
        local_faults=_faults(search, final, predictor, built),
        left_out=left_out(search.dataset, search.outliers, search.unsettled),
    )


def _steps(
    search: Stepwise,
    states: Sequence[State],
    robots: Sequence[Robot],
    errors: Floats,
    check: DataSet | None,
    kept: Sequence[int],
    taken: int,
) -> tuple[ImprovementStep, ...]:
    """Return the steps that are shown, with those before them that are not."""
    return tuple(
        ImprovementStep(
            *_together(states[begin + 1 : k + 1]),
            _errors(search.dataset, robots[k], search.catalogue),
            np.sqrt(np.nanmean(errors[k], axis=0)),
            None if check is None else _errors(check, robots[k], search.catalogue),
            *fall(errors[min(max(begin, 0), taken)], errors[k]),
        )
        for begin, k in zip([-1, *kept], kept, strict=False)
    )


def _errors(dataset: DataSet, robot: Robot, catalogue: Catalogue) -> Floats:
    """Return the rms error (J,) [m] of a description, just as it stands."""
    left = dataset.mean - predict(dataset, robot, catalogue)[1]
    return np.asarray(np.sqrt(np.nanmean((left**2).sum(axis=2), axis=0)))


def _addition(
    search: Stepwise,
    steps: Sequence[ImprovementStep],
    final: State,
    known: Fit,
    robot: Robot,
    check: DataSet | None,
) -> Addition:
    """Return what was added, with its errors, as descriptions hold it."""
    kind = 'left out' if check is None else 'check'
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
    chance = search.chance(final)
    more = more_at_work(fitted, chance) if chance <= P_SINGLE_MIN else ''
    loads, values = loads_of(known, search.predictor), values_of(known)
    return Addition(robot, values, fitted, judged, chance, {}, more, loads=loads)


def _faults(
    search: Stepwise, final: State, predictor: Predictor, built: Imperfections | None
) -> tuple[dict[str, Any], ...]:
    """Return where the improved description is wrong by more than what remains everywhere."""
    found = built or imperfections(SplitPredictor(predictor), {})
    if found is None:
        return ()
    faults = local_faults(
        found.kinds, found.moves, final.whitener, final.fit, search.noise.freedom
    )
    return tuple(fault.to_json(predictor.robot, search.dataset.postures) for fault in faults)
