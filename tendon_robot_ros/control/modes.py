"""
What the arm is asked to do: a mode each, whose `step` says where the tensions go next.

An arm that is driven by wire lengths goes there in pieces whose ends the model has seen.
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
from .approach import Approach, entered
from .checks import Refusal
from .driver_side import MeasuredState, Settling
from .solver import Done, GiveUp, Work
from .state import Controller, Target, Trajectory, Twist
from .target_search import request_of

if TYPE_CHECKING:
    from ..model.shape import Reach, Shape

Array = NDArray[np.float64]
# [1] of the length, of the wanted tip before the reachable one: from more it would come back late
LEAD_LENGTH = 0.01
# [s] at the rate limit: wire pulls are straight lines in between, because the tensions hardly
# change
PIECE_S = 0.02


class Mode(Protocol):
    """What the arm does. A mode writes its own fields only; the core asks it once in a cycle."""

    @property
    def stamp(self) -> str:
        """Of what was asked for, '' where it has none."""

    def step(self, core: Controller, passed: float) -> Array | None:
        """
        Return where the command goes, (m,) [N], or (m,) [m] of a trajectory in pull mode.

        None for a mode that is over: the command stays. `passed` [s] is the time since the last
        step.
        """

    def moving(self, core: Controller) -> bool:
        """Whether the command still moves."""


@dataclass
class Idle:
    """Nothing is asked for: the command stays."""

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
    Goes to the tensions that were found for a target.

    Attributes
    ----------
    target : Target
    reach : Reach
        The tensions that were found.
    via : list of (m,) [N]
        Tensions on the way there.
    position : (3,) [m] or None
        Where the tip should be: that of the target, or of a stream ahead of it.
    in_time : bool
        Whether the search came to its end.

    """

    target: Target
    reach: Reach
    via: list[Array]
    position: Array | None
    in_time: bool = True
    _settling: Settling = field(default_factory=Settling)

    @classmethod
    def along(cls, target: Target, way: Approach, in_time: bool, ahead: Target) -> FollowTarget:
        """Follow the approach that was found for a target, or for one ahead of it."""
        return cls(target, way.reach, list(way.via), ahead.position, in_time)

    @property
    def stamp(self) -> str:
        """Of the target."""
        return self.target.stamp

    def step(self, core: Controller, passed: float) -> Array | None:
        """Return the next tensions on the way, or those of the target."""
        if self.via and _same(core.command, self.via[0]):
            measured, settled = core.measured_tensions, True
            if measured is not None and core.command is not None and not core.settings.pull_mode:
                low, high = core.settings.limits(core.model).T
                settled = self._settling.settled(core.time, core.command, measured, high - low)
            if settled:
                self.via.pop(0)
        return self.via[0] if self.via else core.goal(self.reach.tensions)

    def moving(self, core: Controller) -> bool:
        """Whether the command is not yet where it goes."""
        return bool(self.via) or not _same(core.command, core.goal(self.reach.tensions))


@dataclass
class FollowTwist:
    """Moves the tip with the last velocity that came, from where the tip is."""

    twist: Twist
    received: float  # monotonic [s]
    stamp: str = ''
    reach: Reach | None = None  # the tensions that were found last
    position: Array | None = None  # (3,) [m] where the tip should be, None: not known where it is
    direction: Array = field(default_factory=lambda: np.zeros(3))
    axes: Array = field(default_factory=lambda: np.eye(3))  # of the tip, as columns
    problem: str = ''  # why it leads nowhere
    _due: float = 0.0  # [s] by which the tip is to be moved

    def begin(self, shape: Shape | None, error: TendonRobotError | None) -> None:
        """Begin at a shape; without one it leads nowhere."""
        if shape is None:
            self.problem = str(error)
        else:
            self.position, self.direction = shape.tip_position.copy(), shape.tip_direction.copy()
            self.axes = shape.frames[-1].copy()

    def take(self, now: float, twist: Twist) -> None:
        """Take the next velocity."""
        self.twist, self.received = twist, now

    def step(self, core: Controller, passed: float) -> Array | None:
        """Have the solver look for the next tensions; return those that it has found."""
        late = core.time - self.received > core.settings.twist_timeout
        if late or self.problem or not self.twist.moves:
            return None  # stops where it is
        self._due = min(self._due + passed, CYCLE_MAX_S)  # no jump after a late solution
        if self.position is not None and not core.solver.busy('twist'):
            request = request_of(core, core.model, self._advanced(core), tracking=True)
            lead_max = LEAD_LENGTH * core.model.robot.length

            def done(way: Approach | None, error: TendonRobotError | None) -> None:
                if way is None:
                    self.problem = str(error)
                    return
                self.reach, shape = way.reach, way.reach.shape
                self.axes = shape.frames[-1]
                assert self.position is not None
                ahead = self.position - shape.tip_position
                distance = float(np.linalg.norm(ahead))
                if distance > lead_max:  # what is wanted stays near to where the tip can be
                    self.position = shape.tip_position + ahead * (lead_max / distance)

            core.solver.post('twist', request.answer, done)
        if self.problem:
            return None
        return core.command if self.reach is None else self.reach.tensions

    def _advanced(self, core: Controller) -> Target:
        """Move what is wanted by the time that is due."""
        linear, angular = self.twist.linear, self.twist.angular
        if self.twist.in_tip:
            linear, angular = self.axes @ linear, self.axes @ angular
        assert self.position is not None
        self.position = self.position + linear * self._due
        self.direction = rotated(self.direction, angular * self._due)
        self._due = 0.0
        turns = core.settings.hold_direction or bool(angular.any())
        return Target(self.position, self.direction if turns else None)

    def moving(self, core: Controller) -> bool:
        """Whether the command is not yet where it goes."""
        return self.reach is not None and not _same(core.command, self.reach.tensions)


@dataclass
class PlayTrajectory:
    """Plays a trajectory of the tendons; its end is held."""

    trajectory: Trajectory

    @property
    def stamp(self) -> str:
        """Of the trajectory."""
        return self.trajectory.stamp

    def step(self, core: Controller, passed: float) -> Array | None:
        """Return the values that are due."""
        return self.trajectory.at(core.time)

    def moving(self, core: Controller) -> bool:
        """Whether the command is not yet at the end."""
        return not _same(core.commanded, self.trajectory.values[-1])


def _same(command: Array | None, goal: Array) -> bool:
    """Whether a command (m,) is at its goal."""
    return command is not None and np.array_equal(command, goal)


def keeps_out(
    core: Controller, trajectory: Trajectory, take: Callable[[Refusal | None], None]
) -> tuple[Work, Done]:
    """Return how to look whether a trajectory keeps out of the regions, and to say why not."""
    model, last, acting = core.model, core.track.last, core.acting_tensions()
    settings, command = core.settings, core.commanded

    def work(give_up: GiveUp) -> Refusal | None:
        here = model.follow(last, acting) if last is None or not settings.pull_mode else last
        way = trajectory.begin(0.0, command)
        return entered(model, here, way, settings.keep_out, settings.pull_mode)

    def done(refusal: Refusal | None, error: TendonRobotError | None) -> None:
        if error is not None:
            refusal = Refusal('no_equilibrium', f'tendon_trajectory: {error}; nothing was played')
        take(refusal)

    return work, done


@dataclass
class PullPath:
    """
    Wire pulls (m,) [m] as commanded, and the shapes at the ends of the pieces ahead.

    The solver is asked for a piece while the one before is on; where it is late, the arm waits.
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
        self._ask(core, tensions, goal)
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
        self._ask(core, tensions, goal)
        return tensions

    def _ask(self, core: Controller, tensions: Array, goal: Array) -> None:
        """Have the solver look at the end of the next piece, while the arm is on one before."""
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
            track.works()
            if (self.ahead[-1] if self.ahead else None) is last:
                self.ahead.append(shape)

        core.solver.post('piece', track.finding(end, last), done)

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
