"""
The state of the driver: measurements, lag, silence, stops and releases.

After a release nothing moves without a new command: the driver follows no commands until it is
requested to resume, which the controller does when a new target, trajectory or twist arrives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError, NoEquilibriumError
from ..model.program import bounded_least_squares
from .checks import Refusal
from .state import Settings, Target, Trajectory, Twist

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Shape

Array = NDArray[np.float64]
GO_ON = 'send another target or call reset'
# [s] of silence of driver or tracker, beyond which it counts as lost; a busy machine delays it by
# less, else every such pause would drop the arm
SILENCE_MAX_S = 1.0
# [1] standard deviations; one reading of 16,000 is beyond by chance
NOISE_SD_MAX = 4.0
# [1] of the highest tension: the resolution of load cells, so that a constant reading does not
# count as free of noise
NOISE_MIN = 2e-4
# [1] of the highest tension: noise of poor load cells; more would be a real error of the tension
NOISE_MAX = 1e-2
# [1] readings over which noise is averaged, of load cells and trackers: so that it is known to
# 10 %; the mean offset is over twice as many
NOISE_SAMPLES = 50
# [1] cycles by which a measured tension may lag behind its command, because of bus and driver
CYCLES_LATE = 2.0
# [1] of the range: tolerance of settled tensions, because a lag leaves exp(-5.5) of the range
# after 5.5 time constants
SETTLED_RANGE = 0.004
# [s] within that tolerance: five time constants of a drive of 20 ms, so that noise alone does not
# pass for settled
SETTLED_S = 0.1


@dataclass
class MeasuredState:
    """Tensions (m,) [N] and wire pulls (m,) [m] as measured, nan where not observable."""

    tensions: Array
    pulls: Array
    time: float  # monotonic [s]

    @property
    def observed(self) -> bool:
        """Whether every tension is observable."""
        return bool(np.all(np.isfinite(self.tensions)))

    @property
    def located(self) -> bool:
        """Whether every wire pull is observable."""
        return bool(np.all(np.isfinite(self.pulls)))

    def complete(self, model: Model, tensions: Array) -> Array:
        """Return the wire pulls (m,) [m], those by the model at tensions where not observable."""
        if self.located:
            return self.pulls
        return np.where(np.isfinite(self.pulls), self.pulls, model.shape(tensions).pulls)

    def in_newtons(
        self, model: Model, limits: Array, guess: Shape | None, unknown: Array
    ) -> Array:
        """Return the tensions (m,) [N] at the wire pulls, `unknown` where the model has none."""
        known = np.isfinite(self.pulls)
        if not known.any():
            return unknown
        low, high = limits.T
        try:
            shape = model.pull_shape(self.pulls, guess)
            if np.all((shape.inputs >= low) & (shape.inputs <= high)):
                return shape.inputs
            # a slack tendon is below its limit: fit the pulls within the limits
            tensions, step = np.clip(shape.inputs, low, high), 1e-3 * (high - low)
            for _ in range(len(tensions)):  # Gauss-Newton
                current = model.shape(tensions, shape.state)
                side = np.where(tensions + step > high, -step, step)
                moved = [model.shape(tensions + row, current.state).pulls for row in np.diag(side)]
                slopes = ((np.array(moved) - current.pulls) / side[:, None]).T[known]
                miss = (self.pulls - current.pulls)[known]
                tensions = tensions + bounded_least_squares(
                    slopes, miss, low - tensions, high - tensions
                )
        except (NoEquilibriumError, InputError):
            return unknown
        return np.clip(tensions, low, high)


@dataclass
class ActingTensions:
    """
    Estimated tensions (m,) [N]: the command, corrected where measured ones differ significantly.

    Noise of the load cells must not move the estimate, because the model's friction would lose
    its memory.
    """

    offset: Array | None = None  # (m,) [N] beyond the command
    _last: tuple[Array, Array] | None = None  # commanded, measured
    _variance: Array | None = None  # (m,) [N²] of measured minus commanded
    _mean: Array | None = None  # (m,) [N] mean of measured minus commanded
    _followed: tuple[float, Array] | None = None  # [s], (m,) [N]

    def sent(self, now: float, command: Array, lag: float) -> None:
        """Take a command (m,) [N] to a drive that follows with a lag [s] of first order."""
        if lag == 0.0 or self._followed is None:
            self._followed = now, command
            return
        before, followed = self._followed
        part = 1.0 - np.exp(-max(now - before, 0.0) / lag)
        self._followed = now, followed + part * (command - followed)

    def followed(self, command: Array) -> Array:
        """Return the command (m,) [N] as filtered by the lag of the drive."""
        return command if self._followed is None else self._followed[1]

    def begin(self) -> None:
        """Forget the sent commands: the arm is at its measured state."""
        self._followed = None

    def take(self, command: Array, measured: Array | None, highest: Array) -> Array:
        """
        Return the estimated tensions; the offset changes only beyond the band of the noise.

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
            # the noise, from differences of successive readings
            noise_min, last = NOISE_MIN * highest, self._last
            if self._variance is None:
                self._variance = noise_min**2
            if last is not None and not np.array_equal(measured, last[1]):
                square = 0.5 * (measured - last[1] - (command - before)) ** 2
                square = np.minimum(square, NOISE_SD_MAX**2 * self._variance)  # jumps are clipped
                self._variance = self._variance + (square - self._variance) / NOISE_SAMPLES
            noise = np.clip(np.sqrt(self._variance), noise_min, NOISE_MAX * highest)
            self._last = command.copy(), measured.copy()
            width = NOISE_SD_MAX * noise + CYCLES_LATE * np.abs(command - before)
            differs = measured - command
            mean, samples = differs if self._mean is None else self._mean, 2.0 * NOISE_SAMPLES
            self._mean = mean = mean + (differs - mean) / samples
            narrow = width / np.sqrt(8.0 * samples)  # two deviations of the mean
            offset = np.clip(offset, mean - narrow, mean + narrow)
            offset = np.clip(offset, differs - width, differs + width)
        self.offset = offset
        return np.asarray(np.maximum(command + offset, 0.0))


@dataclass
class Settling:
    """
    Whether the tensions have settled at a command, so that the next one may be sent.

    The tension down to which a tendon was unloaded decides where friction reverses: an approach
    that reverses before the drive has settled is not repeatable. A drive that never settles delays
    the arm by at most five times the settling time.
    """

    _command: Array | None = None  # (m,) [N]
    _since: float = -np.inf  # [s] when it was commanded
    _near: float = -np.inf  # [s] since when they are within tolerance

    def settled(self, now: float, command: Array, measured: Array, width: Array) -> bool:
        """Whether measured tensions (m,) [N] have settled; `width` (m,) [N] are their ranges."""
        if self._command is None or not np.array_equal(command, self._command):
            self._command, self._since, self._near = command.copy(), now, now
        if np.any(np.abs(measured - command) >= SETTLED_RANGE * width):
            self._near = now
        return now - self._near >= SETTLED_S or now - self._since > 5.0 * SETTLED_S


@dataclass
class DriverSide:
    """
    The reported state of the driver, and the command that waits until it follows.

    Attributes
    ----------
    state : MeasuredState or None
        Last measurement.
    silent : bool
        Whether the last measurement is too old.
    lost : bool
        Whether the state of the arm is unknown until the next measurement.
    stopped : str
        Why the driver does not follow commands, '' when it does.
    released : str
        Why the driver released the arm and waits for a request to resume; '' while it follows.
    dropped : Target or None
        The target at the time when it was dropped.
    waiting : callable or None
        Repeats the command that arrived since the release.
    stamp : str
        Stamp of that command.
    acting : ActingTensions
        Estimated tensions.

    """

    state: MeasuredState | None = None
    silent: bool = True
    lost: bool = True
    stopped: str = ''
    released: str = ''
    dropped: Target | None = None
    waiting: Callable[[], None] | None = None
    stamp: str = ''
    acting: ActingTensions = field(default_factory=ActingTensions)
    _releases: int | None = None  # number of releases, None before the first report
    _over: int | None = None  # number of releases that are over
    _twisted: float = -np.inf  # [s] of the last twist other than zero

    def measured(self, now: float, tensions: Array, pulls: Array) -> None:
        """Take measured tensions (m,) [N] and wire pulls (m,) [m], nan where not observable."""
        self.state, self.silent = MeasuredState(tensions, pulls, now), False

    def fresh(self, now: float, settings: Settings) -> bool:
        """Whether the last measurement is recent."""
        return self.state is not None and now - self.state.time <= settings.state_timeout

    def timed_out(self, now: float, settings: Settings) -> bool:
        """Whether the driver is silent for so long that the last command is held no longer."""
        timeout = settings.state_timeout + SILENCE_MAX_S
        return not settings.resume and (self.state is None or now - self.state.time > timeout)

    @property
    def held(self) -> bool:
        """Whether the driver follows no commands."""
        return bool(self.stopped or self.released)

    @property
    def tensions(self) -> Array | None:
        """The measured tensions (m,) [N]; None where they are not observable."""
        state = self.state
        return np.maximum(state.tensions, 0.0) if state is not None and state.observed else None

    def report(self, stopped: str, released: str, releases: int) -> tuple[bool, bool]:
        """Take a report; return whether it has a new release, and whether the last one is over."""
        self.stopped = stopped
        new, over = releases != self._releases, bool(self.released) and not released
        first = self._releases is None
        if new:
            self._releases, self.released = releases, released
        return new and not first, over and not new

    def outdated_release(self, releases: int) -> bool:
        """Whether a report with a number of releases is older than the last resume."""
        return releases == self._over

    def resumed(self) -> None:
        """Record that the driver follows again, from the measured state."""
        self.stopped = self.released = ''
        self.lost, self._over = True, self._releases or None

    def wait(self, repeat: Callable[[], None], request: Target | Trajectory) -> bool:
        """
        Store a command until the driver follows; return False where it follows already.

        Raises
        ------
        Refusal
            The target equals the one before the release, including its stamp.

        """
        if not self.released:
            return False
        if isinstance(request, Target) and self.dropped and request.same(self.dropped):
            raise Refusal('released', f'the same target as before the release; {GO_ON}')
        self.waiting, self.stamp = repeat, request.stamp
        return True

    def twist(self, now: float, twist: Twist, timeout: float) -> bool:
        """Take a twist; return False while the arm is released, which a new twist ends."""
        continues = now - self._twisted <= timeout
        self._twisted = now if twist.moves else -np.inf
        if self.released and twist.moves and not continues:
            self.waiting, self.stamp = lambda: None, ''  # the sender repeats a twist
        return not self.released
