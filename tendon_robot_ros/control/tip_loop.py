"""
What the model leaves over, learned from the measured tip, and tensions that take it off.

The tip is y(T) = model(T) + d + D (T - T_now): a Kalman filter learns the offset d [m] and the
correction D of the Jacobian [m/N] from what is measured at the tensions that act. A step of
bounded least squares on J + D then moves the goal to where y is the target. The filter looks at
what the arm does, not at what it was told, so neither lag nor a limit winds anything up.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..common.errors import TendonRobotError
from ..model.derivatives import tip_slopes
from ..model.redundancy import bounded_step

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Shape
    from .solver import GiveUp
    from .state import Controller

Array = NDArray[np.float64]
TRACKER_SILENT_S = 0.1  # [s] of the tracker
TRACKER_LOST_S = 1.0  # [s] of silence after which the next target is gone to without correction
TRACKER_JUMP_M = 0.02  # [m] between two measurements that no arm does
JUMP_SETTLED_S = 0.2  # [s] without a jump after one, before the tracker is believed again
WORSE_FACTOR, WORSE_SHARE = 2.0, 0.1  # [1] of the error at first, and of the arm's length
OFFSET_MAX_SHARE = 0.4  # [1] of the arm's length: further off, the model is not of this arm
MOVING_ABOVE_N = 0.25  # [N] from the goal: on the way to another target nothing is learned
NEAR_SHARE = 0.05  # [1] of the arm's length: further off, what was learned is of another place
FIRST_DOUBT = 0.5  # [1] variance of the offset at first: a third of it is believed at once
STEP_SHARE = 0.5  # [1] of what the tip is off, in one step
HALVINGS = 4  # of a step that would bring the tip no nearer
TIP_NOISE_M = 3e-4  # [m] against which slopes are weighed
SLOPE_DOUBT = 0.05  # [1] of the arm's length over a tension's range, standard deviation of D
SLOPE_FORGOTTEN_S = 2.0  # [s] in which it is as open again


@dataclass(frozen=True)
class Mismatch:
    """
    What the filter knows at tensions `at`: the tip is off by `offset` + `slopes` (T - at).

    All three axes share one covariance, in units of the tracker's variance, of the offset and of
    the slopes over the ranges of the tensions.
    """

    at: Array  # (m,) [N]
    range: Array  # (m,) [N]
    offset: Array  # (3,) [m]
    slopes: Array  # (3, m) [m] over the ranges
    spread: Array  # (1 + m, 1 + m)

    @classmethod
    def unknown(cls, at: Array, limits: Array, length: float) -> Mismatch:
        """Begin with nothing known."""
        m, doubt = len(at), (SLOPE_DOUBT * length / TIP_NOISE_M) ** 2
        spread = np.diag([FIRST_DOUBT, *np.full(m, doubt)])
        return cls(at, limits[:, 1] - limits[:, 0], np.zeros(3), np.zeros((3, m)), spread)

    def moved(self, tensions: Array) -> Mismatch:
        """Return the same, about other tensions (m,) [N]."""
        share = (tensions - self.at) / self.range
        step = np.eye(1 + len(share))
        step[0, 1:] = share
        spread = step @ self.spread @ step.T
        return Mismatch(
            tensions, self.range, self.offset + self.slopes @ share, self.slopes, spread
        )

    def learned(self, left: Array, gain: float, passed: float, length: float) -> Mismatch:
        """
        Return what is known after the tip was `left` (3,) [m] away from the model's.

        Parameters
        ----------
        gain : float
            Share of a lasting error that is learned per second while the arm stands [1/s].
        passed : float
            Since the last measurement [s].

        """
        share = 1.0 - np.exp(-gain * passed)
        doubt = (SLOPE_DOUBT * length / TIP_NOISE_M) ** 2
        grown = self.spread.copy()
        grown[0, 0] += share**2 / (1.0 - share)  # so that the standing filter's gain is `share`
        grown[1:, 1:] += np.eye(len(self.at)) * doubt * passed / SLOPE_FORGOTTEN_S
        weights = grown[:, 0] / (grown[0, 0] + 1.0)
        spread = grown - np.outer(weights, grown[0])
        top = np.diag(np.minimum(np.sqrt(doubt / np.maximum(np.diag(spread)[1:], doubt)), 1.0))
        spread[1:, 1:] = top @ spread[1:, 1:] @ top  # no more open than at the beginning
        spread[0, 1:] = spread[1:, 0] = spread[0, 1:] @ top
        new = left - self.offset
        slopes = self.slopes + np.outer(new, weights[1:])
        offset = self.offset + weights[0] * new
        return Mismatch(self.at, self.range, offset, slopes, 0.5 * (spread + spread.T))


@dataclass
class TipLoop:
    """
    Moves the goal of the tensions until the measured tip is at the target.

    Frozen while the tracker is silent for 0.1 s, when it jumps by more than 20 mm and for 0.2 s
    after. What was learned stays for the target that stands; after a second of silence the next
    target does without. The loop is left, for this target, where the tip gets no nearer or is
    further from the model than any arm of its kind: tensions then are those of the model.
    """

    tensions: Array | None = None  # (m,) [N] the goal, None: that of the model
    frozen: str = 'no tracker'  # why, '' while it works
    known: Mismatch | None = None
    _seen: tuple[float, Array] | None = None
    _jumped: float = -np.inf  # [s]
    _error: Array = field(default_factory=lambda: np.full(3, np.nan))  # [m]
    _solution: object = None  # for which `tensions` are
    _due: float = 0.0  # [s] since the filter last learned
    _asked: object = None  # the target for which the loop runs
    _began: float = np.inf  # [m] error at its beginning
    _left: str = ''  # why it was left for this target
    _place: Array | None = None  # (3,) [m] the target at which it did

    def reset(self) -> None:
        """Forget what was learned."""
        self.tensions, self.known, self._solution, self._due = None, None, None, 0.0
        self._place = None

    def goal(self, core: Controller, solution: Array) -> Array:
        """Return the goal (m,) [N], within the limits."""
        if self.tensions is None or core.settings.tip_gain == 0.0:
            return solution
        if self._solution is not core.solution:
            return solution  # of another target, which was found with the correction in it
        low, high = core.settings.limits(core.model).T
        return np.clip(self.tensions, low, high)

    def shift(self, now: float, place: Array, length: float) -> Array:
        """
        Return by how much (3,) [m] the tip is off the model near a target (3,) [m].

        0 where nothing was learned near there, and once the tracker is lost.
        """
        lost = self._seen is None or now - self._seen[0] > TRACKER_LOST_S
        if lost or self.known is None or not self._near(place, length):
            return np.zeros(3)
        return self.known.offset

    def _near(self, place: Array, length: float) -> bool:
        away = np.inf if self._place is None else float(np.linalg.norm(place - self._place))
        return away < NEAR_SHARE * length

    def take(self, now: float, core: Controller, position: Array) -> None:
        """Take a measured tip (3,) [m] in the base frame."""
        before, self._seen = self._seen, (now, position)
        self.frozen = self._why_not(now, core, position, before)
        if before is not None:
            self._due = min(self._due + now - before[0], TRACKER_SILENT_S)
        if not self.frozen:
            self._look(core, position)

    def values(self, now: float) -> dict[str, str]:
        """Say how much of the correction is left to the loop, for the status."""
        silent = self._seen is None or now - self._seen[0] > TRACKER_SILENT_S
        frozen = 'tracker silent' if silent else self.frozen
        left = '' if np.isnan(self._error).any() else f'{1e3 * np.linalg.norm(self._error):.3f} mm'
        shift = 0.0 if self.known is None else float(np.linalg.norm(self.known.offset))
        return {
            'correction': f'{1e3 * shift:.3f} mm',
            'correction_frozen': frozen,
            'measured_error': left,
        }

    def _why_not(
        self, now: float, core: Controller, position: Array, before: tuple[float, Array] | None
    ) -> str:
        if before is None or now - before[0] > TRACKER_SILENT_S:
            return 'tracker silent'
        if np.linalg.norm(position - before[1]) > TRACKER_JUMP_M:
            self._jumped = now
        if now - self._jumped < JUMP_SETTLED_S:
            return 'tracker jumped'
        if core.target is None or core.target.position is None or core.solution is None:
            return 'no target'
        self._error = core.target.position - position
        if core.command is None or core.latch or core.driver_stopped or not core.fresh(now):
            return 'stopped'
        goal = self.goal(core, core.solution.tensions)
        if np.abs(goal - core.command).max() > MOVING_ABOVE_N:
            return 'moving'
        return self._astray(core, float(np.linalg.norm(self._error)))

    def _astray(self, core: Controller, error: float) -> str:
        """Say why the loop is left for this target, and have the model's tensions again."""
        length, target = core.model.robot.length, core.target
        if target is not self._asked:
            self._asked, self._began, self._left = target, error, ''
        assert target is not None and target.position is not None
        near = self.known is not None and self._near(target.position, length)
        if self.known is not None and near and not self._left:
            if float(np.linalg.norm(self.known.offset)) > OFFSET_MAX_SHARE * length:
                self._left = 'too far from the model'
            elif error > WORSE_FACTOR * self._began + WORSE_SHARE * length:
                self._left = 'it got no nearer'
            if self._left:
                self.tensions = self.known = None
        return self._left

    def _look(self, core: Controller, position: Array) -> None:
        """Have the solver compare the tip with the model's, and find where the goal is then."""
        solution, target, model = core.solution, core.target, core.model
        if core.solver.busy('loop') or core.settings.pull_mode:
            return
        assert solution is not None and target is not None and target.position is not None
        applied, wanted, length = core.felt_tensions(), target.position, model.robot.length
        assert core.command is not None
        bias = applied - core.command  # what acts beyond the command, it does at the goal, too
        limits, gain, passed = core.settings.limits(model), core.settings.tip_gain, self._due
        goal, last, self._due = self.goal(core, solution.tensions), core.track.last, 0.0
        keep_out = core.settings.keep_out
        known = self.known if self._near(wanted, length) else None
        known = known or Mismatch.unknown(applied, limits, length)

        def work(give_up: GiveUp) -> tuple[Mismatch, Array]:
            here = model.follow(last, applied)
            left = position - here.tip_position
            new = known.moved(applied).learned(left, gain, passed, length)
            found = _next_goal(model, new, here, goal, bias, wanted, limits)
            if keep_out and keep_out.clearance(model.follow(here, found).positions).distance < 0.0:
                found = goal  # where it is the arm was allowed
            return new, found

        def done(found: tuple[Mismatch, Array] | None, error: TendonRobotError | None) -> None:
            if found is not None and core.model is model and core.target is not None:
                self.known, self._place = found[0], wanted
                if core.solution is solution:
                    self.tensions, self._solution = found[1], solution

        core.solver.post('loop', work, done)


def _next_goal(
    model: Model,
    known: Mismatch,
    here: Shape,
    goal: Array,
    bias: Array,
    wanted: Array,
    limits: Array,
) -> Array:
    """Return the tensions (m,) [N] at which the tip is where it is wanted (3,) [m]."""
    past = here.memory if model.remembers else model.arrays.fresh_memory()

    def left(there: Shape) -> Array:
        shift = known.slopes @ ((there.inputs - known.at) / known.range)
        return np.asarray(wanted - there.tip_position - known.offset - shift)

    there = model.follow(here, np.maximum(goal + bias, 0.0))
    miss = left(there)
    slopes = tip_slopes(model, there, past)[:3] * known.range + known.slopes
    step = bounded_step(slopes, STEP_SHARE * miss, goal, limits) - goal
    for _ in range(HALVINGS):
        new = goal + step
        if np.linalg.norm(left(model.follow(here, np.maximum(new + bias, 0.0)))) < np.linalg.norm(
            miss
        ):
            return new
        step = 0.5 * step
    return goal


def stability_margins(gain: float, period: float, delay: float) -> tuple[float, float]:
    """
    Return how much more the arm may do than the corrected Jacobian says, and turned how far.

    Of the loop k z^-n / (z - 1) with k = 1 - exp(-gain period), for n samples of delay that the
    filter does not know of: the gain margin [1] and the phase margin [rad].

    Parameters
    ----------
    gain : float
        `tip_gain` [1/s].
    period : float
        Of the tracker [s].
    delay : float
        Between what is measured and what is heard [s].

    """
    share, samples = 1.0 - np.exp(-gain * period), np.ceil(delay / period)
    most = 2.0 * np.sin(0.5 * np.pi / (2.0 * samples + 1.0)) / share
    crossing = 2.0 * np.arcsin(min(0.5 * share, 1.0))  # [rad] per sample
    return float(most), float(0.5 * np.pi - (samples + 0.5) * crossing)
