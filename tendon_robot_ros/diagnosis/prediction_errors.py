"""
Errors of a prediction: before, after, on postures left out; and what slopes alone promise of them.

`improve` asks of every block of parameters that may join what it would leave on left-out postures.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..common.errors import NoEquilibriumError
from ..comparison.noise import Whitener, input_slopes, rms
from ..comparison.predict import FreeParameter, Predictor, SettledShapes
from ..comparison.repeatability import estimate_noise
from ..data import DataSet
from ..effects import Catalogue, Parameter
from ..robot import Robot
from .candidates import Candidate
from .fit import Fit, covariance_of, covariance_root, shares
from .fitter import Fitter
from .into_description import written_members

Floats = npt.NDArray[np.float64]
FOLDS = 6  # groups of postures that are left out in turn
UNTOLD = 1e-10  # of what tells a direction, below which the other postures tell nothing of it
Groups = npt.NDArray[np.int64]
JOINING_STEP = 0.02  # typical sizes from which a fit begins, where laws have kinks
SIZES_TRIED = (0.03, 0.3, 3.0)  # typical sizes of a law that acts whatever its value
TURNED_SHARE = 0.05  # of such a value, for its slope
TURNING = ('torsion', 'memory')  # stages that, when absent, only a solution tells
TELLS_ITSELF = 1e-3  # share of a reading that the other postures tell, at least


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
    """The descriptions on the way: as described, with effects alone, and as it is written."""

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


def left_out(fitter: Fitter, fit: Fit, beside: bool = True) -> float:
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
        left = normal - out.T @ out + UNTOLD * np.eye(len(normal))
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
    if fitter.built is not None:
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


@dataclass(frozen=True)
class Joining:
    """A block that may join a fit: where it begins, and how it moves N whitened residuals."""

    block: Candidate
    start: Mapping[FreeParameter, float]
    change: Floats | float  # (N,) of the residual where it begins; none for a law without a jump
    columns: Floats  # (N, q) derivatives


class Ways:
    """How blocks may join a fit."""

    def __init__(self, predictor: Predictor, whitener: Whitener, fit: Fit) -> None:
        """
        Settle the postures where the fit is.

        Raises
        ------
        ArithmeticError
            They have no equilibrium.

        """
        self.predictor, self.whitener, self.fit = predictor, whitener, fit
        if predictor.markers(fit.point, near=predictor.settled) is None:
            raise ArithmeticError('a fit has no equilibrium')
        assert predictor.settled is not None
        self.settled: SettledShapes = predictor.settled

    def of(self, blocks: Sequence[Candidate]) -> Iterator[Joining]:
        """Yield how blocks may join; one whose law acts whatever its value, from several sizes."""
        catalogue = self.predictor.model.catalogue
        effects = {name: catalogue[name] for b in blocks for name in b.names if name in catalogue}
        smooth = [
            free
            for block in blocks
            for free in block.frees
            if free.effect not in effects or effects[free.effect].stage not in TURNING
        ]
        moved = self.predictor.tangent(self.fit.point, smooth, self.settled) if smooth else None
        slopes = {}
        if moved is not None:
            columns = -self.whitener.white(moved.markers)
            told = np.isfinite(columns).all(axis=1)
            slopes = {free: columns[i] for i, free in enumerate(smooth) if told[i]}
        for block in blocks:
            absent = set(block.names) - set(self.predictor.robot.effects)
            if any(effects[name].always_on for name in absent & set(effects)):
                yield from self._jumping(block)
                continue
            start = {f: described(self.predictor, f) + off(self.predictor, f) for f in block.frees}
            own = [
                slopes[free] if free in slopes else self._secant(free, value)
                for free, value in start.items()
            ]
            yield Joining(block, start, 0.0, np.array(own).T)

    def _secant(self, free: FreeParameter, value: float) -> Floats:
        """Return the derivative (N,) of the whitened residual from the described value on."""
        step = value - described(self.predictor, free)
        moved = self._residual({**self.fit.point, free: value})
        own = self.fit.residual[: self.whitener.size]
        return np.zeros_like(own) if moved is None else (moved - own) / step

    def _jumping(self, block: Candidate) -> Iterator[Joining]:
        """Yield how a block whose law jumps from absent to acting may join."""
        own = self.fit.residual[: self.whitener.size]
        for size in SIZES_TRIED:
            start = {free: _sized(free.parameter, size) for free in block.frees}
            here = self._residual({**self.fit.point, **start})
            if here is None:
                continue
            columns = []
            for free, value in start.items():
                step = TURNED_SHARE * value
                moved = self._residual({**self.fit.point, **start, free: value + step})
                columns.append(np.zeros_like(here) if moved is None else (moved - here) / step)
            yield Joining(block, start, here - own, np.array(columns).T)

    def _residual(self, point: Mapping[FreeParameter, float]) -> Floats | None:
        """Return the whitened residual (N,) at a point; None without equilibrium."""
        markers = self.predictor.markers(point, near=self.settled)
        if markers is None:
            return None
        return self.whitener.white(self.predictor.dataset.mean - markers)


def described(predictor: Predictor, free: FreeParameter) -> float:
    """Value in the description, moved inside the bounds of a fit."""
    return float(np.clip(predictor.value(free), free.parameter.low, free.parameter.high))


def off(predictor: Predictor, free: FreeParameter) -> float:
    """Return a small step from the described value that stays inside the bounds."""
    step = JOINING_STEP * free.parameter.typical
    return step if described(predictor, free) + step <= free.parameter.high else -step


def _sized(parameter: Parameter, size: float) -> float:
    return float(np.clip(size * parameter.typical, parameter.low, parameter.high))


def promised(residual: Floats, jacobian: Floats, whitener: Whitener, groups: Groups) -> float:
    """Return the mean squared error [m²] of left-out postures after one whole step of a fit."""
    step = covariance_of(jacobian, blind=0.0) @ (jacobian.T @ residual)
    errors = left_out_errors(residual - jacobian @ step, jacobian, whitener, groups)
    return float(np.nanmean(errors))


def grown(fit: Fit, joining: Joining, back: Floats, spread: Floats) -> tuple[Floats, Floats]:
    """
    Return residual (N + p,) and Jacobian (N + p, f) of a fit with a block and its priors.

    Parameters
    ----------
    back, spread : (q,)
        How far the block begins from what is described, and the sd of its priors.

    """
    n, q = joining.columns.shape
    columns = np.vstack([joining.columns, np.zeros((len(fit.residual) - n, q))])
    beside = np.zeros((q, fit.jacobian.shape[1]))
    residual = np.append(fit.residual, back / spread)
    residual[:n] += joining.change
    return residual, np.block([[fit.jacobian, columns], [beside, np.diag(1.0 / spread)]])


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
        told = np.maximum(1.0 - share, TELLS_ITSELF)
        left = residual[rows] + vectors @ (along / told - along)
        for p in np.unique(owners[rows]):
            metres = np.linalg.solve(whitener.root(p), left[owners[rows] == p])
            errors[p] = 3.0 * float(np.mean(metres**2))
    return errors
