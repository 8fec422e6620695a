"""Where a recorded arm stands still: the segments that count as measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..exceptions import DataSetError
from ..robot import Robot
from .bag_reader import Recording, Track
from .dataset import FloatArray

STEPS = 10  # of the time grid, per window
LARGEST = 2e7  # instants x markers
NO_CUTS = np.zeros(0)


@dataclass(frozen=True)
class Rule:
    """
    When the arm counts as still.

    Its speed is the distance between the mean positions in the two halves of a window, so that
    the noise of a tracker is no motion; the window is half the duration.
    """

    speed: float = 0.002  # [m/s], rms over the markers
    duration: float = 1.0  # [s]
    change: float | None = None  # [N] or [m], of any input within a window; None: see `fill`

    def fill(self, robot: Robot, kind: str) -> Rule:
        """Return the rule with a change of 1 % of the tension limit or 0.2 % of the length."""
        if self.change is not None:
            return self
        change = 0.01 * robot.tension_limits[1] if kind == 'tension' else 0.002 * robot.length
        return replace(self, change=change)


@dataclass(frozen=True)
class Motion:
    """How the arm moved, on a regular grid of times."""

    times: FloatArray  # (G,) [s]
    speed: FloatArray  # (G,) [m/s], inf where no marker was seen
    change: FloatArray  # (G,) [N] or [m], largest of the inputs


def motion(recording: Recording, inputs: FloatArray, rule: Rule) -> Motion:
    """
    Compute speed and change of inputs.

    Parameters
    ----------
    recording : Recording
        Gives the markers and the times.
    inputs : ndarray
        (T, m) [N] or [m] at `recording.state_times`.
    rule : Rule
        Gives the window.

    Raises
    ------
    DataSetError
        The recording is too long for so short a window.

    """
    window = rule.duration / 2
    ends = [track.times[[0, -1]] for track in recording.tracks]
    start, end = max(e[0] for e in ends), min(e[1] for e in ends)
    size = sum(track.positions.shape[1] for track in recording.tracks)
    if (end - start) / window * STEPS * size > LARGEST:
        raise DataSetError(
            recording.name,
            f'{end - start:.0f} s are too long to look for {rule.duration:g} s of stillness',
            'ask for a longer duration or import a part of the recording',
        )
    times = np.arange(start + window / 2, end - window / 2 + 1e-9, window / STEPS)
    squares = [_speeds(track, times, window) ** 2 for track in recording.tracks]
    together = np.concatenate(squares, axis=1)  # (G, J)
    seen = np.isfinite(together)
    mean = np.where(seen, together, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
    return Motion(
        times,
        np.where(seen.any(axis=1), np.sqrt(mean), np.inf),
        _changes(recording.state_times, inputs, times, window),
    )


def still_stretches(
    moved: Motion, rule: Rule, cuts: FloatArray = NO_CUTS
) -> list[tuple[float, float]]:
    """
    Return begin and end [s] of every stretch in which the rule holds.

    Parameters
    ----------
    moved : Motion
        Speed and change of inputs.
    rule : Rule
        What counts as still.
    cuts : ndarray, optional
        (C,) [s] where measurements begin and end, if that is known: no stretch goes across, and
        one that is a little too short will do.

    """
    shortest = rule.duration / 4 if len(cuts) else rule.duration / 2  # plus half a window per end
    still = (moved.speed < rule.speed) & (moved.change < (rule.change or np.inf))
    part = np.searchsorted(cuts, moved.times, side='right')
    run = np.cumsum(np.diff(still * (part + 1), prepend=0) != 0)  # counts up where a run begins
    found = []
    for number in np.unique(run[still]):
        begin, end = moved.times[np.flatnonzero(run == number)[[0, -1]]]
        if end - begin >= shortest - 1e-9:
            found.append((float(begin), float(end)))
    return found


def sample_means(
    times: FloatArray, values: FloatArray, begin: FloatArray, end: FloatArray
) -> FloatArray:
    """
    Return means over stretches of time.

    Parameters
    ----------
    times : ndarray
        (S,) [s], ascending.
    values : ndarray
        (S, n); a NaN does not count.
    begin, end : ndarray
        (G,) [s], both included.

    Returns
    -------
    ndarray
        (G, n), NaN where there is no value.

    """
    seen = np.isfinite(values)
    zero = np.zeros((1, values.shape[1]))
    sums = np.concatenate([zero, np.cumsum(np.where(seen, values, 0.0), axis=0)])
    counts = np.concatenate([zero, np.cumsum(seen, axis=0)])
    first = np.searchsorted(times, begin - 1e-9)
    last = np.searchsorted(times, end + 1e-9)
    count = counts[last] - counts[first]
    mean = (sums[last] - sums[first]) / np.maximum(count, 1)
    return np.where(count > 0, mean, np.nan)


def held_means(
    times: FloatArray, values: FloatArray, begin: FloatArray, end: FloatArray
) -> FloatArray:
    """Return `sample_means`, or the last value before where a stretch has no sample."""
    means = sample_means(times, values, begin, end)
    last = np.searchsorted(times, end + 1e-9) - 1
    empty = last < np.searchsorted(times, begin - 1e-9)
    return np.where(empty[:, None], values[np.maximum(last, 0)], means)


def _changes(times: FloatArray, inputs: FloatArray, grid: FloatArray, window: float) -> FloatArray:
    """Return the largest change of an input between the halves of a window, (G,)."""
    before = held_means(times, inputs, grid - window / 2, grid)
    after = held_means(times, inputs, grid, grid + window / 2)
    slackened = np.isnan(before) != np.isnan(after)
    return np.where(slackened, np.inf, np.nan_to_num(np.abs(after - before))).max(axis=1)


def _speeds(track: Track, times: FloatArray, window: float) -> FloatArray:
    """Return the speed of every marker, (G, J) [m/s], NaN where it was not seen."""
    S, J = track.positions.shape[:2]
    flat = track.positions.reshape(S, 3 * J)
    before = sample_means(track.times, flat, times - window / 2, times)
    after = sample_means(track.times, flat, times, times + window / 2)
    return np.linalg.norm((after - before).reshape(len(times), J, 3), axis=2) / (window / 2)
