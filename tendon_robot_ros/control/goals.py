"""A goal: targets one after another, or a trajectory; how far it is, and how it ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .checks import Refusal
from .state import Target
from .status import activity, controller_status, followed
from .trajectory import Trajectory

if TYPE_CHECKING:
    from .core import ControllerCore

Array = NDArray[np.float64]
ARRIVED = 'reached', 'played'
SHORT_OF_IT = 'nearest', 'at_limit'  # the arm stands, and not where it was asked to


@dataclass(frozen=True)
class GoalOutcome:
    """
    How a goal ended.

    The code is '' where it was reached; `canceled`; `ended` by something else that moves, holds or
    stops the arm; `path_tolerance` or `goal_tolerance`; what the status says of an arm that came
    not so far (`nearest`, `at_limit`); or that of a refusal.
    """

    code: str
    message: str


@dataclass(frozen=True)
class Tolerance:
    """What a trajectory may be off, (m,) [N] or [m], inf where it does not matter."""

    path: Array
    goal: Array
    time: float = np.inf  # [s] after its end in which it must be within `goal`


@dataclass(frozen=True)
class Progress:
    """How far a goal is; arrays are (3,) [m], or (m,) [N] or [m] of the tendons."""

    passed: float  # [s] since the goal was taken
    left: float  # [s] that the rest of this step takes at the rate limit
    steps_left: int  # this one counts
    tip: Array | None = None  # where the arm is, the tracker's correction included
    frame: Array | None = None  # (3, 3) of the tip
    distance: float = np.nan  # [m] from the tip to the target of this step
    desired: Array | None = None  # the trajectory now
    actual: Array | None = None  # as measured, nan where not observable


@dataclass
class MotionGoal:
    """
    Steps to be reached one after the other, each asked for when the one before is reached.

    The goal ends when all are reached, when the arm comes no nearer to one, or when the controller
    follows something else: a newer target or goal, a twist, a stop, a release.

    Parameters
    ----------
    steps : sequence of Target or Trajectory
        Their stamps tell them from everything else that the controller is asked for.
    tolerance : Tolerance, optional
        Of a trajectory.

    """

    steps: Sequence[Target | Trajectory]
    tolerance: Tolerance | None = None
    reached: int = field(default=0, init=False)  # so many of the steps
    _began: float = field(default=0.0, init=False)  # monotonic [s]

    @property
    def step(self) -> Target | Trajectory:
        """What is asked of the controller now."""
        return self.steps[self.reached]

    def begin(self, core: ControllerCore, now: float) -> None:
        """Ask for the first step; Refusal says why the controller does not take it."""
        self._began = now
        self._ask(core, now)

    def _ask(self, core: ControllerCore, now: float) -> None:
        for old in ('target', 'model'):
            core.refusals.pop(old, None)  # has been said
        if isinstance(step := self.step, Trajectory):
            core.play(now, step)
        else:
            core.aim(step)

    def look(self, core: ControllerCore, now: float) -> GoalOutcome | None:
        """Look how the goal is, ask for the next step where one is reached; None: it goes on."""
        if followed(core) != self.step.stamp:
            return GoalOutcome(*self._replaced(core, now))
        code, message = activity(core, now)[1:]
        if self.tolerance is not None and (off := self._outside(core, now, code)) is not None:
            self.cancel(core, now)
            return off
        if code in SHORT_OF_IT:
            return GoalOutcome(code, self._said(message))
        if code not in ARRIVED or not self._within(core):
            return None
        if self.reached == len(self.steps) - 1:
            return GoalOutcome('', message)
        self.reached += 1
        try:
            self._ask(core, now)
        except Refusal as refusal:
            return GoalOutcome(refusal.code, self._said(str(refusal)))
        return None

    def cancel(self, core: ControllerCore, now: float) -> None:
        """Hold the arm where it is commanded to be, unless something else moves it by now."""
        if followed(core) == self.step.stamp:
            core.play(now, None)

    def progress(self, core: ControllerCore, now: float) -> Progress:
        """Return how far it is."""
        step, passed, steps_left = self.step, now - self._began, len(self.steps) - self.reached
        if isinstance(step, Trajectory):
            playing = core.playing
            if playing is None:  # it is looked at first
                return Progress(passed, float(step.times[-1]), steps_left)
            left = max(playing.began + float(playing.times[-1]) - now, 0.0)
            desired, actual = playing.at(now), core.heard_values
            return Progress(passed, left, steps_left, desired=desired, actual=actual)
        left, shape = 0.0, core.track.last
        if core.solution is not None and core.command is not None:
            change = np.abs(core.solution.tensions - core.command).max()
            left = float(change) / core.settings.rate_limit
        if shape is None:
            return Progress(passed, left, steps_left)
        place = shape.tip_position if step.position is None else step.position
        tip = shape.tip_position + core.tip_bias(place)
        away = float(np.linalg.norm(tip - place))
        return Progress(passed, left, steps_left, tip, shape.frames[-1], away)

    def _said(self, message: str) -> str:
        many = f'pose {self.reached + 1} of {len(self.steps)}: ' if len(self.steps) > 1 else ''
        return many + message

    def _replaced(self, core: ControllerCore, now: float) -> tuple[str, str]:
        """Say why the controller follows something else."""
        status = controller_status(core, now)
        if status.level == 'error' or core.release.why:
            return 'ended', self._said(status.message)
        if not followed(core) and (refusal := core.refusals.get('target')) is not None:
            return refusal.code, self._said(str(refusal))
        return 'ended', self._said('a newer target, trajectory, twist or stop took its place')

    def _error(self, core: ControllerCore, wanted: Array) -> Array:
        """Return by how much (m,) the tendons are off; 0 where they are not observable."""
        return np.nan_to_num(np.abs(core.heard_values - wanted))

    def _within(self, core: ControllerCore) -> bool:
        """Whether the tendons are where a trajectory ends."""
        if self.tolerance is None or core.playing is None:
            return True
        return bool(np.all(self._error(core, core.playing.values[-1]) <= self.tolerance.goal))

    def _outside(self, core: ControllerCore, now: float, code: str) -> GoalOutcome | None:
        """Say that a trajectory is not followed as near as it was asked, None: it is."""
        tolerance, playing = self.tolerance, core.playing
        if tolerance is None or playing is None:
            return None
        late = now - playing.began - float(playing.times[-1])
        if late <= 0.0:
            name, allowed, wanted = 'path_tolerance', tolerance.path, playing.at(now)
        elif late > tolerance.time:
            name, allowed, wanted = 'goal_tolerance', tolerance.goal, playing.values[-1]
        else:
            return None
        error = self._error(core, wanted)
        worst = int(np.argmax(error - allowed))
        if error[worst] <= allowed[worst] and (name == 'path_tolerance' or code == 'played'):
            return None
        unit = 'm' if core.settings.pull_mode else 'N'
        return GoalOutcome(
            name,
            f'{core.model.inputs[worst]}: {error[worst]:.4g} {unit} from the trajectory, allowed '
            f'are {allowed[worst]:.4g}; the arm holds',
        )
