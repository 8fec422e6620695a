"""While the arm stands at a target: its freedom used as it is preferred now, and its stiffness."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ..common.errors import TendonRobotError
from ..model.inverse import CLEARANCE_BINDS_M, judged
from ..model.redundancy import Balance, balanced
from ..model.tip_task import TipTask, tip_target
from .state import Controller
from .walk import Led

if TYPE_CHECKING:
    from ..model.derivatives import TipStiffness
    from ..model.model import Model
    from ..model.redundancy import Preferences
    from ..model.shape import Reach, Shape
    from .solver import GiveUp
    from .state import Target
    from .tip_loop import TipLoop

Array = NDArray[np.float64]
NEAR_SHARE = 0.05  # [1] of a step: as good as there
STEP_N = 0.2  # [N] between two postures on the way: the tip leaves its place by micrometres
PROGRAMS_MAX, BUDGET_S = 40, 0.5  # to find where the walk leads, and their time [s]
STIFFNESS_PERIOD_S = 0.5  # [s] between two looks at the stiffness


class Standing(Controller, Protocol):
    """A controller whose arm may stand at a target that the tip is held at."""

    loop: TipLoop


@dataclass
class Rebalance:
    """Walks along postures with the same tip to the one that is preferred."""

    stiffness: TipStiffness | None = None
    _walk: tuple[Target, Preferences, Model] | None = None  # for which the two below are
    _aim: Array | None = None  # (m,) [N] where it leads
    _over: bool = False
    _looked: float = -np.inf  # [s]
    _said: tuple[TipStiffness, dict[str, str]] | None = None  # the words for a stiffness

    def step(self, core: Standing, now: float) -> None:
        """Have the solver look for the next posture, and at the stiffness now and then."""
        if now - self._looked > STIFFNESS_PERIOD_S and not core.solver.busy('stiffness'):
            self._looked = now
            self._look(core)
        wants, solution, target = core.settings.preferences, core.solution, core.target
        if wants is None or solution is None or target is None or core.settings.pull_mode:
            return  # wires of given lengths leave no freedom
        if core.solver.busy('balance'):
            return
        if not self._is_for(core, target, wants):
            self._walk = (target, wants, core.model)
            self._aim, self._over = None, False
            core.loop.lead(None)
        if not self._over:
            self._ask(core, target, wants, solution)

    def _is_for(self, core: Standing, target: Target, wants: Preferences) -> bool:
        walk = self._walk
        if walk is None or walk[0] is not target or walk[2] is not core.model:
            return False
        return walk[1] == wants

    def _ask(self, core: Standing, target: Target, wants: Preferences, solution: Reach) -> None:
        """Have the solver look for the next posture."""
        model, last, felt = core.model, core.track.last, core.felt_tensions()
        weight, keep_out = core.settings.direction_weight or None, core.settings.keep_out
        position, command = target.position, core.command
        if position is not None:
            position = position - core.tip_shift(position)
        asked = tip_target(model, position, target.direction, 1.0, weight)
        aim, walk, closed = self._aim, self._walk, core.settings.tip_gain > 0.0
        assert command is not None

        def work(give_up: GiveUp) -> tuple[Led, Reach | None]:
            past = model.arrays.fresh_memory()
            if model.remembers:
                past = model.follow(last, felt).memory
            target_task = task = TipTask(model, asked, past)
            if solution.status != 'reached':  # what is beyond reach is not asked for again
                task = target_task.held_at(solution.shape)
            balance = Balance(task, _further(wants) if closed else wants, keep_out)
            here = balance.task.shape(command, solution.shape.state)
            if closed:
                there = balanced(balance, here, PROGRAMS_MAX, give_up)
                return _led(Balance(task, wants), solution, there), None
            wanted = aim
            if wanted is None:
                wanted = balanced(balance, here, PROGRAMS_MAX, give_up).inputs
            return Led(solution, wanted), _nearer(balance, target_task, here, wanted)

        def done(found: tuple[Led, Reach | None] | None, error: TendonRobotError | None) -> None:
            if core.solution is not solution or self._walk is not walk:
                return
            if found is None or found[1] is None:
                self._over = True
                if closed and found is not None:
                    core.loop.lead(found[0])  # it goes there as far as the tip allows
            else:
                self._aim, core.solution = found[0].tensions, found[1]

        core.solver.post('balance', work, done, BUDGET_S)

    def _look(self, core: Standing) -> None:
        model, last = core.model, core.track.last
        if last is None or len(last.bend) != model.robot.cells:
            return
        held, shape = core.settings.pull_mode, last

        def done(found: TipStiffness | None, error: TendonRobotError | None) -> None:
            self.stiffness = found

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


def _further(wants: Preferences) -> Preferences:
    """Return preferences that lead beyond what is enough: a walk ends on its way there."""
    return replace(wants, stiffness_enough=0.0)


def _led(balance: Balance, solution: Reach, wanted: Shape) -> Led:
    """Return the walk to a posture; it is over where the tip already is as stiff as there."""
    if balance.preferences.stiffness == 0.0:
        return Led(solution, wanted.inputs)
    enough = balance.log_stiffness(wanted)
    return Led(solution, wanted.inputs, lambda shape: balance.log_stiffness(shape) >= enough)


def _nearer(balance: Balance, task: TipTask, here: Shape, wanted: Array) -> Reach | None:
    """Return the next posture on the way to tensions (m,) [N], with the tip where it was."""
    longest = STEP_N
    way = wanted - here.inputs
    size = float(np.abs(way).max())
    if size < longest * NEAR_SHARE:
        return None
    at = balance.begin(here)
    next_one = balance.look(at, here.inputs + min(1.0, longest / size) * way)
    if next_one is None:
        return None
    made = balance.corrected(next_one)
    if np.abs(wanted - made.shape.inputs).max() > size - NEAR_SHARE * min(longest, size):
        return None  # there is no way on along which the tip stays
    found = judged(task, made.shape.inputs, made.shape.state)
    near = balance.keep_out.clearance(made.shape.positions).distance
    return found if near > -CLEARANCE_BINDS_M else None
