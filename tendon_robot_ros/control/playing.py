"""Trajectories of tensions or wire pulls: checked as a whole, then played in time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..drivers.limits import bounded
from .checks import Refusal
from .heard import Heard

if TYPE_CHECKING:
    from .core import ControllerCore

Array = NDArray[np.float64]
SLACK = 1e-9  # [N] or [m] by which a value may be outside for rounding


@dataclass
class Playing:
    """
    Values (n, m) [N], or [m] in pull mode, at times (n,) [s] since the trajectory came.

    Between the points values go in straight lines. The first leg begins where the command is; when
    the first time is 0 the command goes there at the rate limit. The end is held.
    """

    times: Array
    values: Array
    stamp: str = ''
    began: float = np.inf  # monotonic [s]

    def begin(self, now: float, here: Array | None) -> Playing:
        """Start the clock at a command (m,)."""
        times, values = self.times, self.values
        if times[0] > 0.0 and here is not None:
            times, values = np.concatenate([[0.0], times]), np.vstack([here, values])
        return replace(self, times=times, values=values, began=now)

    def at(self, now: float) -> Array:
        """Return the values (m,) that are due."""
        passed = now - self.began
        return np.array([np.interp(passed, self.times, column) for column in self.values.T])

    def over(self, now: float) -> bool:
        """Whether the last point is due."""
        return bool(now - self.began >= self.times[-1])

    def progress(self, now: float) -> str:
        """Say how far it is."""
        return f'{min(now - self.began, self.times[-1]):.2f} of {self.times[-1]:.2f} s'


def in_pulls(core: ControllerCore, now: float, wanted: Array) -> tuple[Array, Array | None]:
    """
    Return tensions (m,) [N] and the wire pulls (m,) [m] to command.

    The pulls are those of a trajectory that plays, else those that belong to the wanted tensions.
    """
    if core.playing is not None:
        pulls = core.playing.at(now)
        limits = core.settings.limits(core.model)
        unknown = limits[:, 0] if core.command is None else core.command
        heard = Heard(np.full(len(pulls), np.nan), pulls, now)
        tensions = heard.in_newtons(core.model, limits, core.track.last, unknown)
        wanted = bounded(tensions, limits)
        core.track.follow(now, wanted)
        return wanted, pulls
    shape = core.track.follow(now, wanted)
    if shape is None:
        wanted = core.command if core.command is not None else wanted
        shape = core.track.last
    return wanted, None if shape is None else shape.pulls


def checked(times: Array, values: Array, limits: Array | None, inputs: tuple[str, ...]) -> Playing:
    """
    Refuse a trajectory that cannot be played as it stands.

    Parameters
    ----------
    times : ndarray, shape (n,) [s]
        Since its beginning, growing.
    values : ndarray, shape (n, m) [N] or [m]
        In the order of `inputs`.
    limits : ndarray, shape (m, 2), optional
        Lowest and highest value of each input.
    inputs : tuple of str
        Their names, for the message.

    """
    what = 'tendon_trajectory'
    if not (np.isfinite(times).all() and np.isfinite(values).all()):
        raise Refusal('not_finite', f'{what}: expected finite numbers')
    if times[0] < 0.0 or np.any(np.diff(times) <= 0.0):
        raise Refusal('times', f'{what}: expected times from 0 that grow from point to point')
    if limits is None:
        return Playing(times, values)
    outside = (values < limits[:, 0] - SLACK) | (values > limits[:, 1] + SLACK)
    if outside.any():
        point, column = np.argwhere(outside)[0]
        low, high = limits[column]
        raise Refusal(
            'limits',
            f'{what}: point {point + 1}: {inputs[column]}: expected {low:g} to {high:g} N, '
            f'got {values[point, column]:g}; nothing of it was played',
        )
    return Playing(times, bounded(values, limits))
