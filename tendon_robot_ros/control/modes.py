"""
Modes of motion; the `step` of a mode returns the goal of the tensions in this cycle.

In pull mode the wire pulls move in pieces, at whose ends the model is evaluated beforehand.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ..common.errors import TendonRobotError
from ..common.rotations import rotated
from ..drivers.safety import CYCLE_MAX_S, approach, bounded
from .approach import Approach, keep_out_refusal
from .checks import Refusal
from .driver_side import MeasuredState, Settling
from .solver import Done, GiveUp, Work
from .state import Controller, Target, Trajectory, Twist
from .target_search import request_of

if TYPE_CHECKING:
    from ..model.shape import Reach, Shape

Array = NDArray[np.float64]
# [1] of the length: distance of the desired tip ahead of the reachable one; from more it would
# come back late
AHEAD_LENGTH_MAX = 0.01
# [s] at the rate limit: wire pulls are straight lines in between, because the tensions hardly
# change
PIECE_S = 0.02


class Mode(Protocol):
    """A mode of motion. It writes its own fields only; the core calls `step` once per cycle."""

    @property
    def stamp(self) -> str:
        """The stamp of the command, '' without one."""

    def step(self, core: Controller, passed: float) -> Array | None:
        """
        Return the goal of the command, (m,) [N], or (m,) [m] of a trajectory in pull mode.

        None ends the mode, and the command stays. `passed` [s] is the time since the last step.
        """

    def moving(self, core: Controller) -> bool:
        """Whether the command still changes."""


@dataclass
class Idle:
    """There is no command to follow: the tensions stay."""

    stamp: str = ''

    def step(self, core: Controller, passed: float) -> Array | None:
        """Return the command."""
        return core.command

    def moving(self, core: Controller) -> bool:
        """Return False."""
        return False


@dataclass
class FollowTarget:
    """
    Follows a target with the tensions that the search returned.

    Attributes
    ----------
    target : Target
    reach : Reach
        The solution of the search.
    via : list of (m,) [N]
        Tensions to pass before.
    position : (3,) [m] or None
        Desired position of the tip: that of the target, or ahead of it in a stream.
    in_time : bool
        Whether the search finished within its budget.

    """

    target: Target
    reach: Reach
    via: list[Array]
    position: Array | None
    in_time: bool = True
    _settling: Settling = field(default_factory=Settling)

    @property
    def stamp(self) -> str:
        """The stamp of the target."""
        return self.target.stamp

    def step(self, core: Controller, passed: float) -> Array | None:
        """Return the next tensions to pass, then those of the target."""
        if self.via and _same(core.command, self.via[0]):
            measured, settled = core.measured_tensions, True
            if measured is not None and core.command is not None and not core.settings.pull_mode:
                low, high = core.settings.limits(core.model).T
                settled = self._settling.settled(core.time, core.command, measured, high - low)
            if settled:
                self.via.pop(0)
        return self.via[0] if self.via else core.goal(self.reach.tensions)

    def moving(self, core: Controller) -> bool:
        """Whether the command is not yet at its goal."""
        return bool(self.via) or not _same(core.command, core.goal(self.reach.tensions))


@dataclass
class FollowTwist:
    """Moves the tip with the last received velocity, from its present position."""

    twist: Twist
    received: float  # monotonic [s]
    stamp: str = ''
    reach: Reach | None = None  # the last solution
    position: Array | None = None  # (3,) [m] desired, None before the first shape
    direction: Array = field(default_factory=lambda: np.zeros(3))
    axes: Array = field(default_factory=lambda: np.eye(3))  # of the tip, as columns
    problem: str = ''  # why there are no tensions for it
    _due: float = 0.0  # [s] of motion that is not yet requested

    def begin(self, shape: Shape | None, error: TendonRobotError | None) -> None:
        """Begin at a shape; without one the error ends the twist."""
        if shape is None:
            self.problem = str(error)
        else:
            self.position, self.direction = shape.tip_position.copy(), shape.tip_direction.copy()
            self.axes = shape.frames[-1].copy()

    def take(self, now: float, twist: Twist) -> None:
        """Take the next velocity."""
        self.twist, self.received = twist, now

    def step(self, core: Controller, passed: float) -> Array | None:
        """Request the next tensions from the solver; return the last ones that it found."""
        timed_out = core.time - self.received > core.settings.twist_timeout
        if timed_out or self.problem or not self.twist.moves:
            return None  # the arm stops
        self._due = min(self._due + passed, CYCLE_MAX_S)  # no jump after a late solution
        if self.position is not None and not core.solver.busy('twist'):
            request = request_of(core, core.model, self._advanced(core), tracking=True)
            ahead_max = AHEAD_LENGTH_MAX * core.model.robot.length

            def done(path: Approach | None, error: TendonRobotError | None) -> None:
                if path is None:
                    self.problem = str(error)
                    return
                self.reach, shape = path.reach, path.reach.shape
                self.axes = shape.frames[-1]
                assert self.position is not None
                ahead = self.position - shape.tip_position
                distance = float(np.linalg.norm(ahead))
                if distance > ahead_max:  # the desired tip stays near the reachable one
                    self.position = shape.tip_position + ahead * (ahead_max / distance)

            core.solver.post('twist', request.answer, done)
        if self.problem:
            return None
        return core.command if self.reach is None else self.reach.tensions

    def _advanced(self, core: Controller) -> Target:
        """Advance the desired pose by the time that is not yet requested."""
        linear, angular = self.twist.linear, self.twist.angular
        if self.twist.in_tip:
            linear, angular = self.axes @ linear, self.axes @ angular
        assert self.position is not None
        self.position = self.position + linear * self._due
        self.direction = rotated(self.direction, angular * self._due)
        self._due = 0.0
        oriented = core.settings.hold_direction or bool(angular.any())
        return Target(self.position, self.direction if oriented else None)

    def moving(self, core: Controller) -> bool:
        """Whether the command is not yet at its goal."""
        return self.reach is not None and not _same(core.command, self.reach.tensions)


@dataclass
class PlayTrajectory:
    """Plays a trajectory of the tendons and holds its end."""

    trajectory: Trajectory

    @property
    def stamp(self) -> str:
        """The stamp of the trajectory."""
        return self.trajectory.stamp

    def step(self, core: Controller, passed: float) -> Array | None:
        """Return the values at the present time."""
        return self.trajectory.at(core.time)

    def moving(self, core: Controller) -> bool:
        """Whether the command is not yet at the end."""
        return not _same(core.commanded, self.trajectory.values[-1])


def _same(command: Array | None, goal: Array) -> bool:
    """Whether a command (m,) is at its goal."""
    return command is not None and np.array_equal(command, goal)


def keep_out_check(
    core: Controller, trajectory: Trajectory, take: Callable[[Refusal | None], None]
) -> tuple[Work, Done]:
    """Return solver work and callback that check whether a trajectory keeps out of regions."""
    model, last, acting = core.model, core.track.last, core.acting_tensions()
    settings, command = core.settings, core.commanded

    def work(give_up: GiveUp) -> Refusal | None:
        start = model.follow(last, acting) if last is None or not settings.pull_mode else last
        started = trajectory.begin(0.0, command)
        return keep_out_refusal(model, start, started, settings.keep_out, settings.pull_mode)

    def done(refusal: Refusal | None, error: TendonRobotError | None) -> None:
        if error is not None:
            refusal = Refusal('no_equilibrium', f'tendon_trajectory: {error}; nothing was played')
        take(refusal)

    return work, done


@dataclass
class PullPath:
    """
    Commanded wire pulls (m,) [m], and the shapes at the ends of the next pieces.

    The solver evaluates a piece while the previous one is played; if it is late, the arm waits.
    """

    pulls: Array
    ahead: deque[Shape] = field(default_factory=deque)
    _played: Array | None = None  # (m,) [N] that belong to the pulls of a trajectory

    def advance(self, core: Controller, goal: Array, step: float) -> Array:
        """Move by a step [N] towards a goal (m,) [N]; return the tensions (m,) [N] there."""
        tensions, self._played = core.command, None
        assert tensions is not None
        if np.array_equal(tensions, goal):
            self.ahead.clear()
        self._request_piece(core, tensions, goal)
        while self.ahead and step > 0.0:
            end = self.ahead[0]
            size = float(np.abs(end.inputs - tensions).max())
            part = 1.0 if size <= step else step / size
            tensions = tensions + part * (end.inputs - tensions)
            self.pulls = self.pulls + part * (end.pulls - self.pulls)
            step -= size
            if part == 1.0:
                tensions, self.pulls = end.inputs.copy(), end.pulls.copy()
                self.ahead.popleft()
        self._request_piece(core, tensions, goal)
        return tensions

    def _request_piece(self, core: Controller, tensions: Array, goal: Array) -> None:
        """Request the shape at the end of the next piece."""
        if len(self.ahead) >= 2 or core.solver.busy('piece'):
            return
        last = self.ahead[-1] if self.ahead else None
        begin = tensions if last is None else last.inputs
        end = approach(begin, goal, np.full_like(goal, core.settings.rate_limit * PIECE_S))
        if np.array_equal(begin, end) and not core.track.problem:
            return
        track, now = core.track, core.time

        def done(shape: Shape | None, error: TendonRobotError | None) -> None:
            if track is not core.track:
                return
            if shape is None:
                track.failed(now, str(error))
                return
            track.recovered()
            if (self.ahead[-1] if self.ahead else None) is last:
                self.ahead.append(shape)

        core.solver.post('piece', track.shape_work(end, last), done)

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

        def done(tensions: Array | None, error: TendonRobotError | None) -> None:
            if tensions is not None:
                self._played = tensions

        core.solver.post('playing', work, done)
        return self._played
