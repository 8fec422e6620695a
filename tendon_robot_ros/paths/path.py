"""
Paths of the tip through given rows, stretched in time to keep limits.

`tip_path` samples a path, `Plan` finds the tensions along it and the times of its samples.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline, pchip_interpolate

from ..common.arrays import Floats, Ints, interpolated, simplified
from ..common.errors import InputError
from ..common.rotations import angle_between
from ..control.inputs import STREAM_PERIOD_S, Trajectory
from ..model.inverse import reach
from ..model.model import Model
from ..model.program import RANGE_TOLERANCE
from ..model.shape import Shape
from ..model.tip_task import TipTask
from ..robot.keep_out import KeepOut

# [m], [rad] samples of a path lie no further apart, and a target counts as reached within them:
# about what a tracker sees of a moving tip, so that neither shows in a run
POSITION_TOLERANCE_M = 1e-3
DIRECTION_TOLERANCE_RAD = np.radians(1.0)  # [rad] as above, so that neither shows in a run
SAMPLE_PERIOD_S = 0.04  # [s] between samples, so that a smooth path changes its speed smoothly
SAMPLES_MAX = 20_000  # [1] of a path; every one costs an inverse, else planning would take minutes


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
        Unit vectors, nan where none is requested.
    rows : ndarray, shape (n,)
        Index of the sample of each given row.

    """

    times: Floats
    positions: Floats
    directions: Floats
    rows: Ints

    def backwards(self) -> TipPath:
        """Return the path from its end to its start."""
        last = len(self.times) - 1
        times = self.times[-1] - self.times[::-1]
        rows = last - self.rows[::-1]
        return TipPath(times, self.positions[::-1], self.directions[::-1], rows)


def tip_path(
    times: Floats | None, positions: Floats, directions: Floats, smooth: bool = True
) -> TipPath:
    """
    Sample a path through rows of targets.

    A smooth path is a monotone cubic through the positions (PCHIP, Fritsch and Carlson 1980), at
    rest at both ends, never beyond a box around two neighbours. Directions turn at constant speed
    from row to row, the shortest way.

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
    # samples of each piece, and their fraction along it, 0 to 1
    lengths, turns = pieces(positions, directions)
    parts = [
        np.diff(when) / SAMPLE_PERIOD_S,
        lengths / POSITION_TOLERANCE_M,
        turns / DIRECTION_TOLERANCE_RAD,
        np.ones(len(positions) - 1),
    ]
    counts = np.ceil(np.max(parts, axis=0) - 1e-9).astype(np.int64)
    rows = np.concatenate([[0], np.cumsum(counts)])
    fraction = np.concatenate([*(np.arange(count) / count for count in counts), [1.0]])
    if len(fraction) > SAMPLES_MAX:
        raise InputError(
            f'the path needs {len(fraction)} samples, expected at most {SAMPLES_MAX}; split it'
        )
    piece = np.searchsorted(rows, np.arange(len(fraction)), side='right') - 1
    piece = np.minimum(piece, len(rows) - 2)
    sampled = when[piece] + fraction * (when[piece + 1] - when[piece])
    curve = smooth_curve(when, positions, piece, fraction) if smooth else None
    if curve is None:
        curve = positions[piece] + fraction[:, None] * (positions[piece + 1] - positions[piece])
    return TipPath(sampled, curve, interpolated_directions(directions, piece, fraction), rows)


def pieces(positions: Floats, directions: Floats) -> tuple[Floats, Floats]:
    """Return lengths [m] and turns [rad], 0 without directions, between n rows, (n - 1,) each."""
    lengths = np.asarray(np.linalg.norm(np.diff(positions, axis=0), axis=1))
    return lengths, np.nan_to_num(angle_between(directions[:-1], directions[1:]))


def set_points(times: Floats, positions: Floats, directions: Floats) -> TipPath:
    """
    Return the path of targets that are held until the next one, as in a recording.

    Targets within `STREAM_PERIOD_S` of each other are taken for a path of their own. A step
    takes no time here; limits of speed say later how long it takes.
    """
    pauses = np.flatnonzero(np.diff(times) > STREAM_PERIOD_S)
    at = np.insert(times, pauses + 1, times[pauses + 1])
    places = np.insert(positions, pauses + 1, positions[pauses], axis=0)
    views = np.insert(directions, pauses + 1, directions[pauses], axis=0)
    path = tip_path(at, places, views, smooth=False)
    own = np.delete(np.arange(len(at)), pauses + 1 + np.arange(len(pauses)))
    return TipPath(path.times, path.positions, path.directions, path.rows[own])


def smooth_curve(times: Floats, positions: Floats, piece: Ints, fraction: Floats) -> Floats | None:
    """Return positions on a monotone cubic; None where rows coincide and there is none."""
    along = times
    if not np.all(np.diff(times) > 0.0):  # no times: the length of the path instead
        lengths = np.linalg.norm(np.diff(positions, axis=0), axis=1)
        if not np.all(lengths > 1e-9):
            return None
        along = np.concatenate([[0.0], np.cumsum(lengths)])
    slopes = pchip_interpolate(along, positions, along, der=1, axis=0)
    slopes[[0, -1]] = 0.0
    curve = CubicHermiteSpline(along, positions, slopes, axis=0)
    return np.asarray(curve(along[piece] + fraction * (along[piece + 1] - along[piece])))


def interpolated_directions(directions: Floats, piece: Ints, fraction: Floats) -> Floats:
    """
    Return directions (N, 3) that turn at constant speed from row to row (slerp).

    Raises
    ------
    InputError
        Two neighbours look in opposite directions: the axis of rotation would be arbitrary.

    """
    before, after = directions[piece], directions[piece + 1]
    angle = angle_between(before, after)
    opposite = angle > np.pi - DIRECTION_TOLERANCE_RAD
    if opposite.any():
        row = int(piece[int(np.argmax(opposite))])
        raise InputError(
            f'rows {row + 1} and {row + 2} look in opposite directions; put a row between them'
        )
    first, second = (
        share * np.sinc(share * angle / np.pi) / np.sinc(angle / np.pi)
        for share in (1.0 - fraction, fraction)
    )
    turned = first[:, None] * before + second[:, None] * after
    # a row without a direction: none up to it, and none after it
    turned = np.where(fraction[:, None] == 0.0, before, turned)
    turned = np.where(fraction[:, None] == 1.0, after, turned)
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


@dataclass(frozen=True)
class Pace:
    """Largest speeds and rates along a path."""

    speed: float = 0.02  # [m/s] of the tip
    turning: float = 0.6  # [rad/s] of its direction
    tension: float = 5.0  # [N/s] of every tension
    pull: float = 0.01  # [m/s] of every wire pull


class Plan:
    """
    A path with the times that keep the pace, and the model's solutions along it.

    Parameters
    ----------
    model : Model
        The one of the controller.
    path : TipPath
    pace : Pace
    start : Shape
        The present shape of the arm, with its friction memory.
    keep_out : KeepOut, optional
        Regions that no part of the arm may enter.

    Attributes
    ----------
    path : TipPath
        With stretched times.
    tensions : ndarray, shape (N, m) [N]
        That the model finds for the samples.
    position_errors, direction_errors : ndarray, shape (N,) [m], [rad]
        Distance and angle of the tip from the samples.
    detours : ndarray, shape (N - 1,) [m]
        Distance of the tip from the path half way between the tensions of two samples.
    regions : tuple of str
        That keep the arm away from its path, in the order of the path.

    """

    def __init__(
        self,
        model: Model,
        path: TipPath,
        pace: Pace,
        start: Shape,
        keep_out: KeepOut | None = None,
    ) -> None:
        found, shape = [], start
        for position, direction in zip(path.positions, path.directions, strict=True):
            view = None if np.isnan(direction).any() else direction
            memory = shape.memory if model.remembers else None
            task = TipTask.at(model, position, view, memory=memory)
            found.append(reach(replace(task, guess=shape, keep_out=keep_out or KeepOut())))
            shape = found[-1].shape
        self.tensions = tensions = np.array([one.tensions for one in found])
        self.position_errors = np.array([one.position_error for one in found])
        self.direction_errors = np.array([one.direction_error for one in found])
        self.regions = tuple(dict.fromkeys(one.region for one in found if one.region))
        lengths, turns = pieces(path.positions, path.directions)
        changes = np.abs(np.diff(tensions, axis=0)).max(axis=1, initial=0.0)
        least = lengths / pace.speed, turns / pace.turning, changes / pace.tension
        gaps = np.max([np.diff(path.times), *least], axis=0)
        self.path = replace(path, times=np.concatenate([[0.0], np.cumsum(gaps)]))
        halfway = 0.5 * (tensions[:-1] + tensions[1:])
        if model.remembers:  # each from the sample before it, the first one from the start
            both = np.stack([tensions[:-1], halfway], axis=1).reshape(-1, tensions.shape[1])
            between = model.sequence(both, start.memory.copy()).tip_position[1::2]
        else:
            between = model.shapes(halfway).tip_position
        middle = 0.5 * (path.positions[:-1] + path.positions[1:])
        self.detours = np.asarray(np.linalg.norm(between - middle, axis=1))

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return float(self.path.times[-1])

    def at(self, time: float) -> tuple[Floats, Floats | None]:
        """Return target position and direction (None: none requested) at a time [s]."""
        path = self.path
        position = interpolated(time, path.times, path.positions)
        direction = interpolated(time, path.times, path.directions)
        if np.isnan(direction).any():
            return position, None
        return position, direction / np.linalg.norm(direction)

    def detour(self) -> str:
        """Return where the arm has to switch to another solution and leaves the path, or ''."""
        if not len(self.detours) or self.detours.max() <= POSITION_TOLERANCE_M:
            return ''
        worst = int(np.argmax(self.detours))
        row = int(np.searchsorted(self.path.rows, worst + 1, side='left'))
        change = np.abs(np.diff(self.tensions, axis=0))[worst].max()
        return (
            f'between rows {row} and {row + 1} the tensions have to change by {change:.1f} N at '
            f'once: the tip leaves the path there by {1e3 * self.detours[worst]:.1f} mm'
        )

    def out_of_reach(self) -> str:
        """Return which rows are out of reach, '' if none."""
        far = (self.position_errors > POSITION_TOLERANCE_M) | (
            self.direction_errors > DIRECTION_TOLERANCE_RAD
        )
        if not far.any():
            return ''
        bad = np.flatnonzero(far)
        row = np.searchsorted(self.path.rows, bad, side='left') + 1
        miss, angle = self.position_errors[bad].max(), self.direction_errors[bad].max()
        span = f'row {row.min()}' if row.min() == row.max() else f'rows {row.min()} to {row.max()}'
        return (
            f'{len(bad)} of {len(far)} samples on the way to {span} are out of reach, '
            f'by up to {1e3 * miss:.1f} mm and {np.degrees(angle):.1f}°'
            + (f'; kept out of {", ".join(self.regions)}' if self.regions else '')
        )


def stretched(times: Floats, values: Floats, rate: float) -> Floats:
    """Return times (n,) [s] at which values (n, m) change by no more than a rate per second."""
    gaps = np.maximum(np.diff(times), np.abs(np.diff(values, axis=0)).max(axis=1) / rate)
    return np.concatenate([[0.0], np.cumsum(gaps)])


def retreat(times: Floats, commands: Floats, rate: float) -> Trajectory:
    """
    Return the commands of a run in reverse, so that the arm goes back along its own path.

    Parameters
    ----------
    times : ndarray, shape (n,) [s]
        Of the commands.
    commands : ndarray, shape (n, m) [N] or [m]
        In the order of the run.
    rate : float
        Largest change per second.

    """
    kept = thinned(times, commands)[::-1]
    back = stretched(times[-1] - times[kept], commands[kept], rate)
    return Trajectory(back + 0.05, commands[kept])


def thinned(times: Floats, values: Floats) -> Ints:
    """
    Return the indices of rows (n, m) at times (n,) [s] between which straight lines suffice.

    As Douglas and Peucker (1973), with `RANGE_TOLERANCE` of the largest change as the distance.
    """

    def beside(first: int, last: int) -> Floats:
        inside, ends = slice(first + 1, last), [first, last]
        line = interpolated(times[inside], times[ends], values[ends])
        return np.asarray(np.abs(values[inside] - line).max(axis=1, initial=0.0))

    tolerance = RANGE_TOLERANCE * float(np.ptp(values, axis=0).max(initial=0.0))
    return np.array(simplified((0, len(times) - 1), tolerance, beside))
