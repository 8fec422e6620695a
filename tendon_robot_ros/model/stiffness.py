"""How stiff the tip is: its motion under a small force, at the tensions or wire lengths held."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError
from .derivatives import Column, derivatives

if TYPE_CHECKING:
    from .forward import ForwardModel
    from .shape import Shape, ShapeBatch

Floats = npt.NDArray[np.float64]
FORCES = ('tip_load', 'force_x'), ('tip_load', 'force_y'), ('tip_load', 'force_z')
TAUT_ABOVE_N = 1e-6  # [N] a wire below is slack and holds no length
RIGID_BELOW = 1e-12  # [m/N] compliance that is none
LENGTH_RANK_SHARE = 1e-9  # of the largest singular value: wires that say the same


@dataclass(frozen=True)
class TipStiffness:
    """The compliance of the tip: its displacement per force on it."""

    compliance: Floats  # (3, 3) [m/N], base frame

    def along(self, direction: npt.ArrayLike) -> float:
        """
        Return the force per displacement along a direction [N/m], free to move across it.

        1 / (uᵀ C u) with the compliance C and the unit vector u; infinite where nothing gives way.
        """
        u = np.asarray(direction, dtype=float)
        size = float(np.linalg.norm(u))
        if u.shape != (3,) or not 1e-12 < size < np.inf:
            raise InputError(f'direction: expected three numbers, not all 0, got {direction!r}')
        u = u / size
        gives = float(u @ self.compliance @ u)
        return 1.0 / gives if abs(gives) > RIGID_BELOW else np.inf

    @property
    def softest(self) -> tuple[float, Floats]:
        """Stiffness [N/m] along the direction (3,) in which the tip gives way most."""
        values, vectors = np.linalg.eigh(0.5 * (self.compliance + self.compliance.T))
        return 1.0 / max(float(values[-1]), RIGID_BELOW), vectors[:, -1]


def tip_stiffness(model: ForwardModel, shape: Shape, wires_held: bool = False) -> TipStiffness:
    """
    Return how the tip of an equilibrium gives way to a small force on it.

    By the implicit function theorem on the model (`derivatives`). Where friction remembers,
    tendons stick at first, and the mean of both directions counts.

    Parameters
    ----------
    shape : Shape
    wires_held : bool
        The motors hold the lengths of the wires instead of their tensions: C - J P⁺ G, with the
        tip's motion J and the pulls' change P by tensions, and the pulls' change G by the force.
        Slack wires hold nothing.

    """
    taut = [name for name, t in zip(model.inputs, shape.inputs, strict=True) if t > TAUT_ABOVE_N]
    columns: list[Column] = [*FORCES, *taut] if wires_held else [*FORCES]
    memory = shape.memory if model.remembers else None
    slopes = derivatives(model, shape.batch, columns, _tip_and_pulls, memory)[0]
    compliance = slopes[:3, :3]
    if wires_held and taut:
        rows = [3 + model.inputs.index(name) for name in taut]
        held = np.linalg.pinv(slopes[rows, 3:], rcond=LENGTH_RANK_SHARE)
        compliance = compliance - slopes[:3, 3:] @ held @ slopes[rows, :3]
    return TipStiffness(compliance)


def _tip_and_pulls(batch: ShapeBatch) -> Floats:
    """Return the position of the tip [m] and the wire pulls [m], (b, 3 + m)."""
    return np.concatenate([batch.tip_position, batch.pulls], axis=1)
