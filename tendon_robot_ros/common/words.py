"""Numbers, units and names as people write and read them, to SI units and back."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from .errors import InputError

TIMES_WORDS = ('three', 'four', 'five', 'six', 'seven', 'eight', 'nine', 'ten', 'eleven', 'twelve')
# [1] prefixes of SI (brochure of 2019) in which a person reads lengths and forces
UNIT_PREFIXES = {'M': 1e6, 'k': 1e3, '': 1.0, 'm': 1e-3, 'µ': 1e-6, 'n': 1e-9}
COMPILING = 'compiling the model, once; half a minute'
PROGRAM = 'python -m tendon_robot_ros'
FAR_M = 100.0  # [m] a larger number is a slip of the pen, because no arm reaches so far
# [1] names in a line, or rows of a table for a person, because a message may hold a million
LISTED_MAX = 12
# [1] characters of a name in a sentence, or in that of a socket, because unix(7) takes 107 in all
NAME_LENGTH_MAX = 50


def typed(*words: object) -> str:
    """Return a command as a person types it, names with blanks quoted."""
    return f'{PROGRAM} {shlex.join(map(str, words))}'


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
    prefix = next((name for name, scale in UNIT_PREFIXES.items() if size >= 0.1 * scale), '')
    return 1.0 / UNIT_PREFIXES[prefix], prefix + unit


def percent(fraction: float) -> str:
    """Format a fraction in percent, rounded down: 100 % only for a fraction of 1 or more."""
    return f'{int(100.0 * fraction) if fraction < 1.0 else 100} %'


def digits(value: float, count: int = 2) -> str:
    """Format a number with significant digits, without an exponent if that is short."""
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


def described_quantity(name: str, unit: str, numbers: Sequence[float], count: int = 3) -> str:
    """Say what a description holds: 'relative_change 5/10 %'."""
    factor, shown = scale_of(unit, max(map(abs, numbers)), name)
    values = '/'.join(digits(factor * number, count) for number in numbers)
    return f'{spoken(name)} {with_unit(values, shown)}'


def times(ratio: float) -> str:
    """Show a ratio: 'six times', '2.4 times'."""
    if ratio >= 2.75 and round(ratio) < 3 + len(TIMES_WORDS):
        return f'{TIMES_WORDS[round(ratio) - 3]} times'
    return f'{digits(ratio, 2)} times'


def probability(p: float) -> str:
    """Show a p-value."""
    if p == 0.0:
        return 'p < 1e-300'
    return f'p = {digits(p, 2)}' if p >= 1e-4 else f'p = {p:.0e}'.replace('e-0', 'e-')


def commands(inputs: Mapping[str, float | None], kind: str = 'tension') -> str:
    """Format a command: 'left 1.10 N, right 0.80 N'; slack wires are omitted."""
    scale, unit = (1.0, 'N') if kind == 'tension' else (1e3, 'mm')
    parts = [
        f'{name} {digits(scale * value, 3)} {unit}'
        for name, value in inputs.items()
        if value is not None and math.isfinite(value) and value != 0.0
    ]
    return ', '.join(parts) or 'nothing pulled'


def counted(count: int, what: str) -> str:
    """Say how many there are: '1 cell', '2 cells'."""
    return f'{count} {what}{"" if count == 1 else "s"}'


def postures(count: int, resting: int = 0) -> str:
    """Describe the number of postures, and how many of them are the arm at rest."""
    rest = f' ({"one" if resting == 1 else resting} at rest)' if resting else ''
    return f'{counted(count, "posture")}{rest}'


def listing(names: Iterable[str]) -> str:
    """List names in a message; a long list is cut in the middle."""
    known = list(names)
    shown = known if len(known) <= LISTED_MAX else [*known[:6], '...', *known[-3:]]
    return ', '.join(shown) or 'none'


def listed(names: Iterable[str], last: str = 'and') -> str:
    """Join names: 'a, b and c'."""
    *first, end = list(names) or ['nothing']
    return f'{", ".join(first)} {last} {end}' if first else end


def grouped[T, K](items: Iterable[T], by: Callable[[T], K]) -> dict[K, list[T]]:
    """Group items by a key; groups and their members stay in order."""
    groups: dict[K, list[T]] = {}
    for item in items:
        groups.setdefault(by(item), []).append(item)
    return groups


def capital(sentence: str) -> str:
    """Begin with a capital letter and leave the rest, units included, alone."""
    return sentence[:1].upper() + sentence[1:]


def columns(rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Align rows of text in columns, the first ones to the left, all others to the right."""
    widths = [max(len(row[c]) for row in rows if c < len(row)) for c in range(len(rows[0]))]
    return '\n'.join(
        '  '.join(
            cell.ljust(width) if c < left else cell.rjust(width)
            for c, (cell, width) in enumerate(zip(row, widths, strict=False))
        ).rstrip()
        for row in rows
    )


STANDARD_GRAVITY = 9.80665  # [m/s²] by definition (CGPM 1901)

# kind of quantity -> unit as written -> factor to SI (angles to radians; counts need a scale);
# a mass is its weight under standard gravity, the pound of 1959 0.45359237 kg
UNITS: dict[str, dict[str, float]] = {
    'time': {'s': 1.0, 'sec': 1.0, 'seconds': 1.0, 'ms': 1e-3, 'us': 1e-6, 'µs': 1e-6, 'ns': 1e-9,
             'min': 60.0},
    'length': {'m': 1.0, 'meters': 1.0, 'metres': 1.0, 'mm': 1e-3, 'millimeters': 1e-3,
               'millimetres': 1e-3, 'cm': 1e-2, 'centimeters': 1e-2, 'um': 1e-6, 'µm': 1e-6,
               'inch': 0.0254, 'inches': 0.0254},
    'force': {'N': 1.0, 'newton': 1.0, 'newtons': 1.0, 'mN': 1e-3, 'cN': 1e-2, 'kN': 1e3,
              **dict.fromkeys(('g', 'gf', 'grams'), 1e-3 * STANDARD_GRAVITY),
              **dict.fromkeys(('kg', 'kgf', 'kp'), STANDARD_GRAVITY),
              **dict.fromkeys(('lbf', 'lb', 'lbs'), 4.4482216152605),
              'ozf': 4.4482216152605 / 16.0},
    'angle': {'deg': math.pi / 180.0, 'degrees': math.pi / 180.0, '°': math.pi / 180.0,
              'rad': 1.0, 'rev': 2.0 * math.pi, 'turns': 2.0 * math.pi},
    'counts': {'ticks': 1.0, 'tick': 1.0, 'counts': 1.0, 'count': 1.0, 'steps': 1.0},
    'current': {'A': 1.0, 'mA': 1e-3, 'amps': 1.0},
}  # fmt: skip
TYPED_LENGTHS = ('mm', 'm', 'cm', 'inch')  # units of what a person types; the first is usual
QUANTITY = re.compile(
    r'^\s*(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(?P<unit>\S*)\s*$'
)
RATE = re.compile(r'(\d+(?:\.\d*)?)\s*Hz')
MARKED = re.compile(r'^(?P<name>.+?)\s*(?:\[\s*(?P<a>[^\]]+?)\s*\]|\(\s*(?P<b>[^)]+?)\s*\))$')
TAILED = re.compile(r'^(?P<name>.+?)(?:[ _./]+|\s*/\s*)(?P<unit>[A-Za-zµ°]+)$')
AFTER_NAME_ONLY = ('min', 'm', 'g', 'A', '°', 'count', 'tick', 'rev')  # rather names than units


@dataclass(frozen=True)
class Unit:
    """A unit as it was written, its kind, and what one of it is in SI."""

    text: str
    kind: str
    factor: float


def find_unit(text: str) -> Unit | None:
    """
    Return the unit that a text is, None where it is none; long ones in any case of letters.

    A rate such as `60Hz` is a unit of time: of one that counts frames.
    """
    cleaned = text.strip()
    for kind, known in UNITS.items():
        for name, factor in known.items():
            if cleaned == name or (len(name) > 2 and cleaned.lower() == name.lower()):
                return Unit(name, kind, factor)
    if (rate := RATE.fullmatch(cleaned)) and float(rate[1]) > 0.0:  # time counted in frames
        return Unit(cleaned, 'time', 1.0 / float(rate[1]))
    return None


def read_unit(option: str, text: str, *kinds: str) -> Unit:
    """
    Return a unit of one of these kinds.

    Raises
    ------
    InputError
        It is none.

    """
    unit = find_unit(text)
    if unit is None or unit.kind not in kinds:
        known = [name for kind in kinds for name in UNITS[kind]]
        rate = ', or a rate of frames such as 60Hz' if 'time' in kinds else ''
        raise InputError(f'{option}: expected one of {", ".join(known)}{rate}, got {text!r}')
    return unit


def read_quantity(option: str, text: str, usual: str, *kinds: str) -> float:
    """
    Return a number with a unit, such as `0.2N`, `30 mm` or `12in`, in SI units.

    Parameters
    ----------
    option : str
        Where it stands, for messages.
    text : str
        The number, with or without unit.
    usual : str
        The unit of a bare number.
    *kinds : str
        Kinds of units that may stand there.

    Raises
    ------
    InputError
        It is no finite number, or its unit is of another kind.

    """
    match = QUANTITY.match(text)
    if match is None or not math.isfinite(float(match['number'])):
        raise InputError(f'{option}: expected a number with a unit such as {usual}, got {text!r}')
    return float(match['number']) * read_unit(option, match['unit'] or usual, *kinds).factor


def numbers(
    what: str, text: str, separator: str | None, expected: str = 'numbers', count: int = 0
) -> tuple[float, ...]:
    """
    Read numbers with a separator between them, None: blanks; 0: as many as there are.

    Raises
    ------
    InputError
        One is no finite number, or there are more or fewer.

    """
    try:
        values = tuple(map(float, text.split(separator)))
    except ValueError:
        values = (math.nan,)
    if not all(map(math.isfinite, values)) or count not in (0, len(values)):
        raise InputError(f'{what}: expected {expected}, got {text!r}')
    return values


def other_unit(text: str, length: float, unit: str, low: float, high: float) -> str:
    """
    Return the advice '; if m is meant, say --unit m' if it fits, else ''.

    It fits if the typed numbers have no unit of their own, and the length [m] that was read
    in `unit` would in the other one lie between `low` and `high` [m].
    """
    for other in TYPED_LENGTHS:
        scale = read_unit('', other, 'length').factor / read_unit('', unit, 'length').factor
        if other != unit and low <= scale * length <= high and in_unit(text, unit) != text:
            return f'; if {other} is meant, say --unit {other}'
    return ''


def in_unit(text: str, unit: str) -> str:
    """Return typed numbers 'x,y,z' or 'x y z' with a unit, unless they have units of their own."""
    matches = map(QUANTITY.match, text.replace(',', ' ').split())
    return text if any(match['unit'] for match in matches if match) else f'{text} {unit}'


def split_name(column: str) -> tuple[str, Unit | None]:
    """
    Split the name of a column into what it names and its unit: `T1 [N]`, `m3_x (mm)`, `time_s`.

    A bare letter at the end, such as the m of `tip_m`, counts as a unit only where it is newtons
    or seconds; others stand in brackets.
    """
    text = column.strip()
    if marked := MARKED.match(text):
        unit = find_unit(marked['a'] or marked['b'])
        if unit is not None:
            return marked['name'].strip(), unit
    if tailed := TAILED.match(text):
        unit = find_unit(tailed['unit'])
        if unit and unit.text == tailed['unit'] and unit.text not in AFTER_NAME_ONLY:
            return tailed['name'].strip(), unit
    return text, None
