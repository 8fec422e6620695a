"""The staircase of an added effect: error before, after, and the noise floor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..common.errors import NoEquilibriumError
from ..comparison.noise import Whitener, estimate_noise, input_slopes, rms
from ..comparison.predict import Predictor
from ..data import DataSet
from ..effects import Catalogue
from ..robot import Robot
from .fit import Fit
from .fitter import Fitter
from .written import written_share

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


def left_out(fitter: Fitter, fit: Fit, errors: Errors, moves: Floats | None = None) -> Errors:
    """
    Return the errors on postures that were not used: groups are left out in turn.

    The change of the parameters that leaving a group out makes is taken from the slopes at the
    fit; the postures left out are then predicted by the model itself, as the description will
    say it: without the tolerances.

    Parameters
    ----------
    fitter, fit : Fitter, Fit
        With all postures.
    errors : Errors
        On all postures.
    moves : (b, P, J, 3) [m], optional
        What imperfections do to the markers: those that a description can hold go along.

    """
    dataset, owners = fitter.predictor.dataset, fitter.whitener.owners
    measured = np.flatnonzero(dataset.trials > 0)
    groups = np.unique(dataset.groups[measured])  # postures of the same inputs tell of each other
    folds = min(FOLDS, len(groups))
    low = [free.parameter.low for free in fit.frees]
    high = [free.parameter.high for free in fit.frees]
    predicted = np.full_like(fit.markers, np.nan)
    for fold in range(folds):
        held = measured[np.isin(dataset.groups[measured], groups[fold::folds])]
        priors = np.ones(len(fit.jacobian) - len(owners), dtype=bool)
        used = np.append(~np.isin(owners, held), priors)
        step = np.linalg.lstsq(fit.jacobian[used], fit.residual[used], rcond=1e-10)[0]
        moved = fit.values - step
        values = np.clip(moved[: len(low)], low, high)
        markers = fitter.predictor.markers(dict(zip(fit.frees, values.tolist(), strict=True)))
        if markers is not None and fit.built is not None and moves is not None:
            members = fit.built.members(moved[len(fit.all_frees) :]) * written_share(fit)
            markers = markers + np.tensordot(members, moves, 1)
        if markers is not None:
            predicted[held] = markers[held]
    after = rms((dataset.mean - predicted)[measured])
    return replace(errors, kind='left out', after=after)
