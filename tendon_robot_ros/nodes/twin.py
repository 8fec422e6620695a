"""A mock arm that is the controller's own model: nothing hidden, nothing scattered."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..model.model import Model
from ..model.shape import Shape
from ..robot import Robot

Array = NDArray[np.float64]


class Twin:
    """The plant of `make demo`; friction remembers what the arm went through."""

    def __init__(self, robot: Robot) -> None:
        """Begin straight and slack."""
        self._model = Model(robot)
        self._last: Shape | None = None

    def respond(self, tensions: Array) -> Shape:
        """Return the shape under tensions (m,) [N]."""
        bend = None if self._last is None else self._last.bend
        memory = None
        if self._last is not None and self._model.remembers:
            memory = self._last.memory
        self._last = self._model.shape(tensions, guess=bend, memory=memory)
        return self._last

    def respond_to_pulls(self, pulls: Array) -> Shape:
        """Return the shape under wire pulls (m,) [m], nan = slack."""
        self._last = self._model.pull_shape(pulls, self._last)
        return self._last
