"""How the arm came to its postures: from straight, one after the other, or in any order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ..common.words import digits, mm
from ..data import DataSet
from ..data.joining import divide
from ..data.recording.still_segments import Segment
from ..data.visits import split_by_order
from .columns import FloatArray

FROM_STRAIGHT, SEQUENCE, VISITS = 'from_straight', 'sequence', 'visits'
LET_GO_SHARE = 0.2  # [1] of the way from the lowest input to the smallest load, that is let go
LOADED_MIN = 3  # postures from which that is told
MOSTLY = 0.8  # [1] of the postures, before which the arm was let go: a few rests may be missed
APART_MIN_M = 3e-4  # [m] between trials, from which the way is said to count: a tracker's noise
APART_FROM_SAME = 2.0  # times what trials with the same way differ by

RESTED = (
    'every posture was loaded from the straight arm (path: from_straight); if the arm went from '
    'one posture to the next, say --path sequence (rounds in the same order) or --path visits '
    '(any order)'
)
NO_REST = (
    'from where the arm came to a posture is taken not to matter, though it did not rest between '
    'them: with friction it does; let it rest next time, or say --path sequence (rounds in the '
    'same order) or --path visits (any order)'
)
ROWS = 'every row was loaded from the straight arm; if not, say --path sequence or --path visits'
IN_ORDER = {
    SEQUENCE: 'every posture was reached from the one before, the first from the straight arm',
    VISITS: 'the arm went from posture to posture without letting go, first from the straight arm',
}


def way_assumed(
    path: str, rest: float, timed: bool, counts: Sequence[tuple[int, int, float]]
) -> str:
    """
    Say how the arm is taken to have come to its postures, and what to say if it did not.

    `counts` are of `let_go_between`, recording by recording.
    """
    if path != FROM_STRAIGHT:
        return IN_ORDER[path]
    if not timed:
        return ROWS
    return RESTED if rest or _was_let_go(counts) else NO_REST


def _was_let_go(counts: Sequence[tuple[int, int, float]]) -> bool:
    """Tell whether inputs were let go before most loaded postures, however short."""
    let_go, of = sum(count for count, _, _ in counts), sum(of for _, of, _ in counts)
    return of >= LOADED_MIN and let_go >= MOSTLY * of


def let_go_between(
    times: FloatArray, inputs: FloatArray, segments: Sequence[Segment], same: float
) -> tuple[int, int, float]:
    """
    Count the loaded segments before which all inputs were let go since the last loaded one.

    Parameters
    ----------
    times : (T,) [s]
    inputs : (T, m) [N] or [m]
        Of one recording.
    segments : sequence of Segment
        Of the same recording, in order.
    same : float
        [N] or [m] inputs that differ by less are the same.

    Returns
    -------
    count, of : int
    level : float
        [N] or [m] below which they were.

    """
    sizes = np.nan_to_num(inputs).max(axis=1)
    lowest = float(np.quantile(sizes, 0.01))
    own = np.array([np.nan_to_num(one.inputs).max() for one in segments])
    loaded = own > lowest + 3.0 * same
    if not loaded.any():
        return 0, 0, lowest
    level = lowest + max(same, LET_GO_SHARE * float(own[loaded].min() - lowest))
    there = [one for one, is_loaded in zip(segments, loaded, strict=True) if is_loaded]
    count = 0
    for before, after in pairwise(there):
        begin, end = np.searchsorted(times, [before.end, after.begin])
        count += bool(sizes[begin:end].min(initial=np.inf) < level)
    return count, len(there) - 1, level


def way_contradicted(path: str, counts: Sequence[tuple[int, int, float]], unit: str) -> list[str]:
    """Say that an arm that was let go before its postures did not come from one to the next."""
    if path == FROM_STRAIGHT or not _was_let_go(counts):
        return []
    let_go, of = sum(count for count, _, _ in counts), sum(of for _, of, _ in counts)
    level = max(level for _, _, level in counts)
    return [
        f'before {let_go} of {of} loaded postures all inputs were let go (below '
        f'{digits(level)} {unit}): the arm was loaded from straight every time; leave out '
        f'--path {path}'
    ]


def way_shows(segments: Sequence[Segment], begins: Sequence[int], places: FloatArray) -> list[str]:
    """
    Say that trials of a posture end elsewhere by the posture that the arm came from.

    Parameters
    ----------
    segments : sequence of Segment
        Named by posture, in order.
    begins : sequence of int
        Which of them are the first of a recording.
    places : (N, J, 3) [m]
        Their markers, in any frame.

    """
    origins = ['', *(one.posture for one in segments[:-1])]
    known = [i for i in range(len(segments)) if i not in begins]
    apart: dict[bool, list[float]] = {True: [], False: []}
    for count, i in enumerate(known):
        for j in known[:count]:
            if segments[i].posture == segments[j].posture:
                squares = np.sum((places[i] - places[j]) ** 2, axis=1)
                if np.isfinite(squares).any():
                    apart[origins[i] == origins[j]].append(float(np.nanmax(squares)))
    if not apart[False]:
        return []
    other = float(np.sqrt(np.median(apart[False])))
    same = float(np.sqrt(np.median(apart[True]))) if apart[True] else 0.0
    if other < max(APART_MIN_M, APART_FROM_SAME * same):
        return []
    beside = f', {mm(same)} where from the same one' if apart[True] else ''
    remedy = (
        'say --path visits'
        if apart[True]
        else 'but no posture was reached twice the same way, so that nothing would tell the noise '
        'of visits: measure rounds in the same order, or let it rest between'
    )
    return [
        f'trials of one posture are {mm(other)} apart where the arm came from different ones'
        f'{beside}, their inputs taken into account: the way counts; {remedy}'
    ]


def as_visits(dataset: DataSet, segments: Sequence[Segment], begins: Sequence[int]) -> DataSet:
    """
    Return the postures of a data set apart by the posture before, as visits in their order.

    Parameters
    ----------
    dataset : DataSet
        Of these segments: a posture per command, a trial per visit to it.
    segments, begins
        As of `way_shows`; the arm was straight before the first segment of every recording.

    """
    names = {name: i for i, name in enumerate(dataset.postures)}
    places = {name: i for i, name in enumerate(dataset.trial_names)}
    commands = np.array([names[one.posture] for one in segments])
    trials = np.array([places[one.trial] for one in segments])
    fresh = np.isin(np.arange(len(segments)), begins)
    measured = dataset.trial_mask[commands, trials]
    split = split_by_order(dataset.postures, commands, trials, measured, fresh)
    own = np.zeros((len(split.postures), len(dataset.trial_names)), dtype=bool)
    own[split.posture, trials] = True
    divided = divide(dataset, split, own)
    if dataset.position_noise is None and divided.trials.max(initial=0) < 2:
        squares = np.array([one.noise**2 for one in segments])
        if np.isfinite(squares).any():  # nothing was repeated: the frames have to tell it
            return replace(divided, position_noise=float(np.sqrt(np.nanmean(squares))))
    return divided


def frames_only(dataset: DataSet) -> list[str]:
    """Say that the noise is that of frames, where no posture was repeated on the same way."""
    known = dataset.position_noise is None or dataset.trials.max(initial=0) > 1
    if known or dataset.path == FROM_STRAIGHT:
        return []
    return [
        f'no posture was repeated the same way: the noise, {mm(dataset.position_noise, 2)}, is '
        "that of the tracker's frames alone, and trials differ by more; say position_noise in "
        'dataset.yaml, or measure rounds'
    ]
