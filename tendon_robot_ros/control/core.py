"""From targets to commands: a state machine without clock, threads or ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ..common.arrays import Floats
from ..common.errors import DriverError
from ..drivers.safety import CYCLE_MAX_S, approach, bounded
from ..model.model import Model
from ..model.shape import Reach, Shape
from .inputs import Output, Refusal, Target, Trajectory, Twist, another_robot
from .modes import FollowTarget, FollowTwist, NullSpace, PlayTrajectory, PullPath
from .solver import Failure, GiveUp
from .state import ControllerState, MeasuredState, Mode, ShapeTracker
from .target_search import (
    FIRST_ANSWER_S,
    Approach,
    SearchResult,
    TargetSearch,
    is_nearer,
    keep_out_refusal,
    model_work,
    search_work,
)
from .tip_loop import TipLoop


@dataclass
class ControllerCore(ControllerState):
    """
    The state machine: it takes commands and measurements, and returns a command per cycle.

    Modes and searches return what it should do. It never evaluates the model: it posts the work to
    the solver, which calls back with the result.
    """

    loop: TipLoop = field(default_factory=TipLoop)
    search: TargetSearch | None = None  # for a target that is not yet followed
    pulls: PullPath | None = None  # in pull mode
    refusals: dict[str, Refusal] = field(default_factory=dict)  # kind of message -> why the last
    null_space: NullSpace = field(default_factory=NullSpace)
    pending_trajectory: Trajectory | None = None  # while the solver checks it against the regions
    _last_search: TargetSearch | None = None
    _syncing: object | None = None  # while the solver computes the tensions at the measured state

    def aim(self, target: Target) -> None:
        """
        Take a setpoint, which stays until the next one, and search tensions for it.

        Raises
        ------
        Refusal
            A stop is latched, or there is no driver.

        """
        self._require_running()
        if self.driver.silent and not self.settings.resume:
            raise Refusal('no_driver', 'target refused: no tendon states; send it again later')
        if not self.driver.wait(lambda: self.aim(target), target):
            self.pending_trajectory = None
            self._seek(target)

    def twist(self, now: float, twist: Twist) -> None:
        """Take a velocity of the tip; it ends by itself after `twist_timeout`."""
        self._require_running()
        if self.command is None:
            raise Refusal('no_driver', 'twist refused: no tendon states yet')
        follows = self.driver.twist(now, twist, self.settings.twist_timeout)
        if not follows or not (self.jogging or twist.moves):
            return  # a joystick at rest does not replace a target
        self.search = self.pending_trajectory = None
        if isinstance(self.mode, FollowTwist):
            self.mode.twist, self.mode.received = twist, now
        else:
            self.mode = FollowTwist(twist, now)
            begin = partial(self.mode.begin, self.track)
            self.solver.post('twist', self.track.shape_work(self.command), begin)

    def play(self, now: float, trajectory: Trajectory | None) -> None:
        """
        Play a trajectory of the tendons; None ends any motion and holds, which is never refused.

        With keep-out regions, the solver first checks the whole trajectory.
        """
        if trajectory is None:
            if self.driver.held:
                self.driver.waiting = None  # the arm holds already
            else:
                self._drop()
                self.driver.dropped = None
            return
        self._require_running()
        if self.command is None:
            raise Refusal('no_driver', 'tendon_trajectory refused: no tendon states yet')
        if self.driver.wait(lambda: self.play(self.time, trajectory), trajectory):
            return
        if self.settings.keep_out:
            self._check_trajectory(now, trajectory)
        else:
            self._play(now, trajectory)

    def _play(self, now: float, trajectory: Trajectory) -> None:
        self._drop()
        if not self.settings.pull_mode:  # another model may have come meanwhile
            trajectory = trajectory.within(self.limits)
        self.driver.dropped = None
        self.mode = PlayTrajectory(trajectory.begin(now, self.commanded))

    def _check_trajectory(self, now: float, trajectory: Trajectory) -> None:
        """Have the solver check whether a trajectory keeps out of regions, and then play it."""
        self.pending_trajectory = trajectory
        model, last, acting = self.model, self.track.last, self.acting_tensions()
        settings, command = self.settings, self.commanded

        def work(give_up: GiveUp) -> Refusal | None:
            start = last if settings.pull_mode and last else model.follow(last, acting)
            begun = trajectory.begin(0.0, command)
            return keep_out_refusal(model, start, begun, settings.keep_out, settings.pull_mode)

        def done(refusal: Refusal | None, error: Failure) -> None:
            if self.pending_trajectory is not trajectory:
                return  # a newer command has replaced it
            if self.model is not model or self.settings.keep_out is not settings.keep_out:
                self._check_trajectory(now, trajectory)  # these came during the check
                return
            self.pending_trajectory = None
            if error is not None:
                problem = f'tendon_trajectory: {error}; nothing was played'
                refusal = Refusal('no_equilibrium', problem)
            if refusal is not None:
                self.refusals['target'] = refusal
            else:
                self._play(max(now, self.time), trajectory)

        self.solver.post('trajectory', work, done)

    def reset(self) -> None:
        """Clear the stops and wait for a new target; raise DriverError while a cause exists."""
        if self.driver.stopped:
            raise DriverError(f'reset refused: the driver is stopped: {self.driver.stopped}')
        if self.latch:
            self._drop()  # the stop may be of this cycle
        self.latch.reset()
        self.refusals.pop('target', None)
        self.driver.dropped = None
        self.driver.lost = True

    def set_model(self, model: Model, on_done: Callable[[Failure], None] | None = None) -> None:
        """
        Change the model; tensions then move to its solution at `rate_limit`.

        A model of another robot (other name, hence other base frame, or other length) drops the
        target: the arm holds its measured state.

        `on_done` is called with None, or with the error that keeps the present model in use: an
        InputError for other inputs, a NoEquilibriumError when the new model has no equilibrium at
        the present tensions or for the target.
        """
        target = self.target

        def done(solved: tuple[Shape | None, Reach | None] | None, error: Failure) -> None:
            if solved is not None:
                self._use(model, target, *solved)
            if on_done is not None:
                on_done(error)
            elif error is not None:
                raise error

        self.solver.post('model', model_work(self, model), done)

    def _use(
        self, model: Model, target: Target | None, shape: Shape | None, reach: Reach | None
    ) -> None:
        """Change the model; the present command continues with it, unless the robot is another."""
        other = another_robot(model.robot, self.model.robot)
        self.model, self.track = model, ShapeTracker(model)
        if shape is not None:
            self.track.accept(shape)
        self.loop.reset()
        if other:
            self.driver.lost, self._syncing = True, None
            self._drop()
            return
        if self.pulls is not None:
            self.pulls = PullPath(self.pulls.pulls)
        pending = None if self.search is None else self.search.target
        if isinstance(mode := self.mode, PlayTrajectory) and not self.settings.pull_mode:
            self.mode = PlayTrajectory(mode.trajectory.within(self.limits))
        elif isinstance(mode, FollowTwist):
            self.mode = Mode()
        elif isinstance(mode, FollowTarget):
            if mode.target is target and reach is not None:
                self.mode = replace(mode, reach=reach, via=[])
            else:
                pending = pending or mode.target  # it arrived during the search
                mode.via = []
        if pending is not None:
            self._seek(pending)

    def _seek(self, target: Target) -> None:
        """Start the search for the tensions of a target; the present motion continues."""
        last = self.target if self.search is None else self.search.target
        self.search = TargetSearch.begin(self, self._last_search, last, target)
        self._last_search, self.streaming = self.search, self.search.streamed
        # after the first budget the arm follows the first solution, while the search continues
        self._search(self.search, min(self.search.budget, FIRST_ANSWER_S))

    def _search(self, search: TargetSearch, budget: float) -> None:
        """Post a search with a budget [s]; the arm follows its first good solution meanwhile."""

        def report(solution: Reach) -> None:
            if self.search is search:
                self._follow(search, Approach(solution), False)

        def done(result: SearchResult | None, error: Failure) -> None:
            self._finish_search(search, result or SearchResult(None, str(error), True))

        work = search_work(self, search, budget, report)
        self.solver.post('target', work, done, budget, urgent=True)

    def _finish_search(self, search: TargetSearch, result: SearchResult) -> None:
        """Follow the result of a search that is still current; search on in the remaining time."""
        newest, remaining = self.search, 0.0 if result.in_time else result.remaining
        if newest is None or newest.stream is not search.stream:
            return
        path = result.approach
        if newest is search and remaining > 0.0:
            if path is not None and is_nearer(self, search.target, path.reach):
                self._follow(search, path, False)
            self._search(search, remaining)
            return
        self.search = None if newest is search else newest
        if path is not None:  # in a stream an older target is on the path, too
            self._follow(search, path, result.in_time)
        elif newest is search:  # else the search for the next target of the stream runs
            code = 'no_equilibrium' if result.in_time else 'no_time'
            late = '' if result.in_time else f' (the search ended after {search.budget:.3g} s)'
            self.refusals['target'] = Refusal(code, f'target refused: {result.problem}{late}')

    def _follow(self, search: TargetSearch, path: Approach, in_time: bool) -> None:
        position = search.extrapolated(self).position
        self.mode = FollowTarget(search.target, path.reach, list(path.via), position, in_time)

    def measured(self, now: float, tensions: Floats, pulls: Floats) -> None:
        """Take measured tensions (m,) [N] and wire pulls (m,) [m], nan where not observable."""
        self.driver.state, self.driver.silent = MeasuredState(tensions, pulls, now), False

    def tip_measured(self, now: float, position: Floats) -> None:
        """Take a measured tip (3,) [m] in the base frame."""
        self.loop.take(now, self, position)

    def driver_reports(
        self, stopped: str, released: str = '', releases: int = 0, other: str = ''
    ) -> None:
        """
        Take the state that the driver reports.

        Parameters
        ----------
        stopped : str
            Why the driver does not follow commands, '' when it does.
        released : str
            Why the driver released the arm and waits for a request to resume; '' while it follows.
        releases : int
            Number of releases so far, including those that are over.
        other : str
            The other sender that the driver follows; '' for none.

        """
        driver = self.driver
        if driver.releases is not None and releases < driver.releases:
            driver.over = None  # another driver, which counts from the beginning
        before, driver.stopped = driver.stopped, stopped or other
        if releases == driver.over:
            driver.stopped = other  # the report is older than the last resume
        if driver.stopped and not before:
            self._drop()
        if before and not driver.stopped:
            self._forget_refusal('driver_stopped')
        if releases != driver.releases:
            first, driver.releases = driver.releases is None, releases
            driver.released = released
            if not first:
                self._lose()
        elif driver.released and not released:
            self.resumed()

    @property
    def needs_driver(self) -> bool:
        """Whether a command waits for a released driver, which should resume."""
        kept = self.target is not None and self.settings.resume
        return bool(self.driver.released) and (self.driver.waiting is not None or kept)

    def resumed(self) -> None:
        """Continue from the measured state after the driver has resumed."""
        driver = self.driver
        driver.stopped = driver.released = ''
        driver.lost, driver.over = True, driver.releases or None
        self._forget_refusal('released', 'driver_stopped')

    def not_resumed(self, problem: str) -> None:
        """Refuse the waiting command: the cause of the release still exists."""
        if self.driver.waiting is not None:
            self.driver.waiting = None
            self.refusals['target'] = Refusal('released', f'target refused: {problem}')

    def _forget_refusal(self, *codes: str) -> None:
        """Forget the refusal of a target with a code whose cause is over."""
        refusal = self.refusals.get('target')
        if refusal is not None and refusal.code in codes:
            del self.refusals['target']

    @property
    def jogging(self) -> bool:
        """Whether a twist moves the tip."""
        return isinstance(self.mode, FollowTwist)

    @property
    def moving(self) -> bool:
        """Whether a search runs or the command still changes."""
        return self.search is not None or self.mode.moving(self)

    @property
    def commanded(self) -> Floats | None:
        """The last command, (m,) [N], or [m] in pull mode."""
        return self.command if self.pulls is None else self.pulls.pulls

    @property
    def measured_values(self) -> Floats:
        """The measurement of the commanded quantity, (m,) [N] or [m]; nan where not observable."""
        if (state := self.driver.state) is None:
            return np.full(len(self.model.inputs), np.nan)
        return state.pulls if self.settings.pull_mode else state.tensions

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
            self._drop()  # another thread may have latched a stop
        if self.latch or self.command is None or driver.timed_out(now, self.settings):
            return None
        if driver.silent:
            return self._output()
        if driver.lost and not self.settings.pull_mode:
            return None  # the solver still computes the tensions at the measured state
        if not (driver.lost or driver.held):
            self._advance(min(max(passed, 0.0), CYCLE_MAX_S))
        if self.track.failing > self.settings.patience:
            self._drop()
            driver.lost = True
            self.refusals['target'] = Refusal('no_equilibrium', f'released: {self.track.problem}')
            return None
        return self._output()

    def _advance(self, passed: float) -> None:
        """Move the command towards the goal of the mode, within the rate limit."""
        assert self.command is not None
        goal = self.mode.step(self, passed)
        if goal is None:
            if isinstance(self.mode, FollowTwist) and self.mode.problem:
                why = f'twist ended: {self.mode.problem}'
                self.refusals['target'] = Refusal('no_equilibrium', why)
            self.mode, goal = Mode(), self.command
        step = self.settings.rate_limit * passed
        if self.pulls is None:
            goal = bounded(goal, self.limits)
            via_pending = isinstance(self.mode, FollowTarget) and self.mode.via
            if self.solution is not None and not via_pending:
                step = self.loop.paced(self, goal, step, passed)
            self.command = approach(self.command, goal, np.full_like(goal, step))
        elif isinstance(self.mode, PlayTrajectory):
            self.command = self.pulls.play(self, goal)
        else:
            self.command = self.pulls.advance(self, bounded(goal, self.limits), step)
        self.driver.acting.sent(self.time, self.command, self.settings.drive_lag)
        if not (self.moving or self.playing or self.jogging):
            self.null_space.step(self)

    def _output(self) -> Output | None:
        assert self.command is not None
        pulls = None if self.pulls is None else self.pulls.pulls.copy()
        if self.settings.pull_mode and pulls is None:
            return None
        if pulls is not None and self.tracks_pulls:
            self.track.commanded(pulls)
        return Output(self.command.copy(), pulls)

    def predict(self, now: float, take: Callable[[Shape], None]) -> None:
        """Call `take` with the shape by the model, at measured tensions where observable."""
        tensions = self.command
        if self.command is not None and self.model.remembers:
            tensions = self.acting_tensions()  # noise would erase the memory of friction
        elif self.driver.tensions is not None and self.fresh(now):
            tensions = self.driver.tensions
        if tensions is None or self.solver.busy('predict'):
            return
        track, find = self.track, self.track.shape_work(tensions)
        if self.pulls is not None and self.tracks_pulls:
            find = track.held_work(find)

        def done(shape: Shape | None, error: Failure) -> None:
            if track is not self.track:
                return  # of the previous model
            if shape is None:
                track.failed(now, str(error))
            else:
                track.accept(shape)
                take(shape)

        self.solver.post('predict', find, done)

    def _lose(self) -> None:
        """Drop the command after a silence, so that the arm stays when the driver is back."""
        self.driver.lost, self._syncing = True, None
        if self.playing is not None:
            self.mode = Mode()
        if not self.settings.resume:
            self._drop()

    def _resync(self) -> None:
        """Start from the measured state; the solver computes tensions from wire pulls."""
        if self._syncing is not None and not self.driver.held:
            return
        assert self.driver.state is not None
        self._syncing = None
        if self.playing is not None or self.jogging:
            self.mode = Mode()
        state, limits = self.driver.state, self.limits
        pull, model, guess = self.settings.pull_mode, self.model, self.track.last
        if not pull and state.observed:
            self._begin(bounded(np.maximum(state.tensions, 0.0), limits), None)
            return
        unknown = limits[:, 0] if self.command is None else self.command
        if pull and state.located:  # the wires keep their lengths, at any tension
            self.pulls, self.command = PullPath(state.pulls), unknown
        if self.driver.held:
            return
        if state.observed:
            unknown = np.maximum(state.tensions, 0.0)
        syncing = self._syncing = object()

        def work(give_up: GiveUp) -> tuple[Floats, Floats | None]:
            tensions = bounded(state.in_newtons(model, limits, guess, unknown), limits)
            return tensions, state.complete(model, tensions) if pull else None

        def done(solved: tuple[Floats, Floats | None] | None, error: Failure) -> None:
            if self._syncing is not syncing:
                return
            self._syncing = None
            if solved is None:
                self.track.failed(self.time, str(error))
            else:
                self._begin(*solved)

        self.solver.post('resync', work, done)

    def _begin(self, tensions: Floats, pulls: Floats | None) -> None:
        self.command, self.driver.lost = tensions, False
        self.driver.acting.begin()
        self.pulls = None if pulls is None else PullPath(pulls)

    def _drop(self) -> None:
        target = self.target if self.search is None else self.search.target
        self.driver.dropped, self.driver.waiting = target or self.driver.dropped, None
        self.search = self.pending_trajectory = None
        self.mode = Mode()
        self.loop.reset()

    def _require_running(self) -> None:
        if self.latch:
            raise Refusal('stopped', f'stopped: {"; ".join(self.latch.reasons)}; call reset first')
        if self.driver.stopped:
            raise Refusal('driver_stopped', f'the driver does not follow: {self.driver.stopped}')
