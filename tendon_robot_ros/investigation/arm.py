"""What an investigation needs of an arm, simulated or real: go there, wait, measure, let go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from ..common.errors import TendonRobotError
from ..data import Marker
from ..robot import Robot

Floats = npt.NDArray[np.float64]
LOST_SHARE_MAX = 0.5  # of the markers of a trial, beyond which it is no measurement


class BrokenMeasurementError(TendonRobotError):
    """A posture was not measured: lost tracker, an arm that does not stand, a slipped tendon."""


@dataclass(frozen=True)
class PostureMeasured:
    """One posture as it was measured."""

    positions: Floats  # (Q, J, 3) [m], nan where a marker was not seen
    inputs: Floats | None = None  # (Q, m) [N] or [m] as measured; None: as commanded
    frames: int = 1  # of the tracker, of all trials together


class MeasurableArm(Protocol):
    """An arm that can be asked; it looks after its own limits, stop and watchdog."""

    @property
    def robot(self) -> Robot:
        """The description that is to be judged."""

    @property
    def markers(self) -> Sequence[Marker]:
        """What the tracker sees."""

    @property
    def input(self) -> str:
        """'tension' or 'displacement': what the motors set."""

    @property
    def path(self) -> str:
        """'from_straight' (it lets go before every posture) or 'sequence'."""

    @property
    def position_noise(self) -> float | None:
        """Standard deviation [m] of a coordinate of one trial, if it is known."""

    @property
    def input_noise(self) -> tuple[float, float]:
        """Relative 1 sd of an input: shared by the trials of a posture, and per trial."""

    def measure(self, inputs: Floats, trials: int) -> PostureMeasured:
        """
        Go to a posture, wait until it stands, and record trials.

        Raises
        ------
        BrokenMeasurementError
            It was not measured; another attempt may do.
        TendonRobotError
            The robot is stopped or gone.

        """

    def release(self) -> None:
        """Let the arm go: the safe state, whatever happened."""


def checked(measured: PostureMeasured) -> PostureMeasured:
    """
    Refuse a measurement that lacks most of its markers.

    Raises
    ------
    BrokenMeasurementError

    """
    seen = np.isfinite(measured.positions).all(axis=2)  # (Q, J)
    good = seen.mean(axis=1) >= 1.0 - LOST_SHARE_MAX
    if not good.any():
        lost = 100.0 * (1.0 - seen.mean())
        raise BrokenMeasurementError(f'the tracker lost {lost:.0f} % of the markers')
    positions = np.where(good[:, None, None], measured.positions, np.nan)
    return replace(measured, positions=positions)
