"""Numbers as people read them: millimetres, degrees, "six times", lists of names."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

TIMES_WORDS = ('no', 'one', 'two', 'three', 'four', 'five', 'six', 'seven', 'eight', 'nine', 'ten',
         'eleven', 'twelve')  # fmt: skip
UNIT_PREFIXES = ((1e6, 'M'), (1e3, 'k'), (1.0, ''), (1e-3, 'm'), (1e-6, 'µ'), (1e-9, 'n'))
PROGRAM = 'python -m tendon_robot_ros'


def scale_of(unit: str, size: float, name: str = '') -> tuple[float, str]:
    """Return the factor and the unit in which a person reads values of a size."""
    if unit.startswith('rad'):
        return 180.0 / math.pi, '°' + unit.removeprefix('rad')
    if unit == '1' and name.startswith('relative_change'):
        return 100.0, '%'
    if unit == 'kg/m' and size < 0.1:
        return 1e3, 'g/m'
    if unit in ('1', 'kg/m') or unit.startswith('1/'):
        return 1.0, '' if unit == '1' else unit
    scale, prefix = next(((s, p) for s, p in UNIT_PREFIXES if size >= 0.1 * s), (1.0, ''))
    return 1.0 / scale, prefix + unit


def percent(share: float) -> str:
    """Show a share; what is not all of it is never 100 %."""
    return f'{int(100.0 * share) if share < 1.0 else 100} %'


def digits(value: float, count: int = 2) -> str:
    """Show a number with so many significant digits, without an exponent where it is short."""
    if value == 0.0 or not math.isfinite(value):
        return '0' if value == 0.0 else 'infinite' if math.isinf(value) else 'unknown'
    places = count - 1 - math.floor(math.log10(abs(value)))
    if not -3 < places < 8:
        return f'{value:.{count}g}'
    return f'{round(value, places):.{max(places, 0)}f}'


def mm(metres: float | None, count: int = 3) -> str:
    """Show a length in mm; a dash for none."""
    return '–' if metres is None or math.isnan(metres) else f'{digits(1e3 * metres, count)} mm'


def with_unit(text: str, unit: str) -> str:
    """Put a unit behind a number; pure numbers have none."""
    if unit in ('', '1'):
        return text
    return f'{text}{unit}' if unit.startswith('°') else f'{text} {unit}'


def spoken(key: str) -> str:
    """Say a parameter of a section or tendon: 'relative_change of distal'."""
    name, _, owner = key.partition('[')
    return f'{name} of {owner.removesuffix("]")}' if owner else name


def times(ratio: float) -> str:
    """Show a ratio: 'six times', '2.4 times'."""
    if ratio >= 2.75 and round(ratio) < len(TIMES_WORDS):
        return f'{TIMES_WORDS[round(ratio)]} times'
    return f'{digits(ratio, 2)} times'


def probability(p: float) -> str:
    """Show a p-value."""
    return (
        'p < 1e-300'
        if p == 0.0
        else f'p = {digits(p, 2)}'
        if p >= 1e-4
        else f'p = {p:.0e}'.replace('e-0', 'e-')
    )


def commands(inputs: Mapping[str, float | None], kind: str = 'tension') -> str:
    """Say what is commanded: 'left 1.10 N, right 0.80 N'; slack wires are left out."""
    scale, unit = (1.0, 'N') if kind == 'tension' else (1e3, 'mm')
    parts = [
        f'{name} {digits(scale * value, 3)} {unit}'
        for name, value in inputs.items()
        if value is not None and math.isfinite(value) and value != 0.0
    ]
    return ', '.join(parts) or 'nothing pulled'


def postures(count: int, resting: int = 0) -> str:
    """Say how many postures there are, and how many of them are the arm at rest."""
    rest = f' ({"one" if resting == 1 else resting} at rest)' if resting else ''
    return f'{count} posture{"" if count == 1 else "s"}{rest}'


def listing(names: Iterable[str]) -> str:
    """List names in a message; a long list is cut in the middle."""
    known = list(names)
    return ', '.join(known if len(known) <= 12 else [*known[:6], '...', *known[-3:]]) or 'none'


def listed(names: Iterable[str], last: str = 'and') -> str:
    """Join names: 'a, b and c'."""
    *first, end = list(names) or ['nothing']
    return f'{", ".join(first)} {last} {end}' if first else end


def capital(sentence: str) -> str:
    """Begin with a capital letter and leave the rest, units included, alone."""
    return sentence[:1].upper() + sentence[1:]


def columns(rows: Sequence[Sequence[str]]) -> str:
    """Align rows of text in columns, the first to the left, all others to the right."""
    widths = [max(len(row[c]) for row in rows if c < len(row)) for c in range(len(rows[0]))]
    return '\n'.join(
        '  '.join(
            cell.ljust(width) if c == 0 else cell.rjust(width)
            for c, (cell, width) in enumerate(zip(row, widths, strict=False))
        ).rstrip()
        for row in rows
    )
