"""
Faults of trackers: invalid readings, markers that are renumbered or exchanged.

For a hidden marker trackers and their exports write an empty cell or NaN, 0 0 0, a value outside
any workspace (-3.697e28 by NDI, 9999999, -9999), or the last visible position again. A marker that
was lost may return under another number, and from some frame on two markers may be exchanged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from ..common.arrays import Bools, Floats, Ints
from ..common.words import listed, listing
from .arrays import CHANCE_PROBABILITY, PLAUSIBLE_FACTOR, SAMPLES_MIN
from .bag_reader import Recording

UNSEEN_M = 1e3  # [m] farther away there is no marker, because no tracker sees so far
# [1] of its frames, that a marker may share with the one it is numbered anew as, because a tracker
# that finds it again needs some frames to drop the old number
SHARED_FRAMES_MAX = 0.01
# [1] of the steps of two markers, below which exchanged columns explain them, because an arm moves
# by less than the distance of two markers from frame to frame
CROSSED_FRACTION_MAX = 0.3

# why a reading is none
ZERO = 'exactly 0, 0, 0'
SENTINEL = 'a number that stands for "not seen"'
HELD = 'the last place, repeated exactly while other markers change'


def is_missing(places: Floats) -> Bools:
    """Return which positions (..., 3) [m] are no marker: not finite, 0 0 0, or too far away."""
    with np.errstate(invalid='ignore'):
        within = (np.abs(places) < UNSEEN_M).all(axis=-1)  # False for NaN
    return np.asarray(~within | (places == 0.0).all(axis=-1))


def without_unseen(
    positions: Floats, length: float | None, news: Bools | None = None
) -> tuple[Floats, dict[str, Ints]]:
    """
    Replace invalid readings by NaN, and count them by reason.

    Parameters
    ----------
    positions : (T, J, 3) [m]
        Frames of J markers.
    length : float or None [m]
        Of the arm; None: the unit of the positions is not known yet.
    news : (T - 1,), optional
        At which steps from frame to frame markers changed that are not among these.

    Returns
    -------
    positions : (T, J, 3)
    counts : dict of (J,)
        By why, of each marker; what was no number to begin with is not counted.

    """
    numbers = np.isfinite(positions).all(axis=2)
    none = is_missing(positions)
    zero = numbers & (positions == 0.0).all(axis=2)
    cleaned = np.where(none[..., None], np.nan, positions)
    sentinel = (numbers & none & ~zero) | _is_sentinel(cleaned, length)
    cleaned[sentinel] = np.nan
    held = _held(cleaned, news)
    cleaned[held] = np.nan
    masks = {ZERO: zero, SENTINEL: sentinel, HELD: held}
    return cleaned, {why: mask.sum(axis=0) for why, mask in masks.items() if mask.any()}


def unseen_lines(counts: dict[str, Ints], labels: Sequence[str]) -> list[str]:
    """Describe how many readings of which markers are excluded, and why."""
    lines = []
    for why, count in counts.items():
        of = np.flatnonzero(count)
        names = listed(labels[j] for j in of.tolist())
        whose = '' if len(of) == len(labels) > 1 else f' of {names}'
        lines.append(f'{int(count.sum()):,} marker readings{whose} are none: {why}')
    return lines


def _is_sentinel(positions: Floats, length: float | None) -> Bools:
    """Return which readings (T, J) are an exactly repeated value that cannot lie on this arm."""
    visible = np.isfinite(positions[..., 0])
    marked = np.zeros(visible.shape, dtype=bool)
    if not visible.any():
        return marked
    places = positions[visible]
    odd = (places == places[:, :1]).all(axis=1)  # such as -1, -1, -1
    if length is not None:
        distance = np.linalg.norm(places - np.median(places, axis=0), axis=1)
        far = distance > PLAUSIBLE_FACTOR * length
        odd |= far if far.mean() < 0.5 else False  # most are in another unit
    if odd.any():
        _, which, times = np.unique(places[odd], axis=0, return_inverse=True, return_counts=True)
        odd[odd] = times[which.ravel()] > 1
        marked[visible] = odd
    return marked


def changes(positions: Floats) -> Bools:
    """Return at which steps (T - 1, J) the positions (T, J, 3) of visible markers change."""
    visible = np.isfinite(positions[..., 0])
    return np.asarray((visible[1:] & visible[:-1]) & (positions[1:] != positions[:-1]).any(axis=2))


def _held(positions: Floats, news: Bools | None) -> Bools:
    """
    Return which readings (T, J) only repeat the last position of their marker.

    A marker that keeps its place to the last digit while others change, and else changes with
    them, was not seen: its column holds the last value.
    """
    visible = np.isfinite(positions[..., 0])
    held = np.zeros(visible.shape, dtype=bool)
    both = visible[1:] & visible[:-1]
    changed = changes(positions)
    count = changed.sum(axis=1) + (0 if news is None else news)
    for j in range(visible.shape[1]):
        comparable = both[:, j] & (count > changed[:, j])  # steps at which another marker changed
        same = both[:, j] & ~changed[:, j]
        edges = np.flatnonzero(np.diff(same, prepend=False, append=False))
        runs = [np.flatnonzero(comparable[a:b]) + a for a, b in edges.reshape(-1, 2).tolist()]
        runs = [run for run in runs if len(run) >= SAMPLES_MIN]
        if not runs:
            continue
        free = comparable.copy()
        free[np.concatenate(runs)] = False
        if free.sum() < SAMPLES_MIN or (rate := changed[free, j].mean()) < 0.5:
            continue
        length_min = np.log(CHANCE_PROBABILITY) / np.log(max(1.0 - rate, 1e-12))
        for run in runs:
            if len(run) >= length_min:
                held[run[0] + 1 : run[-1] + 2, j] = True
    return held


def renumbered(positions: Floats) -> list[tuple[int, ...]]:
    """
    Return which columns hold one marker, one after the other, because it was renumbered.

    Parameters
    ----------
    positions : (T, J, 3)
        NaN = not seen.

    Returns
    -------
    list of tuple of int
        The columns of each marker in the order of time, by the first of them; one that was
        never seen is a marker of its own.

    """
    visible = np.isfinite(positions[..., 0])
    T, J = visible.shape
    first = np.where(visible.any(axis=0), visible.argmax(axis=0), T)
    last = np.where(visible.any(axis=0), T - 1 - visible[::-1].argmax(axis=0), -1)
    chains = [[j] for j in range(J)]
    for j in np.argsort(first, kind='stable').tolist():
        if not 0 < first[j] < T:
            continue
        ends = []  # chains that are gone when this marker begins, and do not come back
        for chain in chains:
            one = chain[-1]
            fewest = min(int(visible[:, one].sum()), int(visible[:, j].sum()))
            later = int(visible[first[j] :, one].sum())
            if chain[0] != j and fewest > 0 and later <= SHARED_FRAMES_MAX * fewest:
                ends.append(chain)
        place = positions[first[j], j]
        off = [float(np.linalg.norm(positions[last[c[-1]], c[-1]] - place)) for c in ends]
        if not off:
            continue
        chain = ends[int(np.argmin(off))]
        others = np.delete(positions[first[j]], [j, chain[-1]], axis=0)
        others = others[np.isfinite(others[:, 0])]
        apart = np.linalg.norm(others - place, axis=1).min(initial=np.inf)
        if len(others) and min(off) < 0.5 * apart:
            mine = next(c for c in chains if c[0] == j)
            chain += mine
            chains.remove(mine)
    return [tuple(chain) for chain in chains]


def put_back(places: Floats) -> tuple[Floats, list[tuple[int, int, int]]]:
    """
    Undo exchanges: put two markers that exchange their columns back into their own.

    From one frame to the next each of the two is where the other one was: no arm does that.

    Parameters
    ----------
    places : (T, J, n)
        x, y, z first, in the order of time; NaN = not seen.

    Returns
    -------
    places : (T, J, n)
        In the columns that the markers have in the beginning.
    exchanges : list of (frame, column, column)
        In the order of time.

    """
    visible, cleaned = np.isfinite(places[..., 0]), places.copy()
    exchanges = list[tuple[int, int, int]]()
    for i, j in combinations(range(visible.shape[1]), 2):
        both = np.flatnonzero(visible[:, i] & visible[:, j])
        pair = places[both[:, None], [i, j], :3]
        steps = np.linalg.norm(pair[1:, :, None] - pair[:-1, None], axis=3)  # (K, to 2, from 2)
        own, other = steps[:, 0, 0] + steps[:, 1, 1], steps[:, 0, 1] + steps[:, 1, 0]
        for k in np.flatnonzero(other < CROSSED_FRACTION_MAX * own).tolist():
            # what is seen of one alone may be of either
            cleaned[both[k] + 1 : both[k + 1], [i, j]] = np.nan
            exchanges.append((int(both[k + 1]), i, j))
    restored, owners = cleaned.copy(), np.arange(visible.shape[1])
    for frame, i, j in sorted(exchanges):
        owners[[i, j]] = owners[[j, i]]
        restored[frame:, owners] = cleaned[frame:]
    return restored, sorted(exchanges)


def exchange_lines(
    exchanges: Sequence[tuple[int, int, int]], times: Floats, names: Sequence[str]
) -> list[str]:
    """Describe which markers exchange their columns, when first [s], and how often."""
    lines = []
    for pair in dict.fromkeys((i, j) for _, i, j in exchanges):
        frames = [frame for frame, *two in exchanges if tuple(two) == pair]
        more = f' and {len(frames) - 1} times more' if len(frames) > 1 else ''
        when = f'at {times[frames[0]]:.2f} s{more}: put back to what they are before'
        lines.append(f'{names[pair[0]]} and {names[pair[1]]} exchange their names {when}')
    return lines


def joined(places: Floats, chains: Sequence[Sequence[int]]) -> Floats:
    """Return places (T, J, n) of markers whose columns follow each other, as of `renumbered`."""
    columns = []
    for first, *later in chains:
        place = places[:, first]
        for j in later:
            place = np.where(np.isnan(place), places[:, j], place)
        columns.append(place)
    return np.stack(columns, axis=1)


def undo_renumbering(recording: Recording, count: int) -> tuple[Recording, list[str]]:
    """Join the tracks of `count` markers that were renumbered; return a line for each, too."""
    track = recording.tracks[0]
    positions = np.where(is_missing(track.positions)[..., None], np.nan, track.positions)
    chains = renumbered(positions)
    if recording.marker_names or not len(chains) == count < positions.shape[1]:
        return recording, []
    lines = [
        f'poses {listing(map(str, chain))} of the shape are one marker, numbered anew'
        for chain in chains
        if len(chain) > 1
    ]
    turned = np.where(np.isnan(positions[..., :1]), np.nan, track.orientations)
    one = replace(track, positions=joined(positions, chains), orientations=joined(turned, chains))
    return replace(recording, tracks=(one,)), lines


def undo_exchanges(recording: Recording) -> tuple[Recording, list[str]]:
    """Undo exchanges of markers within a shape; return the recording and a line for each."""
    if recording.marker_names:
        return recording, []
    (track,) = recording.tracks
    readings = [track.positions, track.orientations]
    places, exchanges = put_back(np.concatenate(readings, axis=2))
    names = [f'pose {j} of the shape' for j in range(places.shape[1])]
    one = replace(track, positions=places[..., :3], orientations=places[..., 3:])
    return replace(recording, tracks=(one,)), exchange_lines(exchanges, track.times, names)


def without_unseen_readings(
    recording: Recording, length: float, names: list[str]
) -> tuple[Recording, list[str]]:
    """Exclude invalid readings of markers; return the recording and a line for each reason."""
    steps = [track.times[1:][changes(track.positions).any(axis=1)] for track in recording.tracks]
    tracks, lines = [], list[str]()
    for k, track in enumerate(recording.tracks):
        others = np.sort(np.concatenate([np.zeros(0), *steps[:k], *steps[k + 1 :]]))
        news = np.diff(np.searchsorted(others, track.times)) > 0
        positions, counts = without_unseen(track.positions, length, news)
        lines += unseen_lines(counts, names if len(recording.tracks) == 1 else [names[k]])
        tracks.append(replace(track, positions=positions))
    return replace(recording, tracks=tuple(tracks)), lines
