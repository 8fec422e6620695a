"""What was reached against what was asked, along a path that was followed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
