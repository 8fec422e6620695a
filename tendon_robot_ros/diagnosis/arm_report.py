"""What a fit tells of the arm as it is built: how much it scatters, and what is out of line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..comparison.statistics import chi2_isf, normal_ppf
from .as_built import REMAINDER
from .fit import Fit

if TYPE_CHECKING:
    from .session import Session

FALSE_ALARM_PROBABILITY = 0.05  # that any member of a healthy arm is called out of line
TOLD_VARIANCE_SHARE = 0.5  # of its variance that the data must take off a member


def arm_report(session: Session, fit: Fit) -> dict[str, Any] | None:
    """
    Return the estimated scatter of each kind with its 95 % interval, and the members out of line.

    Sizes in SI. A member is out of line where it deviates by more of what is plausible than the
    largest of so many would. None where the description counts as exact.
    """
    built, random = fit.built, session.random
    if built is None or random is None:
        return None
    lows, highs = random.intervals(built.sizes)
    first = len(fit.all_frees)
    posterior = np.sqrt(np.diag(fit.covariance)[first:]) * built.spread
    values = fit.values[first:] * built.spread
    kinds = []
    for k, kind in enumerate(built.kinds):
        if kind.name == REMAINDER:
            continue
        own = np.flatnonzero(built.owners == k)
        size = float(built.sizes[k])
        quantile = chi2_isf(FALSE_ALARM_PROBABILITY / len(own), 1)
        limit = np.sqrt(quantile) * max(size, kind.plausible)
        determined = [
            i for i in own if posterior[i] < TOLD_VARIANCE_SHARE * max(built.spread[i], 1e-30)
        ]
        kinds.append(
            {
                'kind': kind.name,
                'unit': kind.unit,
                'size': size,
                'low': float(lows[k]),
                'high': float(highs[k]),
                'plausible': kind.plausible,
                'members': {
                    kind.members[i - own[0]]: _member(values[i], posterior[i]) for i in own
                },
                'told': len(determined),
                'out_of_line': [kind.members[i - own[0]] for i in own if abs(values[i]) > limit],
            }
        )
    last = float(built.sizes[-1])
    return {'kinds': kinds, 'remainder': last, 'floor': floor_as_built(session, fit)}


def _member(value: float, sd: float) -> dict[str, float]:
    half = normal_ppf(0.975) * float(sd)
    return {'value': float(value), 'low': float(value) - half, 'high': float(value) + half}


def floor_as_built(session: Session, fit: Fit) -> float:
    """Return the expected rms [m] of a perfect model of an arm that scatters like this."""
    noise = session.whitener.floor()
    if fit.built is None or session.moves is None:
        return noise
    seen = session.dataset.counts > 0
    keep = np.array([kind.name != REMAINDER for kind in fit.built.kinds])[fit.built.owners]
    spread = (fit.built.spread * keep)[:, None, None]
    moved = ((spread * np.linalg.norm(session.moves, axis=3)) ** 2).sum(axis=0)
    return float(np.sqrt(noise**2 + moved[seen].mean()))
