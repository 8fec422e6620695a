"""What drivers of real motors share: being open, commands within limits and rates, retries."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..common.errors import DriverError
from ..robot import Robot
from .interface import Array, Driver
from .safety import approach, bounded

WRITE_STEP_MAX_S = 0.1  # [s]; after a pause the command does not catch up
RETRY_PERIOD_S = 0.2  # [s] between two attempts to get a port or a motor back


class HardwareDriver(Driver):
    """
    A driver of real motors: it is open or not, and its command moves within limits and rates.

    Parameters
    ----------
    robot : Robot
    mode : str
        `tension` or `pull`.
    place : str
        Port or topic; every message begins with it.
    limits : ndarray, shape (m, 2) [N] or [m]
    rates : ndarray, shape (m,) [N/s] or [m/s]

    """

    def __init__(self, robot: Robot, mode: str, place: str, limits: Array, rates: Array) -> None:
        """Begin closed."""
        self.robot, self.inputs, self.mode, self.place = robot, robot.inputs, mode, place
        self.limits, self.rates = limits, rates
        self._is_open = False
        self._goal: Array = np.zeros(len(self.inputs))  # (m,) what was commanded last
        self._written = self._retried = -np.inf  # monotonic [s]

    def _require_open(self, what: str) -> None:
        if not self._is_open:
            raise DriverError(f'{self.place}: {what}: the driver is not open')

    def _chosen(self, inputs: Sequence[str]) -> NDArray[np.bool_]:
        """Return which inputs are named, (m,); none named means all."""
        unknown = [name for name in inputs if name not in self.inputs]
        if unknown:
            raise DriverError(
                f'expected inputs of {", ".join(self.inputs)}, got {", ".join(unknown)}'
            )
        return np.array([not inputs or name in inputs for name in self.inputs])

    def _since_write(self) -> float:
        """Return how long ago the last command came [s], and begin anew."""
        now = time.monotonic()
        passed, self._written = now - self._written, now
        return passed

    def _towards(self, wanted: Array, limits: Array, passed: float) -> Array:
        """Return the next goal (m,): towards what is wanted, within limits and rates."""
        step = self.rates * min(passed, WRITE_STEP_MAX_S)
        return approach(self._goal, bounded(wanted, limits), step)

    def _may_retry(self, now: float) -> bool:
        """Whether it is time to look again for what was lost; the next time is later."""
        if now - self._retried < RETRY_PERIOD_S:
            return False
        self._retried = now
        return True
