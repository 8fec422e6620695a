"""Gaussian estimates: the update by a linear measurement, and the fit of a model that is none."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .arrays import Floats

# [1] iterations of a fit; one that takes more goes to and fro, and would never end
ITERATIONS_MAX = 12
# [1] of a step, tried one after the other until the cost is lower, because far from the solution
# the model is not linear
STEP_LENGTHS = 1.0, 0.5, 0.2, 0.05, 0.01
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


def gauss_newton[Left](
    start: Floats,
    information: Floats,
    left: Callable[[Floats], tuple[Left, float] | None],
    linearised: Callable[[Floats, Left], tuple[Floats, Floats] | None],
    bounds: tuple[Floats | float, Floats | float] = (-np.inf, np.inf),
) -> tuple[Floats, Left, float, Floats] | None:
    """
    Return the likeliest values of a model with a Gaussian prior around 0.

    Steps are shortened until the cost, chi² of what is left and of the prior, is lower.

    Parameters
    ----------
    start : (k,)
    information : (k, k)
        Inverse covariance of the prior.
    left : callable
        From values to what they leave of the measurements, and its chi²; None where the model
        says nothing.
    linearised : callable
        From values and what they leave to J' V^-1 J (k, k) and J' V^-1 r (k,).
    bounds : (k,) and (k,)
        Of the values.

    Returns
    -------
    values, what they leave, its chi², and J' V^-1 J (k, k) there; None where the model says
    nothing.

    """
    values, here = start, left(start)
    told = np.zeros_like(information)
    for _ in range(ITERATIONS_MAX):
        slopes = None if here is None else linearised(values, here[0])
        if here is None or slopes is None:
            return None
        told, gradient = slopes
        step = np.linalg.solve(told + information, gradient - information @ values)
        if step @ (told + information) @ step < CONVERGED_SD**2:
            break
        cost = here[1] + values @ information @ values
        for length in STEP_LENGTHS:
            place = np.clip(values + length * step, *bounds)
            there = left(place)
            if there is not None and there[1] + place @ information @ place < cost:
                values, here = place, there
                break
        else:
            break
    assert here is not None
    return values, *here, told
