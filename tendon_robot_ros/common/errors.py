"""
Errors that a user can meet, and checks of what a caller gives that raise them.

Each error is one line that says what, where and what to do.
"""

from __future__ import annotations

import importlib
import math
import operator
import os
import reprlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

_SHORT = reprlib.Repr(  # a file may hold a value of any size; a message may not
    maxstring=120, maxother=120, maxlong=120, maxlist=8, maxtuple=8, maxdict=8, maxlevel=3
)


def short(value: object) -> str:
    """Show a value in a message: its `repr`, cut where it gets long."""
    return _SHORT.repr(value)


REASON_MAX = 200  # [1] characters of what a parser says, so that a message stays one line


def reason_of(error: BaseException) -> str:
    """Return the message of a parser on one line, or the type of its error without a message."""
    return ' '.join(str(error).split())[:REASON_MAX] or type(error).__name__


class TendonRobotError(Exception):
    """Base of every error that the command line prints as one line."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Keep message and fields on the way to another process, whatever a class is made of."""
        return Exception.__new__, (type(self), *self.args), vars(self)


class RobotDescriptionError(TendonRobotError):
    """A robot description is not valid."""

    def __init__(self, source: str, key: str, expected: str, got: object) -> None:
        """Name the file and key, the expected and the given value."""
        self.source, self.key, self.expected, self.got = source, key, expected, got
        super().__init__(f'{source}: {key}: expected {expected}, got {short(got)}')


class EffectError(TendonRobotError):
    """An effect is unknown, or its definition is not usable."""


class InputError(TendonRobotError):
    """Tensions, pulls or targets that the model cannot take."""


class NoEquilibriumError(TendonRobotError):
    """The model finds no equilibrium for a posture."""

    def __init__(self, posture: str, effects: tuple[str, ...], last_change: float) -> None:
        """Say at which posture, with which implicit effects, and how far it moved [rad]."""
        self.posture, self.effects, self.last_change = posture, effects, last_change
        names = ', '.join(effects) or 'no implicit effect'
        still = ''
        if math.isfinite(last_change):
            still = f': the last step still changed a bend by {last_change:.2g} rad'
        super().__init__(
            f'no equilibrium for {posture} with {names}{still}; lower the tensions or loads, or '
            'check the units'
        )


class DataSetError(TendonRobotError):
    """A data set cannot be read or written."""

    def __init__(self, where: str, problem: str, remedy: str) -> None:
        """Say file (and row), what is wrong, and what to do."""
        self.where, self.problem, self.remedy = where, problem, remedy
        super().__init__(f'{where}: {problem}; {remedy}')


class ClusterLostError(TendonRobotError):
    """The scheduler of a cluster is gone while it was at work."""


class DriverError(TendonRobotError):
    """A driver cannot do what it was asked."""


class MovedError(DriverError):
    """Motors were moved, and what that was for failed: a person looks before it is tried again."""

    def __init__(self, problem: str) -> None:
        """Say what failed; what to do is the same for all."""
        super().__init__(
            f'{problem}; the motors have moved: look at the wires, call reset, then activate again'
        )


class MissingExtraError(TendonRobotError):
    """An optional dependency is not installed."""

    def __init__(self, package: str, extra: str) -> None:
        """Say the exact line to type."""
        self.package, self.extra = package, extra
        super().__init__(
            f'{package} is not installed; type: python -m pip install "tendon_robot_ros[{extra}]"'
        )


def of_extra(extra: str, module: str) -> Any:
    """Return a module of an optional dependency; MissingExtraError where it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise MissingExtraError(module.partition('.')[0], extra) from None


Progress = Callable[[str, int, int], None]  # called with what is done, steps done, steps in all


def refusal(name: str, expected: str, given: object) -> InputError:
    """Return the error that names the expected and the given value of an argument."""
    kind = '' if isinstance(given, str | int | float | None) else f'{type(given).__name__} '
    return InputError(f'{name}: expected {expected}, got {kind}{short(given)}')


def whole(name: str, given: object, low: int = 0) -> int:
    """Return an integer of at least `low`; integers of numpy are accepted."""
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
    """Return the text if it is one of the known words; else refuse it."""
    if not isinstance(given, str) or given not in known:
        raise refusal(name, f'one of {", ".join(known)}', given)
    return given


def place(name: str, given: object) -> Path:
    """Return a path, given as text or as one."""
    if not isinstance(given, str | os.PathLike) or not str(given).strip():
        raise refusal(name, 'a path', given)
    return Path(given)


def names(what: str, given: object, count: int) -> tuple[str, ...]:
    """Return the given names, or '0' to 'count-1' if none are given."""
    if not isinstance(given, Iterable) or isinstance(given, str | bytes):
        raise refusal(what, f'{count} names', given)
    listed = tuple(map(str, given)) or tuple(map(str, range(count)))
    if len(listed) != count or len(set(listed)) < count:
        raise refusal(what, f'{count} names that differ', listed)
    return listed


def listener(given: Progress | None) -> Progress:
    """Return the progress callable, or one that does nothing for None."""
    if given is None:
        return lambda what, done, total: None
    if not callable(given):
        raise refusal('progress', 'a function or None', given)
    return given


def suggestion(name: object, known: Iterable[str]) -> str:
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
