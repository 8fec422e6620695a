"""Another model while the arm is controlled: what was asked for goes on with it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError, TendonRobotError
from .checks import check_inputs
from .seeking import Seeker, seek, solution_of
from .solver import GiveUp
from .state import ShapeTracker, Target

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Reach
    from .jog import Jog
    from .tip_loop import TipLoop
    from .trajectory import Playing, Way

Array = NDArray[np.float64]


class Changing(Seeker, Protocol):
    """A controller whose model may change."""

    jog: Jog | None
    loop: TipLoop
    way: Way | None
    via: list[Array]
    playing: Playing | None


def change_model(
    core: Changing, model: Model, on_done: Callable[[TendonRobotError | None], None]
) -> None:
    """
    Change the model; tensions then move to its solution at `rate_limit`.

    `on_done` hears None, or why the old one stays: an InputError for other inputs, a
    NoEquilibriumError when it finds none at the present tensions or for the target.
    """
    try:
        check_inputs(model.inputs, core.model.inputs)
    except InputError as error:
        on_done(error)
        return
    command, target = core.command, core.target
    solve = None if target is None else solution_of(core, model, target)

    def work(give_up: GiveUp) -> Reach | None:
        if command is not None:
            model.shape(command)
        return None if solve is None else solve(give_up).reach

    def done(solution: Reach | None, error: TendonRobotError | None) -> None:
        if error is None:
            _use(core, model, target, solution)
        on_done(error)

    core.solver.post('model', work, done)


def _use(core: Changing, model: Model, target: Target | None, solution: Reach | None) -> None:
    """Change the model: what was asked for, and what was accepted, goes on with it."""
    core.model, core.jog, core.track = model, None, ShapeTracker(model)
    core.via = []
    core.loop.reset()
    if core.way is not None:
        core.way = core.way.anew()
    if core.playing is not None and not core.settings.pull_mode:
        core.playing = core.playing.within(core.settings.limits(model))
    searched = core.search.target if core.search is not None else None
    if target is core.target:
        core.solution = solution
    elif searched is None:
        searched = core.target  # it came meanwhile
    if searched is not None:
        seek(core, searched)
