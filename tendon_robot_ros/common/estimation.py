"""Gaussian estimates: the update by a linear measurement, and the fit of a model that is none."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from .arrays import Floats
from .errors import NoEquilibriumError

# [1] iterations of a search; one that takes more goes to and fro, or is held up by a region or a
# kink of friction, and would never end
ITERATIONS_MAX = 40
# [1] of a step, tried one after the other until the cost is lower, because far from the solution
# the model is not linear
STEP_LENGTHS = 1.0, 0.3, 0.1, 0.03
# [1] standard deviations of the estimate that the last step may move it, so that it is that of the
# solution
CONVERGED_SD = 0.05


class KalmanUpdate(NamedTuple):
    """An estimate after a measurement, and how well that agreed."""

    mean: Floats  # (n,) or (n, k)
    covariance: Floats  # (n, n)
    chi2: float  # of the residual; degrees of freedom: its size
    log_likelihood: float  # of the residual, up to a constant


def kalman_update(
    mean: Floats, covariance: Floats, columns: Floats, residual: Floats, noise: Floats
) -> KalmanUpdate:
    """
    Return a Gaussian estimate after a linear measurement (Kalman 1960, J. Basic Eng. 82, 35).

    Parameters
    ----------
    mean : (n,) or (n, k)
        k estimates that are measured alike have a column each.
    covariance : (n, n)
    columns : (r, n)
        How the state moves what is measured.
    residual : (r,) or (r, k)
        Measured minus predicted at the mean.
    noise : (r, r)
        Covariance of the measurement.

    """
    shared = columns @ covariance
    root = np.linalg.cholesky(shared @ columns.T + noise)
    white, gain = np.linalg.solve(root, residual), np.linalg.solve(root, shared)
    after = covariance - gain.T @ gain
    chi2 = float((white * white).sum())
    log_likelihood = -0.5 * chi2 - float(np.log(np.diag(root)).sum())
    return KalmanUpdate(mean + gain.T @ white, 0.5 * (after + after.T), chi2, log_likelihood)


def gauss_newton(
    start: Floats,
    information: Floats,
    residual_of: Callable[[Floats], Floats],
    columns_of: Callable[[Floats, Floats], Floats],
    bounds: tuple[Floats | float, Floats | float] = (-np.inf, np.inf),
) -> tuple[Floats, Floats, Floats]:
    """
    Return the likeliest values of a model with a Gaussian prior around 0.

    Gauss-Newton steps are shortened until the cost, the chi² of the residual and of the prior,
    decreases (Nocedal and Wright 2006, section 10.3).

    Parameters
    ----------
    start : (k,)
    information : (k, k)
        Inverse covariance of the prior.
    residual_of : callable
        From values to the whitened residual (r,) of the measurements; raises NoEquilibriumError.
    columns_of : callable
        From values and their residual to the whitened Jacobian (r, k) of the measurements.
    bounds : (k,) and (k,)
        Of the values.

    Returns
    -------
    values, their residual, and the Jacobian at these values or before the last step

    Raises
    ------
    NoEquilibriumError
        The model has no prediction at the start, or no Jacobian on the path.

    """
    values, white = start, residual_of(start)
    for _ in range(ITERATIONS_MAX):
        columns = columns_of(values, white)
        normal = columns.T @ columns + information
        step = np.linalg.solve(normal, columns.T @ white - information @ values)
        if step @ normal @ step < CONVERGED_SD**2:
            break
        cost = white @ white + values @ information @ values
        for length in STEP_LENGTHS:
            place = np.clip(values + length * step, *bounds)
            with suppress(NoEquilibriumError):
                candidate = residual_of(place)
                if candidate @ candidate + place @ information @ place < cost:
                    values, white = place, candidate
                    break
        else:
            break
    return values, white, columns
