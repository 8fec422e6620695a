"""
Status of the controller (level, code, message, values); progress and outcome of motion goals.

A motion goal is a sequence of targets, or a trajectory of the tendons.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import degrees
from typing import NamedTuple

import numpy as np

from ..common.arrays import Floats
from ..model.shape import Reach
from .core import ControllerCore
from .inputs import Refusal, Target, Trajectory
from .modes import FollowTarget
from .state import GO_ON, Mode
from .tip_loop import foreign

OK, WARN, ERROR = 'ok', 'warn', 'error'
ARRIVED = 'reached', 'played'
NOT_REACHED = 'nearest', 'at_limit'  # the arm rests beside its target


class ControllerStatus(NamedTuple):
    """The most important condition."""

    level: str
    code: str
    message: str


def controller_values(core: ControllerCore, now: float) -> dict[str, str]:
    """Return the values of the status, with their unit in the key: docs/ros_nodes.md."""
    values = {'moving': str(core.moving).lower()}
    if stamp := followed(core):
        values['target_stamp'] = stamp
    if core.playing is not None:
        values['trajectory_time (s)'] = f'{core.playing.passed(now):.3f}'
        values['trajectory_duration (s)'] = f'{core.playing.times[-1]:.3f}'
    if (solution := core.solution) is not None:
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
    """Return the stamp of the current target or trajectory, '' for none."""
    if core.driver.waiting is not None:
        return core.driver.stamp
    if core.search is not None:
        return core.search.target.stamp
    for one in (core.pending_trajectory, core.playing, core.target):
        if one is not None:
            return one.stamp
    return ''


def controller_status(core: ControllerCore, now: float) -> ControllerStatus:
    """Return the status of the controller; docs/ros_nodes.md lists the codes."""
    if core.latch:
        reasons = '; '.join(core.latch.reasons)
        return ControllerStatus(ERROR, 'stopped', f'{reasons}; call reset to go on')
    if core.driver.stopped:
        message = f'the driver does not follow: {core.driver.stopped}'
        return ControllerStatus(ERROR, 'driver_stopped', message)
    if not core.fresh(now):
        if core.command is None:
            message = 'no tendon_states yet: is the driver running?'
            return ControllerStatus(WARN, 'waiting', message)
        over = core.driver.timed_out(now, core.settings)
        follows = 'no commands until they are back' if over else 'holding the last command'
        message = f'no tendon_states for {core.settings.state_timeout:g} s; {follows}'
        return ControllerStatus(ERROR, 'no_driver', message)
    if core.driver.released:
        refusal = core.refusals.get('target')
        refused = f'; {refusal}' if refusal is not None else ''
        message = f'the driver let go: {core.driver.released}; {GO_ON}{refused}'
        return ControllerStatus(WARN, 'released', message)
    if core.track.problem:
        return ControllerStatus(ERROR, 'no_equilibrium', core.track.problem)
    for refusal in core.refusals.values():
        return ControllerStatus(WARN, f'refused_{refusal.code}', str(refusal))
    return activity(core, now)


def activity(core: ControllerCore, now: float) -> ControllerStatus:
    """Return the status of the current motion, where nothing prevents it."""
    moving = ControllerStatus(OK, 'moving', 'moving to the target')
    if core.driver.waiting is not None:  # the mode is that of the command before
        return ControllerStatus(OK, 'holding', 'waiting for the driver')
    if core.search is not None:
        passed = now - core.search.began
        if core.search.streamed and passed < core.search.budget:
            return moving
        message = f'looking for tensions for the target, for {passed:.1f} s'
        return ControllerStatus(OK, 'searching', message)
    if core.jogging:
        return ControllerStatus(OK, 'jogging', 'following a twist')
    if core.playing is not None:
        passed, whole = core.playing.passed(now), core.playing.times[-1]
        if passed == whole and not core.moving:
            return ControllerStatus(OK, 'played', 'at the end of the trajectory of the tendons')
        message = f'playing a trajectory: {passed:.2f} of {whole:.2f} s'
        return ControllerStatus(OK, 'playing', message)
    if core.solution is None:
        return ControllerStatus(OK, 'holding', 'waiting for a target')
    if core.settings.tip_gain > 0.0 and (measured := _measured_condition(core, now)) is not None:
        return measured
    return moving if core.moving else _arrived(core.solution, core.mode)


def _measured_condition(core: ControllerCore, now: float) -> ControllerStatus | None:
    """Return the condition by the tracked tip; None where only the model can tell."""
    if left := core.loop.left(core.target):
        message = f'the closed loop was left: {left}; the model says where'
        return ControllerStatus(WARN, 'nearest', message)
    doubt, remainder = '', core.loop.remainder(now, core.target)
    if core.loop.estimate is not None:  # a bias that is too large for a calibrated model
        offset = float(np.linalg.norm(core.loop.estimate.bias))
        robot = core.model.robot
        advice = foreign(offset, robot.length, core.model.remembers, robot.model_error or 0.0)
        doubt = f'; {advice}' if advice else ''
    if remainder is None:
        if core.loop.why_frozen(now):
            return None
        return ControllerStatus(OK, 'moving', f'moving to the target{doubt}')
    off = f'{1e3 * remainder.distance:.2f} mm'
    if remainder.reached:
        assert core.solution is not None and core.target is not None
        if core.target.direction is not None and core.solution.status != 'reached':
            return None
        message = f'at the target within {off}, as the tracker sees it{doubt}'
        return ControllerStatus(OK, 'reached', message)
    why = remainder.why(core.model.inputs) or 'it comes no nearer now'
    message = f'as near as it can, {off} from the target: {why}{doubt}'
    return ControllerStatus(WARN, 'nearest', message)


def _arrived(solution: Reach, mode: Mode) -> ControllerStatus:
    error = f'{1e3 * solution.position_error:.2f} mm and {degrees(solution.direction_error):.2f}°'
    if solution.status == 'reached':
        message = f'at the target within {error}, as the model sees it'
        return ControllerStatus(OK, 'reached', message)
    limits = ', '.join(solution.at_limit)
    limits = f'; at its limit: {limits}' if limits else ''
    limits += f'; kept out of {solution.region}' if solution.region else ''
    late = isinstance(mode, FollowTarget) and not mode.in_time
    near = 'as near as found in time' if late else 'as near as it can'
    return ControllerStatus(WARN, solution.status, f'{near}, {error} from the target{limits}')


@dataclass(frozen=True)
class GoalOutcome:
    """
    How a goal ended.

    The code is '' for a goal that was reached, `canceled`, `ended` (another command moves, holds
    or stops the arm), `path_tolerance` or `goal_tolerance` (a trajectory was not followed),
    `nearest` or `at_limit` (the arm rests beside its target), or the code of a refusal.
    """

    code: str
    message: str


@dataclass(frozen=True)
class Tolerance:
    """Allowed errors of a trajectory, (m,) [N] or [m]; inf where any error is allowed."""

    path: Floats
    goal: Floats
    time: float = np.inf  # [s] after its end in which it must be within `goal`


@dataclass(frozen=True)
class Progress:
    """Progress of a goal; arrays are (3,) [m] of the tip, or (m,) [N] or [m] of the tendons."""

    passed: float  # [s] since the goal was accepted
    remaining: float  # [s] for the rest of this step at the rate limit
    steps_remaining: int  # including this one
    tip: Floats | None = None  # position of the model, corrected by the tracker
    frame: Floats | None = None  # (3, 3) of the tip
    distance: float = np.nan  # [m] from the tip to the target of this step
    desired: Floats = field(default_factory=lambda: np.zeros(0))  # the trajectory now
    actual: Floats = field(default_factory=lambda: np.zeros(0))  # nan where not observable


@dataclass
class MotionGoal:
    """
    Steps to be reached in sequence; each is commanded when the previous one is reached.

    The goal ends when all steps are reached, when the arm comes no nearer to one of them, or when
    the controller follows another command: a newer target or goal, a twist, a stop, a release.

    Parameters
    ----------
    steps : sequence of Target or Trajectory
        Their stamps distinguish them from other commands to the controller.
    tolerance : Tolerance, optional
        Allowed errors of a trajectory.

    """

    steps: Sequence[Target | Trajectory]
    tolerance: Tolerance | None = None
    reached: int = field(default=0, init=False)  # number of steps
    _began: float = field(default=0.0, init=False)  # monotonic [s]

    @property
    def step(self) -> Target | Trajectory:
        """The step that the controller follows now."""
        return self.steps[self.reached]

    def begin(self, core: ControllerCore, now: float) -> None:
        """Command the first step; raise the Refusal of a controller that rejects it."""
        self._began = now
        self._ask(core, now)

    def _ask(self, core: ControllerCore, now: float) -> None:
        for old in ('target', 'model'):
            core.refusals.pop(old, None)  # of an earlier command
        if isinstance(step := self.step, Trajectory):
            core.play(now, step)
        else:
            core.aim(step)

    def update(self, core: ControllerCore, now: float) -> GoalOutcome | None:
        """Return the outcome, None while the goal is pursued; command the next step when due."""
        if followed(core) != self.step.stamp:
            status = controller_status(core, now)
            refused = None if followed(core) else core.refusals.get('target')
            if status.level == ERROR or core.driver.released:
                return GoalOutcome('ended', self._message(status.message))
            if refused is not None:
                return GoalOutcome(refused.code, self._message(str(refused)))
            why = 'a newer target, trajectory, twist or stop took its place'
            return GoalOutcome('ended', self._message(why))
        _, code, message = activity(core, now)
        if (off := self._outside(core, now, code)) is not None:
            self.cancel(core, now)
            return off
        if code in NOT_REACHED:
            return GoalOutcome(code, self._message(message))
        within = True
        if self.tolerance is not None and core.playing is not None:  # the error at its end
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
            return GoalOutcome(refusal.code, self._message(str(refusal)))
        return None

    def cancel(self, core: ControllerCore, now: float) -> None:
        """Hold the commanded position, unless another command moves the arm by now."""
        if followed(core) == self.step.stamp:
            core.play(now, None)

    def progress(self, core: ControllerCore, now: float) -> Progress:
        """Return the progress of the goal."""
        step, passed = self.step, now - self._began
        steps_remaining = len(self.steps) - self.reached
        if isinstance(step, Trajectory):
            playing = core.playing
            if playing is None:  # the solver still checks it against the regions
                return Progress(passed, float(step.times[-1]), steps_remaining)
            remaining = max(playing.began + float(playing.times[-1]) - now, 0.0)
            desired, actual = playing.at(now), core.measured_values
            return Progress(passed, remaining, steps_remaining, desired=desired, actual=actual)
        remaining, shape = 0.0, core.track.last
        if core.solution is not None and core.command is not None:
            change = np.abs(core.solution.tensions - core.command).max()
            remaining = float(change) / core.settings.rate_limit
        if shape is None:
            return Progress(passed, remaining, steps_remaining)
        place = shape.tip_position if step.position is None else step.position
        tip = shape.tip_position + core.tip_bias(place)
        distance = float(np.linalg.norm(tip - place))
        return Progress(passed, remaining, steps_remaining, tip, shape.frames[-1], distance)

    def _message(self, message: str) -> str:
        many = f'pose {self.reached + 1} of {len(self.steps)}: ' if len(self.steps) > 1 else ''
        return many + message

    def _error(self, core: ControllerCore, desired: Floats) -> Floats:
        """Return the absolute errors of the tendons (m,); 0 where they are not observable."""
        return np.nan_to_num(np.abs(core.measured_values - desired))

    def _outside(self, core: ControllerCore, now: float, code: str) -> GoalOutcome | None:
        """Return the outcome of a trajectory that exceeds its tolerance, None of one within it."""
        tolerance, playing = self.tolerance, core.playing
        if tolerance is None or playing is None:
            return None
        late = now - playing.began - float(playing.times[-1])
        if late <= 0.0:
            name, allowed, desired = 'path_tolerance', tolerance.path, playing.at(now)
        elif late > tolerance.time:
            name, allowed, desired = 'goal_tolerance', tolerance.goal, playing.values[-1]
        else:
            return None
        error = self._error(core, desired)
        worst = int(np.argmax(error - allowed))
        if error[worst] <= allowed[worst] and (name == 'path_tolerance' or code == 'played'):
            return None
        unit = 'm' if core.settings.pull_mode else 'N'
        return GoalOutcome(
            name,
            f'{core.model.inputs[worst]}: {error[worst]:.4g} {unit} from the trajectory, allowed '
            f'are {allowed[worst]:.4g}; the arm holds',
        )
