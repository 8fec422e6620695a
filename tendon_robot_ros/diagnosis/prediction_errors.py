"""Errors of an added effect: before, after, on postures left out, and the noise floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..common.errors import NoEquilibriumError
from ..comparison.noise import Whitener, input_slopes, rms
from ..comparison.predict import Predictor
from ..comparison.repeatability import estimate_noise
from ..data import DataSet
from ..effects import Catalogue
from ..robot import Robot
from .fit import Fit
from .fitter import Fitter
from .into_description import written_members

Floats = npt.NDArray[np.float64]
FOLDS = 6  # groups of postures that are left out in turn


@dataclass(frozen=True)
class Errors:
    """Rms errors [m] over postures and markers of a description before and after a change."""

    kind: str  # 'fitted', 'check', or 'left out': groups of the fitted ones, left out in turn
    data: str
    postures: int
    before: float
    after: float
    floor: float | None  # of a perfect model; None: nothing tells the noise

    @property
    def gone(self) -> float | None:
        """Share of the error above the floor that is gone; None where there was none."""
        floor = self.floor or 0.0
        return (self.before - self.after) / (self.before - floor) if self.before > floor else None


def errors_on(
    dataset: DataSet, before: Robot, after: Robot, catalogue: Catalogue, kind: str
) -> Errors:
    """Compare two descriptions, just as they stand, with the measurements of a data set."""
    old = predict(dataset, before, catalogue)[1]
    predictor, new = predict(dataset, after, catalogue)
    slopes = input_slopes(predictor, {})
    noise = estimate_noise(dataset, slopes)
    floor = None if noise is None else Whitener(dataset, noise, slopes).floor()
    return Errors(
        kind,
        dataset.name,
        int((dataset.trials > 0).sum()),
        rms(dataset.mean - old),
        rms(dataset.mean - new),
        floor,
    )


def predict(dataset: DataSet, robot: Robot, catalogue: Catalogue) -> tuple[Predictor, Floats]:
    """Predict the markers (P, J, 3) [m]; NoEquilibriumError where that fails."""
    predictor = Predictor(dataset, robot, catalogue)
    markers = predictor.markers({})
    if markers is None:
        raise NoEquilibriumError(
            f'a posture of {dataset.name}', predictor.model.implicit_effects, np.inf
        )
    return predictor, markers


def left_out(fitter: Fitter, fit: Fit, beside: bool = True) -> float:
    """
    Return the rms error [m] on postures that were not used: groups are left out in turn.

    The change of the parameters that leaving a group out makes is taken from the slopes at the
    fit; the postures left out are then predicted by the model itself, as the description will
    say it: with the tolerances and the imperfections that it can hold (`beside`), or without.
    """
    dataset, owners = fitter.predictor.dataset, fitter.whitener.owners
    measured = np.flatnonzero(dataset.trials > 0)
    groups = np.unique(dataset.groups[measured])  # postures of the same inputs tell of each other
    folds = min(FOLDS, len(groups))
    frees = fit.all_frees if beside else fit.frees
    low = [free.parameter.low for free in frees]
    high = [free.parameter.high for free in frees]
    predicted = np.full_like(fit.markers, np.nan)
    for fold in range(folds):
        held = measured[np.isin(dataset.groups[measured], groups[fold::folds])]
        priors = np.ones(len(fit.jacobian) - len(owners), dtype=bool)
        used = np.append(~np.isin(owners, held), priors)
        step = np.linalg.lstsq(fit.jacobian[used], fit.residual[used], rcond=1e-10)[0]
        moved = fit.values - step
        values = np.clip(moved[: len(low)], low, high)
        if fitter.built is not None:
            units = moved[len(fit.all_frees) :]
            fitter.go_around(written_members(fit, units) if beside else {})
        markers = fitter.predictor.markers(dict(zip(frees, values.tolist(), strict=True)))
        if markers is not None:
            predicted[held] = markers[held]
    return rms((dataset.mean - predicted)[measured])
