"""
The driver as the controller sees it: what was sent, what is heard, silence, stops and releases.

After a release nothing moves until somebody asks for it anew: the driver follows no commands until
it is told to resume, which the controller does when a new target, trajectory or twist has come.
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
# [s] of silence of driver or tracker; one that is silent for less may only have been held up by a
# busy machine, else every pause of it would drop the arm
GONE_S = 1.0
# [1] standard deviations; one reading of 16,000 is beyond by chance
NOISE_SD_MAX = 4.0
# [1] of the highest tension: load cells resolve no less, so that a constant reading is no noise of
# 0
NOISE_MIN = 2e-4
# [1] of the highest tension: noise of poor load cells; more would be a tension that is really off
NOISE_MAX = 1e-2
# [1] readings over which noise is averaged, of load cells and trackers: so that it is good to 10
# %; the mean offset is over twice as many
NOISE_SAMPLES = 50
# [1] cycles by which a measured tension may lag behind its command, because of bus and driver
CYCLES_LATE = 2.0
# [1] of the range: tensions that have followed a command, but for the end of a lag, because
# exp(-5.5) of a whole range is as much
SETTLED_RANGE = 0.004
# [s] for which they have: five lags of a drive of 20 ms, so that noise alone does not say so
SETTLED_S = 0.1


@dataclass
class MeasuredState:
    """Tensions (m,) [N] and wire pulls (m,) [m] as measured, nan where not observable."""

    tensions: Array
    pulls: Array
    time: float  # monotonic [s]

    @property
    def observed(self) -> bool:
        """Whether every tension was."""
        return bool(np.all(np.isfinite(self.tensions)))

    @property
    def located(self) -> bool:
        """Whether every wire pull was."""
        return bool(np.all(np.isfinite(self.pulls)))

    def complete(self, model: Model, tensions: Array) -> Array:
        """Return the wire pulls (m,) [m]; those of tensions where they are not observable."""
        if self.located:
            return self.pulls
        return np.where(np.isfinite(self.pulls), self.pulls, model.shape(tensions).pulls)

    def in_newtons(
        self, model: Model, limits: Array, guess: Shape | None, unknown: Array
    ) -> Array:
        """Return the tensions (m,) [N] of the wire pulls, or others where none belong to them."""
        known = np.isfinite(self.pulls)
        if not known.any():
            return unknown
        low, high = limits.T
        try:
            shape = model.pull_shape(self.pulls, guess)
            if np.all((shape.inputs >= low) & (shape.inputs <= high)):
                return shape.inputs
            # a slack tendon is below its limit: look for the same pulls within the limits
            tensions, step = np.clip(shape.inputs, low, high), 1e-3 * (high - low)
            for _ in range(len(tensions)):  # Gauss-Newton
                here = model.shape(tensions, shape.state)
                side = np.where(tensions + step > high, -step, step)
                moved = [model.shape(tensions + row, here.state).pulls for row in np.diag(side)]
                slopes = ((np.array(moved) - here.pulls) / side[:, None]).T[known]
                miss = (self.pulls - here.pulls)[known]
                tensions = tensions + bounded_least_squares(
                    slopes, miss, low - tensions, high - tensions
                )
        except (NoEquilibriumError, InputError):
            return unknown
        return np.clip(tensions, low, high)


@dataclass
class ActingTensions:
    """
    Tensions (m,) [N] that act: as commanded, corrected where the measured ones differ.

    By more than noise, that is: noise itself must not move them, because friction of tendons that
    are shaken forgets.
    """

    offset: Array | None = None  # (m,) [N] beyond the command
    _last: tuple[Array, Array] | None = None  # commanded, measured
    _variance: Array | None = None  # (m,) [N²] of what is measured beside what is commanded
    _mean: Array | None = None  # (m,) [N] by which the measured ones differ
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
            # from how what is measured changes beside the command
            least, last = NOISE_MIN * highest, self._last
            if self._variance is None:
                self._variance = least**2
            if last is not None and not np.array_equal(measured, last[1]):
                seen = 0.5 * (measured - last[1] - (command - before)) ** 2
                seen = np.minimum(seen, NOISE_SD_MAX**2 * self._variance)  # a jump is no noise
                self._variance = self._variance + (seen - self._variance) / NOISE_SAMPLES
            noise = np.clip(np.sqrt(self._variance), least, NOISE_MAX * highest)
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

    How far tendons were unloaded decides where friction reverses: an approach that reverses while
    the drive still follows does so elsewhere every time. A drive that never settles holds the arm
    for no longer than five times what it has to be settled for.
    """

    _command: Array | None = None  # (m,) [N]
    _since: float = -np.inf  # [s] when it was commanded
    _near: float = -np.inf  # [s] since when the tensions are near

    def settled(self, now: float, command: Array, measured: Array, width: Array) -> bool:
        """Tell whether measured tensions (m,) [N] have settled; `width` (m,) [N]: the ranges."""
        if self._command is None or not np.array_equal(command, self._command):
            self._command, self._since, self._near = command.copy(), now, now
        if np.any(np.abs(measured - command) >= SETTLED_RANGE * width):
            self._near = now
        return now - self._near >= SETTLED_S or now - self._since > 5.0 * SETTLED_S


@dataclass
class DriverSide:
    """
    What the driver says, and what waits for it to follow.

    Attributes
    ----------
    state : MeasuredState or None
        As it was heard last.
    silent : bool
        It was not heard lately.
    lost : bool
        It is not known where the arm is: the next state tells.
    stopped : str
        Why it does not follow, as it says; '' when it does.
    released : str
        Why it let go of the arm, and waits until it is told to resume; '' while it follows.
    dropped : Target or None
        What was asked for when the target was taken back.
    waiting : callable or None
        Asks anew for what came since the release.
    stamp : str
        Of that.
    acting : ActingTensions
        By what was sent and what is measured.

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
    _releases: int | None = None  # how often it let go, None before it was heard
    _over: int | None = None  # the count of the last one after which it followed again
    _twisted: float = -np.inf  # [s] when a twist last was more than zero

    def measured(self, now: float, tensions: Array, pulls: Array) -> None:
        """Take what it measures, (m,) [N] and (m,) [m], nan where not observable."""
        self.state, self.silent = MeasuredState(tensions, pulls, now), False

    def fresh(self, now: float, settings: Settings) -> bool:
        """Whether it was heard lately."""
        return self.state is not None and now - self.state.time <= settings.state_timeout

    def gone(self, now: float, settings: Settings) -> bool:
        """Whether it is silent for so long that the last command is held no more."""
        timeout = settings.state_timeout + GONE_S
        return not settings.resume and (self.state is None or now - self.state.time > timeout)

    @property
    def held(self) -> bool:
        """Whether it follows no commands."""
        return bool(self.stopped or self.released)

    @property
    def tensions(self) -> Array | None:
        """The measured tensions (m,) [N]; None where they are not observable."""
        state = self.state
        return np.maximum(state.tensions, 0.0) if state is not None and state.observed else None

    def says(self, stopped: str, released: str, releases: int) -> tuple[bool, bool]:
        """Take what it says of itself; return whether it let go anew, and whether that is over."""
        self.stopped = stopped
        new, over = releases != self._releases, bool(self.released) and not released
        first = self._releases is None
        if new:
            self._releases, self.released = releases, released
        return new and not first, over and not new

    def said_before(self, releases: int) -> bool:
        """Whether a count of releases is of the time before it followed again."""
        return releases == self._over

    def resumed(self) -> None:
        """Take that it follows, from the measured state."""
        self.stopped = self.released = ''
        self.lost, self._over = True, self._releases or None

    def wait(self, ask: Callable[[], None], asked: Target | Trajectory) -> bool:
        """
        Keep what was asked for until it follows; False: it does.

        Raises
        ------
        Refusal
            A sender repeats what it said before, stamp and all: that is no new target.

        """
        if not self.released:
            return False
        if isinstance(asked, Target) and self.dropped and asked.same(self.dropped):
            raise Refusal('released', f'the same target as before the release; {GO_ON}')
        self.waiting, self.stamp = ask, asked.stamp
        return True

    def twist(self, now: float, twist: Twist, timeout: float) -> bool:
        """Take a twist; False: of a released arm, which the next one moves if it was let go of."""
        goes_on = now - self._twisted <= timeout
        self._twisted = now if twist.moves else -np.inf
        if self.released and twist.moves and not goes_on:
            self.waiting, self.stamp = lambda: None, ''  # a twist is repeated
        return not self.released
