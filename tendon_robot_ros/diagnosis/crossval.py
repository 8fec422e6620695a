"""
Errors of descriptions: on fitted postures, on a check set, and on postures left out in turn.

The error on postures left out also decides whether the arm as it was found is written.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..common.arrays import Floats
from ..common.errors import NoEquilibriumError
from ..comparison.noise import Whitener, estimate_noise, input_slopes, rms
from ..comparison.predict import Predictor
from ..data import DataSet
from ..effects import Catalogue
from ..robot import Robot
from .description import changed_robot, with_members, with_tolerances, written_members
from .fit import LEVERAGE_MAX, Fit, covariance_root, shares
from .fitter import Fitter
from .marginal import RIDGE
from .verdict import LEFT_OUT_RATIO_MAX

if TYPE_CHECKING:
    from .session import Session

FOLDS = 6  # [1] groups of postures left out in turn, because each is predicted by the model
Groups = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Errors:
    """Rms errors [m] over postures and markers of a description before and after a change."""

    kind: str  # 'fitted', 'check', or 'left out': groups of the fitted ones, left out in turn
    data: str
    postures: int
    before: float
    after: float
    floor: float | None  # of a perfect model; None: nothing tells the noise
    alone: float | None = None  # with the effects, the arm otherwise as described; None: as after

    @property
    def gone(self) -> float | None:
        """Share of the error above the floor that is gone; None where there was none."""
        return share_gone(self.before, self.after, self.floor or 0.0)

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON; an effect without an equilibrium alone has no error."""
        unknown = self.alone is not None and not math.isfinite(self.alone)
        return {**vars(self), 'alone': None if unknown else self.alone}


def share_gone(before: float, after: float, floor: float) -> float | None:
    """
    Return which share of the explainable error is gone, at most 1; None where there was none.

    Explainable is what lies above the noise floor, or above what is left, where that is less:
    noise that was declared too large does not make an error unexplainable.
    """
    least = min(floor, after)
    return (before - after) / (before - least) if before > least else None


@dataclass(frozen=True)
class Staircase:
    """Three descriptions: as described, with effects alone, and as it is written."""

    before: Robot
    alone: Robot
    after: Robot


def errors_on(dataset: DataSet, robots: Staircase, catalogue: Catalogue, kind: str) -> Errors:
    """Compare descriptions, just as they stand, with the measurements of a data set."""
    old = predict(dataset, robots.before, catalogue)[1]
    predictor, new = predict(dataset, robots.after, catalogue)
    same = robots.alone is robots.after
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
        None if same else rms_of(dataset, robots.alone, catalogue),
    )


def rms_of(dataset: DataSet, robot: Robot, catalogue: Catalogue) -> float:
    """Return the rms [m] of a description, just as it stands; nan without an equilibrium."""
    markers = Predictor(dataset, robot, catalogue).markers({})
    return np.nan if markers is None else rms(dataset.mean - markers)


def predict(dataset: DataSet, robot: Robot, catalogue: Catalogue) -> tuple[Predictor, Floats]:
    """Predict the markers (P, J, 3) [m]; NoEquilibriumError where that fails."""
    predictor = Predictor(dataset, robot, catalogue)
    markers = predictor.markers({})
    if markers is None:
        raise NoEquilibriumError(
            f'a posture of {dataset.name}', predictor.model.implicit_effects, np.inf
        )
    return predictor, markers


def left_out_error(fitter: Fitter, fit: Fit, beside: bool = True) -> float:
    """Return the rms error [m] on postures that were not used; see `left_out_markers`."""
    dataset = fitter.predictor.dataset
    measured = dataset.trials > 0
    return rms((dataset.mean - left_out_markers(fitter, fit, beside))[measured])


def left_out_markers(fitter: Fitter, fit: Fit, beside: bool = True) -> Floats:
    """
    Predict postures (P, J, 3) [m] that were not used: groups are left out in turn.

    The change of the parameters that leaving a group out makes is taken from the slopes at the
    fit; the postures left out are then predicted by the model itself, as the description will
    say it: with the tolerances and the imperfections that it can hold (`beside`), or without.
    """
    dataset, owners = fitter.predictor.dataset, fitter.whitener.owners
    measured = np.flatnonzero(dataset.trials > 0)
    groups = np.unique(dataset.groups[measured])  # postures of the same inputs tell of each other
    folds = min(FOLDS, len(groups))
    predicted = np.full_like(fit.markers, np.nan)
    scale = np.maximum(np.linalg.norm(fit.jacobian, axis=0), 1e-300)
    told = fit.jacobian / scale
    normal, gradient = told.T @ told, told.T @ fit.residual
    for fold in range(folds):
        held = measured[np.isin(dataset.groups[measured], groups[fold::folds])]
        gone = np.flatnonzero(np.isin(owners, held))
        out, off = fit.jacobian[gone] / scale, fit.residual[gone]
        left = normal - out.T @ out + RIDGE * np.eye(len(normal))
        step = np.linalg.solve(left, gradient - out.T @ off) / scale
        markers = written_markers(fitter, fit, fit.values - step, beside)
        if markers is not None:
            predicted[held] = markers[held]
    return predicted


def written_markers(
    fitter: Fitter, fit: Fit, values: Floats, beside: bool = True
) -> Floats | None:
    """
    Predict the markers (P, J, 3) [m] as a description says them that has values (q,) of a fit.

    With the tolerances and imperfections that it can hold (`beside`), or without; inside of the
    bounds of its parameters. None without equilibrium.
    """
    frees = fit.all_frees if beside else fit.frees
    low = [free.parameter.low for free in frees]
    high = [free.parameter.high for free in frees]
    own = np.clip(values[: len(frees)], low, high)
    units = values[len(fit.all_frees) :]
    fitter.go_around(written_members(fit, units) if beside else {})
    return fitter.predictor.markers(dict(zip(frees, own.tolist(), strict=True)))


def fall(before: Floats, after: Floats) -> tuple[float, float]:
    """Return how far the rms falls between squared errors (P, J) of postures, and its scatter."""
    seen = np.isfinite(before).any(axis=1)
    old, new = (np.nanmean(squares[seen], axis=1) for squares in (before, after))
    width = float(np.sqrt(old.mean()) + np.sqrt(new.mean()))
    change = old - new
    scatter = float(change.std(ddof=1)) / np.sqrt(len(change))
    return float(change.mean()) / width, scatter / width


def last_worthwhile(errors: Floats) -> int:
    """
    Return the last step that lowers the error of what was taken before by more than its scatter.

    Parameters
    ----------
    errors : (K, P, J) [m²]
        Squared errors of the predictions of left-out postures after 0, 1, ... steps.

    """
    taken = 0
    for k in range(1, len(errors)):
        gain, scatter = fall(errors[taken], errors[k])
        if gain > scatter:
            taken = k
    return taken


def left_out_errors(
    residual: Floats, jacobian: Floats, whitener: Whitener, groups: Groups
) -> Floats:
    """
    Return the mean squared error (P,) [m²] of each posture predicted from other inputs.

    Exact where the model is linear, the hat matrix H: (1 - H_gg)^-1 r_g (Cook and Weisberg 1982).
    Postures of the same group (P,) tell of each other and are left out together.
    """
    owners, (root, _) = whitener.owners, covariance_root(jacobian)
    errors = np.full(len(groups), np.nan)
    for group in np.unique(groups[owners]):
        rows = np.flatnonzero(groups[owners] == group)
        share, vectors = shares(jacobian[rows] @ root)
        along = vectors.T @ residual[rows]
        told = np.maximum(1.0 - share, 1.0 - LEVERAGE_MAX)
        left = residual[rows] + vectors @ (along / told - along)
        for p in np.unique(owners[rows]):
            metres = np.linalg.solve(whitener.root(p), left[owners[rows] == p])
            errors[p] = 3.0 * float(np.mean(metres**2))
    return errors


@dataclass(frozen=True)
class Written:
    """What a fit writes; every error that is told of it is that of one of these descriptions."""

    alone: Robot  # with the effects; the arm otherwise as it was described
    robot: Robot  # that is written: with the arm as it was found as well, where that helps
    beside: bool  # whether it is
    alone_left_out: float  # [m] error on postures left out in turn
    left_out: float  # [m] of what is written


def written(session: Session, fit: Fit) -> Written:
    """
    Return the description to write.

    What was fitted beside the effects goes along where that lowers the error on postures left
    out: tolerances that moved, and imperfections, which of an exact arm are only noise.
    """
    alone = described_by(session, fit, beside=False)
    error = left_out_error(session.fitters[0], fit, beside=False)
    if not fit.as_built and not fit.nuisances:
        return Written(alone, alone, False, error, error)
    together = left_out_error(session.fitters[0], fit)
    if together > LEFT_OUT_RATIO_MAX * error:
        return Written(alone, alone, False, error, error)
    return Written(alone, described_by(session, fit, beside=True), True, error, together)


def described_by(session: Session, fit: Fit, beside: bool) -> Robot:
    """Return the description with the effects of a fit, and with the arm as it found it."""
    robot = changed_robot(session.robot, session.catalogue, fit, session.dataset)
    if not beside:
        return robot
    moved = with_tolerances(robot, session.catalogue, fit)
    return with_members(moved, fit, session.dataset.input)


def error_of(session: Session, robot: Robot) -> float:
    """Return the rms [m] of a description on the measurements; nan without an equilibrium."""
    return rms_of(session.dataset, robot, session.catalogue)
