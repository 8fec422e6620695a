"""What the arm is asked to do: a mode each, whose `step` says where the tensions go next."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ..common.errors import TendonRobotError
from ..common.rotations import rotated
from .friction import Approach, Settling
from .state import Controller, Target
from .target_search import question_of

if TYPE_CHECKING:
    from ..model.shape import Reach, Shape
    from .trajectory import Trajectory

Array = NDArray[np.float64]
LEAD_MAX_M = 0.002  # [m] of the wanted tip before the reachable one, from where it comes back
LATE_MAX_S = 0.05  # [s] a later solution of a twist is not made up for: the tip would jump


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
    problem: str = ''  # why what was asked for ended

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
    def along(cls, target: Target, found: Approach, in_time: bool, ahead: Target) -> FollowTarget:
        """Follow the approach that was found for a target, or for one ahead of it."""
        return cls(target, found.reach, list(found.via), ahead.position, in_time)

    @property
    def stamp(self) -> str:
        """Of the target."""
        return self.target.stamp

    def step(self, core: Controller, passed: float) -> Array | None:
        """Return the next tensions on the way, or those of the target."""
        if self.via and _same(core.command, self.via[0]) and self._settled(core):
            self.via.pop(0)
        return self.via[0] if self.via else core.goal(self.reach.tensions)

    def _settled(self, core: Controller) -> bool:
        """Whether the arm has followed the command, or has been given the time."""
        measured = core.measured_tensions
        if measured is None or core.command is None or core.settings.pull_mode:
            return True
        low, high = core.settings.limits(core.model).T
        return self._settling.settled(core.time, core.command, measured, high - low)

    def moving(self, core: Controller) -> bool:
        """Whether the command is not yet where it goes."""
        goal = core.goal(self.reach.tensions)
        return bool(self.via) or not _same(core.command, goal)


@dataclass(frozen=True)
class Twist:
    """A velocity of the tip [m/s] and [rad/s], in base axes or in those of the tip."""

    linear: Array
    angular: Array
    in_tip: bool = False

    @property
    def moves(self) -> bool:
        """Whether it is a velocity at all."""
        return bool(self.linear.any() or self.angular.any())


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
        self._due = min(self._due + passed, LATE_MAX_S)
        if self.position is not None and not core.solver.busy('twist'):
            question = question_of(core, core.model, self._advanced(core), tracking=True)
            core.solver.post('twist', question.answer, self._found)
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

    def _found(self, found: Approach | None, error: TendonRobotError | None) -> None:
        """Take tensions; what is wanted stays near to where the tip can be."""
        if found is None:
            self.problem = str(error)
            return
        self.reach, shape = found.reach, found.reach.shape
        assert self.position is not None
        ahead = self.position - shape.tip_position
        distance = float(np.linalg.norm(ahead))
        if distance > LEAD_MAX_M:
            self.position = shape.tip_position + ahead * (LEAD_MAX_M / distance)
        self.axes = shape.frames[-1]

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
