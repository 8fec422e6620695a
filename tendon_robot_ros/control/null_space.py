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
from ..model.inverse import CLEARANCE_BINDS_M, judged
from ..model.program import STEP_MAX, STEP_SHARE, bounded_step
from ..model.redundancy import Balance, balanced
from .state import Controller
from .target_search import tip_task

if TYPE_CHECKING:
    from ..model.derivatives import TipStiffness
    from ..model.model import Model
    from ..model.shape import Reach, Shape
    from ..model.tip_task import Preferences, TipTask
    from .solver import GiveUp
    from .state import Target
    from .tip_estimator import TipEstimate
    from .tip_step import TipStep

Array = NDArray[np.float64]
STEP_N = 0.2  # [N] between two postures in open loop: the tip leaves its place by micrometres
PROGRAMS_MAX, BUDGET_S = 40, 0.5  # to find the preferred tensions, and the time for it [s]
STIFFNESS_PERIOD_S = 0.5  # [s] between two looks at the stiffness
SPEED_MAX = 0.002  # [1/s] of the ranges: faster, the tip's bias changes before it is estimated
DRIFT = 5e-4  # [1/s] of the length: velocity of the tip, 1 sd, that doubt of slopes may cause
SLOPE_SD = 0.5  # [1] of the arm's length over the ranges: bias that such a motion causes, 1 sd
HOLD_GAIN = 0.5  # [1/s] of the estimator: slower than `tip_gain`, since only noise moves the tip
STANDS_SHARE = 2e-3  # [1] of the ranges: nearer to its goal, an arm counts as standing
HANDOVER_SHARE = 3e-3  # [1] of the arm's length: further from its place, something pushes the tip


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
        if away > HANDOVER_SHARE * length:
            return None, goal  # the tip loop takes over
        there, width = tip.there(goal), known.range
        slopes, still = tip.slopes_at(there) + known.slopes, np.zeros(3)
        left = self.signs * np.maximum(self.signs * (self.tensions - goal) / width, 0.0)
        wish = left * min(1.0, STEP_MAX / max(float(np.abs(left).max()), 1e-12))
        free = bounded_step(slopes, still, goal, tip.limits, least=wish, signs=self.signs) - goal
        step = free / width
        size = max(float(np.abs(step).max()), 1e-12)
        if size < STANDS_SHARE and away < 2.0 * known.rest:
            return self, goal  # it is over: noise would have tensions rise for ever
        drift = DRIFT * length
        speed = drift / max(known.slope_sd(step / size), drift / SPEED_MAX)
        step *= min(1.0, speed * passed / size)
        miss = STEP_SHARE * (self.place - there.tip_position - known.bias_at(goal))
        return self, bounded_step(slopes, miss, goal, tip.limits, least=step, signs=self.signs)


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
        if now - self._looked > STIFFNESS_PERIOD_S and not core.solver.busy('stiffness'):
            self._looked = now
            self._look(core)
        wants, solution, target = core.settings.preferences, core.solution, core.target
        if wants is None or solution is None or target is None or core.settings.pull_mode:
            return None  # wires of given lengths leave no freedom
        if self._nearer is None and not core.solver.busy('balance'):
            self._go_on(core, target, wants, solution)
        nearer, self._nearer = self._nearer, None
        return nearer[1] if nearer is not None and nearer[0] is solution else None

    def _go_on(self, core: Standing, target: Target, wants: Preferences, solution: Reach) -> None:
        """Begin anew for another target, other preferences or another model; else go on."""
        last = self._for
        if last is None or not (last[0] is target and last[1] == wants and last[2] is core.model):
            self._for, self._tensions, self._over = (target, wants, core.model), None, False
            core.begin_motion(None)
        if not self._over:
            self._ask(core, target, wants, solution)

    def _ask(self, core: Standing, target: Target, wants: Preferences, solution: Reach) -> None:
        """Have the solver look for the preferred tensions, and in open loop for the next ones."""
        model, last, acting = core.model, core.track.last, core.acting_tensions()
        keep_out, position, command = core.settings.keep_out, target.position, core.command
        if position is not None:
            position = position - core.tip_bias(position)
        asked, settings = replace(target, position=position), core.settings
        known, wanted_for, closed = self._tensions, self._for, core.settings.tip_gain > 0.0
        assert command is not None

        def work(give_up: GiveUp) -> tuple[Array, float, Reach | None]:
            past = model.arrays.fresh_memory()
            if model.remembers:
                past = model.follow(last, acting).memory
            target_task = task = tip_task(model, settings, asked, past)
            if solution.status != 'reached':  # what is beyond reach is not asked for again
                task = target_task.held_at(solution.shape)
            balance = Balance(task, wants, keep_out)
            here = task.shape(command, solution.shape.state)
            if closed:  # beyond what is stiff enough, since the motion ends on its way there
                further = Balance(task, replace(wants, stiffness_enough=0.0), keep_out)
                there = balanced(further, here, PROGRAMS_MAX, give_up)
                stiff = wants.stiffness > 0.0
                enough = float(np.exp(balance.log_stiffness(there))) if stiff else np.inf
                return there.inputs, enough, None
            tensions = known
            if tensions is None:
                tensions = balanced(balance, here, PROGRAMS_MAX, give_up).inputs
            return tensions, np.inf, _nearer(balance, target_task, here, tensions)

        def done(
            found: tuple[Array, float, Reach | None] | None, error: TendonRobotError | None
        ) -> None:
            if core.solution is not solution or self._for is not wanted_for:
                return
            if found is None:
                self._over = True
                return
            self._tensions, self._enough, nearer = found
            if nearer is not None:
                self._nearer = solution, nearer
                return
            self._over = True
            if closed:
                here = core.goal(solution.tensions)
                core.begin_motion(NullSpaceMotion.begin(solution, self._tensions, here))

        core.solver.post('balance', work, done, BUDGET_S)

    def _look(self, core: Standing) -> None:
        """Have the solver look how stiff the tip is; a motion ends where that is enough."""
        model, shape, wants = core.model, core.track.last, core.settings.preferences
        if shape is None or len(shape.bend) != model.robot.cells:
            return
        held = core.settings.pull_mode

        def done(found: TipStiffness | None, error: TendonRobotError | None) -> None:
            self.stiffness, motion = found, core.motion
            if found is None or motion is None or wants is None:
                return
            along = np.array(wants.stiffness_direction)
            stiff = found.along(along) if along.any() else found.softest[0]
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


def _nearer(balance: Balance, task: TipTask, here: Shape, tensions: Array) -> Reach | None:
    """Return the next posture towards tensions (m,) [N] with the same tip; None: there is none."""
    change = tensions - here.inputs
    size = float(np.abs(change).max())
    if size < 0.05 * STEP_N:
        return None
    looked = balance.look(balance.begin(here), here.inputs + min(1.0, STEP_N / size) * change)
    if looked is None:
        return None
    made = balance.corrected(looked).shape
    if np.abs(tensions - made.inputs).max() > size - 0.05 * min(STEP_N, size):
        return None  # the tip stays on no way there
    near = balance.keep_out.clearance(made.positions).distance
    return judged(task, made.inputs, made.state) if near > -CLEARANCE_BINDS_M else None
