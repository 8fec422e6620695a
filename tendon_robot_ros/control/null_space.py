"""
Null-space motion: tensions move to preferred ones while the tip stays in place.

While the arm rests at a target, the solver computes the preferred tensions with the same tip. In
open loop the model gives the path there with a constant tip. In closed loop the estimator of the
tip's bias holds the tip, and the speed follows from the uncertainty of the estimate. No tension
reverses its direction: with friction the tendon would stick, and later let the arm slip suddenly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ..common.errors import TendonRobotError
from ..model.inverse import BALANCE_STEPS_MAX, CLEARANCE_BINDS_M, judged
from ..model.program import STEP_GAIN, STEP_MAX, bounded_step
from ..model.redundancy import Balance, balanced
from .state import Controller
from .target_search import tip_task
from .tip_estimator import RANGE_TOLERANCE

if TYPE_CHECKING:
    from ..model.derivatives import TipStiffness
    from ..model.model import Model
    from ..model.shape import Reach, Shape
    from ..model.tip_task import Preferences
    from .solver import GiveUp
    from .state import Target
    from .tip_estimator import TipEstimate, TipStep

Array = NDArray[np.float64]
# [s] budget of the solver, and period of the stiffness, so that targets hardly wait for either
SOLVER_PERIOD_S = 0.5
# [1/s] of the ranges: faster, the tip's bias would change before it is estimated (docs/control.md)
SPEED_MAX = 0.002
# [1/s] of the length: velocity of the tip, 1 sd, that doubt of slopes may cause: 0.1 mm/s on 208
# mm, so that the tracker measures it before it is a millimetre (docs/control.md)
DRIFT = 5e-4
# [1] of the arm's length over the ranges: bias that such a motion causes, 1 sd, because on an arm
# that differs from its model the tip drifts by a quarter of it and more (docs/control.md)
SLOPE_LENGTH_SD = 0.5
# [1/s] of the estimator: slower than `tip_gain`, because only noise moves the tip
# (docs/control.md)
HOLD_GAIN = 0.5
# [1] of the arm's length: beyond it an external load is assumed, because the motion alone
# moves the tip by less: 0.6 mm on 208 mm (docs/control.md)
HANDOVER_LENGTH = 3e-3


@dataclass(frozen=True)
class NullSpaceMotion:
    """
    A null-space motion in closed loop.

    Attributes
    ----------
    solution : Reach
        The solution for the target at which the tip stays.
    tensions : (m,) [N]
        The preferred tensions.
    signs : (m,)
        1 for a tension that only rises, -1 for one that only falls.
    place : (3,) [m] or None
        Position at which the tip is held; None until its bias is known well enough to begin.

    """

    solution: Reach
    tensions: Array
    signs: Array
    place: Array | None = None

    @classmethod
    def begin(cls, solution: Reach, tensions: Array, current: Array) -> NullSpaceMotion:
        """Return the motion from the current tensions (m,) [N] to the preferred ones."""
        return cls(solution, tensions, np.where(tensions >= current, 1.0, -1.0))

    def step(
        self, tip: TipStep, goal: Array, estimate: TipEstimate, passed: float
    ) -> tuple[NullSpaceMotion | None, Array]:
        """
        Return the motion and the next goal (m,) [N]; None instead of the motion ends it.

        Parameters
        ----------
        tip : TipStep
            Shape by the model and its Jacobian.
        goal : (m,) [N]
            The last goal.
        estimate : TipEstimate
            Estimate of the tip's bias.
        passed : float
            Since the last step [s].

        """
        position = tip.shape.tip_position + estimate.bias
        if self.place is None:
            variance_max = 2.0 * HOLD_GAIN * passed  # twice the final variance of the bias
            settled = estimate.covariance[0, 0] < variance_max
            return replace(self, place=position) if settled else self, goal
        distance, length = float(np.linalg.norm(self.place - position)), tip.model.robot.length
        if distance > HANDOVER_LENGTH * length:
            return None, goal  # the tip loop takes over
        goal_shape, width = tip.shape_at(goal), estimate.range
        slopes = tip.slopes_at(goal_shape) + estimate.slopes
        remaining = self.signs * np.maximum(self.signs * (self.tensions - goal) / width, 0.0)
        wish = remaining * min(1.0, STEP_MAX / max(float(np.abs(remaining).max()), 1e-12))

        def step(tip_motion: Array, preferred: Array) -> Array:
            return bounded_step(
                slopes, tip_motion, goal, tip.limits, preferred=preferred, signs=self.signs
            )

        free = (step(np.zeros(3), wish) - goal) / width
        size = max(float(np.abs(free).max()), 1e-12)
        if size < RANGE_TOLERANCE and distance < 2.0 * estimate.rest:
            return self, goal  # at the end; else noise would raise tensions without limit
        drift = DRIFT * length
        speed = drift / max(estimate.slope_sd(free / size), drift / SPEED_MAX)
        miss = STEP_GAIN * (self.place - goal_shape.tip_position - estimate.bias_at(goal))
        return self, step(miss, free * min(1.0, speed * passed / size))


class StandingArm(Controller, Protocol):
    """Access of the null-space motion to the core."""

    @property
    def motion(self) -> NullSpaceMotion | None:
        """The running null-space motion in closed loop."""

    def begin_motion(self, motion: NullSpaceMotion | None) -> None:
        """Start a null-space motion; None ends it."""


@dataclass
class NullSpace:
    """Moves the tensions of an arm at rest to preferred ones; reports the stiffness of the tip."""

    stiffness: TipStiffness | None = None
    _valid_for: tuple[Target, Preferences, Model] | None = None  # for which the next fields hold
    _tensions: Array | None = None  # (m,) [N] preferred
    _enough: float = np.inf  # [N/m] in the preferred direction, at which the motion ends
    _over: bool = False
    _nearer: tuple[Reach, Reach] | None = None  # the solution before, the next posture
    _stiffness_time: float = -np.inf  # [s] of the last request
    _text: tuple[TipStiffness, dict[str, str]] | None = None  # a stiffness and its status

    def step(self, core: StandingArm, now: float) -> Reach | None:
        """
        Request the next posture from the solver, and the stiffness periodically.

        Returns the next posture in open loop, None before there is one.
        """
        if now - self._stiffness_time > SOLVER_PERIOD_S and not core.solver.busy('stiffness'):
            self._stiffness_time = now
            self._update_stiffness(core)
        preferences, solution, target = core.settings.preferences, core.solution, core.target
        if preferences is None or solution is None or target is None or core.settings.pull_mode:
            return None  # given wire lengths leave no null space
        if self._nearer is None and not core.solver.busy('balance'):
            last = self._valid_for
            if (
                last is None
                or not (last[0] is target and last[2] is core.model)
                or last[1] != preferences
            ):  # restart
                self._valid_for, self._tensions = (target, preferences, core.model), None
                self._over = False
                core.begin_motion(None)
            if not self._over:
                self._request_posture(core, target, preferences, solution)
        posture, self._nearer = self._nearer, None
        return posture[1] if posture is not None and posture[0] is solution else None

    def _request_posture(
        self, core: StandingArm, target: Target, preferences: Preferences, solution: Reach
    ) -> None:
        """Request the preferred tensions, and in open loop the next posture."""
        model, last, acting = core.model, core.track.last, core.acting_tensions()
        settings, command, unbiased = core.settings, core.command, target
        if target.position is not None:
            unbiased = replace(target, position=target.position - core.tip_bias(target.position))
        known, valid_for, closed = self._tensions, self._valid_for, settings.tip_gain > 0.0
        assert command is not None

        def work(give_up: GiveUp) -> tuple[Array, float, Reach | None]:
            past = model.follow(last, acting).memory if model.remembers else None
            task = tip_task(model, settings, unbiased, past)
            # a target out of reach: keep the tip of the solution
            held = task if solution.status == 'reached' else task.held_at(solution.shape)
            balance = Balance(held, preferences, settings.keep_out)
            start = task.shape(command, solution.shape.state)
            if closed:  # no limit of the stiffness: the motion ends where it is enough
                further = Balance(
                    held, replace(preferences, stiffness_enough=0.0), settings.keep_out
                )
                preferred = balanced(further, start, BALANCE_STEPS_MAX, give_up)
                stiff = preferences.stiffness > 0.0
                enough = float(np.exp(balance.log_stiffness(preferred))) if stiff else np.inf
                return preferred.inputs, enough, None
            tensions = known
            if tensions is None:
                tensions = balanced(balance, start, BALANCE_STEPS_MAX, give_up).inputs
            posture = _step_towards(balance, start, tensions)
            return (
                tensions,
                np.inf,
                None if posture is None else judged(task, posture.inputs, posture.state),
            )

        def done(
            solved: tuple[Array, float, Reach | None] | None, error: TendonRobotError | None
        ) -> None:
            if core.solution is not solution or self._valid_for is not valid_for:
                return
            if solved is None:
                self._over = True
                return
            self._tensions, self._enough, posture = solved
            if posture is not None:
                self._nearer = solution, posture
                return
            self._over = True
            if closed:
                start = core.goal(solution.tensions)
                core.begin_motion(NullSpaceMotion.begin(solution, self._tensions, start))

        core.solver.post('balance', work, done, SOLVER_PERIOD_S)

    def _update_stiffness(self, core: StandingArm) -> None:
        """Request the stiffness of the tip; a motion ends where it is enough."""
        model, shape, preferences = core.model, core.track.last, core.settings.preferences
        if shape is None or len(shape.bend) != model.robot.cells:
            return
        held = core.settings.pull_mode

        def done(stiffness: TipStiffness | None, error: TendonRobotError | None) -> None:
            self.stiffness, motion = stiffness, core.motion
            if stiffness is None or motion is None or preferences is None:
                return
            along = np.array(preferences.stiffness_direction)
            stiff = stiffness.along(along) if along.any() else stiffness.softest[0]
            if stiff >= self._enough:
                goal = core.goal(motion.solution.tensions)
                core.begin_motion(replace(motion, tensions=goal))

        core.solver.post('stiffness', lambda give_up: model.tip_stiffness(shape, held), done)

    def values(self) -> dict[str, str]:
        """Return the stiffness of the tip for the status."""
        stiffness = self.stiffness
        if stiffness is None:
            return {}
        if self._text is not None and self._text[0] is stiffness:
            return self._text[1]
        softest, towards = stiffness.softest
        words = {'tip_stiffness_softest (N/m)': f'{softest:.4g}'}
        for axis, along, part in zip('xyz', np.eye(3), towards, strict=True):
            words[f'tip_stiffness_{axis} (N/m)'] = f'{stiffness.along(along):.4g}'
            words[f'tip_softest_direction_{axis}'] = f'{part:.4f}'
        self._text = stiffness, words
        return words


def _step_towards(balance: Balance, start: Shape, tensions: Array) -> Shape | None:
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
    return posture if near > -CLEARANCE_BINDS_M else None
