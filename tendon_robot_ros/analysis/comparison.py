"""What a comparison holds: measured and predicted shapes, and the errors that follow."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
import numpy.typing as npt

from .statistics import Estimate, PairedT, estimate, half_width, paired_t

Floats = npt.NDArray[np.float64]
GROWN = 2.0  # times the noise floor: an error that is no longer noise


@dataclass(frozen=True, eq=False)
class Measured:
    """The measurements of a comparison: P postures, Q trials, J markers, m inputs."""

    data: str  # name of the data set
    input: str  # 'tension' or 'displacement'
    input_names: tuple[str, ...]  # (m,)
    inputs: Floats  # (P, m) [N] or [m], NaN = slack
    postures: tuple[str, ...]  # (P,)
    trials: npt.NDArray[np.int64]  # (P,)
    markers: tuple[str, ...]  # (J,)
    arc_lengths: Floats  # (J,) [m]
    per_cell: bool  # one marker at the end of every cell, and no other
    mean: Floats  # (P, J, 3) [m]
    tips: Floats  # (P, Q, 3) [m] the last marker, trial by trial
    angles: Floats | None  # (Q, P, J) [rad] angular displacement, where the markers tell it
    position_noise: float | None  # [m] 1 sd per coordinate and trial
    floor: Floats | None  # (P, J) [m²] expected squared distance for a perfect model

    @cached_property
    def noise_floor(self) -> float | None:
        """Expected rms [m] for a perfect model over postures and markers."""
        return None if self.floor is None else root_mean(self.floor)

    @cached_property
    def floor_per_marker(self) -> Floats | None:
        """Expected rms (J,) [m] for a perfect model over postures."""
        return None if self.floor is None else np.sqrt(mean_over(self.floor, 0))


@dataclass(frozen=True, eq=False)
class ModelErrors:
    """A model's predictions and their distances from the measurements."""

    name: str
    effects: tuple[str, ...]
    markers: Floats  # (P, J, 3) [m]
    angles: Floats | None  # (P, J) [rad]
    distance: Floats  # (P, J) [m] from the trial mean
    tip_errors: Floats  # (P, Q) [m] of the last marker, trial by trial: the residual distance
    centreline: Floats | None = None  # (P, n, 3) [m], where the markers do not lie on it

    @cached_property
    def rms(self) -> float:
        """Over postures and markers [m]."""
        return root_mean(self.distance**2)

    @cached_property
    def tip_rms(self) -> float:
        """Of the last marker, over postures [m]."""
        return root_mean(self.distance[:, -1] ** 2)

    @cached_property
    def max(self) -> float:
        """Largest distance [m]."""
        return float(np.nanmax(self.distance))

    @cached_property
    def per_marker_rms(self) -> Floats:
        """Over postures (J,) [m]."""
        return np.sqrt(mean_over(self.distance**2, 0))

    @cached_property
    def per_posture_rms(self) -> Floats:
        """Over markers (P,) [m]."""
        return np.sqrt(mean_over(self.distance**2, 1))

    def tip_error(self, error: str = 'ci') -> Estimate:
        """Mean tip error over the postures."""
        return estimate(mean_over(self.tip_errors, 1), error)

    def tip_error_of(self, posture: int, error: str = 'ci') -> Estimate:
        """Mean tip error over the trials of a posture."""
        return estimate(self.tip_errors[posture], error)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Measurements against models, side by side."""

    measured: Measured
    models: tuple[ModelErrors, ...]
    error: str = 'ci'  # 95 % t-interval, or 'sem'

    @property
    def noise_floor(self) -> float | None:
        """Expected rms [m] for a perfect model."""
        return self.measured.noise_floor

    @property
    def best(self) -> ModelErrors:
        """The model with the smallest rms."""
        return min(self.models, key=lambda model: model.rms)

    @cached_property
    def paired_t(self) -> tuple[PairedT, ...]:
        """Paired t-tests of the tip errors: over the postures, and over the trials of each."""
        tests = []
        for a, b in combinations(self.models, 2):
            names = (a.name, b.name)
            means = mean_over(a.tip_errors, 1), mean_over(b.tip_errors, 1)
            tests.append(paired_t(names, *means, None))
            for p, posture in enumerate(self.measured.postures):
                tests.append(paired_t(names, a.tip_errors[p], b.tip_errors[p], posture))
        return tuple(test for test in tests if test is not None)

    def worst_posture(self, model: ModelErrors) -> int:
        """Index of the posture with the largest rms."""
        return int(np.nanargmax(model.per_posture_rms))

    def grows_from(self, model: ModelErrors) -> int | None:
        """
        Index of the marker from which the error is more than noise up to the tip.

        None where it nowhere is, or nothing tells the noise.
        """
        floor = self.measured.floor_per_marker
        if floor is None:
            return None
        seen = np.flatnonzero(np.isfinite(floor))
        low = seen[~(model.per_marker_rms[seen] > GROWN * floor[seen])]
        later = seen[seen > (low[-1] if len(low) else -1)]
        return int(later[0]) if len(later) else None

    def angle_bands(self) -> tuple[Floats, Floats] | None:
        """Measured angular displacement (P, J) [rad]: mean, and half the width of its interval."""
        if self.measured.angles is None:
            return None
        angles = self.measured.angles
        return mean_over(angles, 0), half_width(angles, self.error)


def mean_over(values: Floats, axis: int) -> Floats:
    """Mean along an axis; NaN = missing, and where all is missing."""
    count = np.isfinite(values).sum(axis=axis)
    total = np.nansum(values, axis=axis)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def root_mean(squares: Floats) -> float:
    """Root of the mean of squares; NaN = missing."""
    return float(np.sqrt(np.nanmean(squares)))
