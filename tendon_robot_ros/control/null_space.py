"""
Null-space motion: tensions go to those that are preferred while the tip stays.

While the arm stands at a target, the solver looks for the preferred tensions with the same tip. In
open loop the model says how to get there with the tip held. In closed loop the estimator of the
tip's bias holds the tip meanwhile, and the motion is as fast as the estimate is good. No tension
reverses on it: with friction it would stick, and later let the arm slip all at once.
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
# [s] of the solver, and between two looks at the stiffness, so that targets hardly wait for either
SOLVER_PERIOD_S = 0.5
# [1/s] of the ranges: faster, the tip's bias would change before it is estimated (docs/control.md)
SPEED_MAX = 0.002
# [1/s] of the length: velocity of the tip, 1 sd, that doubt of slopes may cause: 0.1 mm/s on 208
# mm, so that the tracker sees it before it is a millimetre (docs/control.md)
DRIFT = 5e-4
# [1] of the arm's length over the ranges: bias that such a motion causes, 1 sd, because on an arm
# that is not its model the tip leaves its place by a quarter of it and more (docs/control.md)
SLOPE_LENGTH_SD = 0.5
# [1/s] of the estimator: slower than `tip_gain`, because only noise moves the tip
# (docs/control.md)
HOLD_GAIN = 0.5
# [1] of the arm's length: further from its place something pushes the tip, because the motion
# alone moves it by less: 0.6 mm on 208 mm (docs/control.md)
HANDOVER_LENGTH = 3e-3


@dataclass(frozen=True)
class NullSpaceMotion:
    """
    The motion in closed loop.

    Attributes
    ----------
    solution : Reach
        Of the target at which the tip stays.
    tensions : (m,) [N]
        The preferred ones.
    signs : (m,)
        1: a tension that only rises, -1: that only falls.
    place : (3,) [m] or None
        Where the tip is held; None until its bias is known well enough to begin.

    """

    solution: Reach
    tensions: Array
    signs: Array
    place: Array | None = None

    @classmethod
    def begin(cls, solution: Reach, tensions: Array, here: Array) -> NullSpaceMotion:
        """Begin at tensions (m,) [N]."""
        return cls(solution, tensions, np.where(tensions >= here, 1.0, -1.0))

    def step(
        self, tip: TipStep, goal: Array, known: TipEstimate, passed: float
    ) -> tuple[NullSpaceMotion | None, Array]:
        """
        Return the motion and the next goal (m,) [N]; None for a motion that is over.

        Parameters
        ----------
        tip : TipStep
            Where the tip is, and how tensions move it.
        goal : (m,) [N]
            The last one.
        known : TipEstimate
            What is known of the tip's bias.
        passed : float
            Since the last step [s].

        """
        here = tip.here.tip_position + known.bias
        if self.place is None:
            settled = known.covariance[0, 0] < 2.0 * HOLD_GAIN * passed  # twice its last variance
            return replace(self, place=here) if settled else self, goal
        away, length = float(np.linalg.norm(self.place - here)), tip.model.robot.length
        if away > HANDOVER_LENGTH * length:
            return None, goal  # the tip loop takes over
        there, width = tip.there(goal), known.range
        slopes = tip.slopes_at(there) + known.slopes
        left = self.signs * np.maximum(self.signs * (self.tensions - goal) / width, 0.0)
        wish = left * min(1.0, STEP_MAX / max(float(np.abs(left).max()), 1e-12))

        def step(wanted: Array, preferred: Array) -> Array:
            return bounded_step(
                slopes, wanted, goal, tip.limits, preferred=preferred, signs=self.signs
            )

        free = (step(np.zeros(3), wish) - goal) / width
        size = max(float(np.abs(free).max()), 1e-12)
        if size < RANGE_TOLERANCE and away < 2.0 * known.rest:
            return self, goal  # it is over: noise would have tensions rise for ever
        drift = DRIFT * length
        speed = drift / max(known.slope_sd(free / size), drift / SPEED_MAX)
        miss = STEP_GAIN * (self.place - there.tip_position - known.bias_at(goal))
        return self, step(miss, free * min(1.0, speed * passed / size))


class Standing(Controller, Protocol):
    """An arm that may stand at a target."""

    @property
    def motion(self) -> NullSpaceMotion | None:
        """The null-space motion that has the arm in closed loop."""

    def begin_motion(self, motion: NullSpaceMotion | None) -> None:
        """Give the arm to a null-space motion; None ends one."""


@dataclass
class NullSpace:
    """Has the tensions of a standing arm go to the preferred ones; how stiff the tip is."""

    stiffness: TipStiffness | None = None
    _for: tuple[Target, Preferences, Model] | None = None  # what the next three are for
    _tensions: Array | None = None  # (m,) [N] the preferred ones
    _enough: float = np.inf  # [N/m] along the preferred direction: as stiff as with these
    _over: bool = False
    _nearer: tuple[Reach, Reach] | None = None  # the solution that was, and the next posture
    _looked: float = -np.inf  # [s]
    _said: tuple[TipStiffness, dict[str, str]] | None = None  # the words for a stiffness

    def step(self, core: Standing, now: float) -> Reach | None:
        """
        Have the solver look for the next posture, and at the stiffness now and then.

        Returns the next posture in open loop, None where there is no other one yet.
        """
        if now - self._looked > SOLVER_PERIOD_S and not core.solver.busy('stiffness'):
            self._looked = now
            self._look_at_stiffness(core)
        wants, solution, target = core.settings.preferences, core.solution, core.target
        if wants is None or solution is None or target is None or core.settings.pull_mode:
            return None  # wires of given lengths leave no freedom
        if self._nearer is None and not core.solver.busy('balance'):
            last = self._for
            if (
                last is None
                or not (last[0] is target and last[2] is core.model)
                or last[1] != wants
            ):  # begin anew
                self._for, self._tensions, self._over = (target, wants, core.model), None, False
                core.begin_motion(None)
            if not self._over:
                self._ask(core, target, wants, solution)
        nearer, self._nearer = self._nearer, None
        return nearer[1] if nearer is not None and nearer[0] is solution else None

    def _ask(self, core: Standing, target: Target, wants: Preferences, solution: Reach) -> None:
        """Have the solver look for the preferred tensions, and in open loop for the next ones."""
        model, last, acting = core.model, core.track.last, core.acting_tensions()
        settings, command, wanted = core.settings, core.command, target
        if target.position is not None:
            wanted = replace(target, position=target.position - core.tip_bias(target.position))
        known, wanted_for, closed = self._tensions, self._for, settings.tip_gain > 0.0
        assert command is not None

        def work(give_up: GiveUp) -> tuple[Array, float, Reach | None]:
            past = model.follow(last, acting).memory if model.remembers else None
            task = tip_task(model, settings, wanted, past)
            # what is beyond reach is not asked for again
            held = task if solution.status == 'reached' else task.held_at(solution.shape)
            balance = Balance(held, wants, settings.keep_out)
            here = task.shape(command, solution.shape.state)
            if closed:  # beyond what is stiff enough, since the motion ends on its way there
                further = Balance(held, replace(wants, stiffness_enough=0.0), settings.keep_out)
                there = balanced(further, here, BALANCE_STEPS_MAX, give_up)
                stiff = wants.stiffness > 0.0
                enough = float(np.exp(balance.log_stiffness(there))) if stiff else np.inf
                return there.inputs, enough, None
            tensions = known
            if tensions is None:
                tensions = balanced(balance, here, BALANCE_STEPS_MAX, give_up).inputs
            made = _step_towards(balance, here, tensions)
            return (
                tensions,
                np.inf,
                None if made is None else judged(task, made.inputs, made.state),
            )

        def done(
            solved: tuple[Array, float, Reach | None] | None, error: TendonRobotError | None
        ) -> None:
            if core.solution is not solution or self._for is not wanted_for:
                return
            if solved is None:
                self._over = True
                return
            self._tensions, self._enough, nearer = solved
            if nearer is not None:
                self._nearer = solution, nearer
                return
            self._over = True
            if closed:
                here = core.goal(solution.tensions)
                core.begin_motion(NullSpaceMotion.begin(solution, self._tensions, here))

        core.solver.post('balance', work, done, SOLVER_PERIOD_S)

    def _look_at_stiffness(self, core: Standing) -> None:
        """Have the solver look how stiff the tip is; a motion ends where that is enough."""
        model, shape, wants = core.model, core.track.last, core.settings.preferences
        if shape is None or len(shape.bend) != model.robot.cells:
            return
        held = core.settings.pull_mode

        def done(stiffness: TipStiffness | None, error: TendonRobotError | None) -> None:
            self.stiffness, motion = stiffness, core.motion
            if stiffness is None or motion is None or wants is None:
                return
            along = np.array(wants.stiffness_direction)
            stiff = stiffness.along(along) if along.any() else stiffness.softest[0]
            if stiff >= self._enough:
                goal = core.goal(motion.solution.tensions)
                core.begin_motion(replace(motion, tensions=goal))

        core.solver.post('stiffness', lambda give_up: model.tip_stiffness(shape, held), done)

    def values(self) -> dict[str, str]:
        """Say how stiff the tip is, for the status."""
        stiffness = self.stiffness
        if stiffness is None:
            return {}
        if self._said is not None and self._said[0] is stiffness:
            return self._said[1]
        softest, towards = stiffness.softest
        words = {'tip_stiffness_softest (N/m)': f'{softest:.4g}'}
        for axis, along, part in zip('xyz', np.eye(3), towards, strict=True):
            words[f'tip_stiffness_{axis} (N/m)'] = f'{stiffness.along(along):.4g}'
            words[f'tip_softest_direction_{axis}'] = f'{part:.4f}'
        self._said = stiffness, words
        return words


def _step_towards(balance: Balance, here: Shape, tensions: Array) -> Shape | None:
    """Return the next posture towards tensions (m,) [N] with the same tip; None: there is none."""
    change = tensions - here.inputs
    size, step = float(np.abs(change / balance.range).max()), STEP_MAX
    if size < 0.05 * step:
        return None
    looked = balance.solve_at(balance.begin(here), here.inputs + min(1.0, step / size) * change)
    if looked is None:
        return None
    made = balance.corrected(looked).shape
    if np.abs((tensions - made.inputs) / balance.range).max() > size - 0.05 * min(step, size):
        return None  # the tip stays on no way there
    near = balance.keep_out.clearance(made.positions).distance
    return made if near > -CLEARANCE_BINDS_M else None
