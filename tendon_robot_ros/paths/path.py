"""A path of the tip between given rows, smooth or straight; what was reached along it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, pchip_interpolate

from ..common.errors import InputError
from ..control.state import STREAM_PERIOD_S

Array = NDArray[np.float64]
SAMPLE_PERIOD_S = 0.04  # [s] between samples
SAMPLE_SPACING_M, SAMPLE_TURN_RAD = 0.001, np.radians(1.0)  # [m] and [rad] between samples at most
SAMPLES_MAX = 20_000  # samples
OPPOSITE_FROM_RAD = np.radians(179.0)  # between two directions: which way round is then chance


@dataclass(frozen=True)
class TipPath:
    """
    Samples of a path.

    Attributes
    ----------
    times : ndarray, shape (N,) [s]
        From 0, growing or standing still.
    positions : ndarray, shape (N, 3) [m]
    directions : ndarray, shape (N, 3)
        Unit vectors, nan where none is asked.
    rows : ndarray, shape (n,)
        Which sample each given row is.

    """

    times: Array
    positions: Array
    directions: Array
    rows: NDArray[np.int64]

    def backwards(self) -> TipPath:
        """Return the way back."""
        last = len(self.times) - 1
        times = self.times[-1] - self.times[::-1]
        rows = last - self.rows[::-1]
        return TipPath(times, self.positions[::-1], self.directions[::-1], rows)


def tip_path(
    times: Array | None,
    positions: Array,
    directions: Array,
    smooth: bool = True,
) -> TipPath:
    """
    Sample a path through rows of targets.

    Smooth: a monotone cubic through the positions (PCHIP, Fritsch and Carlson 1980), at rest at
    both ends, never beyond a box around two neighbours. Directions turn at constant speed from row
    to row, the shortest way.

    Parameters
    ----------
    times : ndarray, shape (n,) [s], or None
        None: all pieces take no time; limits of speed then say how long they take.
    positions : ndarray, shape (n, 3) [m]
    directions : ndarray, shape (n, 3)
        Unit vectors, or nan.
    smooth : bool
        False: straight lines.

    Raises
    ------
    InputError
        Two neighbours look in opposite directions, or the path is too long.

    """
    when = np.zeros(len(positions)) if times is None else times
    if len(positions) == 1:
        return TipPath(np.zeros(1), positions, directions, np.zeros(1, dtype=np.int64))
    rows, share = _places(when, positions, directions)
    if len(share) > SAMPLES_MAX:
        raise InputError(
            f'the path needs {len(share)} samples, expected at most {SAMPLES_MAX}; split it'
        )
    piece = np.searchsorted(rows, np.arange(len(share)), side='right') - 1
    piece = np.minimum(piece, len(rows) - 2)
    sampled = when[piece] + share * (when[piece + 1] - when[piece])
    way = _smooth(when, positions, piece, share) if smooth else None
    if way is None:
        way = positions[piece] + share[:, None] * (positions[piece + 1] - positions[piece])
    return TipPath(sampled, way, _turned(directions, piece, share), rows)


def set_points(times: Array, positions: Array, directions: Array) -> TipPath:
    """
    Return the path of targets that stand until the next one comes, as in a recording.

    Targets within `STREAM_PERIOD_S` of each other are taken for a path of their own. A step
    takes no time here; limits of speed say later how long it takes.
    """
    stands = np.flatnonzero(np.diff(times) > STREAM_PERIOD_S)
    at = np.insert(times, stands + 1, times[stands + 1])
    places = np.insert(positions, stands + 1, positions[stands], axis=0)
    views = np.insert(directions, stands + 1, directions[stands], axis=0)
    path = tip_path(at, places, views, smooth=False)
    own = np.delete(np.arange(len(at)), stands + 1 + np.arange(len(stands)))
    return TipPath(path.times, path.positions, path.directions, path.rows[own])


def _places(times: Array, positions: Array, directions: Array) -> tuple[NDArray[np.int64], Array]:
    """Return the sample of each row, and how far every sample is in its piece, 0 to 1."""
    distance = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    angle = np.nan_to_num(_angles(directions[:-1], directions[1:]))
    parts = [
        np.diff(times) / SAMPLE_PERIOD_S,
        distance / SAMPLE_SPACING_M,
        angle / SAMPLE_TURN_RAD,
        np.ones(len(distance)),
    ]
    counts = np.ceil(np.max(parts, axis=0) - 1e-9).astype(np.int64)
    share = [np.arange(count) / count for count in counts]
    return np.concatenate([[0], np.cumsum(counts)]), np.concatenate([*share, [1.0]])


def _smooth(
    times: Array, positions: Array, piece: NDArray[np.int64], share: Array
) -> Array | None:
    """Return positions on a curve; None where rows coincide and there is none."""
    along = times
    if not np.all(np.diff(times) > 0.0):  # no times: the length of the way instead
        lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
        if not np.all(lengths > 1e-9):
            return None
        along = np.concatenate([[0.0], np.cumsum(lengths)])
    if len(along) < 3:
        slopes = np.zeros_like(positions)
    else:
        slopes = pchip_interpolate(along, positions, along, der=1, axis=0)
        slopes[[0, -1]] = 0.0
    curve = CubicHermiteSpline(along, positions, slopes, axis=0)
    return np.asarray(curve(along[piece] + share * (along[piece + 1] - along[piece])))


def _turned(directions: Array, piece: NDArray[np.int64], share: Array) -> Array:
    before, after = directions[piece], directions[piece + 1]
    angle = _angles(before, after)
    if np.any(angle > OPPOSITE_FROM_RAD):
        row = int(piece[int(np.argmax(angle > OPPOSITE_FROM_RAD))])
        raise InputError(
            f'rows {row + 1} and {row + 2} look in opposite directions; put a row between them'
        )
    sine = np.sin(angle)
    straight = ~(sine > 1e-9)
    safe = np.where(straight, 1.0, sine)
    first = np.where(straight, 1.0 - share, np.sin((1.0 - share) * angle) / safe)
    second = np.where(straight, share, np.sin(share * angle) / safe)
    turned = first[:, None] * before + second[:, None] * after
    # a row without a direction: none up to it, and none after it
    turned = np.where(share[:, None] == 0.0, before, turned)
    turned = np.where(share[:, None] == 1.0, after, turned)
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


def _angles(a: Array, b: Array) -> Array:
    """Return the angles (n,) [rad] between unit vectors (n, 3)."""
    return np.asarray(np.arccos(np.clip((a * b).sum(axis=1), -1.0, 1.0)))


@dataclass(frozen=True)
class PathRun:
    """
    A path that was followed; all times [s] since it began.

    Attributes
    ----------
    inputs : tuple of str, length m
    asked_times, asked, asked_directions : ndarray, shapes (A,), (A, 3) [m], (A, 3)
        Targets of the tip as they were sent; directions nan where none was asked. Empty for
        trajectories of the tendons.
    row_times : ndarray, shape (n,)
        When every given row was due.
    tip_times, tips, tip_directions : ndarray, shapes (T,), (T, 3) [m], (T, 3)
        The tip, measured or as the model sees it.
    measured : bool
        Whether a tracker measured it.
    command_times, commands : ndarray, shapes (C,), (C, m) [N], or [m] in pull mode
        What was commanded.
    pull : bool
        Whether wire pulls were.
    wanted : ndarray, shape (n, m), optional
        Values of the tendons that were asked, for trajectories of the tendons.

    """

    inputs: tuple[str, ...]
    asked_times: Array
    asked: Array
    asked_directions: Array
    row_times: Array
    tip_times: Array
    tips: Array
    tip_directions: Array
    measured: bool
    command_times: Array
    commands: Array
    pull: bool
    wanted: Array | None = None

    def tip_at(self, times: Array) -> tuple[Array, Array]:
        """Return positions (n, 3) [m] and directions (n, 3) of the tip at times (n,) [s]."""
        places = _interpolated(times, self.tip_times, self.tips)
        along = _interpolated(times, self.tip_times, self.tip_directions)
        sizes = np.linalg.norm(along, axis=1, keepdims=True)
        return places, along / np.where(sizes > 0.0, sizes, np.nan)

    def commanded_at(self, times: Array) -> Array:
        """Return commands (n, m) at times (n,) [s]."""
        return _interpolated(times, self.command_times, self.commands)

    def asked_at(self, times: Array) -> tuple[Array, Array]:
        """Return the targets (n, 3) [m] and their directions (n, 3) at times (n,) [s]."""
        places = _interpolated(times, self.asked_times, self.asked)
        return places, _interpolated(times, self.asked_times, self.asked_directions)

    def errors(self, times: Array) -> tuple[Array, Array]:
        """Return distances (n,) [m] and angles (n,) [rad] between tip and target at times."""
        asked, views = self.asked_at(times)
        places, along = self.tip_at(times)
        cosine = (views * along).sum(axis=1) / np.linalg.norm(views, axis=1)
        return np.linalg.norm(places - asked, axis=1), np.arccos(np.clip(cosine, -1.0, 1.0))

    def across(self) -> Array:
        """Return how far the tip was from the path (T,) [m], whenever it was due there."""
        if not len(self.asked):
            return np.full(len(self.tips), np.nan)
        return np.array([_distance(self.asked, place) for place in self.tips])

    def on_the_way(self) -> tuple[float, float, float]:
        """Return rms and largest distance [m] from the target of the moment, and across."""
        errors, _ = self.errors(self.tip_times)
        return float(np.sqrt(np.mean(errors**2))), float(errors.max()), float(self.across().max())


def _interpolated(times: Array, known: Array, values: Array) -> Array:
    if not len(known):
        return np.full((len(times), values.shape[1]), np.nan)
    return np.column_stack([np.interp(times, known, column) for column in values.T])


def _distance(path: Array, place: Array) -> float:
    """Return the distance [m] of a place (3,) from a line through points (A, 3)."""
    if len(path) == 1:
        return float(np.linalg.norm(place - path[0]))
    start, way = path[:-1], np.diff(path, axis=0)
    length = (way**2).sum(axis=1)
    share = ((place - start) * way).sum(axis=1) / np.where(length > 0.0, length, 1.0)
    nearest = start + np.clip(share, 0.0, 1.0)[:, None] * way
    return float(np.nanmin(np.linalg.norm(nearest - place, axis=1)))
