"""A step of the tensions that brings the tip nearer to where it should be."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..model.derivatives import tip_slopes
from ..model.program import STEP_DAMPING, STEP_SHARE, bounded_step
from .remainder import WEAK_SHARE
from .tip_estimator import TipEstimate, bias_share

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Shape
    from ..robot.keep_out import KeepOut

Array = NDArray[np.float64]
SHARES = 1.0, 4.0, 0.25  # [1] of a step: tendons that stick need more, those that slip less
GAINED = 0.1  # [1] of what a step promises, that it must do
SECANTS = 5e-3, 0.05  # [1] of a tension's range: the longer, the more tendons slip


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
        for step in self._steps(there, goal, STEP_SHARE * miss, known):
            for share in SHARES:
                made = goal + share * step
                nearer = float(np.linalg.norm(self._miss(self.there(made), known)))
                nearer /= max(away, 1e-12)
                if nearer < least:
                    best, least = made, nearer
                if nearer < 1.0 - share * STEP_SHARE * GAINED:
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
        share = bias_share(distance, self.model.robot.length)
        learned = share * known.part(there.inputs, distance) * known.slopes
        damping = WEAK_SHARE if self.stands else STEP_DAMPING
        for made in (slopes + learned, slopes):
            yield bounded_step(made, wanted, goal, self.limits, damping) - goal
        m, (low, high) = len(goal), self.limits.T
        room = np.concatenate([high - goal, goal - low])
        both = np.stack([np.zeros(2 * m), np.tile(high - low, 2)], axis=1)
        for share in SECANTS:
            sides = self._secants(there, goal, share)
            step = np.minimum(bounded_step(sides, wanted, np.zeros(2 * m), both), room)
            yield step[:m] - step[m:]
            if share * (wanted @ sides).max() > wanted @ wanted / STEP_SHARE:
                return

    def _secants(self, there: Shape, goal: Array, share: float) -> Array:
        """
        Return how the tip moves (3, 2m) [m] over the ranges, by more and by less of each tension.

        Where tendons pull hard against each other, both may let the arm slip the same way: the
        mean of both slopes then leads nowhere.
        """
        m, (low, high) = len(goal), self.limits.T
        moves = []
        for side in np.concatenate([np.eye(m), -np.eye(m)]) * share:
            to = np.clip(goal + side * (high - low), low, high)
            moves.append(self.there(to).tip_position - there.tip_position)
        return np.array(moves).T / share

    def slopes_at(self, there: Shape) -> Array:
        """Return the model's motion of the tip (3, m) [m] over the ranges at a shape."""
        return _slopes(self.model, there, self.here, self.limits)

    def there(self, goal: Array) -> Shape:
        """Return the shape under a goal (m,) [N] after the one here."""
        return self.model.follow(self.here, np.maximum(goal + self.offset, 0.0))

    def allowed(self, goal: Array, before: Array, keep_out: KeepOut) -> tuple[Array, str]:
        """Return the next goal (m,) [N], or the one before and the region the arm would enter."""
        entered = keep_out and keep_out.clearance(self.there(goal).positions).inside
        return (before, entered) if entered else (goal, '')

    def _distance(self, there: Shape) -> float:
        return float(np.linalg.norm(there.tip_position - self.here.tip_position))

    def _miss(self, there: Shape, known: TipEstimate) -> Array:
        """Return how far (3,) [m] the tip will be from where it is wanted."""
        distance = self._distance(there)
        share = bias_share(distance, self.model.robot.length)
        bias = known.bias_at(there.inputs, distance)
        return np.asarray(self.wanted - there.tip_position - share * bias)


def _slopes(model: Model, shape: Shape, before: Shape, limits: Array) -> Array:
    """Return the motion of the tip (3, m) [m] over the ranges."""
    past = before.memory if model.remembers else model.arrays.fresh_memory()
    return tip_slopes(model, shape, past)[:3] * (limits[:, 1] - limits[:, 0])
