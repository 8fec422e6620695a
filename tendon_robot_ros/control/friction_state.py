"""
The state of friction, and ways on which it ends where it helps.

The state follows the commands as they are sent; what is measured corrects them where it differs
by more than noise. Noise itself must not move it: tendons that are shaken forget.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..common.errors import NoEquilibriumError

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Reach, Shape
    from .solver import GiveUp

Array = NDArray[np.float64]
Solve = Callable[['Shape', Array], 'Reach']
APPROACHES = 'any', 'from_below', 'model'
NOISES = 4.0  # [1] standard deviations of a measured tension that say nothing
NOISE_SHARES = 2e-4, 1e-2  # [1] of the highest tension: least and largest noise
NOISE_SAMPLES, MEAN_SAMPLES = 50.0, 100.0  # over which noise and what differs are averaged
RELEASE_SHARE = 0.3  # [1] of a tension above the lowest, that `from_below` pulls at last
RELEASES = 0.1, 0.3, -0.1  # [1] tried by `model`; negative: the last leg lets go
OVERSHOOT_MAX = 0.1  # [1] of the step of the tip, on a way that `model` chooses
FORGOTTEN = 0.0, -1.0  # [1] what friction might be instead, of the state that is
AS_GOOD_M = 2e-4  # [m] by which a way must be surer than the direct one
LOOKS = 4  # at the tip on every leg


@dataclass
class FeltTensions:
    """Tensions (m,) [N] that act: as commanded, corrected where the measured ones differ."""

    bias: Array | None = None
    _last: tuple[Array, Array] | None = None  # commanded, measured
    _variance: Array | None = None  # (m,) [N²] of what is measured beside what is asked
    _mean: Array | None = None  # (m,) [N] by which the measured ones differ
    _followed: tuple[float, Array] | None = None  # [s], (m,) [N]

    def sent(self, now: float, command: Array, lag: float) -> None:
        """Take a command (m,) [N] to a drive that follows with a lag [s] of first order."""
        if lag == 0.0 or self._followed is None:
            self._followed = now, command
            return
        before, followed = self._followed
        share = 1.0 - np.exp(-max(now - before, 0.0) / lag)
        self._followed = now, followed + share * (command - followed)

    def followed(self, command: Array) -> Array:
        """Return what (m,) [N] the drive has followed by now, of what was sent."""
        return command if self._followed is None else self._followed[1]

    def begin(self) -> None:
        """Forget what was sent: the arm is where it is measured."""
        self._followed = None

    def take(self, command: Array, measured: Array | None, highest: Array) -> Array:
        """
        Return the tensions that act; the correction stays until noise cannot explain it.

        Parameters
        ----------
        command : (m,) [N]
        measured : (m,) [N] or None
        highest : (m,) [N]
            Upper limits.

        """
        bias = np.zeros_like(command) if self.bias is None else self.bias
        if measured is not None:
            width = NOISES * self._noise(command, measured, highest)
            differs = measured - command
            mean = differs if self._mean is None else self._mean
            self._mean = mean = mean + (differs - mean) / MEAN_SAMPLES
            narrow = width / np.sqrt(8.0 * MEAN_SAMPLES)  # two deviations of the mean
            bias = np.clip(bias, mean - narrow, mean + narrow)
            bias = np.clip(bias, differs - width, differs + width)
        self.bias = bias
        return np.asarray(np.maximum(command + bias, 0.0))

    def _noise(self, command: Array, measured: Array, highest: Array) -> Array:
        """Return the noise (m,) [N], from how what is measured changes beside the command."""
        least, most = (share * highest for share in NOISE_SHARES)
        before, self._last = self._last, (command.copy(), measured.copy())
        if self._variance is None:
            self._variance = least**2
        if before is not None and not np.array_equal(measured, before[1]):
            seen = 0.5 * (measured - before[1] - (command - before[0])) ** 2
            seen = np.minimum(seen, NOISES**2 * self._variance)  # a jump is no noise
            self._variance = self._variance + (seen - self._variance) / NOISE_SAMPLES
        return np.clip(np.sqrt(self._variance), least, most)


@dataclass(frozen=True)
class Approach:
    """Tensions for a target, and the tensions (v, m) [N] on the way there."""

    reach: Reach
    via: Array


def straight(direct: Reach) -> Approach:
    """Return the way that is none."""
    return Approach(direct, np.empty((0, len(direct.tensions))))


def planned(
    model: Model, here: Shape, direct: Reach, kind: str, solve: Solve, give_up: GiveUp
) -> Approach:
    """
    Return the way to a target on which friction ends where it is wanted.

    Parameters
    ----------
    model : Model
    here : Shape
        Where the arm is, with what friction remembers.
    direct : Reach
        Tensions for the target, in a straight line from there.
    kind : str
        One of `APPROACHES`: straight; with all tensions rising at last; or that of some ways on
        which what friction was before matters least.
    solve : callable
        From a shape and tensions (m,) [N] to begin with to tensions for the target.
    give_up : callable
        Whether there is no more time.

    """
    best = straight(direct)
    if kind == 'from_below':
        return _released(model, here, direct, RELEASE_SHARE, solve) or best
    if kind == 'any' or not model.remembers:
        return best
    least = _doubt(model, here, best) - AS_GOOD_M
    for share in RELEASES:
        if give_up() or least < 0.0:
            break
        made = _released(model, here, direct, share, solve)
        if made is None or made.reach.status != direct.status:
            continue
        if _overshoot(model, here, made) > OVERSHOOT_MAX:
            continue
        doubt = _doubt(model, here, made)
        if doubt < least:
            best, least = made, doubt
    return best


def from_below(model: Model, direct: Reach, share: float = RELEASE_SHARE) -> Approach:
    """Return the way that lets go of a share of the tensions first; nothing is solved anew."""
    low, high = model.limits.T
    via = np.clip(low + (1.0 - share) * (direct.tensions - low), low, high)
    return Approach(direct, via[None])


def _released(
    model: Model, here: Shape, direct: Reach, share: float, solve: Solve
) -> Approach | None:
    """Return the way that comes from tensions lower by a share, and tensions right from there."""
    via = from_below(model, direct, share).via
    try:
        return Approach(solve(model.follow(here, via[0]), direct.tensions), via)
    except NoEquilibriumError:
        return None


def _doubt(model: Model, here: Shape, way: Approach) -> float:
    """Return how far [m] the tip would be off, were friction not where it is believed to be."""
    signs = slice(len(here.state), len(here.state) + here.tendon_tensions.size)
    worst = 0.0
    for share in FORGOTTEN:
        memory = here.memory.copy()
        memory[signs] *= share
        try:
            shape = None
            for tensions in (*way.via, way.reach.tensions):
                state, past = (
                    (here.state, memory) if shape is None else (shape.state, shape.memory)
                )
                shape = model.shape(tensions, state, past)
        except NoEquilibriumError:
            return np.inf
        assert shape is not None
        off = np.linalg.norm(shape.tip_position - way.reach.shape.tip_position)
        worst = max(worst, float(off))
    return worst


def _overshoot(model: Model, here: Shape, way: Approach) -> float:
    """Return by which share of its step the tip goes beyond the target, or back, on the way."""
    end = way.reach.shape.tip_position
    step = end - here.tip_position
    size = float(np.linalg.norm(step))
    if size < AS_GOOD_M:
        return np.inf
    shape, beyond = here, 0.0
    for tensions in (*way.via, way.reach.tensions):
        begin = shape.inputs
        for look in range(LOOKS):
            shape = model.follow(shape, begin + (look + 1.0) / LOOKS * (tensions - begin))
            along = float((shape.tip_position - here.tip_position) @ step) / size**2
            beyond = max(beyond, along - 1.0, -along)
    return beyond
