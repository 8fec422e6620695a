"""
Estimator of the bias of the model's tip from the tracked tip; steps of the tensions with it.

The tip is y(T) = model(T) + b + D (T - T_now), with a bias b [m] at the tensions that act and a
correction D of the model's Jacobian. A Kalman filter estimates both. The bias of an arm at rest is
a random walk, whose rate follows from a gain. D is a stationary process (Ornstein-Uhlenbeck) along
the path of the tip: it decorrelates with distance, because tendons come to stick or slip.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from ..common.arrays import Floats
from ..common.estimation import kalman_update
from ..model.derivatives import tip_slopes
from ..model.model import Model
from ..model.program import RANGE_TOLERANCE, STEP_DAMPING, STEP_GAIN, STEP_MAX, bounded_step
from ..model.shape import Reach, Shape
from ..robot.estimates import TRACKER_NOISE_M
from ..robot.keep_out import KeepOut

# [1] readings over which noise is averaged, of load cells and trackers: so that it is known to
# 10 %; the mean offset is over twice as many
NOISE_SAMPLES = 50
# [1] of the model's Jacobian, 1 sd of D: friction alone changes it by as much. D is limited to
# it, because by errors of friction a larger D would reverse the sign of the Jacobian. In a
# null-space motion, where the model's tip stays, of the arm's length (docs/control.md)
MODEL_SLOPE_SD = 0.5
# [1] of the arm's length: path of the tip along which D changes to 1/e (docs/control.md)
SLOPE_LENGTH = 0.15
# [1] of the arm's length: distance at which half of the bias applies (docs/control.md)
BIAS_RADIUS = 0.25
# [1] standard deviations of the bias: a nearer tip is at its target, because steps that follow
# noise make the arm slip eventually (docs/control.md)
REST_SD = 1.5
# [1] of the largest slope: below it the loop's steps would be lost in friction (docs/control.md)
WEAK_SLOPE = 0.02
# [1] of a step, tried in sequence, because tendons that stick need more, those that slip less
STEP_LENGTHS = 1.0, 4.0, 0.25
# [1] of the predicted decrease that a step has to reach; less would be noise (Armijo 1966)
GAIN_MIN = 0.1
# [1] of a tension's range, of a secant: the longer, the more tendons slip (docs/control.md)
SECANTS = 5e-3, 0.05
# [1/s] of the length: velocity of the tip, 1 sd, that doubt of slopes may cause: 0.1 mm/s on 208
# mm, so that the tracker measures it before it is a millimetre (docs/control.md)
DRIFT = 5e-4
# [1/s] of the estimator: slower than `tip_gain`, because only noise moves the tip
# (docs/control.md)
HOLD_GAIN = 0.5
# [1] of the arm's length: beyond it an external load is assumed, because the motion alone
# moves the tip by less: 0.6 mm on 208 mm (docs/control.md)
HANDOVER_LENGTH = 3e-3


@dataclass(frozen=True)
class TipEstimate:
    """
    Estimate of bias and slopes at given tensions.

    Attributes
    ----------
    tensions : (m,) [N]
        Point of linearisation.
    range : (m,) [N]
        Ranges of the tensions, the unit of slopes.
    bias : (3,) [m]
    slopes : (3, m) [m]
        D times the ranges.
    covariance : (1 + m, 1 + m) [1]
        Covariance of bias and slopes, equal for the axes, in units of the tracker's variance.
    noise : float
        Standard deviation of the tracker, over all axes [m].
    samples : int
        Number of readings of an arm at rest behind `noise`.
    residual : (3,) [m] or None
        Last difference between the measured tip and the model's.

    """

    tensions: Floats
    range: Floats
    bias: Floats
    slopes: Floats
    covariance: Floats
    noise: float = TRACKER_NOISE_M
    samples: int = 0
    residual: Floats | None = None

    @classmethod
    def begin(cls, tensions: Floats, limits: Floats, slope_sd: Floats) -> TipEstimate:
        """Return the prior with standard deviations of the slopes (m,) [m]."""
        m = len(tensions)
        covariance = np.diag([1.0, *(slope_sd / TRACKER_NOISE_M) ** 2])
        width = limits[:, 1] - limits[:, 0]
        return cls(tensions, width, np.zeros(3), np.zeros((3, m)), covariance)

    def about(self, tensions: Floats) -> TipEstimate:
        """Return the estimate at other tensions (m,) [N]."""
        move = np.eye(len(self.covariance))
        move[0, 1:] = (tensions - self.tensions) / self.range
        bias = self.bias + self.slopes @ move[0, 1:]
        covariance = move @ self.covariance @ move.T
        return replace(self, tensions=tensions, bias=bias, covariance=covariance)

    def updated(
        self,
        residual: Floats,
        gain: float,
        slope_sd: Floats,
        path: float = 0.0,
        length: float = np.inf,
    ) -> TipEstimate:
        """
        Return the estimate after a measurement.

        Parameters
        ----------
        residual : (3,) [m]
            Measured tip minus the model's.
        gain : float
            Fraction of a lasting change of the bias that one measurement adopts while the arm
            rests [1].
        slope_sd : (m,) [m]
            Stationary standard deviation of the slopes.
        path : float
            Path of the model's tip since the last measurement [m].
        length : float
            Length of the arm [m].

        """
        alike = float(np.exp(-path / (SLOPE_LENGTH * length)))
        fades = np.append(1.0, np.full(len(slope_sd), alike))
        # the first term gives the bias the stationary Kalman gain `gain` for constant slopes
        opened = gain**2 / (1.0 - gain), *(1.0 - alike**2) * (slope_sd / TRACKER_NOISE_M) ** 2
        after = kalman_update(
            np.vstack([self.bias, alike * self.slopes.T]),
            self.covariance * np.outer(fades, fades) + np.diag(opened),
            np.eye(len(fades))[:1],
            (residual - self.bias)[None],
            np.eye(1),
        )
        noise, samples = self.noise, self.samples
        if self.residual is not None and path < 0.1 * TRACKER_NOISE_M:  # at rest
            square = 0.5 * float(((residual - self.residual) ** 2).sum())
            if square < 9.0 * max(noise, TRACKER_NOISE_M) ** 2:  # jumps do not count
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

    def without_slopes(self, slope_sd: Floats) -> TipEstimate:
        """Return the estimate with slopes reset to a prior of standard deviations (m,) [m]."""
        first = float(self.covariance[0, 0])
        covariance = np.diag([first, *(slope_sd / TRACKER_NOISE_M) ** 2])
        return replace(self, slopes=np.zeros_like(self.slopes), covariance=covariance)

    @property
    def rest(self) -> float:
        """Distance [m] to the target that the tracker's noise does not resolve."""
        return REST_SD * self.noise * float(np.sqrt(self.covariance[0, 0]))

    def slope_sd(self, direction: Floats) -> float:
        """Return the standard deviation [m] of the slope along a direction (m,) of the ranges."""
        return float(self.noise * np.sqrt(direction @ self.covariance[1:, 1:] @ direction))

    def bias_at(self, tensions: Floats, distance: float = np.inf) -> Floats:
        """Return the bias (3,) [m] at tensions (m,) [N], limited by `slope_part`."""
        added = self.slopes @ ((tensions - self.tensions) / self.range)
        return np.asarray(self.bias + self.slope_part(tensions, distance) * added)

    def slope_part(self, tensions: Floats, distance: float) -> float:
        """
        Return the fraction [1] of the slopes that applies at tensions (m,) [N].

        The slopes add at most a fraction of the distance [m] by which the model's tip moves.
        """
        added = float(np.linalg.norm(self.slopes @ ((tensions - self.tensions) / self.range)))
        return min(1.0, MODEL_SLOPE_SD * distance / max(added, 1e-12))

    def within(self, slopes: Floats) -> TipEstimate:
        """Return the estimate with D limited to a fraction of the model's slopes (3, m) [m]."""
        size_max = MODEL_SLOPE_SD * float(np.linalg.norm(slopes))
        size = max(float(np.linalg.norm(self.slopes)), 1e-12)
        return replace(self, slopes=self.slopes * min(1.0, size_max / size))


def bias_part(distance: float, length: float) -> float:
    """Return the fraction [1] of a bias at a distance [m] on an arm of a length [m]."""
    return 1.0 / (1.0 + (distance / (BIAS_RADIUS * length)) ** 2)


@dataclass(frozen=True)
class TipStep:
    """One step of the goal of the tensions, by the model and its estimated bias."""

    model: Model
    shape: Shape
    target: Floats  # (3,) [m]
    offset: Floats | float  # (m,) [N] estimated minus commanded tensions
    limits: Floats  # (m, 2) [N]
    arrived: bool = False  # the command is at its goal: slow directions count, too

    @cached_property
    def slopes(self) -> Floats:
        """The model's Jacobian of the tip (3, m) [m] times the ranges at the shape."""
        return self.slopes_at(self.shape)

    def next_goal(self, estimate: TipEstimate, goal: Floats) -> Floats:
        """Return the goal (m,) [N] that brings the tip nearer to its target."""
        goal_shape = self.shape_at(goal)
        miss = self._miss(goal_shape, estimate)
        distance = float(np.linalg.norm(miss))
        if self.arrived and distance < estimate.rest:
            return goal  # else steps by noise would make the arm slip
        best, ratio_min = goal, 1.0
        for step in self._steps(goal_shape, goal, STEP_GAIN * miss, estimate):
            for length in STEP_LENGTHS:
                candidate = goal + length * step
                ratio = float(np.linalg.norm(self._miss(self.shape_at(candidate), estimate)))
                ratio /= max(distance, 1e-12)
                if ratio < ratio_min:
                    best, ratio_min = candidate, ratio
                if ratio < 1.0 - length * STEP_GAIN * GAIN_MIN:
                    return best
        return best

    def _steps(
        self, goal_shape: Shape, goal: Floats, motion: Floats, estimate: TipEstimate
    ) -> Iterator[Floats]:
        """
        Yield steps (m,) [N] for a motion (3,) [m] of the tip.

        First by the model's Jacobian with and without its estimated correction. For tendons that
        stick it does not describe steps that make them slip: then by two-sided secants of growing
        length, until one moves the tip by its whole error.
        """
        slopes = self.slopes_at(goal_shape)
        distance, part = self._belief(goal_shape)
        learned = part * estimate.slope_part(goal_shape.inputs, distance) * estimate.slopes
        damping = WEAK_SLOPE if self.arrived else STEP_DAMPING
        for jacobian in (slopes + learned, slopes):
            yield bounded_step(jacobian, motion, goal, self.limits, damping) - goal
        m, (low, high) = len(goal), self.limits.T
        room = np.concatenate([high - goal, goal - low])
        both = np.stack([np.zeros(2 * m), np.tile(high - low, 2)], axis=1)
        for length in SECANTS:
            sides = self._secants(goal_shape, goal, length)
            step = np.minimum(bounded_step(sides, motion, np.zeros(2 * m), both), room)
            yield step[:m] - step[m:]
            if length * (motion @ sides).max() > motion @ motion / STEP_GAIN:
                return

    def _secants(self, goal_shape: Shape, goal: Floats, length: float) -> Floats:
        """
        Return secant slopes of the tip (3, 2m) [m], for increasing and for decreasing tensions.

        Under high co-contraction both may make the arm slip in the same direction, so that their
        mean would be useless.
        """
        m, (low, high) = len(goal), self.limits.T
        moves = []
        for side in np.concatenate([np.eye(m), -np.eye(m)]) * length:
            to = np.clip(goal + side * (high - low), low, high)
            moves.append(self.shape_at(to).tip_position - goal_shape.tip_position)
        return np.array(moves).T / length

    def slopes_at(self, goal_shape: Shape) -> Floats:
        """Return the model's Jacobian of the tip (3, m) [m] times the ranges at a shape."""
        model, (low, high) = self.model, self.limits.T
        past = self.shape.memory if model.remembers else model.arrays.fresh_memory()
        return np.asarray(tip_slopes(model, goal_shape, past)[0][:3] * (high - low))

    def shape_at(self, goal: Floats) -> Shape:
        """Return the shape under a goal (m,) [N], from the present shape."""
        return self.model.follow(self.shape, np.maximum(goal + self.offset, 0.0))

    def allowed(self, goal: Floats, before: Floats, keep_out: KeepOut) -> tuple[Floats, str]:
        """Return the goal (m,) [N], or the last one and the region that the arm would enter."""
        region = keep_out and keep_out.clearance(self.shape_at(goal).positions).inside
        return (before, region) if region else (goal, '')

    def _belief(self, goal_shape: Shape) -> tuple[float, float]:
        """Return the distance [m] of a shape's tip from here, and the part of the bias there."""
        distance = float(np.linalg.norm(goal_shape.tip_position - self.shape.tip_position))
        return distance, bias_part(distance, self.model.robot.length)

    def _miss(self, goal_shape: Shape, estimate: TipEstimate) -> Floats:
        """Return the predicted error of the tip (3,) [m] at a shape."""
        distance, part = self._belief(goal_shape)
        bias = estimate.bias_at(goal_shape.inputs, distance)
        return np.asarray(self.target - goal_shape.tip_position - part * bias)


@dataclass(frozen=True)
class NullSpaceMotion:
    """
    A null-space motion in closed loop.

    Attributes
    ----------
    solution : Reach
        The solution for the target at which the tip stays.
    tensions : (m,) [N]
        The preferred tensions.
    signs : (m,)
        1 for a tension that only rises, -1 for one that only falls.
    place : (3,) [m] or None
        Position at which the tip is held; None until its bias is known well enough to begin.

    """

    solution: Reach
    tensions: Floats
    signs: Floats
    place: Floats | None = None

    @classmethod
    def begin(cls, solution: Reach, tensions: Floats, current: Floats) -> NullSpaceMotion:
        """Return the motion from the current tensions (m,) [N] to the preferred ones."""
        return cls(solution, tensions, np.where(tensions >= current, 1.0, -1.0))

    def step(
        self, tip: TipStep, goal: Floats, estimate: TipEstimate, passed: float
    ) -> tuple[NullSpaceMotion | None, Floats]:
        """
        Return the motion and the next goal (m,) [N]; None instead of the motion ends it.

        Parameters
        ----------
        tip : TipStep
            Shape by the model and its Jacobian.
        goal : (m,) [N]
            The last goal.
        estimate : TipEstimate
            Estimate of the tip's bias.
        passed : float
            Since the last step [s].

        """
        position = tip.shape.tip_position + estimate.bias
        if self.place is None:
            variance_max = 2.0 * HOLD_GAIN * passed  # twice the final variance of the bias
            settled = estimate.covariance[0, 0] < variance_max
            return replace(self, place=position) if settled else self, goal
        distance, length = float(np.linalg.norm(self.place - position)), tip.model.robot.length
        if distance > HANDOVER_LENGTH * length:
            return None, goal  # the tip loop takes over
        goal_shape, width = tip.shape_at(goal), estimate.range
        slopes = tip.slopes_at(goal_shape) + estimate.slopes
        remaining = self.signs * np.maximum(self.signs * (self.tensions - goal) / width, 0.0)
        wish = remaining * min(1.0, STEP_MAX / max(float(np.abs(remaining).max()), 1e-12))
        step = partial(bounded_step, slopes, tensions=goal, limits=tip.limits, signs=self.signs)
        free = (step(target=np.zeros(3), preferred=wish) - goal) / width
        size = max(float(np.abs(free).max()), 1e-12)
        if size < RANGE_TOLERANCE and distance < 2.0 * estimate.rest:
            return self, goal  # at the end; else noise would raise tensions without limit
        drift = DRIFT * length
        # [1/s] of the ranges, at most one tolerance: faster, the tip's bias would change before it
        # is estimated (docs/control.md)
        speed = drift / max(estimate.slope_sd(free / size), drift / RANGE_TOLERANCE)
        miss = STEP_GAIN * (self.place - goal_shape.tip_position - estimate.bias_at(goal))
        return self, step(target=miss, preferred=free * min(1.0, speed * passed / size))
