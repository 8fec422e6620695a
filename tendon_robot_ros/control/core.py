"""From targets to commands: a state machine without clock, threads or ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..common.errors import DriverError, InputError, TendonRobotError
from ..drivers.safety import CYCLE_MAX_S, StopLatch, approach, bounded
from .approach import Approach
from .checks import Refusal, another_robot, check_inputs
from .driver_side import DriverSide
from .modes import FollowTarget, FollowTwist, Idle, Mode, PlayTrajectory, PullPath, keeps_out
from .null_space import NullSpace, NullSpaceMotion
from .solver import InPlace, Solver
from .state import Output, Settings, ShapeTracker, Target, Trajectory, Twist
from .target_search import SearchResult, TargetSearch, ahead_of, is_nearer, searching, with_model
from .tip_loop import TipLoop

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Reach, Shape
    from .solver import GiveUp

Array = NDArray[np.float64]


def raised(error: TendonRobotError | None) -> None:
    """Raise an error, if there is one."""
    if error is not None:
        raise error


@dataclass
class ControllerCore:
    """
    The state between two cycles; all times are monotonic seconds given by the caller.

    Only the core writes its fields: modes and searches answer, and the core does what they say.
    Nothing here evaluates the model: the solver does, and answers when it can.
    """

    model: Model
    settings: Settings = field(default_factory=Settings)
    solver: Solver = field(default_factory=InPlace)
    time: float = -np.inf  # [s] of the last cycle
    mode: Mode = field(default_factory=Idle)
    search: TargetSearch | None = None  # for a target that is not yet followed
    command: Array | None = None  # (m,) [N], None until the driver was heard
    pulls: PullPath | None = None  # in pull mode
    driver: DriverSide = field(default_factory=DriverSide)
    refusals: dict[str, Refusal] = field(default_factory=dict)  # kind of message -> why the last
    latch: StopLatch = field(default_factory=StopLatch)
    loop: TipLoop = field(default_factory=TipLoop)
    null_space: NullSpace = field(default_factory=NullSpace)
    track: ShapeTracker = field(init=False)
    looked_at: Trajectory | None = None  # until it is known whether it enters a region
    _last_search: TargetSearch | None = None
    _syncing: object | None = None  # while the solver looks where the arm is

    def __post_init__(self) -> None:
        """Begin straight."""
        self.track = ShapeTracker(self.model)

    # What is asked for.

    def aim(self, target: Target) -> None:
        """
        Take a set point; it stays until the next one. Tensions for it are looked for.

        Raises
        ------
        Refusal
            A stop is latched, or there is no driver.

        """
        self._require_running()
        if self.driver.silent and not self.settings.resume:
            raise Refusal('no_driver', 'target refused: no tendon states; send it again later')
        if not self.driver.wait(lambda: self.aim(target), target):
            self.looked_at = None
            self._seek(target)

    def twist(self, now: float, twist: Twist) -> None:
        """Take a velocity of the tip; it ends by itself after `twist_timeout`."""
        self._require_running()
        if self.command is None:
            raise Refusal('no_driver', 'twist refused: no tendon states yet')
        follows = self.driver.twist(now, twist, self.settings.twist_timeout)
        if not follows or not (self.jogging or twist.moves):
            return  # a joystick at rest takes no target away
        self.search = self.looked_at = None
        if isinstance(self.mode, FollowTwist):
            self.mode.take(now, twist)
        else:
            self.mode = mode = FollowTwist(twist, now)

            def begin(shape: Shape | None, error: TendonRobotError | None) -> None:
                if shape is not None:
                    self.track.took(shape)
                mode.begin(shape, error)

            self.solver.post('twist', self.track.finding(self.command), begin)

    def play(self, now: float, trajectory: Trajectory | None) -> None:
        """
        Play a trajectory of the tendons; None ends the one that plays and holds.

        With regions to keep out of, the solver looks at the whole of it first.
        """
        self._require_running()
        if self.command is None:
            raise Refusal('no_driver', 'tendon_trajectory refused: no tendon states yet')
        if trajectory is None and self.driver.released:
            self.driver.waiting = None  # the arm holds already
        elif trajectory is None:
            self._drop()
            self.driver.dropped = None
        elif self.driver.wait(lambda: self.play(self.time, trajectory), trajectory):
            return
        elif self.settings.keep_out:
            self.looked_at = trajectory

            def take(refusal: Refusal | None) -> None:
                if self.looked_at is not trajectory:
                    return  # something else is wanted by now
                self.looked_at = None
                if refusal is not None:
                    self.refusals['target'] = refusal
                elif self.settings.pull_mode:
                    self._play(max(now, self.time), trajectory)
                else:  # another model may have come meanwhile
                    limits = self.settings.limits(self.model)
                    self._play(max(now, self.time), trajectory.within(limits))

            self.solver.post('trajectory', *keeps_out(self, trajectory, take))
        else:
            self._play(now, trajectory)

    def _play(self, now: float, trajectory: Trajectory) -> None:
        self._drop()
        self.driver.dropped = None
        self.mode = PlayTrajectory(trajectory.begin(now, self.commanded))

    def stop(self, key: str, reason: str, lasting: bool = False) -> None:
        """Latch a stop and drop the target; while its cause is lasting, reset is refused."""
        self.latch.stop(key, reason, lasting)
        self._drop()

    def reset(self) -> None:
        """Clear the stops and wait for a new target; DriverError while a cause is there."""
        if self.driver.stopped:
            raise DriverError(f'reset refused: the driver is stopped: {self.driver.stopped}')
        self.latch.reset()
        self.refusals.pop('target', None)
        self.driver.dropped = None
        self.driver.lost = True

    def set_model(
        self, model: Model, on_done: Callable[[TendonRobotError | None], None] = raised
    ) -> None:
        """
        Change the model; tensions then move to its solution at `rate_limit`.

        That of another robot (another name, and so another base frame, or another length) takes
        no target over: the arm holds where it is measured.

        `on_done` hears None, or why the old one stays: an InputError for other inputs, a
        NoEquilibriumError when it finds none at the present tensions or for the target.
        """
        try:
            check_inputs(model.inputs, self.model.inputs)
        except InputError as error:
            on_done(error)
            return
        target = self.target

        def done(
            solved: tuple[Shape | None, Reach | None] | None, error: TendonRobotError | None
        ) -> None:
            if solved is not None:
                self._use(model, target, *solved)
            on_done(error)

        self.solver.post('model', with_model(self, model), done)

    def _use(
        self, model: Model, target: Target | None, here: Shape | None, reach: Reach | None
    ) -> None:
        """Change the model: what was asked for goes on with it, unless it is of another robot."""
        other = another_robot(model.robot, self.model.robot)
        self.model, self.track = model, ShapeTracker(model)
        self.track.last = here
        self.loop.reset()
        if other:
            self.driver.lost, self._syncing = True, None
            self._drop()
            return
        if self.pulls is not None:
            self.pulls = PullPath(self.pulls.pulls)
        searched = None if self.search is None else self.search.target
        if isinstance(mode := self.mode, PlayTrajectory) and not self.settings.pull_mode:
            limits = self.settings.limits(model)
            self.mode = PlayTrajectory(mode.trajectory.within(limits))
        elif isinstance(mode, FollowTwist):
            self.mode = Idle()
        elif isinstance(mode, FollowTarget):
            if mode.target is target and reach is not None:
                self.mode = FollowTarget(mode.target, reach, [], mode.position, mode.in_time)
            else:
                searched = searched or mode.target  # it came meanwhile
                mode.via = []
        if searched is not None:
            self._seek(searched)

    # The search for the tensions of a target.

    def _seek(self, target: Target) -> None:
        """Look for the tensions of a target; until they are found the arm goes on as before."""
        last = self.target if self.search is None else self.search.target
        self.search = TargetSearch.begin(self, self._last_search, last, target)
        self._last_search = self.search
        self._search(self.search, self.search.first_budget)

    def _search(self, search: TargetSearch, budget: float) -> None:
        """Search for a time [s]; what is much nearer is gone to while the search goes on."""

        def report(solution: Reach) -> None:
            if self.search is search:
                self._follow(search, Approach.straight(solution), False)

        def done(result: SearchResult | None, error: TendonRobotError | None) -> None:
            self._searched(search, result or SearchResult(None, str(error), True))

        work = searching(self, search, budget, report)
        self.solver.post('target', work, done, budget, urgent=True)

    def _searched(self, search: TargetSearch, result: SearchResult) -> None:
        """Use what was found, unless something else is wanted by now; search for the rest."""
        newest, left = self.search, 0.0 if result.in_time else result.left
        if newest is None or newest.stream is not search.stream:
            return
        way = result.approach
        if newest is search and left > 0.0:
            if way is not None and is_nearer(self, search.target, way.reach):
                self._follow(search, way, False)
            self._search(search, left)
            return
        if newest is search:
            self.search = None
        elif way is None:
            return  # of a stream: the next one may be better
        if way is not None:  # of a stream an older target, too, is on the way
            self._follow(search, way, result.in_time)
            return
        code = 'no_equilibrium' if result.in_time else 'no_time'
        late = '' if result.in_time else f' (the search ended after {search.budget:.3g} s)'
        self.refusals['target'] = Refusal(code, f'target refused: {result.problem}{late}')

    def _follow(self, search: TargetSearch, way: Approach, in_time: bool) -> None:
        ahead = ahead_of(self, search)
        self.mode = FollowTarget.along(search.target, way, in_time, ahead)

    # What the driver and the tracker say.

    def measured(self, now: float, tensions: Array, pulls: Array) -> None:
        """Take what the driver measures, (m,) [N] and (m,) [m], nan where not observable."""
        self.driver.measured(now, tensions, pulls)

    def tip_measured(self, now: float, position: Array) -> None:
        """Take a measured tip (3,) [m] in the base frame."""
        self.loop.take(now, self, position)

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
        if self.driver.said_before(releases):
            stopped = ''
        stopped, before = stopped or other, self.driver.stopped
        if stopped and not before:
            self._drop()
        if before and not stopped:
            self._outdated('driver_stopped')
        again, over = self.driver.says(stopped, released, releases)
        if again:
            self._lose()
        if over:
            self.resumed()

    @property
    def wants_driver(self) -> bool:
        """Whether a released arm is asked to move: the driver should resume."""
        kept = self.target is not None and self.settings.resume
        return bool(self.driver.released) and (self.driver.waiting is not None or kept)

    def resumed(self) -> None:
        """Take that the driver follows: from the measured state, to what waits for that."""
        self.driver.resumed()
        self._outdated('released')
        self._outdated('driver_stopped')

    def not_resumed(self, problem: str) -> None:
        """Take why the driver does not follow: what released the arm is still there."""
        if self.driver.waiting is not None:
            self.driver.waiting = None
            self.refusals['target'] = Refusal('released', f'target refused: {problem}')

    def _outdated(self, code: str) -> None:
        """Forget a refusal of a target whose cause is over."""
        said = self.refusals.get('target')
        if said is not None and said.code == code:
            del self.refusals['target']

    # How it is.

    @property
    def target(self) -> Target | None:
        """The target that is followed."""
        return self.mode.target if isinstance(self.mode, FollowTarget) else None

    @property
    def solution(self) -> Reach | None:
        """The tensions that were found for the target, or for the twist."""
        return self.mode.reach if isinstance(self.mode, FollowTarget | FollowTwist) else None

    @property
    def wanted(self) -> Array | None:
        """Where the tip should be, (3,) [m]: at the target, or ahead of it in a stream."""
        return self.mode.position if isinstance(self.mode, FollowTarget) else None

    @property
    def playing(self) -> Trajectory | None:
        """The trajectory that is played, or whose end is held."""
        return self.mode.trajectory if isinstance(self.mode, PlayTrajectory) else None

    @property
    def jogging(self) -> bool:
        """Whether a twist moves the tip."""
        return isinstance(self.mode, FollowTwist)

    @property
    def moving(self) -> bool:
        """Whether the command is still on its way."""
        return self.search is not None or (self.command is not None and self.mode.moving(self))

    @property
    def streaming(self) -> bool:
        """Whether targets follow each other closely."""
        return self._last_search is not None and self._last_search.streamed

    @property
    def commanded(self) -> Array | None:
        """What was commanded last, (m,) [N], or [m] in pull mode."""
        return self.command if self.pulls is None else self.pulls.pulls

    @property
    def heard_values(self) -> Array:
        """What is measured of what is commanded, (m,) [N] or [m]; nan where not observable."""
        heard = self.driver.state
        if heard is None:
            return np.full(len(self.model.inputs), np.nan)
        return heard.pulls if self.settings.pull_mode else heard.tensions

    @property
    def measured_tensions(self) -> Array | None:
        """The measured tensions (m,) [N]; None where they are not observable."""
        return self.driver.tensions

    def acting_tensions(self) -> Array:
        """Return the tensions (m,) [N] that act: as commanded, where the measured ones agree."""
        low, high = self.settings.limits(self.model).T
        acting = self.driver.acting
        command = low if self.command is None else acting.followed(self.command)
        # noise of load cells is not to look like a motion of the arm to what holds the tip
        unseen = self.driver.silent or self.loop.in_null_space(self)
        return acting.take(command, None if unseen else self.measured_tensions, high)

    @property
    def acting_offset(self) -> Array:
        """By how much (m,) [N] the tensions that act differ from the commanded ones."""
        offset = self.driver.acting.offset
        return np.zeros(len(self.model.inputs)) if offset is None else offset

    @property
    def motion(self) -> NullSpaceMotion | None:
        """The null-space motion that has the arm in closed loop."""
        return self.loop.motion

    def begin_motion(self, motion: NullSpaceMotion | None) -> None:
        """Give the arm to a null-space motion; None ends one."""
        self.loop.motion = motion

    def goal(self, tensions: Array) -> Array:
        """Return where the tip loop has the goal of tensions (m,) [N] that were found."""
        return self.loop.goal(self, tensions)

    def tip_bias(self, place: Array) -> Array:
        """Return by how much (3,) [m] the measured tip is off the model near a place (3,) [m]."""
        if self.settings.tip_gain == 0.0 or self.settings.pull_mode:
            return np.zeros(3)
        return self.loop.bias(self.time, place, self.model.robot.length)

    def fresh(self, now: float) -> bool:
        """Whether the driver was heard lately."""
        return self.driver.fresh(now, self.settings)

    def follows(self, now: float) -> bool:
        """Whether the driver follows commands, and was heard lately."""
        return not (self.latch or self.driver.stopped) and self.fresh(now)

    # The cycle.

    def step(self, now: float) -> Output | None:
        """Return a command; None (stop, no equilibrium for `patience`, no driver) releases."""
        passed, self.time = now - self.time, now
        self.solver.serve()
        driver = self.driver
        driver.silent = not self.fresh(now)
        stalled = np.isfinite(passed) and passed > self.settings.state_timeout
        if driver.silent or stalled:
            self._lose()
        if not driver.silent and (driver.lost or driver.held or self.command is None):
            self._resync()
        if driver.waiting is not None and not (driver.lost or driver.held or self.latch):
            waiting, driver.waiting = driver.waiting, None
            waiting()
        if self.latch:
            self._drop()  # another thread may have stopped it
        if self.latch or self.command is None or driver.gone(now, self.settings):
            return None
        if driver.silent:
            return self._output()
        if driver.lost and not self.settings.pull_mode:
            return None  # still looking for the tensions of what was measured
        if not (driver.lost or driver.held):
            self._advance(min(max(passed, 0.0), CYCLE_MAX_S))
        if self.track.failing > self.settings.patience:
            self._drop()
            driver.lost = True
            self.refusals['target'] = Refusal('no_equilibrium', f'released: {self.track.problem}')
            return None
        return self._output()

    def _advance(self, passed: float) -> None:
        """Move the command towards where the mode wants it, at the rate limit."""
        assert self.command is not None
        goal = self.mode.step(self, passed)
        if goal is None:
            if isinstance(self.mode, FollowTwist) and self.mode.problem:
                why = f'twist ended: {self.mode.problem}'
                self.refusals['target'] = Refusal('no_equilibrium', why)
            self.mode, goal = Idle(), self.command
        if self.pulls is not None and isinstance(self.mode, PlayTrajectory):
            self.command = self.pulls.play(self, goal)
            return
        goal = bounded(goal, self.settings.limits(self.model))
        step = self.settings.rate_limit * passed
        if self.pulls is not None:
            self.command = self.pulls.advance(self, goal, step)
        else:
            on_the_way = isinstance(self.mode, FollowTarget) and self.mode.via
            if self.solution is not None and not on_the_way:
                step = self.loop.paced(self, goal, step, passed)
            self.command = approach(self.command, goal, np.full_like(goal, step))
        self.driver.acting.sent(self.time, self.command, self.settings.drive_lag)
        if not (self.moving or self.playing or self.jogging):
            nearer = self.null_space.step(self, self.time)
            if nearer is not None and isinstance(mode := self.mode, FollowTarget):
                mode.reach = nearer

    def _output(self) -> Output | None:
        assert self.command is not None
        pulls = None if self.pulls is None else self.pulls.pulls.copy()
        if self.settings.pull_mode and pulls is None:
            return None
        return Output(self.command.copy(), pulls)

    def predict(self, now: float, take: Callable[[Shape], None]) -> None:
        """Give `take` the arm as the model sees it: at measured tensions where observable."""
        tensions = self.command
        if self.command is not None and self.model.remembers:
            tensions = self.acting_tensions()  # noise would have friction forget
        elif self.measured_tensions is not None and self.fresh(now):
            tensions = self.measured_tensions
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

    def _lose(self) -> None:
        """Forget what was asked for: a driver that comes back finds nothing to go to."""
        self.driver.lost, self._syncing = True, None
        if self.playing is not None:
            self.mode = Idle()
        if not self.settings.resume:
            self._drop()

    def _resync(self) -> None:
        """Begin at the measured state; the solver says what tensions belong to wire pulls."""
        if self._syncing is not None and not self.driver.held:
            return
        assert self.driver.state is not None
        self._syncing = None
        if self.playing is not None or self.jogging:
            self.mode = Idle()
        heard, limits = self.driver.state, self.settings.limits(self.model)
        pull, model, guess = self.settings.pull_mode, self.model, self.track.last
        if not pull and heard.observed:
            self._begin(bounded(np.maximum(heard.tensions, 0.0), limits), None)
            return
        unknown = limits[:, 0] if self.command is None else self.command
        if pull and heard.located:  # wires stay where they are, whatever tensions that takes
            self.pulls, self.command = PullPath(heard.pulls), unknown
        if self.driver.held:
            return
        if heard.observed:
            unknown = np.maximum(heard.tensions, 0.0)
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
                self.track.failed(self.time, str(error))
            else:
                self._begin(*solved)

        self.solver.post('resync', work, done)

    def _begin(self, tensions: Array, pulls: Array | None) -> None:
        self.command, self.driver.lost = tensions, False
        self.driver.acting.begin()
        self.pulls = None if pulls is None else PullPath(pulls)

    def _drop(self) -> None:
        wanted = self.target if self.search is None else self.search.target
        self.driver.dropped, self.driver.waiting = wanted or self.driver.dropped, None
        self.search = self.looked_at = None
        self.mode = Idle()
        self.loop.reset()

    def _require_running(self) -> None:
        if self.latch:
            raise Refusal('stopped', f'stopped: {"; ".join(self.latch.reasons)}; call reset first')
        if self.driver.stopped:
            raise Refusal('driver_stopped', f'the driver does not follow: {self.driver.stopped}')
