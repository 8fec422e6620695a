"""From fits to the rows and numbers of a result: values with intervals, shares, errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..common.words import mm, spoken
from ..comparison.outliers import Outliers
from ..comparison.statistics import chi2_isf, normal_ppf
from ..data import DataSet
from ..data.dataset import at_rest
from .arm_report import arm_report
from .candidates import Ranked, why_untested
from .decide import (
    ALARM_LEVEL,
    APART_FROM_SCORE,
    CORRELATED_FROM,
    COVERED_SHARE_MIN,
    NOISE_FACTOR_MAX,
    P_SINGLE_MIN,
    POSTURES_ENOUGH,
    Verdict,
)
from .fit import Fit
from .fitter import Fitter
from .interval import intervals
from .load import loads_of
from .local_tests import faults_of
from .prediction_errors import left_out as predicted_left_out
from .prediction_errors import share_gone
from .result import NOT_NEEDED, CandidateRow, EffectFinding, Value
from .session import Session
from .written import described_by, error_of, written

if TYPE_CHECKING:
    from .evidence import Evidence

Floats = npt.NDArray[np.float64]
NOISE_KEYS = ('position', 'shift', 'trial', 'setting', 'source')


def values_of(
    fit: Fit, scale: float = 1.0, covariance: Floats | None = None
) -> dict[str, dict[str, Value]]:
    """
    Return values with 95 % intervals by effect; `scale` widens them (chi² over freedom).

    `covariance` (default: what the fit tells) is that of the freed parameters, the first ones.
    """
    quantile = normal_ppf(0.975) * np.sqrt(scale)
    known = fit.told if covariance is None else covariance
    spread = np.sqrt(np.maximum(np.diag(known), 0.0))
    values: dict[str, dict[str, Value]] = {}
    for i, free in enumerate(fit.frees):
        value, half = float(fit.values[i]), float(quantile * spread[i])
        low = float(max(value - half, free.parameter.low))
        high = float(min(value + half, free.parameter.high))
        values.setdefault(free.effect, {})[free.key] = Value(
            value, low, high, free.parameter.unit, _note(fit, i, half)
        )
    return values


def values_with_intervals(
    fitter: Fitter, fit: Fit, scale: float = 1.0
) -> dict[str, dict[str, Value]]:
    """Values of effects that are to be added: the profile decides where the curvature does not."""
    values = values_of(fit, scale)
    for free, (low, high) in intervals(fitter, fit, scale).items():
        values[free.effect][free.key] = replace(values[free.effect][free.key], low=low, high=high)
    return values


def _note(fit: Fit, i: int, half: float) -> str:
    parameter = fit.frees[i].parameter
    if not half < (parameter.high - parameter.low):
        return 'not determined by these postures'
    if fit.values[i] in (parameter.low, parameter.high):
        return 'at its bound'
    spread = np.sqrt(np.diag(fit.covariance))
    for j in range(len(fit.frees)):
        if (
            j != i
            and np.isfinite(spread[j])
            and (abs(fit.covariance[i, j]) > CORRELATED_FROM * spread[i] * spread[j] > 0.0)
        ):
            return f'correlated with {spoken(fit.frees[j].key)}'
    return ''


@dataclass(frozen=True)
class Left:
    """Rms errors [m] on the fitted postures, each that of a description as it stands."""

    before: float  # as described
    alone: float  # with the effects, the arm otherwise as described
    after: float  # as `add` writes it
    floor: float  # of a perfect model
    beside: bool  # whether what is written has the arm as it was found as well
    left_out: float = np.nan  # what is written, on postures left out in turn

    def share(self, error: float) -> float:
        """Return which share of the explainable error is gone where so much is left, 0 to 1."""
        gone = share_gone(self.before, error, min(self.floor, self.after))
        return 0.0 if gone is None else float(np.clip(gone, 0.0, 1.0))


def left_by(session: Session, fit: Fit | None) -> Left:
    """Return the errors of the descriptions that a fit would write; None: nothing is written."""
    if fit is None:
        before = error_of(session, session.robot)
        return Left(before, before, before, session.whitener.floor(), False)
    made = written(session, fit)
    alone = error_of(session, made.alone)
    after = error_of(session, made.robot) if made.beside else alone
    before = error_of(session, session.robot)
    floor = session.whitener.floor()
    return Left(before, alone, after, floor, made.beside, made.left_out)


def finding(evidence: Evidence, ranked: Ranked, left: Left) -> list[EffectFinding]:
    """Return the effects of a candidate, with what they explain together."""
    fit = evidence.told(ranked)
    values = values_with_intervals(evidence.session.fitters[0], fit, evidence.scale)
    share = left.share(left.after)
    loads = loads_of(fit, evidence.session.predictor, evidence.scale)
    present = evidence.session.robot.effects
    return [
        EffectFinding(name, values[name], share, name in present, loads.get(name))
        for name in ranked.candidate.names
    ]


def rows_of(
    evidence: Evidence,
    chosen: Sequence[Ranked],
    together: Sequence[str],
    verdict: Verdict,
    left: Left,
) -> tuple[CandidateRow, ...]:
    """
    Return the candidate table, best first; where nothing is missing nothing is explained.

    The error of every candidate is of the same kind as that which is told of the chosen one.
    """
    ranked = list(evidence.singles)
    ranked += [r for r in chosen if r not in ranked]
    rows = []
    for r in sorted(ranked, key=lambda r: r.score):
        rows.append(_row(evidence, r, chosen, together, verdict, left))
        evidence.session.progress('postures left out', len(rows), len(ranked))
    return tuple(rows)


def _row(
    evidence: Evidence,
    ranked: Ranked,
    chosen: Sequence[Ranked],
    together: Sequence[str],
    verdict: Verdict,
    left: Left,
) -> CandidateRow:
    fit, session = ranked.fit, evidence.session
    told = evidence.told(ranked) if ranked in chosen else fit
    needed = verdict is not Verdict.ADEQUATE
    if ranked in chosen:
        status = 'best'
    elif ranked.candidate.label in together:
        status = 'cannot be told apart'
    elif ranked.probability > P_SINGLE_MIN:
        status = 'adequate, less likely' if needed else NOT_NEEDED
    else:
        status = 'rejected'
    values = {
        f'{effect}.{key}' if len(ranked.candidate.names) > 1 else key: value
        for effect, items in values_of(told, evidence.scale).items()
        for key, value in items.items()
    }
    error = error_of(session, described_by(session, told, left.beside))
    loads = loads_of(told, session.predictor, evidence.scale)
    return CandidateRow(
        ranked.candidate.label,
        values,
        fit.chi2,
        fit.freedom,
        ranked.probability,
        left.share(error) if needed else 0.0,
        error,
        _held_out(session, ranked, left, error, status),
        status,
        ranked.candidate.present,
        next(iter(loads.values()), None),
    )


def _held_out(session: Session, ranked: Ranked, left: Left, error: float, status: str) -> float:
    """
    Return the error [m] on postures left out in turn.

    Of what is written as `add` tells it, of what competes with it in the same way; of the others
    by slopes alone, which takes no time.
    """
    if status == 'best':
        return left.left_out
    if status in ('rejected', NOT_NEEDED):
        chi2 = max(ranked.fit.chi2, 1e-12)
        return float(error * np.sqrt(max(ranked.held_out, 1e-12) / chi2))
    return predicted_left_out(session.fitters[0], ranked.fit, left.beside)


def details_of(
    evidence: Evidence, chosen: Sequence[Ranked], together: Sequence[str], verdict: Verdict
) -> dict[str, Any]:
    """Return the numbers that reports print beside the verdict."""
    session, base = evidence.session, evidence.base
    relative = verdict is Verdict.OUTSIDE_CATALOGUE
    fit = evidence.told(chosen[0]) if chosen else base
    details: dict[str, Any] = measured_with(session) | {
        'exact': session.robot.exact,
        'caveats': caveats(session),
        **left_out(session.dataset, session.outliers, session.unsettled),
        'as_built': arm_report(session, fit),
        'local_faults': faults_of(session, fit),
        'tolerances': dict(session.robot.tolerances),
        'moved': base.prior_z,
        'base': {
            'chi2': base.chi2,
            'deviance': base.deviance,
            'freedom': base.freedom,
            'probability': base.probability(session.freedom),
        },
        'score': session.score(chosen[0].score if chosen else base.deviance),
        'relative_to_remainder': evidence.scale if relative else None,
        'accuracy': session.accuracy if session.use_accuracy else None,
    }
    details |= _alternatives(evidence, chosen, together)
    if verdict is Verdict.ADEQUATE:
        details['detectable'] = smallest_seen(evidence)
    return details


def measured_with(session: Session) -> dict[str, Any]:
    """Return what was measured, and how exactly."""
    dataset, noise = session.dataset, session.noise
    assert noise is not None
    seen = dataset.trials > 0
    return {
        'robot': session.robot.name,
        'data': dataset.name,
        'postures': int(seen.sum()),
        'at_rest': int(at_rest(dataset.inputs)[seen].sum()),
        'input': dataset.input,
        'trials': int(dataset.trials.sum()),
        'markers': len(dataset.markers),
        'noise': {key: getattr(noise, key) for key in NOISE_KEYS},
    }


def caveats(session: Session) -> list[str]:
    """Say what these measurements are short of."""
    dataset, noise = session.dataset, session.noise
    postures, said = int((dataset.trials > 0).sum()), []
    if postures < POSTURES_ENOUGH:
        said.append(f'{postures} postures are few: different causes may look alike in them')
    seen = dataset.counts.sum(axis=0) > 0
    reach = float(dataset.arc_lengths[seen].max()) / session.robot.length
    if reach < COVERED_SHARE_MIN:
        said.append(
            f'the markers end at {100.0 * reach:.0f} % of the arm: nothing is told of what lies '
            'beyond'
        )
    declared = dataset.position_noise
    if noise is not None and noise.source == 'trials' and declared:
        ratio = noise.position / declared
        if not 1.0 / NOISE_FACTOR_MAX < ratio < NOISE_FACTOR_MAX:
            said.append(
                f'the trials scatter by {mm(noise.position, 2)} per coordinate, declared are '
                f'{mm(declared, 2)}'
            )
    return said


def left_out(
    dataset: DataSet, outliers: Outliers | None, unsettled: Sequence[str]
) -> dict[str, Any]:
    """Name the postures that do not settle, and the readings and trials that others contradict."""
    rows = [] if outliers is None else outliers.rows(dataset)
    return {'unsettled': list(unsettled), 'outliers': rows}


def _alternatives(
    evidence: Evidence, chosen: Sequence[Ranked], together: Sequence[str]
) -> dict[str, Any]:
    """Return what competes with the chosen effects, and what was not tested, with reasons."""
    session, details = evidence.session, dict[str, Any]()
    if evidence.competing is not None:
        details['rival'] = {
            'name': evidence.competing.name,
            'deviance': evidence.competing.deviance,
            'parameters': evidence.competing.parameters,
        }
    details['next_best'], details['wider'] = _next_best(evidence, chosen, together)
    details['described'] = {
        name: session.robot.effects[name]
        for r in chosen
        for name in r.candidate.names
        if name in session.robot.effects
    }
    details['not_tested_because'] = {
        c.names[0]: why_untested(session.catalogue[c.names[0]], session.dataset, session.robot)
        for c in evidence.not_tested
    }
    return details


def _next_best(
    evidence: Evidence, chosen: Sequence[Ranked], together: Sequence[str]
) -> tuple[dict[str, Any] | None, list[str]]:
    """Best beyond the class, and what fits as well but contains one of the class."""
    others = [r for r in evidence.singles if r not in chosen and r.candidate.label not in together]
    if not chosen or not others:
        return None, []
    near = [
        r
        for r in others
        if r.probability > P_SINGLE_MIN and r.score <= chosen[0].score + APART_FROM_SCORE
    ]
    wider = [r.candidate.label for r in near]
    others = [r for r in others if r not in near]
    if not others:
        return None, wider
    other = min(others, key=lambda r: r.score)
    ratio = (other.score - chosen[0].score) / (2.0 * np.log(10.0) * evidence.scale)
    return {'name': other.candidate.label, 'log10_likelihood_ratio': float(ratio)}, wider


def smallest_seen(evidence: Evidence) -> dict[str, dict[str, Any]]:
    """Smallest size of each single-parameter effect that these postures would have shown."""
    count = max(len(evidence.singles), 1)
    threshold = np.sqrt(chi2_isf(2.0 * ALARM_LEVEL / count, 1)) + normal_ppf(0.8)
    seen = {}
    for ranked in evidence.singles:
        if len(ranked.fit.frees) == 1 and not ranked.candidate.present:
            spread = np.sqrt(ranked.fit.covariance[0, 0])
            if np.isfinite(spread):
                free = ranked.fit.frees[0]
                seen[ranked.candidate.label] = {
                    'size': float(threshold * spread),
                    'parameter': free.key,
                    'unit': free.parameter.unit,
                }
    return seen
