"""From fits to the rows and numbers of a result: values with intervals, shares, errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..common.words import mm
from ..comparison.outliers import Outliers
from ..comparison.statistics import chi2_isf, normal_ppf
from ..data import DataSet
from ..data.dataset import at_rest
from .candidates import Ranked, why_untested
from .crossval import described_by, error_of, share_gone, written
from .crossval import left_out as predicted_left_out
from .fit import Fit
from .imperfections import REMAINDER
from .intervals import (
    SizeIntervals,
    loads_of,
    values_of,
    values_with_intervals,
)
from .local_tests import faults_of
from .patterns import Pattern, patterns_of
from .result import NOT_NEEDED, CandidateRow, EffectFinding
from .select import Evidence
from .session import Session
from .verdict import (
    ALARM_LEVEL,
    APART_FROM_SCORE,
    COVERED_SHARE_MIN,
    FALSE_OUT_OF_LINE_PROBABILITY,
    NOISE_FACTOR_MAX,
    NOISE_WITHIN_FLOORS,
    P_SINGLE_MIN,
    PATTERN_SHARE_MIN,
    POSTURES_ENOUGH,
    TOLD_SPAN_MAX,
    Verdict,
)

if TYPE_CHECKING:
    from .session import Session
if TYPE_CHECKING:
    from .select import Evidence

Floats = npt.NDArray[np.float64]
NOISE_KEYS = ('position', 'shift', 'trial', 'setting', 'source')


def remainder_text(
    evidence: Evidence, chosen: Ranked | None, verdict: Verdict, left: float
) -> str:
    """Say that so much [m] remains after the chosen effects (or none), and what it looks like."""
    session = evidence.session
    fit = chosen.fit if chosen else evidence.base
    floor = session.whitener.floor()
    is_noise = left < NOISE_WITHIN_FLOORS * floor
    text = f'What is left ({1e3 * left:.2f} mm) ' + (
        f'equals your repeatability ({1e3 * floor:.2f} mm).'
        if is_noise
        else f'is {left / floor:.1f} times your repeatability ({1e3 * floor:.2f} mm).'
    )
    if session.brief and verdict is Verdict.OUTSIDE_CATALOGUE:
        return text
    if verdict is not Verdict.OUTSIDE_CATALOGUE:
        built = session.random is not None and not is_noise
        return f'{text} How an arm is built accounts for that: see its scatter.' if built else text
    pattern = evidence.competing or best_pattern(evidence, chosen)
    return (
        f'{text} {pattern.text(session.dataset.postures)}'
        if pattern
        else f'{text} {_worst(evidence, fit)}'
    )


def best_pattern(evidence: Evidence, chosen: Ranked | None) -> Pattern | None:
    """Return the pattern that takes a third or more of what is left, if there is one."""
    fit = evidence.base if chosen is None else chosen.fit
    fitters, turns = evidence.session.fitters, evidence.turns
    patterns = evidence.patterns if chosen is None else patterns_of(fitters, fit, turns=turns)
    top = min(patterns, key=lambda pattern: pattern.score, default=None)
    excess = fit.chi2 - fit.freedom
    if top is None or fit.deviance - top.deviance < PATTERN_SHARE_MIN * excess:
        return None
    return top


def _worst(evidence: Evidence, fit: Fit) -> str:
    dataset = evidence.session.dataset
    distance = np.linalg.norm(dataset.mean - fit.markers, axis=2)
    posture, marker = np.unravel_index(np.nanargmax(distance), distance.shape)
    return (
        f'No pattern fits it. It is largest in posture {dataset.postures[posture]} at marker '
        f'{dataset.markers[marker].name} ({1e3 * distance[posture, marker]:.1f} mm).'
    )


def arm_report(session: Session, fit: Fit) -> dict[str, Any] | None:
    """
    Return the estimated scatter of each kind with its 95 % interval, and the members out of line.

    Sizes in SI; no upper end is None. A size is `told` where the measurements would tell a
    plausible one, whatever they tell of this arm: to print what came out large would pick what
    came out too large. A member is out of line where it deviates by more of what is plausible than
    the largest of so many would. None where the description counts as exact.
    """
    built, random = fit.built, session.random
    if built is None or random is None:
        return None
    sizes = built.estimate(told=False).values
    slopes = fit.jacobian[: len(random.columns), : len(fit.all_frees)]
    intervals = SizeIntervals(random, sizes, slopes, fit.precisions)
    lows, highs = intervals.ends(sizes)
    least, most = intervals.ends(random.plausible)
    told = (most < TOLD_SPAN_MAX * least) & ((lows > 0.0) | np.isfinite(highs))
    found, kinds = fit.members or {}, []
    for k, kind in enumerate(built.kinds):
        if kind.name == REMAINDER:
            continue
        values, spread = found[kind.name], _posterior(fit, k)
        size = float(sizes[k])
        quantile = chi2_isf(FALSE_OUT_OF_LINE_PROBABILITY / len(values), 1)
        limit = np.sqrt(quantile) * max(size, kind.plausible)
        members = zip(kind.members, values, spread, strict=True)
        kinds.append(
            {
                'kind': kind.name,
                'unit': kind.unit,
                'size': size,
                'low': float(lows[k]),
                'high': float(highs[k]) if np.isfinite(highs[k]) else None,
                'plausible': kind.plausible,
                'members': {name: _member(value, sd) for name, value, sd in members},
                'told': bool(told[k]),
                'out_of_line': [
                    name
                    for name, value in zip(kind.members, values, strict=True)
                    if abs(value) > limit
                ],
            }
        )
    last = float(sizes[-1])
    return {'kinds': kinds, 'remainder': last, 'floor': floor_as_built(session, fit)}


def _posterior(fit: Fit, k: int) -> np.ndarray:
    """Return what is left of the standard deviation (q,) of the members of a kind."""
    built = fit.built
    assert built is not None
    own = len(fit.all_frees) + np.flatnonzero(built.random.owners == k)
    mix = built.random.mixtures[k]  # what they do not mix the data do not show
    told = ((mix @ fit.covariance[np.ix_(own, own)]) * mix).sum(axis=1)
    unseen = 1.0 - (mix * mix).sum(axis=1)
    return np.asarray(built.sizes[k] * np.sqrt(np.maximum(unseen + told, 0.0)))


def _member(value: float, sd: float) -> dict[str, float]:
    half = normal_ppf(0.975) * float(sd)
    return {'value': float(value), 'low': float(value) - half, 'high': float(value) + half}


def floor_as_built(session: Session, fit: Fit) -> float:
    """Return the expected rms [m] of a perfect model of an arm that scatters like this."""
    return _floor(session, None if fit.built is None else fit.built.sizes)


def usual_floor(session: Session) -> float:
    """Return the expected rms [m] of a perfect model of an arm that is built as usual."""
    return _floor(session, None if session.random is None else session.random.plausible)


def _floor(session: Session, sizes: np.ndarray | None) -> float:
    noise = session.whitener.floor()
    if sizes is None or session.imperfections is None:
        return noise
    seen = session.dataset.counts > 0
    spread = [
        np.full(len(kind), size if kind.name != REMAINDER else 0.0)
        for kind, size in zip(session.imperfections.kinds, sizes, strict=True)
    ]
    lengths = np.linalg.norm(session.imperfections.moves, axis=3)
    moved = ((np.concatenate(spread)[:, None, None] * lengths) ** 2).sum(axis=0)
    return float(np.sqrt(noise**2 + moved[seen].mean()))


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
