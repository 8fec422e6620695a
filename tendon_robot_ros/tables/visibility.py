"""Columns that say whether a marker was seen: State of NDI, visible, occluded and the like."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from ..data.seen import BoolArray
from .columns import FILLERS, MISSING, ColumnName, RawTable, is_number, names_of

# words of a column's name, then of what stands in it
SEEN = {'visible', 'visibility', 'seen', 'valid', 'tracked', 'detected'}  # 0: it was not
HIDDEN = {'occluded', 'occlusion', 'hidden', 'missing', 'lost', 'invalid'}  # 0: it was seen
STATE = {'state', 'status'}  # in words
YES, NO = {'1', 'true', 'yes', 'y', 't'}, {'0', 'false', 'no', 'n', 'f'}
LOST = HIDDEN | {'disabled', 'unseen', 'untracked', 'out', 'not', 'bad', 'none', 'unknown'}


def kind_of_flag(name: ColumnName) -> set[str] | None:
    """Return the words of which a column's name has one: `SEEN`, `HIDDEN` or `STATE`."""
    return next((kind for kind in (SEEN, HIDDEN, STATE) if kind & set(name.words)), None)


def flag_columns(
    table: RawTable, markers: Sequence[Sequence[str]]
) -> Iterator[tuple[ColumnName, set[str], list[int]]]:
    """
    Find columns that say whether markers were seen.

    Parameters
    ----------
    table : RawTable
    markers : sequence of columns
        Of x, y and z of each marker.

    Yields
    ------
    name : ColumnName
    kind : set of str
        `SEEN`, `HIDDEN` or `STATE`.
    of : list of int
        The markers that it is about: the one with the same words, all where it names none.

    """
    names = names_of(table)
    used = {column for columns in markers for column in columns}
    own = {name.column: name for name in names if name.column in used}
    owners = [_words(own[c[0]].component[2]) if c[0] in own else () for c in markers]
    for name in names:
        kind = kind_of_flag(name)
        if kind is None or name.column in used:
            continue
        if kind is STATE and name.column in table.columns:
            continue  # numbers: what they mean only their maker knows
        owner = _words(word for word in name.words if word not in kind)
        of = [j for j, words in enumerate(owners) if words == owner]
        if of or not owner:
            yield name, kind, of or list(range(len(markers)))


def not_visible(table: RawTable, markers: Sequence[Sequence[str]]) -> dict[str, BoolArray]:
    """Return, by why, the readings (R, J) that a column says were not seen."""
    found = {}
    for name, kind, of in flag_columns(table, markers):
        hidden = _hidden(table, name.column, kind)
        if hidden.any() and not hidden.all():
            mask = np.zeros((len(table), len(markers)), dtype=bool)
            mask[:, of] = hidden[:, None]
            found[f'the column {name.column} says so'] = mask
    return found


def _words(words: Iterable[str]) -> tuple[str, ...]:
    return tuple(word for word in words if word not in FILLERS)


def _hidden(table: RawTable, column: str, kind: set[str]) -> BoolArray:
    """Tell in which rows (R,) a column says that the marker was not seen."""
    if column in table.columns:
        values = table.columns[column]
        return np.asarray(values == 0.0 if kind is SEEN else np.nan_to_num(values) != 0.0)
    return np.array([_says_hidden(text, kind) for text in table.texts[column]])


def _says_hidden(text: str, kind: set[str]) -> bool:
    words = set(text.lower().replace('_', ' ').split())
    if text in MISSING:
        return False
    if is_number(text):
        return kind is not STATE and (float(text) == 0.0) == (kind is SEEN)
    if words & LOST:
        return True
    return bool(words & NO) if kind is SEEN else kind is HIDDEN and bool(words & YES)
