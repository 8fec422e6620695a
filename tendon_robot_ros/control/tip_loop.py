"""
Tensions that take off what the measured tip shows of the model's error (see mismatch.py).

What the filter learns, it learns at the tensions that act, on the way to a target as well as at
it. A step of bounded least squares on the corrected Jacobian then moves the goal to where the tip
is the target. The filter looks at what the arm does, not at what it was told, so neither lag nor
a limit winds anything up. The command goes to a set point ever slower, so that the tracker sees
on the way how far the model is off, and the tip does not go beyond.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..common.errors import TendonRobotError
from ..model.derivatives import tip_slopes
from ..model.program import STEP_DAMPING, bounded_step
from .mismatch import STEP_SHARE, Mismatch, here_counts, slope_doubt
from .remainder import LED_SHARE, LeftOver, Remainder
from .walk import Led, Walk, begun

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Reach, Shape
    from ..robot.keep_out import KeepOut
    from .solver import GiveUp
    from .state import Controller

Array = NDArray[np.float64]
TRACKER_SILENT_S = 0.1  # [s] of the tracker
TRACKER_LOST_S = 1.0  # [s] of silence after which the next target is gone to without correction
TRACKER_JUMP_M = 0.02  # [m] between two measurements, beyond the model's way, that no arm does
JUMP_SETTLED_S = 0.2  # [s] without a jump after one, before the tracker is believed again
WORSE_FACTOR, WORSE_SHARE = 2.0, 0.1  # [1] of the error at first, and of the arm's length
OFFSET_MAX_SHARE = 0.4  # [1] of the arm's length: further off, the model is not of this arm
ASTRAY_S = 0.3  # [s] for which it is: an arm that snaps on its way is there for a moment
HALVES = 1.0, 0.5, 0.25, 0.125  # [1] of a step that would bring the tip no nearer
SLIPPING = 1.0, 2.0, 4.0, 0.5, 0.25  # [1] of one that may let no tendon slip
GAINED = 0.1  # [1] of what a step promises, that it must do
ONE_SIDED_SHARES = 5e-4, 5e-3, 0.02, 0.06  # [1] of a tension's range, for slopes in one direction
PACE = 2.0  # [1] of `tip_gain`: how fast the way to a set point shrinks
STANDS_SHARE = 2e-3  # [1] of a tension's range: nearer to its goal, the arm counts as standing
ARRIVED_SHARE = 2e-4  # [1] of a tension's range: nearer, the command is at its goal
PASSED_MAX = 64  # measurements that are kept for a tracker that is late


@dataclass
class TipLoop:
    """
    Moves the goal of the tensions until the measured tip is at the target.

    Frozen while the tracker is silent for 0.1 s, when it jumps by more than 20 mm and for 0.2 s
    after. After a second of silence the next target does without what was learned. The loop is
    left, for this target, where the tip gets no nearer or is further from the model than any arm
    of its kind: tensions then are those of the model.
    """

    tensions: Array | None = None  # (m,) [N] the goal, None: that of the model
    frozen: str = 'no tracker'  # why, '' while it works
    known: Mismatch | None = None
    _seen: tuple[float, Array, Array | None] | None = None  # [s], the tip, that of the model [m]
    _passed: deque[tuple[float, Array, Array]] = field(  # [s], tensions that acted, model's tip
        default_factory=lambda: deque(maxlen=PASSED_MAX)
    )
    _jumped: float = -np.inf  # [s]
    _error: Array = field(default_factory=lambda: np.full(3, np.nan))  # [m]
    _solution: object = None  # for which `tensions` are
    _due: float = 0.0  # [s] since the filter last learned
    _asked: object = None  # the target for which the loop runs
    _began: float = np.inf  # [m] error at its beginning
    _tame: float = -np.inf  # [s] when the error and the offset were last as they may be
    left: str = ''  # why it was left for this target
    _compared: Array | None = None  # (3,) [m] the model's tip with which the last one was
    _led: Led | None = None  # where to
    _walk: Walk | None = None  # there
    left_over: LeftOver = field(default_factory=LeftOver)

    def reset(self) -> None:
        """Forget what was learned."""
        self.tensions, self.known, self._solution, self._due = None, None, None, 0.0
        self._led = self._walk = self._compared = None
        self.left_over = LeftOver()
        self._passed.clear()

    def lead(self, led: Led | None) -> None:
        """Walk to other tensions as far as the tip of a solution stays; None: no walk."""
        self._led = led

    def walking(self, core: Controller) -> bool:
        """Tell whether a walk for the solution that is has the arm."""
        return bool(self._led and self._led.solution is core.solution and not self.frozen)

    def goal(self, core: Controller, solution: Array) -> Array:
        """Return the goal (m,) [N], within the limits."""
        if self.tensions is None or core.settings.tip_gain == 0.0:
            return solution
        if self._solution is not core.solution:
            return solution  # of another target, which was found with the correction in it
        low, high = core.settings.limits(core.model).T
        return np.clip(self.tensions, low, high)

    def step(self, core: Controller, goal: Array, longest: float, passed: float) -> float:
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
        seen = self._seen is not None and core.stepped - self._seen[0] <= TRACKER_SILENT_S
        if gain == 0.0 or not seen or self.left or core.streaming or core.command is None:
            return longest
        low, high = core.settings.limits(core.model).T
        way = np.abs(goal - core.command)
        if np.all(way < ARRIVED_SHARE * (high - low)):
            return longest
        return min(longest, float(way.max()) * (1.0 - float(np.exp(-PACE * gain * passed))))

    def shift(self, now: float, place: Array, length: float) -> Array:
        """
        Return by how much (3,) [m] the tip is off the model near a place (3,) [m].

        Less far from where the arm is, and 0 once the tracker is lost.
        """
        if self._seen is None or now - self._seen[0] > TRACKER_LOST_S or self.known is None:
            return np.zeros(3)
        way = float(np.linalg.norm(place - self._seen[1]))
        return np.asarray(self.known.offset * here_counts(way, length))

    def take(self, now: float, core: Controller, position: Array) -> None:
        """Take a measured tip (3,) [m] in the base frame."""
        last = core.track.last
        modelled = None if last is None else last.tip_position
        before, self._seen = self._seen, (now, position, modelled)
        self.frozen = self._why_not(now, core, position, before)
        if before is not None:
            self._due = min(self._due + now - before[0], TRACKER_SILENT_S)
        if not self.frozen:
            self._look(now, core, position)

    def values(self, now: float) -> dict[str, str]:
        """Say how much of the correction is left to the loop, for the status."""
        silent = self._seen is None or now - self._seen[0] > TRACKER_SILENT_S
        frozen = 'tracker silent' if silent else self.frozen
        shift = 0.0 if self.known is None else float(np.linalg.norm(self.known.offset))
        return {
            'correction (m)': f'{shift:.4g}',
            'correction_frozen': frozen,
            'measured_error (m)': f'{np.linalg.norm(self._error):.4g}',
        }

    def remainder(self, now: float) -> Remainder | None:
        """Return what is left of the way to the target where the tip comes no nearer."""
        silent = self._seen is None or now - self._seen[0] > TRACKER_SILENT_S
        return None if silent or self.frozen else self.left_over.settled(now)

    def _why_not(
        self,
        now: float,
        core: Controller,
        position: Array,
        before: tuple[float, Array, Array | None] | None,
    ) -> str:
        if before is None or now - before[0] > TRACKER_SILENT_S:
            return 'tracker silent'
        modelled = self._seen[2] if self._seen is not None else None
        known = modelled is not None and before[2] is not None
        way = float(np.linalg.norm(modelled - before[2])) if known else 0.0  # type: ignore[operator]
        if np.linalg.norm(position - before[1]) > TRACKER_JUMP_M + way:
            self._jumped = now
        if now - self._jumped < JUMP_SETTLED_S:
            return 'tracker jumped'
        if core.target is None or core.target.position is None or core.solution is None:
            return 'no target'
        self._error = core.target.position - position
        if core.command is None or core.latch or core.driver_stopped or not core.fresh(now):
            return 'stopped'
        return self._astray(core, float(np.linalg.norm(self._error)))

    def _astray(self, core: Controller, error: float) -> str:
        """Say why the loop is left for this target, and have the model's tensions again."""
        length, target = core.model.robot.length, core.target
        if target is not self._asked:
            self._asked, self._began, self.left = target, error, ''
            self._tame = core.stepped
        if self.known is not None and not self.left:
            why = ''
            if float(np.linalg.norm(self.known.offset)) > OFFSET_MAX_SHARE * length:
                why = 'too far from the model'
            elif error > WORSE_FACTOR * self._began + WORSE_SHARE * length:
                why = 'it got no nearer'
            if not why or core.via:  # a way that bends over is meant to lead away
                self._tame = core.stepped
            elif core.stepped - self._tame > ASTRAY_S:
                self.left, self.tensions, self.known = why, None, None
        return self.left

    def _look(self, now: float, core: Controller, position: Array) -> None:
        """Have the solver compare the tip with the model's, and find where the goal is then."""
        solution, wanted, model, target = core.solution, core.wanted, core.model, core.target
        if core.solver.busy('loop') or core.settings.pull_mode:
            return
        assert solution is not None and wanted is not None
        applied, length, known = core.felt_tensions(), model.robot.length, self.known
        limits, gain, passed = core.settings.limits(model), core.settings.tip_gain, self._due
        bias = np.zeros_like(applied) if core.felt.bias is None else core.felt.bias
        goal, last, self._due = self.goal(core, solution.tensions), core.track.last, 0.0
        keep_out, led = core.settings.keep_out, self._led
        then = self._then(now - core.settings.tracker_delay)
        before, was, stands = self._compared, self._walk, self._stands(core, goal)

        def work(give_up: GiveUp) -> _Found:
            here = model.follow(last, applied)
            step = _Step.at(model, here, wanted, bias, limits, stands)
            doubt = slope_doubt(step.slopes, length)
            at, tip = (applied, here.tip_position) if then is None else then
            way = 0.0 if before is None else float(np.linalg.norm(tip - before))
            new = (known or Mismatch.unknown(at, limits, doubt)).moved(at)
            new = new.learned(position - tip, gain, passed, doubt, way, length).moved(applied)
            new = new.within(step.slopes)
            if led is None or led.solution is not solution:
                walk, found = None, step.next_goal(new, goal)
            else:
                walk = begun(was, led, goal, new, at, length)
                walk = walk.learned(at, position - tip, new, length, way, passed)
                walk, found = walk.step(step, goal, new, passed)
            found, region = step.allowed(found, goal, keep_out)
            left = Remainder.at(wanted - here.tip_position, step.slopes, goal, limits, new, region)
            return _Found(new, found, here.tip_position, tip, walk, left)

        def done(found: _Found | None, error: TendonRobotError | None) -> None:
            if found is not None and core.model is model and core.target is not None:
                self.known, self._compared = found.known, found.compared
                self._passed.append((now, applied, found.tip))
                if core.solution is solution:
                    self._take_up(found, solution, now, target)

        core.solver.post('loop', work, done)

    def _take_up(self, found: _Found, solution: Reach, now: float, target: object) -> None:
        """Go to the next goal for a solution; a walk that is left is one no more."""
        self.tensions, self._solution, self._walk = found.goal, solution, found.walk
        self.left_over.take(now, target, found.remainder)
        if found.walk is not None and found.walk.left:
            self._led = None

    def _stands(self, core: Controller, goal: Array) -> bool:
        """Whether the command is as good as at its goal."""
        if core.command is None or core.streaming:
            return False
        low, high = core.settings.limits(core.model).T
        return bool(np.all(np.abs(goal - core.command) < STANDS_SHARE * (high - low)))

    def _then(self, time: float) -> tuple[Array, Array] | None:
        """Return tensions (m,) [N] and the model's tip (3,) [m] at a time; None: now."""
        passed = self._passed
        if not passed or time >= passed[-1][0]:
            return None
        times = [one[0] for one in passed]
        place = max(int(np.searchsorted(times, time, side='right')) - 1, 0)
        (begin, *first), (end, *second) = passed[place], passed[min(place + 1, len(passed) - 1)]
        share = min(max((time - begin) / (end - begin), 0.0), 1.0) if end > begin else 0.0
        tensions, tip = (a + share * (b - a) for a, b in zip(first, second, strict=True))
        return tensions, tip


@dataclass(frozen=True)
class _Found:
    """What one look at the tip gives."""

    known: Mismatch
    goal: Array  # (m,) [N]
    tip: Array  # (3,) [m] the model's, now
    compared: Array  # (3,) [m] and when the tracker saw it
    walk: Walk | None
    remainder: Remainder


@dataclass(frozen=True)
class _Step:
    """One step of the goal: where the arm is and should be, as the model sees it."""

    model: Model
    here: Shape
    slopes: Array  # (3, m) [m] over the ranges
    wanted: Array  # (3,) [m]
    bias: Array  # (m,) [N] that acts beyond the command
    limits: Array  # (m, 2) [N]
    stands: bool = False  # the command is at its goal: time to follow what hardly moves the tip

    @classmethod
    def at(
        cls, model: Model, here: Shape, wanted: Array, bias: Array, limits: Array, stands: bool
    ) -> _Step:
        """Look at the slopes where the arm is."""
        width = limits[:, 1] - limits[:, 0]
        return cls(model, here, _slopes(model, here, here) * width, wanted, bias, limits, stands)

    def next_goal(self, known: Mismatch, goal: Array) -> Array:
        """Return the tensions (m,) [N] at which the tip is nearer to where it is wanted."""
        there = self.there(goal)
        miss, width = self._left(there, known), self.limits[:, 1] - self.limits[:, 0]
        if self.stands and np.linalg.norm(miss) < known.rest:
            return goal  # friction would let the arm slip by what is noise
        slopes = _slopes(self.model, there, self.here) * width
        way = self._way(there)
        damping = LED_SHARE if self.stands else STEP_DAMPING
        part = known.part(there.inputs, way) * here_counts(way, self.model.robot.length)
        best, least = goal, 1.0
        for step, shares in self._steps(there, goal, miss, damping, slopes, part * known.slopes):
            for share in shares:
                left = self._left(self.there(goal + share * step), known)
                nearer = float(np.linalg.norm(left) / max(float(np.linalg.norm(miss)), 1e-12))
                if nearer < least:
                    best, least = goal + share * step, nearer
                if nearer < 1.0 - share * STEP_SHARE * GAINED:
                    return best
        return best

    def _steps(
        self,
        there: Shape,
        goal: Array,
        miss: Array,
        damping: float,
        slopes: Array,
        learned: Array,
    ) -> Iterator[tuple[Array, tuple[float, ...]]]:
        """
        Yield steps (m,) [N] by slopes (3, m) [m], with what was learned and without; of one side.

        Where tendons stick, slopes say little of steps that let them slip; those of one side are
        taken over ever larger steps, until one moves the tip as far as it is off.
        """
        for made in (slopes + learned, slopes):
            step = bounded_step(made, STEP_SHARE * miss, goal, self.limits, damping) - goal
            yield step, HALVES
        for share in ONE_SIDED_SHARES:
            sides = self._one_sided_slopes(there, goal, share)
            yield self._one_sided_step(sides, goal, STEP_SHARE * miss), SLIPPING
            if share * (miss @ sides).max() > miss @ miss:
                return

    def _one_sided_slopes(self, there: Shape, goal: Array, share: float) -> Array:
        """
        Return slopes (3, 2m) [m] over a share of the ranges, of more and of less tension.

        Where tendons pull hard against each other, both may let the arm slip the same way: the
        mean of both slopes then leads nowhere.
        """
        m, width = len(goal), self.limits[:, 1] - self.limits[:, 0]
        moves = []
        for side in np.concatenate([np.eye(m), -np.eye(m)]) * share:
            to = np.clip(goal + side * width, *self.limits.T)
            moves.append(self.there(to).tip_position - there.tip_position)
        return np.array(moves).T / share

    def _one_sided_step(self, slopes: Array, goal: Array, wanted: Array) -> Array:
        """Return a step (m,) [N] by slopes (3, 2m) [m] that differ by the direction."""
        m, (low, high) = len(goal), self.limits.T
        room = np.concatenate([high - goal, goal - low])
        limits = np.stack([np.zeros(2 * m), np.tile(high - low, 2)], axis=1)
        step = np.minimum(bounded_step(slopes, wanted, np.zeros(2 * m), limits), room)
        return np.asarray(step[:m] - step[m:])

    def _way(self, there: Shape) -> float:
        return float(np.linalg.norm(there.tip_position - self.here.tip_position))

    def there(self, goal: Array, before: Shape | None = None) -> Shape:
        """Return the shape under a goal (m,) [N] after another one; default: the one here."""
        return self.model.follow(before or self.here, np.maximum(goal + self.bias, 0.0))

    def allowed(self, goal: Array, before: Array, keep_out: KeepOut) -> tuple[Array, str]:
        """Return the next goal (m,) [N], or the one before and the region the arm would enter."""
        entered = keep_out and keep_out.clearance(self.there(goal).positions).inside
        return (before, entered) if entered else (goal, '')

    def _left(self, there: Shape, known: Mismatch) -> Array:
        """Return how far (3,) [m] the tip will be from where it is wanted."""
        shift = known.shift(there.inputs, self._way(there), self.model.robot.length)
        return np.asarray(self.wanted - there.tip_position - shift)


def _slopes(model: Model, shape: Shape, before: Shape) -> Array:
    """Return the motion of the tip (3, m) [m/N]."""
    past = before.memory if model.remembers else model.arrays.fresh_memory()
    return tip_slopes(model, shape, past)[:3]
