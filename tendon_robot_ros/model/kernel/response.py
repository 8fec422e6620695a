"""
How bends and twists respond to what moves the equilibrium: linear equations, tip to base.

Eliminating a cell (`elimination`) makes what the cell before meets; back-substitution runs from
the base to the tip. A pivot that is not positive means an unstable equilibrium.
"""

import math

import numpy as np

from .elimination import (
    answer,
    answer_own,
    complete_tensions,
    gather_cell,
    pass_tensions,
    solve_cell,
    system_in,
    system_size,
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
from .tangent import differentiate


@compiled
def note_first_slides(chain, system, tangent):
    """Fill the first cell from which on a tendon's travel matters to an eyelet before it."""
    first, tendon = words(system.first), words(chain.tendon)
    for k in range(system.kt):
        first[k] = chain.n
        for i in range(1, tendon[2 * k]):
            if floats(tangent_of(chain, tangent, i) + 8 * (SIZE + TENDON * k))[SLIDES] != 0.0:
                first[k] = i
                break


@compiled
def eliminate(chain, system, tangent):
    """
    Eliminate the cells from the tip to the base.

    Returns the first cell from the tip whose pivot is not positive, that pivot of the bend (4,),
    and the pivot of the twist and how it follows the bend (3,); -1 if all are: the equilibrium is
    then stable.
    """
    unstable, pivot = -1, (1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
    step = 8 * (system.kt + 3) * system.width
    s, out, own = system.answers, system.answers + step, floats(system.pivot)
    for q in range((system.kt + 3) * system.width):
        floats(s)[q] = 0.0
    note_first_slides(chain, system, tangent)
    for i in range(chain.n - 1, -1, -1):
        row = tangent_of(chain, tangent, i)
        answer_own(system, row, s)
        pass_tensions(chain, system, i, row, s)
        gather_cell(chain, system, i, row, s)
        solve_cell(system, i)
        if system.turn - system.kt == 2:  # nothing twists
            own[6], own[7], own[8] = 0.0, 0.0, 1.0
        both = own[1] + own[3]
        positive = own[0] > 0.0 and own[0] * own[4] > 0.25 * both * both and own[8] > 0.0
        if unstable < 0 and not positive:
            unstable, pivot = i, (own[0], own[1], own[3], own[4], own[8], own[6], own[7])
        complete_tensions(chain, system, i)
        answer(chain, system, i, row, s, out)
        s, out = out, s
    return unstable, pivot


@compiled
def substitute(chain, system, tangent, column, pulled, first, start, solution):
    """
    Fill a solution (u,) at an address by back-substitution, base to tip.

    That of the right-hand side in a column; or, with `column` -1, how the cells beyond
    cell `first` follow when that moves by `start` (x, y, twist) and those before it stay.

    Parameters
    ----------
    tangent : address
        Derivatives of the cells.
    column, first : int
    start : tuple of float
        Bend and twist (3,) [rad].
    solution : address
        Takes (u,) [rad per unit].

    """
    kt, turn, right, width = system.kt, system.turn, system.right, system.width
    size, out = turn - kt, floats(solution)
    u, new = floats(system.side), floats(system.answers)
    for j in range(right):
        u[j] = 0.0
    if pulled >= 0:
        u[pulled] = 1.0
    for i in range(chain.n):
        row, own = floats(tangent_of(chain, tangent, i)), (0.0, 0.0, 0.0)
        for r in range(size + kt):
            at = system.bends + 8 * width * (size * i + r)
            if r >= size:
                at = system.tensions + 8 * width * (kt * i + r - size)
            total = floats(at)[column] if column >= 0 else 0.0
            for j in range(right):
                total += floats(at)[j] * u[j]
            new[r] = total
        own = (new[0], new[1], new[2] if size == 3 else 0.0)
        if i == first:
            own = start
        for k in range(kt):
            u[k] = new[size + k]
        for a in range(2):
            out[2 * i + a] = u[kt + a] = own[a]
        if size == 3:
            out[2 * chain.n + i] = u[kt + 2] = own[2]
        for m in range(right - turn):
            at = TURNS + 3 * m
            u[turn + m] += row[at] * own[0] + row[at + 1] * own[1] + row[at + 2] * own[2]


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
    memory = np.zeros(system_size(chain, count))
    derivatives, system = address(tangent), system_in(chain, count, address(memory))
    differentiate(chain, bend, work, past, derivatives)
    size, right, width = system.turn - system.kt, system.right, system.width
    for q in range(count):
        rate = floats(rates + 8 * size * chain.n * q)
        for i in range(chain.n):
            for a in range(size):
                at = 2 * i + a if a < 2 else 2 * chain.n + i
                floats(system.bends)[width * (size * i + a) + right + q] = -rate[at]
    first, pivot = eliminate(chain, system, derivatives)
    start = (0.0, 0.0, 0.0)
    for q in range(count):
        way = ways + 8 * size * chain.n * q
        substitute(chain, system, derivatives, right + q, NONE, NONE, start, way)
    if count == 0 and ways != 0 and first >= 0:
        yields = yielding_to(chain, pivot, ways)
        substitute(chain, system, derivatives, NONE, NONE, first, yields, ways)
    if pulls != 0:
        for k in range(system.kt):
            way = pulls + 8 * size * chain.n * k
            substitute(chain, system, derivatives, NONE, k, NONE, start, way)
    keep(tangent)
    keep(memory)
    return first
