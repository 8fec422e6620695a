"""
What the model leaves over near the tensions that act, learned from the measured tip.

The tip is y(T) = model(T) + d + D (T - T_now): a Kalman filter learns the offset d [m] and the
correction D of the Jacobian [m/N]. How far D may be off is a share of the model's own Jacobian.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
FIRST_DOUBT = 0.5  # [1] variance of the offset at first: a third of it is believed at once
TIP_NOISE_M = 3e-4  # [m] against which slopes are weighed
SLOPE_DOUBT = 0.5  # [1] of the model's slopes, standard deviation of D
SLOPE_DOUBT_LEAST = 0.05  # [1] of the arm's length over a tension's range
SLOPE_FORGOTTEN_S = 2.0  # [s] in which it is as open again
SLOPE_ALIKE_SHARE = 0.15  # [1] of the arm's length, over whose way the slopes stay alike
WANDER = 0.05  # [1] of the way of the tip, by which the offset changes beside the slopes
EXTRAPOLATED_MAX = 0.5  # [1] of the model's slopes, and of the way to there, that slopes may add
ALIKE_SHARE = 0.25  # [1] of the arm's length, over which the model's error stays alike
STEP_SHARE = 0.5  # [1] of what the tip is off, in one step of the goal
NOISE_SAMPLES = 50  # of a standing arm, over which the tracker's noise is averaged
STANDING_SHARE = 0.1  # [1] of `TIP_NOISE_M`, by which the model's tip moves between these
JUMP_NOISES = 3.0  # [1] of the noise: what differs by more is none
REST_DEVIATIONS = 1.5  # [1] of what the offset is known to: a tip that is nearer stays
BISECTIONS, GAIN_MARGIN_MAX = 40, 1e3  # of a margin; [1] larger ones are not looked for


@dataclass(frozen=True)
class Mismatch:
    """
    What the filter knows at tensions `at`: the tip is off by `offset` + `slopes` (T - at).

    All three axes share one covariance, in units of the tracker's variance, of the offset and of
    the slopes over the ranges of the tensions. `noise` [m] is the tracker's, over all axes.
    """

    at: Array  # (m,) [N]
    range: Array  # (m,) [N]
    offset: Array  # (3,) [m]
    slopes: Array  # (3, m) [m] over the ranges
    spread: Array  # (1 + m, 1 + m)
    noise: float = 0.0  # [m]
    samples: int = 0  # from which that is
    left: Array | None = None  # (3,) [m] by which the tip was off the model's last

    @classmethod
    def unknown(cls, at: Array, limits: Array, doubt: Array) -> Mismatch:
        """Begin with nothing known; `doubt` (m,) [m]: see `slope_doubt`."""
        m, width = len(at), limits[:, 1] - limits[:, 0]
        spread = np.diag([FIRST_DOUBT, *(doubt / TIP_NOISE_M) ** 2])
        return cls(at, width, np.zeros(3), np.zeros((3, m)), spread)

    def moved(self, tensions: Array) -> Mismatch:
        """Return the same, about other tensions (m,) [N]."""
        share = (tensions - self.at) / self.range
        step = np.eye(1 + len(share))
        step[0, 1:] = share
        spread = step @ self.spread @ step.T
        offset = self.offset + self.slopes @ share
        return replace(self, at=tensions, offset=offset, spread=spread)

    def learned(
        self,
        left: Array,
        gain: float,
        passed: float,
        doubt: Array,
        way: float = 0.0,
        length: float = np.inf,
    ) -> Mismatch:
        """
        Return what is known after the tip was `left` (3,) [m] away from the model's.

        Parameters
        ----------
        gain : float
            Share of a lasting error that is learned per second while the arm stands [1/s].
        passed : float
            Since the last measurement [s].
        doubt : (m,) [m]
            Of the slopes over the ranges, one standard deviation.
        way : float
            Of the model's tip since the last measurement [m].
        length : float
            Of the arm [m]: what is learned of slopes far away is none of them here.

        """
        share, most = 1.0 - np.exp(-gain * passed), (doubt / TIP_NOISE_M) ** 2
        alike = np.exp(-way / (SLOPE_ALIKE_SHARE * length))
        fades = np.array([1.0, *np.full(len(most), alike)])
        grown = self.spread * np.outer(fades, fades) + np.diag([0.0, *(1.0 - alike**2) * most])
        # so that the standing filter's gain is `share`
        grown[0, 0] += share**2 / (1.0 - share) + (WANDER * way / TIP_NOISE_M) ** 2
        grown[1:, 1:] += np.diag(most) * passed / SLOPE_FORGOTTEN_S
        weights = grown[:, 0] / (grown[0, 0] + 1.0)
        spread = grown - np.outer(weights, grown[0])
        top = np.diag(np.minimum(np.sqrt(most / np.maximum(np.diag(spread)[1:], most)), 1.0))
        spread[1:, 1:] = top @ spread[1:, 1:] @ top  # no more open than at the beginning
        spread[0, 1:] = spread[1:, 0] = spread[0, 1:] @ top
        new = left - self.offset
        slopes = alike * self.slopes + np.outer(new, weights[1:])
        offset = self.offset + weights[0] * new
        noise, samples = self._noise(left, way)
        spread = 0.5 * (spread + spread.T)
        return Mismatch(self.at, self.range, offset, slopes, spread, noise, samples, left)

    def _noise(self, left: Array, way: float) -> tuple[float, int]:
        """Return the tracker's noise [m], and from how many samples of a standing arm it is."""
        if self.left is None or way > STANDING_SHARE * TIP_NOISE_M:
            return self.noise, self.samples
        square, samples = 0.5 * float(((left - self.left) ** 2).sum()), self.samples + 1
        if square > (JUMP_NOISES * max(self.noise, TIP_NOISE_M)) ** 2:
            return self.noise, self.samples
        mean = self.noise**2 + (square - self.noise**2) / min(samples, NOISE_SAMPLES)
        return float(np.sqrt(mean)), samples

    @property
    def rest(self) -> float:
        """How near [m] to its place the tip is as near as the tracker's noise lets anyone know."""
        return REST_DEVIATIONS * self.noise * float(np.sqrt(self.spread[0, 0]))

    def part(self, tensions: Array, way: float) -> float:
        """Return which part [1] of the slopes counts at tensions (m,) [N] a way [m] from here."""
        added = float(np.linalg.norm(self.slopes @ ((tensions - self.at) / self.range)))
        return min(1.0, EXTRAPOLATED_MAX * way / added) if added > 1e-12 else 1.0

    def shift(self, tensions: Array, way: float, length: float) -> Array:
        """Return by how much (3,) [m] the tip is off at tensions (m,) [N] a way [m] from here."""
        added = self.slopes @ ((tensions - self.at) / self.range)
        return np.asarray(self.offset + self.part(tensions, way) * added) * here_counts(
            way, length
        )

    def within(self, slopes: Array) -> Mismatch:
        """Return the same with slopes that are no larger than a part of the model's (3, m) [m]."""
        size = float(np.linalg.norm(self.slopes))
        most = EXTRAPOLATED_MAX * float(np.linalg.norm(slopes))
        return replace(self, slopes=self.slopes * min(1.0, most / max(size, 1e-12)))


def here_counts(way: float, length: float) -> float:
    """Return how much [1] of an error counts a way [m] from where it was seen on an arm [m]."""
    return 1.0 / (1.0 + (way / (ALIKE_SHARE * length)) ** 2)


def slope_doubt(slopes: Array, length: float) -> Array:
    """
    Return how far (m,) [m] the slopes of a model may be off over the ranges of the tensions.

    Parameters
    ----------
    slopes : (3, m) [m]
        The model's, over the ranges.
    length : float
        Of the arm [m].

    """
    sizes = SLOPE_DOUBT * np.linalg.norm(slopes, axis=0)
    return np.asarray(np.maximum(sizes, SLOPE_DOUBT_LEAST * length))


def stability_margins(gain: float, period: float, delay: float) -> tuple[float, float]:
    """
    Return how much more the arm may do than the corrected Jacobian says, and turned how far.

    Of the loop (z - 1 + a)(z - 1 + k) + a k z (g z^-n - 1) = 0 with k = 1 - exp(-gain period), a
    the share of what is left that one step of the goal takes, and n samples of delay that the
    filter does not know of: the largest real g [1], and the largest angle of g = exp(i angle)
    [rad], with which all roots stay inside the unit circle.

    Parameters
    ----------
    gain : float
        `tip_gain` [1/s].
    period : float
        Of the tracker [s].
    delay : float
        Between what is measured and what is heard [s].

    """
    share, samples = 1.0 - np.exp(-gain * period), int(np.ceil(delay / period - 1e-9))

    def stable(more: complex) -> bool:
        product = STEP_SHARE * share
        loop = np.zeros(max(samples, 1) + 2, dtype=complex)
        loop[0], loop[1] = 1.0, STEP_SHARE + share - 2.0 - product
        loop[2] = (1.0 - STEP_SHARE) * (1.0 - share)
        loop[-1 if samples else -2] += product * more
        return bool(np.abs(np.roots(loop)).max() < 1.0)

    def largest(far: float, at: Callable[[float], complex]) -> float:
        low, high = 0.0, far
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if stable(at(middle)) else (low, middle)
        return low

    most = 1.0 + largest(GAIN_MARGIN_MAX, lambda more: 1.0 + more)
    return most, largest(np.pi, lambda angle: complex(np.exp(1j * angle)))
