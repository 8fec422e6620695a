"""Long tables, a row for each marker and time, to wide ones, a row for each time."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from ..common.dataframes import pandas
from .columns import FloatArray, RawTable, guess_time, names_of, table_of, triples_of, word_set
from .points import kind_of_flag

WHOSE = word_set(
    'id ids name tag marker label body object tool sensor point target landmark tracker child '
    'rigidbody idx index'
)
ROUND = 'round of markers'
MARKERS_MAX = 1000  # values of a column that are names: more are counts


def widened(table: RawTable) -> RawTable:
    """
    Return a long table with a row for each time; one that is wide already as it is.

    A table is long where it has one place in a row, and a column that says whose place it is:
    with several values, whose times overlap. Other columns that differ between rows of one time
    are the marker's own.
    """
    if sum(not triple.quantity for triple in triples_of(table)) != 1:
        return table
    time = guess_time(names_of(table))
    if time is None or time.column not in (*table.columns, *table.texts):
        return table
    whose = _whose(table, time.column)
    if whose is None:
        return table
    frame = pandas().DataFrame({**table.columns, **{n: list(t) for n, t in table.texts.items()}})
    number = frame[time.column].to_numpy()
    if len(set(number)) == len(number):  # rows have times of their own
        number = _rounds(frame[whose])
    keys = frame.assign(**{ROUND: number}).drop_duplicates([ROUND, whose])
    rounds = keys.groupby(ROUND, sort=True)
    others = [c for c in frame.columns if c not in (whose, time.column)]
    own = [c for c in others if (rounds[c].nunique(dropna=False) > 1).any()]
    shared = rounds[[c for c in frame.columns if c not in (*own, whose)]].first()
    wide = keys.pivot(index=ROUND, columns=whose, values=own)
    names = {}
    for c, w in wide.columns:
        text = str(int(w)) if isinstance(w, float) and w.is_integer() else str(w)
        names[c, w] = f'{f"marker {text}" if text.isdigit() else text} {c}'
    wide.columns = [names[key] for key in wide.columns]
    units = dict(table.units)
    units |= {named: table.units[c] for (c, _), named in names.items() if c in table.units}
    count = len(frame[whose].unique())
    told = f'a row for each {whose} and time: {count} markers, {len(wide):,} times'
    joined = shared.join(wide).reset_index(drop=True)
    made = table_of(table.name, joined.infer_objects(), units, None, (*table.notes, told))
    return replace(made, up=table.up, part=table.part)


def _whose(table: RawTable, time: str) -> str | None:
    """Return the column that says whose place a row holds, None for none."""
    taken = {column for triple in triples_of(table) for column in triple.columns}
    stamps = _numbered(table, time)
    best, many = None, 1
    for name in names_of(table):
        if not WHOSE & set(name.words) or name.column in taken or name.column == time:
            continue
        if kind_of_flag(name) is not None:
            continue
        values = _numbered(table, name.column)
        if not np.isfinite(values).all() or np.any(values != np.round(values)):
            continue
        known = np.unique(values)
        if not many < len(known) <= min(MARKERS_MAX, len(table) // 2):
            continue
        spans = sorted((stamps[values == v].min(), stamps[values == v].max()) for v in known)
        if any(b[0] <= a[1] for a, b in pairwise(spans)):
            best, many = name.column, len(known)
    return best


def _numbered(table: RawTable, column: str) -> FloatArray:
    """Return the numbers (R,) of a column; of texts their numbers in alphabetical order."""
    if column in table.columns:
        return table.columns[column]
    return np.unique(np.array(table.texts[column]), return_inverse=True)[1].astype(float)


def _rounds(whose: Iterable[Hashable]) -> list[int]:
    """Return the number of the round of every row, in which each marker comes once at most."""
    number, seen, found = 0, set[Hashable](), []
    for value in whose:
        if value in seen:
            number, seen = number + 1, set()
        seen.add(value)
        found.append(number)
    return found
