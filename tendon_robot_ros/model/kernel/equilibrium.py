"""
Equilibrium: the ways to it, in their order.

How many of those that come that far each one finds, of 2.2 million equilibria that diagnoses, real
arms, closed loops and searches for targets ask for:

repeat_sweeps   planar arms, no friction, friction that remembers: 2,016,714 of 2,047,037
march           friction that follows the bend of its own cell, no loads: 104 of 126
solve_stuck     spatial arms whose tendons stick: from a guess 140,591 of 142,652, from a wide slip
                length 16,007 of 16,883, from one that shrinks slowly 55 of 876
newton          what is left of the others: 29,746 of 34,691
continuation    all that is left: 492 of 4,820; most of these have no equilibrium
descend         above the buckling load: it leaves 518 that do not hold

All that `march` needs of a cell is known once those before it are solved. Each is two equations;
together they may be so stiff that no solver of all cells at once ends: the sign of friction of a
tendon across the bend turns with the last digit of the bend.
"""

import math

import numpy as np

from .cells import bend_cell, follows_shape, half_turn, half_turns, twist_in, twist_of, unknowns
from .geometry import shaped_travel
from .layout import (
    BEND_TOLERANCE,
    MARCH,
    SETTLE,
    SLIP_LENGTH,
    YES,
    address,
    compiled,
    descend_at,
    entry,
    floats,
    march_at,
    newton_at,
    residual_at,
    step_at,
)
from .linear import assign, dot, largest, solve_small
from .loads import loaded
from .newton import SAFE_LOAD_SHARE, load_ratio, solve_sliding
from .residual import moment_arms_of, tendon_moment
from .stages import eyelet_acts, friction_travel_acts, memory_acts, offset_scale, torsion_acts
from .sweep import (
    active_stages,
    base_tensions,
    pass_eyelet,
    share_there,
    slip_rate_in,
    tendons_about,
)

# Factors on the slip length, over which the sign of friction is smooth: at the start of a search,
# and from one good step to the next.
SLIP_WIDTH_START, SLIP_WIDTH_FACTORS = 1000.0, (0.3, 0.5)
# steps from a guess, and from a wide slip length; no literals (see `layout`)
GUESSED_STEPS_MAX, WIDE_STEPS_MAX = np.int64(8), np.int64(30)
CONTINUATION_STEPS_MAX = 16  # of the continuation, before there is said to be no equilibrium
CONTINUATION_STRIDE_MIN = 1e-2  # [1] of its way
ANDERSON_DEPTH = 5  # guesses that the acceleration remembers
RESIDUAL_STEP = 1e-7  # [rad] of the differences
RESIDUAL_SOLVED = 1e-13  # [rad] residual of a cell that is solved
MARCH_STEPS_MAX = 30


@compiled
def anderson_step(x, f, steps, changes, used, gram, factor, weights):
    """
    Anderson's next guess: x + f - (steps + changes) weights, weights from least squares.

    Parameters
    ----------
    x, f : ndarray, shape (u,)
        Guess and change of the last sweep [rad]; x becomes the next guess.
    steps, changes : ndarray, shape (ANDERSON_DEPTH, 2n)
        Differences of the last guesses and of their changes [rad].
    used : int
        Rows of them that are filled.
    gram, factor : ndarray, shape (ANDERSON_DEPTH, ANDERSON_DEPTH)
        Inner products of the changes [rad²], and scratch.
    weights : ndarray, shape (ANDERSON_DEPTH,)
        Scratch.

    """
    for p in range(used):
        for q in range(p + 1):
            factor[p, q] = gram[p, q]
        factor[p, p] = gram[p, p] * (1.0 + 1e-14) + 1e-300
        weights[p] = dot(changes[p], f)
    solve_small(factor, weights, used)
    for j in range(x.shape[0]):
        x[j] += f[j]
    for p in range(used):
        weight = weights[p]
        for j in range(x.shape[0]):
            x[j] -= weight * (steps[p, j] + changes[p, j])


@compiled
def repeat_sweeps(chain, inputs, x, work, past, most):
    """Repeat sweeps from a state x, accelerated (Anderson 1965); return the last change [rad]."""
    size, depth = x.shape[0], ANDERSON_DEPTH
    rows, small = np.empty((4 + 2 * depth, size)), np.empty((1 + 2 * depth, depth))
    flat, f, old_x, old_f = rows[0], rows[1], rows[2], rows[3]
    steps, changes = rows[4 : 4 + depth], rows[4 + depth :]
    weights, gram, factor = small[0], small[1 : 1 + depth], small[1 + depth :]
    best, first = math.inf, math.inf
    for turn in range(most):
        step_at(chain.step)(chain, inputs, address(x), work, past, address(flat))
        for j in range(size):
            f[j] = flat[j] - x[j]
        change = largest(f)
        if change < BEND_TOLERANCE:
            assign(x, flat)
            return change
        slow = (turn == 4 and change > 3e-2 * first) or (turn == 9 and change > 1e-2 * first)
        if change > 1e4 * best or change == math.inf or slow:
            return change  # Newton is quicker from where it began
        best = min(best, change)
        if turn == 0:
            first = change
        if turn > 0:
            slot = (turn - 1) % ANDERSON_DEPTH
            for j in range(size):
                steps[slot, j] = x[j] - old_x[j]
                changes[slot, j] = f[j] - old_f[j]
            for p in range(min(turn, ANDERSON_DEPTH)):
                gram[slot, p] = gram[p, slot] = dot(changes[slot], changes[p])
        assign(old_x, x)
        assign(old_f, f)
        anderson_step(x, f, steps, changes, min(turn, ANDERSON_DEPTH), gram, factor, weights)
    return change


@compiled
def is_zero(x):
    """Tell whether every entry is zero."""
    for value in x:
        if value != 0.0:
            return False
    return True


@compiled
def is_planar(chain, x):
    """Tell whether nothing bends the arm across x."""
    for j in range(1, 2 * chain.n, 2):
        if x[j] != 0.0:
            return False
    return True


@compiled
def is_causal(chain):
    """Tell whether nothing beyond a cell decides about it."""
    return not loaded(chain) and not (friction_travel_acts(chain) and eyelet_acts(chain))


@compiled
def step_plainly(chain, inputs, x, work, past):
    """Fill a state x with the one that there is without the effects of shape."""
    floats(work.slip)[2] = 0.0
    step_at(chain.step)(chain, inputs, address(x), work, past, address(x))
    floats(work.slip)[2] = 1.0


@compiled
def begin_again(chain, inputs, x, bend, work, past, cold):
    """Fill x with the state in `bend`, or where there is no guess with the plain one."""
    for j in range(x.shape[0]):
        x[j] = floats(bend)[j]
    if cold:
        step_plainly(chain, inputs, x, work, past)


@compiled
def is_brief(work):
    """Tell whether an equilibrium is looked for only in the quick ways."""
    return floats(work.slip)[3] == 0.0


@compiled
def twist_residual(chain, work, i, x, y, twist):
    """Residual [rad] of the twist of cell i, bent by (x, y), whose tensions are known."""
    s, c = floats(work.half)[2 * i], floats(work.half)[2 * i + 1]
    shaped_travel(chain, i, x, y, s, c, twist, offset_scale(1.0, chain, 0), work)
    return twist - twist_of(chain, i, tendons_about(chain, work, i))


@compiled
def solve_twist(chain, work, state, i, x, y):
    """Newton on the twist of cell i, kept in the state; leaves its moment arms behind."""
    twists = floats(state + 16 * chain.n)
    f = twist_residual(chain, work, i, x, y, twists[i])
    for _ in range(MARCH_STEPS_MAX):
        if abs(f) < RESIDUAL_SOLVED:
            break
        slope = (
            twist_residual(chain, work, i, x, y, twists[i] + RESIDUAL_STEP) - f
        ) / RESIDUAL_STEP
        twists[i] -= f / slope
        f = twist_residual(chain, work, i, x, y, twists[i])


@compiled
def cell_residual(chain, work, past, state, i, last_x, last_y, x, y):
    """
    Residual (x, y) [rad] of cell i, bent by (x, y), behind a cell bent by the last ones.

    Parameters
    ----------
    last_x, last_y : float
        Bend of the cell before [rad], solved already.
    x, y : float
        Bend of this cell [rad].

    """
    half, scale = floats(work.half), offset_scale(1.0, chain, 0)
    half[2 * i], half[2 * i + 1] = half_turn(x * x + y * y)
    if follows_shape(chain):
        twist = twist_in(chain, state, i)
        shaped_travel(chain, i, x, y, half[2 * i], half[2 * i + 1], twist, scale, work)
    moment_arms, factor = moment_arms_of(chain, work)
    if i > 0:
        flags = active_stages(chain, YES)
        ahead = x - last_x, y - last_y
        before, rate = i - 1, slip_rate_in(work)
        passed = share_there(chain, work, before, last_x, last_y, *ahead, flags)
        pass_eyelet(
            chain, work, past, before, last_x, last_y, passed, rate, moment_arms, scale, flags
        )
    if torsion_acts(chain):
        solve_twist(chain, work, state, i, x, y)
    mx, my, total = tendon_moment(chain, work, i, moment_arms, factor)
    bx, by = bend_cell(chain, past, i, mx, my, total)
    return x - bx, y - by


@compiled
def solve_cell_alone(chain, work, past, state, i, last_x, last_y, x, y):
    """
    Newton on the two equations of cell i from (x, y); return its bend.

    Parameters
    ----------
    last_x, last_y : float
        Bend of the cell before [rad].
    x, y : float
        Where the search begins [rad].

    """
    fx, fy = cell_residual(chain, work, past, state, i, last_x, last_y, x, y)
    for _ in range(MARCH_STEPS_MAX):
        if abs(fx) + abs(fy) < RESIDUAL_SOLVED:
            break
        ax, ay = cell_residual(chain, work, past, state, i, last_x, last_y, x + RESIDUAL_STEP, y)
        bx, by = cell_residual(chain, work, past, state, i, last_x, last_y, x, y + RESIDUAL_STEP)
        a, c = (ax - fx) / RESIDUAL_STEP, (ay - fy) / RESIDUAL_STEP
        b, d = (bx - fx) / RESIDUAL_STEP, (by - fy) / RESIDUAL_STEP
        over = 1.0 / (a * d - b * c)
        dx, dy = over * (d * fx - b * fy), over * (a * fy - c * fx)
        share, best = 1.0, abs(fx) + abs(fy)
        for _ in range(12):
            gx, gy = cell_residual(
                chain, work, past, state, i, last_x, last_y, x - share * dx, y - share * dy
            )
            if abs(gx) + abs(gy) < best:
                break
            share *= 0.5
        if not abs(gx) + abs(gy) < best:
            break
        x, y, fx, fy = x - share * dx, y - share * dy, gx, gy
    cell_residual(chain, work, past, state, i, last_x, last_y, x, y)  # leaves its tensions behind
    return x, y


@entry(MARCH)
def march(chain, inputs, bend, work, past):
    """Solve for the state in `bend` from the base to the tip; return the residual [rad]."""
    moment_arms, _ = moment_arms_of(chain, work)
    f, last_x, last_y, x = np.empty(unknowns(chain)), 0.0, 0.0, floats(bend)
    base_tensions(chain, inputs, work, moment_arms)
    for i in range(chain.n):
        last_x, last_y = solve_cell_alone(
            chain, work, past, bend, i, last_x, last_y, x[2 * i], x[2 * i + 1]
        )
        x[2 * i], x[2 * i + 1] = last_x, last_y
    residual_at(chain.residual)(chain, inputs, bend, work, past, address(f))
    return largest(f)


@compiled
def solve_stuck(chain, inputs, x, bend, work, past, cold):
    """
    Solve where tendons may stick: near a guess at once, else from a wide slip length.

    Parameters
    ----------
    inputs : address
        (m,) [N]
    x : ndarray, shape (u,)
        Takes the bends [rad].
    bend : address
        Guess, a state [rad].
    cold : bool
        Whether there is no guess.

    """
    change = math.inf
    begin_again(chain, inputs, x, bend, work, past, cold)
    if not cold:
        change = solve_sliding(chain, inputs, x, work, past, 1.0, 1.0, GUESSED_STEPS_MAX)
    for shrink in SLIP_WIDTH_FACTORS:
        if change < BEND_TOLERANCE or (shrink != SLIP_WIDTH_FACTORS[0] and is_brief(work)):
            break
        step_plainly(chain, inputs, x, work, past)
        change = solve_sliding(
            chain, inputs, x, work, past, SLIP_WIDTH_START, shrink, WIDE_STEPS_MAX
        )
    return change


@compiled
def continuation(chain, inputs, x, work, past):
    """Newton along a path: loads and the sharpness of friction grow together from none."""
    slip = floats(work.slip)
    for j in range(x.shape[0]):
        x[j] = 0.0
    done, stride = 0.0, 0.25
    last = np.zeros(x.shape[0])
    change = math.inf
    for _ in range(CONTINUATION_STEPS_MAX):
        aim = min(1.0, done + stride)
        slip[0] = SLIP_LENGTH * 10.0 ** (3.0 * (1.0 - aim))
        slip[1] = aim
        assign(x, last)
        change = newton_at(chain.newton)(chain, inputs, address(x), work, past, 10)
        if change < BEND_TOLERANCE:
            if aim == 1.0:
                slip[0], slip[1] = SLIP_LENGTH, 1.0
                return change
            done = aim
            assign(last, x)
            stride = min(0.5, 1.6 * stride)
        else:
            stride *= 0.4
            if stride < CONTINUATION_STRIDE_MIN:
                break
    slip[0], slip[1] = SLIP_LENGTH, 1.0
    return max(change, 10.0 * BEND_TOLERANCE)


@compiled
def solve_smooth(chain, inputs, x, bend, work, past, cold):
    """
    Newton from the guess, or cell by cell.

    Parameters
    ----------
    inputs : address
        (m,) [N]
    x : ndarray, shape (u,)
        Takes the bends [rad].
    bend : address
        Guess, a state [rad].
    cold : bool
        Whether there is no guess.

    """
    begin_again(chain, inputs, x, bend, work, past, cold)
    if is_causal(chain):
        change = march_at(chain.march)(chain, inputs, address(x), work, past)
        if change < BEND_TOLERANCE:
            return change
        begin_again(chain, inputs, x, bend, work, past, cold)
    return newton_at(chain.newton)(chain, inputs, address(x), work, past, 12)


@entry(SETTLE)
def solve_equilibrium(chain, inputs, work, past, bend):
    """
    Find the equilibrium for input tensions (m,) [N] from the state [rad] in `bend`.

    Returns the last change [rad]: above `BEND_TOLERANCE` there is no equilibrium and the state
    means nothing. work.tensions are those of the equilibrium.
    """
    size, bends = unknowns(chain), floats(bend)
    x = np.empty(size)
    for j in range(size):
        x[j] = bends[j]
    cold = is_zero(x) and not memory_acts(chain)
    if cold:  # nothing known: begin without the effects of shape
        step_plainly(chain, inputs, x, work, past)
    swept, change = False, math.inf
    if memory_acts(chain) or not eyelet_acts(chain) or is_planar(chain, x):
        change = repeat_sweeps(chain, inputs, x, work, past, 25)
        swept = change < BEND_TOLERANCE
    if not swept and friction_travel_acts(chain) and eyelet_acts(chain) and not memory_acts(chain):
        change = solve_stuck(chain, inputs, x, bend, work, past, cold)
    elif not swept:
        change = solve_smooth(chain, inputs, x, bend, work, past, cold)
    if not change < BEND_TOLERANCE and not is_brief(work):
        change = continuation(chain, inputs, x, work, past)
    if change < BEND_TOLERANCE and loaded(chain):
        ratio = load_ratio(chain)
        if ratio > SAFE_LOAD_SHARE:
            descend_at(chain.descend)(chain, inputs, address(x), work, past, ratio)
            swept = False
    if not swept:
        step_at(chain.step)(chain, inputs, address(x), work, past, bend)
        half_turns(chain, address(x), work)
    for j in range(size):
        bends[j] = x[j]
    return change
