"""What a fit tells of the arm as it is built: how much it scatters, and what is out of line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..comparison.statistics import chi2_isf, normal_ppf
from .as_built import REMAINDER
from .decide import FALSE_OUT_OF_LINE_PROBABILITY, TOLD_SPAN_MAX
from .fit import Fit
from .size_intervals import SizeIntervals

if TYPE_CHECKING:
    from .session import Session


def arm_report(session: Session, fit: Fit) -> dict[str, Any] | None:
    """
    Return the estimated scatter of each kind with its 95 % interval, and the members out of line.

    Sizes in SI; no upper end is None. A size is `told` where the measurements would tell a
    plausible one, whatever they tell of this arm: to print what came out large would pick what
    came out too large. A member is out of line where it deviates by more of what is plausible than
    the largest of so many would. None where the description counts as exact.
    """
    built, random = fit.built, session.random
    if built is None or random is None:
        return None
    sizes = built.estimate(told=False).values
    slopes = fit.jacobian[: len(random.columns), : len(fit.all_frees)]
    intervals = SizeIntervals(random, sizes, slopes, fit.precisions)
    lows, highs = intervals.ends(sizes)
    least, most = intervals.ends(random.plausible)
    told = (most < TOLD_SPAN_MAX * least) & ((lows > 0.0) | np.isfinite(highs))
    found, kinds = fit.members or {}, []
    for k, kind in enumerate(built.kinds):
        if kind.name == REMAINDER:
            continue
        values, spread = found[kind.name], _posterior(fit, k)
        size = float(sizes[k])
        quantile = chi2_isf(FALSE_OUT_OF_LINE_PROBABILITY / len(values), 1)
        limit = np.sqrt(quantile) * max(size, kind.plausible)
        members = zip(kind.members, values, spread, strict=True)
        kinds.append(
            {
                'kind': kind.name,
                'unit': kind.unit,
                'size': size,
                'low': float(lows[k]),
                'high': float(highs[k]) if np.isfinite(highs[k]) else None,
                'plausible': kind.plausible,
                'members': {name: _member(value, sd) for name, value, sd in members},
                'told': bool(told[k]),
                'out_of_line': [
                    name
                    for name, value in zip(kind.members, values, strict=True)
                    if abs(value) > limit
                ],
            }
        )
    last = float(sizes[-1])
    return {'kinds': kinds, 'remainder': last, 'floor': floor_as_built(session, fit)}


def _posterior(fit: Fit, k: int) -> np.ndarray:
    """Return what is left of the standard deviation (q,) of the members of a kind."""
    built = fit.built
    assert built is not None
    own = len(fit.all_frees) + np.flatnonzero(built.random.owners == k)
    mix = built.random.mixtures[k]  # what they do not mix the data do not show
    told = ((mix @ fit.covariance[np.ix_(own, own)]) * mix).sum(axis=1)
    unseen = 1.0 - (mix * mix).sum(axis=1)
    return np.asarray(built.sizes[k] * np.sqrt(np.maximum(unseen + told, 0.0)))


def _member(value: float, sd: float) -> dict[str, float]:
    half = normal_ppf(0.975) * float(sd)
    return {'value': float(value), 'low': float(value) - half, 'high': float(value) + half}


def floor_as_built(session: Session, fit: Fit) -> float:
    """Return the expected rms [m] of a perfect model of an arm that scatters like this."""
    return _floor(session, None if fit.built is None else fit.built.sizes)


def usual_floor(session: Session) -> float:
    """Return the expected rms [m] of a perfect model of an arm that is built as usual."""
    return _floor(session, None if session.random is None else session.random.plausible)


def _floor(session: Session, sizes: np.ndarray | None) -> float:
    noise = session.whitener.floor()
    if sizes is None or session.imperfections is None:
        return noise
    seen = session.dataset.counts > 0
    spread = [
        np.full(len(kind), size if kind.name != REMAINDER else 0.0)
        for kind, size in zip(session.imperfections.kinds, sizes, strict=True)
    ]
    lengths = np.linalg.norm(session.imperfections.moves, axis=3)
    moved = ((np.concatenate(spread)[:, None, None] * lengths) ** 2).sum(axis=0)
    return float(np.sqrt(noise**2 + moved[seen].mean()))
