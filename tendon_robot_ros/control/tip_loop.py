"""
The closed loop: tensions at which the measured tip is where it should be.

What the estimator learns (tip_estimator.py), it learns at the tensions that act, on the way to a
target as well as at it. A step of bounded least squares on the corrected Jacobian then moves the
goal to where the tip is the target. The estimator looks at what the arm does, not at what was
commanded, so neither lag nor a limit winds anything up. The command goes to a set point ever
slower, so that the tracker sees on the way how far the model is off, and the tip does not go
beyond.
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
from .driver_side import GONE_S
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
# [m] between two measurements, beyond the model's path; no arm does it, so that the tracker is
# wrong (docs/control.md)
TRACKER_JUMP_M = 0.02
# [1] of the arm's length; a bias beyond it would be that of another arm or frame (docs/control.md)
BIAS_LENGTH_MAX = 0.4
# [1] of `tip_gain`: how fast the distance to a set point shrinks, so that the bias is known before
# the tip is there (docs/control.md)
PACE = 2.0
# [1] measurements that are kept for a tracker that is late: 0.5 s at 120 Hz; a later one would be
# a tracker that is silent
HISTORY_MAX = 64
# [s] for which the tip has come no nearer, so that it is told; five times the loop's 0.2 s
NO_NEARER_S = 1.0
# [1] of the distance that was left; it has changed by more, because noise changes it by less
CHANGED = 0.2
# [1] of the distance that is left: half of its square then has one cause, so that no two are named
CAUSE = 0.5**0.5
# [1] of the arm's length: a calibrated model is nearer to its arm (docs/control.md)
FOREIGN_LENGTH = 0.05


class _TrackedTip(NamedTuple):
    """A measurement of the tip."""

    time: float  # [s]
    position: Array  # (3,) [m]
    modelled: Array | None  # (3,) [m] where the model had the tip then


@dataclass(frozen=True)
class Remainder:
    """
    What the closed loop leaves between the measured tip and its target.

    Attributes
    ----------
    off : (3,) [m]
        From the tip to its target, the tracker's noise filtered.
    slopes : (3, m) [m]
        Motion of the tip by the tensions, over their ranges.
    room : (2, m) [1]
        Of the ranges, that tensions may still fall and rise.
    rest : float
        Where the loop rests [m]; see `TipEstimate.rest`.
    region : str
        That the arm would enter if it went on, '' if there is none.

    """

    off: Array
    slopes: Array
    room: Array
    rest: float
    region: str = ''

    @property
    def away(self) -> float:
        """How far [m] the tip is from its target."""
        return float(np.linalg.norm(self.off))

    @property
    def none(self) -> bool:
        """Whether the tip is as near as the tracker tells."""
        return self.away <= max(2.0 * self.rest, TRACKER_NOISE_M)

    def why(self, inputs: Sequence[str]) -> str:
        """Say what keeps the tip away, of tendons with names; '' where nothing is known to."""
        if self.region:
            return f'kept out of {self.region}'
        axes, sizes, _ = np.linalg.svd(self.slopes, full_matrices=False)
        parts, weak = axes.T @ self.off, sizes < WEAK_SLOPE * sizes[0]
        if np.linalg.norm(parts[weak]) > CAUSE * self.away:
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
        left = far - strong @ step
        if np.linalg.norm(left) < CAUSE * self.away:
            return ''
        more = strong.T @ left > 0.0  # of that tension the tip would come nearer
        at = np.where(more, stopped[1], stopped[0])
        names = (name for name, ended in zip(inputs, at, strict=True) if ended)
        return f'at its limit: {", ".join(names)}'


@dataclass
class TipProgress:
    """How near the tip came to one target, and for how long it has come no nearer."""

    target: object = None
    remainder: Remainder | None = None
    nearest: float = np.inf  # [m]
    since: float = np.inf  # [s]

    def take(self, now: float, target: object, remainder: Remainder) -> None:
        """Take what is left now; a new target begins anew."""
        away, before = remainder.away, self.nearest
        changed = abs(away - before) > max(CHANGED * before, TRACKER_NOISE_M)
        if target is not self.target or changed:
            self.nearest, self.since = away, now
        self.target, self.remainder = target, remainder

    def settled(self, now: float) -> Remainder | None:
        """Return what is left once that does not change."""
        return self.remainder if now - self.since >= NO_NEARER_S else None


def foreign(offset: float, length: float, remembers: bool) -> str:
    """
    Say what to do about a model that is off [m] its arm of a length [m]; '' where it is near.

    Parameters
    ----------
    offset, length : float
    remembers : bool
        Whether friction remembers in the model.

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
    progress: TipProgress = field(default_factory=TipProgress)
    _seen: _TrackedTip | None = None
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
        self.progress, self._due = TipProgress(), 0.0
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
        if _at_goal(core, goal, 0.1 * RANGE_TOLERANCE):
            return longest  # arrived
        assert core.command is not None
        left = float(np.abs(goal - core.command).max())
        return min(longest, left * (1.0 - float(np.exp(-PACE * gain * passed))))

    def bias(self, now: float, place: Array, length: float) -> Array:
        """
        Return by how much (3,) [m] the tip is off the model near a place (3,) [m].

        Less far from where the arm is, and 0 once the tracker is lost.
        """
        if self._seen is None or now - self._seen.time > GONE_S or self.estimate is None:
            return np.zeros(3)
        distance = float(np.linalg.norm(place - self._seen.position))
        return self.estimate.bias * bias_part(distance, length)

    def take(self, now: float, core: Controller, position: Array) -> None:
        """Take a measured tip (3,) [m] in the base frame."""
        last, before = core.track.last, self._seen
        self._seen = seen = _TrackedTip(now, position, None if last is None else last.tip_position)
        self.frozen = self._why_frozen(core, before, seen)
        if before is not None:
            self._due = min(self._due + now - before.time, TRACKER_SILENT_S)
        if not self.frozen and not core.solver.busy('loop') and not core.settings.pull_mode:
            self._compare(now, core, position)

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
        return None if self._silent(now) or self.frozen else self.progress.settled(now)

    def _silent(self, now: float) -> bool:
        return self._seen is None or now - self._seen.time > TRACKER_SILENT_S

    def _why_frozen(self, core: Controller, before: _TrackedTip | None, seen: _TrackedTip) -> str:
        """Say why a measurement that has come is not used, '' where it is."""
        if before is None or seen.time - before.time > TRACKER_SILENT_S:
            return 'tracker silent'
        path = 0.0
        if seen.modelled is not None and before.modelled is not None:
            path = float(np.linalg.norm(seen.modelled - before.modelled))
        if np.linalg.norm(seen.position - before.position) > TRACKER_JUMP_M + path:
            self._jumped = seen.time
        if seen.time - self._jumped < 2.0 * TRACKER_SILENT_S:
            return 'tracker jumped'
        target = core.target
        if target is None or target.position is None or core.solution is None:
            return 'no target'
        self._error = target.position - seen.position
        if core.command is None or not core.follows(seen.time):
            return 'stopped'
        if target is not self._target:
            self._target, self._near, self.left = target, core.time, ''
        if self.estimate is not None and not self.left:
            off = float(np.linalg.norm(self.estimate.bias))
            if off <= BIAS_LENGTH_MAX * core.model.robot.length:
                self._near = core.time
            elif core.time - self._near > 3.0 * TRACKER_SILENT_S:  # no arm that snaps on its way
                self.left, self.tensions, self.estimate = 'too far from the model', None, None
        return self.left

    def _compare(self, now: float, core: Controller, position: Array) -> None:
        """Have the solver compare the tip with the model's, and find where the goal is then."""
        solution, wanted, model, target = core.solution, core.wanted, core.model, core.target
        assert solution is not None and wanted is not None
        acting, offset, length = core.acting_tensions(), core.acting_offset, model.robot.length
        limits, keep_out = core.settings.limits(model), core.settings.keep_out
        goal, last, known = self.goal(core, solution.tensions), core.track.last, self.estimate
        motion = self.motion if self.in_null_space(core) else None
        passed, self._due = self._due, 0.0
        rate = core.settings.tip_gain if motion is None else HOLD_GAIN
        gain = 1.0 - float(np.exp(-rate * passed))
        seen = now - core.settings.tracker_delay  # [s] when the tracker saw this
        then, before = self._then(seen), self._compared
        known_then = seen == now or (bool(self._history) and seen >= self._history[0][0])
        stands = _at_goal(core, goal, RANGE_TOLERANCE) and not core.streaming

        def work(give_up: GiveUp) -> _Compared:
            here = model.follow(last, acting)
            step = TipStep.at(model, here, wanted, offset, limits, stands)
            at, tip = (acting, here.tip_position) if then is None else then
            path = 0.0 if before is None else float(np.linalg.norm(tip - before))
            if motion is None:
                doubt = MODEL_SLOPE_SD * np.linalg.norm(step.slopes, axis=0)
            else:
                doubt = np.full(len(at), SLOPE_LENGTH_SD * length)
            new = (known or TipEstimate.begin(at, limits, doubt)).about(at)
            if motion is not None and motion.place is None:
                new = new.without_slopes(doubt)  # those of motions of the tip
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
            left = Remainder(
                wanted - here.tip_position - new.bias,
                step.slopes,
                np.array([goal - low, high - goal]) / (high - low),
                new.rest,
                region,
            )
            return _Compared(new, next_goal, here.tip_position, tip, moved, left)

        def done(made: _Compared | None, error: TendonRobotError | None) -> None:
            if made is None or core.model is not model or core.target is None:
                return
            self.estimate, self._compared = made.estimate, made.compared
            self._history.append((now, acting, made.tip))
            if core.solution is solution:
                self.tensions, self._solution = made.goal, solution
                self.progress.take(now, target, made.remainder)
                if self.motion is motion:
                    self.motion = made.motion

        core.solver.post('loop', work, done)

    def _then(self, time: float) -> tuple[Array, Array] | None:
        """Return tensions (m,) [N] and the model's tip (3,) [m] at a time; None: now."""
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
    """What one comparison of the tip with the model's gives."""

    estimate: TipEstimate
    goal: Array  # (m,) [N]
    tip: Array  # (3,) [m] the model's, now
    compared: Array  # (3,) [m] and when the tracker saw it
    motion: NullSpaceMotion | None
    remainder: Remainder


def _at_goal(core: Controller, goal: Array, tolerance: float) -> bool:
    """Whether the command is as good as at its goal (m,) [N], by a tolerance [1] of the ranges."""
    assert core.command is not None
    low, high = core.settings.limits(core.model).T
    return bool(np.all(np.abs(goal - core.command) < tolerance * (high - low)))
