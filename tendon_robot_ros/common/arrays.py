"""Types of arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
DIGITS = 9  # [1] decimals of metres and newtons, because nothing that measures an arm has more
RESOLUTION = 10.0**-DIGITS  # [m] or [N], because values are rounded to it
ROWS_AT_ONCE = 2_000  # [1] rows of a table, or postures, at once, so that they stay in the cache


def evenly(count: int, maximum: int) -> Ints:
    """Return at most `maximum` of `count` indices, evenly spread, with the first and the last."""
    return np.linspace(0, count - 1, min(count, maximum)).round().astype(int)


def interpolated(times: Floats | float, known: Sequence[float] | Floats, rows: Any) -> Floats:
    """Return rows (..., k) at times (...), linear between rows (n, k) at known times (n,)."""
    columns = np.transpose(rows)
    if not len(known):
        return np.full((*np.shape(times), len(columns)), np.nan)
    return np.stack([np.interp(times, known, column) for column in columns], axis=-1)


def simplified(
    kept: Iterable[int], limit: float, beside: Callable[[int, int], Floats]
) -> list[int]:
    """
    Return the rows of a polyline between which straight lines suffice.

    From the piece between two rows that are kept, the row farthest beside its line is kept as
    well, until none is farther than a limit (Ramer 1972, Douglas and Peucker 1973).

    Parameters
    ----------
    kept : iterable of int
        Rows to keep, the first and the last among them.
    limit : float
    beside : callable
        Of two rows: the distances of those between them from the line, in the unit of the limit.

    """
    rows = {*kept}
    pieces = list(pairwise(sorted(rows)))
    while pieces:
        first, last = pieces.pop()
        distances = beside(first, last)
        if distances.max(initial=0.0) > limit:
            corner = first + 1 + int(distances.argmax())
            rows.add(corner)
            pieces += [(first, corner), (corner, last)]
    return sorted(rows)
