"""
How bends and twists respond to what moves the equilibrium: linear equations, tip to base.

Eliminating a cell (`elimination`) makes what the cell before meets; back-substitution runs from
the base to the tip. A pivot that is not positive means an unstable equilibrium.
"""

import math

import numpy as np

from .elimination import (
    answer,
    answer_twist,
    columns,
    complete_tensions,
    pass_tensions,
    solve_cell,
)
from .layout import (
    NONE,
    RESPOND,
    SIZE,
    SLIDES,
    TENDON,
    TURNS,
    address,
    compiled,
    entry,
    floats,
    keep,
    tangent_of,
    tangent_size,
    words,
)
from .linear import fill
from .tangent import differentiate


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

    `bends` (n, 2 or 3, width) holds the right-hand sides in its last columns and zeros before; it
    and `tensions` (n, k, width) take the changes by what comes into each cell. Returns the first
    cell from the tip whose pivot is not positive, that pivot of the bend (4,), and the pivot of
    the twist and how it follows the bend (3,); -1 if all are: the equilibrium is then stable.
    """
    kt, turn, constant = columns(chain)
    width, unstable, pivot = bends.shape[2], -1, (1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
    rows, twist = kt + 3, np.zeros(3)
    twist[0] = 1.0
    s, out, by_own = np.zeros((rows, width)), np.zeros((rows, width)), np.zeros((rows, 3))
    direct, first = np.empty((kt, 3)), first_slides(chain, tangent)
    for i in range(chain.n - 1, -1, -1):
        row = floats(tangent_of(chain, tangent, i))
        for r in range(rows if turn != constant else kt):
            for a in range(2):
                by_own[r, a] = s[r, kt + a]
                if turn != constant:
                    for m in range(3):
                        by_own[r, a] += s[r, turn + m] * row[TURNS + 3 * m + a]
            if turn - kt == 3:
                by_own[r, 2] = s[r, kt + 2]
                if turn != constant:
                    for m in range(3):
                        by_own[r, 2] += s[r, turn + m] * row[TURNS + 3 * m + 2]
        pass_tensions(chain, tangent, i, s, by_own, tensions, direct)
        a, b, c, d = solve_cell(chain, tangent, i, s, by_own, tensions, direct, bends, twist)
        positive = a > 0.0 and a * d > 0.25 * (b + c) * (b + c) and twist[0] > 0.0
        if unstable < 0 and not positive:
            unstable, pivot = i, (a, b, c, d, twist[0], twist[1], twist[2])
        complete_tensions(chain, i, direct, bends, tensions)
        fill(out, 0.0)
        answer(chain, tangent, i, s, by_own, tensions, bends, first, out)
        if turn - kt == 3:
            answer_twist(chain, tangent, i, by_own, bends, first, out)
        s, out = out, s
    return unstable, pivot


@compiled
def substitute(chain, tangent, bends, tensions, column, pulled, first, start, solution):
    """
    Fill a solution (u,) at an address by back-substitution, base to tip.

    That of the right-hand side in a column of `bends`; or, with `column` -1, that of 1 N at the
    base of tendon `pulled`; or, with that -1, too, how the cells beyond cell `first` follow when
    that moves by `start` (x, y, twist) and those before it stay.

    Parameters
    ----------
    tangent : address
        Derivatives of the cells.
    bends, tensions : ndarray, shapes (n, 2 or 3, width) and (n, k, width)
        As `eliminate` leaves them.
    column, pulled, first : int
    start : tuple of float
        Bend and twist (3,) [rad].
    solution : address
        Takes (u,) [rad per unit].

    """
    kt, turn, constant = columns(chain)
    u, new, out = np.zeros(constant), np.zeros(constant), floats(solution)
    if pulled >= 0:
        u[pulled] = 1.0
    for i in range(chain.n):
        row = floats(tangent_of(chain, tangent, i))
        twist = 0.0
        for a in range(turn - kt):
            total = bends[i, a, column] if column >= 0 else 0.0
            for j in range(constant):
                total += bends[i, a, j] * u[j]
            if a < 2:
                out[2 * i + a] = start[a] if i == first else total
            else:
                twist = out[2 * chain.n + i] = start[a] if i == first else total
        for k in range(kt):
            new[k] = tensions[i, k, column] if column >= 0 else 0.0
            for j in range(constant):
                new[k] += tensions[i, k, j] * u[j]
        x, y = out[2 * i], out[2 * i + 1]
        for k in range(kt):
            u[k] = new[k]
        u[kt], u[kt + 1] = x, y
        if turn - kt == 3:
            u[kt + 2] = twist
        for j in range(turn, constant):
            turns = TURNS + 3 * (j - turn)
            u[j] += row[turns] * x + row[turns + 1] * y + row[turns + 2] * twist


@compiled
def yielding(pivot):
    """Bend (x, y) in which the energy falls: eigenvector of a pivot's lower eigenvalue."""
    a, b, c, d, _, _, _ = pivot
    both = 0.5 * (b + c)
    low = 0.5 * (a + d) - math.sqrt(0.25 * (a - d) * (a - d) + both * both)
    if both == 0.0:
        return (1.0, 0.0) if a <= d else (0.0, 1.0)
    return both, low - a


@compiled
def yielding_to(chain, pivot, wanted):
    """Bend and twist in which the energy falls, to the side of bends wanted (n, 2) if can be."""
    a, b, c, d, twist, by_x, by_y = pivot
    x, y, bends = 0.0, 0.0, floats(wanted)
    if not twist > 0.0:
        return 0.0, 0.0, 1.0
    for i in range(chain.n):
        x += bends[2 * i]
        y += bends[2 * i + 1]
    if a * x * x + (b + c) * x * y + d * y * y < 0.0:
        size = math.sqrt(x * x + y * y)
        x, y = x / size, y / size
    else:
        x, y = yielding(pivot)
    return x, y, by_x * x + by_y * y


@entry(RESPOND)
def respond(chain, bend, rates, count, work, past, ways, pulls):
    """
    Fill how a state, whose moments `work` holds, balances rates of the residual (count, u).

    `ways` (count, u): minus the inverse Jacobian of the residual times the rates. Returns the
    first cell from the tip whose pivot is not positive, -1 if none: the equilibrium is stable.
    With `count` 0 and such a cell, `ways` (u,), if it is not 0, is a direction in which the energy
    falls, to the side of what it held: that cell yields, all beyond it follow.

    Parameters
    ----------
    bend : address
        State [rad].
    rates : address
        (count, u) [rad per unit]
    count : int
    ways : address
        (count, u) [rad per unit]
    pulls : address
        Takes how the state follows the tension of every tendon at the base (k, u) [rad/N], where
        there is friction: what comes into the first cell needs no right-hand side. 0: not asked.

    """
    tangent = np.zeros(tangent_size(chain.n, chain.k))
    derivatives = address(tangent)
    differentiate(chain, bend, work, past, derivatives)
    kt, turn, constant = columns(chain)
    size = turn - kt
    bends = np.zeros((chain.n, size, constant + count))
    tensions = np.empty((chain.n, kt, constant + count))
    for q in range(count):
        rate = floats(rates + 8 * size * chain.n * q)
        for i in range(chain.n):
            bends[i, 0, constant + q], bends[i, 1, constant + q] = -rate[2 * i], -rate[2 * i + 1]
            if size == 3:
                bends[i, 2, constant + q] = -rate[2 * chain.n + i]
    first, pivot = eliminate(chain, derivatives, bends, tensions)
    for q in range(count):
        way = ways + 8 * size * chain.n * q
        start = (0.0, 0.0, 0.0)
        substitute(chain, derivatives, bends, tensions, constant + q, NONE, NONE, start, way)
    if count == 0 and ways != 0 and first >= 0:
        start = yielding_to(chain, pivot, ways)
        substitute(chain, derivatives, bends, tensions, NONE, NONE, first, start, ways)
    if pulls != 0:
        start = (0.0, 0.0, 0.0)
        for k in range(kt):
            way = pulls + 8 * size * chain.n * k
            substitute(chain, derivatives, bends, tensions, NONE, k, NONE, start, way)
    keep(tangent)
    return first
