"""What a diagnosis gathers before it decides: fits of the base model and of every candidate."""

from __future__ import annotations

from dataclasses import dataclass

from .candidates import Candidate, Ranked
from .fit import Fit
from .patterns import Pattern
from .session import Session

ALPHA = 0.005  # of the omnibus alarm and of the best candidate's alarm, each
STRAY = 3.0  # declared sd that a quantity may move


@dataclass
class Evidence:
    """All that the decision looks at."""

    session: Session
    base: Fit
    singles: list[Ranked]
    not_tested: list[Candidate]
    best: Ranked | None = None
    rival: Pattern | None = None
    scale: float = 1.0  # chi² over freedom of the best, where nothing is adequate


def gather(session: Session) -> Evidence:
    """Fit the base and every candidate; weights are taken twice at the best candidate's fit."""
    session.weigh({})
    base = session.base_fit()
    tested, not_tested = session.split_tested(base.point)
    singles = session.fit_all(tested)
    for _ in range(2):
        if not singles:
            break
        best = session.best(singles)
        session.weigh(best.fit.point)
        starts = {r.candidate.label: r.fit.point for r in singles}
        singles = session.fit_all([r.candidate for r in singles], starts)
    base = session.base_fit()
    found = Evidence(session, base, singles, not_tested)
    found.best = session.best(singles) if singles else None
    return found


def is_alarming(found: Evidence) -> bool:
    """Tell whether the base model is off: as a whole, beyond a tolerance, or one effect gains."""
    session, base = found.session, found.base
    if base.probability(session.freedom) < ALPHA:
        return True
    if any(abs(z) > STRAY for z in base.pulls.values()):
        return True
    if found.best is None:
        return False
    held, _ = base.held_out(session.whitener.owners)
    return any(
        session.luck(base, r) * len(found.singles) < ALPHA and r.held_out < held
        for r in found.singles
    )
