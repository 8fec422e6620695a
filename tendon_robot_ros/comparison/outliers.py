"""Readings that the other trials of the same posture contradict: named, and left out."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.errors import NoEquilibriumError
from ..common.words import listed
from ..data import DataSet
from .contradictions import TRIALS_MIN, contradicted
from .noise import input_slopes
from .predict import Point, Predictor

Floats = npt.NDArray[np.float64]
UNSETTLED_SHARE_MAX = 0.25  # of the postures, in which a description may have no equilibrium


@dataclass(frozen=True)
class Outliers:
    """What the other trials contradict."""

    readings: npt.NDArray[np.bool_]  # (P, Q, J) single marker readings
    trials: npt.NDArray[np.bool_]  # (P, Q) whole trials
    distance: Floats  # (P, Q, J) [m] from what the other trials say

    @property
    def any(self) -> bool:
        """Whether there are some."""
        return bool(self.readings.any() or self.trials.any())

    def rows(self, dataset: DataSet) -> list[Mapping[str, Any]]:
        """Name them: posture, trial and marker, None for the whole trial, and distance [m]."""
        trials = [
            {'posture': dataset.postures[p], 'trial': dataset.trial_names[q], 'marker': None}
            for p, q in np.argwhere(self.trials)
        ]
        readings = [
            {
                'posture': dataset.postures[p],
                'trial': dataset.trial_names[q],
                'marker': dataset.markers[j].name,
                'distance': float(self.distance[p, q, j]),
            }
            for p, q, j in np.argwhere(self.readings)
        ]
        return [*trials, *readings]

    def without(self, dataset: DataSet) -> DataSet:
        """Return the data set without them; a posture keeps at least one trial."""
        if not self.any:
            return dataset
        out = self.readings | self.trials[..., None]
        positions = np.where(out[..., None], np.nan, dataset.positions)
        return replace(dataset, positions=positions)


def find_outliers(predictor: Predictor, point: Point) -> Outliers:
    """Find readings and trials that the others of their posture contradict (contradictions.py)."""
    dataset = predictor.dataset
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', RuntimeWarning)  # a marker that no trial saw
        moves = dataset.positions - np.nanmedian(dataset.positions, axis=1, keepdims=True)
    distance = np.linalg.norm(moves, axis=-1)
    if not (dataset.trials >= TRIALS_MIN).any():
        nothing = np.zeros(dataset.mask.shape, dtype=bool)
        return Outliers(nothing, nothing.any(axis=2), distance)
    return Outliers(*contradicted(moves, input_slopes(predictor, point)), distance)


def without_unsettled(predictor: Predictor) -> tuple[DataSet, tuple[str, ...]]:
    """
    Leave out the few postures in which the description has no equilibrium, and name them.

    Raises
    ------
    NoEquilibriumError
        They are many, or one of a sequence, in which the next one needs it.

    """
    dataset = predictor.dataset
    if predictor.markers({}) is not None:
        return dataset, ()
    names = predictor.unsettled()
    few = 0 < len(names) <= UNSETTLED_SHARE_MAX * len(dataset.postures)
    if not few or dataset.path != 'from_straight':
        where = listed(f'posture {name}' for name in names) or 'a posture on the way'
        effects = predictor.model.implicit_effects
        raise NoEquilibriumError(f'{where} of {dataset.name}', effects, np.inf)
    return dataset.select(set(dataset.postures) - set(names)), names
