"""
The closed loop: tensions at which the measured tip is at its target.

The estimator (tip_estimator.py) runs at the estimated tensions, on the path to a target as well as
at it. A step of bounded least squares with the corrected Jacobian then moves the goal of the
tensions. The estimator compares measured states, not commands, so that neither lag nor limits
cause windup. The command slows down towards a setpoint, so that the bias is estimated on the path
and the tip does not overshoot.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..common.errors import TendonRobotError
from ..model.program import bounded_least_squares
from .driver_side import SILENCE_MAX_S
from .null_space import HOLD_GAIN, SLOPE_LENGTH_SD, NullSpaceMotion
from .tip_estimator import (
    MODEL_SLOPE_SD,
    RANGE_TOLERANCE,
    TRACKER_NOISE_M,
    WEAK_SLOPE,
    TipEstimate,
    TipStep,
    bias_part,
)

if TYPE_CHECKING:
    from .solver import GiveUp
    from .state import Controller

Array = NDArray[np.float64]
# [s] without a measurement; longer than three frames at 30 Hz, else one lost frame would stop the
# loop
TRACKER_SILENT_S = 0.1
# [m] between two measurements, beyond the model's path; no arm moves so fast, so that it is an
# error of the tracker (docs/control.md)
TRACKER_JUMP_M = 0.02
# [1] of the arm's length; a bias beyond it would be that of another arm or frame (docs/control.md)
BIAS_LENGTH_MAX = 0.4
# [1] of `tip_gain`: rate at which the distance to a setpoint shrinks, so that the bias is known
# before the tip arrives (docs/control.md)
PACE = 2.0
# [1] measurements that are kept for the delay of a tracker: 0.5 s at 120 Hz; with a longer delay
# it would count as silent
HISTORY_MAX = 64
# [s] without progress, after which the remainder is reported, so that it has settled; five times
# the loop's 0.2 s
NO_NEARER_S = 1.0
# [1] of the last distance: a change counts from here, because noise changes it by less
CHANGED = 0.2
# [1] of the distance: half of its square then has one cause, so that only one is named
CAUSE = 0.5**0.5
# [1] of the arm's length: the bias of a calibrated model is smaller (docs/control.md)
FOREIGN_LENGTH = 0.05


class _TrackedTip(NamedTuple):
    """A measurement of the tip."""

    time: float  # [s]
    position: Array  # (3,) [m]
    modelled: Array | None  # (3,) [m] tip of the model at that time


@dataclass(frozen=True)
class Remainder:
    """
    The remaining error of the tip in closed loop.

    Attributes
    ----------
    off : (3,) [m]
        Target minus filtered measured tip.
    slopes : (3, m) [m]
        Jacobian of the tip times the ranges of the tensions.
    room : (2, m) [1]
        Margins of the tensions to their lower and upper limits, relative to the ranges.
    rest : float
        Distance that the tracker does not resolve [m]; see `TipEstimate.rest`.
    region : str
        Keep-out region that the next step would enter, '' for none.

    """

    off: Array
    slopes: Array
    room: Array
    rest: float
    region: str = ''

    @property
    def distance(self) -> float:
        """Distance [m] from the tip to its target."""
        return float(np.linalg.norm(self.off))

    @property
    def reached(self) -> bool:
        """Whether the tip is at its target, within the resolution of the tracker."""
        return self.distance <= max(2.0 * self.rest, TRACKER_NOISE_M)

    def why(self, inputs: Sequence[str]) -> str:
        """Return the cause of the error in words, for named inputs; '' where none is known."""
        if self.region:
            return f'kept out of {self.region}'
        axes, sizes, _ = np.linalg.svd(self.slopes, full_matrices=False)
        parts, weak = axes.T @ self.off, sizes < WEAK_SLOPE * sizes[0]
        if np.linalg.norm(parts[weak]) > CAUSE * self.distance:
            part = axes[:, weak] @ parts[weak]
            along = ', '.join(f'{x:.2f}' for x in (part / np.linalg.norm(part)).round(2) + 0.0)
            return (
                f'{1e3 * np.linalg.norm(part):.2f} mm of it along ({along}), where the tendons '
                f'lead the tip by {1e3 * sizes[weak].max():.2f} mm over their whole range'
            )
        strong, far = axes[:, ~weak].T @ self.slopes, parts[~weak]
        stopped = self.room < RANGE_TOLERANCE
        step = bounded_least_squares(
            strong, far, np.where(stopped[0], 0.0, -1e3), np.where(stopped[1], 0.0, 1e3)
        )
        residual = far - strong @ step
        if np.linalg.norm(residual) < CAUSE * self.distance:
            return ''
        more = strong.T @ residual > 0.0  # more of that tension would reduce the error
        at = np.where(more, stopped[1], stopped[0])
        names = (name for name, ended in zip(inputs, at, strict=True) if ended)
        return f'at its limit: {", ".join(names)}'


@dataclass
class TipProgress:
    """Distance to one target, and the time since it last changed."""

    target: object = None
    remainder: Remainder | None = None
    nearest: float = np.inf  # [m]
    since: float = np.inf  # [s]

    def take(self, now: float, target: object, remainder: Remainder) -> None:
        """Take the present remainder; a new target restarts the clock."""
        distance, before = remainder.distance, self.nearest
        changed = abs(distance - before) > max(CHANGED * before, TRACKER_NOISE_M)
        if target is not self.target or changed:
            self.nearest, self.since = distance, now
        self.target, self.remainder = target, remainder

    def settled(self, now: float) -> Remainder | None:
        """Return the remainder once it does not change any more."""
        return self.remainder if now - self.since >= NO_NEARER_S else None


def foreign(offset: float, length: float, remembers: bool) -> str:
    """
    Return advice about a model whose bias is too large for a calibrated one; '' for a small bias.

    Parameters
    ----------
    offset, length : float
        Bias of the tip, and length of the arm [m].
    remembers : bool
        Whether the model has friction memory.

    """
    if offset < FOREIGN_LENGTH * length:
        return ''
    lacks = '' if remembers else ', often friction_memory'
    return (
        f'the model is {1e3 * offset:.0f} mm off the arm here: a load, or an effect that it '
        f'lacks{lacks}; diagnose tells which'
    )


@dataclass
class TipLoop:
    """
    Moves the goal of the tensions until the measured tip is at the target.

    Frozen while the tracker is silent for 0.1 s, and for 0.2 s after a jump of more than 20 mm.
    After a second of silence the next target ignores the estimate. The loop is abandoned for the
    present target where the bias is larger than on any arm of this kind: the tensions are then
    those of the model.
    """

    tensions: Array | None = None  # (m,) [N] goal, None: that of the model
    frozen: str = 'no tracker'  # reason, '' while the loop runs
    abandoned: str = ''  # reason for the present target
    estimate: TipEstimate | None = None
    motion: NullSpaceMotion | None = None  # in progress
    progress: TipProgress = field(default_factory=TipProgress)
    _tip: _TrackedTip | None = None
    _history: deque[tuple[float, Array, Array]] = field(  # [s], acting tensions, model's tip
        default_factory=lambda: deque(maxlen=HISTORY_MAX)
    )
    _compared: Array | None = None  # (3,) [m] model's tip of the last comparison
    _jumped: float = -np.inf  # [s]
    _error: Array = field(default_factory=lambda: np.full(3, np.nan))  # [m]
    _solution: object = None  # to which `tensions` belong
    _target: object = None  # of the loop
    _near: float = -np.inf  # [s] when the bias was last within its limit
    _due: float = 0.0  # [s] since the last update of the estimator

    def reset(self) -> None:
        """Forget the estimate and the goal."""
        self.tensions = self.estimate = self.motion = self._solution = self._compared = None
        self.progress, self._due = TipProgress(), 0.0
        self._history.clear()

    def in_null_space(self, core: Controller) -> bool:
        """Whether a null-space motion is in progress."""
        motion = self.motion
        return motion is not None and motion.solution is core.solution and not self.frozen

    def goal(self, core: Controller, solution: Array) -> Array:
        """Return the goal (m,) [N], within the limits."""
        if self.tensions is None or core.settings.tip_gain == 0.0:
            return solution
        if self._solution is not core.solution:
            return solution  # of a new target, whose search includes the bias
        low, high = core.settings.limits(core.model).T
        return np.clip(self.tensions, low, high)

    def paced(self, core: Controller, goal: Array, longest: float, passed: float) -> float:
        """
        Return the step of the command [N], which slows down towards a setpoint.

        Parameters
        ----------
        goal : (m,) [N]
        longest : float
            Step by the rate limit [N].
        passed : float
            Time since the last step [s].

        """
        gain = core.settings.tip_gain
        if gain == 0.0 or self._silent(core.time) or self.abandoned or core.streaming:
            return longest
        if _at_goal(core, goal, 0.1 * RANGE_TOLERANCE):
            return longest  # arrived
        assert core.command is not None
        remaining = float(np.abs(goal - core.command).max())
        return min(longest, remaining * (1.0 - float(np.exp(-PACE * gain * passed))))

    def bias(self, now: float, place: Array, length: float) -> Array:
        """
        Return the bias (3,) [m] of the model's tip near a position (3,) [m].

        It falls with the distance from the measured tip, and is 0 once the tracker is lost.
        """
        if self._tip is None or now - self._tip.time > SILENCE_MAX_S or self.estimate is None:
            return np.zeros(3)
        distance = float(np.linalg.norm(place - self._tip.position))
        return self.estimate.bias * bias_part(distance, length)

    def take(self, now: float, core: Controller, position: Array) -> None:
        """Take a measured tip (3,) [m] in the base frame."""
        last, before = core.track.last, self._tip
        self._tip = tip = _TrackedTip(now, position, None if last is None else last.tip_position)
        self.frozen = self._why_frozen(core, before, tip)
        if before is not None:
            self._due = min(self._due + now - before.time, TRACKER_SILENT_S)
        if not self.frozen and not core.solver.busy('loop') and not core.settings.pull_mode:
            self._compare(now, core, position)

    def values(self, now: float) -> dict[str, str]:
        """Return correction and measured error for the status."""
        frozen = 'tracker silent' if self._silent(now) else self.frozen
        bias = 0.0 if self.estimate is None else float(np.linalg.norm(self.estimate.bias))
        return {
            'correction (m)': f'{bias:.4g}',
            'correction_frozen': frozen,
            'measured_error (m)': f'{np.linalg.norm(self._error):.4g}',
        }

    def remainder(self, now: float) -> Remainder | None:
        """Return the remaining error of the tip once it does not change any more."""
        return None if self._silent(now) or self.frozen else self.progress.settled(now)

    def _silent(self, now: float) -> bool:
        return self._tip is None or now - self._tip.time > TRACKER_SILENT_S

    def _why_frozen(self, core: Controller, before: _TrackedTip | None, tip: _TrackedTip) -> str:
        """Return why a measurement is not used, '' where it is."""
        if before is None or tip.time - before.time > TRACKER_SILENT_S:
            return 'tracker silent'
        path = 0.0
        if tip.modelled is not None and before.modelled is not None:
            path = float(np.linalg.norm(tip.modelled - before.modelled))
        if np.linalg.norm(tip.position - before.position) > TRACKER_JUMP_M + path:
            self._jumped = tip.time
        if tip.time - self._jumped < 2.0 * TRACKER_SILENT_S:
            return 'tracker jumped'
        target = core.target
        if target is None or target.position is None or core.solution is None:
            return 'no target'
        self._error = target.position - tip.position
        if core.command is None or not core.follows(tip.time):
            return 'stopped'
        if target is not self._target:
            self._target, self._near, self.abandoned = target, core.time, ''
        if self.estimate is not None and not self.abandoned:
            off = float(np.linalg.norm(self.estimate.bias))
            if off <= BIAS_LENGTH_MAX * core.model.robot.length:
                self._near = core.time
            elif core.time - self._near > 3.0 * TRACKER_SILENT_S:  # not a short snap of the arm
                self.abandoned, self.tensions, self.estimate = 'too far from the model', None, None
        return self.abandoned

    def _compare(self, now: float, core: Controller, position: Array) -> None:
        """Post the comparison of the measured tip with the model's, and the next goal."""
        solution, desired, model, target = core.solution, core.desired_tip, core.model, core.target
        assert solution is not None and desired is not None
        acting, offset, length = core.acting_tensions(), core.acting_offset, model.robot.length
        limits, keep_out = core.settings.limits(model), core.settings.keep_out
        goal, last, known = self.goal(core, solution.tensions), core.track.last, self.estimate
        motion = self.motion if self.in_null_space(core) else None
        passed, self._due = self._due, 0.0
        rate = core.settings.tip_gain if motion is None else HOLD_GAIN
        gain = 1.0 - float(np.exp(-rate * passed))
        sample_time = now - core.settings.tracker_delay  # [s] of the tracker's exposure
        then, before = self._then(sample_time), self._compared
        oldest = self._history[0][0] if self._history else np.inf
        known_then = sample_time == now or sample_time >= oldest
        arrived = _at_goal(core, goal, RANGE_TOLERANCE) and not core.streaming

        def work(give_up: GiveUp) -> _Compared:
            shape = model.follow(last, acting)
            step = TipStep.at(model, shape, desired, offset, limits, arrived)
            at, tip = (acting, shape.tip_position) if then is None else then
            path = 0.0 if before is None else float(np.linalg.norm(tip - before))
            if motion is None:
                doubt = MODEL_SLOPE_SD * np.linalg.norm(step.slopes, axis=0)
            else:
                doubt = np.full(len(at), SLOPE_LENGTH_SD * length)
            new = (known or TipEstimate.begin(at, limits, doubt)).about(at)
            if motion is not None and motion.place is None:
                new = new.without_slopes(doubt)  # slopes of motions of the tip do not apply
            if known_then:
                fading = passed if motion is None else 0.0
                new = new.updated(position - tip, gain, doubt, fading, path, length)
            new = new.about(acting).within(step.slopes)
            if motion is None:
                moved, next_goal = None, step.next_goal(new, goal)
            else:
                moved, next_goal = motion.step(step, goal, new, passed)
            next_goal, region = step.allowed(next_goal, goal, keep_out)
            low, high = limits.T
            remainder = Remainder(
                desired - shape.tip_position - new.bias,
                step.slopes,
                np.array([goal - low, high - goal]) / (high - low),
                new.rest,
                region,
            )
            return _Compared(new, next_goal, shape.tip_position, tip, moved, remainder)

        def done(result: _Compared | None, error: TendonRobotError | None) -> None:
            if result is None or core.model is not model or core.target is None:
                return
            self.estimate, self._compared = result.estimate, result.compared
            self._history.append((now, acting, result.tip))
            if core.solution is solution:
                self.tensions, self._solution = result.goal, solution
                self.progress.take(now, target, result.remainder)
                if self.motion is motion:
                    self.motion = result.motion

        core.solver.post('loop', work, done)

    def _then(self, time: float) -> tuple[Array, Array] | None:
        """Return tensions (m,) [N] and the model's tip (3,) [m] at a past time [s]; None: now."""
        history = self._history
        if not history or time >= history[-1][0]:
            return None
        times = [one[0] for one in history]
        place = max(int(np.searchsorted(times, time, side='right')) - 1, 0)
        (begin, *first), (end, *second) = history[place], history[min(place + 1, len(times) - 1)]
        part = min(max((time - begin) / (end - begin), 0.0), 1.0) if end > begin else 0.0
        tensions, tip = (a + part * (b - a) for a, b in zip(first, second, strict=True))
        return tensions, tip


class _Compared(NamedTuple):
    """Result of one comparison of the measured tip with the model's."""

    estimate: TipEstimate
    goal: Array  # (m,) [N]
    tip: Array  # (3,) [m] of the model, now
    compared: Array  # (3,) [m] of the model, at the exposure
    motion: NullSpaceMotion | None
    remainder: Remainder


def _at_goal(core: Controller, goal: Array, tolerance: float) -> bool:
    """Whether the command is at its goal (m,) [N], within a tolerance [1] of the ranges."""
    assert core.command is not None
    low, high = core.settings.limits(core.model).T
    return bool(np.all(np.abs(goal - core.command) < tolerance * (high - low)))
