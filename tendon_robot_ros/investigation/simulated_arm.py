"""A plant that is asked posture by posture, as an investigation asks a real arm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ..common.errors import InputError, NoEquilibriumError
from ..data import Marker, default_markers
from ..robot import Robot
from ..simulation.measurements import SimulatedNoise
from ..simulation.plant import Plant
from .arm import BrokenMeasurementError, PostureMeasured

Floats = npt.NDArray[np.float64]
READINGS = 5  # of a posture of a sequence, which is measured once


class SimulatedArm:
    """
    A `MeasurableArm` that is simulated, with the noise of a tracker and of load cells.

    Parameters
    ----------
    plant : Plant
    noise : SimulatedNoise, optional
    seed : int
        Of the noise.
    input, path : str
        As of a data set.
    lost : float
        Share of the measurements that break.

    """

    def __init__(
        self,
        plant: Plant,
        noise: SimulatedNoise | None = None,
        seed: int = 0,
        input: str = 'tension',
        path: str = 'from_straight',
        lost: float = 0.0,
    ) -> None:
        """Stand straight."""
        self.plant, self.noise, self.lost = plant, noise or SimulatedNoise(), lost
        self.input, self.path = input, path
        self.markers: Sequence[Marker] = default_markers(plant.robot)
        self.visited: list[Floats] = []  # inputs (m,) of all measurements, broken ones included
        self.released = 0
        self._random = np.random.default_rng(seed)

    @property
    def robot(self) -> Robot:
        """The owner's description."""
        return self.plant.robot

    @property
    def position_noise(self) -> float | None:
        """Standard deviation [m] of a coordinate of a trial."""
        once = self.path == 'sequence'
        return float(self.noise.position / np.sqrt(READINGS if once else 1))

    @property
    def input_noise(self) -> tuple[float, float]:
        """Relative 1 sd of an input."""
        return self.noise.setting, self.noise.trial

    def measure(self, inputs: Floats, trials: int) -> PostureMeasured:
        """Measure a posture."""
        self.visited.append(np.array(inputs))
        if self._random.random() < self.lost:
            raise BrokenMeasurementError('the tracker lost the arm')
        setting = 1.0 + self.noise.setting * self._random.normal(size=inputs.shape)
        factors = setting * (
            1.0 + self.noise.trial * self._random.normal(size=(trials, *inputs.shape))
        )
        try:
            seen = self._seen(inputs * np.maximum(factors, 0.0))
        except (NoEquilibriumError, InputError) as error:
            raise BrokenMeasurementError(f'the arm does not stand: {error}') from None
        size = float(self.position_noise or 0.0)
        frames = trials * (READINGS if self.path == 'sequence' else 1)
        return PostureMeasured(seen + self._random.normal(0.0, size, seen.shape), None, frames)

    def release(self) -> None:
        """Let go; the arm is straight and remembers nothing."""
        self.released += 1
        self.plant.forget()

    def _seen(self, rows: Floats) -> Floats:
        arcs = np.array([marker.arc_length for marker in self.markers])
        offsets = np.array([marker.offset for marker in self.markers])
        pulls = self.input == 'displacement'
        if self.path == 'from_straight':
            return self.plant.markers(rows, arcs, offsets, displacement=pulls)
        respond = self.plant.respond_to_pulls if pulls else self.plant.respond
        return np.array([respond(row).markers(arcs, offsets) for row in rows])
