"""What a caller gives a public function: taken as what it means, or refused in one line."""

from __future__ import annotations

import math
import operator
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from .errors import InputError, short

Progress = Callable[[str, int, int], None]  # hears what is done, how much of it, of how much


def refusal(name: str, expected: str, given: object) -> InputError:
    """Return the error that says what an argument should have been, and what came."""
    kind = '' if isinstance(given, str | int | float | None) else f'{type(given).__name__} '
    return InputError(f'{name}: expected {expected}, got {kind}{short(given)}')


def whole(name: str, given: object, low: int = 0) -> int:
    """Return a whole number from `low` on; one of numpy is one as well."""
    try:
        value = low - 1 if isinstance(given, bool) else operator.index(given)  # type: ignore[arg-type]
    except TypeError:
        value = low - 1
    if value < low:
        raise refusal(name, f'a whole number from {low} on', given)
    return value


def number(name: str, given: object, low: float, high: float, unit: str = '1') -> float:
    """Return a finite number within bounds [unit]."""
    expected = f'a number from {low:g} to {high:g} [{unit}]'
    if isinstance(given, bool | str) or not hasattr(given, '__float__'):
        raise refusal(name, expected, given)
    try:
        value = float(given)
    except (TypeError, ValueError):  # an array of several
        value = math.nan
    if not low <= value <= high:
        raise refusal(name, expected, given)
    return value


def choice(name: str, given: object, known: Sequence[str]) -> str:
    """Return one of the known words."""
    if not isinstance(given, str) or given not in known:
        raise refusal(name, f'one of {", ".join(known)}', given)
    return given


def place(name: str, given: object) -> Path:
    """Return a path, given as text or as one."""
    if not isinstance(given, str | os.PathLike) or not str(given).strip():
        raise refusal(name, 'a path', given)
    return Path(given)


def names(what: str, given: object, count: int) -> tuple[str, ...]:
    """Return names for `count` things, '0' to 'count-1' where none are given."""
    if not isinstance(given, Iterable) or isinstance(given, str | bytes):
        raise refusal(what, f'{count} names', given)
    listed = tuple(map(str, given)) or tuple(map(str, range(count)))
    if len(listed) != count or len(set(listed)) < count:
        raise refusal(what, f'{count} names that differ', listed)
    return listed


def listener(given: Progress | None) -> Progress:
    """Return who hears the progress of long work; None: nobody."""
    if given is None:
        return lambda what, done, total: None
    if not callable(given):
        raise refusal('progress', 'a function or None', given)
    return given


def meant(name: object, known: Iterable[str]) -> str:
    """Return 'did you mean ...? ' where a name is nearly one of the known, else ''."""
    near = get_close_matches(str(name), list(known), n=1)
    return f'did you mean {near[0]}? ' if near else ''


def named_columns(given: Any) -> dict[str, Any] | None:
    """
    Return the columns of what has names for them, None where they have an order only.

    A DataFrame, a Series (one row), a structured array, or a mapping. A DataFrame that was made
    of an array has numbers for names: these are no names.
    """
    if hasattr(given, 'columns'):  # a DataFrame
        names = list(given.columns)
    elif hasattr(given, 'keys'):  # a mapping, or a Series
        names = list(given.keys())
    else:
        fields = getattr(getattr(given, 'dtype', None), 'names', None)
        return None if fields is None else {name: given[name] for name in fields}
    if not isinstance(given, Mapping) and names == list(range(len(names))):
        return None
    return {str(name): given[name] for name in names}
