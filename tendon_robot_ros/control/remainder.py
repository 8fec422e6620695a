"""What the closed loop leaves between the measured tip and its target, and why, in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from .tip_estimator import TipEstimate

Array = NDArray[np.float64]
SETTLED_S = 1.0  # [s] for which the tip has come no nearer: five times the loop's 0.2 s
CHANGED_SHARE = 0.2  # [1] of what was left, and `LEAST_M` at least: by less it has not changed
WEAK_SHARE = 0.02  # [1] of the largest slope: below it the loop's steps are lost in friction
CAUSE_SHARE = 0.7  # [1] of what is left: half of its square has one cause
RESTS, LEAST_M = 2.0, 3e-4  # [1] of where the loop rests; [m] what trackers of this size resolve
LIMIT_SHARE = 1e-3  # [1] of a range: nearer to it a tension is at its limit
FOREIGN_SHARE = 0.05  # [1] of the arm's length: a calibrated model is nearer to its arm


@dataclass(frozen=True)
class Remainder:
    """
    What is left where the tip is.

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

    @classmethod
    def at(
        cls, off: Array, slopes: Array, goal: Array, limits: Array, known: TipEstimate, region: str
    ) -> Remainder:
        """Look at a goal (m,) [N] where the model's tip is `off` (3,) [m] from the target."""
        low, high = limits.T
        room = np.array([goal - low, high - goal]) / (high - low)
        return cls(off - known.bias, slopes, room, known.rest, region)

    @property
    def away(self) -> float:
        """How far [m] the tip is from its target."""
        return float(np.linalg.norm(self.off))

    @property
    def none(self) -> bool:
        """Whether the tip is as near as the tracker tells."""
        return self.away <= max(RESTS * self.rest, LEAST_M)

    def why(self, inputs: Sequence[str]) -> str:
        """Say what keeps the tip away, of tendons with names; '' where nothing is known to."""
        if self.region:
            return f'kept out of {self.region}'
        axes, sizes, _ = np.linalg.svd(self.slopes, full_matrices=False)
        parts, weak = axes.T @ self.off, sizes < WEAK_SHARE * sizes[0]
        if np.linalg.norm(parts[weak]) > CAUSE_SHARE * self.away:
            return _weak(axes[:, weak] @ parts[weak], float(sizes[weak].max()))
        strong, far = axes[:, ~weak].T @ self.slopes, parts[~weak]
        stopped = self.room < LIMIT_SHARE
        found = lsq_linear(
            strong, far, (np.where(stopped[0], 0.0, -1e3), np.where(stopped[1], 0.0, 1e3))
        )
        left = far - strong @ found.x
        if np.linalg.norm(left) < CAUSE_SHARE * self.away:
            return ''
        more = strong.T @ left > 0.0  # of that tension the tip would come nearer
        at = np.where(more, stopped[1], stopped[0])
        names = (name for name, ended in zip(inputs, at, strict=True) if ended)
        return f'at its limit: {", ".join(names)}'


@dataclass
class LeftOver:
    """What is left of the distance to one target, and for how long that has not changed."""

    target: object = None
    remainder: Remainder | None = None
    nearest: float = np.inf  # [m]
    since: float = np.inf  # [s]

    def take(self, now: float, target: object, remainder: Remainder) -> None:
        """Take what is left now; a new target begins anew."""
        away, before = remainder.away, self.nearest
        changed = abs(away - before) > max(CHANGED_SHARE * before, LEAST_M)
        if target is not self.target or changed:
            self.nearest, self.since = away, now
        self.target, self.remainder = target, remainder

    def settled(self, now: float) -> Remainder | None:
        """Return what is left once that does not change."""
        return self.remainder if now - self.since >= SETTLED_S else None


def _weak(part: Array, size: float) -> str:
    """Say that tendons hardly move the tip along what is left of it (3,) [m]."""
    along = ', '.join(f'{x:.2f}' for x in (part / np.linalg.norm(part)).round(2) + 0.0)
    return (
        f'{1e3 * np.linalg.norm(part):.2f} mm of it along ({along}), where the tendons lead the '
        f'tip by {1e3 * size:.2f} mm over their whole range'
    )


def foreign(offset: float, length: float, remembers: bool) -> str:
    """
    Say what to do about a model that is off [m] its arm of a length [m]; '' where it is near.

    Parameters
    ----------
    offset, length : float
    remembers : bool
        Whether friction remembers in the model.

    """
    if offset < FOREIGN_SHARE * length:
        return ''
    lacks = '' if remembers else ', often friction_memory'
    return (
        f'the model is {1e3 * offset:.0f} mm off the arm here: a load, or an effect that it '
        f'lacks{lacks}; diagnose tells which'
    )
