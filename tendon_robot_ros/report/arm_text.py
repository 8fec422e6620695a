"""
What a diagnosis says of the arm as it is built, of readings left out, of where it is wrong.

The last also as marks on the pictures of the arm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..common.words import digits, listed, mm
from ..diagnosis.verdict import FALSE_DISCOVERY_RATE

KIND_NAMES = {
    'cell_stiffness': 'stiffness of the cells',
    'cell_kink': 'kinks at rest',
    'cell_kink_across': 'kinks across the plane',
    'channel_gain': 'gains of the inputs',
    'hole_radius': 'holes',
    'pull_zero': 'zeros of the pulls',
    'position': 'position of the tracker',
    'rotation': 'rotation of the tracker',
}
READINGS_LISTED_MAX = 6  # readings that are listed one by one


def amount(value: float, unit: str, sign: bool = False) -> str:
    """Return a size with its unit as a person reads it."""
    if unit == 'm':
        return mm(value, 2)
    scale, mark = (100.0, ' %') if unit == '1' else (float(np.degrees(1.0)), '°')
    return f'{"+" if sign and value > 0.0 else ""}{digits(scale * value, 2)}{mark}'


def as_built(report: Mapping[str, Any] | None) -> list[str]:
    """Say how much the arm scatters, with 95 % intervals, and what is out of line."""
    if not report:
        return []
    told = []
    for kind in report['kinds']:
        name, size, low, high = (kind[key] for key in ('kind', 'size', 'low', 'high'))
        if not kind['told']:
            continue
        said = [None if end is None else amount(end, kind['unit']) for end in (size, low, high)]
        if low <= 0.0:  # where one end is open, the other one alone
            told.append(f'{KIND_NAMES[name]} below {said[2]}')
        elif high is None:
            told.append(f'{KIND_NAMES[name]} above {said[1]}')
        else:
            told.append(f'{KIND_NAMES[name]} {said[0]} ({said[1]} to {said[2]})')
    lines = [f'the arm as built scatters by (1 sd, 95 %): {", ".join(told)}'] if told else []
    strange = [
        f'{name} ({amount(kind["members"][name]["value"], kind["unit"], True)})'
        for kind in report['kinds']
        for name in kind['out_of_line']
        if kind['kind'] not in ('position', 'rotation')
    ]
    if strange:
        lines.append(f'out of line with the others: {listed(strange)}')
    hidden = [KIND_NAMES[kind['kind']] for kind in report['kinds'] if not kind['told']]
    if hidden:
        lines.append(f'these measurements do not tell: {", ".join(hidden)}')
    return lines


def left_out(details: Mapping[str, Any], how: str = 'left out') -> list[str]:
    """Name the readings and trials that the others contradict, and postures that do not settle."""
    unsettled = details.get('unsettled') or []
    outliers = details.get('outliers') or []
    trials = [f'trial {o["trial"]} of posture {o["posture"]}' for o in outliers if not o['marker']]
    readings = [o for o in outliers if o['marker']]
    sentences = []
    if unsettled:
        named = [f'posture {name}' for name in unsettled]
        sentences.append(f'{how}, because the description has no equilibrium: {listed(named)}')
    if trials:
        sentences.append(f'{how}, because the other trials contradict it: {listed(trials)}')
    if 0 < len(readings) <= READINGS_LISTED_MAX:
        named = [
            f'marker {o["marker"]} in trial {o["trial"]} of posture {o["posture"]} '
            f'({mm(o["distance"])})'
            for o in readings
        ]
        sentences.append(f'{how}, because the other trials contradict it: {listed(named)}')
    elif readings:
        far = max(o['distance'] for o in readings)
        sentences.append(
            f'{how}: {len(readings)} readings of single markers that the other trials '
            f'contradict (by up to {mm(far)})'
        )
    return sentences


Fault = Mapping[str, Any]  # of `local_faults` in the details of a diagnosis


def where_wrong(faults: Sequence[Fault]) -> list[str]:
    """Say where the model is still wrong; nothing where it is nowhere."""
    if not faults:
        return []
    rate = f'{100.0 * FALSE_DISCOVERY_RATE:.0f} %'
    told = []
    for fault in faults:
        posture = fault['posture']
        where = 'in all postures' if posture is None else f'in posture {posture}'
        told.append(f'{where} {sentence(fault)}')
    return [
        f'where it is still wrong (of such places at most {rate} are false alarms): '
        + '; '.join(told)
    ]


def sentence(fault: Fault) -> str:
    """Say what is wrong at a place."""
    name, kind = _cells(fault), fault['kind']
    if kind == 'cell_stiffness':  # what is softer bends more
        return f'{name} bends {_range(fault, -1.0)} than described'
    if kind.startswith('cell_kink'):
        cell, _, towards = name.partition(' towards ')
        bends = _range(fault, 1.0)
        kinked = 'bends' if fault['posture'] is not None else 'is kinked at rest: it bends'
        return f'{cell} {kinked} {bends} towards {towards}'
    if kind == 'channel_gain':
        return f'input {name} pulls {_range(fault, 1.0)} than it says'
    if kind == 'hole_radius':
        return f'tendon {name} lies {_range(fault, 1.0)} off the axis than described'
    return f'input {name} has wound {_range(fault, 1.0)} than it says'


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
    unit = fault['unit']
    ends = sorted(sign * fault[key] for key in ('size', 'low', 'high'))
    size = sign * fault['size']
    if size < 0.0:
        ends = sorted(-end for end in ends)
    low, high = (amount(end, unit) for end in (ends[0], ends[-1]))
    return f'{amount(abs(size), unit)} ({low} to {high}) {"more" if size > 0.0 else "less"}'


def _cells(fault: Fault) -> str:
    """Name a place, or the cells among which it cannot be told."""
    alike = [name.partition(' towards ') for name in fault['alike']]
    if len(alike) < 2 or fault['along'] is None:
        return str(fault['place'])
    numbers = sorted({int(name.split()[1]) for name, _, _ in alike})
    tail = ''.join(str(fault['place']).partition(' towards ')[1:])
    if numbers == list(range(numbers[0], numbers[-1] + 1)) and len(numbers) > 2:
        return f'one of the cells {numbers[0]} to {numbers[-1]}{tail}'
    return f'cell {listed(map(str, numbers), "or")}{tail}'
