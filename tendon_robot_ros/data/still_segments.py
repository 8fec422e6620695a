"""Still segments of a recorded arm: found, averaged and assembled to a data set."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..common.arrays import DIGITS, RESOLUTION, Floats, Ints
from ..common.errors import DataSetError, short
from ..robot import Robot
from ..robot.estimates import same_input
from .arrays import NO_ROTATION, VALUES_MAX, Marker, mean_inputs
from .bag_reader import Recording
from .dataset import READINGS, DataSet
from .measurement_files import sort_trials

STEPS_PER_WINDOW = 10  # [1] of the time grid, so that a stretch is found to a tenth of the window


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
        change = same_input(robot, kind) if self.change is None else self.change
        return replace(self, change=change)


@dataclass(frozen=True)
class ArmMotion:
    """Speed of the arm and change of its inputs, on a regular grid of times."""

    times: Floats  # (G,) [s]
    speed: Floats  # (G,) [m/s], inf where no marker was seen
    change: Floats  # (G,) [N] or [m], largest of the inputs

    @classmethod
    def of(cls, recording: Recording, rule: Rule) -> ArmMotion:
        """
        Compute speed and change of inputs; the rule gives the window.

        Raises
        ------
        DataSetError
            The recording is too long for so short a window.

        """
        window, half = rule.duration / 2, rule.duration / 4
        start = min(track.times[0] for track in recording.tracks)
        start = max(start, recording.state_times[0])  # what the inputs were before, nothing tells
        end = max(track.times[-1] for track in recording.tracks)
        size = sum(track.positions.shape[1] for track in recording.tracks)
        if (end - start) / window * STEPS_PER_WINDOW * size > VALUES_MAX:
            sought = f'{rule.duration:g} s of stillness'
            problem = f'{end - start:.0f} s are too long to look for {sought}'
            remedy = 'ask for a longer duration or import a part of the recording'
            raise DataSetError(recording.name, problem, remedy)
        times = np.arange(start + half, end - half + 1e-9, window / STEPS_PER_WINDOW)
        begin = np.concatenate([times - half, times])
        # (G,) [m/s] of each marker; one by one, because a million frames fill the memory
        speeds = []
        for track in recording.tracks:
            for j in range(track.positions.shape[1]):
                means = sample_means(track.times, track.positions[:, j], begin, begin + half)
                before, after = np.split(means, 2)
                speeds.append(np.linalg.norm(after - before, axis=1) / half)
        squares = np.stack(speeds, axis=1) ** 2  # (G, J)
        valid = np.isfinite(squares)
        mean = np.where(valid, squares, 0.0).sum(axis=1) / np.maximum(valid.sum(axis=1), 1)
        before = held_means(recording.state_times, recording.inputs, times - half, times)
        after = held_means(recording.state_times, recording.inputs, times, times + half)
        slackened = np.isnan(before) != np.isnan(after)
        changes = np.where(slackened, np.inf, np.nan_to_num(np.abs(after - before)))
        speed = np.where(valid.any(axis=1), np.sqrt(mean), np.inf)
        return cls(times, speed, changes.max(axis=1))


def never_still(
    name: str, motions: Sequence[ArmMotion], times: Sequence[Floats], rule: Rule
) -> DataSetError:
    """Return the error of recordings without any still segment; `times` [s] of their markers."""
    slowest = 1e3 * min(float(moved.speed.min(initial=np.inf)) for moved in motions)
    lasts = max(float(np.ptp(own)) for own in times)
    # a speed takes messages in both halves of its window, which is half of the duration
    steps = [float(np.median(np.diff(own))) for own in times if len(own) > 1]
    shortest = 3.999 * min(steps, default=0.0)  # times are rounded
    shorter = min(0.5 * lasts, 0.5 * rule.duration)
    remedy = 'let the arm rest longer in every posture'
    if shorter >= shortest > 0.0:
        remedy = f'allow a shorter duration, say {shorter:.2g}'
    limit, duration = 1e3 * rule.speed, rule.duration  # [mm/s] and [s]
    if lasts < duration:
        problem = f'lasts {lasts:.3g} s, and the arm counts as still after {duration:g} s'
    elif duration < shortest:
        few = f'too few to see in {duration:g} s whether the arm stands still'
        problem = f'holds a place every {0.25 * shortest:.2g} s, {few}'
        remedy = f'ask for a duration of {2.0 * shortest:.2g} or more'
    elif not any(len(moved.times) for moved in motions):
        problem = 'inputs and markers are hardly recorded at the same time'
        remedy = 'record both from beginning to end'
    elif slowest == np.inf:
        problem, remedy = 'no marker was ever seen', 'record the markers again'
    elif slowest < limit:
        problem = (
            f'the arm never stands still for {duration:g} s at once, in a recording of '
            f'{lasts:.3g} s (still: slower than {limit:g} mm/s, inputs change by less than '
            f'{rule.change or 0.0:.2g} in half of that time)'
        )
        remedy += ', or a higher speed where noise looks like one'
    else:
        moment = f'at its slowest moment {slowest:.2g} mm/s'
        problem = f'the arm is never slower than {limit:g} mm/s for {duration:g} s ({moment})'
        remedy = 'allow a higher speed or a shorter duration'
    return DataSetError(name, problem, remedy)


def still_stretches(
    moved: ArmMotion, rule: Rule, cuts: Floats | None = None
) -> list[tuple[float, float]]:
    """
    Return begin and end [s] of every stretch in which the rule holds.

    Parameters
    ----------
    moved : ArmMotion
        Speed and change of inputs.
    rule : Rule
        What counts as still.
    cuts : ndarray, optional
        (C,) [s] where measurements begin and end, if that is known: no stretch goes across, and
        one that is a little too short will do.

    """
    # [s] and half a window per end
    shortest = rule.duration / 2 if cuts is None else rule.duration / 4
    still = (moved.speed < rule.speed) & (moved.change < (rule.change or np.inf))
    part = 0 if cuts is None else np.searchsorted(cuts, moved.times, side='right')
    run = np.cumsum(np.diff(still * (part + 1), prepend=0) != 0)  # counts up where a run begins
    stretches = []
    for number in np.unique(run[still]):
        begin, end = moved.times[np.flatnonzero(run == number)[[0, -1]]]
        if end - begin >= shortest - 1e-9:
            stretches.append((float(begin), float(end)))
    return stretches


def sample_means(times: Floats, values: Floats, begin: Floats, end: Floats) -> Floats:
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
    known = np.isfinite(values)
    zero = np.zeros((1, values.shape[1]))
    sums = np.concatenate([zero, np.cumsum(np.where(known, values, 0.0), axis=0)])
    counts = np.concatenate([zero, np.cumsum(known, axis=0)])
    first = np.searchsorted(times, begin - 1e-9)
    last = np.searchsorted(times, end + 1e-9)
    count = counts[last] - counts[first]
    mean = (sums[last] - sums[first]) / np.maximum(count, 1)
    return np.where(count > 0, mean, np.nan)


def held_means(times: Floats, values: Floats, begin: Floats, end: Floats) -> Floats:
    """Return `sample_means`, or the last value before where a stretch has no sample."""
    means = sample_means(times, values, begin, end)
    last = np.searchsorted(times, end + 1e-9) - 1
    empty = last < np.searchsorted(times, begin - 1e-9)
    return np.where(empty[:, None], values[np.maximum(last, 0)], means)


@dataclass(frozen=True)
class Segment:
    """An interval in which the arm stood still, and its mean measurements."""

    begin: float  # [s] since the recording began
    end: float  # [s]
    inputs: Floats  # (m,) [N] or [m]
    positions: Floats  # (J, 3) [m]
    orientations: Floats  # (J, 4)
    noise: float = 0.0  # [m] 1 sd of a mean position, from the frames; NaN where there is one
    posture: str = ''
    trial: str = ''


def find_segments(
    recording: Recording, moved: ArmMotion, rule: Rule, sequence: bool
) -> tuple[list[Segment], list[str]]:
    """
    Return the measurements of a recording, and a line for each one that is excluded.

    Parameters
    ----------
    recording : Recording
        Gives the markers and the inputs, and the labels if there are any.
    moved : ArmMotion
        Speed and change of inputs.
    rule : Rule
        What counts as still.
    sequence : bool
        Every trial replays the postures in order: one may stand without a measurement.

    """
    if not any(text for _, text in recording.labels):
        averages = [_average(recording, *part) for part in still_stretches(moved, rule)]
        return name_segments(averages, rule, sequence), []
    segments, excluded = [], []
    ends = [time for time, _ in recording.labels[1:]] + [np.inf]
    stretches = still_stretches(moved, rule, np.array([time for time, _ in recording.labels]))
    for (begin, text), end in zip(recording.labels, ends, strict=True):
        if not text:
            continue
        try:
            label = json.loads(text)
            posture, trial = str(label['posture']), str(label['trial'])
        except (ValueError, TypeError, KeyError):
            remedy = 'write {"posture": ..., "trial": ...} as JSON, or nothing'
            raise DataSetError(recording.name, f'label {short(text)}', remedy) from None
        inside = [part for part in stretches if begin <= part[0] and part[1] <= end]
        if inside:
            longest = max(inside, key=lambda part: part[1] - part[0])
            one = _average(recording, *longest)
        elif sequence:
            one = _average(recording, begin, end - 1e-6)  # only its inputs are known
            positions, orientations = np.nan * one.positions, np.nan * one.orientations
            one = replace(one, positions=positions, orientations=orientations)
        else:
            excluded.append(f'posture {posture}, trial {trial}: the arm did not stand still')
            continue
        segments.append(replace(one, posture=posture, trial=trial))
    return segments, excluded


def _average(recording: Recording, begin: float, end: float) -> Segment:
    """Average over a stretch of time."""
    first, last = np.array([begin]), np.array([end])
    positions, orientations, noise = [], [], []
    for track in recording.tracks:
        count = track.positions.shape[1]
        inside = slice(*np.searchsorted(track.times, [begin - 1e-9, end + 1e-9]))
        frames = track.positions[inside]
        flat = frames.reshape(-1, 3 * count)
        positions.append(sample_means(track.times[inside], flat, first, last).reshape(count, 3))
        orientations.append(_mean_quaternion(track.orientations[inside]))
        noise.append(_noise(frames))
    first_state, end_state = np.searchsorted(recording.state_times, [begin - 1e-9, end + 1e-9])
    near = slice(max(int(first_state) - 1, 0), max(int(end_state), 1))  # and the last state before
    (inputs,) = held_means(recording.state_times[near], recording.inputs[near], first, last)
    places, turned = np.concatenate(positions).round(DIGITS), np.concatenate(orientations)
    rms = float(np.sqrt(np.mean(np.square(noise))))
    return Segment(begin, end, inputs.round(DIGITS), places, turned, rms)


def _noise(positions: Floats) -> float:
    """Return 1 sd [m] of the mean of frames (S, J, 3), per coordinate."""
    count = np.isfinite(positions).sum(axis=0)
    known = count > 1
    if not known.any():
        return float('nan')
    variances = np.nanvar(positions[:, known], axis=0, ddof=1)
    return float(np.sqrt(np.mean(variances / count[known])))


def _mean_quaternion(quaternions: Floats) -> Floats:
    """Return the mean of quaternions that differ little, (S, J, 4) to (J, 4)."""
    if not len(quaternions):  # no message in all that time
        return np.full(quaternions.shape[1:], np.nan)
    known = np.abs(np.linalg.norm(quaternions, axis=2, keepdims=True) - 1.0) < 0.05
    values = np.where(known, quaternions, 0.0)
    reference = values[known.argmax(axis=0)[:, 0], np.arange(values.shape[1])]
    total = (values * np.where((values * reference).sum(axis=2) < 0, -1, 1)[..., None]).sum(axis=0)
    norm = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(norm > 0, total / np.maximum(norm, 1e-12), np.nan)


def name_segments(segments: list[Segment], rule: Rule, sequence: bool) -> list[Segment]:
    """Name segments: the same inputs are trials of one posture; in a sequence all differ."""
    if sequence:
        return [replace(one, posture=str(i), trial='0') for i, one in enumerate(segments)]
    postures = np.array([one.inputs for one in segments])
    counts, named = list[int](), []
    for one in segments:
        known = postures[: len(counts)]
        close = np.abs(known - one.inputs) <= (rule.change or 0.0)
        same = (close | np.isnan(known) & np.isnan(one.inputs)).all(axis=1)
        index = int(same.argmax()) if same.any() else len(counts)
        if index == len(counts):
            postures[index] = one.inputs
            counts.append(0)
        named.append(replace(one, posture=str(index), trial=str(counts[index])))
        counts[index] += 1
    return named


def rows_of(
    segments: Sequence[Segment], postures: tuple[str, ...], trials: tuple[str, ...]
) -> tuple[Ints, Ints]:
    """Return the indices (N,) of the posture and of the trial of every segment."""
    known = [{name: i for i, name in enumerate(names)} for names in (postures, trials)]
    pairs = [(known[0][one.posture], known[1][one.trial]) for one in segments]
    rows, columns = np.array(pairs, dtype=np.int64).T
    return rows, columns


def frame_noise(segments: Sequence[Segment]) -> float | None:
    """Return the noise [m] of measurements that nobody repeated, from their frames."""
    squares = np.array([one.noise**2 for one in segments])
    if not np.isfinite(squares).any():
        return None
    return max(float(np.sqrt(np.nanmean(squares))), RESOLUTION)  # else it would be exact


def segments_dataset(
    bag: str, segments: Sequence[Segment], robot: Robot, markers: tuple[Marker, ...], **values: Any
) -> DataSet:
    """
    Return the data set of named segments; without trials, the noise is that of the frames.

    Other values are those of `DataSet`.

    Raises
    ------
    DataSetError
        Two segments have the same names.

    """
    postures = tuple(dict.fromkeys(one.posture for one in segments))
    trials = sort_trials(tuple(one.trial for one in segments))
    size = len(postures), len(trials)
    at = rows_of(segments, postures, trials)
    filled = np.zeros(size, dtype=np.int64)
    np.add.at(filled, at, 1)
    if filled.max() > 1:
        twice = int((filled[at] > 1).argmax())
        named = f'posture {segments[twice].posture!r}, trial {segments[twice].trial!r}'
        remedy = 'record it again with labels that differ'
        raise DataSetError(bag, f'{named} is labelled twice', remedy)
    arrays: dict[str, Any] = {'trial_names': trials}
    for key in ('inputs', *READINGS):
        rows = np.array([getattr(one, key) for one in segments])
        arrays[key] = np.full((*size, *rows.shape[1:]), np.nan)
        arrays[key][at] = rows
    inputs, turned = arrays.pop('inputs'), arrays['orientations']
    mean, arrays['trial_inputs'] = mean_inputs(inputs, filled > 0, postures, bag)
    if np.all(turned[np.isfinite(turned)].reshape(-1, 4) == NO_ROTATION):
        del arrays['orientations']
    if values.get('position_noise') is None and len(trials) == 1:
        values['position_noise'] = frame_noise(segments)
    return DataSet(bag, robot, markers, postures, mean.round(DIGITS), **arrays, **values)
