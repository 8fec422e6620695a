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

import numpy as np

from ..common.arrays import Floats, interpolated
from ..common.local_stop import SILENCE_S
from ..model.program import RANGE_TOLERANCE, bounded_least_squares
from ..robot.estimates import MODEL_ERROR_MAX, TRACKER_NOISE_M
from .solver import Failure, GiveUp
from .state import ControllerState, TipCorrection, TrackedTip, is_near
from .tip_estimator import (
    HOLD_GAIN,
    MODEL_SLOPE_SD,
    WEAK_SLOPE,
    NullSpaceMotion,
    TipEstimate,
    TipStep,
)

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
# [1] of the error that the description knows: a larger bias comes by chance in 1 % of postures
KNOWN_FACTOR = 2.0


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

    off: Floats
    slopes: Floats
    room: Floats
    rest: float
    region: str = ''

    @property
    def distance(self) -> float:
        """Distance [m] from the tip to its target."""
        return float(np.linalg.norm(self.off))

    @property
    def resolution(self) -> float:
        """Distance [m] that the tracker resolves."""
        return max(2.0 * self.rest, TRACKER_NOISE_M)

    @property
    def reached(self) -> bool:
        """Whether the tip is at its target, within the resolution of the tracker."""
        return self.distance <= self.resolution

    def why(self, inputs: Sequence[str]) -> str:
        """
        Return the cause of the error in words, for named inputs; '' where none is known.

        A cause accounts for half of the squared distance, so that only one is named.
        """
        if self.region:
            return f'kept out of {self.region}'
        axes, sizes, _ = np.linalg.svd(self.slopes)
        sizes = np.pad(sizes, (0, len(axes) - len(sizes)))  # of fewer than three tendons
        parts, weak = axes.T @ self.off, sizes < WEAK_SLOPE * sizes[0]
        if parts[weak] @ parts[weak] > 0.5 * self.distance**2:
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
        if residual @ residual < 0.5 * self.distance**2:
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
        changed = abs(remainder.distance - self.nearest) > remainder.resolution
        if target is not self.target or changed:
            self.nearest, self.since = remainder.distance, now
        self.target, self.remainder = target, remainder

    def settled(self, now: float) -> Remainder | None:
        """Return the remainder once it does not change any more."""
        return self.remainder if now - self.since >= SILENCE_S else None


def foreign(offset: float, length: float, remembers: bool, known: float = 0.0) -> str:
    """
    Return advice about a model whose bias is too large for a calibrated one; '' for a small bias.

    Parameters
    ----------
    offset, length : float
        Bias of the tip, and length of the arm [m].
    remembers : bool
        Whether the model has friction memory.
    known : float
        Error of the tip that the description knows, rms [m].

    """
    if offset < max(MODEL_ERROR_MAX * length, KNOWN_FACTOR * known):
        return ''
    lacks = '' if remembers else ', often friction_memory'
    return (
        f'the model is {1e3 * offset:.0f} mm off the arm here: a load, or an effect that it '
        f'lacks{lacks}; diagnose tells which'
    )


@dataclass
class TipLoop(TipCorrection):
    """
    Moves the goal of the tensions until the measured tip is at the target.

    Frozen while the tracker is silent for 0.1 s, and for 0.2 s after a jump of more than 20 mm.
    After a second of silence the next target ignores the estimate. The loop is abandoned for the
    present target where the bias is larger than on any arm of this kind: the tensions are then
    those of the model.
    """

    abandoned: str = ''  # reason for the present target
    progress: TipProgress = field(default_factory=TipProgress)
    # [s], (m,) [N] acting tensions, (3,) [m] model's tip
    _history: deque[tuple[float, Floats, Floats]] = field(default_factory=deque)
    _compared: Floats | None = None  # (3,) [m] model's tip of the last comparison
    _jumped: float = -np.inf  # [s]
    _error: Floats = field(default_factory=lambda: np.full(3, np.nan))  # [m]
    _target: object = None  # of the loop
    _near: float = -np.inf  # [s] when the bias was last within its limit
    _due: float = 0.0  # [s] since the last update of the estimator

    def reset(self) -> None:
        """Forget the estimate and the goal."""
        self.tensions = self.estimate = self.motion = self.solution = self._compared = None
        self.progress, self._due, self._target = TipProgress(), 0.0, None
        self._history.clear()

    def paced(self, core: ControllerState, goal: Floats, longest: float, passed: float) -> float:
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
        assert core.command is not None
        if is_near(core.command, goal, core.limits, 0.1 * RANGE_TOLERANCE):
            return longest  # arrived
        remaining = float(np.abs(goal - core.command).max())
        return min(longest, remaining * (1.0 - float(np.exp(-PACE * gain * passed))))

    def take(self, now: float, core: ControllerState, position: Floats) -> None:
        """Take a measured tip (3,) [m] in the base frame."""
        last, before = core.track.last, self.tip
        self.tip = tip = TrackedTip(now, position, None if last is None else last.tip_position)
        self.frozen = self._unused(core, before, tip)
        if before is not None:
            self._due = min(self._due + now - before.time, TRACKER_SILENT_S)
        if not self.frozen and not core.solver.busy('loop') and not core.settings.pull_mode:
            self._compare(now, core, position)

    def values(self, now: float) -> dict[str, str]:
        """Return correction and measured error for the status."""
        bias = 0.0 if self.estimate is None else float(np.linalg.norm(self.estimate.bias))
        return {
            'correction (m)': f'{bias:.4g}',
            'correction_frozen': self.why_frozen(now),
            'measured_error (m)': f'{np.linalg.norm(self._error):.4g}',
        }

    def remainder(self, now: float, target: object) -> Remainder | None:
        """Return the remaining error at a target once it does not change any more."""
        measured = self.progress.target is target and not self.why_frozen(now)
        return self.progress.settled(now) if measured else None

    def why_frozen(self, now: float) -> str:
        """Return why the loop does not run, '' while it runs."""
        return 'tracker silent' if self._silent(now) else self.frozen

    def left(self, target: object) -> str:
        """Return why the loop was left for a target, '' while it runs."""
        return self.abandoned if target is self._target else ''

    def _silent(self, now: float) -> bool:
        return self.tip is None or now - self.tip.time > TRACKER_SILENT_S

    def _unused(self, core: ControllerState, before: TrackedTip | None, tip: TrackedTip) -> str:
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
        stopped = core.latch or core.driver.stopped
        if core.command is None or stopped or not core.fresh(tip.time):
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

    def _compare(self, now: float, core: ControllerState, position: Floats) -> None:
        """Post the comparison of the measured tip with the model's, and the next goal."""
        solution, desired, target = core.solution, core.mode.position, core.target
        assert solution is not None and desired is not None and core.command is not None
        acting, model = core.acting_tensions(), core.model
        offset = core.driver.acting.offset
        limits, keep_out = core.limits, core.settings.keep_out
        goal, last, known = core.goal(solution.tensions), core.track.last, self.estimate
        motion = self.motion if core.in_null_space else None
        passed, self._due = self._due, 0.0
        rate = core.settings.tip_gain if motion is None else HOLD_GAIN
        gain = 1.0 - float(np.exp(-rate * passed))
        sample_time = now - core.settings.tracker_delay  # [s] of the tracker's exposure
        then, before = self._then(sample_time), self._compared
        oldest = self._history[0][0] if self._history else np.inf
        known_then = sample_time == now or sample_time >= oldest
        near = is_near(core.command, goal, limits, RANGE_TOLERANCE)
        arrived = near and not core.streaming

        def work(give_up: GiveUp) -> Compared:
            shape = model.follow(last, acting)
            step = TipStep(model, shape, desired, offset, limits, arrived)
            at, tip = (acting, shape.tip_position) if then is None else then
            path = 0.0 if before is None else float(np.linalg.norm(tip - before))
            if motion is None:
                doubt = MODEL_SLOPE_SD * np.linalg.norm(step.slopes, axis=0)
            else:
                doubt = np.full(len(at), MODEL_SLOPE_SD * model.robot.length)
            new = (known or TipEstimate.begin(at, limits, doubt)).about(at)
            if motion is not None and motion.place is None:
                new = new.without_slopes(doubt)  # slopes of motions of the tip do not apply
            if known_then:
                new = new.updated(position - tip, gain, doubt, path, model.robot.length)
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
            return new, next_goal, shape.tip_position, tip, moved, remainder

        def done(result: Compared | None, error: Failure) -> None:
            if result is None or core.model is not model or core.target is None or self.abandoned:
                return
            self.estimate, next_goal, tip, self._compared, moved, remainder = result
            self._history.append((now, acting, tip))
            while len(self._history) > 1 and self._history[1][0] <= sample_time:
                self._history.popleft()
            if core.solution is solution:
                self.tensions, self.solution = next_goal, solution
                self.progress.take(now, target, remainder)
                if self.motion is motion:
                    self.motion = moved

        core.solver.post('loop', work, done)

    def _then(self, time: float) -> tuple[Floats, Floats] | None:
        """Return tensions (m,) [N] and the model's tip (3,) [m] at a past time [s]; None: now."""
        if not self._history or time >= self._history[-1][0]:
            return None
        times, tensions, tips = zip(*self._history, strict=True)
        return interpolated(time, times, tensions), interpolated(time, times, tips)


# of the measured tip with the model's: the estimate, the next goal (m,) [N], the model's tip (3,)
# [m] now and at the exposure, the null-space motion after it, and what is left
Compared = tuple[TipEstimate, Floats, Floats, Floats, NullSpaceMotion | None, Remainder]
