"""
The state of the controller, and of the driver: measurements, lag, silence, stops and releases.

After a release nothing moves without a new command: the driver follows no commands until it is
requested to resume, which the controller does when a new target, trajectory or twist arrives.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError, NoEquilibriumError
from ..common.local_stop import SILENCE_S
from ..drivers.interface import SETTLED_S
from ..drivers.safety import StopLatch, bounded
from ..model.compile import GAP_ACCEPTED_M
from ..model.model import Model
from ..model.program import RANGE_TOLERANCE, bounded_least_squares
from ..model.pulls import transmitted
from ..model.shape import Reach, Shape
from ..model.tip_task import limits_by_pulls
from .inputs import Refusal, Settings, Target, Trajectory, Twist
from .solver import GiveUp, Solver, Work
from .tip_estimator import NOISE_SAMPLES, NullSpaceMotion, TipEstimate, bias_part

GO_ON = 'send another target or call reset'
# [1] standard deviations; one reading of 16,000 is beyond by chance
NOISE_SD_MAX = 4.0
# [1] commanded pulls that a prediction follows, because a backbone that remembers comes to another
# place on a curve than on its chord, and each takes stiff wires 10 ms
WAY_MAX = 3


@dataclass
class MeasuredState:
    """Tensions (m,) [N] and wire pulls (m,) [m] as measured, nan where not observable."""

    tensions: Floats
    pulls: Floats
    time: float  # monotonic [s]

    @property
    def observed(self) -> bool:
        """Whether every tension is observable."""
        return bool(np.all(np.isfinite(self.tensions)))

    @property
    def located(self) -> bool:
        """Whether every wire pull is observable."""
        return bool(np.all(np.isfinite(self.pulls)))

    def complete(self, model: Model, tensions: Floats) -> Floats:
        """Return the wire pulls (m,) [m], those by the model at tensions where not observable."""
        if self.located:
            return self.pulls
        return np.where(np.isfinite(self.pulls), self.pulls, model.shape(tensions).pulls)

    def in_newtons(
        self, model: Model, limits: Floats, guess: Shape | None, unknown: Floats
    ) -> Floats:
        """Return the tensions (m,) [N] at the wire pulls, `unknown` where the model has none."""
        known = np.isfinite(self.pulls)
        if not known.any():
            return unknown
        low, high = limits.T
        memory = None if guess is None else guess.memory.copy()
        passed = transmitted(model, self.pulls[None], memory)[0]
        try:
            shape = model.follow_pulls(guess, self.pulls)
            if np.all((shape.inputs >= low) & (shape.inputs <= high)):
                return shape.inputs
            # a slack tendon is below its limit: fit the pulls within the limits
            tensions, step = np.clip(shape.inputs, low, high), 1e-3 * (high - low)
            for _ in range(len(tensions)):  # Gauss-Newton
                current = model.shape(tensions, shape.state)
                side = np.where(tensions + step > high, -step, step)
                moved = [model.shape(tensions + row, current.state).pulls for row in np.diag(side)]
                slopes = ((np.array(moved) - current.pulls) / side[:, None]).T[known]
                miss = (passed - current.pulls)[known]
                tensions += bounded_least_squares(slopes, miss, low - tensions, high - tensions)
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

    offset: Floats | float = 0.0  # (m,) [N] beyond the command
    _last: tuple[Floats, Floats] | None = None  # commanded, measured
    _variance: Floats | None = None  # (m,) [N²] of measured minus commanded
    _mean: Floats | None = None  # (m,) [N] mean of measured minus commanded
    _followed: tuple[float, Floats] | None = None  # [s], (m,) [N]

    def sent(self, now: float, command: Floats, lag: float) -> None:
        """Take a command (m,) [N] to a drive that follows with a lag [s] of first order."""
        if lag == 0.0 or self._followed is None:
            self._followed = now, command
            return
        before, followed = self._followed
        part = 1.0 - np.exp(-max(now - before, 0.0) / lag)
        self._followed = now, followed + part * (command - followed)

    def followed(self, command: Floats) -> Floats:
        """Return the command (m,) [N] as filtered by the lag of the drive."""
        return command if self._followed is None else self._followed[1]

    def begin(self) -> None:
        """Forget the sent commands: the arm is at its measured state."""
        self._followed = None

    def take(self, command: Floats, measured: Floats | None, highest: Floats) -> Floats:
        """
        Return the estimated tensions; the offset changes only beyond the band of the noise.

        Parameters
        ----------
        command : (m,) [N]
        measured : (m,) [N] or None
        highest : (m,) [N]
            Upper limits.

        """
        offset = self.offset
        if measured is not None:
            before = command if self._last is None else self._last[0]
            # the noise, from differences of successive readings; a constant reading has some, too
            noise_min, last = 0.1 * RANGE_TOLERANCE * highest, self._last
            if self._variance is None:
                self._variance = noise_min**2
            if last is not None and not np.array_equal(measured, last[1]):
                square = 0.5 * (measured - last[1] - (command - before)) ** 2
                square = np.minimum(square, NOISE_SD_MAX**2 * self._variance)  # jumps are clipped
                self._variance = self._variance + (square - self._variance) / NOISE_SAMPLES
            # poor load cells have fifty times the least; more is an error of the tension
            noise = np.clip(np.sqrt(self._variance), noise_min, 50.0 * noise_min)
            self._last = command.copy(), measured.copy()
            # bus and driver delay a measured tension by a cycle each
            width = NOISE_SD_MAX * noise + 2.0 * np.abs(command - before)
            differs = measured - command
            mean, samples = differs if self._mean is None else self._mean, 2.0 * NOISE_SAMPLES
            self._mean = mean = mean + (differs - mean) / samples
            narrow = width / np.sqrt(8.0 * samples)  # two deviations of the mean
            offset = np.clip(offset, mean - narrow, mean + narrow)
            offset = np.clip(offset, differs - width, differs + width)
        self.offset = offset
        return np.asarray(np.maximum(command + offset, 0.0))


def is_near(tensions: Floats, goal: Floats, limits: Floats, tolerance: float) -> bool:
    """Whether tensions (m,) [N] are at a goal, within a tolerance [1] of their ranges."""
    return bool(np.all(np.abs(tensions - goal) < tolerance * np.ptp(limits, axis=1)))


@dataclass
class Settling:
    """
    Whether the tensions have settled at a command, so that the next one may be sent.

    The tension down to which a tendon was unloaded decides where friction reverses: an approach
    that reverses before the drive has settled is not repeatable. A drive that never settles delays
    the arm by at most five times the settling time.
    """

    _command: Floats | None = None  # (m,) [N]
    _since: float = -np.inf  # [s] when it was commanded
    _near: float = -np.inf  # [s] since when they are within tolerance

    def settled(self, now: float, command: Floats, measured: Floats, limits: Floats) -> bool:
        """Whether measured tensions (m,) [N] with limits (m, 2) [N] have settled."""
        if self._command is None or not np.array_equal(command, self._command):
            self._command, self._since, self._near = command.copy(), now, now
        if not is_near(measured, command, limits, 2.0 * RANGE_TOLERANCE):
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
    releases: int | None = None  # so far, None before the first report
    over: int | None = None  # so far when the last one was over
    _twisted: float = -np.inf  # [s] of the last twist other than zero

    def timed_out(self, now: float, settings: Settings) -> bool:
        """Whether the driver is silent for so long that the last command is held no longer."""
        timeout = settings.state_timeout + SILENCE_S
        return not settings.resume and (self.state is None or now - self.state.time > timeout)

    @property
    def held(self) -> bool:
        """Whether the driver follows no commands."""
        return bool(self.stopped or self.released)

    @property
    def tensions(self) -> Floats | None:
        """The measured tensions (m,) [N]; None where they are not observable."""
        state = self.state
        return np.maximum(state.tensions, 0.0) if state is not None and state.observed else None

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


class ShapeTracker:
    """The last shape of the model, at which the next search for an equilibrium starts."""

    def __init__(self, model: Model) -> None:
        """Begin with the straight arm."""
        self.model = model
        self._last: Shape | None = None
        self._way: list[Floats] = []  # (m,) [m] pulls commanded since the last shape
        self._followed = 0  # number of them that the running prediction follows
        self.problem = ''
        self._failed: tuple[float, float] | None = None  # [s] first and last time, in a row

    @property
    def last(self) -> Shape | None:
        """The last shape, with the play of the transmission as it is now."""
        if self._last is None or not self.model.transmission_remembers:
            return self._last
        shape = Shape(self._last.form, self._last.block.copy())
        if self._way:
            transmitted(self.model, np.array(self._way), shape.memory)
        return shape

    def commanded(self, pulls: Floats) -> None:
        """Take commanded pulls (m,) [m], which the next prediction follows."""
        if not (self._way and np.array_equal(pulls, self._way[-1])):
            self._way.append(pulls)

    def shape_work(self, tensions: Floats, before: Shape | None = None) -> Work[Shape]:
        """Return solver work: the shape under tensions (m,) [N] after `before` or the last one."""
        model, before = self.model, before or self.last
        return lambda give_up: model.follow(before, tensions)

    def held_work(self, otherwise: Work[Shape]) -> Work[Shape]:
        """Return solver work: the shape at the commanded pulls, `otherwise` without one."""
        model, shape, way = self.model, self._last, self._way[::-1]
        self._followed, step = len(way), max(-(-len(way) // WAY_MAX), 1)

        def work(give_up: GiveUp) -> Shape:
            nonlocal shape
            with suppress(NoEquilibriumError, InputError):
                for pulls in reversed(way[::step]):  # the last one always
                    if shape is None or np.abs(shape.pulls - pulls).max() > GAP_ACCEPTED_M:
                        shape = model.follow_pulls(shape, pulls)
                if shape is not None:
                    return shape
            return otherwise(give_up)

        return work

    def accept(self, shape: Shape) -> None:
        """Store a new shape."""
        self._last = shape
        del self._way[: self._followed]
        self._followed = 0
        self.recovered()

    def recovered(self) -> None:
        """Record that there is an equilibrium."""
        self.problem, self._failed = '', None

    def failed(self, now: float, problem: str) -> None:
        """Record that there is no equilibrium."""
        self.problem = problem
        self._failed = (now if self._failed is None else self._failed[0], now)

    @property
    def failing(self) -> float:
        """Time without an equilibrium [s]."""
        return 0.0 if self._failed is None else self._failed[1] - self._failed[0]


class TrackedTip(NamedTuple):
    """A measurement of the tip."""

    time: float  # [s]
    position: Floats  # (3,) [m]
    modelled: Floats | None  # (3,) [m] tip of the model at that time


@dataclass
class TipCorrection:
    """The correction of the tensions by the tracked tip, as tip_loop.py updates it."""

    tensions: Floats | None = None  # (m,) [N] goal for the solution, None: that of the model
    solution: Reach | None = None
    frozen: str = 'no tracker'  # reason, '' while the loop runs
    estimate: TipEstimate | None = None
    motion: NullSpaceMotion | None = None  # in progress
    tip: TrackedTip | None = None


class Mode:
    """
    A mode of motion; this one follows no command: the tensions stay.

    A mode writes its own fields only, and another posture for its target is written to `reach`.
    """

    target: Target | None = None
    reach: Reach | None = None  # solution for the target, or for the twist
    position: Floats | None = None  # (3,) [m] desired position of the tip, ahead in a stream
    trajectory: Trajectory | None = None

    def step(self, state: ControllerState, passed: float) -> Floats | None:
        """
        Return the goal of the command, (m,) [N], or (m,) [m] of a trajectory in pull mode.

        None ends the mode, and the command stays. `passed` [s] is the time since the last step.
        """
        return state.command

    def moving(self, state: ControllerState) -> bool:
        """Whether the command still changes."""
        return False


@dataclass
class ControllerState:
    """
    The state between two cycles; all times are monotonic seconds given by the caller.

    Only the core writes its fields; modes and searches read them.
    """

    model: Model
    settings: Settings = field(default_factory=Settings)
    solver: Solver = field(default_factory=Solver)
    time: float = -np.inf  # [s] of the last cycle
    mode: Mode = field(default_factory=Mode)
    command: Floats | None = None  # (m,) [N], None before the first measurement
    streaming: bool = False  # whether targets follow each other closely
    driver: DriverSide = field(default_factory=DriverSide)
    latch: StopLatch = field(default_factory=StopLatch)
    loop: TipCorrection = field(default_factory=TipCorrection)
    track: ShapeTracker = field(init=False)

    def __post_init__(self) -> None:
        """Begin with the straight arm."""
        self.track = ShapeTracker(self.model)

    @property
    def limits(self) -> Floats:
        """Limits of the tensions (m, 2) [N]; in pull mode wires may be slack."""
        return limits_by_pulls(self.model) if self.settings.pull_mode else self.model.limits

    @property
    def target(self) -> Target | None:
        """The current target."""
        return self.mode.target

    @property
    def solution(self) -> Reach | None:
        """The solution for the target, or for the twist."""
        return self.mode.reach

    @property
    def playing(self) -> Trajectory | None:
        """The trajectory that is played or whose end is held."""
        return self.mode.trajectory

    @property
    def commanded(self) -> Floats | None:
        """The last command, (m,) [N], or [m] in pull mode."""
        return self.command

    @property
    def tracks_pulls(self) -> bool:
        """Whether the model follows commanded pulls, because bends or motors remember the way."""
        remembers = self.model.bends_remember or self.model.transmission_remembers
        return self.settings.pull_mode and remembers

    @property
    def in_null_space(self) -> bool:
        """Whether a null-space motion is in progress in closed loop."""
        motion = self.loop.motion
        return motion is not None and motion.solution is self.solution and not self.loop.frozen

    def acting_tensions(self) -> Floats:
        """Return the estimated tensions (m,) [N]: the command, corrected by the measured ones."""
        low, high = self.limits.T
        acting = self.driver.acting
        command = low if self.command is None else acting.followed(self.command)
        # noise of load cells must not appear as a motion of the arm to the null-space motion
        unseen = self.driver.silent or self.in_null_space
        return acting.take(command, None if unseen else self.driver.tensions, high)

    def goal(self, tensions: Floats) -> Floats:
        """Return the tensions (m,) [N] of a solution as the tip loop corrects them."""
        if self.loop.tensions is None or self.settings.tip_gain == 0.0:
            return tensions
        if self.loop.solution is not self.solution:
            return tensions  # of a new target, whose search includes the bias
        return bounded(self.loop.tensions, self.limits)

    def tip_bias(self, place: Floats) -> Floats:
        """
        Return the bias (3,) [m] of the model's tip near a position (3,) [m].

        It falls with the distance from the measured tip, and is 0 once the tracker is lost.
        """
        closed = self.settings.tip_gain > 0.0 and not self.settings.pull_mode
        tip, estimate = self.loop.tip, self.loop.estimate
        if tip is None or estimate is None or self.time - tip.time > SILENCE_S or not closed:
            return np.zeros(3)
        distance = float(np.linalg.norm(place - tip.position))
        return estimate.bias * bias_part(distance, self.model.robot.length)

    def without_bias(self, target: Target) -> Target:
        """Return the target of the model's tip with which the tip is at a target."""
        if target.position is None:
            return target
        return replace(target, position=target.position - self.tip_bias(target.position))

    def fresh(self, now: float) -> bool:
        """Whether the last measurement of the driver is recent."""
        state = self.driver.state
        return state is not None and now - state.time <= self.settings.state_timeout
