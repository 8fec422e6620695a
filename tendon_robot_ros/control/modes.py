"""
Modes of motion: follow a target or a twist, play a trajectory; null-space motion at a target.

The `step` of a mode returns the goal of the tensions in this cycle. In pull mode the wire pulls
move in pieces, at whose ends the model is evaluated beforehand.

While the arm rests at a target, the solver computes preferred tensions with the same tip. In open
loop the model gives the path there with a constant tip. In closed loop the estimator of the tip's
bias holds the tip (tip_estimator.py).
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from ..common.arrays import Floats
from ..common.estimation import ITERATIONS_MAX
from ..common.rotations import from_rotation_vector
from ..drivers.safety import CYCLE_MAX_S, approach, bounded
from ..model.derivatives import TipStiffness
from ..model.inverse import POSITION_TOLERANCE_M, TOLERANCE_COST_M2, WORTHWHILE_MAX, judged
from ..model.model import Model
from ..model.program import STEP_MAX
from ..model.pulls import command
from ..model.redundancy import Balance, balanced
from ..model.shape import Reach, Shape
from ..model.tip_task import TRACK, Preferences
from .inputs import Target, Trajectory, Twist
from .solver import Failure, GiveUp
from .state import ControllerState, MeasuredState, Mode, Settling, ShapeTracker
from .target_search import STREAM_LENGTH, Approach, SearchRequest, tip_task
from .tip_estimator import NullSpaceMotion

# [s] budget of the solver, and period of the stiffness, so that targets hardly wait for either
SOLVER_PERIOD_S = 0.5


@dataclass
class FollowTarget(Mode):
    """
    Follows a target with the tensions that the search returned.

    Attributes
    ----------
    target : Target
    reach : Reach
        The solution of the search.
    via : list of (m,) [N]
        Tensions to pass before.
    position : (3,) [m] or None
        Desired position of the tip: that of the target, or ahead of it in a stream.
    in_time : bool
        Whether the search finished within its budget.

    """

    target: Target
    reach: Reach
    via: list[Floats] = field(default_factory=list)
    position: Floats | None = None
    in_time: bool = True
    _settling: Settling = field(default_factory=Settling)
    # [m²] cost of the tip beside its place at the last arrival; 0 where no search is to follow
    _missed: float = field(default=np.inf, init=False)

    def step(self, state: ControllerState, passed: float) -> Floats | None:
        """Return the next tensions to pass, then those of the target."""
        if self.via and _same(state.command, self.via[0]):
            measured = None if state.settings.pull_mode else state.driver.tensions
            settled = self._settling.settled
            if measured is None or settled(state.time, self.via[0], measured, state.limits):
                self.via.pop(0)
        elif self._unsure(state) and _same(state.command, self.reach.tensions):
            self._look_back(state, self.reach.tensions)
        return self.via[0] if self.via else state.goal(self.reach.tensions)

    def moving(self, state: ControllerState) -> bool:
        """Whether the command is not yet at its goal, or that goal may change."""
        at_goal = _same(state.command, state.goal(self.reach.tensions))
        return bool(self.via) or not at_goal or self._unsure(state)

    def _unsure(self, state: ControllerState) -> bool:
        """Whether an arm that remembers may have come to another place than the solution's."""
        last_leg = state.settings.approach == 'from_below'  # which no other may follow
        return state.tracks_pulls and self._missed > 0.0 and not last_leg

    def _look_back(self, state: ControllerState, command: Floats) -> None:
        """
        Search again from where the model says that the arm has come to, where it should not be.

        The search takes each cell to bend in a straight line to its end; the arm came on a curve.
        Searches go on while each brings the tip nearer by more than it is worth.
        """
        here, target, most = state.track.last, self.target, WORTHWHILE_MAX * self._missed
        settled = self._settling.settled(state.time, command, command, state.limits)
        if state.solver.busy('again') or not settled:
            return
        task = tip_task(state.model, state.settings, target)
        missed = 0.0 if here is None else task.held_at(self.reach.shape).cost(here)
        self._missed = missed if TOLERANCE_COST_M2 < missed < most else 0.0
        if here is None or self._missed == 0.0:
            return
        now = task.cost(here)

        def done(path: Approach | None, error: Failure) -> None:
            if path is not None and task.cost(path.reach.shape) < now:
                self.reach = path.reach
            else:
                self._missed = 0.0

        request = SearchRequest.of(state, state.model, target, TRACK)
        state.solver.post('again', request.answer, done)


@dataclass
class FollowTwist(Mode):
    """Moves the tip with the last received velocity, from its present position."""

    twist: Twist
    received: float  # monotonic [s]
    reach: Reach | None = None  # the last solution
    position: Floats | None = None  # (3,) [m] desired, None before the first shape
    direction: Floats = field(default_factory=lambda: np.zeros(3))
    axes: Floats = field(default_factory=lambda: np.eye(3))  # of the tip, as columns
    problem: str = ''  # why there are no tensions for it
    _due: float = 0.0  # [s] of motion that is not yet requested

    def begin(self, track: ShapeTracker, shape: Shape | None, error: Failure) -> None:
        """Begin at a shape, which is the last one then; without one the error ends the twist."""
        if shape is None:
            self.problem = str(error)
        else:
            track.accept(shape)
            self.position, self.direction = shape.tip_position.copy(), shape.tip_direction.copy()
            self.axes = shape.frames[-1].copy()

    def step(self, state: ControllerState, passed: float) -> Floats | None:
        """Request the next tensions from the solver; return the last ones that it found."""
        timed_out = state.time - self.received > state.settings.twist_timeout
        if timed_out or self.problem or not self.twist.moves:
            return None  # the arm stops
        self._due = min(self._due + passed, CYCLE_MAX_S)  # no jump after a late solution
        if self.position is not None and not state.solver.busy('twist'):
            request = SearchRequest.of(state, state.model, self._advanced(state), TRACK)
            # farther ahead, the desired tip would come back late
            ahead_max = 0.1 * STREAM_LENGTH * state.model.robot.length

            def done(path: Approach | None, error: Failure) -> None:
                if path is None:
                    self.problem = str(error)
                    return
                self.reach, shape = path.reach, path.reach.shape
                self.axes = shape.frames[-1]
                if request.target.direction is None:  # a turn begins where the tip looks
                    self.direction = shape.tip_direction.copy()
                assert self.position is not None
                ahead = self.position - shape.tip_position
                distance = float(np.linalg.norm(ahead))
                if distance > ahead_max:  # the desired tip stays near the reachable one
                    self.position = shape.tip_position + ahead * (ahead_max / distance)

            state.solver.post('twist', request.answer, done)
        if self.problem:
            return None
        return state.command if self.reach is None else self.reach.tensions

    def _advanced(self, state: ControllerState) -> Target:
        """Advance the desired pose by the time that is not yet requested."""
        linear, angular = self.twist.linear, self.twist.angular
        if self.twist.in_tip:
            linear, angular = self.axes @ linear, self.axes @ angular
        assert self.position is not None
        self.position = self.position + linear * self._due
        self.direction = from_rotation_vector(angular * self._due) @ self.direction
        self._due = 0.0
        oriented = state.settings.hold_direction or bool(angular.any())
        return Target(self.position, self.direction if oriented else None)

    def moving(self, state: ControllerState) -> bool:
        """Whether the command is not yet at its goal."""
        return self.reach is not None and not _same(state.command, self.reach.tensions)


@dataclass
class PlayTrajectory(Mode):
    """Plays a trajectory of the tendons and holds its end."""

    trajectory: Trajectory

    def step(self, state: ControllerState, passed: float) -> Floats | None:
        """Return the values at the present time."""
        return self.trajectory.at(state.time)

    def moving(self, state: ControllerState) -> bool:
        """Whether the command is not yet at the end."""
        return not _same(state.commanded, self.trajectory.values[-1])


def _same(command: Floats | None, goal: Floats) -> bool:
    """Whether a command (m,) is at its goal."""
    return command is not None and np.array_equal(command, goal)


@dataclass
class PullPath:
    """
    Commanded wire pulls (m,) [m], and the shapes at the ends of the next pieces.

    The solver evaluates a piece while the previous one is played; if it is late, the arm waits.
    """

    pulls: Floats
    ahead: deque[Shape] = field(default_factory=deque)
    _played: Floats | None = None  # (m,) [N] that belong to the pulls of a trajectory

    def advance(self, state: ControllerState, goal: Floats, step: float) -> Floats:
        """Move by a step [N] towards a goal (m,) [N]; return the tensions (m,) [N] there."""
        tensions, self._played = state.command, None
        assert tensions is not None
        if np.array_equal(tensions, goal):
            self.ahead.clear()
        self._request_piece(state, tensions, goal)
        while self.ahead and step > 0.0:
            end = self.ahead[0]
            size = float(np.abs(end.inputs - tensions).max())
            part = 1.0 if size <= step else step / size
            tensions = tensions + part * (end.inputs - tensions)
            self.pulls = self.pulls + part * (end.pulls - self.pulls)
            step -= size
            if part == 1.0:
                tensions, self.pulls = end.inputs.copy(), end.pulls.copy()
                self.ahead.popleft()
        self._request_piece(state, tensions, goal)
        return tensions

    def _request_piece(self, state: ControllerState, tensions: Floats, goal: Floats) -> None:
        """Request the shape at the end of the next piece."""
        if len(self.ahead) >= 2 or state.solver.busy('piece'):
            return
        last = self.ahead[-1] if self.ahead else None
        begin = tensions if last is None else last.inputs
        # wire pulls are straight lines in between, because the tensions hardly change
        step = 0.5 * CYCLE_MAX_S * state.settings.rate_limit
        end = approach(begin, goal, np.full_like(goal, step))
        if np.array_equal(begin, end) and not state.track.problem:
            return
        track, now = state.track, state.time
        find = track.shape_work(end, last)
        begun = last or track.last
        past = track.model.arrays.fresh_memory() if begun is None else begun.memory
        pulls = self.pulls if last is None else last.pulls

        def work(give_up: GiveUp) -> Shape:
            shape = find(give_up)
            command(track.model, shape, past, pulls)
            return shape

        def done(shape: Shape | None, error: Failure) -> None:
            if track is not state.track:
                return
            if shape is None:
                track.failed(now, str(error))
                return
            track.recovered()
            if (self.ahead[-1] if self.ahead else None) is last:
                self.ahead.append(shape)

        state.solver.post('piece', work, done)

    def play(self, state: ControllerState, pulls: Floats) -> Floats:
        """Command wire pulls (m,) [m] at once; return the last known tensions (m,) [N] there."""
        tensions = state.command if self._played is None else self._played
        assert tensions is not None
        self.pulls, self._played = pulls, tensions
        self.ahead.clear()
        if state.solver.busy('playing'):
            return tensions
        model, guess, limits = state.model, state.track.last, state.limits
        measured = MeasuredState(np.full(len(pulls), np.nan), pulls, state.time)

        def work(give_up: GiveUp) -> Floats:
            return bounded(measured.in_newtons(model, limits, guess, tensions), limits)

        def done(tensions: Floats | None, error: Failure) -> None:
            if tensions is not None:
                self._played = tensions

        state.solver.post('playing', work, done)
        return self._played


@dataclass
class NullSpace:
    """Moves the tensions of an arm at rest to preferred ones; reports the stiffness of the tip."""

    stiffness: TipStiffness | None = None
    # for which the next fields hold
    _valid_for: tuple[Target | None, Preferences | None, Model | None] = (None, None, None)
    _tensions: Floats | None = None  # (m,) [N] preferred
    _enough: float = np.inf  # [N/m] in the preferred direction, at which the motion ends
    _over: bool = False
    _stiffness_time: float = -np.inf  # [s] of the last request

    def step(self, state: ControllerState) -> None:
        """Request the next posture from the solver, and the stiffness periodically."""
        due = state.time - self._stiffness_time > SOLVER_PERIOD_S
        if due and not state.solver.busy('stiffness'):
            self._stiffness_time = state.time
            self._update_stiffness(state)
        preferences, solution, target = state.settings.preferences, state.solution, state.target
        if preferences is None or solution is None or target is None or state.settings.pull_mode:
            return  # given wire lengths leave no null space
        if state.solver.busy('balance'):
            return
        known, wanted, model = self._valid_for
        if not (known is target and wanted == preferences and model is state.model):  # restart
            self._valid_for, self._tensions = (target, preferences, state.model), None
            self._over, state.loop.motion = False, None
        if not self._over:
            self._request_posture(state, target, preferences, solution)

    def _request_posture(
        self, state: ControllerState, target: Target, preferences: Preferences, solution: Reach
    ) -> None:
        """Request the preferred tensions, and in open loop the next posture."""
        model, last, acting = state.model, state.track.last, state.acting_tensions()
        settings, command, unbiased = state.settings, state.command, state.without_bias(target)
        known, valid_for, closed = self._tensions, self._valid_for, settings.tip_gain > 0.0
        assert command is not None

        def work(give_up: GiveUp) -> tuple[Floats, float, Reach | None]:
            past = model.follow(last, acting).memory if model.remembers else None
            task = tip_task(model, settings, unbiased, past)
            # a target out of reach: keep the tip of the solution
            held = task if solution.status == 'reached' else task.held_at(solution.shape)
            balance = Balance(held, preferences, settings.keep_out)
            start = task.shape(command, solution.shape.state)
            if closed:  # no limit of the stiffness: the motion ends where it is enough
                unlimited = replace(preferences, stiffness_enough=0.0)
                further = Balance(held, unlimited, settings.keep_out)
                preferred = balanced(further, start, ITERATIONS_MAX, give_up)
                stiff = preferences.stiffness > 0.0
                enough = float(np.exp(balance.log_stiffness(preferred))) if stiff else np.inf
                return preferred.inputs, enough, None
            tensions = known
            if tensions is None:
                tensions = balanced(balance, start, ITERATIONS_MAX, give_up).inputs
            posture = _step_towards(balance, start, tensions)
            reach = None if posture is None else judged(task, posture.inputs, posture.state)
            return tensions, np.inf, reach

        def done(solved: tuple[Floats, float, Reach | None] | None, error: Failure) -> None:
            if state.solution is not solution or self._valid_for is not valid_for:
                return
            self._over = True
            if solved is None:
                return
            self._tensions, self._enough, posture = solved
            if posture is not None:
                self._over = False
                state.mode.reach = posture
            elif closed:
                start = state.goal(solution.tensions)
                state.loop.motion = NullSpaceMotion.begin(solution, self._tensions, start)

        state.solver.post('balance', work, done, SOLVER_PERIOD_S)

    def _update_stiffness(self, state: ControllerState) -> None:
        """Request the stiffness of the tip; a motion ends where it is enough."""
        model, shape, preferences = state.model, state.track.last, state.settings.preferences
        if shape is None or len(shape.bend) != model.robot.cells:
            return
        held = state.settings.pull_mode

        def done(stiffness: TipStiffness | None, error: Failure) -> None:
            self.stiffness, motion = stiffness, state.loop.motion
            if stiffness is None or motion is None or preferences is None:
                return
            along = np.array(preferences.stiffness_direction)
            stiff = stiffness.along(along) if along.any() else stiffness.softest[0]
            if stiff >= self._enough:
                goal = state.goal(motion.solution.tensions)
                state.loop.motion = replace(motion, tensions=goal)

        state.solver.post('stiffness', lambda give_up: model.tip_stiffness(shape, held), done)

    def values(self) -> dict[str, str]:
        """Return the stiffness of the tip for the status."""
        if (stiffness := self.stiffness) is None:
            return {}
        softest, towards = stiffness.softest
        values = {'tip_stiffness_softest (N/m)': f'{softest:.4g}'}
        for axis, along, part in zip('xyz', np.eye(3), towards, strict=True):
            values[f'tip_stiffness_{axis} (N/m)'] = f'{stiffness.along(along):.4g}'
            values[f'tip_softest_direction_{axis}'] = f'{part:.4f}'
        return values


def _step_towards(balance: Balance, start: Shape, tensions: Floats) -> Shape | None:
    """Return the next posture towards tensions (m,) [N] with the same tip, None without one."""
    change = tensions - start.inputs
    size, step = float(np.abs(change / balance.range).max()), STEP_MAX
    if size < 0.05 * step:
        return None
    moved = balance.solve_at(balance.begin(start), start.inputs + min(1.0, step / size) * change)
    if moved is None:
        return None
    posture = balance.corrected(moved).shape
    if np.abs((tensions - posture.inputs) / balance.range).max() > size - 0.05 * min(step, size):
        return None  # no step keeps the tip in place
    near = balance.keep_out.clearance(posture.positions).distance
    return posture if near > -POSITION_TOLERANCE_M else None
