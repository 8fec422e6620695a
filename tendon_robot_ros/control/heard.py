"""What the driver last measured, and how long ago that was."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..exceptions import InputError, NoEquilibriumError

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Shape

Array = NDArray[np.float64]


@dataclass
class Heard:
    """Tensions (m,) [N] and wire pulls (m,) [m] as measured, nan where not observable."""

    tensions: Array
    pulls: Array
    time: float  # monotonic [s]

    @property
    def observed(self) -> bool:
        """Whether every tension was."""
        return bool(np.all(np.isfinite(self.tensions)))

    def in_newtons(
        self, model: Model, limits: Array, guess: Shape | None, unknown: Array
    ) -> Array:
        """Return the tensions; those of the wire pulls where tension is not observable."""
        if self.observed:
            return np.maximum(self.tensions, 0.0)
        low, high = limits.T
        try:
            shape = model.pull_shape(self.pulls, guess)
            if np.all((shape.inputs >= low) & (shape.inputs <= high)):
                return shape.inputs
            # a slack tendon is below its limit: look for the same pulls within the limits
            start = np.clip(shape.inputs, low + 1e-6, high - 1e-6)
            found = least_squares(
                lambda tensions: 1e3 * (model.shape(tensions).pulls - self.pulls),  # [mm]
                start,
                bounds=(low, high),
                max_nfev=30,
            )
        except (NoEquilibriumError, InputError):
            return unknown
        return np.asarray(found.x, dtype=float)
