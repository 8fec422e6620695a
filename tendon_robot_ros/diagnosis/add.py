"""Add effects to a robot description and take them out: fitted, written, undone."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import date
from functools import reduce
from typing import Any

import numpy as np

from ..common.arrays import Floats
from ..common.errors import InputError, NoEquilibriumError, refusal
from ..common.processes import one_thread
from ..common.results import TextResult, make_frame, plain
from ..common.words import mm, probability
from ..data import DataSet, DataSetLike, load_dataset
from ..effects import CatalogueLike, load_catalogue
from ..inference.candidates import Candidate, why_untested
from ..inference.crossval import Errors, Written, errors_on, model_error_of, set_alike, written
from ..inference.fit import Fit
from ..inference.imperfections import Members
from ..inference.intervals import LoadVector, Values, loads_of, values_with_intervals
from ..inference.predict import Point, free_parameters
from ..inference.session import Question, Session
from ..robot import Robot, RobotLike
from .result import EffectFinding, found_values
from .verdict import P_SINGLE_MIN


@dataclass(frozen=True)
class Addition(TextResult):
    """A description with fitted effects, and what they do to the error."""

    robot: Robot
    values: Values  # with their intervals
    fitted: Errors  # on the postures of the fit
    check: Errors  # on a check set, else on postures left out in turn
    probability: float  # p-value of the remaining error if no other effect acts
    moved: dict[str, float] = field(default_factory=dict)  # tolerance -> declared sd it moved
    more_at_work: str = ''  # note in the file where other effects act as well
    model_error: float | None = None  # [m] at the tip, on left-out postures; None: only noise
    beside: bool = False  # whether tolerances that moved and imperfections are written, too
    accuracy: float | None = None  # [m] declared, that weighed; None: repeatability alone did
    loads: dict[str, LoadVector] = field(default_factory=dict)  # of effects that are forces
    described: Robot | None = None  # before
    anew: Members = field(default_factory=dict)  # in each of several recordings; off the errors

    @property
    def helps(self) -> bool:
        """Whether the error on postures that were not used does not rise."""
        return self.check.after <= self.check.before

    def __repr__(self) -> str:
        """Say what was added, and how the errors fell."""
        each = self.fitted, self.check
        errors = '; '.join(f'{e.kind}: {mm(e.before)} -> {mm(e.after)}' for e in each)
        return f'<Addition of {", ".join(self.values)} to {self.robot.name}: {errors}>'

    def frame(self) -> Any:
        """Return the added values as a table (pandas): a row per effect and parameter."""
        rows = [
            {'effect': name, 'parameter': key, **vars(value)}
            for name, values in self.values.items()
            for key, value in values.items()
        ]
        return make_frame({key: [row[key] for row in rows] for key in rows[0]}, {})

    def to_json(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        left_out = 'robot', 'described', 'accuracy', 'values'
        own = {key: value for key, value in vars(self).items() if key not in left_out}
        return dict(plain({'effects': self.values, **own}))


def with_origin(addition: Addition, before: Robot) -> Robot:
    """Return the description with the origin of its fitted values, and its own error."""
    robot = replace(addition.robot, model_error=_short(addition.model_error))
    error: dict[str, Any] = {'unit': 'm'}
    for one in (addition.fitted, addition.check):
        numbers = {key: _short(getattr(one, key)) for key in ('before', 'after', 'floor')}
        error[one.kind.replace(' ', '_')] = {'data': one.data, **numbers}
    for name, values in addition.values.items():
        origin: dict[str, Any] = {
            'parameters': {
                key: {name: _short(getattr(value, name)) for name in ('value', 'low', 'high')}
                | {'unit': value.unit}
                | ({'note': value.note} if value.note else {})
                for key, value in values.items()
            },
            'data': addition.fitted.data,
            'date': date.today().isoformat(),
            'error': error,
        }
        if len(addition.values) > 1:
            origin['together_with'] = [other for other in addition.values if other != name]
        if name in before.effects:
            old = before.effects[name].items()
            origin['replaces'] = {k: list(v) if isinstance(v, tuple) else v for k, v in old}
        if addition.moved:
            origin['tolerances_moved'] = {key: _short(z) for key, z in addition.moved.items()}
        if addition.accuracy:
            origin['weighed_by_accuracy'] = addition.accuracy
        if addition.more_at_work:
            origin['more_at_work'] = addition.more_at_work
        robot = robot.with_effect(name, robot.effects[name], origin)
    return robot


def more_at_work(
    errors: Errors, chance: float, dataset: DataSet, squares: Floats, noise: float
) -> tuple[str, float | None]:
    """
    Return the note that other effects act as well, and the error [m] of the model at the tip.

    By the squared errors (P, J) [m²] of postures left out, of which `noise` makes an rms [m].
    """
    floor = errors.floor or 0.0
    left = f'{errors.after / floor:.1f} times the noise' if floor > 0.0 else mm(errors.after, 2)
    note = (
        f'more is at work than these effects: what is left on the fitted postures is {left} '
        f'({probability(chance)})'
    )
    return note, model_error_of(dataset, squares, noise)


def restore(robot: Robot, name: str) -> tuple[Robot, Mapping[str, Any] | None]:
    """
    Undo an addition: what the effect was before comes back, else the effect goes.

    Returns
    -------
    robot : Robot
    values : mapping, optional
        What came back.

    Raises
    ------
    InputError
        The description does not list that effect.

    """
    without = replace(robot.without_effect(name), model_error=None)  # it is another model
    origin = robot.fitted.get(name)
    values = origin.get('replaces') if isinstance(origin, dict) else None
    if not isinstance(values, dict):
        return without, None
    back = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
    return robot.with_effect(name, back), back


def _short(value: float | None) -> float | None:
    return None if value is None else float(f'{value:.4g}')


@one_thread()
def add_effect(
    dataset: DataSetLike,
    name: str | EffectFinding | Sequence[str | EffectFinding],
    robot: RobotLike | None = None,
    catalogue: CatalogueLike | None = None,
    check: DataSetLike | None = None,
    partial: bool = False,
) -> Addition:
    """
    Fit an effect, or several together, on a data set and write the values into a description.

    Declared tolerances take part in the fit and stay out of the description. Effects that the
    description lists already get new values.

    Parameters
    ----------
    dataset : DataSet, path, or a list of these
        As `load_dataset` takes them.
    name : str, EffectFinding, or a sequence of these
        An effect of the catalogue, or what a diagnosis found, with values to start from:
        `diagnosis.effects`.
    robot : Robot, name, path, text or dict, optional
        Default: the data set's.
    catalogue : Catalogue or paths, optional
        With your own effects.
    check : DataSet or path, optional
        Other postures to judge by; default: groups of postures are left out in turn.
    partial : bool
        Something outside the catalogue is known to be at work, too.

    Returns
    -------
    Addition
        The new description is its `robot`.

    Raises
    ------
    EffectError, InputError
        An effect is unknown, or these postures say nothing about it.
    NoEquilibriumError

    """
    effects: Sequence[Any] = name if isinstance(name, list | tuple) else [name]
    names = [one.name if isinstance(one, EffectFinding) else one for one in effects]
    if not names or not all(isinstance(one, str) for one in names):
        raise refusal('add', 'the names of effects', name)
    dataset = load_dataset(dataset, robot)
    described = dataset.robot
    other = None if check is None else load_dataset(check, described)
    session = Question.of(dataset, described, load_catalogue(catalogue)).prepared()
    dataset = session.dataset
    found = [one for one in effects if isinstance(one, EffectFinding)]
    whole = len(found) == len(names)
    point = found_values(found, session.catalogue, session.robot) if whole else None
    settled = settle(session, names, point)
    session, fit, descriptions = settled.session, settled.fit, settled.descriptions
    chance, scale = settled.probability, settled.scale
    values = values_with_intervals(session.fitter, fit, scale)
    alike = set_alike(session.dataset, described, session.catalogue, fit.anew)
    fitted = errors_on(alike, described, descriptions, session.catalogue, 'fitted')
    if other is not None:
        on_check = errors_on(other, described, descriptions, session.catalogue, 'check')
    else:
        alone = descriptions.alone_left_out if descriptions.beside else None
        on_check = replace(fitted, kind='left out', alone=alone, after=descriptions.left_out)
    more, error = '', None
    if partial or chance <= P_SINGLE_MIN:
        squares, noise = descriptions.left_out_squares, session.whitener.floor()
        more, error = more_at_work(fitted, chance, dataset, squares, noise)
    by = session.dataset.accuracy if session.use_accuracy else None
    loads, moved = loads_of(fit, session.predictor, scale), fit.prior_z
    added = Addition(
        descriptions.robot,
        values,
        fitted,
        on_check,
        chance,
        moved,
        more,
        error,
        descriptions.beside,
        by,
        loads,
        described,
        fit.anew,
    )
    return replace(added, robot=with_origin(added, described))


@dataclass(frozen=True)
class Settled:
    """Effects fitted together, and the description to write."""

    session: Session
    fit: Fit
    descriptions: Written
    probability: float  # p-value by repeatability alone
    scale: float  # chi² over freedom where the fit is not adequate, else 1


def settle(session: Session, names: Sequence[str], start: Point | None = None) -> Settled:
    """
    Fit effects together, weighed by the accuracy where they misfit beyond repeatability.

    Repeatability alone would give most weight to the postures with most trials and the markers
    with least noise, although the model error is far larger. That refit is rejected where it
    raises the error on left-out postures.
    """
    session, fit = fit_effects(session, names, start)
    probability, fit = fit.probability(session.noise.freedom), session.fitter.for_values(fit)
    descriptions = written(session, fit)
    if probability <= P_SINGLE_MIN and session.dataset.accuracy:
        with suppress(NoEquilibriumError):
            accurate = replace(session, use_accuracy=True).weigh(fit)
            accurate, refitted = fit_effects(accurate, names, fit.point)
            refitted = accurate.fitter.for_values(refitted)
            other = written(accurate, refitted)
            if other.left_out <= descriptions.left_out:
                session, fit, descriptions = accurate, refitted, other
        session = session if session.use_accuracy else session.weigh(fit)
    own = fit.probability(session.noise.freedom) if session.use_accuracy else probability
    scale = 1.0 if own > P_SINGLE_MIN else max(1.0, fit.chi2 / max(fit.freedom, 1))
    return Settled(session, fit, descriptions, probability, scale)


def fit_effects(
    session: Session, names: Sequence[str], start: Point | None = None
) -> tuple[Session, Fit]:
    """Fit effects together, one joining after the other; weights are retaken twice at the fit."""
    known = {name: [f.key for f in start or () if f.effect == name] for name in names}
    own = [_candidate(session, name, keys) for name, keys in known.items()]
    fit = _joined(session, own) if start is None else _fit(session, _together(own), start)
    for _ in range(2):
        session = session.weigh(fit)
        fit = _fit(session, _together(own), fit)
    return session, session.fitter.over_reversals(fit)


def _joined(session: Session, own: Sequence[Candidate]) -> Fit:
    """
    Fit effects, one joining after the other, in whatever order they are named.

    Those of the wires come first: wires that give way have an equilibrium where stiff ones have
    none. One that has no equilibrium without the others waits for them.
    """
    fit, inside, error = None, list[Candidate](), None
    order = [effect.name for effect in session.catalogue]
    order.sort(key=lambda name: session.catalogue[name].needs != 'pulls')
    waiting = sorted(own, key=lambda c: order.index(c.names[0]))
    while waiting:
        for candidate in waiting:
            try:
                _refuse_untested(session, candidate, fit)
                fit = _fit(session, _together([*inside, candidate]), fit)
            except NoEquilibriumError as problem:
                error = error or problem
                continue
            inside.append(candidate)
            waiting.remove(candidate)
            break
        else:
            assert error is not None
            raise error
    assert fit is not None
    return fit


def _together(candidates: Sequence[Candidate]) -> Candidate:
    return reduce(Candidate.with_, candidates, Candidate((), (), True))


def _fit(session: Session, candidate: Candidate, start: Fit | Point | None) -> Fit:
    try:
        return session.fitter.fit(candidate.frees, start)
    except (ArithmeticError, np.linalg.LinAlgError):
        raise NoEquilibriumError(
            f'a posture of {session.dataset.name}', candidate.names, np.inf
        ) from None


def _candidate(session: Session, name: str, known: Collection[str]) -> Candidate:
    """Return an effect with its parameters; of one at an unknown place those that are `known`."""
    effect = session.catalogue[name]
    if name in session.robot.effects or not effect.placed:
        return next(c for c in session.candidates if c.names == (effect.name,))
    frees = free_parameters(effect, session.robot)
    frees = tuple(free for free in frees if free.key in known)
    if not frees:
        raise InputError(
            f'{name}: where it acts is not described; `diagnose --add` finds the place and adds '
            'it, or list it in the description with the place that you know'
        )
    return Candidate((name,), frees, present=False)


def _refuse_untested(session: Session, candidate: Candidate, fit: Fit | None) -> None:
    """Raise InputError where the postures do not show an effect."""
    effect = session.catalogue[candidate.names[0]]
    if session.tested([candidate], {} if fit is None else fit.point):
        return
    reason = why_untested(effect, session.dataset, session.robot)
    raise InputError(
        f'{effect.name}: these measurements cannot tell its value ({reason}); nothing was written'
    )
