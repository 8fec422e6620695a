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
from .noise import input_slopes
from .predict import Point, Predictor
from .statistics import chi2_isf

Floats = npt.NDArray[np.float64]
FALSE_OUTLIER_PROBABILITY = 1e-3  # for the most extreme of all readings, or of all trials
TRIALS_MIN = 3  # trials of a posture from which two can contradict one
MARKERS_OFF_SHARE = 0.5  # share of the markers of a trial beyond which the trial itself is off
UNSETTLED_SHARE_MAX = 0.25  # of the postures, in which a description may have no equilibrium
REWEIGHTING_ROUNDS = 4  # of the robust scale
TOLD_SHARE_MIN = 0.5  # of the noise of a reading, that inputs must not be able to explain
TRIAL_LIMITS = 1.5  # times the limit of an input's deviation beyond which its trial is off
TRIALS_OFF_SHARE = 0.5  # of the trials of a posture; the rest must agree
SIZES_MIN = 10  # sizes that tell how large they usually are
SLOPES_OFF_SHARE = 0.3  # of what slopes took off; the model that they are of may lack something


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
    """
    Find readings and trials that the others of their posture contradict.

    Inputs that differ from trial to trial move all markers along known directions; what is left
    after these is the tracker. A reading stands out against the robust spread of all readings, a
    trial by its inputs against those of all trials, or when half of its markers stand out. Where
    inputs could explain most of what a reading does (one marker, three tendons), nothing is left
    to judge it by, and it counts neither as an outlier nor for the spread.
    """
    dataset = predictor.dataset
    P, Q, J = dataset.mask.shape
    judged = np.flatnonzero(dataset.trials >= TRIALS_MIN)
    if not len(judged):
        nothing = np.zeros((P, Q, J), dtype=bool)
        return Outliers(nothing, nothing.any(axis=2), np.full((P, Q, J), np.nan))
    slopes = input_slopes(predictor, point)
    left, along = np.full((P, Q, J, 3), np.nan), np.zeros((P, Q, J, 3))
    inputs = np.zeros((P, Q))
    for p in judged.tolist():
        seen = np.flatnonzero(dataset.trial_mask[p])
        g = slopes[p].reshape(len(slopes[p]), -1).T
        for q, move in zip(seen, _moves(dataset.positions[p, seen], g), strict=True):
            left[p, q], inputs[p, q] = _without_inputs(move, g)
            along[p, q] = move.reshape(-1, 3) - left[p, q]
        left[p, :, _untold_share(g) < TOLD_SHARE_MIN] = np.nan
    distance = np.linalg.norm(left, axis=-1)
    explained = np.linalg.norm(along, axis=-1)
    readings = distance > outlier_limits(distance, 3) + SLOPES_OFF_SHARE * explained
    moved = np.where(inputs == 0.0, np.nan, np.abs(inputs))
    trials = np.abs(inputs) > TRIAL_LIMITS * outlier_limits(moved, 1)
    counted = np.maximum(dataset.mask.sum(axis=2), 1)
    trials |= (readings.sum(axis=2) > MARKERS_OFF_SHARE * counted) & (counted > 2)
    trials &= (trials.sum(axis=1) < TRIALS_OFF_SHARE * dataset.trials)[:, None]
    moved = np.linalg.norm(dataset.positions - _middle(dataset.positions, 1), axis=-1)
    return Outliers(readings & ~trials[..., None], trials, moved)


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


def _middle(places: Floats, axis: int) -> Floats:
    """Return the median of places over trials, the axis kept; NaN where no trial saw a marker."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', RuntimeWarning)
        return np.asarray(np.nanmedian(places, axis=axis, keepdims=True))


def _moves(trials: Floats, g: Floats) -> Floats:
    """
    Return how far trials (q, J, 3) [m] of a posture are from their middle, as (q, 3J).

    The middle is that of the trials with the same inputs: else a marker that one of them lost
    would have the middle of other trials than its neighbours, and would stand out in all.
    """
    moves = trials - _middle(trials, 0)
    even = [move.reshape(-1, 3) - _without_inputs(move.ravel(), g)[0] for move in moves]
    return np.asarray(trials - _middle(trials - even, 0)).reshape(len(trials), -1)


def _without_inputs(move: Floats, g: Floats) -> tuple[Floats, float]:
    """
    Take off a trial's move what its inputs explain, robustly.

    Returns
    -------
    left : (J, 3) [m]
    size : float
        How far the inputs were off, relative, of all that these postures show.

    """
    seen = np.isfinite(move)
    weights = np.ones(int(seen.sum()))
    a, y = g[seen], move[seen]
    scale = max(float(np.linalg.norm(a)), 1e-30)
    along = np.zeros(a.shape[1])
    for _ in range(REWEIGHTING_ROUNDS):
        normal = (a * weights[:, None]).T @ a + 1e-6 * scale**2 * np.eye(a.shape[1])
        along = np.linalg.solve(normal, (a * weights[:, None]).T @ y)
        off = np.abs(y - a @ along)
        spread = max(1.4826 * float(np.median(off)), 1e-9)
        weights = np.minimum(1.0, 2.0 * spread / np.maximum(off, 1e-12))
    left = np.full(len(move), np.nan)
    left[seen] = y - a @ along
    return left.reshape(-1, 3), float(np.linalg.norm(a @ along)) / scale


def _untold_share(g: Floats) -> Floats:
    """Return which share (J,) of the noise of a reading inputs cannot explain; slopes (3J, m)."""
    normal = g.T @ g + 1e-6 * max(float((g * g).sum()), 1e-60) * np.eye(g.shape[1])
    explained = (g @ np.linalg.inv(normal) * g).sum(axis=1)
    return np.asarray(1.0 - explained.reshape(-1, 3).mean(axis=1))


def outlier_limits(sizes: Floats, freedom: int | npt.NDArray[np.int64]) -> Floats:
    """
    Return the sizes (...) beyond which one is an outlier, from the robust spread of all.

    A size is the norm of so many values of the same spread: one number for all, or one for each.
    The largest of all sizes is beyond its limit by chance with `FALSE_OUTLIER_PROBABILITY`.
    """
    seen, many = np.isfinite(sizes), np.broadcast_to(freedom, sizes.shape)
    if seen.sum() < SIZES_MIN:
        return np.full(sizes.shape, np.inf)
    spread = float(np.median(sizes[seen] / _norms(0.5, many)[seen]))
    return spread * _norms(FALSE_OUTLIER_PROBABILITY / int(seen.sum()), many)


def _norms(p: float, freedom: npt.NDArray[np.int64]) -> Floats:
    """Return the norms that so many standard normal values each exceed with a probability."""
    known, where = np.unique(freedom, return_inverse=True)
    norms = np.array([np.sqrt(chi2_isf(p, int(one))) for one in known])
    return np.asarray(norms[where].reshape(freedom.shape))
