"""From fits to the rows and numbers of a result: errors, fractions, scatter, remainder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..common.words import mm
from ..data import DataSet
from ..data.dataset import at_rest
from ..inference.candidates import Ranked, why_untested
from ..inference.crossval import (
    described_by,
    error_of,
    explained_fraction,
    left_out_squares,
    written,
)
from ..inference.fit import Fit
from ..inference.imperfections import ANEW, EARLIER
from ..inference.intervals import SizeIntervals, loads_of, values_of, values_with_intervals
from ..inference.marginal import Prior
from ..inference.outliers import Outliers
from ..inference.session import Session
from ..inference.statistics import QUANTILE, SIGNIFICANCE, chi2_isf, root_mean
from .local_tests import faults_of
from .placed import pushes_by
from .result import NOT_NEEDED, CandidateRow, EffectFinding
from .select import Concluded, Fits
from .trust import smallest_sizes
from .verdict import (
    APART_FROM_SCORE,
    COVERAGE_MIN,
    P_SINGLE_MIN,
    PATTERN_GAIN_MIN,
    POSTURES_ENOUGH,
    REPEATABILITIES_MAX,
    SAME_ERROR_RATIO,
    Verdict,
)

NOISE_KEYS = ('position', 'shift', 'trial', 'setting', 'source')
SPAN_MAX = 30.0  # [1] ratio of the ends of an interval, else nobody would know the size


def remainder_text(
    fits: Fits, decision: Concluded, residual: float, arm: Mapping[str, Any] | None
) -> str:
    """
    Return sentences on the residual [m] after the chosen effects, if any, and its pattern.

    `arm` is what `arm_report` says of the scatter of the arm.
    """
    session, outside = fits.session, decision.verdict is Verdict.OUTSIDE_CATALOGUE
    floor = session.whitener.floor()
    is_noise = residual < SAME_ERROR_RATIO * floor
    left, repeatability = (f'({1e3 * error:.2f} mm)' for error in (residual, floor))
    size = 'equals' if is_noise else f'is {residual / floor:.1f} times'
    text = f'What is left {left} {size} your repeatability {repeatability}.'
    if not outside:
        accounted = '' if is_noise else _accounted(session, residual, arm)
        return f'{text} {accounted}'.rstrip()
    repeats = session.repeats
    if fits.remembers and repeats is not None:
        return (
            f'{text} Where inputs repeat, the error of the description differs by '
            f'{mm(repeats.apart)} from time to time: what is missing depends on how the arm got '
            'there, or on time.'
        )
    fit = fits.base if decision.chosen is None else decision.chosen.fit
    pattern, dataset = decision.rival, session.dataset
    if pattern is None:
        patterns = fits.patterns if fit is fits.base else fits.patterns_on(fit)
        pattern = min(patterns, key=lambda pattern: pattern.score, default=None)
        gain = 0.0 if pattern is None else fit.deviance - pattern.deviance
        if gain < PATTERN_GAIN_MIN * (fit.chi2 - fit.freedom):
            pattern = None
    if pattern is not None:
        return f'{text} {pattern.text(dataset.postures)}'
    distance = np.linalg.norm(dataset.mean - fit.markers, axis=2)
    posture, marker = np.unravel_index(np.nanargmax(distance), distance.shape)
    return (
        f'{text} No pattern fits it. It is largest in posture {dataset.postures[posture]} at '
        f'marker {dataset.markers[marker].name} ({1e3 * distance[posture, marker]:.1f} mm).'
    )


def _accounted(session: Session, residual: float, arm: Mapping[str, Any] | None) -> str:
    """Return the sentence on what accounts for a residual [m] that is more than noise, if any."""
    reference, known = session.dataset.reference, session.robot.model_error
    told = {
        kind['kind']: kind['size']
        for kind in (arm or {}).get('kinds', ())
        if kind['told'] and kind['kind'] not in ANEW.values()  # taken off the errors
    }
    kinds = (kind.name for kind in session.imperfections.kinds)
    measured = session.floor_with(np.array([told.get(k, float(k == EARLIER)) for k in kinds]))
    if reference is not None and measured <= residual / SAME_ERROR_RATIO:
        return (
            f'How the arm deviates from its description may itself have changed by that much: it '
            f'deviated by {mm(reference.error, 2)} at the tip in {reference.name}.'
        )
    if known:
        return f'The description is known to be off by {mm(known, 2)} at the tip.'
    if arm is None:
        return ''
    if residual < REPEATABILITIES_MAX * session.whitener.floor():
        return 'How an arm is built accounts for that: see its scatter.'
    if measured > residual / SAME_ERROR_RATIO:
        return 'The scatter that these measurements show accounts for that.'
    return (
        f'The scatter that these measurements show accounts for {mm(measured, 2)}; '
        'for the rest they show no cause: other effects may be at work, too.'
    )


def arm_report(session: Session, fit: Fit) -> dict[str, Any] | None:
    """
    Return the estimated scatter of each kind with its 95 % interval, and the members out of line.

    Sizes in SI; an infinite upper end is None. A size is `told` where the measurements would
    determine a plausible one, whatever the estimate is: to select large estimates would select
    overestimates. A member is out of line where it is significantly larger than the largest of so
    many members of plausible size. None where the description is exact.
    """
    built, random = fit.built, session.random
    if not fit.as_built:
        return None
    sizes = fit.estimate(prior=Prior.NONE).values
    intervals = SizeIntervals(random, sizes, fit.slopes, fit.precisions)
    lows, highs = intervals.ends(sizes)
    usual_low, usual_high = intervals.ends(random.plausible)
    informative = (usual_high < SPAN_MAX * usual_low) & ((lows > 0.0) | np.isfinite(highs))
    members, kinds = fit.members, []
    for k, kind in enumerate(built.kinds[:-1]):  # without the remainder
        if kind.name == EARLIER:
            continue
        own = len(fit.all_frees) + np.flatnonzero(built.random.owners == k)
        mix = built.random.mixtures[k]  # the data show no other directions
        known = ((mix @ fit.covariance[np.ix_(own, own)]) * mix).sum(axis=1)
        unseen = 1.0 - (mix * mix).sum(axis=1)
        half = QUANTILE * built.sizes[k] * np.sqrt(np.maximum(unseen + known, 0.0))
        values, size = members[kind.name], float(sizes[k])
        limit = np.sqrt(chi2_isf(SIGNIFICANCE / len(values), 1)) * max(size, kind.plausible)
        rows = list(zip(kind.members, values.tolist(), half.tolist(), strict=True))
        kinds.append(
            {
                'kind': kind.name,
                'unit': kind.unit,
                'size': size,
                'low': float(lows[k]),
                'high': float(highs[k]) if np.isfinite(highs[k]) else None,
                'plausible': kind.plausible,
                'members': {
                    name: {'value': value, 'low': value - half, 'high': value + half}
                    for name, value, half in rows
                },
                'told': bool(informative[k]),
                'out_of_line': [name for name, value, _ in rows if abs(value) > limit],
            }
        )
    floor = session.floor_with(built.sizes)
    return {'kinds': kinds, 'remainder': float(sizes[-1]), 'floor': floor}


@dataclass(frozen=True)
class FittedErrors:
    """Rms errors [m] of unchanged descriptions on the fitted postures."""

    before: float  # as described
    alone: float  # with the effects, the arm otherwise as described
    after: float  # as `add` writes it
    floor: float  # of a perfect model
    beside: bool  # whether the arm as it was found is written as well
    left_out: float = np.nan  # of the written description, on left-out postures

    def explained(self, error: float) -> float:
        """Return the explained fraction, 0 to 1, of the explainable error if `error` remains."""
        fraction = explained_fraction(self.before, error, min(self.floor, self.after))
        return 0.0 if fraction is None else float(np.clip(fraction, 0.0, 1.0))


def fitted_errors(fits: Fits, chosen: Ranked | None) -> FittedErrors:
    """Return the errors of the descriptions that a candidate writes; without one, as described."""
    session, fit = fits.session, fits.base if chosen is None else fits.reported(chosen)
    before, floor = error_of(session, session.robot, fit), session.whitener.floor()
    if chosen is None:
        return FittedErrors(before, before, before, floor, False)
    descriptions = written(session, fit)
    alone = error_of(session, descriptions.alone, fit)
    after = error_of(session, descriptions.robot, fit) if descriptions.beside else alone
    return FittedErrors(before, alone, after, floor, descriptions.beside, descriptions.left_out)


def finding(fits: Fits, decision: Concluded, errors: FittedErrors) -> list[EffectFinding]:
    """
    Return the chosen effects, with the fraction that they explain together.

    Where another effect may stand for one of several, the intervals of the rest hold for both.
    """
    ranked, session = decision.chosen, fits.session
    if ranked is None:
        return []
    fit = fits.reported(ranked)
    values = values_with_intervals(session.fitter, fit, decision.scale)
    explained = errors.explained(errors.after)
    loads = loads_of(fit, session.predictor, decision.scale)
    for other in (fits.reported(one) for one in decision.alike if one is not ranked):
        others, forces = values_of(other), loads_of(other, session.predictor)
        for name in values.keys() & others.keys():
            values[name] = {k: own.spanning(others[name][k]) for k, own in values[name].items()}
        both = loads.keys() & forces.keys()
        loads |= {name: loads[name].spanning(forces[name]) for name in both}
    present = session.robot.effects
    return [
        EffectFinding(name, values[name], explained, name in present, loads.get(name))
        for name in ranked.names
    ]


def nearest(fits: Fits, decision: Concluded) -> Ranked | None:
    """Return the one of a class that predicts left-out postures best, the arm as described."""
    near = [one for one in fits.every if one.candidate.label in decision.together]

    def left_out_error(one: Ranked) -> float:
        return root_mean(left_out_squares(fits.session.fitter, one.fit, beside=False))

    return min(near, key=left_out_error, default=decision.chosen)


def rows_of(fits: Fits, decision: Concluded, errors: FittedErrors) -> tuple[CandidateRow, ...]:
    """
    Return the candidate table, best first.

    The error of every candidate is of the same kind as that of the chosen one.
    """
    ranked, chosen = fits.every, decision.chosen
    together = decision.alike or (() if chosen is None else (chosen,))
    ranked += [one for one in together if one not in ranked]
    rows = []
    for r in sorted(ranked, key=lambda r: r.score):
        rows.append(_row(fits, decision, r, errors))
        fits.session.progress('postures left out', len(rows), len(ranked))
    return tuple(rows)


def _row(fits: Fits, decision: Concluded, ranked: Ranked, errors: FittedErrors) -> CandidateRow:
    """
    Return the row of a candidate.

    The left-out error of the chosen candidate and of those that explain as much comes from the
    model, as in `add`; that of the others is linearised, which is much cheaper. So are their
    intervals: at the likeliest sizes of the imperfections, not over all possible ones.
    """
    fit, session, best = ranked.fit, fits.session, ranked is decision.chosen
    reported = fits.reported(ranked) if best else fit
    needed = decision.verdict is not Verdict.ADEQUATE
    error = error_of(session, described_by(session, reported, errors.beside), reported)
    known, alike = None, {one.candidate.label for one in decision.alike} or set(decision.together)
    if best:
        status, held_out = 'best', errors.left_out
    elif ranked.candidate.label in alike:
        status = 'cannot be told apart'
        held_out = root_mean(left_out_squares(session.fitter, fit, errors.beside))
    else:
        adequate = 'adequate, less likely' if needed else NOT_NEEDED
        status = adequate if ranked.probability > P_SINGLE_MIN else 'rejected'
        by_slopes = max(ranked.held_out, 1e-12) / max(fit.chi2, 1e-12)
        held_out = float(error * np.sqrt(by_slopes))
        count = len(fit.frees)
        known = fit.covariance[:count, :count]
    values = {
        f'{effect}.{key}' if len(ranked.names) > 1 else key: value
        for effect, items in values_of(reported, decision.scale, known).items()
        for key, value in items.items()
    }
    loads = loads_of(reported, session.predictor, decision.scale, known)
    return CandidateRow(
        ranked.candidate.label,
        values,
        fit.chi2,
        fit.freedom,
        ranked.probability,
        errors.explained(error) if needed else 0.0,
        error,
        held_out,
        status,
        ranked.present,
        next(iter(loads.values()), None),
    )


def details_of(fits: Fits, decision: Concluded) -> dict[str, Any]:
    """Return the numbers that reports print beside the verdict."""
    session, base, chosen = fits.session, fits.base, decision.chosen
    taken = session.dataset.reference
    fit = base if chosen is None else fits.reported(chosen)
    outside = decision.verdict is Verdict.OUTSIDE_CATALOGUE
    details: dict[str, Any] = measured_with(session) | {
        'exact': session.robot.exact,
        'caveats': caveats(session),
        **left_out(session.dataset, session.outliers, session.unsettled),
        'as_built': arm_report(session, fit),
        'anew': fit.anew,
        'local_faults': faults_of(session, fit),
        'tolerances': dict(session.robot.tolerances),
        'moved': base.prior_z,
        'base': {
            'chi2': base.chi2,
            'deviance': base.deviance,
            'freedom': base.freedom,
            'probability': base.probability(session.noise.freedom),
        },
        'score': session.score(base.deviance if chosen is None else chosen.score),
        'relative_to_remainder': decision.scale if outside else None,
        'accuracy': session.dataset.accuracy if session.use_accuracy else None,
        'model_error': session.robot.model_error,
        'reference': taken and {'data': taken.name, 'error': taken.error, 'lacked': taken.lacked},
    }
    if decision.rival is not None:
        names = 'name', 'deviance', 'parameters'
        details['rival'] = {name: getattr(decision.rival, name) for name in names}
    details['next_best'], details['wider'] = _next_best(fits, decision)
    details['described'] = {
        name: session.robot.effects[name]
        for name in (() if chosen is None else chosen.names)
        if name in session.robot.effects
    }
    named = {*decision.together, *(() if chosen is None else chosen.names)}
    details['effects_in_words'] = {
        effect.name: {'title': effect.title, 'finding': effect.finding}
        for effect in session.catalogue
        if effect.name in named
    }
    details['pushes'] = {
        name: pushes_by(session, fit if ranked is chosen else ranked.fit, name, decision.scale)
        for ranked in dict.fromkeys(filter(None, (chosen, *decision.alike)))
        for name in ranked.names
        if session.catalogue[name].placed
    }
    details['not_tested_because'] = {
        c.names[0]: why_untested(session.catalogue[c.names[0]], session.dataset, session.robot)
        for c in fits.not_tested
    }
    if decision.verdict is Verdict.ADEQUATE:
        details['detectable'] = {
            one.free.effect: one.plain
            for one in smallest_sizes(fits.singles, session.nuisances)
            if one.size and one.alone
        }
    return details


def measured_with(session: Session) -> dict[str, Any]:
    """Return the extent and the noise of the measurements."""
    dataset, noise = session.dataset, session.noise
    measured = dataset.trials > 0
    return {
        'robot': session.robot.name,
        'data': dataset.name,
        'postures': int(measured.sum()),
        'at_rest': int(at_rest(dataset.inputs)[measured].sum()),
        'input': dataset.input,
        'trials': int(dataset.trials.sum()),
        'markers': len(dataset.markers),
        'noise': {key: getattr(noise, key) for key in NOISE_KEYS},
    }


def caveats(session: Session) -> list[str]:
    """Return sentences on the deficiencies of these measurements."""
    dataset, noise = session.dataset, session.noise
    postures, texts = int((dataset.trials > 0).sum()), []
    if postures < POSTURES_ENOUGH:
        texts.append(f'{postures} postures are few: different causes may look alike in them')
    visible = dataset.counts.sum(axis=0) > 0
    reach = float(dataset.arc_lengths[visible].max()) / session.robot.length
    if reach < COVERAGE_MIN:
        texts.append(
            f'the markers end at {100.0 * reach:.0f} % of the arm: nothing is told of what lies '
            'beyond'
        )
    declared = dataset.position_noise
    if noise.source == 'trials' and declared:
        ratio = noise.position / declared
        if not 0.5 < ratio < 2.0:
            texts.append(
                f'the trials scatter by {mm(noise.position, 2)} per coordinate, declared are '
                f'{mm(declared, 2)}'
            )
    return texts


def left_out(
    dataset: DataSet, outliers: Outliers | None, unsettled: Sequence[str]
) -> dict[str, Any]:
    """Return what had no part: postures without equilibrium, contradicted readings, how many."""
    rows = [] if outliers is None else outliers.rows(dataset)
    thinned = [int((dataset.trials > 0).sum()), dataset.thinned_from]
    return {
        'unsettled': list(unsettled),
        'outliers': rows,
        'thinned': thinned if dataset.thinned_from else None,
    }


def _next_best(fits: Fits, decision: Concluded) -> tuple[dict[str, Any] | None, list[str]]:
    """Return the best candidate outside the class, and those that fit as well but contain one."""
    chosen = decision.chosen
    others = [
        r for r in fits.every if r is not chosen and r.candidate.label not in decision.together
    ]
    if chosen is None or not others:
        return None, []
    near = [
        r
        for r in others
        if r.probability > P_SINGLE_MIN and r.score <= chosen.score + APART_FROM_SCORE
    ]
    wider = [r.candidate.label for r in near]
    other = min((r for r in others if r not in near), key=lambda r: r.score, default=None)
    if other is None:
        return None, wider
    ratio = (other.score - chosen.score) / (2.0 * np.log(10.0) * decision.scale)
    return {'name': other.candidate.label, 'log10_likelihood_ratio': float(ratio)}, wider
