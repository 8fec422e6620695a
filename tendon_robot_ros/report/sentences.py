"""
Sentences of several reports: values with intervals, an arm as built, excluded readings, faults.

Faults are the places where a model is still wrong; they are also marked in pictures of the arm.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from string import Formatter
from typing import Any

import numpy as np

from ..common.words import commands, digits, listed, mm, scale_of, spoken, with_unit
from ..common.words import described_quantity as described_quantity
from ..comparison.result import Comparison
from ..diagnosis.verdict import FALSE_DISCOVERY_RATE
from ..inference.imperfections import PLAUSIBLE_SIZES
from ..inference.intervals import LoadVector, Value, Values
from ..robot.estimates import BY_EYE_RAD
from .page import Shown

# [1] zeros behind the point that are shown of nothing: more would claim to be known
ZEROS_MAX = 3
# [1] places behind the point; with more, a row of zeros would have to be counted
DECIMALS_MAX = 7
# [1] of half an interval by which its ends may differ to be written as ±, so that one digit of it
# is right
SYMMETRY_TOLERANCE = 0.2
KIND_NAMES = {
    'cell_stiffness': 'stiffness of the cells',
    'cell_kink': 'kinks at rest',
    'cell_kink_across': 'kinks across the plane',
    'channel_gain': 'gains of the inputs',
    'hole_radius': 'holes',
    'pull_zero': 'zeros of the pulls',
    'position': 'position of the tracker',
    'rotation': 'rotation of the tracker',
    'pull_zero_anew': 'zeros of the pulls in each recording',
    'position_anew': 'position of the tracker in each recording',
    'rotation_anew': 'rotation of the tracker in each recording',
}


def quantity(name: str, value: Value, size: float = 0.0) -> str:
    """
    Say 'lever = 0.158 ± 0.007 mm', or the ends of an interval that is not symmetric.

    `size` [unit of the value] chooses the prefix together with the value.
    """
    return f'{spoken(name)} = {_with_interval(name, value, size)}'


def _with_interval(name: str, value: Value, size: float = 0.0) -> str:
    number, down, up = value.value, value.value - value.low, value.high - value.value
    half = 0.5 * (down + up)
    factor, unit = scale_of(value.unit, max(abs(number), half, size), name)
    note = f' ({value.note})' if value.note else ''
    if not math.isfinite(half) or half <= 0.0:
        return f'{with_unit(digits(factor * number, 3), unit)}{note}'
    places = decimals(factor * half)
    shown = rounded(factor * number, places)
    if abs(up - down) <= SYMMETRY_TOLERANCE * half:
        return f'{with_unit(f"{shown} ± {rounded(factor * half, places)}", unit)}{note}'
    ends = f'{rounded(factor * value.low, places)} to {rounded(factor * value.high, places)}'
    extra = f', {value.note}' if value.note else ''
    return f'{with_unit(shown, unit)} (95 %: {ends}{extra})'


def quantities(values: Mapping[str, Value], load: LoadVector | None = None) -> str:
    """Format the parameters of an effect; of a force also its size and direction."""
    texts = [quantity(name, v, _largest(values, v.unit)) for name, v in values.items()]
    return ', '.join([*texts, *([] if load is None else [f'together {load_words(load)}'])])


def of_effects(values: Values, loads: Mapping[str, LoadVector], mark: str = '') -> list[str]:
    """Say the values of effects, a line each; `mark` stands around their names."""
    said = {name: quantities(own, loads.get(name)) for name, own in values.items()}
    return [f'{mark}{name}{mark}: {text}' for name, text in said.items()]


class _Found:
    """The values of a parameter in a sentence: '5.0 ± 0.3 % stiffer (distal)'."""

    def __init__(self, values: Mapping[str, Value], name: str) -> None:
        self.values = {key: one for key, one in values.items() if key.partition('[')[0] == name}
        self.size = _largest(values, next(iter(self.values.values())).unit)

    def __format__(self, words: str) -> str:
        """Say the values; of two words such as `more/less` the one that suits the sign."""
        more, _, less = words.partition('/')
        parts = []
        for key, value in self.values.items():
            word = less if less and value.value < 0.0 else more
            if word is less and less:
                value = replace(value, value=-value.value, low=-value.high, high=-value.low)
            owner = key.partition('[')[2].removesuffix(']')
            shown = _with_interval(key, value, self.size)
            parts.append(' '.join(filter(None, [shown, word, owner and f'({owner})'])))
        return listed(parts)


def finding_words(
    title: str,
    finding: str,
    values: Mapping[str, Value],
    load: LoadVector | None = None,
    pushes: Sequence[Mapping[str, Any]] = (),
) -> str:
    """
    Say what was found of an effect: in the words of `Effect.finding`, else by its title.

    `pushes` are those of the details of a diagnosis: where it pushes the arm.
    """
    names = dict.fromkeys(key.partition('[')[0] for key in values)
    found: dict[str, Any] = {name: _Found(values, name) for name in names}
    if load is not None:
        found |= {'size': _with_interval('', load.size), 'direction': load_direction(load)}
    fields = {field for _, field, _, _ in Formatter().parse(finding) if field}
    where = pushed(pushes)
    if finding and fields <= {*found, *where}:
        return finding.format(**found, **where)
    shown = [f'{name.replace("_", " ")} {value}' for name, value in found.items()]
    return ', '.join([title, *shown])


def pushed(pushes: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Say in which postures something pushes the arm, and between which places along it."""
    if not pushes:
        return {}
    names = [str(one['posture']) for one in pushes]
    low = 1e3 * min(one['arc_length'] - one['half'] for one in pushes)
    high = 1e3 * max(one['arc_length'] + one['half'] for one in pushes)
    half = max(0.5 * (high - low), 0.1)  # [mm] because no marker is placed more closely
    place = f'{rounded(0.5 * (low + high), decimals(half))} ± {rounded(half, decimals(half))} mm'
    word = 'posture' if len(names) == 1 else 'postures'
    return {'postures': f'{word} {listed(names)}', 'place': place}


def load_words(load: LoadVector) -> str:
    """Say '0.151 ± 0.004 N, along gravity, 86 ± 9° from the arm's axis'."""
    return f'{_with_interval("", load.size)}, {load_direction(load)}'


def load_direction(load: LoadVector) -> str:
    """Say 'along gravity, 86 ± 9° from the arm's axis'."""
    directions = []
    if (angle := load.from_gravity) is not None:
        if angle.low <= 0.0:
            directions.append('along gravity')
        elif angle.high >= math.pi:
            directions.append('against gravity')
        else:
            directions.append(f'{_with_interval("angle", angle)} from gravity')
    if (angle := load.from_axis) is not None:
        if angle.low <= 0.0 or angle.high >= math.pi:
            end = 'tip' if angle.low <= 0.0 else 'base'
            directions.append(f"along the arm's axis, towards its {end}")
        else:
            text = f"{_with_interval('', angle)} from the arm's axis"
            if load.from_gravity is None:  # the axis alone leaves the side open
                quarter = round(load.around_axis / (0.5 * math.pi))
                side = f'{round(math.degrees(load.around_axis)) % 360}° (x: 0°, y: 90°)'
                if abs(load.around_axis - quarter * 0.5 * math.pi) < BY_EYE_RAD:
                    side = ('x', 'y', '-x', '-y')[quarter % 4]
                text = f'{text} towards {side}'
            directions.append(text)
    return ', '.join(directions or ['its direction is not told'])


def _largest(values: Mapping[str, Value], unit: str) -> float:
    return max(abs(value.value) for value in values.values() if value.unit == unit)


def decimals(half: float) -> int:
    """Places behind the point that show a half width with one digit, two if it begins with 1."""
    exponent = math.floor(math.log10(half))
    leading = half / 10.0**exponent
    return max((1 if leading < 2.0 else 0) - exponent, 0)


def rounded(value: float, places: int) -> str:
    """Format a number with some decimals, never as -0 nor as zeros alone."""
    text = f'{value:.{places}f}' if places <= DECIMALS_MAX else digits(value, 3)
    if float(text) != 0.0:
        return text
    return f'{0.0:.{min(places, ZEROS_MAX)}f}' if places <= DECIMALS_MAX else '0'


def amount(value: float, unit: str, sign: bool = False) -> str:
    """Return a size with its unit as a person reads it."""
    if unit == 'm':
        return mm(value, 2)
    scale, mark = (100.0, ' %') if unit == '1' else (float(np.degrees(1.0)), '°')
    return f'{"+" if sign and value > 0.0 else ""}{digits(scale * value, 2)}{mark}'


def as_built(report: Mapping[str, Any] | None) -> list[str]:
    """Describe the scatter of the arm as built, with 95 % intervals, and its outliers."""
    if not report:
        return []
    sizes = []
    for kind in report['kinds']:
        name, size, low, high, unit = (kind[k] for k in ('kind', 'size', 'low', 'high', 'unit'))
        if not kind['told']:
            continue
        said, least, most = ('' if end is None else amount(end, unit) for end in (size, low, high))
        interval = f'{said} ({least} to {most})'
        if low <= 0.0 or high is None:  # where one end is open, the other one alone
            interval = f'below {most}' if low <= 0.0 else f'above {least}'
        sizes.append(f'{KIND_NAMES[name]} {interval}')
    lines = [f'the arm as built scatters by (1 sd, 95 %): {", ".join(sizes)}'] if sizes else []
    strange = [
        f'{name} ({amount(kind["members"][name]["value"], kind["unit"], True)})'
        for kind in report['kinds']
        for name in kind['out_of_line']
        if not kind['kind'].startswith(('position', 'rotation'))
    ]
    if strange:
        lines.append(f'out of line with the others: {listed(strange)}')
    if hidden := [KIND_NAMES[kind['kind']] for kind in report['kinds'] if not kind['told']]:
        lines.append(f'these measurements do not tell: {", ".join(hidden)}')
    return lines


def anew_lines(anew: Mapping[str, Any]) -> list[str]:
    """Say what was set anew in each of several recordings, by how much, and is no error."""
    sizes = [
        f'{KIND_NAMES[kind]} (up to {amount(float(np.abs(own).max()), PLAUSIBLE_SIZES[kind][0])})'
        for kind, own in anew.items()
    ]
    return [f'taken off the errors, as found: {", ".join(sizes)}'] if sizes else []


def excluded_lines(details: Mapping[str, Any]) -> list[str]:
    """Describe excluded readings and trials, and postures without an equilibrium."""
    unsettled = [f'posture {name}' for name in details.get('unsettled') or []]
    trials, readings = [], {}  # a reading of a marker: what it is, and how far it is off [m]
    for one in details.get('outliers') or []:
        where = f'trial {one["trial"]} of posture {one["posture"]}'
        if one['marker']:
            readings[f'marker {one["marker"]} in {where}'] = one['distance']
        else:
            trials.append(where)
    named = [f'{what} ({mm(distance)})' for what, distance in readings.items()]
    few = len(named) <= Shown.READINGS
    lacking = 'left out, because the description has no equilibrium'
    contradicted = 'left out, because the other trials contradict it'
    sentences = []
    if details.get('thinned'):
        used, every = details['thinned']
        sentences.append(
            f'{used:,} of {every:,} postures were used, evenly spread, because neighbours are '
            'alike; the error is of all'
        )
    groups = (lacking, unsettled), (contradicted, trials), (contradicted, named if few else [])
    sentences += [f'{why}: {listed(names)}' for why, names in groups if names]
    if not few:
        sentences.append(
            f'left out: {len(readings)} readings of single markers that the other trials '
            f'contradict (by up to {mm(max(readings.values()))})'
        )
    return sentences


Fault = Mapping[str, Any]  # of `local_faults` in the details of a diagnosis


def where_wrong(faults: Sequence[Fault]) -> list[str]:
    """Describe where the model is still wrong; empty if there is no such place."""
    if not faults:
        return []
    rate = f'{100.0 * FALSE_DISCOVERY_RATE:.0f} %'
    places = []
    for fault in faults:
        posture = fault['posture']
        where = 'in all postures' if posture is None else f'in posture {posture}'
        places.append(f'{where} {sentence(fault)}')
    begins = f'where it is still wrong (of such places at most {rate} are false alarms)'
    return [f'{begins}: {"; ".join(places)}']


def sentence(fault: Fault) -> str:
    """Say what is wrong at a place."""
    name, kind = place_of(fault), fault['kind']
    if kind == 'cell_stiffness':  # what is softer bends more
        return f'{name} bends {_range(fault, -1.0)} than described'
    if kind.startswith('cell_kink'):
        cell, _, towards = name.partition(' towards ')
        bends = _range(fault, 1.0)
        kinked = 'bends' if fault['posture'] is not None else 'is kinked at rest: it bends'
        return f'{cell} {kinked} {bends} towards {towards}'
    size = _range(fault, 1.0)
    if kind == 'hole_radius':
        return f'tendon {name} lies {size} off the axis than described'
    return f'input {name} {"pulls" if kind == "channel_gain" else "has wound"} {size} than it says'


def marks(faults: Sequence[Fault], posture: str) -> list[tuple[float, str]]:
    """Return where to mark the arm in a posture: distance from the base [m], and what is wrong."""
    return [
        (0.5 * sum(fault['along']), sentence(fault))
        for fault in faults
        if fault['along'] is not None and fault['posture'] in (None, posture)
    ]


def of_inputs(faults: Sequence[Fault], posture: str) -> list[str]:
    """Say what is wrong with the inputs in one posture: no place of the arm shows it."""
    own = [f for f in faults if f['along'] is None and f['posture'] == posture]
    return [sentence(fault) for fault in own]


def _range(fault: Fault, sign: float) -> str:
    """Say a size with its interval: '1.2° (0.8 to 1.6) more'."""
    more = sign * fault['size'] > 0.0
    low, size, high = sorted((sign if more else -sign) * fault[k] for k in ('low', 'size', 'high'))
    size, low, high = (amount(one, fault['unit']) for one in (size, low, high))
    return f'{size} ({low} to {high}) {"more" if more else "less"}'


def place_of(fault: Fault) -> str:
    """Name a place, or the cells among which it cannot be located."""
    alike = [name.partition(' towards ') for name in fault['alike']]
    if len(alike) < 2 or fault['along'] is None:
        return str(fault['place'])
    numbers = sorted({int(name.split()[1]) for name, _, _ in alike})
    tail = ''.join(str(fault['place']).partition(' towards ')[1:])
    names = list[str]()
    for run in np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1):
        names += [f'{run[0]} to {run[-1]}'] if len(run) > 2 else map(str, run)
    among = 'one of the cells' if len(names) < len(numbers) else 'cell'
    return f'{among} {listed(names, "or")}{tail}'


def posture_name(comparison: Comparison, posture: int) -> str:
    """Name a posture and what was commanded."""
    measured = comparison.measured
    inputs = dict(zip(measured.input_names, measured.inputs[posture].tolist(), strict=True))
    return f'posture {measured.postures[posture]} ({commands(inputs, measured.input)})'


def interval_name(comparison: Comparison) -> str:
    """Name what stands behind a ±."""
    return '95 %' if comparison.error == 'ci' else 'standard error'
