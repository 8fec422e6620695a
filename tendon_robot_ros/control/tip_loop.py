"""
The closed loop: tensions at which the measured tip is where it should be.

What the estimator learns (tip_estimator.py), it learns at the tensions that act, on the way to a
target as well as at it. A step of bounded least squares on the corrected Jacobian then moves the
goal to where the tip is the target. The estimator looks at what the arm does, not at what it was
told, so neither lag nor a limit winds anything up. The command goes to a set point ever slower, so
that the tracker sees on the way how far the model is off, and the tip does not go beyond.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..common.errors import TendonRobotError
from .null_space import HOLD_GAIN, SLOPE_SD, STANDS_SHARE, NullSpaceMotion
from .remainder import LeftOver, Remainder
from .tip_estimator import MODEL_SLOPE_SD, TipEstimate, bias_share
from .tip_step import TipStep

if TYPE_CHECKING:
    from .solver import GiveUp
    from .state import Controller

Array = NDArray[np.float64]
TRACKER_SILENT_S = 0.1  # [s] three measurements of a tracker at 30 Hz
TRACKER_LOST_S = 1.0  # [s] of silence after which the arm may be anywhere: the bias counts no more
TRACKER_JUMP_M = 0.02  # [m] between two measurements, beyond the model's path, that no arm does
JUMP_SETTLED_S = 0.2  # [s] without a jump after one, before the tracker is believed again
BIAS_MAX_SHARE = 0.4  # [1] of the arm's length: further off, tracker or model is of another arm
LEAVES_S = 0.3  # [s] for which it is: an arm that snaps on its way is there for a moment
PACE = 2.0  # [1] of `tip_gain`: how fast the distance to a set point shrinks
HISTORY_MAX = 64  # measurements that are kept for a tracker that is late: 0.5 s at 120 Hz


@dataclass
class TipLoop:
    """
    Moves the goal of the tensions until the measured tip is at the target.

    Frozen while the tracker is silent for 0.1 s, when it jumps by more than 20 mm and for 0.2 s
    after. After a second of silence the next target does without what was learned. The loop is
    left, for this target, where the tip is further from the model than any arm of its kind:
    tensions then are those of the model.
    """

    tensions: Array | None = None  # (m,) [N] the goal, None: that of the model
    frozen: str = 'no tracker'  # why, '' while it works
    left: str = ''  # why it was left for this target
    estimate: TipEstimate | None = None
    motion: NullSpaceMotion | None = None  # that has the arm
    left_over: LeftOver = field(default_factory=LeftOver)
    _seen: tuple[float, Array, Array | None] | None = None  # [s], the tip, that of the model [m]
    _history: deque[tuple[float, Array, Array]] = field(  # [s], acting tensions, model's tip
        default_factory=lambda: deque(maxlen=HISTORY_MAX)
    )
    _compared: Array | None = None  # (3,) [m] the model's tip with which the last one was
    _jumped: float = -np.inf  # [s]
    _error: Array = field(default_factory=lambda: np.full(3, np.nan))  # [m]
    _solution: object = None  # for which `tensions` are
    _target: object = None  # for which the loop runs
    _near: float = -np.inf  # [s] when the bias was last as it may be
    _due: float = 0.0  # [s] since the estimator was updated

    def reset(self) -> None:
        """Forget what was learned."""
        self.tensions = self.estimate = self.motion = self._solution = self._compared = None
        self.left_over, self._due = LeftOver(), 0.0
        self._history.clear()

    def in_null_space(self, core: Controller) -> bool:
        """Whether a null-space motion has the arm."""
        motion = self.motion
        return motion is not None and motion.solution is core.solution and not self.frozen

    def goal(self, core: Controller, solution: Array) -> Array:
        """Return the goal (m,) [N], within the limits."""
        if self.tensions is None or core.settings.tip_gain == 0.0:
            return solution
        if self._solution is not core.solution:
            return solution  # of another target, which was found with the correction in it
        low, high = core.settings.limits(core.model).T
        return np.clip(self.tensions, low, high)

    def paced(self, core: Controller, goal: Array, longest: float, passed: float) -> float:
        """
        Return how far [N] the command goes at once; a set point is neared ever slower.

        Parameters
        ----------
        goal : (m,) [N]
        longest : float
            By the rate limit [N].
        passed : float
            Since the last step [s].

        """
        gain = core.settings.tip_gain
        if gain == 0.0 or self._silent(core.time) or self.left or core.streaming:
            return longest
        assert core.command is not None
        low, high = core.settings.limits(core.model).T
        left = np.abs(goal - core.command)
        if np.all(left < 0.1 * STANDS_SHARE * (high - low)):
            return longest  # arrived
        return min(longest, float(left.max()) * (1.0 - float(np.exp(-PACE * gain * passed))))

    def bias(self, now: float, place: Array, length: float) -> Array:
        """
        Return by how much (3,) [m] the tip is off the model near a place (3,) [m].

        Less far from where the arm is, and 0 once the tracker is lost.
        """
        if self._seen is None or now - self._seen[0] > TRACKER_LOST_S or self.estimate is None:
            return np.zeros(3)
        distance = float(np.linalg.norm(place - self._seen[1]))
        return self.estimate.bias * bias_share(distance, length)

    def take(self, now: float, core: Controller, position: Array) -> None:
        """Take a measured tip (3,) [m] in the base frame."""
        last = core.track.last
        before, self._seen = (
            self._seen,
            (now, position, None if last is None else last.tip_position),
        )
        self.frozen = self._why_frozen(now, core, before)
        if before is not None:
            self._due = min(self._due + now - before[0], TRACKER_SILENT_S)
        if not self.frozen:
            self._look(now, core, position)

    def values(self, now: float) -> dict[str, str]:
        """Say how much of the correction is left to the loop, for the status."""
        frozen = 'tracker silent' if self._silent(now) else self.frozen
        bias = 0.0 if self.estimate is None else float(np.linalg.norm(self.estimate.bias))
        return {
            'correction (m)': f'{bias:.4g}',
            'correction_frozen': frozen,
            'measured_error (m)': f'{np.linalg.norm(self._error):.4g}',
        }

    def remainder(self, now: float) -> Remainder | None:
        """Return what is left of the distance to the target once that does not change."""
        return None if self._silent(now) or self.frozen else self.left_over.settled(now)

    def _silent(self, now: float) -> bool:
        return self._seen is None or now - self._seen[0] > TRACKER_SILENT_S

    def _why_frozen(
        self, now: float, core: Controller, before: tuple[float, Array, Array | None] | None
    ) -> str:
        """Say why a measurement that has come is not used, '' where it is."""
        assert self._seen is not None
        _, position, modelled = self._seen
        if before is None or now - before[0] > TRACKER_SILENT_S:
            return 'tracker silent'
        path = 0.0
        if modelled is not None and before[2] is not None:
            path = float(np.linalg.norm(modelled - before[2]))
        if np.linalg.norm(position - before[1]) > TRACKER_JUMP_M + path:
            self._jumped = now
        if now - self._jumped < JUMP_SETTLED_S:
            return 'tracker jumped'
        target = core.target
        if target is None or target.position is None or core.solution is None:
            return 'no target'
        self._error = target.position - position
        if core.command is None or core.latch or core.driver_stopped or not core.fresh(now):
            return 'stopped'
        if target is not self._target:
            self._target, self._near, self.left = target, core.time, ''
        if self.estimate is not None and not self.left:
            off = float(np.linalg.norm(self.estimate.bias))
            if off <= BIAS_MAX_SHARE * core.model.robot.length:
                self._near = core.time
            elif core.time - self._near > LEAVES_S:
                self.left, self.tensions, self.estimate = 'too far from the model', None, None
        return self.left

    def _look(self, now: float, core: Controller, position: Array) -> None:
        """Have the solver compare the tip with the model's, and find where the goal is then."""
        solution, wanted, model, target = core.solution, core.wanted, core.model, core.target
        if core.solver.busy('loop') or core.settings.pull_mode:
            return
        assert solution is not None and wanted is not None
        acting, offset, length = core.acting_tensions(), core.acting_offset, model.robot.length
        limits, keep_out = core.settings.limits(model), core.settings.keep_out
        goal, last, known = self.goal(core, solution.tensions), core.track.last, self.estimate
        motion = self.motion if self.in_null_space(core) else None
        gain = core.settings.tip_gain if motion is None else HOLD_GAIN
        passed, self._due = self._due, 0.0
        share = 1.0 - float(np.exp(-gain * passed))
        seen = now - core.settings.tracker_delay  # [s] when the tracker saw this
        then, known_then = self._then(seen), seen == now or self._knows(seen)
        before, stands = self._compared, self._stands(core, goal)

        def work(give_up: GiveUp) -> _Found:
            here = model.follow(last, acting)
            step = TipStep.at(model, here, wanted, offset, limits, stands)
            at, tip = (acting, here.tip_position) if then is None else then
            path = 0.0 if before is None else float(np.linalg.norm(tip - before))
            if motion is None:
                doubt = MODEL_SLOPE_SD * np.linalg.norm(step.slopes, axis=0)
            else:
                doubt = np.full(len(at), SLOPE_SD * length)
            new = (known or TipEstimate.begin(at, limits, doubt)).about(at)
            if motion is not None and motion.place is None:
                new = new.without_slopes(doubt)  # those of motions of the tip
            fading = passed if motion is None else 0.0
            if known_then:
                new = new.updated(position - tip, share, doubt, fading, path, length)
            new = new.about(acting).within(step.slopes)
            if motion is None:
                moved, found = None, step.next_goal(new, goal)
            else:
                moved, found = motion.step(step, goal, new, passed)
            found, region = step.allowed(found, goal, keep_out)
            left = Remainder.at(wanted - here.tip_position, step.slopes, goal, limits, new, region)
            return _Found(new, found, here.tip_position, tip, moved, left)

        def done(found: _Found | None, error: TendonRobotError | None) -> None:
            if found is None or core.model is not model or core.target is None:
                return
            self.estimate, self._compared = found.estimate, found.compared
            self._history.append((now, acting, found.tip))
            if core.solution is solution:
                self.tensions, self._solution = found.goal, solution
                self.left_over.take(now, target, found.remainder)
                if self.motion is motion:
                    self.motion = found.motion

        core.solver.post('loop', work, done)

    def _stands(self, core: Controller, goal: Array) -> bool:
        """Whether the command is as good as at its goal."""
        assert core.command is not None
        low, high = core.settings.limits(core.model).T
        near = np.all(np.abs(goal - core.command) < STANDS_SHARE * (high - low))
        return bool(near) and not core.streaming

    def _knows(self, time: float) -> bool:
        """Whether it is known where the model had the tip at a time."""
        return bool(self._history) and time >= self._history[0][0]

    def _then(self, time: float) -> tuple[Array, Array] | None:
        """Return tensions (m,) [N] and the model's tip (3,) [m] at a time; None: now."""
        history = self._history
        if not history or time >= history[-1][0]:
            return None
        times = [one[0] for one in history]
        place = max(int(np.searchsorted(times, time, side='right')) - 1, 0)
        (begin, *first), (end, *second) = history[place], history[min(place + 1, len(times) - 1)]
        share = min(max((time - begin) / (end - begin), 0.0), 1.0) if end > begin else 0.0
        tensions, tip = (a + share * (b - a) for a, b in zip(first, second, strict=True))
        return tensions, tip


@dataclass(frozen=True)
class _Found:
    """What one look at the tip gives."""

    estimate: TipEstimate
    goal: Array  # (m,) [N]
    tip: Array  # (3,) [m] the model's, now
    compared: Array  # (3,) [m] and when the tracker saw it
    motion: NullSpaceMotion | None
    remainder: Remainder
