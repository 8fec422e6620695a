"""
Errors of descriptions: on fitted postures, on a check set, and on postures left out in turn.

The error on postures left out also decides whether the arm as it was found is written.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..common.arrays import Floats, Ints
from ..common.errors import NoEquilibriumError, RobotDescriptionError
from ..data import DataSet
from ..effects import Catalogue
from ..model.program import solved
from ..robot import Robot
from .description import WRITABLE_KINDS, changed_robot, with_members, with_values
from .fit import LEVERAGE_MAX, Fit, covariance_root, left_out
from .fitter import Fitter
from .imperfections import ANEW, BuiltPredictor, Members
from .marginal import RIDGE
from .noise import Whitener, estimate_noise, input_slopes
from .predict import Predictor, SettledShapes
from .session import Session
from .statistics import rms, root_mean

FOLDS = 6  # [1] groups of postures left out in turn, because each costs a run of the model
# [1] ratio of the errors left out from which the arm as found is written: docs/inference.md
LEFT_OUT_RATIO_MAX = 0.95


@dataclass(frozen=True)
class Errors:
    """Rms errors [m] over postures and markers of a description before and after a change."""

    kind: str  # 'fitted', 'check', or 'left out': groups of the fitted ones, left out in turn
    data: str
    postures: int
    before: float
    after: float
    floor: float | None  # of a perfect model; None: the noise is not known
    # with the effects, the arm otherwise as described; None: as after, nan: without an equilibrium
    alone: float | None = None

    @property
    def gone(self) -> float | None:
        """Explained fraction of the error above the floor; None where there was none."""
        return explained_fraction(self.before, self.after, self.floor or 0.0)


def explained_fraction(before: float, after: float, floor: float) -> float | None:
    """
    Return the explained fraction of the explainable error, at most 1; None where there is none.

    The explainable error is the part above the noise floor, or above the remaining error, where
    that is smaller: noise that was declared too large does not make an error unexplainable.
    """
    unexplainable = min(floor, after)
    return (before - after) / (before - unexplainable) if before > unexplainable else None


def set_alike(
    dataset: DataSet,
    robot: Robot,
    catalogue: Catalogue,
    anew: Members,
    near: SettledShapes | None = None,
) -> DataSet:
    """
    Return several recordings as if nothing had been set anew in each of them.

    A description cannot hold zeros and tracker's frames of single recordings, so that the errors
    of descriptions are those without them. Nothing is changed without an equilibrium.
    """
    if not anew:
        return dataset
    arm = BuiltPredictor(Predictor(dataset, robot, catalogue))
    markers = arm.markers({}, near=None if arm.carries else near)
    arm.around = anew
    moved = None if markers is None else arm.markers({}, near=arm.settled)
    return dataset if markers is None or moved is None else dataset.less(moved - markers)


def errors_on(
    dataset: DataSet, before: Robot, written: Written, catalogue: Catalogue, kind: str
) -> Errors:
    """Return the errors on a data set of a description and of what takes its place."""
    old = predict(dataset, before, catalogue)[1]
    predictor, new = predict(dataset, written.robot, catalogue)
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
        rms_of(dataset, written.alone, catalogue) if written.beside else None,
    )


def rms_of(
    dataset: DataSet, robot: Robot, catalogue: Catalogue, near: SettledShapes | None = None
) -> float:
    """Return the rms error [m] of a description without any fit; nan without an equilibrium."""
    return rms(missed(dataset, robot, catalogue, near))


def missed(
    dataset: DataSet, robot: Robot, catalogue: Catalogue, near: SettledShapes | None = None
) -> Floats:
    """Return measured minus predicted markers (P, J, 3) [m]; nan without an equilibrium."""
    predictor = Predictor(dataset, robot, catalogue)
    markers = predictor.markers({}, near=None if predictor.carries else near)
    return dataset.mean - (np.nan if markers is None else markers)


def predict(dataset: DataSet, robot: Robot, catalogue: Catalogue) -> tuple[Predictor, Floats]:
    """Return the predictor and its markers (P, J, 3) [m]; raise NoEquilibriumError without any."""
    predictor = Predictor(dataset, robot, catalogue)
    markers = predictor.markers({})
    if markers is None:
        raise NoEquilibriumError(
            f'a posture of {dataset.name}', predictor.model.implicit_effects, np.inf
        )
    return predictor, markers


def model_error_of(dataset: DataSet, squares: Floats, floor: float) -> float | None:
    """
    Return the size at the tip [m] of the error of a model that left-out postures show.

    By least squares, for an error whose square grows along the arm with the arc length, as that of
    a `Whitener`. None where they show nothing beyond the base.

    Parameters
    ----------
    dataset : DataSet
    squares : (P, J) [m²]
        Squared errors of the predictions of postures that were left out.
    floor : float
        Rms [m] that noise alone makes.

    """
    heights = np.broadcast_to(dataset.arc_lengths / dataset.robot.length, squares.shape)
    known = np.isfinite(squares) & (heights > 0.0)
    if not known.any():
        return None
    h, excess = heights[known], squares[known] - floor**2
    return float(np.sqrt(max(float(h @ excess) / float(h @ h), 0.0)))


def folds_of(dataset: DataSet, count: int = FOLDS) -> list[Ints]:
    """Return the postures of at most so many folds; those of the same inputs stay together."""
    measured = np.flatnonzero(dataset.trials > 0)
    own = dataset.groups[measured]
    groups = np.unique(own)
    count = min(count, len(groups))
    return [measured[np.isin(own, groups[fold::count])] for fold in range(count)]


def left_out_squares(
    fitter: Fitter, fit: Fit, beside: bool = True, folds: Sequence[Ints] = ()
) -> Floats:
    """
    Return squared errors (P, J) [m²] of postures that were not used: folds are left out in turn.

    The parameters without a fold follow from the Jacobian at the fit (one Gauss-Newton step within
    their bounds); what only the fold determines is as described. The model itself then predicts
    the left-out postures, as the description to write would: with the tolerances and imperfections
    that it can hold (`beside`), or without.
    """
    dataset, owners = fitter.predictor.dataset, fitter.whitener.owners
    predicted = np.full_like(fit.markers, np.nan)
    scale = np.maximum(np.linalg.norm(fit.jacobian, axis=0), 1e-300)
    scaled = fit.jacobian / scale
    normal, gradient = scaled.T @ scaled, scaled.T @ fit.residual
    k = len(fit.frees)
    gradient[:k] += RIDGE * scale[:k] * (fit.values[:k] - fit.described)
    room = np.full((2, len(scale)), [[-np.inf], [np.inf]])
    for i, own in enumerate(free.parameter for free in fit.all_frees):
        room[:, i] = (fit.values[i] - np.array([own.high, own.low])) * scale[i]
    for held in folds or folds_of(dataset):
        rows = np.flatnonzero(np.isin(owners, held))
        out, off = fit.jacobian[rows] / scale, fit.residual[rows]
        remaining = normal - out.T @ out + RIDGE * np.eye(len(normal))
        step = solved(remaining, out.T @ off - gradient, None, *room) / scale
        markers = written_markers(fitter, fit, fit.values - step, beside)
        if markers is not None:
            predicted[held] = markers[held]
    return np.asarray(((dataset.mean - predicted) ** 2).sum(axis=2))


def written_markers(
    fitter: Fitter, fit: Fit, values: Floats, beside: bool = True
) -> Floats | None:
    """
    Predict the markers (P, J, 3) [m] of a description with values (q,) of a fit.

    The values are clipped to their bounds, with the tolerances and imperfections that the
    description can hold (`beside`), or without; with what was set anew in each recording. None
    without equilibrium.
    """
    frees = fit.all_frees if beside else fit.frees
    named = fit.built.random.named(values[len(fit.all_frees) :], fit.built.sizes)
    kinds = (*ANEW.values(), *(WRITABLE_KINDS if beside else ()))
    fitter.linearise_around({kind: own for kind, own in named.items() if kind in kinds})
    point = {free: free.clip(value) for free, value in zip(frees, values.tolist(), strict=False)}
    return fitter.predictor.markers(point, near=fit.settled)


def fall(before: Floats, after: Floats) -> tuple[float, float]:
    """Return the fall [m] of the rms of squared errors (P, J) [m²], and its standard error [m]."""
    measured = np.isfinite(before).any(axis=1)
    old, new = (np.nanmean(squares[measured], axis=1) for squares in (before, after))
    width = float(np.sqrt(old.mean()) + np.sqrt(new.mean()))
    change = old - new
    scatter = float(change.std(ddof=1)) / np.sqrt(len(change))
    return float(change.mean()) / width, scatter / width


def last_worthwhile(errors: Floats) -> int:
    """
    Return the last step that lowers the error by more than the standard error of the change.

    Parameters
    ----------
    errors : (K, P, J) [m²]
        Squared errors of the predictions of left-out postures after 0, 1, ... steps.

    """
    last = 0
    for k in range(1, len(errors)):
        gain, scatter = fall(errors[last], errors[k])
        if gain > scatter:
            last = k
    return last


def left_out_errors(
    residual: Floats, jacobian: Floats, whitener: Whitener, groups: Ints
) -> Floats:
    """
    Return the mean squared error (P,) [m²] of each posture predicted from other inputs.

    In closed form, see `fit.left_out`. Postures of the same group (P,) are not independent and are
    left out together.
    """
    owners, (root, _) = groups[whitener.owners], covariance_root(jacobian)
    n, least = len(owners), 1.0 - LEVERAGE_MAX
    return whitener.squares(left_out(residual[:n], jacobian[:n] @ root, owners, least)[0])


@dataclass(frozen=True)
class Written:
    """The descriptions that a fit writes; every reported error is that of one of them."""

    alone: Robot  # with the effects; the arm otherwise as it was described
    robot: Robot  # that is written: with the arm as it was found as well, where that helps
    beside: bool  # whether it is
    alone_left_out: float  # [m] error on postures left out in turn
    left_out_squares: Floats  # (P, J) [m²] of what is written

    @property
    def left_out(self) -> float:
        """Rms error [m] of what is written, on postures left out in turn."""
        return root_mean(self.left_out_squares)


def written(session: Session, fit: Fit) -> Written:
    """
    Return the description to write.

    The fitted tolerances and imperfections are written as well where they lower the error on
    left-out postures.
    """
    alone, fitter = described_by(session, fit, beside=False), session.fitter

    plain = left_out_squares(fitter, fit, beside=False)
    error = root_mean(plain)
    if not fit.as_built and not fit.nuisances:
        return Written(alone, alone, False, error, plain)
    together = left_out_squares(fitter, fit)
    lost = np.isfinite(plain) & ~np.isfinite(together)  # without an equilibrium
    robot = described_by(session, fit, beside=True)
    helps = root_mean(together) <= LEFT_OUT_RATIO_MAX * error and not lost.any()
    if not helps or np.isnan(error_of(session, robot, fit)):
        return Written(alone, alone, False, error, plain)
    return Written(alone, robot, True, error, together)


def described_by(session: Session, fit: Fit, beside: bool) -> Robot:
    """Return the description with the effects of a fit, `beside` them the arm as found."""
    robot = changed_robot(session.robot, session.catalogue, fit, session.dataset)
    if not beside:
        return robot
    declared = list(fit.point.items())[len(fit.frees) :]  # quantities that the fit moved
    moved = with_values(robot, session.catalogue, declared)
    return with_members(moved, fit, session.dataset.input)


def error_of(session: Session, robot: Robot, fit: Fit) -> float:
    """
    Return the rms error [m] on the measurements, without what a fit shows to be set anew in each.

    Nan without an equilibrium, and where a fit went beyond what a description can hold.
    """
    near = session.described[0].settled if session.dataset.thinned_from else None
    try:
        alike = set_alike(session.whole, robot, session.catalogue, fit.anew, near)
        return rms_of(alike, robot, session.catalogue, near)
    except RobotDescriptionError:
        return np.nan
