"""
The state of friction, and approaches to a target on which it ends where it helps.

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
NOISE_SD_MAX = 4.0  # [1] standard deviations: of noise alone, one reading of 16,000 is beyond
NOISE_SHARES = 2e-4, 1e-2  # [1] of the highest tension: resolution and noise of poor load cells
NOISE_SAMPLES, MEAN_SAMPLES = 50.0, 100.0  # over which noise and offset are averaged, at 200 Hz
CYCLES_LATE = 2.0  # by which a measured tension may lag behind its command: bus and driver
BEND_SLIPS = 80.0  # [1] presliding lengths of the wire nearest to the middle: each law forgets
PRESLIDING_SHARE = 0.036  # [1] of the largest radius: that length where nobody knows it
BEND_MAX_RAD = 4.0  # [rad] of the whole arm; more would wind it up
BENDS = np.geomspace(0.005, 1.0, 24)  # [1] of a tension's range, tried until that bend
CARRIED_ROUNDS, CARRIED_OFF = 40, 1e-3  # until directions stay to 1/1000 of full friction
SETTLED_SHARE = 0.004  # [1] of the range: tensions that have followed, but for the end of a lag
SETTLED_S, SETTLED_TIMEOUT_S = 0.1, 0.5  # [s] five lags of a drive; [s] a drive that never settles


@dataclass
class ActingTensions:
    """Tensions (m,) [N] that act: as commanded, corrected where the measured ones differ."""

    offset: Array | None = None  # (m,) [N] beyond the command
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
        offset = np.zeros_like(command) if self.offset is None else self.offset
        if measured is not None:
            before = command if self._last is None else self._last[0]
            width = NOISE_SD_MAX * self._noise(command, measured, highest)
            width = width + CYCLES_LATE * np.abs(command - before)
            differs = measured - command
            mean = differs if self._mean is None else self._mean
            self._mean = mean = mean + (differs - mean) / MEAN_SAMPLES
            narrow = width / np.sqrt(8.0 * MEAN_SAMPLES)  # two deviations of the mean
            offset = np.clip(offset, mean - narrow, mean + narrow)
            offset = np.clip(offset, differs - width, differs + width)
        self.offset = offset
        return np.asarray(np.maximum(command + offset, 0.0))

    def _noise(self, command: Array, measured: Array, highest: Array) -> Array:
        """Return the noise (m,) [N], from how what is measured changes beside the command."""
        least, most = (share * highest for share in NOISE_SHARES)
        before, self._last = self._last, (command.copy(), measured.copy())
        if self._variance is None:
            self._variance = least**2
        if before is not None and not np.array_equal(measured, before[1]):
            seen = 0.5 * (measured - before[1] - (command - before[0])) ** 2
            seen = np.minimum(seen, NOISE_SD_MAX**2 * self._variance)  # a jump is no noise
            self._variance = self._variance + (seen - self._variance) / NOISE_SAMPLES
        return np.clip(np.sqrt(self._variance), least, most)


@dataclass
class Settling:
    """
    Whether the tensions have settled at a command, so that the next one may be sent.

    How far tendons were unloaded decides where friction reverses: an approach that reverses while
    the drive still follows does so elsewhere every time.
    """

    _command: Array | None = None  # (m,) [N]
    _since: float = -np.inf  # [s] when it was commanded
    _near: float = -np.inf  # [s] since when the tensions are near

    def settled(self, now: float, command: Array, measured: Array, width: Array) -> bool:
        """Tell whether measured tensions (m,) [N] have settled; `width` (m,) [N]: the ranges."""
        if self._command is None or not np.array_equal(command, self._command):
            self._command, self._since, self._near = command.copy(), now, now
        if np.any(np.abs(measured - command) >= SETTLED_SHARE * width):
            self._near = now
        return now - self._near >= SETTLED_S or now - self._since > SETTLED_TIMEOUT_S


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

    @classmethod
    def straight(cls, direct: Reach) -> Approach:
        """Go straight to tensions."""
        return cls(direct, np.empty((0, len(direct.tensions))))


def forgotten(
    model: Model, here: Shape, direct: Reach, solve: Callable[[Shape], Reach]
) -> Approach:
    """
    Return the approach to a target on which friction forgets first, from where the arm is.

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
        return Approach.straight(direct)


def forgetting(model: Model) -> Array:
    """
    Return tensions (2, m) [N] after which friction knows nothing of what was before.

    The tendons on one side pull until the whole arm bends there, then all are at their lowest: at
    every eyelet every tendon has slipped there and back, whatever its law of slip. The bend takes
    the wire nearest to the middle many presliding lengths through its eyelets. The side is that
    of the tendon for which all others slip most.
    """
    side, least = _side(model)
    (low, high), radius = model.limits.T, max(float(np.hypot(*t.end)) for t in model.robot.tendons)
    length = PRESLIDING_SHARE * radius
    if model.remembers:
        length = float(model.arrays.get('friction_memory', 'presliding_length', None))
    wanted, width = min(BEND_SLIPS * length / least, BEND_MAX_RAD), float((high - low).max())
    shape = straight = model.shape(low)
    for more in width * BENDS:
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
