"""The smallest size of every effect that the postures of a data set would show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from .candidates import Candidate
from .fit import Fit
from .predict import Free
from .probability import chi2_isf
from .session import Session

Floats = npt.NDArray[np.float64]
POWER = 0.8  # share of cases in which such a size raises the alarm
ALPHA = 0.005  # of the best candidate's alarm


@dataclass(frozen=True)
class Seen:
    """Smallest size of one parameter; None where no size within its bounds would show."""

    free: Free
    size: float | None


def smallest_sizes(
    session: Session, base: Fit, candidates: Sequence[Candidate]
) -> tuple[Seen, ...]:
    """
    Return the smallest sizes of missing effects, parameter by parameter.

    The size at which the whitened change of the markers, less what the declared tolerances can
    take up, is long enough for the likelihood ratio to raise the alarm in `POWER` of the cases.
    """
    found = []
    for candidate in candidates:
        effect = session.catalogue[candidate.names[0]]
        if candidate.present or effect.always_on or effect.stage == 'memory':
            continue
        for free in candidate.frees:
            one_sided = len(candidate.frees) == 1 and free.parameter.neutral in (
                free.parameter.low,
                free.parameter.high,
            )
            alpha = ALPHA / max(len(candidates), 1) * (2.0 if one_sided else 1.0)
            length = np.sqrt(noncentrality(len(candidate.frees), alpha))
            found.append(Seen(free, _size(session, base, free, float(length))))
    return tuple(found)


def _size(session: Session, base: Fit, free: Free, length: float) -> float | None:
    """Return the size whose change of the markers is so long, by scaling it until it fits."""
    parameter, size = free.parameter, 0.1 * free.parameter.typical
    start = base.point.get(free, session.predictor.value(free))
    side = 1.0 if start + size <= parameter.high else -1.0
    for _ in range(8):
        change = _change(session, base, free, start + side * size)
        if change is None or change <= 0.0:
            return None
        ratio = length / change
        size *= float(np.clip(ratio, 0.1, 10.0))
        if abs(ratio - 1.0) < 0.02:
            break
    return size if parameter.low <= start + side * size <= parameter.high else None


def _change(session: Session, base: Fit, free: Free, value: float) -> float | None:
    """Length of the whitened change of the markers, after the tolerances took up their part."""
    markers = session.predictor.markers({**base.point, free: value})
    if markers is None:
        return None
    if not session.nuisances:
        change = session.whitener.white(markers - base.markers)
        return float(np.linalg.norm(change))
    fitter = session.fitter(session.predictor)
    fitter.measured = markers
    try:
        return float(np.sqrt(fitter.fit((), base.point).chi2))
    except (ArithmeticError, np.linalg.LinAlgError):
        return None


@cache
def noncentrality(freedom: int, alpha: float) -> float:
    """Squared length that lifts chi² over its threshold in `POWER` of the cases."""
    threshold = chi2_isf(alpha, freedom)
    noise = np.random.default_rng(0).normal(size=(20_000, freedom))
    rest = (noise[:, 1:] ** 2).sum(axis=1)
    low, high = 0.0, 100.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        power = float(((noise[:, 0] + middle) ** 2 + rest > threshold).mean())
        low, high = (middle, high) if power < POWER else (low, middle)
    return high**2
