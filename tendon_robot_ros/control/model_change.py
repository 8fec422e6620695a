"""Another model while the arm is controlled: what was asked for goes on with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ..common.errors import InputError, TendonRobotError
from .checks import check_inputs
from .friction_state import carried
from .seeking import Seeker, question_of, seek
from .solver import GiveUp
from .state import ShapeTracker, Target

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Reach, Shape
    from ..robot import Robot
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

    def begin_anew(self) -> None:
        """Forget what was asked for, and begin at the measured state."""


def another_robot(robot: Robot, before: Robot) -> bool:
    """Whether a description is of another arm: what was asked for in its base frame is void."""
    return robot.name != before.name or not np.isclose(robot.length, before.length, rtol=1e-9)


def change_model(
    core: Changing, model: Model, on_done: Callable[[TendonRobotError | None], None]
) -> None:
    """
    Change the model; tensions then move to its solution at `rate_limit`.

    That of another robot (another name, and so another base frame, or another length) takes no
    target over: the arm holds where it is measured.

    `on_done` hears None, or why the old one stays: an InputError for other inputs, a
    NoEquilibriumError when it finds none at the present tensions or for the target.
    """
    try:
        check_inputs(model.inputs, core.model.inputs)
    except InputError as error:
        on_done(error)
        return
    command, target, last, before = core.command, core.target, core.track.last, core.model
    other = another_robot(model.robot, before.robot)
    question = None if target is None or other else question_of(core, model, target)
    felt = command if command is None else core.felt_tensions()

    def work(give_up: GiveUp) -> tuple[Shape | None, Reach | None]:
        here = None
        if command is not None and felt is not None:
            model.shape(command)
            here = None if other else carried(model, before, last, felt)
        if question is None:
            return here, None
        return here, replace(question, last=here or question.last).answer(give_up).reach

    def done(
        found: tuple[Shape | None, Reach | None] | None, error: TendonRobotError | None
    ) -> None:
        if found is not None:
            _use(core, model, target, *found)
        on_done(error)

    core.solver.post('model', work, done)


def _use(
    core: Changing,
    model: Model,
    target: Target | None,
    here: Shape | None,
    solution: Reach | None,
) -> None:
    """Change the model: what was asked for goes on with it, unless it is of another robot."""
    other = another_robot(model.robot, core.model.robot)
    core.model, core.jog, core.track = model, None, ShapeTracker(model)
    core.track.last = here
    core.via = []
    core.loop.reset()
    if other:
        core.begin_anew()
        return
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
