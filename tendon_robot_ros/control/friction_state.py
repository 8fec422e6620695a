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

Array = NDArray[np.float64]
APPROACHES = 'any', 'from_below'
NOISES = 4.0  # [1] standard deviations of a measured tension that say nothing
HELD_NOISES = 6.0  # [1] the same while the correction is held: beyond 4 is one of 16,000
NOISE_SHARES = 2e-4, 1e-2  # [1] of the highest tension: least and largest noise
NOISE_SAMPLES, MEAN_SAMPLES = 50.0, 100.0  # over which noise and what differs are averaged
CYCLES_LATE = 2.0  # by which a measured tension may be behind a command on the move
OVER_BANDS = 80.0  # [1] of the friction band, by which the bend of `from_below` moves wires
BAND_SHARE = 0.036  # [1] of the largest radius: the friction band where nobody knows it
OVER_MAX_RAD = 4.0  # [rad] of bend, for that
OVER_LEAST, OVER_RUNGS = 0.005, 24  # [1] of a tension's range; sizes that are tried
CARRIED_ROUNDS, CARRIED_OFF = 40, 1e-3  # until directions stay, and by how much of full friction
NEAR_SHARE = 0.004  # [1] of the range: tensions that have followed, but for the end of a lag
NEAR_S, NEAR_TIMEOUT_S = 0.1, 0.5  # [s] of being near, or of waiting for it, before a way turns


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

    def take(
        self, command: Array, measured: Array | None, highest: Array, held: bool = False
    ) -> Array:
        """
        Return the tensions that act; the correction stays until noise cannot explain it.

        Parameters
        ----------
        command : (m,) [N]
        measured : (m,) [N] or None
        highest : (m,) [N]
            Upper limits.
        held : bool
            The correction stays where a mean differs, and until one reading is far off: somebody
            learns what it leaves over, and would take its changes for motions of the arm.

        """
        bias = np.zeros_like(command) if self.bias is None else self.bias
        if measured is not None:
            before = command if self._last is None else self._last[0]
            width = NOISES * self._noise(command, measured, highest)
            width = width + CYCLES_LATE * np.abs(command - before)
            differs = measured - command
            mean = differs if self._mean is None else self._mean
            self._mean = mean = mean + (differs - mean) / MEAN_SAMPLES
            narrow = width / np.sqrt(8.0 * MEAN_SAMPLES)  # two deviations of the mean
            if held:
                width = width * HELD_NOISES / NOISES
            else:
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


@dataclass
class Arrival:
    """
    Whether the arm has come to a turn of its way.

    How far tendons were let go decides where friction begins to turn round: a way that turns
    while the drive still follows turns elsewhere every time.
    """

    _command: Array | None = None  # (m,) [N]
    _since: float = -np.inf  # [s] when it was commanded
    _near: float = -np.inf  # [s] when the tensions came near

    def over(self, now: float, command: Array, measured: Array, width: Array) -> bool:
        """Tell whether measured tensions (m,) [N] have followed; `width` (m,) [N]: the ranges."""
        if self._command is None or not np.array_equal(command, self._command):
            self._command, self._since, self._near = command.copy(), now, now
        if np.any(np.abs(measured - command) >= NEAR_SHARE * width):
            self._near = now
        return now - self._near >= NEAR_S or now - self._since > NEAR_TIMEOUT_S


def carried(model: Model, before: Model, last: Shape | None, tensions: Array) -> Shape | None:
    """
    Return the shape in which friction is as another model had it; None: nothing is known of it.

    The arm has not moved, only what is believed of it: the directions in which tendons were last
    dragged stay. The travel from which they go on is that of the new model there, until which
    they are set back: taken from the other one, all tendons would have slipped by the difference.

    Parameters
    ----------
    model, before : Model
        The one that comes, and the one that was.
    last : Shape or None
        As `before` had it.
    tensions : (m,) [N]
        That act now.

    """
    same = last is not None and (last.form.n, last.form.k) == (model.form.n, model.form.k)
    if last is None or not same or not (model.remembers and before.remembers):
        return None
    signs = slice(len(last.state), len(last.state) + last.tendon_tensions.size)
    directions, memory, shape = last.memory[signs].copy(), last.memory, last
    try:
        for _ in range(CARRIED_ROUNDS):
            shape = model.shape(tensions, shape.state, memory)
            if np.abs(shape.memory[signs] - directions).max() < CARRIED_OFF:
                break
            memory = shape.memory.copy()
            memory[signs] = directions
    except NoEquilibriumError:
        return None
    return shape


@dataclass(frozen=True)
class Approach:
    """Tensions for a target, and the tensions (v, m) [N] on the way there."""

    reach: Reach
    via: Array


def straight(direct: Reach) -> Approach:
    """Return the way that is none."""
    return Approach(direct, np.empty((0, len(direct.tensions))))


def forgotten(
    model: Model, here: Shape, direct: Reach, solve: Callable[[Shape], Reach]
) -> Approach:
    """
    Return the way to a target on which friction forgets first, from where the arm is.

    Parameters
    ----------
    model : Model
    here : Shape
        Where the arm is, with what friction remembers.
    direct : Reach
        Tensions for the target, in a straight line from there: what is left where there is no
        equilibrium on the way.
    solve : callable
        From a shape to tensions for the target that are right from there.

    """
    via = forgetting(model)
    try:
        for tensions in via:
            here = model.follow(here, tensions)
        return Approach(solve(here), via)
    except NoEquilibriumError:
        return straight(direct)


def from_below(model: Model, direct: Reach) -> Approach:
    """Return the way by which friction forgets; nothing is solved anew."""
    return Approach(direct, forgetting(model))


def forgetting(model: Model) -> Array:
    """
    Return tensions (2, m) [N] after which friction knows nothing of what was before.

    The tendons on one side pull until the whole arm bends there, then all are at their lowest: at
    every eyelet every tendon has slipped that way and back, whatever its law of slip. The bend is
    as large as takes the wire nearest to the middle often through its friction band. The side is
    that of the tendon for which all others slip most.
    """
    side, least = _side(model)
    (low, high), radius = model.limits.T, max(float(np.hypot(*t.end)) for t in model.robot.tendons)
    band = BAND_SHARE * radius
    if model.remembers:
        band = float(model.arrays.get('friction_memory', 'presliding_length', None))
    wanted, width = min(OVER_BANDS * band / least, OVER_MAX_RAD), float((high - low).max())
    shape = straight = model.shape(low)
    for more in np.geomspace(OVER_LEAST * width, width, OVER_RUNGS):
        try:
            shape = model.shape(np.clip(low + more * side, low, high), shape.state)
        except NoEquilibriumError:
            break
        if np.linalg.norm(shape.bend - straight.bend, axis=1).sum() >= wanted:
            break
    return np.array([shape.inputs, low])


def _side(model: Model) -> tuple[Array, float]:
    """Return the share (m,) by which inputs pull to one side, and the least arm [m] of a wire."""
    ends = np.array([tendon.end for tendon in model.robot.tendons])
    arms = [ends @ (end / np.hypot(*end)) for end in ends if np.hypot(*end) > 0.0]
    along = max(arms, key=lambda arm: float(np.abs(arm).min()))
    pulls = np.array([along[list(members)].mean() for members in model.robot.input_tendons])
    return np.maximum(pulls, 0.0) / np.abs(along).max(), float(np.abs(along).min())
