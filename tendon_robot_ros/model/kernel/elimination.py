"""
The linear equations of the chain: what balances a change, and whether an equilibrium is stable.

The changes u of the tensions, of bend and twist before, and of rotation and place of the frame
pass towards the tip, the changes w of the travel beyond an eyelet and of the loads' torque and
force towards the base (place and force only where something pushes the arm at a place). At every
cell, all cells beyond it answer u with w = S u + h. Eliminating a cell, with all cells beyond it,
gives the S of the cell before; back-substitution runs from the base to the tip.
The work grows linearly with the cells. A pivot that is not positive means an unstable equilibrium.
"""

import math
from collections import namedtuple

import numpy as np

from . import layout, stages
from . import linearisation as part
from .cells import coordinates
from .layout import add_row, address, compiled, entry, floats, inlined, keep, solve_rows, words
from .linearisation import differentiate, pushed_part, tangent_of, tangent_width, tendon_part
from .loads import loaded

# System: sizes and addresses of the equations. Columns: the tensions that come in (kt of them, if
# there is friction), from `own` on bend and twist before, from `frame` on the rotation of the
# frame (if there are loads) and its place (if something pushes there), from `right` on the
# right-hand sides; `width` in all; of the loads as many rows as columns, `right - frame`: torque
# and force. Of every cell the changes
#   bends    (2 or 3, width)  of bend and twist; holds the right-hand sides before
#   tensions (kt, width)      of the tensions
# and, of the cell at hand,
#   answers  (2, kt + 6, width)  S and h of what lies beyond it, and of what lies beyond its start
#   by_own   (kt + 6, 3)         how what lies beyond answers the cell's own bend and twist
#   direct   (kt, 3)             part of the tensions by bend and twist of the cell
#   pivot    (3, 3)              derivative of the cell's residual, all beyond eliminated
#   matrix, side                 equations of tendons that slide together
#   first    (kt,) int           first cell from which on a tendon's travel matters before it
#   active   (kt,) int           tendons that slide together
# In all that follows `row` is the address of the derivatives of cell i (see `layout`); `s` and
# `out` are those of what lies beyond the cell, and of what lies beyond its start.
System = namedtuple(
    'System',
    'kt frame right width bends tensions answers by_own direct pivot matrix side first active',
)
System.__name__ += '_' + __name__.partition('.')[0].rpartition('_')[2]


@compiled
def system_in(chain, count, start):
    """Lay the equations out from an address on, at which zeros stand."""
    kt = chain.k if stages.eyelet_acts(chain) else 0
    frame = kt + coordinates(chain)
    loads = 0  # changes of the loads that pass a cell: of torque, and of force at a place
    if loaded(chain):
        loads = 6 if stages.push_acts(chain) else 3
    right = frame + loads
    width = right + count
    tensions = start + 8 * chain.n * (frame - kt) * width
    answers = tensions + 8 * chain.n * kt * width
    by_own = answers + 16 * (kt + loads) * width
    direct = by_own + 24 * (kt + loads)
    pivot = direct + 24 * kt
    matrix = pivot + 72
    side = matrix + 8 * kt * kt
    first = side + 8 * kt * (width + 3) + 8 * right
    columns = (kt, frame, right, width, start, tensions)
    blocks = (answers, by_own, direct, pivot, matrix, side, first, first + 8 * kt)
    return System(*(columns + blocks))


@compiled
def answer_own(system, row, s):
    """Fill by_own: the answer of all beyond a cell to its own bend and twist."""
    kt, frame, width = system.kt, system.frame, system.width
    own, loads = floats(system.by_own), system.right - frame
    for r in range(kt + loads):
        answers = floats(s + 8 * width * r)
        for a in range(frame - kt):
            total = answers[kt + a]
            for m in range(loads):  # behind the rows of ROTATIONS are those of SHIFTS
                total += answers[frame + m] * floats(row)[part.ROTATIONS + 3 * m + a]
            own[3 * r + a] = total


@compiled
def pass_tensions(chain, system, i, row, s):
    """
    Fill the changes of the tensions in cell i, and apart from them their part by its own bend.

    A tendon about to slide at the eyelet before the cell feels all travel beyond: the answers `s`
    and by_own say how much there is.
    """
    kt, width, tendon = system.kt, system.width, words(chain.tendon)
    active, count = words(system.active), layout.ZERO
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
        slopes = tendon_part(row, k)
        change[k] = slopes[part.PASSED]
        if slopes[part.LAGS] != 0.0:
            change[width - 1] = slopes[part.LAGS]  # in the last right-hand side
        for a in range(system.frame - kt):
            change[kt + a] = slopes[part.BEFORE + a]
            direct[a] = slopes[part.WITHIN + a] + slopes[part.SLIDES] * slopes[part.TRAVELS + a]
        if slopes[part.SLIDES] != 0.0:
            active[count] = k
            count += 1
    if count > 0:
        slide_together(system, i, row, s, count)


@compiled
def slide_together(system, i, row, s, count):
    """Solve for the changes of the tensions of active tendons, which feel each other's travel."""
    kt, width, own = system.kt, system.width, system.frame - system.kt
    active, matrix = words(system.active), floats(system.matrix)
    changes, all_direct = system.tensions + 8 * width * kt * i, floats(system.direct)
    for p in range(count):
        k = active[p]
        slides = tendon_part(row, k)[part.SLIDES]
        answers, change = floats(s + 8 * width * k), floats(changes + 8 * width * k)
        at = system.side + 8 * (width + own) * p
        side = floats(at)
        for j in range(width):
            side[j] = change[j] + (slides * answers[j] if j >= system.frame else 0.0)
        for a in range(own):
            side[width + a] = all_direct[3 * k + a] + slides * floats(system.by_own)[3 * k + a]
        q = 0
        for other in range(kt):
            factor = slides * answers[other]
            if q < count and active[q] == other:
                matrix[count * p + q] = (1.0 if p == q else 0.0) - factor
                q += 1
            elif factor != 0.0:
                add_row(at, factor, changes + 8 * width * other, layout.ZERO, width)
                for a in range(own):
                    side[width + a] += factor * all_direct[3 * other + a]
    solved = solve_rows(system.matrix, system.side, count, width + own)
    for p in range(count):
        side = floats(system.side + 8 * (width + own) * p)
        change = floats(changes + 8 * width * active[p])
        for j in range(width):
            change[j] = side[j] if solved else math.nan
        for a in range(own):
            all_direct[3 * active[p] + a] = side[width + a]


@inlined
def moved_by(row, m, a):
    """Component m of how far the end of a cell moves when its start turns about axis a [m/rad]."""
    if m == a:
        return 0.0
    reach = row[part.REACH + 3 - m - a]
    return reach if (a + 1) % 3 != m else -reach


@compiled
def answer_pushes(chain, system, i, row, s):
    """Add to S what the push on the end of a cell answers; then say all by the cell's start."""
    kt, frame, width = system.kt, system.frame, system.width
    slopes = pushed_part(chain, row)
    for r in range(6):
        answers = floats(s + 8 * width * (kt + r))
        for c in range(6):  # behind the rows of PUSH_TORQUE are those of PUSH_FORCE
            answers[frame + c] += slopes[part.PUSH_TORQUE + 6 * r + c]
    answer_own(system, row, s)
    for r in range(kt + 6):
        answers = floats(s + 8 * width * r)
        for a in range(3):
            by_place, reach = answers[frame + 3 + a], slopes[part.REACH + a]
            for k in range(kt):
                if i < words(chain.tendon)[2 * k]:
                    answers[k] += by_place * reach * slopes[part.GROWS]
            for m in range(3):
                answers[frame + a] += answers[frame + 3 + m] * moved_by(slopes, m, a)


@compiled
def gather_cell(chain, system, i, row, s):
    """Fill the pivot of cell i, and move all outside it to its right-hand sides."""
    kt, frame, width, size = (system.kt, system.frame, system.width, system.frame - system.kt)
    pivot, loads = floats(system.pivot), system.right - frame
    changes, bends = system.tensions + 8 * width * kt * i, system.bends + 8 * width * size * i
    for q in range(9):
        pivot[q] = floats(row)[part.ACROSS * (q // 3) + q % 3]
    for k in range(kt):
        if i >= words(chain.tendon)[2 * k]:
            continue
        for a in range(size):
            residual = floats(row + 8 * part.ACROSS * a)
            factor = tendon_part(row, k)[part.BY_TENSION + a]
            for m in range(loads):  # behind BY_TORQUE is BY_FORCE
                factor += residual[part.BY_TORQUE + m] * floats(s)[width * (kt + m) + k]
            for b in range(size):
                pivot[3 * a + b] += factor * floats(system.direct)[3 * k + b]
            add_row(bends + 8 * width * a, -factor, changes + 8 * width * k, layout.ZERO, width)
    for a in range(size):
        residual = floats(row + 8 * part.ACROSS * a)
        for m in range(loads):
            factor = residual[part.BY_TORQUE + m]
            for b in range(size):
                pivot[3 * a + b] += factor * floats(system.by_own)[3 * (kt + m) + b]
            if m < 3:
                floats(bends)[width * a + frame + m] -= residual[part.BY_ROTATION + m]
            add_row(bends + 8 * width * a, -factor, s + 8 * width * (kt + m), frame, width)


@compiled
def solve_cell(system, i):
    """
    Solve for the changes of bend and twist of cell i from its pivot and right-hand sides.

    The twist goes first: the pivot then holds that of the bend without it, the twist's own in its
    last entry, and before it how the twist follows the bend.
    """
    width, size, pivot = system.width, system.frame - system.kt, floats(system.pivot)
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
    kt, width, size = system.kt, system.width, system.frame - system.kt
    bends = system.bends + 8 * width * size * i
    for k in range(kt):
        if i < words(chain.tendon)[2 * k]:
            for a in range(size):
                factor = floats(system.direct)[3 * k + a]
                if factor != 0.0:
                    at = system.tensions + 8 * width * (kt * i + k)
                    add_row(at, factor, bends + 8 * width * a, layout.ZERO, width)


@compiled
def answer_row(system, i, r, s, extra, out):
    """Fill row r of the next S; `extra` (3,): direct parts of bend and twist of the cell."""
    kt, frame, width, size = (system.kt, system.frame, system.width, system.frame - system.kt)
    answers, next_answers = floats(s + 8 * width * r), floats(out + 8 * width * r)
    for j in range(width):
        next_answers[j] = answers[j] if j >= frame else 0.0
    for a in range(size):
        factor = floats(system.by_own)[3 * r + a] + extra[a]
        bends = system.bends + 8 * width * (size * i + a)
        add_row(out + 8 * width * r, factor, bends, layout.ZERO, width)
    for k in range(kt):
        if answers[k] != 0.0:
            at = system.tensions + 8 * width * (kt * i + k)
            add_row(out + 8 * width * r, answers[k], at, layout.ZERO, width)


@compiled
def answer(chain, system, i, row, s, out):
    """Fill the next S from that of cell i."""
    kt, frame, width = system.kt, system.frame, system.width
    slopes, tendon = floats(row), words(chain.tendon)
    for k in range(kt):
        if words(system.first)[k] <= i < tendon[2 * k]:
            row_k = tendon_part(row, k)
            extra = (row_k[part.TRAVELS], row_k[part.TRAVELS + 1], row_k[part.TRAVELS + 2])
            answer_row(system, i, k, s, extra, out)
        else:
            for j in range(width):
                floats(out)[width * k + j] = 0.0
    loads = system.right - frame
    for m in range(min(loads, 3)):
        at = part.TORQUE_BY_OWN + 3 * m
        extra = (slopes[at], slopes[at + 1], slopes[at + 2])
        for k in range(kt):
            if i < tendon[2 * k]:
                pulls = tendon_part(row, k)[part.PULLS + m]
                floats(s)[width * (kt + m) + k] += pulls
        answer_row(system, i, kt + m, s, extra, out)
        at = part.TORQUE_BY_ROTATION + 3 * m
        for a in range(3):
            floats(out)[width * (kt + m) + frame + a] += slopes[at + a]
    for m in range(loads - 3):
        answer_row(system, i, kt + 3 + m, s, (0.0, 0.0, 0.0), out)
        for a in range(3):
            factor = pushed_part(chain, row)[part.TORQUE_BY_FORCE + 3 * a + m]
            source = out + 8 * width * (kt + 3 + m)
            add_row(out + 8 * width * (kt + a), factor, source, layout.ZERO, width)


@compiled
def eliminate(chain, system, tangent):
    """
    Eliminate the cells from the tip to the base.

    Returns the first cell from the tip whose pivot is not positive, that pivot of the bend (4,),
    and the pivot of the twist and how it follows the bend (3,); -1 if all are: the equilibrium is
    then stable.
    """
    unstable, pivot = -1, (1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
    step = 8 * (system.kt + system.right - system.frame) * system.width
    s, out, own = system.answers, system.answers + step, floats(system.pivot)
    for q in range((system.kt + system.right - system.frame) * system.width):
        floats(s)[q] = 0.0
    for k in range(system.kt):
        words(system.first)[k] = chain.n
        for i in range(words(chain.tendon)[2 * k] - 1, 0, -1):
            if tendon_part(tangent_of(chain, tangent, i), k)[part.SLIDES] != 0.0:
                words(system.first)[k] = i
    for i in range(chain.n - 1, -1, -1):
        row = tangent_of(chain, tangent, i)
        if system.right == system.frame + 6:
            answer_pushes(chain, system, i, row, s)
        else:
            answer_own(system, row, s)
        pass_tensions(chain, system, i, row, s)
        gather_cell(chain, system, i, row, s)
        solve_cell(system, i)
        if system.frame - system.kt == 2:  # nothing twists
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
def move_frame(chain, system, i, row, own, u):
    """Change rotation, and place, where cell i starts, which u holds, to those where it ends."""
    frame, slopes, more = system.frame, floats(row), pushed_part(chain, row)
    for m in range(system.right - frame - 1, -1, -1):  # the place by the rotation at the start
        at = part.ROTATIONS + 3 * m
        move = slopes[at] * own[0] + slopes[at + 1] * own[1] + slopes[at + 2] * own[2]
        for a in range(3 if m >= 3 else 0):
            move += moved_by(more, m - 3, a) * u[frame + a]
        for k in range(system.kt if m >= 3 else 0):
            if i < words(chain.tendon)[2 * k]:
                move += more[part.REACH + m - 3] * more[part.GROWS] * u[k]
        u[frame + m] += move


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
    kt, frame, right, width = system.kt, system.frame, system.right, system.width
    size, out = frame - kt, floats(solution)
    u, new = floats(system.side), floats(system.answers)
    for j in range(right):
        u[j] = 0.0
    if pulled >= 0:
        u[pulled] = 1.0
    for i in range(chain.n):
        row, own = tangent_of(chain, tangent, i), (0.0, 0.0, 0.0)
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
        move_frame(chain, system, i, row, own, u)


@compiled
def yielding_to(chain, pivot, preferred):
    """Bend and twist in which the energy falls, on the side of preferred bends (n, 2)."""
    a, b, c, d, twist, by_x, by_y = pivot
    x, y, bends = 0.0, 0.0, floats(preferred)
    if not twist > 0.0:
        return 0.0, 0.0, 1.0
    for i in range(chain.n):
        x += bends[2 * i]
        y += bends[2 * i + 1]
    if a * x * x + (b + c) * x * y + d * y * y < 0.0:
        size = math.sqrt(x * x + y * y)
        x, y = x / size, y / size
    else:  # eigenvector of the lower eigenvalue
        both = 0.5 * (b + c)
        x, y = both, 0.5 * (d - a) - math.sqrt(0.25 * (a - d) * (a - d) + both * both)
        if both == 0.0:
            x, y = (1.0, 0.0) if a <= d else (0.0, 1.0)
    return x, y, by_x * x + by_y * y


@entry()
def respond(chain, bend, rates, count, work, past, answers, pulls):
    """
    Fill the response of a state, whose moments `work` holds, to rates of the residual (count, u).

    `answers` (count, u): minus the inverse Jacobian of the residual times the rates. Returns the
    first cell from the tip whose pivot is not positive, -1 if none: the equilibrium is stable.
    With `count` 0 and such a cell, `answers` (u,), if it is not 0, takes a direction in which the
    energy falls, to the side of what it held: that cell yields, all beyond it follow.

    Parameters
    ----------
    bend : address
        State [rad].
    rates : address
        (count, u) [rad per unit]
    count : int
    answers : address
        (count, u) [rad per unit]
    pulls : address
        Takes the derivatives of the state by the tendons' tensions at the base (k, u) [rad/N],
        where there is friction: tensions at the first cell need no right-hand side. 0: omitted.

    """
    tangent = np.zeros(chain.n * tangent_width(chain))
    memory = np.zeros(system_in(chain, count, 0).active // 8 + chain.k)
    derivatives, system = address(tangent), system_in(chain, count, address(memory))
    differentiate(chain, bend, work, past, derivatives)
    size, right, width = system.frame - system.kt, system.right, system.width
    for q in range(count):
        rate = floats(rates + 8 * size * chain.n * q)
        for i in range(chain.n):
            for a in range(size):
                at = 2 * i + a if a < 2 else 2 * chain.n + i
                floats(system.bends)[width * (size * i + a) + right + q] = -rate[at]
    first, pivot = eliminate(chain, system, derivatives)
    start, none = (0.0, 0.0, 0.0), layout.NONE
    for q in range(count):
        answer_at = answers + 8 * size * chain.n * q
        substitute(chain, system, derivatives, right + q, none, none, start, answer_at)
    if count == 0 and answers != 0 and first >= 0:
        yields = yielding_to(chain, pivot, answers)
        substitute(chain, system, derivatives, none, none, first, yields, answers)
    if pulls != 0:
        for k in range(system.kt):
            follows = pulls + 8 * size * chain.n * k
            substitute(chain, system, derivatives, none, k, none, start, follows)
    keep(tangent, memory)
    return first
