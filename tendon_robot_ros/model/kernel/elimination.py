"""
One cell of the linear equations of the chain: eliminated, with all that lies beyond it.

Towards the tip go the changes u of the tensions, of bend and twist before, and of the turn of the
frame; towards the base the changes w of the travel beyond an eyelet and of the loads' torque. At
every cell, what lies beyond answers u with w = S u + h. Eliminating a cell makes the S of the cell
before; back-substitution runs from the base to the tip. The work grows linearly with the cells.
"""

import math

import numpy as np

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
    compiled,
    floats,
    tangent_of,
    words,
)
from .linear import fill, solve_rows
from .loads import loaded
from .stages import eyelet_acts
from .twisting import coordinates


@compiled
def columns(chain):
    """Columns of the tensions; where those of the frame's turn begin, where the constants do."""
    tensions = chain.k if eyelet_acts(chain) else 0
    turn = tensions + coordinates(chain)
    return tensions, turn, turn + 3 if loaded(chain) else turn


@compiled
def pass_tensions(chain, tangent, i, s, by_own, tensions, direct):
    """
    Fill the changes of the tensions in cell i (k, width) and their part by the own bend (k, 3).

    A tendon about to slide at the eyelet before the cell feels all travel beyond: s (rows, width)
    and by_own (rows, 3) say how that answers.

    Parameters
    ----------
    tangent : address
        Derivatives of the cells, see `tangent`.
    i : int
    s : ndarray, shape (k + 3, width)
        How what lies beyond the cell answers what comes into it.
    by_own : ndarray, shape (k + 3, 3)
        And how it answers the cell's own bend and twist.
    tensions : ndarray, shape (n, k, width)
        Takes the changes in row i [N per unit].
    direct : ndarray, shape (k, 3)
        Takes their part by bend and twist of the cell [N/rad].

    """
    kt, turn, _ = columns(chain)
    tendon, width = words(chain.tendon), tensions.shape[2]
    active, count = np.empty(kt, np.int64), 0
    for k in range(kt):
        for j in range(width):
            tensions[i, k, j] = 0.0
        direct[k, 0], direct[k, 1], direct[k, 2] = 0.0, 0.0, 0.0
        if i == 0:
            tensions[i, k, k] = 1.0  # of what is pulled at the base
        if i == 0 or i >= tendon[2 * k]:
            continue
        here = floats(tangent_of(chain, tangent, i) + 8 * (SIZE + TENDON * k))
        tensions[i, k, k] = here[PASSED]
        if here[LAGS] != 0.0:
            tensions[i, k, width - 1] = here[LAGS]  # the only right-hand side
        for a in range(turn - kt):
            tensions[i, k, kt + a] = here[BEFORE + a]
            direct[k, a] = here[HERE + a] + here[SLIDES] * here[TRAVELS + a]
        if here[SLIDES] != 0.0:
            active[count] = k
            count += 1
    if count > 0:
        slide_together(chain, tangent, i, s, by_own, tensions, direct, active[:count])


@compiled
def slide_together(chain, tangent, i, s, by_own, tensions, direct, active):
    """
    Solve for the changes of the tensions of active tendons, which feel each other's travel.

    Parameters
    ----------
    tangent : address
        Derivatives of the cells, see `tangent`.
    i : int
    s : ndarray, shape (k + 3, width)
        How what lies beyond the cell answers what comes into it.
    by_own : ndarray, shape (k + 3, 3)
        And how it answers the cell's own bend and twist.
    tensions : ndarray, shape (n, k, width)
        Row i holds what comes from before, and takes the result.
    direct : ndarray, shape (k, 3)
        The same by bend and twist of the cell [N/rad].
    active : ndarray
        Indices of the tendons.

    """
    kt, turn, _ = columns(chain)
    count, width, own = active.shape[0], tensions.shape[2], turn - kt
    left, right = np.zeros((count, count)), np.empty((count, width + own))
    is_active = np.zeros(kt, np.bool_)
    for p in range(count):
        is_active[active[p]] = True
    for p in range(count):
        k = active[p]
        slides = floats(tangent_of(chain, tangent, i) + 8 * (SIZE + TENDON * k))[SLIDES]
        for j in range(width):
            right[p, j] = tensions[i, k, j] + (slides * s[k, j] if j >= turn else 0.0)
        for a in range(own):
            right[p, width + a] = direct[k, a] + slides * by_own[k, a]
        for q in range(count):
            left[p, q] = (1.0 if p == q else 0.0) - slides * s[k, active[q]]
        for other in range(kt):
            share = 0.0 if is_active[other] else slides * s[k, other]
            if share != 0.0:
                for j in range(width):
                    right[p, j] += share * tensions[i, other, j]
                for a in range(own):
                    right[p, width + a] += share * direct[other, a]
    if not solve_rows(left, right, count):
        fill(right, math.nan)
    for p in range(count):
        for j in range(width):
            tensions[i, active[p], j] = right[p, j]
        for a in range(own):
            direct[active[p], a] = right[p, width + a]


@compiled
def solve_cell(chain, tangent, i, s, by_own, tensions, direct, bends, twist):
    """
    Fill the changes of bend and twist of cell i, which hold its right-hand sides.

    Returns the cell's pivot, the derivative of its residual with all beyond eliminated.

    Parameters
    ----------
    tangent : address
        Derivatives of the cells, see `tangent`.
    i : int
    s : ndarray, shape (k + 3, width)
        How what lies beyond the cell answers what comes into it.
    by_own : ndarray, shape (k + 3, 3)
        And how it answers the cell's own bend and twist.
    tensions : ndarray, shape (n, k, width)
        Changes of the tensions in row i.
    direct : ndarray, shape (k, 3)
        Their part by bend and twist of the cell [N/rad].
    bends : ndarray, shape (n, 2 or 3, width)
        Row i holds the right-hand sides, and takes the changes [rad per unit].

    """
    kt, turn, constant = columns(chain)
    row, width = floats(tangent_of(chain, tangent, i)), bends.shape[2]
    tendon = words(chain.tendon)
    a, b, c, d = row[OWN], row[OWN + 1], row[OWN + 3], row[OWN + 4]
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
    if turn - kt == 3:
        x, y, u, v = reduce_twist(chain, tangent, i, s, by_own, tensions, direct, bends, twist)
        a, b, c, d = a - x * u, b - x * v, c - y * u, d - y * v
    scale = 1.0 / (a * d - b * c)
    for j in range(width):
        u, v = bends[i, 0, j], bends[i, 1, j]
        bends[i, 0, j], bends[i, 1, j] = scale * (d * u - b * v), scale * (a * v - c * u)
    if turn - kt == 3:
        for j in range(width):
            bends[i, 2, j] += twist[1] * bends[i, 0, j] + twist[2] * bends[i, 1, j]
    return a, b, c, d


@compiled
def reduce_twist(chain, tangent, i, s, by_own, tensions, direct, bends, twist):
    """
    Take the twist of cell i out of the equations of its bend.

    `twist` (3,) becomes its pivot and how it follows the bend (x, y). Returns the derivatives of
    the bend's residual (x, y) by the twist, and those of the twist's by the bend over its pivot.
    """
    kt, turn, constant = columns(chain)
    row, width = floats(tangent_of(chain, tangent, i)), bends.shape[2]
    x, y = row[OWN + 2], row[OWN + 5]
    u, v, pivot = row[OWN + 6], row[OWN + 7], row[OWN + 8]
    for k in range(kt):
        if i >= words(chain.tendon)[2 * k]:
            continue
        here = floats(tangent_of(chain, tangent, i) + 8 * (SIZE + TENDON * k))
        shares = (here[BY_TENSION], here[BY_TENSION + 1], here[BY_TENSION + 2])
        if turn != constant:
            for m in range(3):
                answer_here = s[kt + m, k]
                shares = (
                    shares[0] + row[BY_TORQUE + m] * answer_here,
                    shares[1] + row[BY_TORQUE + 3 + m] * answer_here,
                    shares[2] + row[BY_TORQUE + 6 + m] * answer_here,
                )
        x, y = x + shares[0] * direct[k, 2], y + shares[1] * direct[k, 2]
        u, v = u + shares[2] * direct[k, 0], v + shares[2] * direct[k, 1]
        pivot += shares[2] * direct[k, 2]
        for j in range(width):
            bends[i, 2, j] -= shares[2] * tensions[i, k, j]
    if turn != constant:
        for m in range(3):
            at, share = kt + m, row[BY_TORQUE + 6 + m]
            x += row[BY_TORQUE + m] * by_own[at, 2]
            y += row[BY_TORQUE + 3 + m] * by_own[at, 2]
            u, v = u + share * by_own[at, 0], v + share * by_own[at, 1]
            pivot += share * by_own[at, 2]
            bends[i, 2, turn + m] -= row[BY_TURN + 6 + m]
            for j in range(turn, width):
                bends[i, 2, j] -= share * s[at, j]
    u, v = u / pivot, v / pivot
    twist[0], twist[1], twist[2] = pivot, -u, -v
    for j in range(width):
        bends[i, 2, j] /= pivot
        bends[i, 0, j] -= x * bends[i, 2, j]
        bends[i, 1, j] -= y * bends[i, 2, j]
    return x, y, u, v


@compiled
def complete_tensions(chain, i, direct, bends, tensions):
    """
    Add to the changes of the tensions in cell i those that its own bend and twist make.

    Parameters
    ----------
    direct : ndarray, shape (k, 3)
        Part of the tensions by bend and twist of the cell [N/rad].
    bends : ndarray, shape (n, 2 or 3, width)
        Changes of bend and twist.
    tensions : ndarray, shape (n, k, width)
        Row i holds the changes of what passes from before; takes all.

    """
    kt, turn, _ = columns(chain)
    width = tensions.shape[2]
    for k in range(kt):
        if i < words(chain.tendon)[2 * k]:
            for j in range(width):
                tensions[i, k, j] += direct[k, 0] * bends[i, 0, j] + direct[k, 1] * bends[i, 1, j]
            if turn - kt == 3:
                for j in range(width):
                    tensions[i, k, j] += direct[k, 2] * bends[i, 2, j]


@compiled
def answer_row(chain, i, s, r, by_own, extra, tensions, bends, out):
    """
    Row r of the next S: how what lies beyond a cell's start answers what comes in there.

    Parameters
    ----------
    i, r : int
    s : ndarray, shape (k + 3, width)
        How what lies beyond the cell answers.
    by_own : ndarray, shape (k + 3, 3)
        And how it answers the cell's own bend and twist.
    extra : tuple of float
        What the bend of the cell adds itself (2,).
    tensions, bends : ndarray, shapes (n, k, width) and (n, 2, width)
        Changes by what comes into each cell.
    out : ndarray, shape (k + 3, width)
        The next S.

    """
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
    """
    Fill the next S (rows, width) from that of cell i.

    Parameters
    ----------
    tangent : address
        Derivatives of the cells, see `tangent`.
    i : int
    s : ndarray, shape (k + 3, width)
        How what lies beyond the cell answers what comes into it.
    by_own : ndarray, shape (k + 3, 3)
        And how it answers the cell's own bend and twist.
    tensions, bends : ndarray, shapes (n, k, width) and (n, 2, width)
        Changes by what comes into each cell.
    first : ndarray, shape (k,)
        `first_slides`.
    out : ndarray, shape (k + 3, width)
        The next S.

    """
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
        at = TORQUE_BY_OWN + 3 * m
        extra = (row[at], row[at + 1])
        for k in range(kt):
            if i < tendon[2 * k]:
                here = floats(tangent_of(chain, tangent, i) + 8 * (SIZE + TENDON * k))
                s[kt + m, k] += here[PULLS + m]
        answer_row(chain, i, s, kt + m, by_own, extra, tensions, bends, out)
        for a in range(3):
            out[kt + m, turn + a] += row[TORQUE_BY_TURN + 3 * m + a]


@compiled
def answer_twist(chain, tangent, i, by_own, bends, first, out):
    """Add to the next S what the twist of cell i does."""
    kt, turn, constant = columns(chain)
    row = floats(tangent_of(chain, tangent, i))
    for r in range(kt if turn == constant else kt + 3):
        if r >= kt:
            share = by_own[r, 2] + row[TORQUE_BY_OWN + 3 * (r - kt) + 2]
        elif first[r] <= i < words(chain.tendon)[2 * r]:
            here = floats(tangent_of(chain, tangent, i) + 8 * (SIZE + TENDON * r))
            share = by_own[r, 2] + here[TRAVELS + 2]
        else:
            continue
        for j in range(out.shape[1]):
            out[r, j] += share * bends[i, 2, j]
