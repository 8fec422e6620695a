"""The way of an arm that is driven by wire lengths: in pieces whose ends the model has seen."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ..common.errors import TendonRobotError
from ..drivers.safety import approach
from .state import Controller

if TYPE_CHECKING:
    from ..model.shape import Shape

Array = NDArray[np.float64]
PIECE_S = 0.02  # [s] at the rate limit: wire pulls are near enough to straight lines in between
PIECES_AHEAD = 2  # pieces


class PullDriven(Controller, Protocol):
    """A controller of an arm that is driven by wire lengths."""

    way: Way | None


@dataclass
class Way:
    """
    Wire pulls (m,) [m] as commanded, and the shapes at the ends of the pieces ahead.

    The solver is asked for a piece while the one before is on; where it is late, the arm waits.
    """

    pulls: Array
    ahead: deque[Shape] = field(default_factory=deque)

    def anew(self) -> Way:
        """Return a way from the same pulls on which nothing is planned."""
        return Way(self.pulls)

    def advance(self, core: PullDriven, goal: Array, step: float) -> Array:
        """Move by a step [N] towards a goal (m,) [N]; return the tensions (m,) [N] there."""
        tensions = core.command
        assert tensions is not None
        if np.array_equal(tensions, goal):
            self.ahead.clear()
        self._ask(core, tensions, goal)
        while self.ahead and step > 0.0:
            end = self.ahead[0]
            size = float(np.abs(end.inputs - tensions).max())
            share = 1.0 if size <= step else step / size
            tensions = tensions + share * (end.inputs - tensions)
            self.pulls = self.pulls + share * (end.pulls - self.pulls)
            step -= size
            if share == 1.0:
                tensions, self.pulls = end.inputs.copy(), end.pulls.copy()
                self.ahead.popleft()
        self._ask(core, tensions, goal)
        return tensions

    def _ask(self, core: PullDriven, tensions: Array, goal: Array) -> None:
        """Have the solver look at the end of the next piece."""
        if len(self.ahead) >= PIECES_AHEAD or core.solver.busy('piece'):
            return
        last = self.ahead[-1] if self.ahead else None
        begin = tensions if last is None else last.inputs
        end = approach(begin, goal, np.full_like(goal, core.settings.rate_limit * PIECE_S))
        if np.array_equal(begin, end) and not core.track.problem:
            return
        track, now = core.track, core.stepped
        find = track.finding(end, last)

        def done(shape: Shape | None, error: TendonRobotError | None) -> None:
            if core.way is not self or track is not core.track:
                return
            if shape is None:
                track.failed(now, str(error))
                return
            track.works()
            if (self.ahead[-1] if self.ahead else None) is last:
                self.ahead.append(shape)

        core.solver.post('piece', find, done)
