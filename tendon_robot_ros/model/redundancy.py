"""
What the freedom of antagonistic tendons is used for: a quadratic program after another.

Each program linearises the tip about an equilibrium and weighs what is preferred, over the change
u of the tensions in shares of their range R = high - low:

    min  W/2 |f + J R u|² + sum of weight x preference (quadratic, or its slope)
    s.t. low <= T + R u <= high, |u| <= trust,  d_i + n_i . P_i R u >= 0 near keep-out regions

with f the weighted error of the tip (6,), J its Jacobian, P_i the motion of a point of the arm
that is d_i [m] from a region in direction n_i. A step that does not pay is tried again with half
the trust. Where friction remembers, J is that of the way to which the step lets eyelets slide: the
program says the way, and J the program. What a step in vain did corrects J (Broyden 1965).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..common.errors import NoEquilibriumError
from ..robot.keep_out import KeepOut
from .derivatives import derivatives, take_sides, tip_stiffness, tip_ways
from .program import solved, within
from .tip_task import Preferences, TipTask

if TYPE_CHECKING:
    from .shape import Shape, ShapeBatch

Floats = npt.NDArray[np.float64]
# [1] of the square of the tip's error in lengths of the robot, against preferences of about 1: one
# that asks for a whole range moves the tip by some 1/600 of the length where tendons hardly lead
# it, else by next to nothing; and by how much more counts what is inside a region
TIP_WEIGHT, KEEP_OUT_RATIO = 4e5, 1e3
NEAR_SHARE = 0.25  # of the arm's length: further regions bind no step
POINTS_MAX = 8  # of the arm that are held away from a region at once
TRUST, TRUST_MIN = 0.15, 1e-4  # [1] of a tension's range
STEP_DONE = 3e-5  # [1] of a tension's range: a step that is none
CO_CONTRACTIONS = 0.1, 0.3  # [1] of the range, more on all tendons
DAMPING = 1e-4  # [1] keeps tensions where nothing speaks for a change
SLOPE_SHARE = 2e-3  # [1] of a tension's range, for the slope of the stiffness
CORRECTIONS_MAX, CORRECTED_SHARE = 3, 1e-5  # after a step: how often, from what error on [1] of L
POINT_STEP_M = 1e-6  # [m] for the direction away from a region
# How often a step is looked for anew as eyelets turn; share [1] of them that may do so unseen
TURNS_MAX, TURNED_SHARE = 3, 0.1
LEARNS_WITHIN = 5e-3  # [1] of a range: a longer correction in vain says nothing of slopes here


@dataclass
class Linearised:
    """An equilibrium on the way, and what is known there."""

    shape: Shape
    error: Floats  # (6,) weighted [m]
    past: Floats  # friction memory from which tensions go on, with the side of eyelets at rest
    slopes: Floats | None = None  # (6, m) of the weighted error by shares of the range [m]
    ways: Floats | None = None  # (m, u) of the state by tensions [rad/N]
    preferred: tuple[Floats, Floats] | None = None  # see `Balance._preferred`


@dataclass
class Balance:
    """The programs of one task: what is preferred, and where the arm may not be."""

    task: TipTask
    preferences: Preferences
    keep_out: KeepOut = field(default_factory=KeepOut)
    limits: Floats | None = None  # (m, 2) [N], default: the model's
    here: Floats | None = None  # (m,) [N] where the arm is, for smooth commands
    low: Floats = field(init=False)
    range: Floats = field(init=False)
    weights: Floats = field(init=False)  # (6,) [1], [m] of the tip's error
    tip_weight: float = field(init=False)  # [1/m²] of the square of that error

    def __post_init__(self) -> None:
        """Scale tensions by their range."""
        limits = self.task.model.limits if self.limits is None else self.limits
        self.low, self.range = limits[:, 0], limits[:, 1] - limits[:, 0]
        self.weights = np.repeat(self.task.target[6:], 3)
        self.tip_weight = TIP_WEIGHT / self.task.model.robot.length**2

    def begin(self, shape: Shape) -> Linearised:
        """Look at an equilibrium."""
        return Linearised(shape, self.error(shape), self.task.past)

    def error(self, shape: Shape) -> Floats:
        """Return the weighted error of the tip (6,) [m]."""
        return self.weights * self.task.off(shape)

    def slopes(self, at: Linearised) -> Floats:
        """Return the slopes of the weighted error (6, m) by shares of the range [m]."""
        if at.slopes is None:
            at.slopes, at.ways = self._slopes_after(at.shape, at.past)
        return at.slopes

    def _slopes_after(self, shape: Shape, past: Floats) -> tuple[Floats, Floats]:
        """Return slopes (6, m) of the weighted error, and ways (m, u) of the state [rad/N]."""
        slopes, ways = tip_ways(self.task.model, shape, past)
        return self.weights[:, None] * slopes * self.range, ways

    def cost(self, shape: Shape, error: Floats, stiffness: bool = True) -> float:
        """Return what a posture costs [1]."""
        wants, u = self.preferences, (shape.inputs - self.low) / self.range
        cost = 0.5 * self.tip_weight * float(error @ error)
        cost += 0.5 * wants.low_tension * float(u @ u)
        near, far = np.maximum(wants.margin - u, 0.0), np.maximum(u - 1.0 + wants.margin, 0.0)
        cost += (
            0.5
            * (wants.slack * float(near @ near) + wants.limit * float(far @ far))
            / (wants.margin**2)
        )
        if self.here is not None:
            moved = (shape.inputs - self.here) / self.range
            cost += 0.5 * wants.smooth * float(moved @ moved)
        if self.keep_out:
            inside = np.minimum(self.keep_out.distances(shape.positions), 0.0)
            cost += 0.5 * KEEP_OUT_RATIO * self.tip_weight * float((inside * inside).sum())
        if stiffness and wants.stiffness > 0.0:
            cost -= wants.stiffness * self.log_stiffness(shape)
        return cost

    def log_stiffness(self, shape: Shape) -> float:
        """Return the logarithm of the preferred stiffness of the tip [N/m], at most of enough."""
        wants = self.preferences
        made = tip_stiffness(self.task.model, shape, wants.wires_held)
        towards = np.array(wants.stiffness_direction)
        stiff = made.along(towards) if towards.any() else made.softest[0]
        enough = wants.stiffness_enough or np.inf
        return float(np.log(min(max(stiff, 1e-12), enough)))

    def stiffness_slope(self, shape: Shape) -> Floats:
        """Return how that logarithm follows shares of the range, (m,), by differences."""
        slope = np.zeros(len(self.range))
        base = self.log_stiffness(shape)
        for j, width in enumerate(self.range):
            step = SLOPE_SHARE * width
            if shape.inputs[j] + step > self.low[j] + width:
                step = -step
            moved = shape.inputs.copy()
            moved[j] += step
            try:
                there = self.task.shape(moved, shape.state)
            except NoEquilibriumError:
                continue
            slope[j] = (self.log_stiffness(there) - base) / (step / width)
        return slope

    def quadratic(self, at: Linearised) -> tuple[Floats, Floats]:
        """Return matrix (m, m) and slope (m,) of the cost of a step in shares of the range."""
        if at.preferred is None:
            at.preferred = self._preferred(at)
        slopes, (diagonal, slope) = self.slopes(at), at.preferred
        weighted = self.tip_weight * slopes.T
        matrix = weighted @ slopes
        matrix.ravel()[:: len(slope) + 1] += diagonal
        return matrix, slope + weighted @ at.error

    def _preferred(self, at: Linearised) -> tuple[Floats, Floats]:
        """Return diagonal (m,) and slope (m,) of what is preferred, in shares of the range."""
        wants, u = self.preferences, (at.shape.inputs - self.low) / self.range
        diagonal = np.full(len(u), DAMPING + wants.low_tension + wants.smooth)
        slope = wants.low_tension * u
        if self.here is not None:
            slope = slope + wants.smooth * (at.shape.inputs - self.here) / self.range
        for weight, over in (
            (wants.slack, np.minimum(u - wants.margin, 0.0)),
            (wants.limit, np.maximum(u - 1.0 + wants.margin, 0.0)),
        ):
            if weight > 0.0:
                slope = slope + weight / wants.margin**2 * over
                diagonal = diagonal + weight / wants.margin**2 * (over != 0.0)
        if wants.stiffness > 0.0:
            slope = slope - wants.stiffness * self.stiffness_slope(at.shape)
        return diagonal, slope

    def step(self, at: Linearised, trust: float) -> Floats:
        """
        Return the tensions (m,) [N] of the program about a posture.

        Where friction remembers, slopes are those of the way there: it says to which side each
        eyelet slides, and the slopes on these sides say the way. Where they go to and fro, it runs
        along a kink, and the mean of the slopes on its sides counts.
        """
        tensions = self._program(at, trust)
        for turn in range(TURNS_MAX if self.task.model.remembers else 0):
            if not self._turned(at, tensions, 1.0 / (turn + 1)):
                break
            tensions = self._program(at, trust)
        return tensions

    def _turned(self, at: Linearised, tensions: Floats, share: float) -> bool:
        """Move slopes by a share to those of the way there, if too many eyelets turn on it."""
        model, slopes, ways, past = self.task.model, at.slopes, at.ways, at.past.copy()
        assert slopes is not None and ways is not None
        turned = take_sides(model, at.shape, past, (tensions - at.shape.inputs) @ ways)
        if turned <= TURNED_SHARE * model.arrays.chain.n * model.arrays.chain.k:
            return False
        at.past = past
        new_slopes, new_ways = self._slopes_after(at.shape, past)
        at.slopes = slopes + share * (new_slopes - slopes)
        at.ways = ways + share * (new_ways - ways)
        return True

    def _program(self, at: Linearised, trust: float) -> Floats:
        matrix, slope = self.quadratic(at)
        u = (at.shape.inputs - self.low) / self.range
        upper, lower = np.minimum(1.0 - u, trust), np.maximum(-u, -trust)
        rows, bounds = None, lower
        if self.keep_out:
            rows, room = self._walls(at)
            inside = room > 0.0
            if inside.any():  # there the way out is a matter of cost: all at once may be too much
                out = rows[inside]
                matrix = matrix + KEEP_OUT_RATIO * self.tip_weight * out.T @ out
                slope = slope - KEEP_OUT_RATIO * self.tip_weight * out.T @ room[inside]
            rows, bounds = rows[~inside], np.concatenate([lower, room[~inside]])
        made = solved(matrix, slope, rows, bounds, upper)
        return within(u + made, 0.0, 1.0) * self.range + self.low

    def improve(self, at: Linearised, trust: float) -> tuple[Linearised | None, float]:
        """Make one step that pays; None where none does. Returns the trust of the next one."""
        cost = self.cost(at.shape, at.error)
        while trust > TRUST_MIN:
            tensions = self.step(at, trust)
            size = float(np.abs((tensions - at.shape.inputs) / self.range).max())
            if size < STEP_DONE:
                return None, trust
            looked = self.look(at, tensions)
            if looked is not None:
                costs = [(self.cost(one.shape, one.error), one) for one in self.ways_on(looked)]
                least, made = min(costs, key=lambda one: one[0])
                if least < cost:
                    return made, min(2.0 * trust, TRUST)
                self._learned(at, looked)
            trust = 0.5 * min(trust, size)
        return None, trust

    def _learned(self, at: Linearised, there: Linearised) -> bool:
        """Take from a step in vain what it did, where friction remembers; tell whether it does."""
        if self.task.model.remembers:
            share = (there.shape.inputs - at.shape.inputs) / self.range
            at.slopes = broyden(self.slopes(at), share, there.error - at.error)
        return self.task.model.remembers

    def ways_on(self, looked: Linearised) -> tuple[Linearised, ...]:
        """Return a posture with its tip brought back, and as it is where regions may forbid it."""
        corrected = self.corrected(looked)
        return (corrected, looked) if self.keep_out else (corrected,)

    def corrected(self, at: Linearised) -> Linearised:
        """Bring the tip back to where it should be by least changes, as far as these do."""
        near = CORRECTED_SHARE * self.task.model.robot.length
        for _ in range(CORRECTIONS_MAX):
            if float(at.error @ at.error) < near**2:
                break
            u = (at.shape.inputs - self.low) / self.range
            slopes = self.slopes(at)
            matrix = self.tip_weight * slopes.T @ slopes + DAMPING * np.eye(len(u))
            slope = self.tip_weight * slopes.T @ at.error
            back = solved(matrix, slope, None, -u, 1.0 - u)
            made = self.look(at, within(u + back, 0.0, 1.0) * self.range + self.low)
            if made is not None and made.error @ made.error < at.error @ at.error:
                at = made
            elif made is None or max(abs(back)) > LEARNS_WITHIN or not self._learned(at, made):
                break
        return at

    def look(self, at: Linearised, tensions: Floats) -> Linearised | None:
        """Solve for tensions from a posture; None where there is no equilibrium."""
        try:
            return self.begin(self.task.shape(tensions, at.shape.state))
        except NoEquilibriumError:
            return None

    def _walls(self, at: Linearised) -> tuple[Floats, Floats]:
        """Return rows (r, m) and room (r,) [m]: rows @ step >= room is out; room > 0: inside."""
        model, shape, near = self.task.model, at.shape, NEAR_SHARE * self.task.model.robot.length
        rows: list[Floats] = []
        room: list[float] = []
        away = self.keep_out.distances(shape.positions)
        if away.min() < near:
            past = at.past if model.remembers else None
            moves = derivatives(model, shape.batch, model.inputs, _positions, past)[0]
            for region, far in zip(self.keep_out.regions, away, strict=True):
                nearest = np.argsort(far)[:POINTS_MAX]
                for i in nearest[far[nearest] < near]:
                    normal = _outward(region.solid.distance, shape.positions[i])
                    rows.append(normal @ moves[i] * self.range)
                    room.append(-float(far[i]))
        return np.array(rows).reshape(-1, len(self.range)), np.array(room)


def balanced(
    balance: Balance,
    shape: Shape,
    steps: int,
    give_up: Callable[[], bool] = lambda: False,
    trust: float = TRUST,
) -> Shape:
    """
    Return the best posture after up to so many programs from an equilibrium.

    For a stiff tip also from more tension all over: friction may hold the arm where it is so that
    every small change makes it softer, and a larger one stiffer.
    """
    found = []
    for start in _beginnings(balance, balance.begin(shape)):
        at, width = start, trust
        for _ in range(steps):
            if give_up():
                break
            made, width = balance.improve(at, width)
            if made is None:
                break
            at = made
        found.append((balance.cost(at.shape, at.error), at))
        if give_up():
            break
    return min(found, key=lambda one: one[0])[1].shape


def _beginnings(balance: Balance, at: Linearised) -> Iterator[Linearised]:
    yield at
    if balance.preferences.stiffness > 0.0:
        for share in CO_CONTRACTIONS:
            u = (at.shape.inputs - balance.low) / balance.range
            tensions = balance.low + np.minimum(u * (1.0 + share) + share, 1.0) * balance.range
            if (more := balance.look(at, tensions)) is not None:
                yield balance.corrected(more)


def broyden(slopes: Floats, step: Floats, change: Floats) -> Floats:
    """
    Return slopes (6, m) that agree with what a step (m,) changed (6,), and else change least.

    J + (y - J s) sᵀ / (sᵀ s): Broyden 1965, Math. Comp. 19, 577.
    """
    size = float(step @ step)
    if size < 1e-24:
        return slopes
    return np.asarray(slopes + np.outer(change - slopes @ step, step) / size)


def _outward(distance: Callable[[Floats], Floats], point: Floats) -> Floats:
    """Return the direction (3,) in which a point gets away from a solid, by differences."""
    step = POINT_STEP_M * np.eye(3)
    return np.asarray((distance(point + step) - distance(point - step)) / (2.0 * POINT_STEP_M))


def _positions(batch: ShapeBatch) -> Floats:
    """Return the ends of the cells (b, n, 3) [m]."""
    return batch.positions
