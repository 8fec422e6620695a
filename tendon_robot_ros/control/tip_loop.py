"""What the model leaves over: an integral on the measured tip, through the model's Jacobian."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..common.errors import TendonRobotError

if TYPE_CHECKING:
    from .state import Controller

Array = NDArray[np.float64]
TRACKER_SILENT_S = 0.1  # [s] of the tracker
TRACKER_JUMP_M = 0.02  # [m] between two measurements that no arm does
ARRIVED_WITHIN_N = 0.03  # [N] from where the command is wanted: the tip has arrived
DAMPING = 0.05  # [1] of the largest singular value


@dataclass
class TipLoop:
    """
    Adds tensions to the model's solution until the measured tip is at the target.

    Frozen while the tracker is silent for 0.1 s, when it jumps by more than 20 mm, while the
    tensions are on their way, and when a tension is at its upper limit. Tendons at their lower
    limit take no part. A new target begins with the correction of the one before.
    """

    tensions: Array | None = None  # (m,) [N] added to the solution
    frozen: str = 'no tracker'  # why, '' while it works
    _seen: tuple[float, Array] | None = None
    _error: Array = field(default_factory=lambda: np.full(3, np.nan))  # [m]
    _shift: float = 0.0  # [m] that the correction moves the tip
    _due: float = 0.0  # [s] over which is still to be integrated

    def reset(self) -> None:
        """Forget the correction."""
        self.tensions, self._shift, self._due = None, 0.0, 0.0

    def goal(self, core: Controller, solution: Array) -> Array:
        """Return the solution (m,) [N] with the correction, within the limits."""
        if self.tensions is None or core.settings.tip_gain == 0.0:
            return solution
        low, high = core.settings.limits(core.model).T
        return np.clip(solution + self.tensions, low, high)

    def take(self, now: float, core: Controller, position: Array) -> None:
        """Take a measured tip (3,) [m] in the base frame."""
        before, self._seen = self._seen, (now, position)
        self.frozen = self._why_not(now, core, position, before)
        if not self.frozen and before is not None:
            self._due = min(self._due + now - before[0], TRACKER_SILENT_S)
            self._look(core)

    def values(self, now: float) -> dict[str, str]:
        """Say how much of the correction is left to the loop, for the status."""
        silent = self._seen is None or now - self._seen[0] > TRACKER_SILENT_S
        frozen = 'tracker silent' if silent else self.frozen
        left = '' if np.isnan(self._error).any() else f'{1e3 * np.linalg.norm(self._error):.3f} mm'
        return {
            'correction': f'{1e3 * self._shift:.3f} mm',
            'correction_frozen': frozen,
            'measured_error': left,
        }

    def _why_not(
        self, now: float, core: Controller, position: Array, before: tuple[float, Array] | None
    ) -> str:
        target, solution, command = core.target, core.solution, core.command
        if before is None or now - before[0] > TRACKER_SILENT_S:
            return 'tracker silent'
        if np.linalg.norm(position - before[1]) > TRACKER_JUMP_M:
            return 'tracker jumped'
        if target is None or target.position is None or solution is None or command is None:
            return 'no target'
        self._error = target.position - position
        if core.latch or core.driver_stopped or not core.fresh(now):
            return 'stopped'
        goal = self.goal(core, solution.tensions)
        if np.abs(goal - command).max() > ARRIVED_WITHIN_N:
            return 'moving'
        if solution.at_limit or np.any(goal >= core.settings.limits(core.model)[:, 1]):
            return 'a tension at its limit'
        return ''

    def _look(self, core: Controller) -> None:
        """Have the solver say how tensions move the tip, and integrate then."""
        if core.solver.busy('loop'):
            return
        model, solution, command = core.model, core.solution, core.command
        assert command is not None

        def done(jacobian: Array | None, error: TendonRobotError | None) -> None:
            if jacobian is not None and core.solution is solution and core.model is model:
                self._integrate(jacobian, core)

        core.solver.post('loop', lambda give_up: model.jacobian(command)[:3], done)

    def _integrate(self, jacobian: Array, core: Controller) -> None:
        assert core.solution is not None
        wanted = core.settings.tip_gain * self._due * self._error
        self._due = 0.0
        low = core.settings.limits(core.model)[:, 0]
        correction = self.tensions if self.tensions is not None else np.zeros(len(low))
        free = np.ones(len(low), dtype=bool)
        for _ in range(len(low)):  # let go of tendons that would go below their limit
            step = _damped(jacobian * free, wanted)
            below = free & (core.solution.tensions + correction + step < low)
            if not below.any():
                break
            free &= ~below
        else:
            step = np.zeros(len(low))
        self.tensions = correction + step
        applied = self.goal(core, core.solution.tensions) - core.solution.tensions
        self._shift = float(np.linalg.norm(jacobian @ applied))


def _damped(jacobian: Array, wanted: Array) -> Array:
    """Return the damped least-squares step (m,) [N] for a wanted motion (3,) [m]."""
    size = float(np.linalg.norm(jacobian, 2))
    if size == 0.0:
        return np.zeros(jacobian.shape[1])
    squared = jacobian @ jacobian.T + (DAMPING * size) ** 2 * np.eye(3)
    return np.asarray(jacobian.T @ np.linalg.solve(squared, wanted))
