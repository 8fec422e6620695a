"""`diagnose`: which physical effect is missing from a description, and with which confidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..common.errors import InputError, NoEquilibriumError, Progress, whole
from ..common.processes import one_thread
from ..common.words import listed, mm, typed
from ..data import DataSet, DataSetLike, load_dataset
from ..data.dataset import names_in
from ..effects import CatalogueLike, load_catalogue
from ..inference.crossval import described_by, error_of, rms_of
from ..inference.discrepancy import earlier_of, since
from ..inference.fit import Fit
from ..inference.fitter import BEST_FEW, FAILURES
from ..inference.predict import FreeParameter
from ..inference.session import NOISE_UNKNOWN, Question, Session
from ..robot import RobotLike
from .add import add_effect
from .marker_hypotheses import exchanged
from .next_measurement import propose
from .report_rows import details_of, finding, fitted_errors, nearest, remainder_text, rows_of
from .result import Diagnosis
from .select import gather
from .setup_hypotheses import Mistake
from .setup_mistakes import (
    Explained,
    Mended,
    find_mistake,
    implausible,
    in_shares,
    is_odd_fit,
    mended_rivals,
)
from .verdict import (
    APART_FROM_SCORE,
    MISTAKE_HANDICAP,
    P_SINGLE_MIN,
    PLAIN_FLOORS,
    POSTURES_MIN,
    RESIDUAL_PARTLY_MAX,
    RESIDUAL_RATIO_MAX,
    Verdict,
)


@one_thread()
def diagnose(
    dataset: DataSetLike,
    robot: RobotLike | None = None,
    catalogue: CatalogueLike | None = None,
    workers: int = 1,
    progress: Progress | None = None,
    reference: DataSetLike | None = None,
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
        Has no effect: fits one after the other are faster than in threads.
    progress : callable, optional
        Called with (what, done, total).
    reference : DataSet, path, or a list of these, optional
        An earlier recording of the same arm: then only what has changed since is judged, the
        effects that are missing there being added first.

    Raises
    ------
    TendonRobotError
        The description does not fit the catalogue, or the model finds no equilibrium at all.

    """
    whole('workers', workers, 1)
    dataset = load_dataset(dataset, robot)
    if reference is not None:
        (dataset,) = changed_since([dataset], reference, catalogue, progress)
    question = Question.of(dataset, dataset.robot, load_catalogue(catalogue), progress)
    measured = int((question.dataset.trials > 0).sum())
    if measured < POSTURES_MIN:
        needed = f'{POSTURES_MIN} or more are needed, six are better'
        return _cannot_judge(question, f'{measured} measured posture(s): {needed}')
    try:
        question = question.settled()
    except NoEquilibriumError:
        mistake = find_mistake(question.predictor, 0.0)
        if mistake is None:
            raise
        return _mistaken(question, mistake)
    try:
        session = question.weigh()
    except InputError:
        return _cannot_judge(question, NOISE_UNKNOWN)
    markers = session.predictor.markers({})
    exchange = None if markers is None else next(exchanged(session.predictor, markers), None)
    if exchange is not None:  # else outliers may be exchanged markers
        return _mistaken(session, exchange)
    session = session.without_outliers()
    usual = session.usual_floor
    mistake = find_mistake(session.predictor, session.known_floor, usual)
    plain = mistake is not None and mistake.after <= PLAIN_FLOORS * usual
    if mistake is not None and (mistake.certain or (plain and not mistake.doubtful)):
        return _mistaken(session, mistake)
    described, rivals = mended_rivals(session, PLAIN_FLOORS * usual)
    likelier = _likelier_mistake(session, described, rivals)
    if likelier is not None:
        return _mistaken(session, likelier)
    diagnosis = _judge(session)
    if mistake is not None and plain:  # an effect that explains the data as well is preferred
        if not diagnosis.verdict.may_add:
            return _mistaken(session, mistake)
        diagnosis = _weighed_against(session, mistake, diagnosis)
    caveats = list(diagnosis.details.get('caveats', ()))
    caveats += implausible(diagnosis) + in_shares(diagnosis, dataset.input)
    caveats += _changed_between(diagnosis, dataset)
    quiet = described is not None and described.quiet
    limit = np.inf if quiet else RESIDUAL_PARTLY_MAX * diagnosis.error_after
    first = rivals[0] if rivals and rivals[0].explained.residual < limit else None
    if first is not None and not (quiet and first.agrees(diagnosis)):
        caveats.append(first.possible(quiet))
    return replace(diagnosis, details={**diagnosis.details, 'caveats': caveats})


def _changed_between(diagnosis: Diagnosis, dataset: DataSet) -> list[str]:
    """Return the caveat on several recordings that no cause of the catalogue explains."""
    first, *later = names_in(dataset.name)
    outside = diagnosis.verdict is Verdict.OUTSIDE_CATALOGUE and dataset.reference is None
    if not outside or not later or len(dataset.divided) < 2:
        return []
    command = typed('diagnose', later[0], '--reference', first)
    return [f'if something has changed between these recordings, `{command}` names it']


def changed_since(
    datasets: Sequence[DataSet],
    reference: DataSetLike,
    catalogue: CatalogueLike | None = None,
    progress: Progress | None = None,
) -> list[DataSet]:
    """
    Return recordings of one arm without what it deviated from its description before; see `since`.

    Effects that are missing in the earlier recording are added to the description first: an arm
    with other effects than described moves in another way when something changes.
    """
    old, lacked = earlier_of(datasets[0], reference), tuple[str, ...]()
    before = diagnose(old, None, catalogue, progress=progress)
    if before.adds:
        added = add_effect(old, before.effects, None, catalogue)
        if added.helps:
            datasets = [replace(one, robot=added.robot) for one in datasets]
            lacked = tuple(effect.name for effect in before.effects)
    return [since(one, old, catalogue, lacked) for one in datasets]


def _likelier_mistake(
    session: Session, described: Explained | None, rivals: Sequence[Mended]
) -> Mistake | None:
    """
    Return the mistake whose correction explains the measurements where effects alone do not.

    A residual far below that of the effects suffices; otherwise the effect that remains has to
    explain the corrected measurements of an arm as built.
    """
    if described is None:
        return None
    for one in rivals[:BEST_FEW]:
        residual, names = one.explained.residual, one.explained.names
        enough = residual < RESIDUAL_RATIO_MAX * described.residual
        partly = not described.quiet and residual <= RESIDUAL_PARTLY_MAX * described.residual
        if enough or (partly and _explains(session, one)):
            return one.with_rest(residual, names)
    return None


def _explains(session: Session, one: Mended) -> bool:
    """Return whether its effect explains the corrected measurements, to the declared accuracy."""
    assert one.mistake.mended is not None
    point, names = one.explained.point, one.explained.names
    frees = tuple(free for free in point if free.effect in names)
    question = replace(session.mended(one.mistake.mended), use_accuracy=True)
    try:
        mended, first = _weighed(question, frees)
        fit = mended.fitter.fit(frees, first)
    except FAILURES:
        return False
    return fit.probability(mended.noise.freedom) > P_SINGLE_MIN and not is_odd_fit(
        fit, mended.predictor
    )


def _weighed(question: Question, frees: tuple[FreeParameter, ...] = ()) -> tuple[Session, Fit]:
    """Return a session with weights taken at a fit, and this fit."""
    session = question.weigh()
    fit = session.fitter.fit(frees)
    return session.weigh(fit).growing(fit), fit


def _weighed_against(session: Session, mistake: Mistake, diagnosis: Diagnosis) -> Diagnosis:
    """Return the likelier of mistake and effects, the other as a caveat where it is possible."""
    assert mistake.mended is not None
    mended, first = _weighed(session.mended(mistake.mended))
    score = mended.score(mended.base_fit((first,)).deviance)
    gain = score + MISTAKE_HANDICAP - diagnosis.details['score']
    if gain > 0.0:
        sentence = f'{mistake.sentence} the error would fall to {mm(mistake.after)} as well'
        caveats = [*diagnosis.details['caveats'], f'{sentence}: {mistake.mend}']
        unsure = {**diagnosis.details, 'caveats': caveats}
        return replace(diagnosis, details=unsure) if gain < APART_FROM_SCORE else diagnosis
    names = listed([effect.name for effect in diagnosis.effects])
    mend = f'{mistake.mend}; if that is as described, add {names}, which explains it as well'
    return _mistaken(session, mistake if gain < -APART_FROM_SCORE else replace(mistake, mend=mend))


def _judge(question: Question) -> Diagnosis:
    """
    Judge the effects, mistakes of the set-up being excluded.

    A misfit beyond repeatability is judged again by the declared accuracy, where there is one.
    The result has all numbers that reports read.
    """
    fits = gather(question)
    decision = fits.judge()
    outside = decision.verdict is Verdict.OUTSIDE_CATALOGUE
    if outside and question.dataset.accuracy and not question.use_accuracy:
        fits = gather(replace(question, use_accuracy=True))
        decision = fits.judge()
    outside = decision.verdict is Verdict.OUTSIDE_CATALOGUE
    session, chosen = fits.session, nearest(fits, decision) if outside else decision.chosen
    decision = replace(decision, chosen=chosen)
    errors = fitted_errors(fits, chosen)
    if outside and not errors.after <= errors.before:
        decision = replace(decision, chosen=None, together=())  # it does not lower the error
        chosen, errors = None, fitted_errors(fits, None)
    own = set() if chosen is None else set(chosen.names)
    details = details_of(fits, decision)
    if errors.beside:  # else the arm is written as it was described
        as_found = described_by(session, fits.base, beside=True)
        details['error_as_found'] = error_of(session, as_found, fits.base)
    return Diagnosis(
        verdict=decision.verdict,
        effects=tuple(finding(fits, decision, errors)),
        cannot_tell_apart=decision.together,
        not_tested=tuple(c.names[0] for c in fits.not_tested if c.names[0] not in own),
        out_of_tolerance=decision.out_of_tolerance,
        error_before=errors.before,
        error_after=errors.after,
        error_alone=errors.alone,
        noise_floor=errors.floor,
        next_measurement=propose(session, decision.alike) if decision.alike else None,
        remainder=remainder_text(fits, decision, errors.after, details['as_built']),
        candidates=rows_of(fits, decision, errors),
        details=details,
    )


def _mistaken(question: Question, mistake: Mistake) -> Diagnosis:
    """Return the diagnosis of a mistake; no effect is judged before it is corrected."""
    diagnosis = _cannot_judge(question, '')
    text = mistake.text(diagnosis.error_before)
    fields = {key: value for key, value in vars(mistake).items() if key != 'mended'}
    details = {'needed': text, 'mistake': fields}
    return replace(diagnosis, error_after=mistake.after, remainder=text, details=details)


def _cannot_judge(question: Question, needed: str) -> Diagnosis:
    before = rms_of(question.dataset, question.robot, question.catalogue)
    return Diagnosis(
        Verdict.CANNOT_JUDGE,
        error_before=before,
        error_after=before,
        noise_floor=question.whitener.floor() if isinstance(question, Session) else np.nan,
        remainder=needed,
        details={'needed': needed},
    )
