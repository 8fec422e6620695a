"""
How far the tip is from where the model has it, estimated from the tracked tip.

The tip is y(T) = model(T) + b + D (T - T_now), with a bias b [m] at the tensions that act and a
correction D of the model's Jacobian. A Kalman filter (Kalman 1960, J. Basic Eng. 82, 35) estimates
both. The bias of an arm that stands is a random walk, as fast as a gain says. D is a stationary
process (Ornstein-Uhlenbeck) in time and along the path of the tip: what is long ago or far behind
says nothing of it here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
TRACKER_NOISE_M = 3e-4  # [m] of all axes together, until a standing arm has shown the tracker's
MODEL_SLOPE_SD = 0.5  # [1] of the model's Jacobian: friction alone changes it by as much. A D
# that is larger is not believed: with errors of friction it would turn the Jacobian round
SLOPE_S = 4.0  # [s] in which D changes to 1/e: tendons come to stick or slip within seconds
SLOPE_PATH = 0.15  # [1] of the arm's length: path of the tip along which D changes to 1/e
BIAS_RADIUS = 0.25  # [1] of the arm's length, at which half of the bias is left
NOISE_SAMPLES = 50  # of a standing arm, over which the tracker's noise is averaged: 1 s at 50 Hz
REST_SD = 1.5  # [1] standard deviations of the bias: a tip that is nearer is where it should be


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
        share: float,
        slope_sd: Array,
        passed: float = 0.0,
        path: float = 0.0,
        length: float = np.inf,
    ) -> TipEstimate:
        """
        Return the estimate after the tip was `residual` (3,) [m] away from the model's.

        Parameters
        ----------
        share : float
            Of a lasting change of the bias that is taken over from one measurement, while the arm
            stands [1].
        slope_sd : (m,) [m]
            Standard deviation of slopes of which nothing is known.
        passed : float
            Since the last measurement [s]; 0 where slopes are those of one slow motion.
        path : float
            Of the model's tip since the last measurement [m].
        length : float
            Of the arm [m].

        """
        alike = float(np.exp(-passed / SLOPE_S - path / (SLOPE_PATH * length)))
        fades = np.append(1.0, np.full(len(slope_sd), alike))
        prior = self.covariance * np.outer(fades, fades)
        # the first makes `share` the gain of the bias where slopes do not matter
        opened = share**2 / (1.0 - share), *(1.0 - alike**2) * (slope_sd / TRACKER_NOISE_M) ** 2
        prior += np.diag(opened)
        gain = prior[:, 0] / (prior[0, 0] + 1.0)
        covariance = prior - np.outer(gain, prior[0])
        new = residual - self.bias
        noise, samples = self.noise, self.samples
        if self.residual is not None and path < 0.1 * TRACKER_NOISE_M:  # the arm stands
            square = 0.5 * float(((residual - self.residual) ** 2).sum())
            if square < 9.0 * max(noise, TRACKER_NOISE_M) ** 2:  # a jump is no noise
                samples = min(samples + 1, NOISE_SAMPLES)
                noise = float(np.sqrt(noise**2 + (square - noise**2) / samples))
        return replace(
            self,
            bias=self.bias + gain[0] * new,
            slopes=alike * self.slopes + np.outer(new, gain[1:]),
            covariance=0.5 * (covariance + covariance.T),
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
        """Return by how much (3,) [m] the tip is off at tensions (m,) [N], see `part`."""
        added = self.slopes @ ((tensions - self.tensions) / self.range)
        return np.asarray(self.bias + self.part(tensions, distance) * added)

    def part(self, tensions: Array, distance: float) -> float:
        """
        Return which part [1] of the slopes counts at tensions (m,) [N].

        Where the model's tip is a distance [m] away, slopes add no more than a share of that.
        """
        added = float(np.linalg.norm(self.slopes @ ((tensions - self.tensions) / self.range)))
        return min(1.0, MODEL_SLOPE_SD * distance / max(added, 1e-12))

    def within(self, slopes: Array) -> TipEstimate:
        """Return the same with D at most as large as a share of the model's (3, m) [m]."""
        most = MODEL_SLOPE_SD * float(np.linalg.norm(slopes))
        size = max(float(np.linalg.norm(self.slopes)), 1e-12)
        return replace(self, slopes=self.slopes * min(1.0, most / size))


def bias_share(distance: float, length: float) -> float:
    """Return which share [1] of a bias is left a distance [m] away on an arm of a length [m]."""
    return 1.0 / (1.0 + (distance / (BIAS_RADIUS * length)) ** 2)
