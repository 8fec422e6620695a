"""Several effects at once: which further ones are worth a fit, pairs, and when one is enough."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ..comparison.predict import FreeParameter, Point
from ..effects import Catalogue
from .candidates import Candidate, Ranked
from .decide import (
    APART_FROM_SCORE,
    EFFECTS_MAX,
    FIRST_STEP_GAIN_MIN,
    NEAR_SCORE,
    PAIRED_MAX,
)
from .search import LADDER
from .session import Session

Floats = npt.NDArray[np.float64]


def several(session: Session, singles: Sequence[Ranked]) -> Ranked | None:
    """
    Search two or three effects that are adequate together: greedy, then pairs and swaps.

    Returns the best combination found, adequate or not; None when nothing could be combined.
    """
    order = sorted(singles, key=lambda r: r.score)
    current: Ranked = order[0]
    best: Ranked | None = None
    for size in range(2, EFFECTS_MAX + 1):
        extended = _extended(session, current)
        if size == 2 and not any(session.holds(f) for f in extended):
            extended += _pairs(session, order[:PAIRED_MAX], current)
        if not extended:
            break
        current = best = min(extended, key=lambda r: r.score)
        if session.holds(best):
            best = _pruned(session, reweighed(session, best))
            if session.holds(best):
                break
    return best


def _pruned(session: Session, ranked: Ranked) -> Ranked:
    """Take out of three effects one that the other two make needless: by it the score falls."""
    while len(ranked.candidate.names) > 2:
        fewer = [ranked.candidate.without(name) for name in ranked.candidate.names]
        starts = {
            c.label: {free: ranked.fit.point[free] for free in c.frees if free in ranked.fit.point}
            for c in fewer
        }
        best = min(session.fit_all(fewer, starts, 'fewer effects'), key=lambda r: r.score)
        if best.score > ranked.score:
            break
        ranked = best
    return ranked


def joined(session: Session, best: Ranked) -> Ranked | None:
    """
    Join a second effect, and a third, to an adequate one while the gain is more than chance would.

    An arm as built may scatter as much as a second effect needs; that it need not is told by the
    likelihood. None where one is enough.
    """
    current = best
    while len(current.candidate.names) < EFFECTS_MAX:
        more = [
            r
            for r in _extended(session, current)
            if session.stands_out(current.fit, r, len(session.candidates))
            and r.score < current.score - APART_FROM_SCORE
        ]
        if not more:
            break
        current = reweighed(session, min(more, key=lambda r: r.score))
    return None if current is best else current


def reweighed(session: Session, ranked: Ranked) -> Ranked:
    """Fit a candidate again with noise and weights taken at its own fit."""
    for _ in range(2):
        session.weigh(ranked.fit.point, ranked.fit.around)
        ranked = session.fit_all([ranked.candidate], {ranked.candidate.label: ranked.fit})[0]
    return ranked


def hints(session: Session, current: Ranked, larger: Candidate) -> bool:
    """
    Tell whether further parameters would gain, by a look at them that costs much less than a fit.

    A first step of each; of an effect whose neutral value is no absence, a ladder of sizes.
    """
    built = current.fit.built
    if session.random is None or built is None:
        return True
    session.fitters[0].resume(current.fit)
    more = [free for free in larger.frees if free not in current.fit.point]
    if any(session.catalogue[free.effect].always_on for free in more):
        return _ladder_hints(session, current, more)
    columns = _first_steps(session, current, more)
    return columns is None or _gain(session, current, {}, columns) > FIRST_STEP_GAIN_MIN


def _gain(
    session: Session, current: Ranked, point: Point, columns: Sequence[Floats] = ()
) -> float:
    """
    Return what the deviance falls by at other values, as far as linear parameters go along.

    Those of the fit, with derivatives as they are there, and more with `columns` (N,).
    """
    random, built = session.random, current.fit.built
    assert random is not None and built is not None
    fitter, n = session.fitters[0], len(random.columns)
    markers = fitter.predictor.markers({**current.fit.point, **point})
    if markers is None:
        return -np.inf
    slopes = current.fit.jacobian[:n, : len(current.fit.all_frees)]
    slopes = np.column_stack([slopes, *(column[:n] for column in columns)])
    estimated = random.estimate(fitter.residual(markers), slopes, built.sizes)
    return float(current.fit.deviance - estimated.deviance)


def _ladder_hints(session: Session, current: Ranked, more: Sequence[FreeParameter]) -> bool:
    """
    Tell whether an effect that is always on may gain at one of a ladder of sizes.

    Nothing but linear parameters follows there, so that it may even look a little worse.
    """
    for factor in LADDER:
        point = {}
        for free in more:
            own = free.parameter
            size = session.predictor.value(free) if own.has_default else factor * own.typical
            point[free] = float(np.clip(size, own.low, own.high))
        if _gain(session, current, point) > -NEAR_SCORE:
            return True
    return False


def _first_steps(
    session: Session, current: Ranked, more: Sequence[FreeParameter]
) -> list[Floats] | None:
    """Return the derivatives (N,) by further parameters; None where one has no equilibrium."""
    predictor, point = session.fitters[0].predictor, current.fit.point
    here, columns = predictor.markers(point), list[Floats]()
    if here is None:
        return columns
    near = predictor.settled
    for free in more:
        value, step = session.predictor.value(free), 0.05 * free.parameter.typical
        if value + step > free.parameter.high:
            step = -step
        moved = predictor.markers({**point, free: value + step}, near=near)
        if moved is None:
            return None
        columns.append(session.whitener.white(here - moved)[:, None] / step)
    return columns


def _extended(session: Session, current: Ranked) -> list[Ranked]:
    """Fit the current effects with each other one whose first step gains."""
    order = [c for c in _extensions(session, current) if hints(session, current, c)]
    starts = {c.label: current.fit for c in order}
    return session.fit_joint(order, starts, f'{len(current.candidate.names) + 1} effects')


def _extensions(session: Session, current: Ranked) -> list[Candidate]:
    """List the current effects with each other one that the postures show there."""
    tested, _ = session.split_tested(current.fit.point)
    have = set(current.candidate.names)
    return [
        current.candidate.with_(c)
        for c in tested
        if not have & set(c.names) and not _overlaps(session.catalogue, c, have)
    ]


def _pairs(session: Session, order: Sequence[Ranked], known: Ranked) -> list[Ranked]:
    """Fit the pairs among the best single effects; those with one of them are known."""
    pairs, starts = [], {}
    order = [r for r in order if r is not known]
    for i, first in enumerate(order):
        for second in order[i + 1 :]:
            pair = first.candidate.with_(second.candidate)
            if _overlaps(session.catalogue, second.candidate, set(first.candidate.names)):
                continue
            pairs.append(pair)
            starts[pair.label] = first.fit
    return session.fit_joint(pairs, starts, 'pairs')


def _overlaps(catalogue: Catalogue, candidate: Candidate, have: set[str]) -> bool:
    """Tell whether a candidate contains, or is contained in, one that is already there."""
    name = candidate.names[0]
    return bool(set(catalogue[name].contains) & have) or any(
        name in catalogue[other].contains for other in have
    )
