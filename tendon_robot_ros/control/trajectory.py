"""
Trajectories of tensions or wire pulls, checked as a whole; the path of an arm driven by lengths.

An arm that is driven by wire lengths goes in pieces whose ends the model has seen.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..common.errors import TendonRobotError
from ..drivers.safety import approach, bounded
from .checks import Refusal
from .keeping_out import entered
from .solver import Done, GiveUp, Work
from .state import Controller, MeasuredState

if TYPE_CHECKING:
    from ..model.shape import Shape

Array = NDArray[np.float64]
PIECE_S = 0.02  # [s] at the rate limit: wire pulls are near enough to straight lines in between
PIECES_AHEAD = 2  # the solver looks at one while the arm is on the other
LIMIT_ROUNDING = 1e-9  # [N] or [m] by which a value may be outside for rounding


@dataclass(frozen=True)
class Trajectory:
    """
    Values (n, m) [N], or [m] in pull mode, at times (n,) [s] since the trajectory came.

    Between the points values go in straight lines. The first leg begins where the command is; when
    the first time is 0 the command goes there at the rate limit. The end is held.
    """

    times: Array
    values: Array
    stamp: str = ''
    began: float = np.inf  # monotonic [s]

    def begin(self, now: float, here: Array | None) -> Trajectory:
        """Start the clock at a command (m,)."""
        times, values = self.times, self.values
        if times[0] > 0.0 and here is not None:
            times, values = np.concatenate([[0.0], times]), np.vstack([here, values])
        return replace(self, times=times, values=values, began=now)

    def within(self, limits: Array) -> Trajectory:
        """Return the same within the limits (m, 2) [N] of a model that came meanwhile."""
        return replace(self, values=bounded(self.values, limits))

    def at(self, now: float) -> Array:
        """Return the values (m,) that are due."""
        passed = now - self.began
        return np.array([np.interp(passed, self.times, column) for column in self.values.T])

    def over(self, now: float) -> bool:
        """Whether the last point is due."""
        return bool(now - self.began >= self.times[-1])

    def progress(self, now: float) -> str:
        """Say how far it is."""
        return f'{self.passed(now):.2f} of {self.times[-1]:.2f} s'

    def passed(self, now: float) -> float:
        """Return how much of it is played [s]."""
        return float(min(now - self.began, self.times[-1]))


@dataclass
class PullPath:
    """
    Wire pulls (m,) [m] as commanded, and the shapes at the ends of the pieces ahead.

    The solver is asked for a piece while the one before is on; where it is late, the arm waits.
    """

    pulls: Array
    ahead: deque[Shape] = field(default_factory=deque)
    _played: Array | None = None  # (m,) [N] that belong to the pulls of a trajectory

    def anew(self) -> PullPath:
        """Return a path from the same pulls on which nothing is planned."""
        return PullPath(self.pulls)

    def advance(self, core: Controller, goal: Array, step: float) -> Array:
        """Move by a step [N] towards a goal (m,) [N]; return the tensions (m,) [N] there."""
        tensions, self._played = core.command, None
        assert tensions is not None
        if np.array_equal(tensions, goal):
            self.ahead.clear()
        self._ask(core, tensions, goal)
        while self.ahead and step > 0.0:
            end = self.ahead[0]
            size = float(np.abs(end.inputs - tensions).max())
            share = 1.0 if size <= step else step / size
            tensions = tensions + share * (end.inputs - tensions)
            self.pulls = self.pulls + share * (end.pulls - self.pulls)
            step -= size
            if share == 1.0:
                tensions, self.pulls = end.inputs.copy(), end.pulls.copy()
                self.ahead.popleft()
        self._ask(core, tensions, goal)
        return tensions

    def _ask(self, core: Controller, tensions: Array, goal: Array) -> None:
        """Have the solver look at the end of the next piece."""
        if len(self.ahead) >= PIECES_AHEAD or core.solver.busy('piece'):
            return
        last = self.ahead[-1] if self.ahead else None
        begin = tensions if last is None else last.inputs
        end = approach(begin, goal, np.full_like(goal, core.settings.rate_limit * PIECE_S))
        if np.array_equal(begin, end) and not core.track.problem:
            return
        track, now = core.track, core.time
        find = track.finding(end, last)

        def done(shape: Shape | None, error: TendonRobotError | None) -> None:
            if track is not core.track:
                return
            if shape is None:
                track.failed(now, str(error))
                return
            track.works()
            if (self.ahead[-1] if self.ahead else None) is last:
                self.ahead.append(shape)

        core.solver.post('piece', find, done)

    def play(self, core: Controller, pulls: Array) -> Array:
        """Command wire pulls (m,) [m] at once; return the last known tensions (m,) [N] there."""
        tensions = core.command if self._played is None else self._played
        assert tensions is not None
        self.pulls, self._played = pulls, tensions
        self.ahead.clear()
        if core.solver.busy('playing'):
            return tensions
        model, guess, limits = core.model, core.track.last, core.settings.limits(core.model)
        measured = MeasuredState(np.full(len(pulls), np.nan), pulls, core.time)

        def work(give_up: GiveUp) -> Array:
            return bounded(measured.in_newtons(model, limits, guess, tensions), limits)

        def done(found: Array | None, error: TendonRobotError | None) -> None:
            if found is not None:
                self._played = found

        core.solver.post('playing', work, done)
        return self._played


def looking(
    core: Controller, trajectory: Trajectory, take: Callable[[Refusal | None], None]
) -> tuple[Work, Done]:
    """Return how to look whether a trajectory keeps out of the regions, and to say why not."""
    model, last, acting = core.model, core.track.last, core.acting_tensions()
    settings, command = core.settings, core.commanded

    def work(give_up: GiveUp) -> Refusal | None:
        here = model.follow(last, acting) if last is None or not settings.pull_mode else last
        path = trajectory.begin(0.0, command)
        return entered(model, here, path.times, path.values, settings.keep_out, settings.pull_mode)

    def done(refusal: Refusal | None, error: TendonRobotError | None) -> None:
        if error is not None:
            refusal = Refusal('no_equilibrium', f'tendon_trajectory: {error}; nothing was played')
        take(refusal)

    return work, done


def checked(
    times: Array, values: Array, limits: Array | None, inputs: tuple[str, ...]
) -> Trajectory:
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
        return Trajectory(times, values)
    outside = (values < limits[:, 0] - LIMIT_ROUNDING) | (values > limits[:, 1] + LIMIT_ROUNDING)
    if outside.any():
        point, column = np.argwhere(outside)[0]
        low, high = limits[column]
        raise Refusal(
            'limits',
            f'{what}: point {point + 1}: {inputs[column]}: expected {low:g} to {high:g} N, '
            f'got {values[point, column]:g}; nothing of it was played',
        )
    return Trajectory(times, bounded(values, limits))
