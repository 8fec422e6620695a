"""Which effects the measurements cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence

from .candidates import Ranked
from .decide import APART_FROM_SCORE, SAME_WITHIN_CHI2
from .session import Session


def indistinct(session: Session, ranked: Sequence[Ranked], gate: float) -> list[Ranked]:
    """
    Return the adequate candidates that cannot be told apart, the best first.

    Within chi² + 2 k of 9.21 of the best; a larger candidate that contains a smaller one of the
    class drops out; among ties the first of the catalogue is best.
    """
    adequate = [r for r in ranked if r.probability > gate]
    top = min(r.score for r in adequate)
    near = [r for r in adequate if r.score <= top + APART_FROM_SCORE]
    kept = [
        r
        for r in near
        if not any(small is not r and contains(session, r, small) for small in near)
    ]
    best = session.best(kept)
    return sorted(kept, key=lambda r: r is not best)


def contains(session: Session, large: Ranked, small: Ranked) -> bool:
    """Tell whether the larger candidate can predict just what the smaller one predicts here."""
    if small.candidate.names[0] in session.catalogue[large.candidate.names[0]].contains:
        return True
    if set(small.candidate.names) < set(large.candidate.names):
        return True
    if large.fit.rank <= small.fit.rank:
        return False
    mimic = session.mimic(small.fit.markers, large.candidate.frees, large.fit.point, small.fit)
    return mimic.chi2 < SAME_WITHIN_CHI2
