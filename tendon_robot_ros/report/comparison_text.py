"""A comparison as sentences and as a table."""

from __future__ import annotations

import numpy as np

from ..common.words import PROGRAM, columns, commands, digits, mm, postures, probability, times
from ..comparison.result import Comparison, ModelErrors
from ..comparison.statistics import Estimate, PairedT
from ..data.dataset import at_rest
from .sentences import excluded_lines

# [1] noise floors: as good as the measurements can tell, because the rms over 12 postures in three
# coordinates scatters by 12 % (1 sd) by chance
GOOD_WITHIN_FLOORS = 1.3
# [1] of the motion of the markers: with a noise floor above this a model would pass that is off by
# a tenth of the motion; measurements of an arm with a tracker have a hundredth
FLOOR_FRACTION_MAX = 0.1


def table(comparison: Comparison) -> str:
    """Return the table of all models."""
    head = [size(comparison), *error_columns(comparison)]
    rows = [[label(model), *errors(comparison, model)] for model in comparison.models]
    if comparison.noise_floor is not None:
        rows.append(['noise floor (a perfect model)', mm(comparison.noise_floor), '', ''])
    return columns([head, *rows])


def error_columns(comparison: Comparison) -> list[str]:
    """Name the errors that a table of models shows."""
    return ['rms', 'worst', f'tip error ({error_name(comparison)})']


def errors(comparison: Comparison, model: ModelErrors) -> list[str]:
    """Return the errors of a model, as `error_columns` names them."""
    return [mm(model.rms), mm(model.max), interval(model.tip_error(comparison.error))]


def sentences(comparison: Comparison) -> list[str]:
    """Return the conclusions: the largest errors, the better model, and the next step."""
    lines = [*excluded_lines({'outliers': comparison.measured.left_out}), where_worst(comparison)]
    lines += [paired(test) for test in comparison.paired_t if test.posture is None]
    last = f'{verdict(comparison)} {next_step(comparison)}'
    return [*lines, last.strip().replace('`', '')]


def size(comparison: Comparison) -> str:
    """Describe the number of postures, trials and markers."""
    measured = comparison.measured
    minimum, maximum = int(measured.trials[measured.trials > 0].min()), int(measured.trials.max())
    trials = f'{maximum}' if minimum == maximum else f'{minimum} to {maximum}'
    measured_postures = measured.trials > 0
    parts = (trials, 'trial'), (len(measured.markers), 'marker')
    counts = [f'{n} {name}{"" if str(n) == "1" else "s"}' for n, name in parts]
    resting = int(at_rest(measured.inputs)[measured_postures].sum())
    return ' x '.join([postures(int(measured_postures.sum()), resting), *counts])


def error_name(comparison: Comparison) -> str:
    """Name what stands behind a ±."""
    return 'mean ± 95 %' if comparison.error == 'ci' else 'mean ± standard error'


def label(model: ModelErrors) -> str:
    """Name a model and what it is."""
    what = kind(model.effects)
    return what if model.name == what else f'{model.name} ({what})'


def kind(effects: tuple[str, ...]) -> str:
    """Say which model a list of effects makes, in the words of the paper."""
    if not effects:
        return 'PCCA'
    more = [name for name in effects if name != 'tendon_friction']
    base = 'PCCA' if len(more) == len(effects) else 'FKM'
    if not more:
        return base
    return f'{base} + {more[0] if len(more) == 1 else f"{len(more)} effects"}'


def interval(value: Estimate) -> str:
    """Show a mean and its interval in mm."""
    if not np.isfinite(value.half):
        return mm(value.mean)
    half = digits(1e3 * value.half, 2)
    places = len(half.partition('.')[2])
    return f'{1e3 * value.mean:.{places}f} ± {half} mm'


def marker_name(comparison: Comparison, marker: int) -> str:
    """Name a marker: the cell whose end it is, or its name."""
    what = 'cell' if comparison.measured.per_cell else 'marker'
    return f'{what} {comparison.measured.markers[marker]}'


def posture_name(comparison: Comparison, posture: int) -> str:
    """Name a posture and what was commanded."""
    measured = comparison.measured
    inputs = dict(zip(measured.input_names, measured.inputs[posture].tolist(), strict=True))
    return f'posture {measured.postures[posture]} ({commands(inputs, measured.input)})'


def where_worst(comparison: Comparison) -> str:
    """Describe where the best model has its largest error, and its name if there are several."""
    best = comparison.best
    of = '' if len(comparison.models) == 1 else f' of {best.name}'
    return f'worst{of}: {worst(comparison, best)}'


def worst(comparison: Comparison, model: ModelErrors) -> str:
    """Describe where a model has its largest error, and where the error exceeds the noise."""
    posture = comparison.worst_posture(model)
    rms = mm(model.per_posture_rms[posture])
    text = f'{posture_name(comparison, posture)}, rms {rms}'
    marker = comparison.grows_from(model)
    if marker is None:
        return f'{text}.'
    if marker == 0:
        first, last = (mm(float(model.per_marker_rms[j])) for j in (0, -1))
        return f'{text}; the first marker is off by {first} rms, the last by {last}.'
    return f'{text}; the error grows from {marker_name(comparison, marker)} on.'


def verdict(comparison: Comparison) -> str:
    """Compare the best model with the repeatability."""
    best, floor = comparison.best, comparison.noise_floor
    who = 'The model'
    if len(comparison.models) > 1:  # said by what it is the best, if tip errors do not tell them
        tests = [one for one in comparison.paired_t if one.posture is None]
        alike = any(one.low <= 0.0 <= one.high and best.name in one.models for one in tests)
        who = f'The best model{" by rms" if alike else ""}, {best.name},'
    if floor is None:
        return (
            'Nothing tells how well you can measure: record every posture at least three times, '
            'or write position_noise into dataset.yaml.'
        )
    if _drowned(comparison):
        moved = comparison.measured.motion
        return (
            f'Nothing can be judged: the noise floor is {digits(100.0 * floor / moved, 2)} % of '
            f'what the markers move from posture to posture ({mm(moved)} rms), and a model that '
            'is off by as much would pass. See which trials of a posture differ, and measure '
            'again.'
        )
    ratio = best.rms / floor
    if ratio < GOOD_WITHIN_FLOORS:
        return (
            f'{who} is as good as your measurements can tell: its error is {digits(ratio, 2)} '
            'times your repeatability.'
        )
    return f'{who} is off by {times(ratio)} your repeatability.'


def _drowned(comparison: Comparison) -> bool:
    """Return whether the noise floor is a large fraction of the motion."""
    measured, floor = comparison.measured, comparison.noise_floor
    several = int((measured.trials > 0).sum()) > 1
    return several and floor is not None and floor > FLOOR_FRACTION_MAX * measured.motion


def next_step(comparison: Comparison) -> str:
    """Say what to type next; empty when nothing is to be explained."""
    floor = comparison.noise_floor
    if _drowned(comparison):
        return ''
    if floor is not None and comparison.best.rms < GOOD_WITHIN_FLOORS * floor:
        return ''
    return f'Ask why: `{PROGRAM} diagnose {comparison.measured.data}`'


def paired(test: PairedT) -> str:
    """Describe which of two models has the smaller tip error, and the p-value."""
    better, other = test.models if test.difference < 0.0 else test.models[::-1]
    low, high = sorted((abs(test.low), abs(test.high)))
    over = 'postures' if test.posture is None else f'trials of posture {test.posture}'
    significance = probability(test.p)
    pairs = f'paired t over {test.n} {over}, {significance}'
    if test.low <= 0.0 <= test.high:
        return f'tip error: {better} and {other} do not differ ({pairs})'
    return (
        f'tip error: {better} {mm(abs(test.difference))} less than {other} (95 %: '
        f'{digits(1e3 * low, 3)} to {mm(high)}, {pairs})'
    )
