"""From targets to commands: one object, no clock, no threads, no ROS."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..drivers.latch import StopLatch
from ..drivers.limits import approach, bounded
from ..exceptions import DriverError, InputError, NoEquilibriumError
from .checks import Refusal
from .closed_loop import TipLoop
from .heard import Heard
from .jog import Jog, Twist, follow_twist
from .playing import Playing, in_pulls
from .settings import Output, Settings, Target
from .tracking import ShapeTracker

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Reach, Shape

Array = NDArray[np.float64]
STARTS = 12  # of a cold search; a twist only goes on from where it is
LONGEST_CYCLE = 0.05  # [s]; after a stall the command does not catch up in one step


@dataclass
class ControllerCore:
    """The state between two cycles; all times are monotonic seconds given by the caller."""

    model: Model
    settings: Settings = field(default_factory=Settings)
    target: Target | None = None
    solution: Reach | None = None
    command: Array | None = None  # (m,) [N], None until the driver was heard
    driver_stopped: str = ''  # why the driver does not follow, as it says
    refusals: dict[str, Refusal] = field(default_factory=dict)  # kind of message -> why the last
    latch: StopLatch = field(default_factory=StopLatch)
    loop: TipLoop = field(default_factory=TipLoop)
    playing: Playing | None = None  # a trajectory of the tendons; its end is held
    _jog: Jog | None = None
    _heard: Heard | None = None
    _pulls: Array | None = None  # (m,) [m] as commanded last, in pull mode
    _lost: bool = True
    _stepped: float = -np.inf
    track: ShapeTracker = field(init=False)

    def __post_init__(self) -> None:
        """Begin straight."""
        self.track = ShapeTracker(self.model)

    def measured(self, now: float, tensions: Array, pulls: Array) -> None:
        """Take what the driver measures, (m,) [N] and (m,) [m], nan where not observable."""
        self._heard = Heard(tensions, pulls, now)

    def aim(self, target: Target) -> None:
        """
        Take a set point; it stays until the next one.

        Raises
        ------
        Refusal
            The model finds no equilibrium for it, or a stop is latched.

        """
        self._require_running()
        try:
            solution = self.solve(target)
        except (NoEquilibriumError, InputError) as error:
            raise Refusal('no_equilibrium', f'target refused: {error}') from None
        self.target, self.solution, self._jog, self.playing = target, solution, None, None

    def twist(self, now: float, twist: Twist) -> None:
        """Take a velocity of the tip; it ends by itself after `twist_timeout`."""
        self._require_running()
        if self.command is None:
            raise Refusal('no_driver', 'twist refused: no tendon states yet')
        if self._jog is None and not twist.moves:
            return  # a joystick at rest takes no target away
        if self._jog is None:
            self._jog = Jog.start(self.track.begin(self.command))
            self.target = self.solution = self.playing = None
        self._jog.take(now, twist)

    def play(self, now: float, trajectory: Playing | None) -> None:
        """Play a trajectory of the tendons; None ends the one that plays and holds."""
        self._require_running()
        if self.command is None:
            raise Refusal('no_driver', 'tendon_trajectory refused: no tendon states yet')
        self._drop()
        self.playing = None if trajectory is None else trajectory.begin(now, self.commanded)

    def stop(self, key: str, reason: str, lasting: bool = False) -> None:
        """Latch a stop and drop the target; while its cause is lasting, reset is refused."""
        self.latch.stop(key, reason, lasting)
        self._drop()

    def reset(self) -> None:
        """Clear the stops and wait for a new target; DriverError while a cause is there."""
        if self.driver_stopped:
            raise DriverError(f'reset refused: the driver is stopped: {self.driver_stopped}')
        self.latch.reset()
        self._lost = True

    def driver_says(self, stopped: str) -> None:
        """Take why the driver does not follow, '' when it does."""
        if stopped and not self.driver_stopped:
            self._drop()
        self.driver_stopped = stopped

    @property
    def no_equilibrium(self) -> str:
        """Why the model has no shape now, '' when it has one."""
        return self.track.problem

    @property
    def jogging(self) -> bool:
        """Whether a twist moves the tip."""
        return self._jog is not None

    @property
    def commanded(self) -> Array | None:
        """What was commanded last, (m,) [N], or [m] in pull mode."""
        return self.command if self._pulls is None else self._pulls

    @property
    def moving(self) -> bool:
        """Whether the command is still on its way."""
        if self.playing is not None and self.commanded is not None:
            return not np.array_equal(self.commanded, self.playing.values[-1])
        if self.solution is None or self.command is None:
            return False
        goal = self.loop.goal(self, self.solution.tensions)
        return not np.array_equal(self.command, goal)

    def fresh(self, now: float) -> bool:
        """Whether the driver was heard lately."""
        return self._heard is not None and now - self._heard.time <= self.settings.state_timeout

    def step(self, now: float) -> Output | None:
        """Return a command; None (stop, no equilibrium for `patience`, no driver) releases."""
        passed = min(max(now - self._stepped, 0.0), LONGEST_CYCLE)
        self._stepped = now
        if not self.fresh(now):
            self._lost, self.playing = True, None
        elif self._lost or self.driver_stopped or self.command is None:
            self._resync()
        if self.latch or self.command is None:
            return None
        wanted = self.command
        if self.fresh(now) and not self.driver_stopped:
            wanted = self._advance(now, passed)
        return self._output(now, wanted)

    def predict(self, now: float) -> Shape | None:
        """Return the arm as the model sees it: at measured tensions where observable."""
        tensions = self.command
        if self._heard is not None and self._heard.observed and self.fresh(now):
            tensions = np.maximum(self._heard.tensions, 0.0)
        return None if tensions is None else self.track.follow(now, tensions)

    def set_model(self, model: Model) -> None:
        """
        Change the model; tensions then move to its solution at `rate_limit`.

        Raises
        ------
        InputError
            It has other inputs.
        NoEquilibriumError
            It finds none at the present tensions, or for the target: the old one stays.

        """
        if model.inputs != self.model.inputs:
            raise InputError(
                f'the new model has the inputs {", ".join(model.inputs)}, expected '
                f'{", ".join(self.model.inputs)}; restart the node to change them'
            )
        if self.command is not None:
            model.shape(self.command)
        solution = None if self.target is None else self.solve(self.target, model)
        self.model, self.solution = model, solution
        self._jog, self.track = None, ShapeTracker(model)
        self.loop.reset()

    def _advance(self, now: float, passed: float) -> Array:
        """Move the command towards where the target or the twist wants it, at the rate limit."""
        assert self.command is not None
        if self._jog is not None:
            over = self._jog.over(now, self.settings.twist_timeout)
            if over or not follow_twist(self, self._jog, passed):
                self._jog = self.solution = None
        goal = self.command
        if self.playing is not None and not self.settings.pull_mode:
            goal = self.playing.at(now)
        elif self.solution is not None:
            goal = self.loop.goal(self, self.solution.tensions)
        goal = bounded(goal, self.settings.limits(self.model))
        return approach(self.command, goal, np.full_like(goal, self.settings.rate_limit * passed))

    def _output(self, now: float, wanted: Array) -> Output | None:
        pulls = None
        if self.settings.pull_mode:
            wanted, pulls = in_pulls(self, now, wanted)
        failing = self.track.failing(now) > self.settings.patience
        if failing or (self.settings.pull_mode and pulls is None):
            self._drop()
            self._lost = True
            self.refusals['target'] = Refusal('no_equilibrium', f'released: {self.track.problem}')
            return None
        self.command, self._pulls = wanted, pulls
        return Output(wanted.copy(), pulls)

    def solve(self, target: Target, model: Model | None = None) -> Reach:
        """Return tensions for a target, from where the arm is."""
        model = model or self.model
        guess = self.track.last if self.solution is None else self.solution.shape
        same = guess is not None and len(guess.bend) == model.robot.cells
        return model.reach(
            position=target.position,
            direction=target.direction,
            guess=guess if same else None,
            direction_weight=self.settings.direction_weight or None,
            starts=STARTS if self._jog is None else 0,
            by_pulls=self.settings.pull_mode,
            relax=self._jog is None,
        )

    def _resync(self) -> None:
        """Begin at the measured state."""
        assert self._heard is not None
        limits = self.settings.limits(self.model)
        unknown = limits[:, 0] if self.command is None else self.command
        tensions = self._heard.in_newtons(self.model, limits, self.track.last, unknown)
        self.command = bounded(tensions, limits)
        self._lost, self._jog, self.playing, self._pulls = False, None, None, None

    def _drop(self) -> None:
        self.target = self.solution = self._jog = self.playing = None
        self.loop.reset()

    def _require_running(self) -> None:
        if self.latch:
            raise Refusal('stopped', f'stopped: {"; ".join(self.latch.reasons)}; call reset first')
        if self.driver_stopped:
            raise Refusal('driver_stopped', f'the driver does not follow: {self.driver_stopped}')
