"""The model of a robot: one object for prediction, control, fitting and the mock robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy.typing as npt

from ..robot.inputs import TensionsLike
from .derivatives import Column, Seen, TipStiffness, derivatives, tip_jacobian, tip_stiffness
from .forward import Floats, ForwardModel
from .inverse import reach
from .pulls import pull_shape
from .shape import Reach, Shape, ShapeBatch


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
        **options: object,
    ) -> Reach:
        """Return tensions that bring the tip to a target; see `inverse.reach`."""
        return reach(self, position, direction, **options)  # type: ignore[arg-type]

    def tip_stiffness(self, shape: Shape, wires_held: bool = False) -> TipStiffness:
        """Return how the tip gives way to a force on it; see `derivatives.tip_stiffness`."""
        return tip_stiffness(self, shape, wires_held)

    def pull_shape(
        self, pulls: TensionsLike, guess: Shape | None = None, memory: Floats | None = None
    ) -> Shape:
        """Return the shape under wire pulls; see `pulls.pull_shape`."""
        return pull_shape(self, pulls, guess, memory)
