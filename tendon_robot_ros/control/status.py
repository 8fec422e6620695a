"""
How the controller is, as a level, a code, a sentence and values; how far a goal is, and its end.

A goal is targets one after another, or a trajectory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import degrees
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .checks import Refusal
from .driver_side import GO_ON
from .modes import FollowTarget
from .state import Target, Trajectory
from .tip_loop import foreign

if TYPE_CHECKING:
    from ..model.shape import Reach
    from .core import ControllerCore

Array = NDArray[np.float64]
OK, WARN, ERROR = 'ok', 'warn', 'error'
ARRIVED = 'reached', 'played'
SHORT_OF_IT = 'nearest', 'at_limit'  # the arm stands, and not where it was asked to


@dataclass(frozen=True)
class ControllerStatus:
    """The first thing that a person should know comes as level, code and message."""

    level: str
    code: str
    message: str


def controller_status(core: ControllerCore, now: float) -> ControllerStatus:
    """Return how the controller is; codes are listed in docs/ros_interface.md."""
    return ControllerStatus(*_condition(core, now))


def controller_values(core: ControllerCore, now: float) -> dict[str, str]:
    """Return the values of the status, with their unit in the key: docs/ros_interface.md."""
    values = {'moving': str(core.moving).lower()}
    if stamp := followed(core):
        values['target_stamp'] = stamp
    if core.playing is not None:
        values['trajectory_time (s)'] = f'{core.playing.passed(now):.3f}'
        values['trajectory_duration (s)'] = f'{core.playing.times[-1]:.3f}'
    if core.solution is not None:
        solution = core.solution
        values |= {
            'solution': solution.status,
            'position_error (m)': f'{solution.position_error:.3g}',
            'direction_error (rad)': f'{solution.direction_error:.3g}',
            'at_limit': ', '.join(solution.at_limit),
            'kept_out_of': solution.region,
        }
    if core.command is not None:
        for name, tension in zip(core.model.inputs, core.command, strict=True):
            values[f'tension {name} (N)'] = f'{tension:.4f}'
    values.update(core.null_space.values())
    if core.settings.tip_gain > 0.0:
        values.update(core.loop.values(now))
    return values


def followed(core: ControllerCore) -> str:
    """Return the stamp of the target or the trajectory that the controller is at, '' for none."""
    if core.driver.waiting is not None:
        return core.driver.stamp
    if core.search is not None:
        return core.search.target.stamp
    for one in (core.looked_at, core.playing, core.target):
        if one is not None:
            return one.stamp
    return ''


def _condition(core: ControllerCore, now: float) -> tuple[str, str, str]:
    if core.latch:
        return ERROR, 'stopped', '; '.join(core.latch.reasons) + '; call reset to go on'
    if core.driver.stopped:
        return ERROR, 'driver_stopped', f'the driver does not follow: {core.driver.stopped}'
    if not core.fresh(now):
        if core.command is None:
            return WARN, 'waiting', 'no tendon_states yet: is the driver running?'
        silent = (
            f'no tendon_states for {core.settings.state_timeout:g} s; holding the last command'
        )
        if core.driver.gone(now, core.settings):
            timeout = core.settings.state_timeout
            silent = f'no tendon_states for {timeout:g} s; no commands until they are back'
        return ERROR, 'no_driver', silent
    if core.driver.released:
        refusal = core.refusals.get('target')
        again = f'; {refusal}' if refusal is not None else ''
        return WARN, 'released', f'the driver let go: {core.driver.released}; {GO_ON}{again}'
    if core.track.problem:
        return ERROR, 'no_equilibrium', core.track.problem
    for refusal in core.refusals.values():
        return WARN, f'refused_{refusal.code}', str(refusal)
    return activity(core, now)


def activity(core: ControllerCore, now: float) -> tuple[str, str, str]:
    """Return level, code and sentence of what the arm does, where nothing keeps it from that."""
    if core.search is not None:
        passed = now - core.search.began
        if core.search.streamed and passed < core.search.budget:
            return OK, 'moving', 'moving to the target'
        return OK, 'searching', f'looking for tensions for the target, for {passed:.1f} s'
    if core.jogging:
        return OK, 'jogging', 'following a twist'
    if core.playing is not None:
        if core.playing.over(now) and not core.moving:
            return OK, 'played', 'at the end of the trajectory of the tendons'
        passed, whole = core.playing.passed(now), core.playing.times[-1]
        return OK, 'playing', f'playing a trajectory: {passed:.2f} of {whole:.2f} s'
    if core.solution is None:
        return OK, 'holding', 'waiting for a target'
    if core.settings.tip_gain > 0.0 and (seen := _as_seen(core, now)) is not None:
        return seen
    if core.moving:
        return OK, 'moving', 'moving to the target'
    return _arrived(core.solution, not isinstance(core.mode, FollowTarget) or core.mode.in_time)


def _as_seen(core: ControllerCore, now: float) -> tuple[str, str, str] | None:
    """Say where the tip is as the tracker sees it; None where the model alone tells."""
    if core.loop.left:
        return WARN, 'nearest', f'the closed loop was left: {core.loop.left}; the model says where'
    doubt, left = '', core.loop.remainder(now)
    if core.loop.estimate is not None:  # far from the arm, as the loop has learned?
        offset = float(np.linalg.norm(core.loop.estimate.bias))
        said = foreign(offset, core.model.robot.length, core.model.remembers)
        doubt = f'; {said}' if said else ''
    if left is None:
        loop = core.loop.values(now)['correction_frozen']
        return None if loop else (OK, 'moving', f'moving to the target{doubt}')
    off = f'{1e3 * left.away:.2f} mm'
    if left.none:
        assert core.solution is not None and core.target is not None
        if core.target.direction is not None and core.solution.status != 'reached':
            return None
        return OK, 'reached', f'at the target within {off}, as the tracker sees it{doubt}'
    why = left.why(core.model.inputs) or 'it comes no nearer now'
    return WARN, 'nearest', f'as near as it can, {off} from the target: {why}{doubt}'


def _arrived(solution: Reach, in_time: bool) -> tuple[str, str, str]:
    error = f'{1e3 * solution.position_error:.2f} mm and {degrees(solution.direction_error):.2f}°'
    if solution.status == 'reached':
        return OK, 'reached', f'at the target within {error}, as the model sees it'
    limits = ', '.join(solution.at_limit)
    limits = f'; at its limit: {limits}' if limits else ''
    limits += f'; kept out of {solution.region}' if solution.region else ''
    if not in_time:
        return WARN, solution.status, f'as near as found in time, {error} from the target{limits}'
    return WARN, solution.status, f'as near as it can, {error} from the target{limits}'


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
            status = controller_status(core, now)
            refused = None if followed(core) else core.refusals.get('target')
            if status.level == ERROR or core.driver.released:
                return GoalOutcome('ended', self._said(status.message))
            if refused is not None:
                return GoalOutcome(refused.code, self._said(str(refused)))
            why = 'a newer target, trajectory, twist or stop took its place'
            return GoalOutcome('ended', self._said(why))
        code, message = activity(core, now)[1:]
        if self.tolerance is not None and (off := self._outside(core, now, code)) is not None:
            self.cancel(core, now)
            return off
        if code in SHORT_OF_IT:
            return GoalOutcome(code, self._said(message))
        within = self.tolerance is None or core.playing is None
        if self.tolerance is not None and core.playing is not None:  # where a trajectory ends
            error = self._error(core, core.playing.values[-1])
            within = bool(np.all(error <= self.tolerance.goal))
        if code not in ARRIVED or not within:
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

    def _error(self, core: ControllerCore, wanted: Array) -> Array:
        """Return by how much (m,) the tendons are off; 0 where they are not observable."""
        return np.nan_to_num(np.abs(core.heard_values - wanted))

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
