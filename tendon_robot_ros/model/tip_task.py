"""The target of the tip, the cost of its tensions and the time that a search may take."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..common.errors import InputError, number, refusal, short
from ..robot import Robot
from ..robot.inputs import finite
from ..robot.keep_out import KeepOut
from .program import RANGE_TOLERANCE

if TYPE_CHECKING:
    from .forward import ForwardModel
    from .shape import Shape

# [1] weight of ln of what is left of the tensions' range, beside ln of the error that is left: 1 /
# (1 + D²) with D a half, so that a tension grows evenly until the error that no tension takes away
# is half of what it takes away (docs/model.md)
TENSION_PRICE = 0.8
# [1] lengths of the arm from its base; farther is another unit, because millimetres would be a
# thousand times as far; all tips so far off cost the same
UNIT_LENGTHS = 10.0
# [1] of the length: nearer, a search has converged, 1.4 µm on 208 mm, else rounding would say what
# is reached
CONVERGED_LENGTH = 7e-6
# [1] weight of tensions above their lowest: so little that it only decides between tensions with
# the same tip; more would leave the tip beside its place (docs/model.md)
LOW_TENSION_WEIGHT = 4e-5


def cost_of(distance: float) -> float:
    """Return the cost [m²] of a tip at a distance [m] from its target: half of its square."""
    return 0.5 * distance * distance


def limits_by_pulls(model: ForwardModel) -> Floats:
    """Return tension limits (m, 2) [N] of wires that may be slack."""
    return model.limits * [0.0, 1.0]


class Patience:
    """A time budget: calling it returns True once it is over; another thread may end it early."""

    def __init__(self, budget: float = math.inf) -> None:
        """Start the clock; `budget` [s]."""
        self._began = time.monotonic()
        self.until: npt.NDArray[np.float64] = np.array([self._began + budget])  # (1,) [s]

    def __call__(self) -> bool:
        """Whether time is over."""
        return time.monotonic() > float(self.until[0])

    def begin(self) -> None:
        """Restart the clock: a search that had to wait has its whole budget."""
        self.prolong(time.monotonic() - self._began)

    def prolong(self, more: float) -> None:
        """Add time [s]; a budget that was ended stays ended."""
        self.until += more

    def end(self) -> None:
        """End the budget now."""
        self.until[0] = -math.inf


@dataclass(frozen=True)
class Preferences:
    """Preferences among tensions with the same tip position; weights [1]."""

    low_tension: float = 0.03
    stiffness: float = 0.0  # of the tip, along `stiffness_direction`
    stiffness_direction: tuple[float, float, float] = (0.0, 0.0, 0.0)  # zeros: the softest
    stiffness_enough: float = 0.0  # [N/m] beyond which nothing is gained; 0: there is no such
    slack: float = 0.0  # distance from the lowest tension
    limit: float = 0.0  # distance from the highest tension
    smooth: float = 0.0  # little change from where the arm is
    margin: float = 0.1  # [1] of the range: the distance that `slack` and `limit` want

    def __post_init__(self) -> None:
        """Refuse weights and margins out of their ranges."""
        for name in ('low_tension', 'stiffness', 'slack', 'limit', 'smooth'):
            number(name, getattr(self, name), 0.0, 1e3)
        if not 0.0 <= self.stiffness_enough < np.inf:
            raise refusal('stiffness_enough', '0 N/m or more', self.stiffness_enough)
        if not 0.0 < self.margin <= 0.5:
            raise refusal('margin', 'more than 0 and at most 0.5', self.margin)


@dataclass(frozen=True)
class Policy:
    """
    How many starts a search tries, and what tension costs beside the tip's error.

    Weights are relative to the robot: 1 is its length over the mean range of its tensions
    (`TipTask.per_newton`), so that a robot of another size or stiffness is searched alike.

    Attributes
    ----------
    starts : int
        Starts all over the workspace that may be tried; 0: only near the guess.
    relax : bool
        From a solution, go on to one of low tension. Without a guess that is always done.
    tension_weight : float
        Of tensions above their lowest [1].
    change_weight : float
        Of the change from the tensions of the guess [1], where tendons stick: such a change takes
        time. A solution that jumps does not end the search then, and none is relaxed.

    """

    starts: int = 24
    relax: bool = False
    tension_weight: float = LOW_TENSION_WEIGHT
    change_weight: float = 0.0

    @property
    def frugal(self) -> bool:
        """Whether tension costs more than what decides between equal tips."""
        return self.tension_weight > LOW_TENSION_WEIGHT


# A target that has nothing to do with where the arm is
COLD = Policy(relax=True)
# [1] A motion that goes on from the guess, as a twist: from elsewhere the tensions would jump
TRACK = Policy(starts=0)
# [1] Targets that follow each other closely: weights so that newtons of all tendons against each
# other are not spent on tenths of a millimetre where tendons hardly lead the tip (docs/model.md)
STREAM = Policy(starts=12, relax=True, tension_weight=0.02, change_weight=0.06)


@dataclass(frozen=True)
class TipTask:
    """
    The target of the tip, the present shape and the keep-out regions of a search.

    Attributes
    ----------
    model : ForwardModel
    target : (8,)
        Position [m], direction, weight of the position [1], of the direction [m/rad]; see `at`.
    past : (k,)
        Friction memory from which the tensions are reached, along a straight line.
    guess : Shape, optional
        The present shape: a search starts there and looks elsewhere only if it must.
    by_pulls : bool
        Only tensions that wire lengths can hold; the lower limit is 0.
    preferences : Preferences, optional
        What the freedom that the target leaves is used for; default: low tension.
    keep_out : KeepOut
        Regions that no part of the arm may enter.
    patience : Patience
        Ends a search between its steps.

    """

    model: ForwardModel
    target: Floats
    past: Floats
    guess: Shape | None = None
    by_pulls: bool = False
    preferences: Preferences | None = None
    keep_out: KeepOut = field(default_factory=KeepOut)
    patience: Patience = field(default_factory=Patience)

    @classmethod
    def at(
        cls,
        model: ForwardModel,
        position: npt.ArrayLike | None,
        direction: npt.ArrayLike | None = None,
        direction_weight: float | None = None,
        memory: Floats | None = None,
    ) -> TipTask:
        """
        Return the task of a tip position (3,) [m], an approach direction (3,), or both.

        Parameters
        ----------
        direction : (3,), optional
            Its length and the roll about it are ignored.
        direction_weight : float [m/rad], optional
            Default: a fifth of the robot's length.
        memory : optional
            Friction memory where the arm is (`Shape.memory`); default: straight and free of
            tension.

        Raises
        ------
        InputError
            Neither position nor direction, or not finite.

        """
        if position is None and direction is None:
            raise InputError('target: expected a position, a direction, or both, got neither')
        target = np.zeros(8)
        if position is not None:
            target[:3], target[6] = finite('position', position, 3), 1.0
        if direction is not None:
            along = finite('direction', direction, 3)
            size = math.sqrt(along @ along)
            if size < 1e-9:
                raise InputError(f'direction: expected a vector of some length, got {along}')
            weight = 0.2 * model.robot.length if direction_weight is None else direction_weight
            target[3:6], target[7] = along / size, weight
        return cls(model, target, model.arrays.fresh_memory() if memory is None else memory)

    @property
    def limits(self) -> Floats:
        """Limits of the tensions (m, 2) [N] in the search."""
        return limits_by_pulls(self.model) if self.by_pulls else self.model.limits

    @property
    def per_newton(self) -> float:
        """Length of the robot over the mean range of its tensions [m/N]."""
        return self.model.robot.length / self._range

    @property
    def _range(self) -> float:
        """Return the mean range of the tensions [N]."""
        low, high = self.model.limits.T
        return float((high - low).mean())

    def tension(self, weight: float, priced: bool = False) -> tuple[float, ...]:
        """
        Return the cost of tension as `aim` of the kernel takes it.

        A weight [1] in units of `per_newton` and, if `priced`, the price of `worth`.
        """
        room, price = self._range * len(self.model.inputs), TENSION_PRICE if priced else 0.0
        length = self.model.robot.length
        converged = cost_of(CONVERGED_LENGTH * length)
        return weight * self.per_newton, price, length, room, RANGE_TOLERANCE, converged

    def above_lowest(self, weight: float, inputs: Floats) -> float:
        """Return the cost [m²] of tensions (m,) [N] above their lowest, with a weight [1]."""
        above = inputs - self.model.limits[:, 0]
        return 0.5 * (weight * self.per_newton) ** 2 * float(above @ above)

    def worth(self, cost: float, inputs: Floats) -> float:
        """
        Return a cost [m²] of the remaining error e with the price of tensions (m,) [N].

        It grows with ln e - `TENSION_PRICE` x ln(1 - t), with the mean fraction t of the tensions
        in their range: how far a target is beyond reach does not make tension cheap. Beyond a
        length of the robot e itself counts, in lengths.
        """
        used = float((inputs - self.model.limits[:, 0]).mean()) / self._range
        length = self.model.robot.length
        lengths = math.sqrt(2.0 * cost) / length
        size = lengths if lengths < 1.0 else math.exp(min(lengths - 1.0, UNIT_LENGTHS))
        room = math.pow(max(1.0 - used, RANGE_TOLERANCE), TENSION_PRICE)
        return 0.5 * (length * size / room) ** 2

    def held_at(self, shape: Shape) -> TipTask:
        """Return the task whose target is the tip of a shape, for targets beyond reach."""
        return replace(self, target=np.concatenate([shape.tip, self.target[6:]]))

    def shape(self, inputs: Floats, state: Floats) -> Shape:
        """Return the shape under tensions (m,) [N] that follow the past."""
        return self.model.shape(inputs, state, self.past)

    def tip_error(self, shape: Shape) -> Floats:
        """Return the error (6,) of tip position [m] and direction against the target."""
        return shape.tip - self.target[:6]

    def cost(self, shape: Shape) -> float:
        """Return half the square of the weighted tip error [m²], as the kernel's searches do."""
        error = np.repeat(self.target[6:], 3) * self.tip_error(shape)
        return 0.5 * float(error @ error)

    def errors(self, shape: Shape) -> tuple[float, float]:
        """Return the errors of tip position [m] and direction [rad]; 0 where none is requested."""
        x, y, z, bx, by, bz, weight, direction_weight = self.target.tolist()
        position = math.dist(shape.tip_position.tolist(), (x, y, z)) if weight else 0.0
        if not direction_weight:
            return position, 0.0
        ax, ay, az = shape.tip_direction.tolist()
        across = math.hypot(ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)
        return position, math.atan2(across, ax * bx + ay * by + az * bz)


def refuse_other_unit(robot: Robot, position: npt.ArrayLike | None) -> None:
    """Refuse a position (3,) [m] so far from the base that its unit must be another one."""
    if position is None:
        return
    values = finite('position', position, 3)
    distance = float(np.linalg.norm(values))
    if distance > UNIT_LENGTHS * robot.length:
        mm = 1e-3 * distance <= UNIT_LENGTHS * robot.length
        hint = '; if these are mm, divide by 1000' if mm else ''
        raise InputError(
            f'position: expected metres, got {short(values.tolist())}, {distance:.4g} m from the '
            f'base of an arm of {robot.length:.4g} m{hint}'
        )
