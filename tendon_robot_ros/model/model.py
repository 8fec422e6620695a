"""The model of a robot: one object for prediction, control, fitting and the mock robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy.typing as npt

from ..common.errors import refusal, whole
from ..robot.inputs import TensionsLike
from ..robot.keep_out import KeepOut
from .derivatives import Column, Seen, TipStiffness, derivatives, tip_jacobian, tip_stiffness
from .forward import Floats, ForwardModel
from .inverse import reach
from .pulls import pull_shape
from .redundancy import Preferences
from .shape import Reach, Shape, ShapeBatch
from .tip_task import refuse_other_unit


class Model(ForwardModel):
    """
    A frictionless chain of cells plus the physical effects that a robot description lists.

    PCCA is the chain alone; with `tendon_friction` it is the FKM of Kato et al. 2015.
    """

    def jacobian(self, tensions: TensionsLike) -> Floats:
        """Return d (tip position [m], tip direction) / d tensions [N], (6, m)."""
        return tip_jacobian(self, self.tensions(tensions))

    def derivatives(
        self,
        shapes: ShapeBatch,
        columns: Sequence[Column],
        seen: Seen | None = None,
    ) -> Floats:
        """Return derivatives by tensions and parameters; see `derivatives.derivatives`."""
        return derivatives(self, shapes, columns, seen)

    def reach(
        self,
        position: npt.ArrayLike | None = None,
        direction: npt.ArrayLike | None = None,
        *,
        guess: Shape | None = None,
        position_weight: float = 1.0,
        direction_weight: float | None = None,
        starts: int = 24,
        by_pulls: bool = False,
        relax: bool = False,
        gently: bool = False,
        memory: Floats | None = None,
        preferences: Preferences | None = None,
        keep_out: KeepOut | None = None,
        give_up: Callable[[], bool] = lambda: False,
        tell: Callable[[Reach], None] | None = None,
    ) -> Reach:
        """
        Return tensions that bring the tip to a target [m]; see `inverse.reach`.

        Raises
        ------
        InputError
            Neither position nor direction, or not finite; a position that is no place in metres.

        """
        refuse_other_unit(self.robot, position)
        if guess is not None and not isinstance(guess, Shape):
            raise refusal('guess', 'a Shape of this robot', guess)
        return reach(
            self, position, direction, guess=guess, position_weight=position_weight,
            direction_weight=direction_weight, starts=whole('starts', starts),
            by_pulls=by_pulls, relax=relax, gently=gently, memory=memory,
            preferences=preferences, keep_out=keep_out, give_up=give_up, tell=tell,
        )  # fmt: skip

    def tip_stiffness(self, shape: Shape, wires_held: bool = False) -> TipStiffness:
        """Return how the tip gives way to a force on it; see `derivatives.tip_stiffness`."""
        return tip_stiffness(self, shape, wires_held)

    def pull_shape(
        self, pulls: TensionsLike, guess: Shape | None = None, memory: Floats | None = None
    ) -> Shape:
        """Return the shape under wire pulls; see `pulls.pull_shape`."""
        return pull_shape(self, pulls, guess, memory)
