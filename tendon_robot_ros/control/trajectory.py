"""
Trajectories of tensions or wire pulls, checked as a whole, then played; the way of wire lengths.

An arm that is driven by wire lengths goes in pieces whose ends the model has seen.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ..common.errors import TendonRobotError
from ..drivers.safety import approach, bounded
from .checks import Refusal
from .keeping_out import entered
from .solver import GiveUp
from .state import Controller, MeasuredState

if TYPE_CHECKING:
    from ..model.shape import Shape

Array = NDArray[np.float64]
PIECE_S = 0.02  # [s] at the rate limit: wire pulls are near enough to straight lines in between
PIECES_AHEAD = 2  # pieces
LIMIT_ROUNDING = 1e-9  # [N] or [m] by which a value may be outside for rounding


class PullDriven(Controller, Protocol):
    """A controller of an arm that is driven by wire lengths."""

    way: Way | None


@dataclass
class Way:
    """
    Wire pulls (m,) [m] as commanded, and the shapes at the ends of the pieces ahead.

    The solver is asked for a piece while the one before is on; where it is late, the arm waits.
    """

    pulls: Array
    ahead: deque[Shape] = field(default_factory=deque)

    def anew(self) -> Way:
        """Return a way from the same pulls on which nothing is planned."""
        return Way(self.pulls)

    def advance(self, core: PullDriven, goal: Array, step: float) -> Array:
        """Move by a step [N] towards a goal (m,) [N]; return the tensions (m,) [N] there."""
        tensions = core.command
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

    def _ask(self, core: PullDriven, tensions: Array, goal: Array) -> None:
        """Have the solver look at the end of the next piece."""
        if len(self.ahead) >= PIECES_AHEAD or core.solver.busy('piece'):
            return
        last = self.ahead[-1] if self.ahead else None
        begin = tensions if last is None else last.inputs
        end = approach(begin, goal, np.full_like(goal, core.settings.rate_limit * PIECE_S))
        if np.array_equal(begin, end) and not core.track.problem:
            return
        track, now = core.track, core.stepped
        find = track.finding(end, last)

        def done(shape: Shape | None, error: TendonRobotError | None) -> None:
            if core.way is not self or track is not core.track:
                return
            if shape is None:
                track.failed(now, str(error))
                return
            track.works()
            if (self.ahead[-1] if self.ahead else None) is last:
                self.ahead.append(shape)

        core.solver.post('piece', find, done)


class Player(Controller, Protocol):
    """A controller that may play a trajectory."""

    playing: Playing | None
    looked: Playing | None  # whether it keeps out of the regions

    @property
    def commanded(self) -> Array | None:
        """What was commanded last, (m,) [N], or [m] in pull mode."""


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

    def within(self, limits: Array) -> Playing:
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


def look_and_play(core: Player, trajectory: Playing, play: Callable[[Playing], None]) -> None:
    """Have the solver look whether a trajectory keeps out of the regions; then play it."""
    model, last, felt = core.model, core.track.last, core.felt_tensions()
    settings, command = core.settings, core.commanded
    looked = core.looked = trajectory

    def work(give_up: GiveUp) -> Refusal | None:
        here = model.follow(last, felt) if last is None or not settings.pull_mode else last
        way = trajectory.begin(0.0, command)
        return entered(model, here, way.times, way.values, settings.keep_out, settings.pull_mode)

    def done(refusal: Refusal | None, error: TendonRobotError | None) -> None:
        if core.looked is not looked:
            return  # something else is wanted by now
        core.looked = None
        if error is not None:
            refusal = Refusal('no_equilibrium', f'tendon_trajectory: {error}; nothing was played')
        if refusal is None:
            pull = settings.pull_mode
            play(trajectory if pull else trajectory.within(settings.limits(core.model)))
        else:
            core.refusals['target'] = refusal

    core.solver.post('trajectory', work, done)


def play_pulls(core: Player, way: Way, playing: Playing, now: float) -> None:
    """Command the wire pulls of a trajectory; the solver says what tensions belong to them."""
    way.pulls = playing.at(now)
    way.ahead.clear()
    if core.solver.busy('playing') or core.command is None:
        return
    model, guess, unknown = core.model, core.track.last, core.command
    limits = core.settings.limits(model)
    heard = MeasuredState(np.full(len(way.pulls), np.nan), way.pulls, now)

    def work(give_up: GiveUp) -> Array:
        return bounded(heard.in_newtons(model, limits, guess, unknown), limits)

    def done(tensions: Array | None, error: TendonRobotError | None) -> None:
        if tensions is not None and core.playing is playing and core.model is model:
            core.command = tensions

    core.solver.post('playing', work, done)


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
    outside = (values < limits[:, 0] - LIMIT_ROUNDING) | (values > limits[:, 1] + LIMIT_ROUNDING)
    if outside.any():
        point, column = np.argwhere(outside)[0]
        low, high = limits[column]
        raise Refusal(
            'limits',
            f'{what}: point {point + 1}: {inputs[column]}: expected {low:g} to {high:g} N, '
            f'got {values[point, column]:g}; nothing of it was played',
        )
    return Playing(times, bounded(values, limits))
