"""Tips into cubes, and arms that run into themselves, compiled: a microsecond for a posture."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

Floats = npt.NDArray[np.float64]
Numbers = npt.NDArray[np.int64]
compiled: Any = njit(cache=True, nogil=True)
# A line that turns by less than an angle in all has ends farther apart than cos(angle / 2) of its
# length (Schur): up to here more than 2/pi of it, also where bent cells are a tenth shorter.
TURNED_MIN_RAD = 0.5 * math.pi


def folds(positions: Floats, thickness: Floats, lengths: Floats) -> npt.NDArray[np.bool_]:
    """
    Tell which arms (b,) run into themselves.

    Two places of the backbone are nearer than the tendons beside them need, although the arm
    between them is long enough to turn round; or a cell bends until its holes meet.

    Parameters
    ----------
    positions : (b, n, 3) [m]
        Ends of the cells.
    thickness : (n,) [m]
        Farthest tendon from the backbone, in every cell.
    lengths : (n,) [m]
        Of the cells.

    """
    hit = np.zeros(len(positions), dtype=np.bool_)
    _folds(positions, thickness, np.cumsum(lengths) - 0.5 * lengths, hit)
    return hit


@compiled
def _folds(positions, thickness, along, hit):  # type: ignore[no-untyped-def]
    b, n = positions.shape[0], positions.shape[1]
    middles = np.empty((n, 3))
    for p in range(b):
        if _turn(positions[p]) < TURNED_MIN_RAD:
            continue
        for i in range(n):
            for axis in range(3):
                before = positions[p, i - 1, axis] if i else 0.0
                middles[i, axis] = 0.5 * (positions[p, i, axis] + before)
        hit[p] = _touches(middles, thickness, along)


@compiled
def _turn(ends):  # type: ignore[no-untyped-def]
    """Angle [rad] by which the straight pieces between the ends of cells turn, in all."""
    turned = 0.0
    for i in range(1, ends.shape[0]):
        dot = first = second = 0.0
        for axis in range(3):
            before = ends[i - 1, axis] - (ends[i - 2, axis] if i > 1 else 0.0)
            after = ends[i, axis] - ends[i - 1, axis]
            dot += before * after
            first += before * before
            second += after * after
        turned += math.acos(min(max(dot / math.sqrt(first * second), -1.0), 1.0))
    return turned


@compiled
def _touches(middles, thickness, along):  # type: ignore[no-untyped-def]
    n = middles.shape[0]
    for i in range(n):
        j = i + 1
        while j < n:
            apart = thickness[i] + thickness[j]
            if along[j] - along[i] <= 0.5 * math.pi * apart:
                j += 1
                continue
            x = middles[j, 0] - middles[i, 0]
            y = middles[j, 1] - middles[i, 1]
            z = middles[j, 2] - middles[i, 2]
            if x * x + y * y + z * z < apart * apart:
                return True
            j += 1
    return False


@compiled
def keep_least(flat, looks, content, m, rows, where, best, seen, used):  # type: ignore[no-untyped-def]
    """
    Put postures into cubes; return how many cubes are in use.

    Of every cube the posture of the lowest highest tension stays, of equal ones that of the least
    sum, so that the order in which they come does not matter.

    Parameters
    ----------
    flat : (b,)
        Cubes of the postures.
    looks : (b,)
        Bits of the parts of all directions.
    content : (b, m + 6)
        Tensions, tips, directions.
    m : int
    rows : (cubes,)
        Which row holds a cube; -1: none.
    where : (r,)
        Which cube a row is.
    best : (r, m + 6)
    seen : (r,)
    used : int
        Rows in use; there is room for b more.

    """
    for p in range(len(flat)):
        row = rows[flat[p]]
        if row < 0:
            row = used
            rows[flat[p]] = row
            where[row] = flat[p]
            seen[row] = looks[p]
            best[row] = content[p]
            used += 1
            continue
        seen[row] |= looks[p]
        if _is_less(content[p], best[row], m):
            best[row] = content[p]
    return used


@compiled
def _is_less(one, other, m):  # type: ignore[no-untyped-def]
    high = old_high = total = old_total = 0.0
    for j in range(m):
        high, old_high = max(high, one[j]), max(old_high, other[j])
        total, old_total = total + one[j], old_total + other[j]
    if high != old_high:
        return high < old_high
    if total != old_total:
        return total < old_total
    for j in range(len(one)):
        if one[j] != other[j]:
            return one[j] < other[j]
    return False
