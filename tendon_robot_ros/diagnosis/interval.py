"""95 % intervals of fitted parameters: from the curvature, or by profile likelihood."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ..comparison.predict import FreeParameter, Point, Predictor, SettledShapes
from ..comparison.statistics import normal_ppf
from ..comparison.tangent import Tangent
from .fit import Fit
from .fitter import Fitter
from .likelihood import Likelihood

Floats = npt.NDArray[np.float64]
QUANTILE = normal_ppf(0.975)
PROFILE_FROM_ERROR = 0.1  # relative error of a Gaussian endpoint from which the profile decides
SEARCH_STEPS_MAX = 6  # of the search for an endpoint


class Pinned(Predictor):
    """A predictor some of whose parameters stay where they are put."""

    def __init__(self, predictor: Predictor, values: Point) -> None:
        """Share everything with the predictor."""
        self.__dict__.update(predictor.__dict__)
        self._inner, self._pinned = predictor, dict(values)

    def markers(
        self,
        point: Point,
        inputs: Floats | None = None,
        stiffness: Floats | None = None,
        near: SettledShapes | None = None,
    ) -> Floats | None:
        """Predict markers (P, J, 3) [m]; see `Predictor.markers`."""
        predicted = self._inner.markers({**point, **self._pinned}, inputs, stiffness, near)
        self.settled = self._inner.settled
        return predicted

    def tangent(
        self, point: Point, frees: Sequence[FreeParameter], settled: SettledShapes
    ) -> Tangent | None:
        """Return how freed parameters move what settled; see `Predictor.tangent`."""
        return self._inner.tangent({**point, **self._pinned}, frees, settled)


def intervals(
    fitter: Fitter, fit: Fit, scale: float = 1.0
) -> dict[FreeParameter, tuple[float, float]]:
    """
    Return 95 % intervals of the free parameters of a settled fit.

    An endpoint comes from the curvature at the fit where chi² there is what the curvature says;
    else (bounds, asymmetry, friction's kinks) it is where the profile of chi² has risen by 3.84.
    Of an arm as built the deviance at the estimated sizes of its imperfections says only whether
    the model is straight; how wide the interval is knows how well these sizes are told.

    Parameters
    ----------
    fitter : Fitter
        The one of the fit.
    fit : Fit
    scale : float
        Chi² over freedom where the fit is not adequate: intervals widen by its root.

    """
    wide = QUANTILE * math.sqrt(scale)
    fitter.resume(fit)
    ends = {}
    for i, free in enumerate(fit.frees):
        spread = float(np.sqrt(max(fit.told[i, i], 0.0)))
        if not np.isfinite(spread):
            ends[free] = (free.parameter.low, free.parameter.high)
            continue
        low, high = (_endpoint(fitter, fit, i, side * spread, wide) for side in (-1.0, 1.0))
        ends[free] = (low, high)
    return ends


def _endpoint(fitter: Fitter, fit: Fit, i: int, spread: float, wide: float) -> float:
    """Where the profile has risen by wide² on one side; the bound where it never does."""
    value, parameter = float(fit.values[i]), fit.frees[i].parameter
    bound = parameter.high if spread > 0.0 else parameter.low
    end = value + wide * spread
    wide *= abs(spread) / math.sqrt(fit.covariance[i, i])  # of what rises at the estimated sizes
    outside = end > parameter.high if spread > 0.0 else end < parameter.low
    first, profile = (_ridge_rise, _profile_rise) if fit.built is None else (_risen, _risen)
    if not outside:
        rise = first(fitter, fit, i, end)
        if abs(rise - wide) < PROFILE_FROM_ERROR * wide:
            return end
    if value == bound:
        return value
    plain, end = end, bound if outside else end
    rise = profile(fitter, fit, i, end)
    if outside and rise < wide:
        return bound
    for _ in range(SEARCH_STEPS_MAX):
        if abs(rise - wide) < 0.02 * wide or not np.isfinite(rise):
            break
        stretch = float(np.clip(wide / max(rise, 1e-6), 0.2, 5.0))
        end = float(np.clip(value + (end - value) * stretch, parameter.low, parameter.high))
        rise = profile(fitter, fit, i, end)
        if end == bound and rise < wide:
            break
    return end if np.isfinite(rise) else plain


def _ridge_rise(fitter: Fitter, fit: Fit, i: int, end: float) -> float:
    """Root of the rise of chi² where the curvature says the profile runs; NaN: no equilibrium."""
    moved, prior = _along(fit, i, end)
    markers = fitter.predictor.markers(moved)
    if markers is None:
        return float('nan')
    white = fitter.residual(markers)
    return float(np.sqrt(max(float(white @ white) + prior - fit.chi2, 0.0)))


def _along(fit: Fit, i: int, end: float) -> tuple[Point, float]:
    """Return the point at which the curvature says the profile runs, and chi² of its priors."""
    share = fit.covariance[:, i] / fit.covariance[i, i]
    moved = (fit.values + np.nan_to_num(share) * (end - fit.values[i]))[: len(fit.all_frees)]
    lows = [f.parameter.low for f in fit.frees] + [-np.inf] * len(fit.nuisances)
    highs = [f.parameter.high for f in fit.frees] + [np.inf] * len(fit.nuisances)
    moved = np.clip(moved, lows, highs)
    prior = [
        (value - n.centre) / n.spread
        for value, n in zip(moved[len(fit.frees) :], fit.nuisances, strict=True)
    ]
    point = dict(zip(fit.all_frees, moved.tolist(), strict=True))
    return point, float(np.sum(np.square(prior)))


def _risen(fitter: Fitter, fit: Fit, i: int, end: float) -> float:
    """Root of the rise of the deviance of an arm as built; NaN: no equilibrium."""
    here, there = (_deviance(fitter, fit, i, at) for at in (float(fit.values[i]), end))
    return float(np.sqrt(max(there - here, 0.0)))


def _deviance(fitter: Fitter, fit: Fit, i: int, at: float) -> float:
    """Deviance with one parameter put somewhere: all else goes along, but for the sizes."""
    moved, prior = _along(fit, i, at)
    markers = fitter.predictor.markers(moved)
    if markers is None or fit.built is None:
        return float('nan')
    others = np.delete(np.arange(len(fit.all_frees)), i)
    slopes = fit.jacobian[: fitter.whitener.size, others]
    parts, sizes = fit.built.random.parts, fit.built.sizes
    likelihood = Likelihood(parts, fitter.residual(markers), slopes, fit.precisions[others])
    return likelihood.deviance(sizes**2) + prior


def _profile_rise(fitter: Fitter, fit: Fit, i: int, end: float) -> float:
    """Root of the rise of chi² with one parameter put somewhere and all others refitted."""
    free, others = fit.frees[i], fit.frees[:i] + fit.frees[i + 1 :]
    pinned = Fitter(
        Pinned(fitter.predictor, {free: end}),
        fitter.whitener,
        fit.nuisances,
        fitter.columns,
        fitter.built,
    )
    pinned.resume(fit)
    sizes = None if fit.built is None else fit.built.sizes
    try:
        refit = pinned.fit(others, fit.point, turns=8, sizes=sizes)
    except (ArithmeticError, np.linalg.LinAlgError):
        return float('inf')
    return float(np.sqrt(max(refit.chi2 - fit.chi2, 0.0)))
