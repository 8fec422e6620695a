"""
A string from the arm to a fixed point, fitted where the arm answers linearly to its pull.

Its pull turns with the posture; far away it is a constant force. Pulls (P, 3) [N] of P postures
act on one place of the arm, `at` (P, 3) [m].
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from ..common.arrays import Floats
from ..common.estimation import gauss_newton
from ..inference.fitter import BEST_FEW
from ..model.derivatives import DIFFERENCE_STEP

# [1] arm lengths over the distance, from which fits start, because far ones are all alike
CLOSENESS = (0.5, 1.0, 2.0, 4.0)
# [1] growth of the pull over an arm length, from which fits start, so that a weight over a pulley,
# a long spring and a stretched string are all near one of them
STIFFENING = (0.0, 2.0, 8.0)
CLOSENESS_MIN = 1e-3  # [1] because a point a thousand arms away is no place
CLOSENESS_MAX = 20.0  # [1] because the place moves by more than a twentieth of the arm
STIFFENING_MAX = 100.0  # [1] because a stretch of a hundredth of the arm is as good as none
SETTLING_STEPS = 6  # [1] because each step of Newton's method doubles the digits


@dataclass(frozen=True)
class Tether:
    """A string that pulls at one place of the arm, or hangs slack."""

    force: Floats  # (3,) [N] where the place is at the centre
    closeness: float  # [1/m] inverse of the distance from there to the fixed point
    stiffening: float  # [1/m] growth of the pull with the length, over the pull there
    centre: Floats  # (3,) [m]

    @property
    def fixed_point(self) -> Floats:
        """Where it is fixed (3,) [m]."""
        return self.centre + self.force / (np.linalg.norm(self.force) * self.closeness)

    def effect(self, arc_length: float) -> dict[str, float]:
        """Return what the effect `tether` says of it, tied at an arc length [m]."""
        size, distance = float(np.linalg.norm(self.force)), 1.0 / self.closeness
        values = dict(
            zip(('point_x', 'point_y', 'point_z'), self.fixed_point.tolist(), strict=True)
        )
        values['arc_length'] = arc_length
        if self.stiffening == 0.0:
            return values | {'tension': size}
        values['stiffness'] = size * self.stiffening
        if self.stiffening * distance > 1.0:
            return values | {'slack_length': distance - 1.0 / self.stiffening}
        return values | {'tension': size * (1.0 - self.stiffening * distance)}

    def pulls(self, at: Floats) -> tuple[Floats, Floats]:
        """Return the pulls (P, 3) and their slopes (P, 3, 3) [N/m] by the place."""
        size = max(float(np.linalg.norm(self.force)), 1e-300)
        along, off = self.force / size, at - self.centre
        way = along - self.closeness * off  # over the distance from the centre
        length = np.maximum(np.linalg.norm(way, axis=1), 1e-9)
        way = way / length[:, None]
        longer = (self.closeness * (off * off).sum(axis=1) - 2.0 * off @ along) / (length + 1.0)
        pull = size * np.maximum(1.0 + self.stiffening * longer, 0.0)
        outer = way[:, :, None] * way[:, None, :]
        turning = (pull * self.closeness / length)[:, None, None] * (np.eye(3) - outer)
        stretching = np.where(pull > 0.0, size * self.stiffening, 0.0)[:, None, None] * outer
        return pull[:, None] * way, -turning - stretching

    def settled(self, arm: Answer) -> Floats:
        """Return the pulls at which the arm comes to rest (Newton's method)."""
        at = arm.at
        for _ in range(SETTLING_STEPS):
            pulls, slopes = self.pulls(at)
            off = arm.at + np.einsum('pij,pj->pi', arm.give, pulls - arm.held) - at
            at = at + np.linalg.solve(np.eye(3) - arm.give @ slopes, off[..., None])[..., 0]
        return self.pulls(at)[0]


@dataclass(frozen=True)
class Answer:
    """How an arm under pulls, and what is left of its measurements, answers to other pulls."""

    held: Floats  # (P, 3) [N] the pulls
    at: Floats  # (P, 3) [m] the place under them
    give: Floats  # (P, 3, 3) [m/N] of that place
    left: Floats  # (N,) whitened residual
    columns: Floats  # (N, 3 P) [1/N] its derivative


@dataclass(frozen=True)
class FittedTether:
    """The likeliest string."""

    tether: Tether
    pulls: Floats  # (P, 3) [N]
    chi2: float
    parameters: int  # beyond those of a constant force: closeness, and stiffening if any

    @property
    def score(self) -> float:
        """Chi² plus twice the number of parameters."""
        return self.chi2 + 2.0 * self.parameters


def fit_tether(arm: Answer, unit: float, length: float) -> FittedTether:
    """Fit a string to an arm of a `length` [m]; a usual force is a `unit` [N]."""
    root, triangle = np.linalg.qr(arm.columns)
    left = root.T @ arm.left
    beyond = float(arm.left @ arm.left - left @ left)
    centre = arm.at.mean(axis=0)

    def tether(values: Floats) -> Tether:
        return Tether(unit * values[:3], values[3] / length, values[4] / length, centre)

    def residual_of(values: Floats) -> tuple[Floats, float]:
        pulls = tether(values).settled(arm)
        residual = left + triangle @ (pulls - arm.held).ravel()
        return residual, float(residual @ residual)

    high = np.array([30.0, 30.0, 30.0, CLOSENESS_MAX, STIFFENING_MAX])
    low, force = np.array([-30.0, -30.0, -30.0, CLOSENESS_MIN, 0.0]), arm.held.mean(axis=0) / unit
    fits = []
    for stiffenings in (STIFFENING[:1], STIFFENING[1:]):
        free = np.array([1.0, 1.0, 1.0, 1.0, stiffenings[0] > 0.0])

        def linearised(
            values: Floats, residual: Floats, free: Floats = free
        ) -> tuple[Floats, Floats]:
            moved = [
                residual_of(values + DIFFERENCE_STEP * one)[0] - residual for one in np.diag(free)
            ]
            slopes = np.array(moved).T / DIFFERENCE_STEP
            return slopes.T @ slopes, -slopes.T @ residual

        starts = [np.append(force, start) for start in product(CLOSENESS, stiffenings)]
        starts.sort(key=lambda start: residual_of(start)[1])
        for start in starts[:BEST_FEW]:
            fitted = gauss_newton(start, 1e-6 * np.eye(5), residual_of, linearised, (low, high))
            if fitted is not None:
                found = tether(fitted[0])
                count = int(free.sum()) - len(force)
                fits.append(FittedTether(found, found.settled(arm), beyond + fitted[2], count))
    return min(fits, key=lambda fit: fit.score)
