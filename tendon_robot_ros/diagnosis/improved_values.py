"""
How far the values of an improved description may be off, the arm being as it is built.

The search weighs what it cannot explain as new in every posture. Imperfections are the same in
all of them, so that postures tell less than they are many. Values stay those of the search, linear
in the residual r with A = J M, M = (J'J + P)^-1, under its weights W; their covariance is that
which noise, imperfections B of likely sizes S and a remainder give such an estimator:
A'W (noise + B S B') W'A + M P M, P being the precision of the priors.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ..comparison.noise import Whitener, input_slopes
from ..comparison.predict import Predictor
from ..comparison.statistics import normal_ppf, t_ppf
from .as_built import Imperfections
from .described_arm import OF_THE_ARM
from .fit import Fit, covariance_of
from .marginal import RandomEffects
from .stepwise import State, Stepwise

Floats = npt.NDArray[np.float64]
FREEDOM_MIN, FREEDOM_MAX = 2.0, 1e4  # degrees of freedom that a value may have


def as_known(
    search: Stepwise, final: State, predictor: Predictor, found: Imperfections | None
) -> Fit:
    """
    Return the fit of the effects of the catalogue, with the covariance that its values have.

    Parameters
    ----------
    search : Stepwise
    final : State
        What it found.
    predictor : Predictor
        Of the description with what was found.
    found : Imperfections, optional
        Of that description; None: it is exact.

    """
    if found is None:
        spread = covariance_of(final.fit.jacobian)
    else:
        plain = Whitener(search.dataset, search.noise, input_slopes(predictor, {}))
        spread = covariance_as_built(final.fit, final.whitener, plain, search.measured, found)
    own = np.flatnonzero([free.effect not in OF_THE_ARM for free in final.fit.frees])
    jacobian = np.linalg.inv(np.linalg.cholesky(spread[np.ix_(own, own)]))
    effects = tuple(final.fit.frees[i] for i in own)
    nothing = np.zeros(len(own))
    return replace(final.fit, frees=effects, values=final.fit.values[own], residual=nothing,
                   jacobian=jacobian)  # fmt: skip


def covariance_as_built(
    fit: Fit, whitener: Whitener, plain: Whitener, measured: Floats, found: Imperfections
) -> Floats:
    """
    Return the covariance (q, q) of values that weights have found, of an arm as it is built.

    Parameters
    ----------
    fit : Fit
        Rows of the priors last.
    whitener, plain : Whitener
        Weights of the fit; of the noise alone.
    measured : (P, J, 3) [m]
    found : Imperfections
        What may be off; what the parameters of the fit stand for does not count.

    """
    claimed = {free.parameter.tolerance for free in fit.frees}
    counts = np.array([kind.name not in claimed for kind in found.kinds])
    kept = counts[found.owners]
    kinds = [kind for kind, own in zip(found.kinds, counts, strict=True) if own]
    owners = (np.cumsum(counts) - 1)[found.owners[kept]]
    random = RandomEffects(plain.white(found.moves[kept]).T, owners, kinds)

    told, prior = fit.jacobian[: whitener.size], fit.jacobian[whitener.size :]
    slopes = _reweighed(told, whitener, plain)
    residual, precision = plain.white(measured - fit.markers), prior.T @ prior
    sizes = random.estimate(residual, slopes, weights=np.diag(precision)).values

    known = covariance_of(fit.jacobian)
    answers = _answers(told @ known, whitener, plain)
    by_arm = random.columns.T @ answers  # (r, q) of a mixture of unit size
    spread = answers.T @ answers + by_arm.T @ (random.spread(sizes)[:, None] ** 2 * by_arm)
    wider = _wider(random, sizes, by_arm, np.diag(spread))
    scale = _excess(random, sizes, residual, slopes) * np.outer(wider, wider)
    return np.asarray(scale * spread + known @ precision @ known)


def _wider(random: RandomEffects, sizes: Floats, by_arm: Floats, variance: Floats) -> Floats:
    """
    Return by how much (q,) intervals widen since the sizes of imperfections are estimated.

    Student's t of as many degrees of freedom as give the variance of a value its own uncertainty
    (Satterthwaite 1946).
    """
    shares = np.array([(by_arm[random.owners == k] ** 2).sum(axis=0) for k in range(len(sizes))])
    doubt = np.einsum('kq,kl,lq->q', shares, random.doubt(sizes), shares)
    freedom = np.clip(2.0 * variance**2 / np.maximum(doubt, 1e-300), FREEDOM_MIN, FREEDOM_MAX)
    return np.array([t_ppf(0.975, one) for one in freedom]) / normal_ppf(0.975)


def _reweighed(rows: Floats, before: Whitener, after: Whitener) -> Floats:
    """Return rows (N, q) that are whitened by other weights than before."""
    made = np.empty_like(rows)
    for own, old, new in _postures(before, after):
        made[own] = new @ np.linalg.solve(old, rows[own])
    return made


def _answers(rows: Floats, before: Whitener, after: Whitener) -> Floats:
    """Return by how much values (N, q) answer to errors under other weights than before."""
    made = np.empty_like(rows)
    for own, old, new in _postures(before, after):
        made[own] = np.linalg.solve(new.T, old.T @ rows[own])
    return made


def _postures(
    before: Whitener, after: Whitener
) -> Iterator[tuple[npt.NDArray[np.intp], Floats, Floats]]:
    """Yield the rows of every posture, and its weights (n, n) before and after."""
    for p in np.unique(before.owners):
        yield np.flatnonzero(before.owners == p), before.root(p), after.root(p)


def _excess(random: RandomEffects, sizes: Floats, residual: Floats, slopes: Floats) -> float:
    """Return chi² over freedom, 1 at least: how much more is left than this likelihood expects."""
    root = random.root(sizes)
    off, tangents = random.lift(root, residual), random.lift(root, slopes)
    left = off - tangents @ np.linalg.lstsq(tangents, off, rcond=1e-10)[0]
    chi2 = float(left @ left)
    return float(max(1.0, chi2 / max(len(off) - slopes.shape[1], 1)))
