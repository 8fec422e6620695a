"""
One cell of the linear equations of the chain: eliminated, with all that lies beyond it.

Towards the tip go the changes u of the tensions, of bend and twist before, and of the turn of the
frame; towards the base the changes w of the travel beyond an eyelet and of the loads' torque. At
every cell, what lies beyond answers u with w = S u + h. Eliminating a cell makes the S of the cell
before; back-substitution runs from the base to the tip. The work grows linearly with the cells.
"""

import math
from collections import namedtuple

from .cells import coordinates
from .layout import (
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
    ZERO,
    compiled,
    floats,
    inlined,
    words,
)
from .linear import solve_rows
from .loads import loaded
from .stages import eyelet_acts

# System: sizes and addresses of the equations. Columns: the tensions that come in (kt of them, if
# there is friction), from `own` on bend and twist before, from `turn` on the turn of the frame (if
# there are loads), from `right` on the right-hand sides; `width` in all. Of every cell the changes
#   bends    (2 or 3, width)  of bend and twist; holds the right-hand sides before
#   tensions (kt, width)      of the tensions
# and, of the cell at hand,
#   answers  (2, kt + 3, width)  S and h of what lies beyond it, and of what lies beyond its start
#   by_own   (kt + 3, 3)         how what lies beyond answers the cell's own bend and twist
#   direct   (kt, 3)             part of the tensions by bend and twist of the cell
#   pivot    (3, 3)              derivative of the cell's residual, all beyond eliminated
#   left, side                   equations of tendons that slide together
#   first    (kt,) int           first cell from which on a tendon's travel matters before it
#   active   (kt,) int           tendons that slide together
# In all that follows `row` is the address of the derivatives of cell i (see `layout`); `s` and
# `out` are those of what lies beyond the cell, and of what lies beyond its start.
System = namedtuple(
    'System',
    'kt turn right width bends tensions answers by_own direct pivot left side first active',
)
System.__name__ += '_' + __name__.partition('.')[0].rpartition('_')[2]


@compiled
def system_size(chain, count):
    """Floats that the equations take, with a number of right-hand sides."""
    k, width = chain.k, chain.k + 6 + count
    return chain.n * (3 + k) * width + 2 * (k + 3) * width + (9 + k) * (k + 3) + k * width + 2 * k


@compiled
def system_in(chain, count, start):
    """Lay the equations out in an array of `system_size` floats that starts as zeros."""
    kt = chain.k if eyelet_acts(chain) else 0
    turn = kt + coordinates(chain)
    right = turn + 3 if loaded(chain) else turn
    width = right + count
    tensions = start + 8 * chain.n * (turn - kt) * width
    answers = tensions + 8 * chain.n * kt * width
    by_own = answers + 16 * (kt + 3) * width
    direct = by_own + 24 * (kt + 3)
    pivot = direct + 24 * kt
    left = pivot + 72
    side = left + 8 * kt * kt
    first = side + 8 * kt * (width + 3)
    return System(
        kt,
        turn,
        right,
        width,
        start,
        tensions,
        answers,
        by_own,
        direct,
        pivot,
        left,
        side,
        first,
        first + 8 * kt,
    )


@inlined
def add_row(target, share, source, begin, width):
    """Add a share of one row to another, from a column on."""
    into, row = floats(target), floats(source)
    for j in range(begin, width):
        into[j] += share * row[j]


@compiled
def answer_own(system, row, s):
    """Fill by_own: how what lies beyond a cell answers its own bend and twist."""
    kt, turn, width = system.kt, system.turn, system.width
    own, loads = floats(system.by_own), turn != system.right
    for r in range(kt + 3 if loads else kt):
        answers = floats(s + 8 * width * r)
        for a in range(turn - kt):
            total = answers[kt + a]
            if loads:
                for m in range(3):
                    total += answers[turn + m] * floats(row)[TURNS + 3 * m + a]
            own[3 * r + a] = total


@compiled
def pass_tensions(chain, system, i, row, s):
    """
    Fill the changes of the tensions in cell i, and apart from them their part by its own bend.

    A tendon about to slide at the eyelet before the cell feels all travel beyond: the answers `s`
    and by_own say how much there is.
    """
    kt, width, tendon = system.kt, system.width, words(chain.tendon)
    active, count = words(system.active), ZERO
    for k in range(kt):
        change = floats(system.tensions + 8 * width * (kt * i + k))
        direct = floats(system.direct + 24 * k)
        for j in range(width):
            change[j] = 0.0
        direct[0], direct[1], direct[2] = 0.0, 0.0, 0.0
        if i == 0:
            change[k] = 1.0  # of what is pulled at the base
        if i == 0 or i >= tendon[2 * k]:
            continue
        here = floats(row + 8 * (SIZE + TENDON * k))
        change[k] = here[PASSED]
        if here[LAGS] != 0.0:
            change[width - 1] = here[LAGS]  # in the last right-hand side
        for a in range(system.turn - kt):
            change[kt + a] = here[BEFORE + a]
            direct[a] = here[HERE + a] + here[SLIDES] * here[TRAVELS + a]
        if here[SLIDES] != 0.0:
            active[count] = k
            count += 1
    if count > 0:
        slide_together(system, i, row, s, count)


@compiled
def slide_together(system, i, row, s, count):
    """Solve for the changes of the tensions of active tendons, which feel each other's travel."""
    kt, width, own = system.kt, system.width, system.turn - system.kt
    active, left = words(system.active), floats(system.left)
    changes, all_direct = system.tensions + 8 * width * kt * i, floats(system.direct)
    for p in range(count):
        k = active[p]
        slides = floats(row + 8 * (SIZE + TENDON * k))[SLIDES]
        answers, change = floats(s + 8 * width * k), floats(changes + 8 * width * k)
        at = system.side + 8 * (width + own) * p
        side = floats(at)
        for j in range(width):
            side[j] = change[j] + (slides * answers[j] if j >= system.turn else 0.0)
        for a in range(own):
            side[width + a] = all_direct[3 * k + a] + slides * floats(system.by_own)[3 * k + a]
        q = 0
        for other in range(kt):
            share = slides * answers[other]
            if q < count and active[q] == other:
                left[count * p + q] = (1.0 if p == q else 0.0) - share
                q += 1
            elif share != 0.0:
                add_row(at, share, changes + 8 * width * other, ZERO, width)
                for a in range(own):
                    side[width + a] += share * all_direct[3 * other + a]
    solved = solve_rows(system.left, system.side, count, width + own)
    for p in range(count):
        side = floats(system.side + 8 * (width + own) * p)
        change = floats(changes + 8 * width * active[p])
        for j in range(width):
            change[j] = side[j] if solved else math.nan
        for a in range(own):
            all_direct[3 * active[p] + a] = side[width + a]


@compiled
def gather_cell(chain, system, i, row, s):
    """Fill the pivot of cell i, and move what comes from outside it to its right-hand sides."""
    kt, turn, width, size = system.kt, system.turn, system.width, system.turn - system.kt
    slopes, pivot, loads = floats(row), floats(system.pivot), turn != system.right
    changes, bends = system.tensions + 8 * width * kt * i, system.bends + 8 * width * size * i
    for q in range(9):
        pivot[q] = slopes[OWN + q]
    for k in range(kt):
        if i >= words(chain.tendon)[2 * k]:
            continue
        for a in range(size):
            share = floats(row + 8 * (SIZE + TENDON * k))[BY_TENSION + a]
            if loads:
                for m in range(3):
                    share += slopes[BY_TORQUE + 3 * a + m] * floats(s)[width * (kt + m) + k]
            for b in range(size):
                pivot[3 * a + b] += share * floats(system.direct)[3 * k + b]
            add_row(bends + 8 * width * a, -share, changes + 8 * width * k, ZERO, width)
    if not loads:
        return
    for a in range(size):
        for m in range(3):
            share = slopes[BY_TORQUE + 3 * a + m]
            for b in range(size):
                pivot[3 * a + b] += share * floats(system.by_own)[3 * (kt + m) + b]
            floats(bends)[width * a + turn + m] -= slopes[BY_TURN + 3 * a + m]
            add_row(bends + 8 * width * a, -share, s + 8 * width * (kt + m), turn, width)


@compiled
def solve_cell(system, i):
    """
    Solve for the changes of bend and twist of cell i, whose pivot and right-hand sides are there.

    The twist goes first: the pivot then holds what is left of the bend, the twist's own in its
    last entry, and before it how the twist follows the bend.
    """
    width, size, pivot = system.width, system.turn - system.kt, floats(system.pivot)
    x = floats(system.bends + 8 * width * size * i)
    if size == 3:
        pivot[6], pivot[7] = -pivot[6] / pivot[8], -pivot[7] / pivot[8]
        for j in range(width):
            x[2 * width + j] /= pivot[8]
        for a in range(2):
            pivot[3 * a] += pivot[3 * a + 2] * pivot[6]
            pivot[3 * a + 1] += pivot[3 * a + 2] * pivot[7]
            for j in range(width):
                x[width * a + j] -= pivot[3 * a + 2] * x[2 * width + j]
    a, b, c, d = pivot[0], pivot[1], pivot[3], pivot[4]
    scale = 1.0 / (a * d - b * c)
    for j in range(width):
        u, v = x[j], x[width + j]
        x[j], x[width + j] = scale * (d * u - b * v), scale * (a * v - c * u)
    if size == 3:
        for j in range(width):
            x[2 * width + j] += pivot[6] * x[j] + pivot[7] * x[width + j]


@compiled
def complete_tensions(chain, system, i):
    """Add to the changes of the tensions in cell i those that its own bend and twist make."""
    kt, width, size = system.kt, system.width, system.turn - system.kt
    bends = system.bends + 8 * width * size * i
    for k in range(kt):
        if i < words(chain.tendon)[2 * k]:
            for a in range(size):
                share = floats(system.direct)[3 * k + a]
                if share != 0.0:
                    at = system.tensions + 8 * width * (kt * i + k)
                    add_row(at, share, bends + 8 * width * a, ZERO, width)


@compiled
def answer_row(system, i, r, s, extra, out):
    """Fill row r of the next S; `extra` (3,): what bend and twist of the cell add themselves."""
    kt, turn, width, size = system.kt, system.turn, system.width, system.turn - system.kt
    answers, next_answers = floats(s + 8 * width * r), floats(out + 8 * width * r)
    for j in range(width):
        next_answers[j] = answers[j] if j >= turn else 0.0
    for a in range(size):
        share = floats(system.by_own)[3 * r + a] + extra[a]
        add_row(out + 8 * width * r, share, system.bends + 8 * width * (size * i + a), ZERO, width)
    for k in range(kt):
        if answers[k] != 0.0:
            at = system.tensions + 8 * width * (kt * i + k)
            add_row(out + 8 * width * r, answers[k], at, ZERO, width)


@compiled
def answer(chain, system, i, row, s, out):
    """Fill the next S from that of cell i."""
    kt, turn, width = system.kt, system.turn, system.width
    slopes, tendon = floats(row), words(chain.tendon)
    for k in range(kt):
        if words(system.first)[k] <= i < tendon[2 * k]:
            here = floats(row + 8 * (SIZE + TENDON * k))
            extra = (here[TRAVELS], here[TRAVELS + 1], here[TRAVELS + 2])
            answer_row(system, i, k, s, extra, out)
        else:
            for j in range(width):
                floats(out)[width * k + j] = 0.0
    if turn == system.right:
        return
    for m in range(3):
        at = TORQUE_BY_OWN + 3 * m
        extra = (slopes[at], slopes[at + 1], slopes[at + 2])
        for k in range(kt):
            if i < tendon[2 * k]:
                pulls = floats(row + 8 * (SIZE + TENDON * k))[PULLS + m]
                floats(s)[width * (kt + m) + k] += pulls
        answer_row(system, i, kt + m, s, extra, out)
        for a in range(3):
            floats(out)[width * (kt + m) + turn + a] += slopes[TORQUE_BY_TURN + 3 * m + a]
