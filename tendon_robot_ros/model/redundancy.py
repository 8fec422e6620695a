"""
Null-space motion of antagonistic tendons: a sequence of quadratic programs.

Each program linearises the tip about an equilibrium and weighs the preferences, over the change
u of the tensions in fractions of their range R = high - low:

    min  W/2 |f + J R u|² + sum of weight x preference (quadratic, or its slope)
    s.t. low <= T + R u <= high, |u| <= trust,  d_i + n_i . P_i R u >= 0 near keep-out regions

with f the weighted error of the tip (6,), J its Jacobian, P_i the motion of a point of the arm
that is d_i [m] from a region in direction n_i. A step that does not lower the cost is repeated
with half the trust. Where friction remembers, J depends on the side to which each eyelet slides
next, and that on the step: both are iterated. A rejected step corrects J (Broyden 1965).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ..common.arrays import Floats
from ..common.errors import NoEquilibriumError
from ..robot.keep_out import KeepOut
from .derivatives import DIFFERENCE_STEP, derivatives, take_sides, tip_slopes, tip_stiffness
from .program import RANGE_TOLERANCE, solved, within
from .tip_task import CONVERGED_LENGTH, Preferences, TipTask

if TYPE_CHECKING:
    from .shape import Shape

# [1] weight of the square of the tip's error in lengths of the robot, against preferences of about
# 1, so that one that asks for a whole range moves the tip by 1/600 of the length at most
TIP_WEIGHT = 4e5
KEEP_OUT_RATIO = 1e3  # [1] of that weight, of points inside a region, so that no target keeps them
NEAR_LENGTH = 0.25  # [1] of the length, so that only regions near the arm take time
TRUST = 0.15  # [1] of a tension's range, the longest step, because slopes change beyond
# [1] of a range: shorter steps would change less than a motor's resolution; also the damping,
# beside preferences of about 1, so that tensions stay without any
STEP_MIN = 1e-4
# [1] of a range, more on all tendons: further starts for a stiff tip, because friction may hold
# the arm so that every small change makes it softer
CO_CONTRACTIONS = (0.1, 0.3)
# [1] of the tip after a step, because its error is squared by each, and of a step with the sides
# of its eyelets, because it then runs along a kink
CORRECTIONS_MAX = 3


@dataclass
class Linearised:
    """An equilibrium with its tip error and, once computed, its derivatives."""

    shape: Shape
    error: Floats  # (6,) weighted [m]
    past: Floats  # friction memory from which tensions change, with the side of eyelets at rest
    slopes: Floats | None = None  # (6, m) of the weighted error by fractions of the range [m]
    state_slopes: Floats | None = None  # (m, u) of the state by tensions [rad/N]
    preferred: tuple[Floats, Floats] | None = None  # see `Balance._preferred`


@dataclass
class Balance:
    """The quadratic programs of one task: preferences and keep-out regions."""

    task: TipTask
    preferences: Preferences
    keep_out: KeepOut = field(default_factory=KeepOut)
    present: Floats | None = None  # (m,) [N] tensions of the arm now, for smooth commands
    low: Floats = field(init=False)
    range: Floats = field(init=False)
    weights: Floats = field(init=False)  # (6,) [1], [m] of the tip's error
    tip_weight: float = field(init=False)  # [1/m²] of the square of that error

    def __post_init__(self) -> None:
        """Scale tensions by their range."""
        limits = self.task.limits
        self.low, self.range = limits[:, 0], limits[:, 1] - limits[:, 0]
        self.weights = np.repeat(self.task.target[6:], 3)
        self.tip_weight = TIP_WEIGHT / self.task.model.robot.length**2

    def begin(self, shape: Shape) -> Linearised:
        """Return an equilibrium with its error."""
        return Linearised(shape, self.error(shape), self.task.past)

    def error(self, shape: Shape) -> Floats:
        """Return the weighted error of the tip (6,) [m]."""
        return self.weights * self.task.tip_error(shape)

    def slopes(self, at: Linearised) -> Floats:
        """Return the slopes of the weighted error (6, m) by fractions of the range [m]."""
        if at.slopes is None:
            at.slopes, at.state_slopes = self._slopes_after(at.shape, at.past)
        return at.slopes

    def _slopes_after(self, shape: Shape, past: Floats) -> tuple[Floats, Floats]:
        """Return slopes (6, m) of the weighted error, and (m, u) of the state [rad/N]."""
        slopes, state_slopes = tip_slopes(self.task.model, shape, past)
        return self.weights[:, None] * slopes * self.range, state_slopes

    def cost(self, shape: Shape, error: Floats) -> float:
        """Return the cost [1] of a posture: error, preferences and penetration of regions."""
        weights, distances = self._squares(shape.inputs)
        cost = self.tip_weight * float(error @ error) + float(weights @ (distances**2).sum(axis=1))
        if self.keep_out:
            inside = np.minimum(self.keep_out.distances(shape.positions), 0.0)
            cost += KEEP_OUT_RATIO * self.tip_weight * float((inside * inside).sum())
        cost *= 0.5
        if self.preferences.stiffness > 0.0:
            cost -= self.preferences.stiffness * self.log_stiffness(shape)
        return cost

    def log_stiffness(self, shape: Shape) -> float:
        """Return ln of the tip's stiffness [N/m] as preferred, at most of `stiffness_enough`."""
        preferences = self.preferences
        compliance = tip_stiffness(self.task.model, shape)
        towards = np.array(preferences.stiffness_direction)
        stiffness = compliance.along(towards) if towards.any() else compliance.softest[0]
        enough = preferences.stiffness_enough or np.inf
        return float(np.log(min(max(stiffness, 1e-12), enough)))

    def stiffness_slope(self, at: Linearised) -> Floats:
        """Return the slopes (m,) of that logarithm by fractions of the range, by differences."""
        slope, shape = np.zeros(len(self.range)), at.shape
        base = self.log_stiffness(shape)
        # shorter steps would be noise: stiffness is a difference itself
        for j, step in enumerate(np.diag(RANGE_TOLERANCE * self.range)):
            if (shifted := self.solve_at(at, shape.inputs + step)) is not None:
                slope[j] = (self.log_stiffness(shifted.shape) - base) / RANGE_TOLERANCE
        return slope

    def quadratic(self, at: Linearised) -> tuple[Floats, Floats]:
        """Return matrix (m, m) and slope (m,) of the cost of a step in fractions of the range."""
        if at.preferred is None:
            at.preferred = self._preferred(at)
        slopes, (diagonal, slope) = self.slopes(at), at.preferred
        weighted = self.tip_weight * slopes.T
        return weighted @ slopes + np.diag(diagonal), slope + weighted @ at.error

    def _preferred(self, at: Linearised) -> tuple[Floats, Floats]:
        """Return diagonal (m,) and slope (m,) of the preferences, in fractions of the range."""
        preferences, (weights, distances) = self.preferences, self._squares(at.shape.inputs)
        counts = distances != 0.0
        counts[:2] = True  # low tension and little change count everywhere
        diagonal, slope = STEP_MIN + weights @ counts, weights @ distances
        if preferences.stiffness > 0.0:
            slope = slope - preferences.stiffness * self.stiffness_slope(at)
        return diagonal, slope

    def _squares(self, inputs: Floats) -> tuple[Floats, Floats]:
        """
        Return weights (4,) and distances (4, m) [1] of the range from what is preferred.

        Each of low tension, little change, slack and limit costs half its weight times the square
        of its distances.
        """
        wants, u = self.preferences, (inputs - self.low) / self.range
        moved = np.zeros(len(u)) if self.present is None else (inputs - self.present) / self.range
        under, over = np.minimum(u - wants.margin, 0.0), np.maximum(u - 1.0 + wants.margin, 0.0)
        within_margin = np.array([wants.slack, wants.limit]) / wants.margin**2
        weights = np.array([wants.low_tension, wants.smooth, *within_margin])
        return weights, np.array([u, moved, under, over])

    def step(self, at: Linearised, trust: float) -> Floats:
        """
        Return the tensions (m,) [N] of the program about a posture.

        Where friction remembers, slopes are those of the sides to which eyelets slide on this
        step: both are iterated. Where sides alternate, the step runs along a kink, and the mean of
        the slopes on its sides counts.
        """
        tensions, model = self._program(at, trust), self.task.model
        for count in range(CORRECTIONS_MAX if model.remembers else 0):
            assert at.slopes is not None and at.state_slopes is not None
            past, fraction = at.past.copy(), 1.0 / (count + 1)
            step = (tensions - at.shape.inputs) @ at.state_slopes
            changed = take_sides(model, at.shape, past, step)
            if not changed:
                break
            at.past = past
            slopes, state_slopes = self._slopes_after(at.shape, past)
            at.slopes = at.slopes + fraction * (slopes - at.slopes)
            at.state_slopes = at.state_slopes + fraction * (state_slopes - at.state_slopes)
            tensions = self._program(at, trust)
        return tensions

    def _program(self, at: Linearised, trust: float) -> Floats:
        matrix, slope = self.quadratic(at)
        u = (at.shape.inputs - self.low) / self.range
        upper, lower = np.minimum(1.0 - u, trust), np.maximum(-u, -trust)
        rows, bounds = None, lower
        if self.keep_out:
            rows, room = self._walls(at)
            inside = room > 0.0
            if inside.any():  # a cost, no constraint: one step may be too short to get out
                out = rows[inside]
                matrix = matrix + KEEP_OUT_RATIO * self.tip_weight * out.T @ out
                slope = slope - KEEP_OUT_RATIO * self.tip_weight * out.T @ room[inside]
            rows, bounds = rows[~inside], np.concatenate([lower, room[~inside]])
        step = solved(matrix, slope, rows, bounds, upper)
        return within(u + step, 0.0, 1.0) * self.range + self.low

    def improve(self, at: Linearised, trust: float) -> tuple[Linearised | None, float]:
        """Step to a lower cost, or None; also return the trust of the next step."""
        cost = self.cost(at.shape, at.error)
        while trust > STEP_MIN:
            tensions = self.step(at, trust)
            size = float(np.abs((tensions - at.shape.inputs) / self.range).max())
            if size < STEP_MIN:
                return None, trust
            trial = self.solve_at(at, tensions)
            if trial is not None:
                # with the tip corrected, and also without where regions may forbid that
                corrected = self.corrected(trial)
                ends = (corrected, trial) if self.keep_out else (corrected,)
                costs = [self.cost(end.shape, end.error) for end in ends]
                if min(costs) < cost:
                    return ends[int(np.argmin(costs))], min(2.0 * trust, TRUST)
                self._learn(at, trial)
            trust = 0.5 * min(trust, size)
        return None, trust

    def _learn(self, at: Linearised, trial: Linearised) -> bool:
        """Correct slopes by a rejected step where friction remembers; return whether it does."""
        if self.task.model.remembers:
            step = (trial.shape.inputs - at.shape.inputs) / self.range
            at.slopes = broyden(self.slopes(at), step, trial.error - at.error)
        return self.task.model.remembers

    def corrected(self, at: Linearised) -> Linearised:
        """Reduce the error of the tip by minimum changes of tension, as far as possible."""
        near = CONVERGED_LENGTH * self.task.model.robot.length
        for _ in range(CORRECTIONS_MAX):
            if float(at.error @ at.error) < near**2:
                break
            u = (at.shape.inputs - self.low) / self.range
            slopes = self.slopes(at)
            matrix = self.tip_weight * slopes.T @ slopes + STEP_MIN * np.eye(len(u))
            slope = self.tip_weight * slopes.T @ at.error
            back = solved(matrix, slope, None, -u, 1.0 - u)
            trial = self.solve_at(at, within(u + back, 0.0, 1.0) * self.range + self.low)
            if trial is not None and trial.error @ trial.error < at.error @ at.error:
                at = trial
            elif trial is None or not self._learn(at, trial):
                break
        return at

    def solve_at(self, at: Linearised, tensions: Floats) -> Linearised | None:
        """Solve for tensions from a posture; None where there is no equilibrium."""
        try:
            return self.begin(self.task.shape(tensions, at.shape.state))
        except NoEquilibriumError:
            return None

    def _walls(self, at: Linearised) -> tuple[Floats, Floats]:
        """Return rows (r, m) and room (r,) [m]: rows @ step >= room is outside, room > 0 in."""
        model, shape = self.task.model, at.shape
        distances = self.keep_out.distances(shape.positions)
        near = distances < NEAR_LENGTH * model.robot.length
        rows, room = [np.empty((0, len(self.range)))], [np.empty(0)]
        if near.any():
            past = at.past if model.remembers else None
            moves = derivatives(model, shape.batch, model.inputs, lambda b: b.positions, past)[0]
            for region, far, close in zip(self.keep_out.regions, distances, near, strict=True):
                points, distance = shape.positions[close], region.solid.distance
                steps = DIFFERENCE_STEP * np.eye(3)  # [m]
                sides = [distance(points + step) - distance(points - step) for step in steps]
                normals = np.stack(sides, axis=-1) / (2.0 * DIFFERENCE_STEP)
                rows.append(np.einsum('pc,pcm->pm', normals, moves[close]) * self.range)
                room.append(-far[close])
        return np.concatenate(rows), np.concatenate(room)


def balanced(
    balance: Balance, shape: Shape, steps: int, give_up: Callable[[], bool] = lambda: False
) -> Shape:
    """
    Return the posture of lowest cost after up to so many programs from an equilibrium.

    For a stiff tip the programs also start from more tension on all tendons: friction may hold
    the arm so that every small change makes it softer, and only a larger one stiffer.
    """
    ends = []
    for start in _starts(balance, balance.begin(shape)):
        at, trust = start, TRUST
        for _ in range(steps):
            if give_up():
                break
            improved, trust = balance.improve(at, trust)
            if improved is None:
                break
            at = improved
        ends.append((balance.cost(at.shape, at.error), at))
        if give_up():
            break
    return min(ends, key=lambda one: one[0])[1].shape


def _starts(balance: Balance, at: Linearised) -> Iterator[Linearised]:
    yield at
    if balance.preferences.stiffness > 0.0:
        for fraction in CO_CONTRACTIONS:
            u = (at.shape.inputs - balance.low) / balance.range
            u = np.minimum(u * (1.0 + fraction) + fraction, 1.0)
            tensions = balance.low + u * balance.range
            if (more := balance.solve_at(at, tensions)) is not None:
                yield balance.corrected(more)


def broyden(slopes: Floats, step: Floats, change: Floats) -> Floats:
    """
    Return slopes (6, m), minimally changed to predict the change (6,) of a step (m,).

    J + (y - J s) sᵀ / (sᵀ s): Broyden 1965, Math. Comp. 19, 577.
    """
    size = float(step @ step)
    if size < 1e-24:
        return slopes
    return np.asarray(slopes + np.outer(change - slopes @ step, step) / size)
