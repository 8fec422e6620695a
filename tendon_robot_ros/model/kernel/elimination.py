"""
The linear equations of the chain, solved from the tip to the base and back.

Towards the tip go the changes u of the tensions, of the bend before, and of the turn of the
frame; towards the base the changes w of the travel beyond an eyelet and of the loads' torque. At
every cell, what lies beyond answers u with w = S u + h. Eliminating a cell makes the S of the cell
before; back-substitution runs from the base to the tip. The work grows linearly with the cells.
"""

import math

import numpy as np

from .layout import RESPOND, address, compiled, entry, floats, keep, words
from .loads import loaded
from .stages import eyelet_acts
from .tangent import (
    BEFORE,
    BY_TENSION,
    BY_TORQUE,
    BY_TURN,
    HERE,
    LAGS,
    OWN,
    PASSED,
    PULLS,
    SIZE,
    SLIDES,
    TENDON,
    TORQUE_BY_OWN,
    TORQUE_BY_TURN,
    TRAVELS,
    TURNS,
    differentiate,
    tangent_of,
    tangent_size,
)


@compiled
def solve_rows(a, b, size):
    """Solve a x = b in place, a (size, size), b (size, ...), by LU; False where singular."""
    width = b.shape[1]
    for c in range(size):
        pivot = c
        for r in range(c + 1, size):
            if abs(a[r, c]) > abs(a[pivot, c]):
                pivot = r
        if not 1e-30 < abs(a[pivot, c]) < 1e30:
            return False
        if pivot != c:
            for j in range(size):
                a[c, j], a[pivot, j] = a[pivot, j], a[c, j]
            for j in range(width):
                b[c, j], b[pivot, j] = b[pivot, j], b[c, j]
        for r in range(c + 1, size):
            share = a[r, c] / a[c, c]
            if share != 0.0:
                for j in range(c + 1, size):
                    a[r, j] -= share * a[c, j]
                for j in range(width):
                    b[r, j] -= share * b[c, j]
    for r in range(size - 1, -1, -1):
        for c in range(r + 1, size):
            for j in range(width):
                b[r, j] -= a[r, c] * b[c, j]
        scale = 1.0 / a[r, r]
        for j in range(width):
            b[r, j] *= scale
    return True


@compiled
def columns(chain):
    """Columns of the tensions; where those of the frame's turn begin, where the constants do."""
    tensions = chain.k if eyelet_acts(chain) else 0
    turn = tensions + 2
    return tensions, turn, turn + 3 if loaded(chain) else turn


@compiled
def pass_tensions(chain, tangent, i, s, by_own, tensions, direct):
    """
    Fill the changes of the tensions in cell i (k, width) and their part by the own bend (k, 2).

    A tendon about to slide at the eyelet before the cell feels all travel beyond: s (rows, width)
    and by_own (rows, 2) say how that answers.
    """
    kt, _, _ = columns(chain)
    tendon, width = words(chain.tendon), tensions.shape[2]
    active, count = np.empty(kt, np.int64), 0
    for k in range(kt):
        for j in range(width):
            tensions[i, k, j] = 0.0
        direct[k, 0], direct[k, 1] = 0.0, 0.0
        if i == 0 or i >= tendon[2 * k]:
            continue
        here = floats(tangent_of(chain, tangent, i) + 8 * (SIZE + TENDON * k))
        tensions[i, k, k] = here[PASSED]
        if here[LAGS] != 0.0:
            tensions[i, k, width - 1] = here[LAGS]  # the only right-hand side
        for a in range(2):
            tensions[i, k, kt + a] = here[BEFORE + a]
            direct[k, a] = here[HERE + a] + here[SLIDES] * here[TRAVELS + a]
        if here[SLIDES] != 0.0:
            active[count] = k
            count += 1
    if count > 0:
        slide_together(chain, tangent, i, s, by_own, tensions, direct, active[:count])


@compiled
def slide_together(chain, tangent, i, s, by_own, tensions, direct, active):
    """Solve for the changes of the tensions of active tendons, which feel each other's travel."""
    kt, turn, _ = columns(chain)
    count, width = active.shape[0], tensions.shape[2]
    left, right = np.zeros((count, count)), np.empty((count, width + 2))
    is_active = np.zeros(kt, np.bool_)
    for p in range(count):
        is_active[active[p]] = True
    for p in range(count):
        k = active[p]
        slides = floats(tangent_of(chain, tangent, i) + 8 * (SIZE + TENDON * k))[SLIDES]
        for j in range(width):
            right[p, j] = tensions[i, k, j] + (slides * s[k, j] if j >= turn else 0.0)
        for a in range(2):
            right[p, width + a] = direct[k, a] + slides * by_own[k, a]
        for q in range(count):
            left[p, q] = (1.0 if p == q else 0.0) - slides * s[k, active[q]]
        for other in range(kt):
            share = 0.0 if is_active[other] else slides * s[k, other]
            if share != 0.0:
                for j in range(width):
                    right[p, j] += share * tensions[i, other, j]
                for a in range(2):
                    right[p, width + a] += share * direct[other, a]
    if not solve_rows(left, right, count):
        right[:] = math.nan
    for p in range(count):
        for j in range(width):
            tensions[i, active[p], j] = right[p, j]
        direct[active[p], 0], direct[active[p], 1] = right[p, width], right[p, width + 1]


@compiled
def solve_cell(chain, tangent, i, s, by_own, tensions, direct, bends):
    """
    Fill the changes of the bend of cell i (2, width), which holds its right-hand sides.

    Returns the cell's pivot, the derivative of its residual with all beyond eliminated.
    """
    kt, turn, constant = columns(chain)
    row, width = floats(tangent_of(chain, tangent, i)), bends.shape[2]
    tendon = words(chain.tendon)
    a, b, c, d = row[OWN], row[OWN + 1], row[OWN + 2], row[OWN + 3]
    for k in range(kt):
        if i >= tendon[2 * k]:
            continue
        here = floats(tangent_of(chain, tangent, i) + 8 * (SIZE + TENDON * k))
        u, v = here[BY_TENSION], here[BY_TENSION + 1]
        if turn != constant:
            for m in range(3):
                u += row[BY_TORQUE + m] * s[kt + m, k]
                v += row[BY_TORQUE + 3 + m] * s[kt + m, k]
        a, b = a + u * direct[k, 0], b + u * direct[k, 1]
        c, d = c + v * direct[k, 0], d + v * direct[k, 1]
        for j in range(width):
            bends[i, 0, j] -= u * tensions[i, k, j]
            bends[i, 1, j] -= v * tensions[i, k, j]
    if turn != constant:
        for m in range(3):
            u, v = row[BY_TORQUE + m], row[BY_TORQUE + 3 + m]
            a, b = a + u * by_own[kt + m, 0], b + u * by_own[kt + m, 1]
            c, d = c + v * by_own[kt + m, 0], d + v * by_own[kt + m, 1]
            bends[i, 0, turn + m] -= row[BY_TURN + m]
            bends[i, 1, turn + m] -= row[BY_TURN + 3 + m]
            for j in range(turn, width):
                bends[i, 0, j] -= u * s[kt + m, j]
                bends[i, 1, j] -= v * s[kt + m, j]
    scale = 1.0 / (a * d - b * c)
    for j in range(width):
        u, v = bends[i, 0, j], bends[i, 1, j]
        bends[i, 0, j], bends[i, 1, j] = scale * (d * u - b * v), scale * (a * v - c * u)
    return a, b, c, d


@compiled
def answer_row(chain, i, s, r, by_own, extra, tensions, bends, out):
    """Row r of the next S: how what lies beyond a cell's start answers what comes in there."""
    kt, turn, _ = columns(chain)
    width = out.shape[1]
    u, v = by_own[r, 0] + extra[0], by_own[r, 1] + extra[1]
    for j in range(width):
        out[r, j] = u * bends[i, 0, j] + v * bends[i, 1, j]
    for j in range(turn, width):
        out[r, j] += s[r, j]
    for k in range(kt):
        share = s[r, k]
        if share != 0.0:
            for j in range(width):
                out[r, j] += share * tensions[i, k, j]


@compiled
def answer(chain, tangent, i, s, by_own, tensions, bends, first, out):
    """Fill the next S (rows, width) from that of cell i."""
    kt, turn, constant = columns(chain)
    row, tendon = floats(tangent_of(chain, tangent, i)), words(chain.tendon)
    for k in range(kt):
        here = floats(tangent_of(chain, tangent, i) + 8 * (SIZE + TENDON * k))
        if first[k] <= i < tendon[2 * k]:
            extra = (here[TRAVELS], here[TRAVELS + 1])
            answer_row(chain, i, s, k, by_own, extra, tensions, bends, out)
    if turn == constant:
        return
    for m in range(3):
        extra = (row[TORQUE_BY_OWN + 2 * m], row[TORQUE_BY_OWN + 2 * m + 1])
        for k in range(kt):
            if i < tendon[2 * k]:
                here = floats(tangent_of(chain, tangent, i) + 8 * (SIZE + TENDON * k))
                s[kt + m, k] += here[PULLS + m]
        answer_row(chain, i, s, kt + m, by_own, extra, tensions, bends, out)
        for a in range(3):
            out[kt + m, turn + a] += row[TORQUE_BY_TURN + 3 * m + a]


@compiled
def first_slides(chain, tangent):
    """First cell (k,) from which on a tendon's travel matters to an eyelet before it."""
    kt, _, _ = columns(chain)
    first, tendon = np.empty(kt, np.int64), words(chain.tendon)
    for k in range(kt):
        first[k] = chain.n
        for i in range(1, tendon[2 * k]):
            if floats(tangent_of(chain, tangent, i) + 8 * (SIZE + TENDON * k))[SLIDES] != 0.0:
                first[k] = i
                break
    return first


@compiled
def eliminate(chain, tangent, bends, tensions):
    """
    Eliminate the cells from the tip to the base.

    `bends` (n, 2, width) holds the right-hand sides in its last columns and zeros before; it and
    `tensions` (n, k, width) take the changes by what comes into each cell. Returns the first cell
    from the tip whose pivot is not positive, and that pivot; -1 if all are: the equilibrium is
    then stable.
    """
    kt, turn, constant = columns(chain)
    width, unstable, pivot = bends.shape[2], -1, (1.0, 0.0, 0.0, 1.0)
    rows = kt + 3
    s, out, by_own = np.zeros((rows, width)), np.zeros((rows, width)), np.zeros((rows, 2))
    direct, first = np.empty((kt, 2)), first_slides(chain, tangent)
    tendon = words(chain.tendon)
    for i in range(chain.n - 1, -1, -1):
        row = floats(tangent_of(chain, tangent, i))
        for r in range(rows if turn != constant else kt):
            for a in range(2):
                by_own[r, a] = s[r, kt + a]
                if turn != constant:
                    for m in range(3):
                        by_own[r, a] += s[r, turn + m] * row[TURNS + 2 * m + a]
        pass_tensions(chain, tangent, i, s, by_own, tensions, direct)
        a, b, c, d = solve_cell(chain, tangent, i, s, by_own, tensions, direct, bends)
        if unstable < 0 and not (a > 0.0 and a * d > 0.25 * (b + c) * (b + c)):
            unstable, pivot = i, (a, b, c, d)
        for k in range(kt):
            if i < tendon[2 * k]:
                for j in range(width):
                    tensions[i, k, j] += (
                        direct[k, 0] * bends[i, 0, j] + direct[k, 1] * bends[i, 1, j]
                    )
        out[:] = 0.0
        answer(chain, tangent, i, s, by_own, tensions, bends, first, out)
        s, out = out, s
    return unstable, pivot


@compiled
def substitute(chain, tangent, bends, tensions, column, first, start, solution):
    """
    Fill a solution (2n,) at an address by back-substitution, base to tip.

    That of the right-hand side in a column of `bends`; or, with `column` -1, how the cells beyond
    cell `first` follow when that bends by `start` (x, y) and those before it stay.
    """
    kt, turn, constant = columns(chain)
    u, new, out = np.zeros(constant), np.zeros(constant), floats(solution)
    for i in range(chain.n):
        row = floats(tangent_of(chain, tangent, i))
        for a in range(2):
            total = bends[i, a, column] if column >= 0 else 0.0
            for j in range(constant):
                total += bends[i, a, j] * u[j]
            out[2 * i + a] = start[a] if i == first else total
        for k in range(kt):
            new[k] = tensions[i, k, column] if column >= 0 else 0.0
            for j in range(constant):
                new[k] += tensions[i, k, j] * u[j]
        x, y = out[2 * i], out[2 * i + 1]
        for k in range(kt):
            u[k] = new[k]
        u[kt], u[kt + 1] = x, y
        for j in range(turn, constant):
            m = j - turn
            u[j] += row[TURNS + 2 * m] * x + row[TURNS + 2 * m + 1] * y


@compiled
def yielding(pivot):
    """Bend (x, y) in which the energy falls: eigenvector of a pivot's lower eigenvalue."""
    a, b, c, d = pivot
    both = 0.5 * (b + c)
    low = 0.5 * (a + d) - math.sqrt(0.25 * (a - d) * (a - d) + both * both)
    if both == 0.0:
        return (1.0, 0.0) if a <= d else (0.0, 1.0)
    return both, low - a


@compiled
def yielding_to(chain, pivot, wanted):
    """Bend (x, y) in which the energy falls, to the side of bends wanted (n, 2) if it can be."""
    a, b, c, d = pivot
    x, y, bends = 0.0, 0.0, floats(wanted)
    for i in range(chain.n):
        x += bends[2 * i]
        y += bends[2 * i + 1]
    if a * x * x + (b + c) * x * y + d * y * y < 0.0:
        size = math.sqrt(x * x + y * y)
        return x / size, y / size
    return yielding(pivot)


@entry(RESPOND)
def respond(chain, bend, rates, count, work, past, ways):
    """
    Fill how bends (n, 2), whose states `work` holds, balance rates of the residual (count, 2n).

    `ways` (count, 2n): minus the inverse Jacobian of the residual times the rates. Returns the
    first cell from the tip whose pivot is not positive, -1 if none: the equilibrium is stable.
    With `count` 0 and such a cell, `ways` (2n,) is a direction in which the energy falls, to the
    side of what it held: that cell yields, all beyond it follow.
    """
    tangent = np.zeros(tangent_size(chain.n, chain.k))
    derivatives = address(tangent)
    differentiate(chain, bend, work, past, derivatives)
    kt, _, constant = columns(chain)
    bends = np.zeros((chain.n, 2, constant + count))
    tensions = np.empty((chain.n, kt, constant + count))
    for q in range(count):
        rate = floats(rates + 16 * chain.n * q)
        for i in range(chain.n):
            bends[i, 0, constant + q], bends[i, 1, constant + q] = -rate[2 * i], -rate[2 * i + 1]
    first, pivot = eliminate(chain, derivatives, bends, tensions)
    for q in range(count):
        way = ways + 16 * chain.n * q
        substitute(chain, derivatives, bends, tensions, constant + q, -1, (0.0, 0.0), way)
    if count == 0 and first >= 0:
        start = yielding_to(chain, pivot, ways)
        substitute(chain, derivatives, bends, tensions, -1, first, start, ways)
    keep(tangent)
    return first
