"""
What a diagnosis says in words, and what was added by it.

Every sentence comes from fields of the result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from string import Formatter

import numpy as np

from ..common.words import columns, commands, counted, digits, listed, mm, percent, postures
from ..diagnosis.add import Addition
from ..diagnosis.result import CandidateRow, Diagnosis, EffectFinding, NextMeasurement
from ..diagnosis.verdict import P_SINGLE_MIN, SAME_ERROR_RATIO, SEPARABLE_FROM_SD, Verdict
from ..inference.crossval import explained_fraction
from ..robot.estimates import stiffnesses
from . import sentences

# tolerances that are no fractions, and their units
TOLERANCE_UNITS = {'position': 'm', 'pull_zero': 'm', 'rotation': 'rad', 'cell_kink': 'rad'}
# a fit without physics that beat the effects, by its name
PATTERNS = {
    'soft_cell': 'a single soft cell',
    'taper': 'a stiffness that changes along the arm',
    'gain_per_posture': 'a factor of its own on the inputs of every posture',
    'rotation_per_posture': 'a rotation of its own of every posture',
}
# [1] trials of a posture that are advised: so many halve the noise, so that its spread shows too
TRIALS_ADVISED = 5
NOT_WRITTEN = 'Nothing was written: the error on postures that were not used would rise.'


def lines(diagnosis: Diagnosis) -> list[str]:
    """Return all lines: verdict, remaining error, alternatives, what to do, what it rests on."""
    text, trust = verdict(diagnosis).split('\n'), trust_lines(diagnosis)
    if not diagnosis.verdict.judged:
        return [*text, *sentences.excluded_lines(diagnosis.details), *trust]
    text += [*errors(diagnosis), diagnosis.remainder]
    text += [f'mind: {caveat}' for caveat in diagnosis.details.get('caveats', ())]
    text += sentences.where_wrong(diagnosis.details.get('local_faults', ()))
    text += filter(None, [alike(diagnosis), next_measurement(diagnosis)])
    text += ['', size(diagnosis), *declared(diagnosis)]
    text += sentences.excluded_lines(diagnosis.details)
    text += sentences.as_built(diagnosis.details.get('as_built'))
    return [*text, *filter(None, [untested(diagnosis), detectable(diagnosis)]), *trust]


def size(diagnosis: Diagnosis) -> str:
    """Say what was diagnosed."""
    details = diagnosis.details
    if 'postures' not in details:
        return 'diagnosis'
    parts = [counted(details['trials'], 'trial'), counted(details['markers'], 'marker')]
    measured = postures(details['postures'], details.get('at_rest', 0))
    return f'{details["robot"]} on {details["data"]}: {listed([measured, *parts])}'


def declared(diagnosis: Diagnosis) -> list[str]:
    """Say what counts as exact, and what the noise is taken to be."""
    details = diagnosis.details
    if 'tolerances' not in details:
        return []
    sizes = ', '.join(tolerance(name, size) for name, size in details['tolerances'].items())
    if not details.get('exact', True):
        first = 'the arm is taken as it is built: cells, tendons and tracker may be a little off'
        first += f'; declared (1 sd): {sizes}' if sizes else ''
    elif sizes:
        first = f'declared tolerances (1 sd): {sizes}; everything else is taken as exact'
    else:
        first = 'no tolerances declared: the description is taken as exact'
    if known := details.get('model_error'):
        first += f'; the description is known to be off by {mm(known, 2)} at the tip'
    if taken := details.get('reference'):
        first = (
            f'what the arm deviated from its description in {taken["data"]} '
            f'({mm(taken["error"], 2)} at the tip) is taken off: what has changed since is judged'
        )
        if lacked := listed(list(taken['lacked'])):
            first += f'; missing there already, and counted as described: {lacked}'
    noise = details['noise']
    source = 'from the trials' if noise['source'] == 'trials' else 'as declared'
    second = f'noise, {source}: {mm(noise["position"], 2)} per coordinate'
    if noise.get('shift'):
        second += f', {mm(noise["shift"], 2)} of all markers of a trial together'
    second += f', inputs {digits(100.0 * noise["trial"])} % per trial'
    setting = f', {digits(100.0 * noise["setting"])} % per setting (declared)'
    second += setting if noise['setting'] else '; none declared for how inputs are set'
    return [first, second]


def tolerance(name: str, size: float) -> str:
    """Say a declared tolerance in the unit that suits it."""
    return f'{name} {sentences.amount(size, TOLERANCE_UNITS.get(name, "1"))}'


def verdict(diagnosis: Diagnosis) -> str:
    """Return the verdict in one line, or two: its sentence with what the diagnosis found."""
    sentence = diagnosis.verdict.sentence
    names = [name for _, name, _, _ in Formatter().parse(sentence) if name]
    return sentence.format(**{name: _fields[name](diagnosis) for name in names})


def detail(key: str, known: str, usual: str) -> Callable[[Diagnosis], str]:
    """Return what says a detail of a diagnosis in a sentence, the usual words where it is not."""
    return lambda diagnosis: (
        usual if diagnosis.details.get(key) is None else known.format(diagnosis.details[key])
    )


def findings(diagnosis: Diagnosis) -> str:
    """Say what was found: 'a load of 29.9 ± 0.3 mN at the tip, along gravity (`tip_load`)'."""
    return '; and '.join(in_words(diagnosis, effect) for effect in diagnosis.effects)


def in_words(diagnosis: Diagnosis, found: EffectFinding | CandidateRow) -> str:
    """Say an effect with its values, in the words of its own file."""
    words = diagnosis.details.get('effects_in_words', {}).get(found.name, {})
    title, finding = words.get('title', found.name.replace('_', ' ')), words.get('finding', '')
    pushes = diagnosis.details.get('pushes', {}).get(found.name, ())
    said = sentences.finding_words(title, finding, found.parameters, found.load, pushes)
    return f'{said} (`{found.name}`)'


def as_written(diagnosis: Diagnosis) -> str:
    """Return the parameters under their names in a description, where the verdict has others."""
    words = diagnosis.details.get('effects_in_words', {})
    lines = [
        f'\nIn the description: {e.name}: {sentences.quantities(e.parameters)}.'
        for e in diagnosis.effects
        if words.get(e.name, {}).get('finding')
    ]
    return ''.join(lines)


def class_lines(diagnosis: Diagnosis) -> str:
    """Return a line for each effect that explains the measurements as well, the best first."""
    found: list[CandidateRow | EffectFinding] = [*diagnosis.candidates, *diagnosis.effects]
    known = {one.name: one for one in found}
    alike = [known.get(name, EffectFinding(name, {}, 0.0)) for name in diagnosis.cannot_tell_apart]
    return '\n'.join(f'- {in_words(diagnosis, one)}' for one in alike)


def explained_part(diagnosis: Diagnosis) -> str:
    """Say which fraction of the error above the noise goes, with and without the arm."""
    explained = percent(diagnosis.effects[0].explained)
    if not with_arm(diagnosis):
        return f'{explained} of the error above the noise'
    lowest = min(diagnosis.noise_floor, diagnosis.error_after)

    def share(error: float) -> str:
        fraction = explained_fraction(diagnosis.error_before, error, lowest) or 0.0
        return percent(max(fraction, 0.0))

    as_found = diagnosis.details.get('error_as_found', np.nan)
    without = f', and that arm {share(as_found)} without it' if np.isfinite(as_found) else ''
    return (
        f'{explained} of the error above the noise with the arm as it was found, '
        f'{share(diagnosis.error_alone)} alone{without}'
    )


def with_arm(diagnosis: Diagnosis) -> bool:
    """Return whether `add` would write the estimated arm in addition to the effects."""
    alone = diagnosis.error_alone
    return bool(np.isfinite(alone) and diagnosis.effects and alone != diagnosis.error_after)


def errors(diagnosis: Diagnosis) -> list[str]:
    """Explain the errors, if there is more than one after the verdict."""
    taken = sentences.anew_lines(diagnosis.details.get('anew', {}))
    if not with_arm(diagnosis):
        return taken
    names = listed([effect.name for effect in diagnosis.effects])
    return [
        f'error: {mm(diagnosis.error_before)} as described -> {mm(diagnosis.error_alone)} with '
        f'{names} alone -> {mm(diagnosis.error_after)} with the arm as it was found as well '
        '(tolerances and imperfections), which is what `add` writes',
        *taken,
    ]


def why_off(diagnosis: Diagnosis) -> str:
    """Say which quantity moved beyond its tolerance, or how much another value explains."""
    if diagnosis.out_of_tolerance:
        moved, by = diagnosis.details.get('moved', {}), ' (by {} times its tolerance)'
        strays = [
            f'{name}{by.format(digits(abs(moved[name]))) if name in moved else ""}'
            for name in diagnosis.out_of_tolerance
        ]
        return f'{listed(strays)} must move further than declared.'
    text = f'It explains {explained_part(diagnosis)}.'
    if diagnosis.cannot_tell_apart:
        text += f' {listed(diagnosis.cannot_tell_apart, "or")} explain it equally well.'
    return text


def instead(diagnosis: Diagnosis) -> str:
    """Say what the description has instead."""
    if diagnosis.out_of_tolerance:
        return ''
    best = diagnosis.effects[0]
    before = diagnosis.details.get('described', {}).get(best.name, {})
    units = {key.partition('[')[0]: value.unit for key, value in best.parameters.items()}
    was = '; '.join(
        sentences.described_quantity(key, units.get(key, '1'), np.atleast_1d(value).tolist())
        for key, value in before.items()
    )
    taken = diagnosis.details.get('reference')
    says = f'in {taken["data"]} it was' if taken else 'the description says'
    return f'; {says} {was or "nothing"}'


def what_remains(diagnosis: Diagnosis) -> str:
    """Say how far the best effects lower the error, and what remains or fits better."""
    before, after = diagnosis.error_before, diagnosis.error_after
    floors = (after if diagnosis.effects else before) / diagnosis.noise_floor
    size, little = f'{digits(floors)} times the noise', floors < SAME_ERROR_RATIO
    if not diagnosis.effects:
        random = 'not random, though it is only ' if little else ''
        return f'No known effect helps; the error is {random}{size}'
    best = next(row for row in diagnosis.candidates if row.status == 'best')
    lowers = 'It lowers' if len(diagnosis.effects) == 1 else 'They lower'
    lowers += f' the error from {mm(before)} to {mm(after)}'
    text = f'Nearest: {findings(diagnosis)}. {lowers}, but '
    rival = diagnosis.details.get('rival')
    if rival and best.probability > P_SINGLE_MIN:
        name = rival['name']
        return f'{text}{PATTERNS.get(name, name)} fits better without any physics'
    p = best.probability
    significance = ' (p < 1e-6)' if p < 1e-6 else f' (p = {digits(p, 1)})'
    if little:
        return f'{text}what remains is not random{significance}, though it is only {size}'
    return f'{text}what remains is {size}{significance}'


# field of a sentence of `diagnosis.verdict.Verdict` -> what stands there, so that a sentence names
# what it needs
_fields: dict[str, Callable[[Diagnosis], str]] = {
    'alike': class_lines,
    'as_written': as_written,
    'obstacle': detail('mistake', 'Mistake of the set-up', 'Cannot be judged'),
    'findings': findings,
    'instead': instead,
    'judged_by': lambda diagnosis: (
        f'matters at an accuracy of {mm(accuracy, 2)}'
        if (accuracy := diagnosis.details.get('accuracy'))
        else 'these measurements could show'
    ),
    'missing': detail('reference', 'Changed since {0[data]}', 'Missing'),
    'nothing': detail('reference', 'Nothing has changed since {0[data]}', 'Nothing is missing'),
    'off': detail('reference', 'Changed since {0[data]}', 'A value is off'),
    'remainder': lambda diagnosis: diagnosis.remainder,
    'share': explained_part,
    'these_postures': detail('postures', 'these {} postures', 'these postures'),
    'what_remains': what_remains,
    'why_off': why_off,
}


def alike(diagnosis: Diagnosis) -> str:
    """Describe effects indistinguishable from the named ones, and the next best one."""
    if not diagnosis.effects:
        return ''
    own, names = [effect.name for effect in diagnosis.effects], diagnosis.cannot_tell_apart
    rest = [name for name in names if name not in own]
    one_of = f'{listed([name for name in own if name in names])} ' if len(own) > 1 and rest else ''
    parts = []
    best = diagnosis.details.get('next_best')
    if best is not None and diagnosis.verdict is not Verdict.SEVERAL:
        log10 = best['log10_likelihood_ratio']
        ratio = 'more than 10^100' if log10 > 100.0 else f'10^{round(log10)}'
        ratio = ratio if log10 >= 3.0 else digits(10.0**log10, 2)
        parts.append(f'next best, {best["name"]}, is {ratio} times less likely')
    if wider := diagnosis.details.get('wider') or []:
        does = 'does' if len(wider) == 1 else 'do'
        parts.append(f'{listed(wider)} {does} the same with more parameters')
    if diagnosis.verdict is Verdict.AMBIGUOUS:
        return '; '.join(parts)
    tail = f' ({"; ".join(parts)})' if parts else ''
    return f'{one_of}cannot be told apart from: {", ".join(rest) or "nothing"}{tail}'


def untested(diagnosis: Diagnosis) -> str:
    """List the effects that these postures do not determine, and why."""
    if not diagnosis.not_tested:
        return ''
    why = diagnosis.details.get('not_tested_because', {})
    groups: dict[str, list[str]] = {}
    for name in diagnosis.not_tested:
        groups.setdefault(why.get(name, ''), []).append(name)
    parts = [
        f'{", ".join(names)} ({reason})' if reason else ', '.join(names)
        for reason, names in groups.items()
    ]
    return f'not tested by these postures: {"; ".join(parts)}'


def detectable(diagnosis: Diagnosis) -> str:
    """Describe the smallest detectable size of every effect."""
    sizes = diagnosis.details.get('detectable')
    if not sizes:
        return ''
    parts = [
        f'{name} {sentences.described_quantity(one["parameter"], one["unit"], [one["size"]], 2)}'
        for name, one in sizes.items()
    ]
    return 'smallest size that would have been seen (four times in five): ' + ', '.join(parts)


def next_measurement(diagnosis: Diagnosis) -> str:
    """Say what to measure next, and what that will show."""
    step = diagnosis.next_measurement
    if step is None:
        return ''
    names = diagnosis.cannot_tell_apart
    if step.difference < SEPARABLE_FROM_SD * step.noise / np.sqrt(TRIALS_ADVISED):
        small = mm(step.difference, 2) if step.difference >= 1e-5 else 'less than 0.01 mm'
        return (
            f'No posture within the limits separates {listed(names)}: they differ by '
            f'{small} at most, your noise is {mm(step.noise, 2)}. '
            'Either describes this robot; measure the quantity itself to know which it is.'
        )
    kind = diagnosis.details.get('input', 'tension')
    where = commands(dict(step.input), kind)
    if step.gravity is not None:
        down = ', '.join(digits(g, 3) for g in step.gravity)
        where += f', with the base turned so that gravity is [{down}] m/s²'
    if step.after is not None:
        where += f', coming from {commands(dict(step.after), kind)}'
    return f'Measure this next: {where}, {TRIALS_ADVISED} trials. {predicted_apart(step)}'


def predicted_apart(step: NextMeasurement) -> str:
    """Say which prediction stands apart from the others, and by how much."""
    names, tips = list(step.predictions), np.array(list(step.predictions.values()))
    end = f'your noise there is {mm(step.noise, 2)}.'
    if len(names) < 2:
        return f'The predictions differ by {mm(step.difference, 2)} at the tip; {end}'
    apart = np.linalg.norm(tips[:, None] - tips[None, :], axis=2)
    nearest = np.where(np.eye(len(names), dtype=bool), np.inf, apart).min(axis=1)
    odd = int(np.argmax(nearest))
    if len(names) == 2:
        return f'{listed(names)} predict tips {mm(step.difference, 2)} apart; {end}'
    if nearest[odd] < step.noise:
        return f'The predictions differ by up to {mm(step.difference, 2)} at the tip; {end}'
    return (
        f'{names[odd]} predicts the tip at least {mm(float(nearest[odd]), 2)} from the '
        f'others; {end}'
    )


def trust_lines(diagnosis: Diagnosis) -> list[str]:
    """Describe the false alarm rate and power by the bootstrap; empty without one."""
    if 'trust' not in diagnosis.details:
        return []
    trust = diagnosis.details['trust']
    if trust is None:
        return [
            'How often this procedure raises a false alarm could not be simulated: the '
            'description has no equilibrium in some posture, or nothing tells the noise.'
        ]
    if not trust['runs']:
        return [
            'How often this procedure raises a false alarm is not known: no simulation of your '
            'postures ended in the time that it has. Try it on a machine that does nothing else.'
        ]
    low, high = 100.0 * trust['alarm_rate_low'], 100.0 * trust['alarm_rate_high']
    rate = digits(100.0 * trust['alarm_rate'])
    texts = [
        f'With nothing missing, this procedure raises an alarm in {rate} % of cases '
        f'({trust["runs"]} simulated on your postures; 95 %: {digits(low)} to {digits(high)} %).'
    ]
    sizes = []
    for name, own in trust['detectable'].items():
        shown = [
            f'{key} too small to see'
            if one['size'] is None
            else sentences.described_quantity(key, one['unit'], [one['size']], 2)
            for key, one in own.items()
        ]
        sizes.append(f'{name} {", ".join(shown)}')
    texts.append('Smallest sizes that raise it four times in five: ' + '; '.join(sizes) + '.')
    if trust['checked']:
        robots = f'Of {trust["checked"]} simulated robots with an effect of such a size'
        rate = f'{100.0 * trust["detected"] / trust["checked"]:.0f}'
        texts.append(f'{robots}, {rate} % raised it.')
    if diagnosis.verdict is Verdict.OUTSIDE_CATALOGUE:
        texts.append(
            'All of this is about effects of the catalogue; of a cause outside it it says nothing.'
        )
    return texts


def addition_lines(addition: Addition) -> list[str]:
    """Return values, errors, tolerances and warnings."""
    values = sentences.of_effects(addition.values, addition.loads)
    return [*values, error_table(addition), *addition_warnings(addition)]


def error_table(addition: Addition) -> str:
    """Return the table of errors before, after, and of a perfect model."""
    alone = ['effects alone'] if addition.beside else []
    table = [['error (rms)', 'before', *alone, 'after', 'noise floor', 'gone']]
    for errors in (addition.fitted, addition.check):
        count = counted(errors.postures, 'posture')
        numbers = [mm(errors.before), mm(errors.after), mm(errors.floor)]
        if addition.beside:  # the effects alone; without the arm as found there may be no shape
            known = errors.alone is not None and math.isfinite(errors.alone)
            numbers.insert(1, mm(errors.alone) if known else 'no equilibrium')
        removed = '' if errors.gone is None else percent(errors.gone)
        table.append([f'{errors.kind}: {count} of {errors.data}', *numbers, removed])
    return columns(table)


def never_used(addition: Addition) -> str:
    """Describe the change of the error on postures that were not fitted, in one line."""
    check = addition.check
    floor = '' if check.floor is None else f'  (floor {mm(check.floor)})'
    which = 'never used' if check.kind == 'check' else 'left out in turn'
    return f'error on postures {which}: {mm(check.before)} -> {mm(check.after)}{floor}'


def also_written(addition: Addition) -> list[str]:
    """Name what the new file changes in addition to the effects that were added."""
    robot, before = addition.robot, addition.described
    if before is None:
        return []
    places = ([np.hypot(*tendon.base) for tendon in one.tendons] for one in (before, robot))
    return [
        *_changed('stiffness', 'cell', stiffnesses(before), stiffnesses(robot)),
        *_changed('offset', 'tendon', *places),
        *(
            name
            for name, values in robot.effects.items()
            if name not in addition.values and values != before.effects.get(name)
        ),
        *(['gravity'] if robot.gravity != before.gravity else []),
    ]


def _changed(what: str, part: str, before: Iterable[float], after: Iterable[float]) -> list[str]:
    """Say of how many parts something changed, and between which changes; nothing of none."""
    pairs = zip(before, after, strict=True)
    changes = [100.0 * float(new / old - 1.0) for old, new in pairs if new != old and old]
    if not changes:
        return []
    low, high = (f'{change:+.2g}' for change in (min(changes), max(changes)))
    size = f'{low} %' if low == high else f'{low} to {high} %'
    return [f'{what} of {counted(len(changes), part)} ({size})']


def more_lines(more_at_work: str, error: float | None) -> list[str]:
    """Say that more is at work, and that a description is written with its own error [m]."""
    texts = [f'note: {more_at_work}'] if more_at_work else []
    if error:
        texts.append(
            f'off by {mm(error, 2)} at the tip on postures left out: the file says so, as '
            'model_error, and later diagnoses count with it'
        )
    return texts


def addition_warnings(addition: Addition) -> list[str]:
    """Say what else is written and at work, which tolerances moved, when a check got worse."""
    texts = sentences.anew_lines(addition.anew)
    if addition.beside:
        also = also_written(addition)
        texts.append(
            'after: with the effects and the arm as it was found beside them; '
            f'the file holds that, too: {listed(also)}'
        )
    if addition.moved:
        moves = ', '.join(f'{name} by {digits(z)} sd' for name, z in addition.moved.items())
        where = 'in the file, too' if addition.beside else 'not in the file'
        texts.append(f'declared tolerances moved in the fit: {moves} ({where})')
    if addition.accuracy:
        texts.append(f'weighed by the declared accuracy of {mm(addition.accuracy, 2)}')
    texts += more_lines(addition.more_at_work, addition.model_error)
    if addition.check.after > addition.check.before:
        texts.append(
            'note: the error on postures that were not fitted grew; do not use these values'
        )
    return texts
