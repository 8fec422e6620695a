"""Diagnose: which physical effect is missing, and how sure is that."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..data import DataSet
from ..effects import Catalogue, load_catalogue
from ..robot import Robot
from .candidates import TWINS, Ranked
from .evidence import STRAY, Evidence, gather, is_alarming
from .next_measurement import propose
from .noise import rms
from .patterns import Pattern, Rivals
from .remainder import remainder_text
from .report_rows import details_of, finding, rows_of
from .result import Diagnosis
from .session import APART, SINGLE, Progress, Session, indistinct, several


def diagnose(
    dataset: DataSet,
    robot: Robot | None = None,
    catalogue: Catalogue | None = None,
    workers: int = 2,
    progress: Progress | None = None,
) -> Diagnosis:
    """
    Name the physical effect whose absence explains the error of a model on a data set.

    Parameters
    ----------
    dataset : DataSet
    robot : Robot, optional
        The description to judge; default: the data set's.
    catalogue : Catalogue, optional
        The effects to consider; default: the built-in ones and installed ones.
    workers : int
        Threads.
    progress : callable, optional
        Called with (what, done, total).

    Raises
    ------
    TendonRobotError
        The description does not fit the catalogue, or the model finds no equilibrium at all.

    """
    session = Session(
        dataset, robot or dataset.robot, catalogue or load_catalogue(), workers, progress
    )
    lacking = _what_is_lacking(session)
    if lacking:
        return _cannot_judge(session, lacking)
    found = gather(session)
    if not is_alarming(found):
        return _adequate(found)
    verdict = decide(found)
    if verdict.verdict == 'outside_catalogue' and session.accuracy and not session.use_accuracy:
        session.use_accuracy = True
        found = gather(session)
        return _adequate(found) if not is_alarming(found) else decide(found)
    return verdict


def _what_is_lacking(session: Session) -> str:
    """Say what is needed before anything can be judged; empty when nothing is."""
    dataset = session.dataset
    measured = int((dataset.trials > 0).sum())
    if measured < 2:
        return f'{measured} measured posture(s): two or more are needed, six are better'
    if session.predictor.markers({}) is None:
        from ..exceptions import NoEquilibriumError

        raise NoEquilibriumError(
            'a posture of this data set', session.predictor.model.implicit_effects, np.inf
        )
    if not session.weigh({}):
        return (
            'one trial per posture and no position_noise in dataset.yaml: repeat the '
            'postures, or declare the noise of the tracker'
        )
    return ''


def decide(found: Evidence) -> Diagnosis:
    """Say what explains the error: one effect, a class, several, or nothing in the catalogue."""
    session = found.session
    adequate = [r for r in found.singles if r.probability > SINGLE]
    if adequate:
        group = indistinct(session, adequate, SINGLE)
        found.rival = _best_rival(found, group[0])
        return _outside(found, group[0]) if found.rival else _named(found, group)
    combined = several(session, found.singles) if found.singles else None
    if combined is not None:  # the weights have moved
        found.base = session.base_fit()
        found.singles = session.fit_all(
            [r.candidate for r in found.singles],
            {r.candidate.label: r.fit.point for r in found.singles},
        )
        found.best = session.best(found.singles)
    candidates = [r for r in (combined, found.best) if r is not None]
    best_overall = min(candidates, key=lambda r: r.score) if candidates else None
    found.rival = _best_rival(found, best_overall)
    if combined is not None and session.holds(combined) and found.rival is None:
        return _several(found, combined)
    return _outside(found, found.best)


def _best_rival(found: Evidence, best: Ranked | None) -> Pattern | None:
    """Return the pattern that beats the best explanation by more than luck, if any."""
    rivals = Rivals(found.session.fitters[0], found.base).all()
    if best is None or not rivals:
        return None
    top = min(rivals, key=lambda pattern: pattern.score)
    return top if top.score < best.score - APART else None


def _named(found: Evidence, group: Sequence[Ranked]) -> Diagnosis:
    """Verdict for a class of adequate single effects, best first."""
    best = group[0]
    names = [r.candidate.names[0] for r in group]
    strays = [
        quantity
        for quantity, z in found.base.pulls.items()
        if abs(z) > STRAY and quantity in TWINS and TWINS[quantity][0] in names
    ]
    if strays or all(r.candidate.present for r in group):
        verdict = 'wrong_parameter'
    else:
        verdict = 'missing_effect' if len(group) == 1 else 'ambiguous'
    if strays:  # the declared quantity is what moved: its twin is what to add
        twin = TWINS[strays[0]][0]
        best = next(r for r in group if r.candidate.names[0] == twin)
    together = tuple(names) if len(group) > 1 or strays else ()
    return _result(
        found,
        verdict,
        [best],
        together,
        strays,
        propose(found.session, group) if len(group) > 1 else None,
    )


def _several(found: Evidence, combined: Ranked) -> Diagnosis:
    return _result(found, 'several', [combined], (), [], None)


def _outside(found: Evidence, best: Ranked | None) -> Diagnosis:
    """Nothing in the catalogue is adequate, or something simpler outside it is better."""
    if best is not None:
        found.scale = max(1.0, best.fit.chi2 / max(best.fit.freedom, 1))
    helpful = best is not None and best.score < found.base.chi2 - APART * found.scale
    near = [
        r.candidate.label
        for r in found.singles
        if best is not None and r.score <= best.score + APART * found.scale and r is not best
    ]
    return _result(
        found,
        'outside_catalogue',
        [best] if helpful and best else [],
        (best.candidate.label, *near) if helpful and best and near else (),
        [],
        None,
    )


def _adequate(found: Evidence) -> Diagnosis:
    return _result(found, 'adequate', [], (), [], None)


def _result(
    found: Evidence,
    verdict: str,
    chosen: Sequence[Ranked],
    together: tuple[str, ...],
    strays: Sequence[str],
    following: object,
) -> Diagnosis:
    session = found.session
    measured = session.dataset.mean
    after = chosen[0].fit.markers if chosen else found.base.markers
    as_described = session.predictor.markers({})
    assert as_described is not None
    untested = tuple(
        c.names[0]
        for c in found.not_tested
        if c.names[0] not in {name for r in chosen for name in r.candidate.names}
    )
    effects = tuple(item for r in chosen for item in finding(found, r))
    return Diagnosis(
        verdict=verdict,
        effects=effects,
        cannot_tell_apart=together,
        not_tested=untested,
        out_of_tolerance=tuple(strays),
        error_before=rms(measured - as_described),
        error_after=rms(measured - after),
        noise_floor=session.whitener.floor(),
        next_measurement=following,  # type: ignore[arg-type]
        remainder=remainder_text(found, chosen[0] if chosen else None, verdict),
        candidates=rows_of(found, chosen, together),
        details=details_of(found, chosen, together, verdict),
    )


def _cannot_judge(session: Session, lacking: str) -> Diagnosis:
    markers = session.predictor.markers({})
    before = float('nan') if markers is None else rms(session.dataset.mean - markers)
    return Diagnosis(
        'cannot_judge',
        (),
        (),
        (),
        (),
        before,
        before,
        float('nan'),
        None,
        lacking,
        (),
        {'needed': lacking},
    )
