"""Another model while the arm is controlled: where the arm is by it, and where it should go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .friction import carried
from .target_search import question_of

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Reach, Shape
    from ..robot import Robot
    from .solver import GiveUp
    from .state import Controller


def another_robot(robot: Robot, before: Robot) -> bool:
    """Whether a description is of another arm: what was asked for in its base frame is void."""
    return robot.name != before.name or not np.isclose(robot.length, before.length, rtol=1e-9)


def with_model(
    core: Controller, model: Model
) -> Callable[[GiveUp], tuple[Shape | None, Reach | None]]:
    """
    Return how to find the shape by another model, and tensions for the target that is followed.

    NoEquilibriumError where it has none at the present tensions, or for the target.
    """
    command, target, last, before = core.command, core.target, core.track.last, core.model
    other = another_robot(model.robot, before.robot)
    question = None if target is None or other else question_of(core, model, target)
    acting = None if command is None else core.acting_tensions()

    def work(give_up: GiveUp) -> tuple[Shape | None, Reach | None]:
        here = None
        if command is not None and acting is not None:
            model.shape(command)
            here = None if other else carried(model, before, last, acting)
        if question is None:
            return here, None
        return here, replace(question, last=here or question.last).answer(give_up).reach

    return work
