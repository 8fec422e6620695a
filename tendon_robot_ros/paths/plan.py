"""When the tip is where: a path stretched in time until speeds and tension rates are kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError
from ..control.trajectory import Trajectory
from .path import TipPath

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Shape
    from ..robot.keep_out import KeepOut

Array = NDArray[np.float64]
DETOUR_SHARE_MAX = 0.002  # of the largest change: a straight line may leave a command by so much
# [m], [rad] from what was asked: as good as there
REACHED_WITHIN_M, REACHED_WITHIN_RAD = 1e-3, np.radians(1.0)


@dataclass(frozen=True)
class Pace:
    """What is not exceeded on the way."""

    speed: float = 0.02  # [m/s] of the tip
    turning: float = 0.6  # [rad/s] of its direction
    tension: float = 5.0  # [N/s] of every tension
    pull: float = 0.01  # [m/s] of every wire pull


@dataclass(frozen=True)
class Plan:
    """
    A path with the times that keep the pace, and what the model says of it.

    Attributes
    ----------
    path : TipPath
        With stretched times.
    tensions : ndarray, shape (N, m) [N]
        That the model finds for the samples.
    position_errors, direction_errors : ndarray, shape (N,) [m], [rad]
        How near they bring the tip.
    detours : ndarray, shape (N - 1,) [m]
        How far the tip is from the path half way between the tensions of two samples.
    asked : float
        Duration [s] as it was given.
    regions : tuple of str
        That keep the arm away from its path, in the order of the way.

    """

    path: TipPath
    tensions: Array
    position_errors: Array
    direction_errors: Array
    detours: Array
    asked: float
    regions: tuple[str, ...] = ()

    @property
    def duration(self) -> float:
        """How long it takes [s]."""
        return float(self.path.times[-1])

    def at(self, time: float) -> tuple[Array, Array | None]:
        """Return position and direction (None: none asked) that are due at a time [s]."""
        times, path = self.path.times, self.path
        place = int(np.clip(np.searchsorted(times, time, side='right') - 1, 0, len(times) - 1))
        after = min(place + 1, len(times) - 1)
        gap = times[after] - times[place]
        share = float(np.clip((time - times[place]) / gap, 0.0, 1.0)) if gap > 0.0 else 0.0
        position = path.positions[place] * (1.0 - share) + path.positions[after] * share
        direction = path.directions[place] * (1.0 - share) + path.directions[after] * share
        if np.isnan(direction).any():
            return position, None
        return position, direction / np.linalg.norm(direction)

    def detour(self) -> str:
        """Say where the arm has to change to another solution and leaves the path, or ''."""
        if not len(self.detours) or self.detours.max() <= REACHED_WITHIN_M:
            return ''
        worst = int(np.argmax(self.detours))
        row = int(np.searchsorted(self.path.rows, worst + 1, side='left'))
        change = np.abs(np.diff(self.tensions, axis=0))[worst].max()
        return (
            f'between rows {row} and {row + 1} the tensions have to change by {change:.1f} N at '
            f'once: the tip leaves the path there by {1e3 * self.detours[worst]:.1f} mm'
        )

    def out_of_reach(self) -> str:
        """Say which rows lead where the arm cannot go, '' when there are none."""
        far = (self.position_errors > REACHED_WITHIN_M) | (
            self.direction_errors > REACHED_WITHIN_RAD
        )
        if not far.any():
            return ''
        bad = np.flatnonzero(far)
        row = np.searchsorted(self.path.rows, bad, side='left') + 1
        miss, turn = self.position_errors[bad].max(), self.direction_errors[bad].max()
        span = f'row {row.min()}' if row.min() == row.max() else f'rows {row.min()} to {row.max()}'
        return (
            f'{len(bad)} of {len(far)} samples on the way to {span} are out of reach, '
            f'by up to {1e3 * miss:.1f} mm and {np.degrees(turn):.1f}°'
            + (f'; kept out of {", ".join(self.regions)}' if self.regions else '')
        )


def plan(
    model: Model, path: TipPath, pace: Pace, start: Shape, keep_out: KeepOut | None = None
) -> Plan:
    """
    Find the tensions along a path, from where the arm is, and stretch its times.

    Parameters
    ----------
    model : Model
        The one of the controller.
    path : TipPath
        What is asked.
    pace : Pace
        What is not exceeded.
    start : Shape
        Where the arm is; where friction remembers, the way begins with what it remembers there.
    keep_out : KeepOut, optional
        Regions that no part of the arm may enter.

    """
    shapes, shape = [], start
    for position, direction in zip(path.positions, path.directions, strict=True):
        view = None if np.isnan(direction).any() else direction
        past = shape.memory if model.remembers else None
        solution = model.reach(
            position, view, guess=shape, relax=True, memory=past, keep_out=keep_out
        )
        shapes.append(solution)
        shape = solution.shape
    tensions = np.array([one.tensions for one in shapes])
    gaps = np.diff(path.times)
    for changes, largest in (
        (np.linalg.norm(np.diff(path.positions, axis=0), axis=1), pace.speed),
        (_turns(path.directions), pace.turning),
        (np.abs(np.diff(tensions, axis=0)).max(axis=1, initial=0.0), pace.tension),
    ):
        gaps = np.maximum(gaps, changes / largest)
    times = np.concatenate([[0.0], np.cumsum(gaps)])
    return Plan(
        TipPath(times, path.positions, path.directions, path.rows),
        tensions,
        np.array([one.position_error for one in shapes]),
        np.array([one.direction_error for one in shapes]),
        _detours(model, path, tensions),
        float(path.times[-1]),
        tuple(dict.fromkeys(one.region for one in shapes if one.region)),
    )


def _detours(model: Model, path: TipPath, tensions: Array) -> Array:
    if len(tensions) < 2:
        return np.zeros(0)
    halfway = 0.5 * (tensions[:-1] + tensions[1:])
    if model.remembers:  # each from where it was, not from straight
        way = np.stack([tensions[:-1], halfway], axis=1).reshape(-1, tensions.shape[1])
        between = model.sequence(way).tip_position[1::2]
    else:
        between = model.shapes(halfway).tip_position
    middle = 0.5 * (path.positions[:-1] + path.positions[1:])
    return np.asarray(np.linalg.norm(between - middle, axis=1))


def stretched(times: Array, values: Array, rate: float) -> Array:
    """Return times (n,) [s] at which values (n, m) change by no more than a rate per second."""
    if rate <= 0.0:
        raise InputError(f'rate: expected more than 0, got {rate:g}')
    gaps = np.maximum(np.diff(times), np.abs(np.diff(values, axis=0)).max(axis=1) / rate)
    return np.concatenate([[0.0], np.cumsum(gaps)])


def retreat(times: Array, commands: Array, rate: float) -> Trajectory:
    """
    Return the commands of a run backwards, so that the arm leaves by the way it came.

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


def thinned(times: Array, values: Array) -> NDArray[np.int64]:
    """
    Return which rows of values (n, m) at times (n,) [s] straight lines need to pass near all.

    As Douglas and Peucker (1973), with `DETOUR_SHARE_MAX` of the largest change as the distance.
    """
    tolerance = DETOUR_SHARE_MAX * float(np.ptp(values, axis=0).max(initial=0.0))
    kept, open_pieces = {0, len(times) - 1}, [(0, len(times) - 1)]
    while open_pieces:
        first, last = open_pieces.pop()
        inside = slice(first + 1, last)
        ends = times[[first, last]]
        line = [np.interp(times[inside], ends, column[[first, last]]) for column in values.T]
        away = np.abs(values[inside] - np.column_stack(line)).max(axis=1, initial=0.0)
        if away.max(initial=0.0) > tolerance:
            middle = first + 1 + int(np.argmax(away))
            kept.add(middle)
            open_pieces += [(first, middle), (middle, last)]
    return np.array(sorted(kept))


def _turns(directions: Array) -> Array:
    along = np.clip((directions[:-1] * directions[1:]).sum(axis=1), -1.0, 1.0)
    return np.asarray(np.nan_to_num(np.arccos(along)))
