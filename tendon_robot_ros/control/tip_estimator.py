"""
How far the tip is from where the model has it, by the tracked tip; steps of the tensions by it.

The tip is y(T) = model(T) + b + D (T - T_now), with a bias b [m] at the tensions that act and a
correction D of the model's Jacobian. A Kalman filter estimates both. The bias of an arm that
stands is a random walk, as fast as a gain says. D is a stationary process (Ornstein-Uhlenbeck) in
time and along the path of the tip: what is long ago or far behind says nothing of it here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..common.estimation import kalman_update
from ..model.derivatives import tip_slopes
from ..model.program import STEP_DAMPING, STEP_GAIN, bounded_step
from .driver_side import NOISE_SAMPLES

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Shape
    from ..robot.keep_out import KeepOut

Array = NDArray[np.float64]
# [m] noise of a tracker, of all axes together, until a standing arm has shown it; less than what
# trackers of this size resolve would have the loop follow noise
TRACKER_NOISE_M = 3e-4
# [1] of the model's Jacobian, 1 sd of D: friction alone changes it by as much. A larger D is not
# believed, because with errors of friction it would turn the Jacobian round
MODEL_SLOPE_SD = 0.5
# [s] in which D changes to 1/e, because tendons come to stick or slip within seconds
SLOPE_S = 4.0
# [1] of the arm's length: path of the tip along which D changes to 1/e (docs/control.md)
SLOPE_LENGTH = 0.15
# [1] of the arm's length, at which half of the bias is left (docs/control.md)
BIAS_RADIUS = 0.25
# [1] standard deviations of the bias: a tip that is nearer is where it should be, because steps
# that follow noise let the arm slip in the end (docs/control.md)
REST_SD = 1.5
# [1] of the largest slope: below it the loop's steps would be lost in friction (docs/control.md)
WEAK_SLOPE = 0.02
# [1] of a tension's range: nearer to its goal or limit it is there, because noise of load cells is
# half of it
RANGE_TOLERANCE = 2e-3
# [1] of a step, tried one after the other, because tendons that stick need more, those that slip
# less
STEP_LENGTHS = 1.0, 4.0, 0.25
# [1] of what a step promises, that it must do; with less it would be noise (Armijo 1966)
GAIN_MIN = 0.1
# [1] of a tension's range, of a secant: the longer, the more tendons slip (docs/control.md)
SECANTS = 5e-3, 0.05


@dataclass(frozen=True)
class TipEstimate:
    """
    What is estimated at tensions.

    Attributes
    ----------
    tensions : (m,) [N]
        About which it is.
    range : (m,) [N]
        Over which slopes are.
    bias : (3,) [m]
    slopes : (3, m) [m]
        D over the ranges.
    covariance : (1 + m, 1 + m) [1]
        Of bias and slopes, the same for each axis, in units of the tracker's variance.
    noise : float
        Standard deviation of the tracker, over all axes [m].
    samples : int
        Of a standing arm, from which that is.
    residual : (3,) [m] or None
        By which the tip was off the model's last.

    """

    tensions: Array
    range: Array
    bias: Array
    slopes: Array
    covariance: Array
    noise: float = TRACKER_NOISE_M
    samples: int = 0
    residual: Array | None = None

    @classmethod
    def begin(cls, tensions: Array, limits: Array, slope_sd: Array) -> TipEstimate:
        """Begin with nothing known but how far (m,) [m] slopes may be off."""
        m = len(tensions)
        covariance = np.diag([1.0, *(slope_sd / TRACKER_NOISE_M) ** 2])
        width = limits[:, 1] - limits[:, 0]
        return cls(tensions, width, np.zeros(3), np.zeros((3, m)), covariance)

    def about(self, tensions: Array) -> TipEstimate:
        """Return the same about other tensions (m,) [N]."""
        move = np.eye(len(self.covariance))
        move[0, 1:] = (tensions - self.tensions) / self.range
        bias = self.bias + self.slopes @ move[0, 1:]
        covariance = move @ self.covariance @ move.T
        return replace(self, tensions=tensions, bias=bias, covariance=covariance)

    def updated(
        self,
        residual: Array,
        gain: float,
        slope_sd: Array,
        passed: float = 0.0,
        path: float = 0.0,
        length: float = np.inf,
    ) -> TipEstimate:
        """
        Return the estimate after the tip was `residual` (3,) [m] away from the model's.

        Parameters
        ----------
        gain : float
            Part of a lasting change of the bias that is taken over from one measurement, while the
            arm stands [1].
        slope_sd : (m,) [m]
            Standard deviation of slopes of which nothing is known.
        passed : float
            Since the last measurement [s]; 0 where slopes are those of one slow motion.
        path : float
            Of the model's tip since the last measurement [m].
        length : float
            Of the arm [m].

        """
        alike = float(np.exp(-passed / SLOPE_S - path / (SLOPE_LENGTH * length)))
        fades = np.append(1.0, np.full(len(slope_sd), alike))
        # the first makes `gain` that of the bias where slopes do not matter
        opened = gain**2 / (1.0 - gain), *(1.0 - alike**2) * (slope_sd / TRACKER_NOISE_M) ** 2
        after = kalman_update(
            np.vstack([self.bias, alike * self.slopes.T]),
            self.covariance * np.outer(fades, fades) + np.diag(opened),
            np.eye(len(fades))[:1],
            (residual - self.bias)[None],
            np.eye(1),
        )
        noise, samples = self.noise, self.samples
        if self.residual is not None and path < 0.1 * TRACKER_NOISE_M:  # the arm stands
            square = 0.5 * float(((residual - self.residual) ** 2).sum())
            if square < 9.0 * max(noise, TRACKER_NOISE_M) ** 2:  # a jump is no noise
                samples = min(samples + 1, NOISE_SAMPLES)
                noise = float(np.sqrt(noise**2 + (square - noise**2) / samples))
        return replace(
            self,
            bias=after.mean[0],
            slopes=after.mean[1:].T,
            covariance=after.covariance,
            noise=noise,
            samples=samples,
            residual=residual,
        )

    def without_slopes(self, slope_sd: Array) -> TipEstimate:
        """Return the same with nothing known of slopes but how far (m,) [m] they may be off."""
        first = float(self.covariance[0, 0])
        covariance = np.diag([first, *(slope_sd / TRACKER_NOISE_M) ** 2])
        return replace(self, slopes=np.zeros_like(self.slopes), covariance=covariance)

    @property
    def rest(self) -> float:
        """How near [m] to its place the tip is as near as the tracker's noise lets anyone know."""
        return REST_SD * self.noise * float(np.sqrt(self.covariance[0, 0]))

    def slope_sd(self, direction: Array) -> float:
        """Return the standard deviation [m] of the slope along a direction (m,) of the ranges."""
        return float(self.noise * np.sqrt(direction @ self.covariance[1:, 1:] @ direction))

    def bias_at(self, tensions: Array, distance: float = np.inf) -> Array:
        """Return by how much (3,) [m] the tip is off at tensions (m,) [N], see `slope_part`."""
        added = self.slopes @ ((tensions - self.tensions) / self.range)
        return np.asarray(self.bias + self.slope_part(tensions, distance) * added)

    def slope_part(self, tensions: Array, distance: float) -> float:
        """
        Return which part [1] of the slopes counts at tensions (m,) [N].

        Where the model's tip is a distance [m] away, slopes add no more than a part of that.
        """
        added = float(np.linalg.norm(self.slopes @ ((tensions - self.tensions) / self.range)))
        return min(1.0, MODEL_SLOPE_SD * distance / max(added, 1e-12))

    def within(self, slopes: Array) -> TipEstimate:
        """Return the same with D at most as large as a part of the model's slopes (3, m) [m]."""
        most = MODEL_SLOPE_SD * float(np.linalg.norm(slopes))
        size = max(float(np.linalg.norm(self.slopes)), 1e-12)
        return replace(self, slopes=self.slopes * min(1.0, most / size))


def bias_part(distance: float, length: float) -> float:
    """Return which part [1] of a bias is left a distance [m] away on an arm of a length [m]."""
    return 1.0 / (1.0 + (distance / (BIAS_RADIUS * length)) ** 2)


@dataclass(frozen=True)
class TipStep:
    """One step of the goal: where the arm is and should be, as the model sees it."""

    model: Model
    here: Shape
    slopes: Array  # (3, m) [m] over the ranges
    wanted: Array  # (3,) [m]
    offset: Array  # (m,) [N] that acts beyond the command
    limits: Array  # (m, 2) [N]
    stands: bool = False  # the command is at its goal: time to follow what hardly moves the tip

    @classmethod
    def at(
        cls, model: Model, here: Shape, wanted: Array, offset: Array, limits: Array, stands: bool
    ) -> TipStep:
        """Look at the slopes where the arm is."""
        return cls(model, here, _slopes(model, here, here, limits), wanted, offset, limits, stands)

    def next_goal(self, known: TipEstimate, goal: Array) -> Array:
        """Return the tensions (m,) [N] at which the tip is nearer to where it is wanted."""
        there = self.there(goal)
        miss = self._miss(there, known)
        away = float(np.linalg.norm(miss))
        if self.stands and away < known.rest:
            return goal  # friction would let the arm slip by what is noise
        best, least = goal, 1.0
        for step in self._steps(there, goal, STEP_GAIN * miss, known):
            for length in STEP_LENGTHS:
                made = goal + length * step
                nearer = float(np.linalg.norm(self._miss(self.there(made), known)))
                nearer /= max(away, 1e-12)
                if nearer < least:
                    best, least = made, nearer
                if nearer < 1.0 - length * STEP_GAIN * GAIN_MIN:
                    return best
        return best

    def _steps(
        self, there: Shape, goal: Array, wanted: Array, known: TipEstimate
    ) -> Iterator[Array]:
        """
        Yield steps (m,) [N] that move the tip as wanted (3,) [m].

        By the model's slopes, with what was learned and without. Where tendons stick, they say
        little of steps that let them slip: then by secants of both sides, ever longer, until one
        moves the tip as far as it is off.
        """
        slopes = self.slopes_at(there)
        distance = self._distance(there)
        part = bias_part(distance, self.model.robot.length)
        learned = part * known.slope_part(there.inputs, distance) * known.slopes
        damping = WEAK_SLOPE if self.stands else STEP_DAMPING
        for made in (slopes + learned, slopes):
            yield bounded_step(made, wanted, goal, self.limits, damping) - goal
        m, (low, high) = len(goal), self.limits.T
        room = np.concatenate([high - goal, goal - low])
        both = np.stack([np.zeros(2 * m), np.tile(high - low, 2)], axis=1)
        for length in SECANTS:
            sides = self._secants(there, goal, length)
            step = np.minimum(bounded_step(sides, wanted, np.zeros(2 * m), both), room)
            yield step[:m] - step[m:]
            if length * (wanted @ sides).max() > wanted @ wanted / STEP_GAIN:
                return

    def _secants(self, there: Shape, goal: Array, length: float) -> Array:
        """
        Return how the tip moves (3, 2m) [m] over the ranges, by more and by less of each tension.

        Where tendons pull hard against each other, both may let the arm slip the same way: the
        mean of both slopes then leads nowhere.
        """
        m, (low, high) = len(goal), self.limits.T
        moves = []
        for side in np.concatenate([np.eye(m), -np.eye(m)]) * length:
            to = np.clip(goal + side * (high - low), low, high)
            moves.append(self.there(to).tip_position - there.tip_position)
        return np.array(moves).T / length

    def slopes_at(self, there: Shape) -> Array:
        """Return the model's motion of the tip (3, m) [m] over the ranges at a shape."""
        return _slopes(self.model, there, self.here, self.limits)

    def there(self, goal: Array) -> Shape:
        """Return the shape under a goal (m,) [N] after the one here."""
        return self.model.follow(self.here, np.maximum(goal + self.offset, 0.0))

    def allowed(self, goal: Array, before: Array, keep_out: KeepOut) -> tuple[Array, str]:
        """Return the next goal (m,) [N], or the one before and the region the arm would enter."""
        region = keep_out and keep_out.clearance(self.there(goal).positions).inside
        return (before, region) if region else (goal, '')

    def _distance(self, there: Shape) -> float:
        return float(np.linalg.norm(there.tip_position - self.here.tip_position))

    def _miss(self, there: Shape, known: TipEstimate) -> Array:
        """Return how far (3,) [m] the tip will be from where it is wanted."""
        distance = self._distance(there)
        part = bias_part(distance, self.model.robot.length)
        bias = known.bias_at(there.inputs, distance)
        return np.asarray(self.wanted - there.tip_position - part * bias)


def _slopes(model: Model, shape: Shape, before: Shape, limits: Array) -> Array:
    """Return the motion of the tip (3, m) [m] over the ranges."""
    past = before.memory if model.remembers else model.arrays.fresh_memory()
    return tip_slopes(model, shape, past)[:3] * (limits[:, 1] - limits[:, 0])
