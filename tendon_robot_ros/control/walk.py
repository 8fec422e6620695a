"""
A walk of the tensions that leaves the tip where it is; what the model misses is learned on it.

Along a walk the measured tip is off the model's by d + l s, with s the mean way of the tensions
in shares of their ranges: one leak l [m] for each axis of the tip, far less to learn than a
Jacobian. A Kalman filter (Kalman 1960, J. Basic Eng. 82, 35) learns d and l, and the walk goes as
fast as l is known. No tension turns round on it: friction would stick, and later let go of the arm
all at once. As the walk moves the tip nowhere, the tip can be led anywhere by tensions that only
go on, at different speeds.

At its end the walk goes on holding the tip, so that no other filter takes over with other noise:
the tensions stand until its own, slower now, sees the tip leave, and go on by little. The ordinary
loop has the arm again where that one's filter sees the tip elsewhere than the walk does: a load.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ..model.program import bounded_step

if TYPE_CHECKING:
    from ..model.shape import Reach, Shape
    from .mismatch import Mismatch

Array = NDArray[np.float64]
LEAK_DOUBT = 1.0  # [1] of the arm's length over the ranges, 1 sd
LEAK_ALIKE = 1.0  # [1] of the ranges, over which the leak changes by as much
WANDER = 0.6  # [1] of the way of the model's tip, by which the offset changes beside the leak
NOISE_SAMPLES = 50  # of a standing arm, from which on the tracker's noise is known
NOISE_M, NOISE_LEAST_M = 2e-4, 1e-6  # [m] of the tracker on each axis: until it is; at least
KNOWN_M, KNOWN_NOISES = (
    1.5e-5,
    0.075,
)  # [m]; [1] of that noise: so well the offset is known at first
SPEED_MAX = 0.002  # [1/s] of the ranges
SPEED_FIRST, ALIKE_S = 1e-4, 10.0  # [1/s] of the ranges at first; [s] for the way so far again
DRIFT = 1e-5  # [m/s] by which the tip may leave its place, 1 sd
OFF_M = 2e-4  # [m] from its place: there the walk waits
STEP_SHARE = 0.1  # [1] of what the tip is off, in one step of the goal; the slower, the less
PACE_LEAST = 0.1  # [1] of that share where it stands; else as its speed is to the largest
AHEAD, PROBE = 2e-3, 0.25  # [1] of the ranges, to where slopes are looked at; [1] more of one
CONTROLLED = 0.01  # [1] of the largest slope: the tip is led in directions with at least that
FREE = 0.02  # [1] of the ranges: the step by which tensions that hold the tip are found
FREE_DAMPING = 2e-3  # [1] of the largest slope, for that; see `bounded_step`
DAMPING = 0.02  # [1] of the largest slope, see `bounded_step`
LOOK = 5e-4  # [1] of the ranges, between two looks at whether what was walked is enough
STUCK_S = 3.0  # [s] without a way on, or with the tip off its place: then a walk is over
OVER = 0.01  # [1] of the ranges: nearer to its end a walk is over
HELD_GAIN = 0.5  # [1/s] with which a walk that is over learns that the tip is elsewhere
HELD_DEVIATIONS = 4.0  # [1] of what it knows the offset to: nearer, tensions stand
HELD_MORE = 0.02  # [1] of the ranges, by which tensions go on to hold the tip
ELSEWHERE = 3.0  # [1] of where the ordinary loop rests: so far both filters differ by a load only


class Ahead(Protocol):
    """Where the arm is and should be, as the model sees it, and what goals lead to."""

    @property
    def here(self) -> Shape:
        """Where the arm is."""

    @property
    def wanted(self) -> Array:
        """Where the tip should be (3,) [m]."""

    @property
    def limits(self) -> Array:
        """Of the tensions (m, 2) [N]."""

    def there(self, goal: Array, before: Shape | None = None) -> Shape:
        """Return the shape under a goal (m,) [N] after another one; default: the one here."""


@dataclass(frozen=True)
class Led:
    """Where a walk leads, and whether a shape on the way is as good as its end."""

    solution: Reach  # for the target at which the tip is to stay
    tensions: Array  # (m,) [N]
    enough: Callable[[Shape], bool] = lambda shape: False


@dataclass(frozen=True)
class Leak:
    """What is known of how the tip leaves the model along a walk; axes share one covariance."""

    way: float  # [1] that the tensions have gone, mean share of their ranges
    offset: Array  # (3,) [m]
    slope: Array  # (3,) [m] over the ranges
    spread: Array  # (2, 2) [m²] of both

    def learned(self, way: float, left: Array, noise: float, length: float, moved: float) -> Leak:
        """
        Return what is known after the tip was `left` (3,) [m] away from the model's.

        Parameters
        ----------
        way : float
            That the tensions have gone when this was seen [1].
        noise : float
            Of the tracker on one axis [m].
        length : float
            Of the arm [m].
        moved : float
            Way of the model's tip since the last measurement [m].

        """
        on = way - self.way
        step = np.array([[1.0, on], [0.0, 1.0]])
        grown = step @ self.spread @ step.T
        doubts = (WANDER * moved) ** 2, (LEAK_DOUBT * length) ** 2 * abs(on) / LEAK_ALIKE
        grown += np.diag(doubts)
        gain = grown[:, 0] / (grown[0, 0] + noise**2)
        new = left - self.offset - self.slope * on
        spread = grown - np.outer(gain, grown[0])
        offset = self.offset + self.slope * on + gain[0] * new
        slope = self.slope + gain[1] * new
        return Leak(way, offset, slope, 0.5 * (spread + spread.T))

    def sure(self) -> Array:
        """Return the leak (3,) [m] by which tensions are led: the less, the less it is known."""
        square = float(self.slope @ self.slope)
        return self.slope * (square / (square + 3.0 * float(self.spread[1, 1])))

    def speed(self) -> float:
        """Return how fast [1/s] the walk may go by what is known of the leak."""
        most = min(SPEED_MAX, SPEED_FIRST + max(self.way, 0.0) / ALIKE_S)
        return min(most, DRIFT / float(np.sqrt(self.spread[1, 1])))


@dataclass(frozen=True)
class Walk:
    """A walk of the tensions from where they are to where they are preferred."""

    led: Led
    ways: Array  # (m,) 1: a tension that rises, -1: that falls
    begin: Array  # (m,) [N]
    range: Array  # (m,) [N]
    leak: Leak
    held: Array  # (3,) [m] from where the tip is wanted, that it was off when the walk began
    heading: Array | None = None  # (m,) [1] of the last step; None: the offset is not yet known
    end: Array | None = None  # (m,) [N] where it was over: there the tip is held
    looked: float = -1.0  # [1] that it had gone when it last looked whether that is enough
    stuck: float = 0.0  # [s] for which there has been no way on
    left: bool = False  # to the ordinary loop

    def way(self, tensions: Array) -> float:
        """Return how far [1] tensions (m,) [N] are on the walk."""
        return float(self.ways @ ((tensions - self.begin) / self.range)) / len(self.ways)

    def learned(
        self,
        tensions: Array,
        left: Array,
        known: Mismatch,
        length: float,
        moved: float,
        passed: float,
    ) -> Walk:
        """Return what is known after a measurement at tensions (m,) [N]; see `Leak.learned`."""
        noise, leak = _noise(known), self.leak
        if self.end is not None:  # so that the standing filter's gain is `share`
            share = 1.0 - float(np.exp(-HELD_GAIN * passed))
            doubt = np.diag([noise**2 * share**2 / (1.0 - share), 0.0])
            leak = replace(leak, spread=leak.spread + doubt)
        leak = leak.learned(self.way(tensions), left, noise, length, moved)
        apart = float(np.linalg.norm(known.offset - leak.offset))
        return replace(self, leak=leak, left=apart > ELSEWHERE * max(known.rest, OFF_M))

    def step(
        self, ahead: Ahead, goal: Array, known: Mismatch, passed: float
    ) -> tuple[Walk, Array]:
        """
        Return the walk and the next goal (m,) [N] on it.

        Parameters
        ----------
        ahead : Ahead
        goal : (m,) [N]
            The last one.
        known : Mismatch
            What the filter of the loop knows: its noise, and how near the tip may rest.
        passed : float
            Since the last step [s].

        """
        there = ahead.there(goal)
        moves, curve = self._slopes(ahead, there, goal)
        axes, sizes, _ = np.linalg.svd(moves, full_matrices=False)
        axes = axes[:, sizes > CONTROLLED * sizes[0]].T  # (a, 3) in which tendons lead the tip
        slopes = axes @ (moves + np.outer(self.leak.sure(), self.ways) / len(goal))
        off = ahead.wanted - ahead.here.tip_position - self.leak.offset
        free = self._free(slopes, goal, ahead.limits)
        longest = float(np.abs(free).max())
        walk = self._started(off, free / max(longest, 1e-12), known)
        away = float(np.linalg.norm(axes @ (off - walk.held)))
        goes = longest > OVER and (walk.heading is None or away < OFF_M)
        walk = replace(walk, stuck=0.0 if goes else walk.stuck + passed)
        way = walk.way(goal)
        look = way - walk.looked > LOOK
        walk = replace(walk, looked=way if look else walk.looked)
        if self.end is None and (walk._over(goal) or (look and self.led.enough(ahead.here))):
            return replace(walk, end=goal, left=walk.heading is None), goal
        if walk.heading is None or away < walk._rest:
            return walk, goal
        near = max(0.0, 1.0 - away / OFF_M) if self.end is None else 0.0
        speed = near * walk.leak.speed()
        share = min(1.0, speed * passed / max(longest, OVER))
        ahead_by = walk.leak.slope * (walk.way(there.inputs) - walk.leak.way)
        miss = ahead.wanted - walk.held - there.tip_position - walk.leak.offset - ahead_by
        pace = 1.0 if self.end is not None else max(PACE_LEAST, speed / SPEED_MAX)
        wanted = axes @ (pace * STEP_SHARE * miss - curve * share * longest)
        on = share * free
        made = bounded_step(slopes, wanted, goal, ahead.limits, DAMPING, on, walk.ways)
        return walk, self._near_end(made)

    def _over(self, goal: Array) -> bool:
        """Tell whether the walk is at its end, or has had no way on for long."""
        return bool(self._left(goal).max() < OVER) or self.stuck > STUCK_S

    def _left(self, goal: Array) -> Array:
        """Return how far (m,) [1] each tension still is from where it is led."""
        return np.maximum(self.ways * (self.led.tensions - goal) / self.range, 0.0)

    def _near_end(self, tensions: Array) -> Array:
        """Return tensions (m,) [N] no further than they may go to hold the tip."""
        if self.end is None:
            return tensions
        more = HELD_MORE * self.range
        return np.asarray(np.clip(tensions, self.end - more, self.end + more))

    @property
    def _rest(self) -> float:
        """How near [m] to its place a tip is held that is led no more; 0 on the walk."""
        doubt = float(np.sqrt(self.leak.spread[0, 0]))
        return 0.0 if self.end is None else HELD_DEVIATIONS * doubt

    def _free(self, slopes: Array, goal: Array, limits: Array) -> Array:
        """Return how far (m,) [1] each tension may go on where slopes (a, m) [m] hold the tip."""
        wish = self._left(goal)
        scale = FREE / max(float(wish.max()), FREE)
        first, still = scale * self.ways * wish, np.zeros(len(slopes))
        made = bounded_step(slopes, still, goal, limits, FREE_DAMPING, first, self.ways)
        return np.asarray((made - goal) / self.range / scale)

    def _started(self, off: Array, heading: Array, known: Mismatch) -> Walk:
        """Return the walk with its heading, once the offset is known; the tip is held there."""
        if self.end is not None:
            return self
        if self.heading is None:
            enough = max(KNOWN_M, KNOWN_NOISES * _noise(known))
            if self.leak.spread[0, 0] > enough**2:
                return self
            size = max(float(np.linalg.norm(off)), 1e-12)
            return replace(self, heading=heading, held=off * min(1.0, known.rest / size))
        return replace(self, heading=heading)

    def _slopes(self, ahead: Ahead, there: Shape, goal: Array) -> tuple[Array, Array]:
        """
        Return the motion of the tip (3, m) [m] over the ranges, by a little more of each tension.

        And by how much (3,) [m] over the ranges the tip moves otherwise on the walk itself.
        Seen a little further on the walk, where tendons slide: of tendons that stick they differ.
        """
        low, high = ahead.limits.T
        heading = self.ways if self.heading is None else self.heading

        def tip(more: Array) -> Array:
            to = np.clip(goal + AHEAD * (heading + more) * self.range, low, high)
            return ahead.there(to, there).tip_position

        base = tip(np.zeros(len(goal)))
        moves = [tip(PROBE * one) - base for one in np.diag(self.ways)]
        slopes = self.ways * np.array(moves).T / (AHEAD * PROBE)
        return slopes, (base - there.tip_position) / AHEAD - slopes @ heading


def begun(
    walk: Walk | None, led: Led, goal: Array, known: Mismatch, tensions: Array, length: float
) -> Walk:
    """
    Return a walk, or a new one if it leads elsewhere.

    Parameters
    ----------
    walk : Walk or None
        The last one.
    led : Led
        Where it leads.
    goal : (m,) [N]
        Where it begins.
    known : Mismatch
        What the filter of the loop knows.
    tensions : (m,) [N]
        That act.
    length : float
        Of the arm [m].

    """
    if walk is not None and walk.led is led:
        return walk
    doubt = _noise(known) * float(np.sqrt(known.spread[0, 0]))
    spread = np.diag([doubt**2, (LEAK_DOUBT * length) ** 2])
    leak = Leak(0.0, known.offset, np.zeros(3), spread)
    ways = np.where(led.tensions >= goal, 1.0, -1.0)
    return Walk(led, ways, tensions, known.range, leak, np.zeros(3))


def _noise(known: Mismatch) -> float:
    """Return the tracker's noise on one axis [m]."""
    if known.samples < NOISE_SAMPLES:
        return NOISE_M
    return max(known.noise / float(np.sqrt(3.0)), NOISE_LEAST_M)
