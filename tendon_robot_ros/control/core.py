"""From targets to commands: one object, no clock, no threads, no ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..common.errors import DriverError, TendonRobotError
from ..drivers.safety import CYCLE_MAX_S, StopLatch, approach, bounded
from .checks import Refusal
from .friction_state import Approach, Arrival, FeltTensions
from .jog import Jog, Twist, follow_twist, start_jog
from .model_change import change_model
from .rebalance import Rebalance
from .release import Release
from .seeking import TargetSearch, seek
from .solver import GiveUp, InPlace, Solver
from .state import MeasuredState, Output, Settings, ShapeTracker, Target
from .tip_loop import TipLoop
from .trajectory import Playing, Way, look_and_play, play_pulls

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Reach, Shape

Array = NDArray[np.float64]
HELD_SILENT_S = 1.0  # [s] for which the last command is held after the driver fell silent


def raised(error: TendonRobotError | None) -> None:
    """Raise an error, if there is one."""
    if error is not None:
        raise error


@dataclass
class ControllerCore:
    """
    The state between two cycles; all times are monotonic seconds given by the caller.

    Nothing here evaluates the model: the solver does, and answers when it can.
    """

    model: Model
    settings: Settings = field(default_factory=Settings)
    solver: Solver = field(default_factory=InPlace)
    target: Target | None = None
    wanted: Array | None = None  # (3,) [m] its position, led where it moves
    solution: Reach | None = None
    in_time: bool = True  # whether the search for it came to its end
    search: TargetSearch | None = None  # for a target that is not yet followed
    asked: TargetSearch | None = None  # the last one
    command: Array | None = None  # (m,) [N], None until the driver was heard
    driver_stopped: str = ''  # why the driver does not follow, as it says
    release: Release = field(default_factory=Release)  # of the arm, by the driver
    refusals: dict[str, Refusal] = field(default_factory=dict)  # kind of message -> why the last
    latch: StopLatch = field(default_factory=StopLatch)
    loop: TipLoop = field(default_factory=TipLoop)
    felt: FeltTensions = field(default_factory=FeltTensions)
    balance: Rebalance = field(default_factory=Rebalance)
    via: list[Array] = field(default_factory=list)  # (m,) [N] each, on the way to the solution
    playing: Playing | None = None  # a trajectory of the tendons; its end is held
    looked: Playing | None = None  # a trajectory that may enter a region, while nobody knows
    stepped: float = -np.inf  # [s] when it last did
    way: Way | None = None  # in pull mode
    jog: Jog | None = None  # while a twist moves the tip
    _heard: MeasuredState | None = None
    _lost: bool = True  # where the arm is
    _silent: bool = True
    _arrival: Arrival = field(default_factory=Arrival)  # at the next turn of a way
    _syncing: object | None = None  # while the solver looks where the arm is
    track: ShapeTracker = field(init=False)

    def __post_init__(self) -> None:
        """Begin straight."""
        self.track = ShapeTracker(self.model)

    def measured(self, now: float, tensions: Array, pulls: Array) -> None:
        """Take what the driver measures, (m,) [N] and (m,) [m], nan where not observable."""
        self._heard, self._silent = MeasuredState(tensions, pulls, now), False

    def aim(self, target: Target) -> None:
        """
        Take a set point; it stays until the next one. Tensions for it are looked for.

        Raises
        ------
        Refusal
            A stop is latched, or there is no driver.

        """
        self._require_running()
        if self._silent and not self.settings.resume:
            raise Refusal('no_driver', 'target refused: no tendon states; send it again later')
        if self.release.wait(lambda: self.aim(target), target):
            return
        self.looked = None
        seek(self, target)

    def follow(
        self, target: Target, found: Approach, in_time: bool = True, led: Target | None = None
    ) -> None:
        """Go to where the tensions for a target are, or for one that leads it."""
        self.target, self.solution, self.in_time = target, found.reach, in_time
        self.wanted = target.position if led is None else led.position
        self.via = list(found.via)
        self.jog = self.playing = None

    def felt_tensions(self) -> Array:
        """Return the tensions (m,) [N] that act: as commanded, where the measured ones agree."""
        low, high = self.settings.limits(self.model).T
        command = low if self.command is None else self.felt.followed(self.command)
        heard = self._heard
        known = heard is not None and heard.observed and not self._silent
        measured = np.maximum(heard.tensions, 0.0) if known and heard is not None else None
        return self.felt.take(command, measured, high, self.loop.walking(self))

    def tip_shift(self, place: Array) -> Array:
        """Return by how much (3,) [m] the measured tip is off the model near a target (3,) [m]."""
        if self.settings.tip_gain == 0.0 or self.settings.pull_mode:
            return np.zeros(3)
        return self.loop.shift(self.stepped, place, self.model.robot.length)

    @property
    def streaming(self) -> bool:
        """Whether targets follow each other closely."""
        return self.asked is not None and self.asked.streamed

    def twist(self, now: float, twist: Twist) -> None:
        """Take a velocity of the tip; it ends by itself after `twist_timeout`."""
        self._require_running()
        if self.command is None:
            raise Refusal('no_driver', 'twist refused: no tendon states yet')
        follows = self.release.twist(now, twist, self.settings.twist_timeout)
        if not follows or (self.jog is None and not twist.moves):
            return  # a joystick at rest takes no target away
        self.search = self.looked = None
        if self.jog is None:
            self.jog = Jog()
            self.target = self.solution = self.playing = None
            self.via = []
            start_jog(self, self.jog)
        if self.jog is not None:
            self.jog.take(now, twist)

    def end_twist(self, jog: Jog, problem: str) -> None:
        """End a twist that leads nowhere."""
        if self.jog is jog:
            self.jog = self.solution = None
            self.refusals['target'] = Refusal('no_equilibrium', f'twist ended: {problem}')

    def play(self, now: float, trajectory: Playing | None) -> None:
        """
        Play a trajectory of the tendons; None ends the one that plays and holds.

        With regions to keep out of, the solver looks at the whole of it first.
        """
        self._require_running()
        if self.command is None:
            raise Refusal('no_driver', 'tendon_trajectory refused: no tendon states yet')
        if trajectory is None and self.release.why:
            self.release.waiting = None  # the arm holds already
            return
        if trajectory is not None and self.release.wait(
            lambda: self.play(self.stepped, trajectory), trajectory
        ):
            return
        if trajectory is not None and self.settings.keep_out:
            look_and_play(self, trajectory, lambda seen: self._play(max(now, self.stepped), seen))
        else:
            self._play(now, trajectory)

    def _play(self, now: float, trajectory: Playing | None) -> None:
        self._drop()
        self.release.dropped = None
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
        self.refusals.pop('target', None)
        self.release.dropped = None
        self._lost = True

    def driver_says(
        self, stopped: str, released: str = '', releases: int = 0, other: str = ''
    ) -> None:
        """
        Take what the driver says of itself.

        Parameters
        ----------
        stopped : str
            Why it does not follow, '' when it does.
        released : str
            Why it let go of the arm and waits until it is told to resume; '' while it follows.
        releases : int
            How often it has let go: one that is over by now counts, too.
        other : str
            Whom it follows instead.

        """
        if releases == self.release.over:
            stopped = ''  # it was said before the driver resumed
        stopped = stopped or other
        if stopped and not self.driver_stopped:
            self._drop()
        if self.driver_stopped and not stopped:
            self._outdated('driver_stopped')
        self.driver_stopped = stopped
        again, over = self.release.heard(released, releases)
        if again:
            self._lose()
        if over:
            self.resumed()

    @property
    def wants_driver(self) -> bool:
        """Whether a released arm is asked to move: the driver should resume."""
        kept = self.target is not None and self.settings.resume
        return bool(self.release.why) and (self.release.waiting is not None or kept)

    def resumed(self) -> None:
        """Take that the driver follows: from the measured state, to what waits for that."""
        self.release.why, self._lost = '', True
        self.release.over = self.release.count or None
        self.driver_stopped = ''
        self._outdated('released')
        self._outdated('driver_stopped')

    def not_resumed(self, problem: str) -> None:
        """Take why the driver does not follow: what released the arm is still there."""
        if self.release.waiting is not None:
            self.release.waiting = None
            self.refusals['target'] = Refusal('released', f'target refused: {problem}')

    def _outdated(self, code: str) -> None:
        """Forget a refusal of a target whose cause is over."""
        said = self.refusals.get('target')
        if said is not None and said.code == code:
            del self.refusals['target']

    @property
    def no_equilibrium(self) -> str:
        """Why the model has no shape now, '' when it has one."""
        return self.track.problem

    @property
    def jogging(self) -> bool:
        """Whether a twist moves the tip."""
        return self.jog is not None

    @property
    def commanded(self) -> Array | None:
        """What was commanded last, (m,) [N], or [m] in pull mode."""
        return self.command if self.way is None else self.way.pulls

    @property
    def heard_values(self) -> Array:
        """What is measured of what is commanded, (m,) [N] or [m]; nan where not observable."""
        heard = self._heard
        if heard is None:
            return np.full(len(self.model.inputs), np.nan)
        return heard.pulls if self.settings.pull_mode else heard.tensions

    @property
    def moving(self) -> bool:
        """Whether the command is still on its way."""
        if self.search is not None:
            return True
        if self.playing is not None and self.commanded is not None:
            return not np.array_equal(self.commanded, self.playing.values[-1])
        if self.solution is None or self.command is None:
            return False
        if self.via:
            return True
        goal = self.loop.goal(self, self.solution.tensions)
        return not np.array_equal(self.command, goal)

    def fresh(self, now: float) -> bool:
        """Whether the driver was heard lately."""
        return self._heard is not None and now - self._heard.time <= self.settings.state_timeout

    def gone(self, now: float) -> bool:
        """Whether the driver is silent for so long that the last command is held no more."""
        timeout = self.settings.state_timeout + HELD_SILENT_S
        silent = self._heard is None or now - self._heard.time > timeout
        return silent and not self.settings.resume

    def step(self, now: float) -> Output | None:
        """Return a command; None (stop, no equilibrium for `patience`, no driver) releases."""
        passed, self.stepped = now - self.stepped, now
        self.solver.serve()
        self._silent = not self.fresh(now)
        stalled = np.isfinite(passed) and passed > self.settings.state_timeout
        if self._silent or stalled:
            self._lose()
        if not self._silent and (self._lost or self._held or self.command is None):
            self._resync()
        if self.release.waiting is not None and not (self._lost or self._held or self.latch):
            waiting, self.release.waiting = self.release.waiting, None
            waiting()
        if self.latch:
            self._drop()  # another thread may have stopped it
        if self.latch or self.command is None or self.gone(now):
            return None
        if self._silent:
            return self._output()
        if self._lost and not self.settings.pull_mode:
            return None  # still looking for the tensions of what was measured
        if not (self._lost or self._held):
            self._advance(now, min(max(passed, 0.0), CYCLE_MAX_S))
            if not (self.moving or self.jog or self.playing):
                self.balance.step(self, now)
        if self.track.failing > self.settings.patience:
            self._drop()
            self._lost = True
            self.refusals['target'] = Refusal('no_equilibrium', f'released: {self.track.problem}')
            return None
        return self._output()

    def predict(self, now: float, take: Callable[[Shape], None]) -> None:
        """Give `take` the arm as the model sees it: at measured tensions where observable."""
        tensions = self.command
        if self.command is not None and self.model.remembers:
            tensions = self.felt_tensions()  # noise would have friction forget
        elif self._heard is not None and self._heard.observed and self.fresh(now):
            tensions = np.maximum(self._heard.tensions, 0.0)
        if tensions is None or self.solver.busy('predict'):
            return
        track, find = self.track, self.track.finding(tensions)

        def done(shape: Shape | None, error: TendonRobotError | None) -> None:
            if track is not self.track:
                return  # of the model before
            if shape is None:
                track.failed(now, str(error))
            else:
                track.took(shape)
                take(shape)

        self.solver.post('predict', find, done)

    def set_model(
        self, model: Model, on_done: Callable[[TendonRobotError | None], None] = raised
    ) -> None:
        """Change the model while controlling; see `model_change.change_model`."""
        change_model(self, model, on_done)

    def _advance(self, now: float, passed: float) -> None:
        """Move the command towards where the target or the twist wants it, at the rate limit."""
        assert self.command is not None
        if self.jog is not None:
            over = self.jog.over(now, self.settings.twist_timeout)
            if over or not follow_twist(self, self.jog, passed):
                self.jog = self.solution = None
        step = self.settings.rate_limit * passed
        if self.way is not None and self.playing is not None:
            play_pulls(self, self.way, self.playing, now)
            return
        goal = self._goal(now)
        if self.way is not None:
            self.command = self.way.advance(self, goal, step)
        else:
            if self.solution is not None and not self.via:
                step = self.loop.step(self, goal, step, passed)
            self.command = approach(self.command, goal, np.full_like(goal, step))
        self.felt.sent(now, self.command, self.settings.drive_lag)
        if self.via and np.array_equal(self.command, goal) and self._follows(now):
            self.via.pop(0)

    def _follows(self, now: float) -> bool:
        """Whether the arm is where the command is, or has been given the time."""
        assert self.command is not None
        if (heard := self._heard) is None or not heard.observed or self.way is not None:
            return True
        low, high = self.settings.limits(self.model).T
        return self._arrival.over(now, self.command, heard.tensions, high - low)

    def _goal(self, now: float) -> Array:
        assert self.command is not None
        goal = self.command
        if self.playing is not None:
            goal = self.playing.at(now)
        elif self.via and self.solution is not None:
            goal = self.via[0]
        elif self.solution is not None:
            goal = self.loop.goal(self, self.solution.tensions)
        return bounded(goal, self.settings.limits(self.model))

    def _output(self) -> Output | None:
        assert self.command is not None
        pulls = None if self.way is None else self.way.pulls.copy()
        if self.settings.pull_mode and pulls is None:
            return None
        return Output(self.command.copy(), pulls)

    def _lose(self) -> None:
        """Forget what was asked for: a driver that comes back finds nothing to go to."""
        self._lost, self.playing, self._syncing = True, None, None
        if not self.settings.resume:
            self._drop()

    def begin_anew(self) -> None:
        """Forget what was asked for, and begin at the measured state."""
        self._lost, self._syncing = True, None
        self._drop()

    def _resync(self) -> None:
        """Begin at the measured state."""
        if self._syncing is not None and not self._held:
            return
        assert self._heard is not None
        self.jog = self.playing = self._syncing = None
        heard, limits, pull = (
            self._heard,
            self.settings.limits(self.model),
            self.settings.pull_mode,
        )
        if not pull and heard.observed:
            self._begin(bounded(np.maximum(heard.tensions, 0.0), limits), None)
            return
        unknown = limits[:, 0] if self.command is None else self.command
        if pull and heard.located:  # wires stay where they are, whatever tensions that takes
            self.way, self.command = Way(heard.pulls), unknown
        if not self._held:
            self._look(heard.observed_or(unknown), limits)

    def _look(self, unknown: Array, limits: Array) -> None:
        """Have the solver say what tensions belong to the measured wire pulls."""
        assert self._heard is not None
        heard, model, guess = self._heard, self.model, self.track.last
        pull = self.settings.pull_mode
        syncing = self._syncing = object()

        def work(give_up: GiveUp) -> tuple[Array, Array | None]:
            tensions = bounded(heard.in_newtons(model, limits, guess, unknown), limits)
            return tensions, heard.complete(model, tensions) if pull else None

        def done(
            solved: tuple[Array, Array | None] | None, error: TendonRobotError | None
        ) -> None:
            if self._syncing is not syncing:
                return
            self._syncing = None
            if solved is None:
                self.track.failed(self.stepped, str(error))
            else:
                self._begin(*solved)

        self.solver.post('resync', work, done)

    def _begin(self, tensions: Array, pulls: Array | None) -> None:
        self.command, self._lost = tensions, False
        self.felt.begin()
        self.way = None if pulls is None else Way(pulls)

    @property
    def _held(self) -> bool:
        """Whether the driver follows no commands."""
        return bool(self.driver_stopped or self.release.why)

    def _drop(self) -> None:
        wanted = self.target if self.search is None else self.search.target
        self.release.dropped, self.release.waiting = wanted or self.release.dropped, None
        self.target = self.solution = self.search = self.jog = self.playing = self.looked = None
        self.via = []
        self.loop.reset()

    def _require_running(self) -> None:
        if self.latch:
            raise Refusal('stopped', f'stopped: {"; ".join(self.latch.reasons)}; call reset first')
        if self.driver_stopped:
            raise Refusal('driver_stopped', f'the driver does not follow: {self.driver_stopped}')
