"""Checked reading of a YAML mapping: every refusal names file, key, expectation and value."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, get_origin, get_type_hints

import yaml

from .errors import DriverError, InputError, RobotDescriptionError, TendonRobotError, short
from .files import read_text
from .words import read_quantity

NESTING_MAX = 100  # [1] brackets within brackets, else compiled code would run out of memory
# [1] characters that are read once more for a better message, because that takes ten times as long
EXPLAINED_CHARACTERS_MAX = 4_000
Loader: Any = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)  # compiled: a tenth of the time


class _Counting:
    """Limits the nesting depth, because the compiled loader would crash without an error."""

    depth = 0

    def descend_resolver(self, node: object, index: object) -> None:
        """Go into a node."""
        self.depth += 1
        if self.depth > NESTING_MAX:
            raise ValueError('brackets nested too deeply')

    def ascend_resolver(self) -> None:
        """Go out of a node."""
        self.depth -= 1


class _Plain(_Counting, Loader):  # type: ignore[misc]
    """The fast loader, compiled where available."""


class _Explaining(_Counting, yaml.SafeLoader):
    """The loader in pure Python, whose errors name the position more exactly."""


def parse_yaml(text: str, refuse: Callable[[str], Exception] = ValueError) -> Any:
    """
    Read YAML text into plain values; nothing in it is ever executed.

    Where that fails, what `refuse` makes of the reason, on one line, is raised.
    """
    try:
        return _parsed(text)
    except (yaml.YAMLError, ValueError) as error:  # a date such as 2000-99-99 is a ValueError
        raise refuse(' '.join(str(error).split())) from None


def _parsed(text: str) -> Any:
    """Read YAML text; a ValueError names the line of a mistake."""
    try:
        return yaml.load(text, Loader=_Plain)
    except yaml.MarkedYAMLError as refused:
        error = refused
        if len(text) <= EXPLAINED_CHARACTERS_MAX:
            try:  # the interpreted loader knows better where the mistake is
                yaml.load(text, Loader=_Explaining)
            except yaml.MarkedYAMLError as explained:
                error = explained
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise ValueError(f'line {line}: {error.problem}') from None


def dump_yaml(content: Any) -> str:
    """Write plain values as YAML: keys in their order, lists of values on one line."""
    options: Any = {'sort_keys': False, 'default_flow_style': None, 'allow_unicode': True}
    return str(yaml.safe_dump(content, **options))


def read_yaml(path: Path, refuse: Callable[[str], TendonRobotError]) -> Any:
    """Read a YAML file into plain values; `refuse` makes the error from a reason."""
    return parse_yaml(read_text(path, refuse), refuse)


class Reader:
    """A mapping of a description file, with the path of keys that leads to it."""

    refusal: ClassVar[type[TendonRobotError] | None] = None  # of files that are no description

    def __init__(self, source: str, path: str, content: Any) -> None:
        """Refuse what is no mapping."""
        self.source, self.path = source, path
        if content is None:
            content = {}
        if not isinstance(content, dict):
            raise self.error('', 'keys with values', content)
        self.content: dict[str, Any] = content

    def error(self, key: str, expected: str, got: object) -> TendonRobotError:
        """Build the error for a key of this mapping; other files have another class for it."""
        where = self._where(key)
        if self.refusal is None:
            return RobotDescriptionError(self.source, where, expected, got)
        return self.refusal(f'{self.source}: {where}: expected {expected}, got {short(got)}')

    def read[Part](self, kind: type[Part]) -> Part:
        """Return a dataclass of this mapping, whose keys are its annotated fields."""
        self.only(*_readers(kind))  # type: ignore[arg-type]
        return kind(**self.fields(kind))

    def fields(self, kind: type) -> dict[str, Any]:
        """Return the annotated fields of a dataclass; one that is not here has its default."""
        return {
            name: read(self, name)
            for name, read in _readers(kind).items()
            if self.has(name) or not hasattr(kind, name)
        }

    def has(self, key: str) -> bool:
        """Return whether a key is present and not empty."""
        return self.content.get(key) is not None

    def only(self, *known: str) -> None:
        """Refuse unknown keys."""
        for key in self.content:
            if key not in known:
                words = ' '.join(str(key).split())  # a key may have lines
                raise self.error(words, 'one of ' + ', '.join(known), str(key))

    def child(self, key: str) -> Self:
        """Open the mapping below a key, empty when absent."""
        return type(self)(self.source, self._where(key), self.content.get(key))

    def items(self, key: str) -> Iterator[Self]:
        """Open each entry of a list."""
        value = self.content.get(key)
        if not isinstance(value, list) or not value:
            raise self.error(key, 'a list with at least one entry', value)
        for index, item in enumerate(value):
            yield type(self)(self.source, f'{self._where(key)}[{index}]', item)

    def unique(self, key: str, names: list[str]) -> None:
        """Refuse a repeated name."""
        for name in names:
            if names.count(name) > 1:
                raise self.error(key, 'names that differ', name)

    def name(self, key: str) -> str:
        """Return a name; YAML reads y, n, on, off and numbers as something else."""
        value = self.content.get(key)
        if isinstance(value, (bool, int, float)):
            raise self.error(key, 'a name (put it in quotes: YAML reads it otherwise)', value)
        if not isinstance(value, str) or not value.strip():
            raise self.error(key, 'a name', value)
        if any(character in value for character in ',=\n\t'):
            raise self.error(key, 'a name without comma, equals sign or line break', value)
        return value

    def choice(self, key: str, known: tuple[str, ...], default: str | None = None) -> str:
        """Return one of the known words."""
        value = self.content.get(key, default)
        if value not in known:
            raise self.error(key, 'one of ' + ', '.join(known), value)
        return str(value)

    def flag(self, key: str) -> bool:
        """Return true or false; false when absent."""
        value = self.content.get(key, False)
        if not isinstance(value, bool):
            raise self.error(key, 'true or false', value)
        return value

    def whole(self, key: str, low: int, high: int, default: int | None = None) -> int:
        """Return a whole number within bounds."""
        value = self.content.get(key)
        if value is None and default is not None:
            return default
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self.error(key, f'a whole number from {low} to {high}', value)
        return value

    def number(
        self,
        key: str,
        low: float = -math.inf,
        high: float = math.inf,
        unit: str = '1',
        default: float | None = None,
    ) -> float:
        """Return a finite number within bounds."""
        if default is not None and not self.has(key):
            return default
        return self._number(key, self.content.get(key), low, high, unit)

    def length(self, key: str) -> float:
        """Return a length of at least 0 [m]: a number, or text with a unit such as `3 mm`."""
        value = self.content.get(key)
        if isinstance(value, str):
            with suppress(InputError):
                value = read_quantity(key, value, 'm', 'length')
        return self._number(key, value, 0.0, 1.0, 'm')

    def numbers(self, key: str) -> float | tuple[float, ...]:
        """Return one number, or a list of them."""
        value = self.content.get(key)
        if isinstance(value, list):
            return self.vector(key, len(value))
        return self._number(key, value, -math.inf, math.inf, 'SI')

    def vector(self, key: str, size: int) -> tuple[Any, ...]:
        """Return a list of finite numbers."""
        value = self.content.get(key)
        if not isinstance(value, list) or len(value) != size:
            raise self.error(key, f'a list of {size} numbers', value)
        return tuple(
            self._number(f'{key}[{i}]', v, -math.inf, math.inf, 'SI') for i, v in enumerate(value)
        )

    def limits(self, key: str) -> tuple[float, float]:
        """Return [lowest, highest] tension, 0 <= lowest < highest [N]."""
        low, high = self.vector(key, 2)
        if not 0.0 <= low < high:
            raise self.error(key, '[lowest, highest] with 0 <= lowest < highest [N]', [low, high])
        return low, high

    def per_cell(
        self, key: str, cells: int, unit: str, default: float | None = None
    ) -> tuple[float, ...]:
        """Return one positive value per cell from a number or a list."""
        value = self.content.get(key, default)
        values = value if isinstance(value, list) else [value] * cells
        if len(values) != cells:
            raise self.error(
                key, f'one number or {cells} of them (one per cell)', f'{len(values)} numbers'
            )
        return tuple(self._number(key, v, 1e-12, 1e6, unit) for v in values)

    def offset(self, key: str) -> tuple[float, float]:
        """Return an offset (x, y) [m] from the axis."""
        x, y = self.vector(key, 2)
        if max(abs(x), abs(y)) > 1.0:
            raise self.error(key, 'an offset below 1 m (is it in mm?)', [x, y])
        return x, y

    def offsets(self, key: str, cells: int) -> tuple[tuple[float, float], ...]:
        """Return one offset (x, y) [m] per cell."""
        value = self.content.get(key)
        if not isinstance(value, list) or len(value) != cells:
            got = f'{len(value)} of them' if isinstance(value, list) else value
            raise self.error(key, f'{cells} offsets [x, y] (one per cell)', got)
        listed = {f'{key}[{i}]': row for i, row in enumerate(value)}
        rows = type(self)(self.source, self.path, listed)
        return tuple(rows.offset(row) for row in rows.content)

    def _number(self, key: str, value: Any, low: float, high: float, unit: str) -> float:
        bounds = '' if low == -math.inf else f' from {low:g} to {high:g}'
        if isinstance(value, str):
            with suppress(ValueError):  # YAML 1.1 reads 2e-4 as text
                value = float(value)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(key, f'a number{bounds} [{unit}]', value)
        if not (math.isfinite(value) and low <= value <= high):
            hint = ' (is it in mm?)' if unit == 'm' and 10.0 * high < value <= 1e3 * high else ''
            raise self.error(key, f'a finite number{bounds} [{unit}]{hint}', value)
        return float(value)

    def _where(self, key: str) -> str:
        return '.'.join(map(str, filter(None, (self.path, key)))) or 'file'


class ConfigFields(Reader):
    """Checked reading of the configuration."""

    refusal = DriverError


# How a field of a dataclass is read stands in its annotation, beside its default:
#     rate: Annotated[float, in_range(0.1, 1000.0, 'Hz')] = 30.0
Read = Callable[[Any, str], Any]  # of a reader and the key


@cache  # annotations are texts, and regions are read while the arm is commanded
def _readers(kind: type) -> dict[str, Read]:
    """Return how each annotated field of a dataclass is read."""
    hints = get_type_hints(kind, include_extras=True).items()
    return {name: hint.__metadata__[0] for name, hint in hints if get_origin(hint) is Annotated}


def in_range(low: float, high: float, unit: str) -> Read:
    """Return how a number within bounds is read."""
    return lambda one, key: one.number(key, low, high, unit)


def one_of(*known: str) -> Read:
    """Return how one of the known words is read."""
    return lambda one, key: one.choice(key, known)


def part(kind: type) -> Read:
    """Return how the keys of a dataclass are read."""
    return lambda one, key: one.child(key).read(kind)
