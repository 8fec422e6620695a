"""Diagnose: which physical effect is missing, and how sure is that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..common.errors import NoEquilibriumError, Progress, whole
from ..common.processes import one_thread
from ..common.words import listed, mm
from ..comparison.noise import rms
from ..comparison.outliers import find_outliers
from ..data import DataSetLike, load_dataset
from ..effects import CatalogueLike, load_catalogue
from ..robot import RobotLike, load_robot
from .candidates import Ranked
from .marker_hypotheses import exchanged_in
from .next_measurement import propose
from .patterns import Pattern
from .report_rows import details_of, finding, left_by, remainder_text, rows_of, usual_floor
from .result import Diagnosis
from .select import (
    Evidence,
    competing_pattern,
    gather,
    is_alarming,
    joined,
    outside_by_itself,
    several,
)
from .session import Session
from .setup_hypotheses import Mistake
from .setup_mistakes import Explained, Rival, find_mistake, implausible, rivals_of
from .verdict import (
    APART_FROM_SCORE,
    ERROR_SHARE_LEFT_LIMIT,
    MISTAKE_HANDICAP,
    P_SINGLE_MIN,
    PARTLY_LEFT_MAX,
    PARTLY_TRIED_MAX,
    PLAIN_WITHIN_FLOORS,
    POSTURES_MIN,
    SAME_WITHIN_CHI2,
    STRAY_SD_MAX,
    Verdict,
)


@one_thread()
def diagnose(
    dataset: DataSetLike,
    robot: RobotLike | None = None,
    catalogue: CatalogueLike | None = None,
    workers: int = 2,
    progress: Progress | None = None,
) -> Diagnosis:
    """
    Name the physical effect whose absence explains the error of a model on a data set.

    Parameters
    ----------
    dataset : DataSet, path, or a list of these
        As `load_dataset` takes them.
    robot : Robot, name, path, text or dict, optional
        The description to judge; default: the data set's.
    catalogue : Catalogue or paths, optional
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
    dataset, workers = load_dataset(dataset), whole('workers', workers, 1)
    judged = dataset.robot if robot is None else load_robot(robot)
    session = Session(dataset, judged, load_catalogue(catalogue), workers, progress)
    lacking = _what_is_lacking(session)
    if isinstance(lacking, Mistake):
        return _mistaken(session, lacking)
    if lacking:
        return _cannot_judge(session, lacking)
    taken = exchanged_in(session.predictor)  # readings that contradict others may be of these
    if taken is not None:
        return _mistaken(session, taken)
    session.leave_out(find_outliers(session.predictor, {}))
    enough = PLAIN_WITHIN_FLOORS * usual_floor(session)
    mistake = find_mistake(session.predictor, session.whitener.floor(), usual_floor(session))
    plain = mistake is not None and mistake.after <= enough
    if mistake is not None and (mistake.certain or (plain and not mistake.doubtful)):
        return _mistaken(session, mistake)
    described, found = rivals_of(session, enough)
    likelier = _beyond_effects(session, described, found)
    if likelier is not None:
        return _mistaken(session, likelier)
    session.brief = mistake is not None and plain
    diagnosis = _judge(session)
    if mistake is not None and plain:  # an effect that explains all is the better story
        if not diagnosis.verdict.may_add:
            return _mistaken(session, mistake)
        diagnosis = _likelier(session, mistake, diagnosis)
    said = [*diagnosis.details.get('caveats', ()), *implausible(diagnosis)]
    quiet = described is not None and described.quiet
    limit = np.inf if quiet else PARTLY_LEFT_MAX * diagnosis.error_after
    if found and found[0].explained.left < limit and not (quiet and found[0].agrees(diagnosis)):
        said.append(found[0].possible(quiet))
    return replace(diagnosis, details={**diagnosis.details, 'caveats': said})


def _beyond_effects(
    session: Session, described: Explained | None, found: Sequence[Rival]
) -> Mistake | None:
    """
    Return the mistake without which the measurements are explained as they are not with it.

    Where it leaves far less than the effects do nothing else is asked; else where the measurements
    without it are explained as well as the noise and the arm as built tell.
    """
    if described is None:
        return None
    limit = ERROR_SHARE_LEFT_LIMIT * described.left
    for one in found[:PARTLY_TRIED_MAX]:
        if one.explained.left < limit:
            return one.told(one.explained.left, one.explained.names)
        if described.quiet or one.explained.left > PARTLY_LEFT_MAX * described.left:
            continue
        again = _judge_mended(session, one.mistake)
        if again is None or again.verdict is Verdict.OUTSIDE_CATALOGUE or implausible(again):
            continue
        return one.told(again.error_after, [effect.name for effect in again.effects])
    return None


def _judge_mended(session: Session, mistake: Mistake) -> Diagnosis | None:
    """Judge the measurements without a mistake; None where nothing can be judged then."""
    assert mistake.mended is not None
    mended = session.mended(mistake.mended)
    return _judge(mended) if mended.weigh({}) else None


def _likelier(session: Session, mistake: Mistake, diagnosis: Diagnosis) -> Diagnosis:
    """Return what is likelier, the mistake or the effects; where both may be, say the other."""
    gain = _score_mended(session, mistake) + MISTAKE_HANDICAP - diagnosis.details['score']
    if gain > 0.0:
        said = f'{mistake.sentence} the error would fall to {mm(mistake.after)} as well'
        caveats = [*diagnosis.details['caveats'], f'{said}: {mistake.mend}']
        unsure = {**diagnosis.details, 'caveats': caveats}
        return replace(diagnosis, details=unsure) if gain < APART_FROM_SCORE else diagnosis
    names = listed([effect.name for effect in diagnosis.effects])
    mend = f'{mistake.mend}; if that is as described, add {names}, which explains it as well'
    return _mistaken(session, mistake if gain < -APART_FROM_SCORE else replace(mistake, mend=mend))


def _score_mended(session: Session, mistake: Mistake) -> float:
    """Return what the set-up without its mistake scores on the same readings."""
    assert mistake.mended is not None
    mended = session.mended(mistake.mended)
    if not mended.weigh({}):
        return np.inf
    base = mended.base_fit()
    mended.weigh(base.point, base.members)
    return mended.score(mended.base_fit((base,)).deviance)


def _judge(session: Session) -> Diagnosis:
    """Judge the effects, the mistakes of the set-up being looked through."""
    evidence = gather(session)
    if not is_alarming(evidence):
        return _adequate(evidence)
    diagnosis = decide(evidence)
    outside = diagnosis.verdict is Verdict.OUTSIDE_CATALOGUE
    if outside and session.accuracy and not session.use_accuracy:
        session.use_accuracy = True
        evidence = gather(session)
        return _adequate(evidence) if not is_alarming(evidence) else decide(evidence)
    return diagnosis


def _what_is_lacking(session: Session) -> str | Mistake:
    """Say what is needed, or wrong, before anything can be judged; empty when nothing is."""
    dataset = session.dataset
    measured = int((dataset.trials > 0).sum())
    if measured < POSTURES_MIN:
        return f'{measured} measured posture(s): {POSTURES_MIN} or more are needed, six are better'
    try:
        session.leave_out_unsettled()
    except NoEquilibriumError:
        mistake = find_mistake(session.predictor, 0.0)
        if mistake is None:
            raise
        return mistake
    if not session.weigh({}):
        return (
            'one trial per posture and no position_noise in dataset.yaml: repeat the '
            'postures, or declare the noise of the tracker'
        )
    return ''


def decide(evidence: Evidence) -> Diagnosis:
    """Say what explains the error: one effect, a class, several, or nothing in the catalogue."""
    session = evidence.session
    adequate = [r for r in evidence.singles if r.probability > P_SINGLE_MIN]
    group = indistinct(session, adequate, P_SINGLE_MIN) if adequate else []
    group = [r for r in group if evidence.is_there(r)]
    if group:
        evidence.competing = competing_pattern(evidence, group[0].score) or _nameless(
            evidence, group[0]
        )
        if evidence.competing:
            return _outside(evidence, group[0])
        more = joined(session, group[0]) if evidence.base.built is not None else None
        if more is not None and evidence.is_there(more):
            return _several(evidence, more)
        return _named(evidence, group)
    combined = several(session, evidence.singles) if evidence.singles else None
    if combined is not None:  # the weights have moved
        evidence.base = session.base_fit((evidence.base,))
        evidence.__dict__.pop('patterns', None)
        evidence._told.clear()
        evidence.singles = session.refit(evidence.singles, evidence.base)
        evidence.best = session.best(evidence.singles)
    candidates = [r for r in (combined, evidence.best) if r is not None]
    holds = combined is not None and session.holds(combined) and evidence.is_there(combined)
    evidence.competing = None
    if candidates and (holds or not session.brief):
        evidence.competing = competing_pattern(evidence, min(r.score for r in candidates))
    if combined is not None and holds and evidence.competing is None:
        return _several(evidence, combined)
    return _outside(evidence, evidence.best)


def _nameless(evidence: Evidence, best: Ranked) -> Pattern | None:
    """Return the pattern that raised the alarm where the effect alone would not have."""
    session, base = evidence.session, evidence.base
    if base.built is None or session.stands_out(base, best, len(evidence.singles)):
        return None
    pattern = outside_by_itself(evidence)
    return pattern if pattern is not None and pattern.score < best.score else None


def _named(evidence: Evidence, group: Sequence[Ranked]) -> Diagnosis:
    """Verdict for a class of adequate single effects, best first."""
    best = group[0]
    names = [r.candidate.names[0] for r in group]
    twins = {
        quantity: evidence.session.catalogue.twin(quantity) for quantity in evidence.base.prior_z
    }
    strays = [
        quantity
        for quantity, z in evidence.base.prior_z.items()
        if abs(z) > STRAY_SD_MAX and (twin := twins[quantity]) is not None and twin[0] in names
    ]
    if strays or all(r.candidate.present for r in group):
        verdict = Verdict.WRONG_PARAMETER
    else:
        verdict = Verdict.MISSING_EFFECT if len(group) == 1 else Verdict.AMBIGUOUS
    if strays:  # the declared quantity is what moved: its twin is what to add
        said_by = twins[strays[0]]
        best = next(r for r in group if said_by and r.candidate.names[0] == said_by[0])
    together = tuple(names) if len(group) > 1 or strays else ()
    return _result(
        evidence,
        verdict,
        [best],
        together,
        strays,
        propose(evidence.session, group) if len(group) > 1 else None,
    )


def _several(evidence: Evidence, combined: Ranked) -> Diagnosis:
    return _result(evidence, Verdict.SEVERAL, [combined], (), [], None)


def _outside(evidence: Evidence, best: Ranked | None) -> Diagnosis:
    """Nothing in the catalogue is adequate, or something simpler outside it is better."""
    if best is not None:
        evidence.scale = max(1.0, best.fit.chi2 / max(best.fit.freedom, 1))
    apart = APART_FROM_SCORE * evidence.scale
    lower = best is not None and best.score < evidence.base.deviance - apart
    helpful = lower and best is not None and evidence.is_there(best)
    near = [
        r.candidate.label
        for r in evidence.singles
        if best is not None and r.score <= best.score + apart and r is not best
    ]
    return _result(
        evidence,
        Verdict.OUTSIDE_CATALOGUE,
        [best] if helpful and best else [],
        (best.candidate.label, *near) if helpful and best and near else (),
        [],
        None,
    )


def _adequate(evidence: Evidence) -> Diagnosis:
    return _result(evidence, Verdict.ADEQUATE, [], (), [], None)


def _result(
    evidence: Evidence,
    verdict: Verdict,
    chosen: Sequence[Ranked],
    together: tuple[str, ...],
    strays: Sequence[str],
    following: object,
) -> Diagnosis:
    session = evidence.session
    left = left_by(session, evidence.told(chosen[0]) if chosen else None)
    if verdict is Verdict.OUTSIDE_CATALOGUE and not left.after <= left.before:  # it is no fit
        chosen, together, left = [], (), left_by(session, None)
    untested = tuple(
        c.names[0]
        for c in evidence.not_tested
        if c.names[0] not in {name for r in chosen for name in r.candidate.names}
    )
    effects = tuple(item for r in chosen for item in finding(evidence, r, left))
    return Diagnosis(
        verdict=verdict,
        effects=effects,
        cannot_tell_apart=together,
        not_tested=untested,
        out_of_tolerance=tuple(strays),
        error_before=left.before,
        error_after=left.after,
        error_alone=left.alone,
        noise_floor=left.floor,
        next_measurement=following,  # type: ignore[arg-type]
        remainder=remainder_text(evidence, chosen[0] if chosen else None, verdict, left.after),
        candidates=rows_of(evidence, chosen, together, verdict, left),
        details=details_of(evidence, chosen, together, verdict),
    )


def _mistaken(session: Session, mistake: Mistake) -> Diagnosis:
    """Say the mistake of the set-up; no effect is judged before it is mended."""
    markers = session.predictor.markers({})
    before = np.inf if markers is None else rms(session.dataset.mean - markers)
    diagnosis = _cannot_judge(session, mistake.text(before))
    told = {key: value for key, value in vars(mistake).items() if key != 'mended'}
    return replace(
        diagnosis,
        noise_floor=diagnosis.noise_floor if markers is None else session.whitener.floor(),
        error_after=mistake.after,
        details={**diagnosis.details, 'mistake': told},
    )


def _cannot_judge(session: Session, lacking: str) -> Diagnosis:
    markers = session.predictor.markers({})
    before = float('nan') if markers is None else rms(session.dataset.mean - markers)
    return Diagnosis(
        Verdict.CANNOT_JUDGE,
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
