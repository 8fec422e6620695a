"""Add effects to a robot description: fit their parameters and watch the error fall."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..data import DataSet
from ..effects import Catalogue, load_catalogue
from ..exceptions import InputError, NoEquilibriumError
from ..robot import Robot
from .candidates import Candidate, is_tested
from .fit import Fit
from .interval import intervals
from .origin import Addition, changed_robot, more_at_work, with_origin
from .predict import Free, Point
from .report_rows import values_of
from .result import EffectFinding, Value
from .session import SINGLE, Session
from .staircase import errors_on, left_out
from .untested import why_untested


def add_effects(
    dataset: DataSet,
    names: Sequence[str],
    robot: Robot | None = None,
    catalogue: Catalogue | None = None,
    check: DataSet | None = None,
    start: Sequence[EffectFinding] = (),
    partial: bool = False,
) -> Addition:
    """
    Fit effects on a data set and write their values into a description.

    Declared tolerances take part in the fit and stay out of the description. Effects that the
    description lists already get new values.

    Parameters
    ----------
    dataset : DataSet
    names : sequence of str
        Effects, fitted together.
    robot : Robot, optional
        Default: the data set's.
    catalogue : Catalogue, optional
    check : DataSet, optional
        Other postures to judge by; default: groups of postures are left out in turn.
    start : sequence of EffectFinding, optional
        Values to start from, as a diagnosis found them.
    partial : bool
        Something outside the catalogue is known to be at work, too.

    Raises
    ------
    EffectError, InputError
        An effect is unknown, or these postures say nothing about it.
    NoEquilibriumError

    """
    described = robot or dataset.robot
    session = Session(dataset, described, catalogue or load_catalogue(), workers=1)
    if session.predictor.markers({}) is None:
        raise NoEquilibriumError(
            f'a posture of {dataset.name}', session.predictor.model.implicit_effects, np.inf
        )
    if not session.weigh({}):
        raise InputError(
            f'{dataset.name}: one trial per posture and no position_noise in '
            'dataset.yaml: repeat the postures, or declare the noise of the tracker'
        )
    fit = fit_effects(session, names, _point(session, names, start))
    probability = fit.probability(session.freedom)
    scale = 1.0 if probability > SINGLE else max(1.0, fit.chi2 / max(fit.freedom, 1))
    values = _values(session, fit, scale)
    changed = changed_robot(described, session.catalogue, fit, dataset)
    fitted = errors_on(dataset, described, changed, session.catalogue, 'fitted')
    on_check = (
        left_out(session.fitters[0], fit, fitted)
        if check is None
        else errors_on(check, described, changed, session.catalogue, 'check')
    )
    more = more_at_work(fitted, probability) if partial or probability <= SINGLE else ''
    made = Addition(changed, values, fitted, on_check, probability, fit.pulls, more)
    return replace(made, robot=with_origin(made, described))


def fit_effects(session: Session, names: Sequence[str], start: Point | None = None) -> Fit:
    """Fit effects together, one joining after the other; weights are retaken twice at the fit."""
    fit, together = None, None
    for name in dict.fromkeys(names):
        candidate = _candidate(session, name)
        if start is None:
            _refuse_untested(session, candidate, fit)
        together = candidate if together is None else together.with_(candidate)
        if start is None:
            fit = _fit(session, together, None if fit is None else fit.point)
    if together is None:
        raise InputError('add: expected the name of an effect, got none')
    point = start if fit is None else fit.point
    for _ in range(2):
        session.weigh(point or {})
        fit = _fit(session, together, point)
        point = fit.point
    assert fit is not None
    return fit


def _fit(session: Session, candidate: Candidate, start: Point | None) -> Fit:
    try:
        return session.fitters[0].fit(candidate.frees, start)
    except (ArithmeticError, np.linalg.LinAlgError):
        raise NoEquilibriumError(
            f'a posture of {session.dataset.name}', candidate.names, np.inf
        ) from None


def _candidate(session: Session, name: str) -> Candidate:
    effect = session.catalogue[name]
    return next(c for c in session.candidates if c.names == (effect.name,))


def _refuse_untested(session: Session, candidate: Candidate, fit: Fit | None) -> None:
    """Raise InputError where the postures say nothing about an effect."""
    effect = session.catalogue[candidate.names[0]]
    point = {} if fit is None else fit.point
    here = session.predictor.markers(point)
    acts = (
        effect.acts_on is None
        or effect.acts_on in session.robot.effects
        or any(free.effect == effect.acts_on for free in point)
    )
    if (
        acts
        and here is not None
        and is_tested(candidate, session.predictor, session.whitener, point, here)
    ):
        return
    reason = why_untested(effect, session.dataset, session.robot, session.catalogue)
    raise InputError(
        f'{effect.name}: these measurements cannot tell its value ({reason}); nothing was written'
    )


def _point(
    session: Session, names: Sequence[str], start: Sequence[EffectFinding]
) -> dict[Free, float] | None:
    """Return the values of a diagnosis as a point; None where an effect is not among them."""
    found = {effect.name: effect for effect in start}
    if not names or not set(names) <= set(found):
        return None
    frees = [free for name in names for free in _candidate(session, name).frees]
    return {free: found[free.effect].parameters[free.key].value for free in frees}


def _values(session: Session, fit: Fit, scale: float) -> dict[str, dict[str, Value]]:
    """Values with intervals: Gaussian ones, and profiles where those do not hold."""
    values = values_of(fit, scale)
    for free, (low, high) in intervals(session.fitters[0], fit, scale).items():
        values[free.effect][free.key] = replace(values[free.effect][free.key], low=low, high=high)
    return values
