"""The shape that the model gives from cycle to cycle, and since when it has given none."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..exceptions import InputError, NoEquilibriumError

if TYPE_CHECKING:
    from ..model.model import Model
    from ..model.shape import Shape

Array = NDArray[np.float64]


class ShapeTracker:
    """Starts each search for an equilibrium at the one before."""

    def __init__(self, model: Model) -> None:
        """Begin straight."""
        self.model = model
        self.last: Shape | None = None
        self.problem = ''
        self._since: float | None = None

    def begin(self, tensions: Array) -> Shape:
        """Return the shape under tensions (m,) [N]; raise when there is none."""
        guess = None if self.last is None else self.last.bend
        remembers = self.last is not None and self.model.remembers
        memory = self.last.memory if self.last is not None and remembers else None
        self.last = self.model.shape(tensions, guess=guess, memory=memory)
        return self.last

    def follow(self, now: float, tensions: Array) -> Shape | None:
        """Return the shape, or None and remember since when there is none."""
        try:
            shape = self.begin(tensions)
        except (NoEquilibriumError, InputError) as error:
            self.problem = str(error)
            self._since = now if self._since is None else self._since
            return None
        self.problem, self._since = '', None
        return shape

    def failing(self, now: float) -> float:
        """Return for how long there has been none [s]."""
        return 0.0 if self._since is None else now - self._since
