"""Where the best model is still wrong, in words and as marks on the pictures of the arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..common.words import listed
from ..diagnosis.decide import FALSE_DISCOVERY_RATE
from .arm_text import amount

Fault = Mapping[str, Any]  # of `local_faults` in the details of a diagnosis


def where_wrong(faults: Sequence[Fault]) -> list[str]:
    """Say where the model is still wrong; nothing where it is nowhere."""
    if not faults:
        return []
    return [
        'where it is still wrong (of such places at most '
        f'{100.0 * FALSE_DISCOVERY_RATE:.0f} % are false alarms): '
        + '; '.join(f'{_where(fault)}{sentence(fault)}' for fault in faults)
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


def _where(fault: Fault) -> str:
    return 'in all postures ' if fault['posture'] is None else f'in posture {fault["posture"]} '


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
