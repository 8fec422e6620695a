"""While the arm stands at a target: its freedom used as it is preferred now, and its stiffness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..common.errors import TendonRobotError
from ..model.inverse import judged
from ..model.redundancy import Balance
from ..model.tip_task import TipTask, tip_target

if TYPE_CHECKING:
    from ..model.shape import Reach
    from ..model.stiffness import TipStiffness
    from .solver import GiveUp
    from .state import Controller

Array = NDArray[np.float64]
STEP_N = 0.2  # [N] between two postures on the way: the tip leaves its place by micrometres
STIFFNESS_PERIOD_S = 0.5  # [s] between two looks at the stiffness


@dataclass
class Rebalance:
    """Walks along postures with the same tip, one program after another, until none pays."""

    stiffness: TipStiffness | None = None
    _done: tuple[Any, ...] = ()  # solution and preferences for which nothing pays any more
    _looked: float = -np.inf  # [s]

    def step(self, core: Controller, now: float) -> None:
        """Have the solver look for the next posture, and at the stiffness now and then."""
        if now - self._looked > STIFFNESS_PERIOD_S and not core.solver.busy('stiffness'):
            self._looked = now
            self._look(core)
        wants, solution, target = core.settings.preferences, core.solution, core.target
        closed = core.settings.tip_gain > 0.0
        if wants is None or solution is None or target is None or core.settings.pull_mode:
            return
        if closed or self._done == (solution, wants) or core.solver.busy('balance'):
            return
        model, last, felt = core.model, core.track.last, core.felt_tensions()
        weight, keep_out = core.settings.direction_weight or None, core.settings.keep_out
        asked = tip_target(model, target.position, target.direction, 1.0, weight)

        def work(give_up: GiveUp) -> Reach | None:
            past = model.arrays.fresh_memory()
            if model.remembers:
                past = model.follow(last, felt).memory
            task = TipTask(model, asked, past)
            balance = Balance(task, wants, keep_out)
            trust = STEP_N / float(balance.range.max())
            made, _ = balance.improve(balance.begin(solution.shape), trust)
            return None if made is None else judged(task, made.shape.inputs, made.shape.state)

        def done(found: Reach | None, error: TendonRobotError | None) -> None:
            if core.solution is not solution or core.model is not model:
                return
            if found is None:
                self._done = (solution, wants)
            else:
                core.solution = found

        core.solver.post('balance', work, done)

    def _look(self, core: Controller) -> None:
        model, last = core.model, core.track.last
        if last is None or len(last.bend) != model.robot.cells:
            return
        held, shape = core.settings.pull_mode, last

        def done(found: TipStiffness | None, error: TendonRobotError | None) -> None:
            self.stiffness = found

        core.solver.post('stiffness', lambda give_up: model.tip_stiffness(shape, held), done)

    def values(self) -> dict[str, str]:
        """Say how stiff the tip is, for the status."""
        if self.stiffness is None:
            return {}
        softest, towards = self.stiffness.softest
        axes = (self.stiffness.along(axis) for axis in np.eye(3))
        return {
            'tip_stiffness': ', '.join(f'{value:.3g}' for value in axes) + ' N/m along x, y, z',
            'tip_softest': f'{softest:.3g} N/m along ({", ".join(f"{x:.2f}" for x in towards)})',
        }
