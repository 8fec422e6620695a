"""Still segments of a recording: averaged, named, and put together to a data set."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np

from ..exceptions import DataSetError, short
from .bag_reader import Recording
from .dataset import FloatArray
from .shapes import sort_trials
from .stillness import Motion, Rule, held_means, sample_means, still_stretches

DIGITS = 9  # a mean is rounded to nanometres and nanonewtons


@dataclass(frozen=True)
class Segment:
    """A stretch of time in which the arm stood still, and what was measured then."""

    begin: float  # [s] since the recording began
    end: float  # [s]
    inputs: FloatArray  # (m,) [N] or [m]
    positions: FloatArray  # (J, 3) [m]
    orientations: FloatArray  # (J, 4)
    noise: float = 0.0  # [m] 1 sd of a mean position, from the frames; NaN where there is one
    posture: str = ''
    trial: str = ''


@dataclass(frozen=True)
class Arrays:
    """Segments as the arrays of a data set."""

    postures: tuple[str, ...]
    trials: tuple[str, ...]
    inputs: FloatArray  # (P, m)
    trial_inputs: FloatArray | None  # (P, Q, m) where they differ between the trials
    positions: FloatArray  # (P, Q, J, 3)
    orientations: FloatArray | None  # (P, Q, J, 4)


def find_segments(
    recording: Recording, inputs: FloatArray, moved: Motion, rule: Rule, sequence: bool
) -> tuple[list[Segment], list[str]]:
    """
    Return the measurements of a recording, and one line about each that is left out.

    Parameters
    ----------
    recording : Recording
        Gives the markers, and the labels if there are any.
    inputs : ndarray
        (T, m) [N] or [m] at `recording.state_times`.
    moved : Motion
        Speed and change of inputs.
    rule : Rule
        What counts as still.
    sequence : bool
        Every trial replays the postures in order: one may stand without a measurement.

    """
    if not any(text for _, text in recording.labels):
        found = [_average(recording, inputs, *part) for part in still_stretches(moved, rule)]
        return _named(found, rule, sequence), []
    segments, left_out = [], []
    ends = [time for time, _ in recording.labels[1:]] + [np.inf]
    stretches = still_stretches(moved, rule, np.array([time for time, _ in recording.labels]))
    for (begin, text), end in zip(recording.labels, ends, strict=True):
        if not text:
            continue
        posture, trial = _label(recording.name, text)
        inside = [part for part in stretches if begin <= part[0] and part[1] <= end]
        if inside:
            longest = max(inside, key=lambda part: part[1] - part[0])
            one = _average(recording, inputs, *longest)
        elif sequence:
            one = _unseen(recording, inputs, begin, end - 1e-6)
        else:
            left_out.append(f'posture {posture}, trial {trial}: the arm did not stand still')
            continue
        segments.append(replace(one, posture=posture, trial=trial))
    return segments, left_out


def _label(bag: str, text: str) -> tuple[str, str]:
    try:
        label = json.loads(text)
        return str(label['posture']), str(label['trial'])
    except (ValueError, TypeError, KeyError):
        raise DataSetError(
            bag, f'label {short(text)}', 'write {"posture": ..., "trial": ...} as JSON, or nothing'
        ) from None


def _average(recording: Recording, inputs: FloatArray, begin: float, end: float) -> Segment:
    """Average over a stretch of time."""
    first, last = np.array([begin]), np.array([end])
    positions, orientations, noise = [], [], []
    for track in recording.tracks:
        count = track.positions.shape[1]
        flat = track.positions.reshape(-1, 3 * count)
        positions.append(sample_means(track.times, flat, first, last).reshape(count, 3))
        inside = (track.times >= begin - 1e-9) & (track.times <= end + 1e-9)
        orientations.append(_mean_turn(track.orientations[inside]))
        noise.append(_noise(track.positions[inside]))
    return Segment(
        begin,
        end,
        held_means(recording.state_times, inputs, first, last)[0].round(DIGITS),
        np.concatenate(positions).round(DIGITS),
        np.concatenate(orientations),
        float(np.sqrt(np.mean(np.square(noise)))),
    )


def _noise(positions: FloatArray) -> float:
    """Return 1 sd [m] of the mean of frames (S, J, 3), per coordinate."""
    seen = np.isfinite(positions)
    count = seen.sum(axis=0)
    mean = np.where(seen, positions, 0.0).sum(axis=0) / np.maximum(count, 1)
    squares = np.where(seen, (positions - mean) ** 2, 0.0).sum(axis=0)
    known = count > 1
    if not known.any():
        return float('nan')
    return float(np.sqrt(np.mean(squares[known] / (count[known] * (count[known] - 1)))))


def _unseen(recording: Recording, inputs: FloatArray, begin: float, end: float) -> Segment:
    """Return a segment of a sequence in which only the inputs are known."""
    one = _average(recording, inputs, begin, end)
    nothing = np.full_like(one.positions, np.nan), np.full_like(one.orientations, np.nan)
    return replace(one, positions=nothing[0], orientations=nothing[1])


def _mean_turn(turned: FloatArray) -> FloatArray:
    """Return the mean of quaternions that differ little, (S, J, 4) to (J, 4)."""
    known = np.abs(np.linalg.norm(turned, axis=2, keepdims=True) - 1.0) < 0.05
    values = np.where(known, turned, 0.0)
    reference = values[known.argmax(axis=0)[:, 0], np.arange(values.shape[1])]
    total = (values * np.where((values * reference).sum(axis=2) < 0, -1, 1)[..., None]).sum(axis=0)
    norm = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(norm > 0, total / np.maximum(norm, 1e-12), np.nan)


def _named(found: list[Segment], rule: Rule, sequence: bool) -> list[Segment]:
    """Name segments: the same inputs are trials of one posture; in a sequence all differ."""
    if sequence:
        return [replace(one, posture=str(i), trial='0') for i, one in enumerate(found)]
    postures: list[FloatArray] = []
    counts: list[int] = []
    named = []
    for one in found:
        same = (
            i for i, inputs in enumerate(postures) if _alike(inputs, one.inputs, rule.change or 0)
        )
        index = next(same, len(postures))
        if index == len(postures):
            postures.append(one.inputs)
            counts.append(0)
        named.append(replace(one, posture=str(index), trial=str(counts[index])))
        counts[index] += 1
    return named


def _alike(a: FloatArray, b: FloatArray, change: float) -> bool:
    return bool(np.allclose(a, b, rtol=0.0, atol=change, equal_nan=True))


def assemble(bag: str, segments: list[Segment]) -> Arrays:
    """
    Put named segments together.

    Raises
    ------
    DataSetError
        Two segments have the same names.

    """
    postures = tuple(dict.fromkeys(one.posture for one in segments))
    trials = sort_trials(tuple(one.trial for one in segments))
    places = {name: i for i, name in enumerate(postures)}, {n: i for i, n in enumerate(trials)}
    size = len(postures), len(trials)
    J, m = len(segments[0].positions), len(segments[0].inputs)
    inputs = np.full((*size, m), np.nan)
    positions, turned = np.full((*size, J, 3), np.nan), np.full((*size, J, 4), np.nan)
    done = np.zeros(size, dtype=bool)
    for one in segments:
        place = places[0][one.posture], places[1][one.trial]
        if done[place]:
            raise DataSetError(
                bag,
                f'posture {one.posture!r}, trial {one.trial!r} is labelled twice',
                'record it again with labels that differ',
            )
        done[place] = True
        inputs[place], positions[place], turned[place] = (
            one.inputs,
            one.positions,
            one.orientations,
        )
    known = np.isfinite(turned)
    plain = not known.any() or np.all(turned[known].reshape(-1, 4) == [0.0, 0.0, 0.0, 1.0])
    mean = sample_mean(inputs, done)
    spread = np.nan_to_num(np.abs(inputs - mean[:, None]))[done]
    return Arrays(
        postures,
        trials,
        mean,
        inputs if spread.max() > 10.0**-DIGITS else None,
        positions,
        None if plain else turned,
    )


def sample_mean(inputs: FloatArray, done: FloatArray) -> FloatArray:
    """Return the mean over the trials that were done, (P, m)."""
    counts = done.sum(axis=1)[:, None]
    return (np.where(done[..., None], inputs, 0.0).sum(axis=1) / counts).round(DIGITS)
