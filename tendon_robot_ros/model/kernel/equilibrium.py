"""
Equilibrium: the methods by which it is found, in the order in which they are tried.

How many of those that come that far each one solves, of 2.2 million equilibria that diagnoses,
real arms, closed loops and searches for targets ask for:

repeat_sweeps   planar arms, no friction, friction with memory: 2,016,714 of 2,047,037
march           friction that follows the bend of its own cell, no loads: 104 of 126. Without it 98
                of 300 random postures of `spatial_3` with `tendon_friction` and `straight_tendon`
                are not solved
solve_sticking  spatial arms whose tendons stick: from a guess 140,591 of 142,652, from a large
                smoothing length 16,007 of 16,883, from one that shrinks slowly 55 of 876
newton          what is left of the others: 29,746 of 34,691
continuation    all that is left: 492 of 4,820; most of these have no equilibrium
descend         above the buckling load: it leaves 518 that are unstable
"""

import math

import numpy as np

from . import layout, stages
from .cells import (
    bend_cell,
    cell_stiffness,
    follows_shape,
    half_turn,
    half_turns,
    twist_in,
    twist_of,
    unknowns,
)
from .geometry import shaped_travel
from .layout import (
    address,
    assign,
    cell,
    compiled,
    copy,
    dot,
    entry,
    floats,
    keep,
    largest,
    solve_small,
    words,
)
from .loads import at_tip, loaded, pushed, weight
from .sweep import (
    active_stages,
    axial_moment_on,
    base_tensions,
    moment_arms_of,
    moment_on,
    pass_eyelet,
    ratio_at,
    slip_rate_in,
)

ANDERSON_DEPTH = 5  # [1] last guesses that are combined; more would combine rounding errors
STEP_MAX_RAD = 1.0  # [rad] of a bend in one step, because slopes here tell nothing beyond
# [1] on the smoothing length after a step that is short enough; measured: the second solves 55 of
# the 876 that the first leaves
SHRINK_FACTORS = (0.3, 0.5)
# [1] sweeps, and steps where kinks of friction cut them short: three times those that the second
# factor takes to 1e-3, because two in three may shrink nothing
KINKED_STEPS_MAX = np.int64(30)
STEP_NEAR_RAD = 1e-4  # [rad] last step, so that Newton converges from there without own travel
SLIP_START_TRAVEL = 3.0  # [1] of a tendon that begins to slip, so that it may stick again
STRIDE_MIN = 1e-2  # [1] of the path of a continuation: shorter ones would take more than 100 steps
# [1] of Euler's load, above which stability is checked: less than the bound of `load_ratio`,
# because rods are uneven
SAFE_LOAD = 0.7
# [1] of gradient descent, because the energy is almost flat just above the buckling load
DESCENT_STEPS_MAX = 5000


@compiled
def residual_size(chain, inputs, bend, work, past, f):
    """Fill f (u,) [rad], the residual at the state in `bend`; return its largest entry."""
    chain.residual(chain, inputs, bend, work, past, address(f))
    return largest(f)


@compiled
def is_planar(chain, x):
    """Tell whether nothing bends the arm across x."""
    for j in range(1, 2 * chain.n, 2):
        if x[j] != 0.0:
            return False
    return True


@compiled
def sweep_unshaped(chain, inputs, x, work, past):
    """Fill a state x with the one that there is without the effects of shape."""
    floats(work.settings)[layout.SHAPED] = 0.0
    chain.step(chain, inputs, address(x), work, past, address(x))
    floats(work.settings)[layout.SHAPED] = 1.0


@compiled
def restart(chain, inputs, x, bend, work, past, cold):
    """Fill x with the guess in `bend`, or without one (`cold`) with the unshaped state."""
    copy(bend, address(x), x.shape[0])
    if cold:
        sweep_unshaped(chain, inputs, x, work, past)


@compiled
def repeat_sweeps(chain, inputs, x, work, past):
    """Repeat sweeps from a state x, accelerated (Anderson 1965); return the last change [rad]."""
    size, depth = x.shape[0], ANDERSON_DEPTH
    rows, small = np.empty((4 + 2 * depth, size)), np.empty((1 + 2 * depth, depth))
    swept, f, old_x, old_f = rows[0], rows[1], rows[2], rows[3]
    steps, changes = rows[4 : 4 + depth], rows[4 + depth :]
    weights, gram, factor = small[0], small[1 : 1 + depth], small[1 + depth :]
    best, first = math.inf, math.inf
    for count in range(KINKED_STEPS_MAX):
        chain.step(chain, inputs, address(x), work, past, address(swept))
        for j in range(size):
            f[j] = swept[j] - x[j]
        change = largest(f)
        if change < layout.BEND_TOLERANCE:
            assign(x, swept)
            return change
        slow = (count == 4 and change > 3e-2 * first) or (count == 9 and change > 1e-2 * first)
        if change > 1e4 * best or change == math.inf or slow:
            return change  # Newton is quicker from where it began
        best = min(best, change)
        first = change if count == 0 else first
        if count > 0:
            slot = (count - 1) % ANDERSON_DEPTH
            for j in range(size):
                steps[slot, j] = x[j] - old_x[j]
                changes[slot, j] = f[j] - old_f[j]
            for p in range(min(count, ANDERSON_DEPTH)):
                gram[slot, p] = gram[p, slot] = dot(changes[slot], changes[p])
        assign(old_x, x)
        assign(old_f, f)
        used = min(count, ANDERSON_DEPTH)  # the next guess: weights by least squares
        for p in range(used):
            for q in range(used):
                factor[p, q] = gram[p, q]
            factor[p, p] = gram[p, p] * (1.0 + 50.0 * layout.EPSILON) + layout.TINY
            weights[p] = dot(changes[p], f)
        solve_small(factor, weights, used)
        for j in range(size):
            x[j] += f[j]
            for p in range(used):
                x[j] -= weights[p] * (steps[p, j] + changes[p, j])
    return change


@compiled
def twist_residual(chain, work, i, x, y, twist):
    """Residual [rad] of the twist of cell i, bent by (x, y), whose tensions are known."""
    s, c = floats(work.half)[2 * i], floats(work.half)[2 * i + 1]
    shaped_travel(chain, i, x, y, s, c, twist, stages.offset_scale(1.0, chain, 0), work)
    return twist - twist_of(chain, i, axial_moment_on(chain, work, i, layout.NO))


@compiled
def solve_twist(chain, work, state, i, x, y):
    """Newton on the twist of cell i, kept in the state; fills its moment arms."""
    twists, h = floats(state + 16 * chain.n), layout.DIFFERENCE_STEP
    f = twist_residual(chain, work, i, x, y, twists[i])
    for _ in range(KINKED_STEPS_MAX):
        if abs(f) < layout.BEND_TOLERANCE:
            break
        twists[i] -= f * h / (twist_residual(chain, work, i, x, y, twists[i] + h) - f)
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
    half, scale = floats(work.half), stages.offset_scale(1.0, chain, 0)
    half[2 * i], half[2 * i + 1] = half_turn(x * x + y * y)
    if follows_shape(chain):
        twist = twist_in(chain, state, i)
        shaped_travel(chain, i, x, y, half[2 * i], half[2 * i + 1], twist, scale, work)
    moment_arms, factor = moment_arms_of(chain, work)
    if i > 0:
        flags, rate, j = active_stages(chain, layout.YES), slip_rate_in(work), i - 1
        passed = ratio_at(chain, work, j, last_x, last_y, x - last_x, y - last_y, flags)
        pass_eyelet(chain, work, past, j, last_x, last_y, passed, rate, moment_arms, scale, flags)
    if stages.torsion_acts(chain):
        solve_twist(chain, work, state, i, x, y)
    mx, my, total = moment_on(chain, work, i, moment_arms, factor, layout.NO)
    bx, by = bend_cell(chain, past, i, mx, my, total, x, y)
    return x - bx, y - by


@entry()
def march(chain, inputs, bend, work, past):
    """
    Solve for the state in `bend`, cell after cell from the base; return the residual [rad].

    For arms in which nothing beyond a cell decides about it. Each cell is two equations, solved by
    Newton. All
    together they may be so stiff that no solver of all cells at once converges: the sign of
    friction of a tendon across the bend changes with the last digit of the bend.
    """
    moment_arms, _ = moment_arms_of(chain, work)
    f, last_x, last_y, x = np.empty(unknowns(chain)), 0.0, 0.0, floats(bend)
    h = layout.DIFFERENCE_STEP
    base_tensions(chain, inputs, work, moment_arms)
    for i in range(chain.n):
        known, (bx, by) = (chain, work, past, bend, i, last_x, last_y), (x[2 * i], x[2 * i + 1])
        fx, fy = cell_residual(*known, bx, by)
        for _ in range(KINKED_STEPS_MAX):
            best = abs(fx) + abs(fy)
            if best < layout.BEND_TOLERANCE:
                break
            ax, ay = cell_residual(*known, bx + h, by)
            cx, cy = cell_residual(*known, bx, by + h)
            a, b, c, d = (ax - fx) / h, (cx - fx) / h, (ay - fy) / h, (cy - fy) / h
            over = 1.0 / (a * d - b * c)
            dx, dy = over * (d * fx - b * fy), over * (a * fy - c * fx)
            for _ in range(layout.STEPS_MAX):
                gx, gy = cell_residual(*known, bx - dx, by - dy)
                if abs(gx) + abs(gy) < best:
                    break
                dx, dy = 0.5 * dx, 0.5 * dy
            if not abs(gx) + abs(gy) < best:
                break
            bx, by, fx, fy = bx - dx, by - dy, gx, gy
        cell_residual(*known, bx, by)  # fills the tensions of this very bend
        x[2 * i], x[2 * i + 1] = last_x, last_y = bx, by
    return residual_size(chain, inputs, bend, work, past, f)


@compiled
def next_travel(z, travel, width, new_width):
    """Travel [m] that an eyelet takes over, from its last one and what the step says it is."""
    s = math.copysign(1.0, z)
    if abs(z) <= layout.CLEAR_TRAVEL * width:
        s = math.tanh(z / width)
        s += (1.0 - s * s) * (travel - z) / width
        if abs(s) < layout.SLIPPING_FROM:
            return new_width * math.atanh(s)
    if s * travel <= 0.0:
        return 0.0
    return math.copysign(max(abs(travel), SLIP_START_TRAVEL * new_width), s)


@compiled
def take_over(chain, bend, work, move, own, width, longest, shrink):
    """
    Move the travel of the eyelets with a step of the bends; return the next smoothing length.

    Parameters
    ----------
    bend : address
        State after the step [rad], whose travel and moment arms `work` takes.
    move : ndarray, shape (u,)
        Step of the bends [rad].
    own : ndarray, shape (4, n, k)
        Travel [m]: the eyelets' own, in the cell and beyond, then the real one, likewise.
    width : float
        Smoothing length now [m].
    longest : float
        Step [rad] that was asked for: after a short one the smoothing length shrinks.
    shrink : float
        Factor on it then [1].

    """
    new_width = width
    if longest < layout.LINEAR_STEP_RAD:
        new_width = max(shrink * width, layout.SMOOTHING_LENGTH)
    tendon, (moment_arms, scale) = words(chain.tendon), moment_arms_of(chain, work)
    lever, twists = floats(moment_arms), stages.torsion_acts(chain)
    for k in range(chain.k):
        total = 0.0
        for i in range(tendon[2 * k] - 1, -1, -1):
            at = 2 * (chain.k * i + k)
            step = scale * (lever[at] * move[2 * i] + lever[at + 1] * move[2 * i + 1])
            if twists:
                step += floats(work.axial)[at // 2] * move[2 * chain.n + i]
            own[0, i, k] = next_travel(own[0, i, k], own[2, i, k] + step, width, new_width)
            own[1, i, k] = next_travel(own[1, i, k], own[3, i, k] + total, width, new_width)
            total += step
    chain.place_travel(chain, bend, work)
    return new_width


@compiled
def exchange(chain, work, own):
    """Put the eyelets' own travel into `work`; keep the real one in own[2:], and the lag."""
    travel, lag, count = floats(work.travel), floats(work.lag), 2 * chain.n * chain.k
    taken, real = floats(address(own)), floats(address(own) + 8 * count)
    for j in range(count):  # behind the travel lies that beyond
        real[j], lag[j], travel[j] = travel[j], travel[j] - taken[j], taken[j]


@compiled
def own_travel(chain, bend, work):
    """Start with the travel that a state gives: (4, n, k) [m], see `take_over`."""
    own = np.zeros((4, chain.n, chain.k))
    chain.place_travel(chain, bend, work)
    copy(work.travel, address(own), 2 * chain.n * chain.k)  # and that beyond, behind it
    return own


@compiled
def end_sliding(chain, work):
    """Let friction follow the travel of the bends again, with its own smoothing length."""
    floats(work.settings)[layout.SMOOTHING] = layout.SMOOTHING_LENGTH
    for j in range(2 * chain.n * chain.k):
        floats(work.lag)[j] = 0.0


@compiled
def solve_sliding(chain, inputs, x, work, past, wide, shrink, steps_max):
    """
    Newton with a state of every eyelet, from bends x (u,); return the last residual [rad].

    Friction follows tanh(travel / smoothing length): between sliding one way and the other lie
    2 µm, and Newton on the bends alone jumps to and fro over them. In a spatial arm half of the
    eyelets stick: tendons pull against each other, and friction there is what the balance asks
    for. So every eyelet has a travel of its own, from which its friction follows, and which may
    lag behind that of the bends; a step solves the linear equations of both. An eyelet that sticks
    takes over the friction that the step gives it, not the travel; one that would need more than
    all friction begins to slip; one that would slip against its friction sticks. That is a
    primal-dual method with the smoothing length as its barrier.

    Parameters
    ----------
    inputs : address
        (m,) [N]
    x : ndarray, shape (u,)
        Bends [rad], guess and result.
    wide : float
        Smoothing length at the start, over SMOOTHING_LENGTH [1].
    shrink : float
        Factor on it after every good step [1].
    steps_max : int

    """
    size = x.shape[0]
    f, move = np.empty(size), np.empty(size)
    own, longest = own_travel(chain, address(x), work), math.inf
    width = wide * layout.SMOOTHING_LENGTH
    for _ in range(steps_max):
        floats(work.settings)[layout.SMOOTHING] = width
        exchange(chain, work, own)
        chain.balance(chain, inputs, address(x), work, past, address(f))
        chain.respond(chain, address(x), address(f), 1, work, past, address(move), 0)
        longest = largest(move)
        if not longest < math.inf:
            break
        fraction = min(1.0, STEP_MAX_RAD / max(longest, layout.TINY))
        for j in range(size):
            move[j] *= fraction
            x[j] += move[j]
        if longest < STEP_NEAR_RAD and width == layout.SMOOTHING_LENGTH:
            break
        width = take_over(chain, address(x), work, move, own, width, longest, shrink)
    end_sliding(chain, work)
    if not longest < STEP_NEAR_RAD:
        return math.inf
    return chain.newton(chain, inputs, address(x), work, past)


@compiled
def solve_sticking(chain, inputs, x, bend, work, past, cold):
    """
    Solve where tendons may stick: near a guess at once, else from a large smoothing length.

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
    restart(chain, inputs, x, bend, work, past, cold)
    if not cold:
        change = solve_sliding(chain, inputs, x, work, past, 1.0, 1.0, layout.STEPS_MAX)
    for shrink in SHRINK_FACTORS:
        quick = floats(work.settings)[layout.EVERY_METHOD] == 0.0 and shrink != SHRINK_FACTORS[0]
        if change < layout.BEND_TOLERANCE or quick:
            break
        sweep_unshaped(chain, inputs, x, work, past)
        change = solve_sliding(
            chain, inputs, x, work, past, layout.WIDE_SMOOTHING, shrink, KINKED_STEPS_MAX
        )
    return change


@entry()
def newton(chain, inputs, bend, work, past):
    """
    Newton on the state with a line search; return the last residual [rad].

    Parameters
    ----------
    inputs, bend : address
        (m,) [N]; state [rad], guess and result.

    """
    size, x = unknowns(chain), floats(bend)
    f, trial_f = np.empty(size), np.empty(size)
    trial, move = np.empty(size), np.empty(size)
    change = residual_size(chain, inputs, bend, work, past, f)
    for _ in range(layout.STEPS_MAX):
        if change < layout.BEND_TOLERANCE or change == math.inf:
            break
        chain.respond(chain, bend, address(f), 1, work, past, address(move), 0)
        longest, better = largest(move), False
        if not longest < math.inf:
            break
        before, fraction = dot(f, f), min(1.0, STEP_MAX_RAD / max(longest, layout.TINY))
        for _ in range(layout.STEPS_MAX):
            for j in range(size):
                trial[j] = x[j] + fraction * move[j]
            new = residual_size(chain, inputs, address(trial), work, past, trial_f)
            better = dot(trial_f, trial_f) < (1.0 - 1e-4 * fraction) * before
            better = better or new < layout.BEND_TOLERANCE
            if better:
                break
            fraction *= 0.5
        if not better:
            break
        copy(address(trial), bend, size)
        assign(f, trial_f)
        change = new
    return change


@compiled
def continuation(chain, inputs, x, work, past):
    """Newton along a path: loads and the sharpness of friction grow together from none."""
    settings, last = floats(work.settings), np.zeros(x.shape[0])
    progress, stride, change = 0.0, 0.25, math.inf
    while progress < 1.0 and stride > STRIDE_MIN:
        aim = min(1.0, progress + stride)
        settings[layout.SMOOTHING] = layout.SMOOTHING_LENGTH * layout.WIDE_SMOOTHING ** (1.0 - aim)
        settings[layout.LOAD_SCALE] = aim
        assign(x, last)
        change = chain.newton(chain, inputs, address(x), work, past)
        if change < layout.BEND_TOLERANCE:
            progress, stride = aim, min(0.5, 1.6 * stride)
            assign(last, x)
        else:
            stride *= 0.4
    settings[layout.SMOOTHING], settings[layout.LOAD_SCALE] = layout.SMOOTHING_LENGTH, 1.0
    return change if progress == 1.0 else max(change, 10.0 * layout.BEND_TOLERANCE)


@compiled
def load_ratio(chain, work):
    """
    Return all loads together over Euler's load of the arm, one end free [1].

    The second variation of a load's potential is at most |F| times the integral of the tangent's
    change squared, whatever the shape: below 1 every equilibrium is stable.
    """
    x, y, z = at_tip(chain)[0]
    force = math.sqrt(x * x + y * y + z * z)
    rigidity, total = math.inf, 0.0
    for i in range(chain.n):
        for x, y, z in (weight(chain, i), pushed(chain, work, i)[0]):
            force += math.sqrt(x * x + y * y + z * z)
        reach = cell(chain, i, layout.LENGTH)
        rigidity = min(rigidity, reach * cell_stiffness(chain, i))
        total += reach
    return force * total * total * 4.0 / (math.pi * math.pi * rigidity)


@entry()
def descend(chain, inputs, bend, work, past, ratio):
    """
    Leave an unstable equilibrium, the state in `bend`, for a stable one.

    The straight arm, pushed a little to the side that the loads prefer, sinks until it rests: the
    gradient of the energy is the stiffness times the residual.
    """
    size = unknowns(chain)
    f, moved, down, x = np.empty(size), np.empty(size), np.empty(size), np.zeros(size)
    chain.step(chain, inputs, address(x), work, past, address(moved))
    assign(down, moved)
    residual_size(chain, inputs, bend, work, past, f)
    if chain.respond(chain, bend, 0, 0, work, past, address(down), 0) < 0:
        return
    push = math.copysign(1e-3 / largest(down), dot(down, moved))
    for j in range(size):
        x[j] = push * down[j]
    for _ in range(DESCENT_STEPS_MAX):
        change = residual_size(chain, inputs, address(x), work, past, f)
        if change < layout.SETTLED_RAD or change == math.inf:
            break
        for j in range(size):
            x[j] -= f[j] / (1.0 + ratio)
    change = chain.newton(chain, inputs, address(x), work, past)
    if change < layout.BEND_TOLERANCE:
        copy(address(x), bend, size)
    keep(x)


@entry()
def solve_equilibrium(chain, inputs, work, past, bend):
    """
    Find the equilibrium for input tensions (m,) [N] from the state [rad] in `bend`.

    Returns the last change [rad]: above `BEND_TOLERANCE` there is no equilibrium and the state
    means nothing. work.tensions are those of the equilibrium.
    """
    size, remembers = unknowns(chain), stages.memory_acts(chain)
    friction = stages.eyelet_acts(chain)
    slides = friction and stages.friction_travel_acts(chain)
    x, settings = np.empty(size), floats(work.settings)
    copy(bend, address(x), size)
    cold = largest(x) == 0.0 and not remembers
    if cold:
        sweep_unshaped(chain, inputs, x, work, past)
    swept, change = False, math.inf
    if remembers or not friction or is_planar(chain, x):
        change = repeat_sweeps(chain, inputs, x, work, past)
        swept = change < layout.BEND_TOLERANCE
    if not swept and slides and not remembers:
        change = solve_sticking(chain, inputs, x, bend, work, past, cold)
    elif not swept:
        restart(chain, inputs, x, bend, work, past, cold)
        if not (loaded(chain) or slides):
            change = chain.march(chain, inputs, address(x), work, past)
            if not change < layout.BEND_TOLERANCE:
                restart(chain, inputs, x, bend, work, past, cold)
        if not change < layout.BEND_TOLERANCE:
            change = chain.newton(chain, inputs, address(x), work, past)
    if not change < layout.BEND_TOLERANCE and settings[layout.EVERY_METHOD] != 0.0:
        change = continuation(chain, inputs, x, work, past)
    if change < layout.BEND_TOLERANCE and settings[layout.STABLE] != 0.0 and loaded(chain):
        ratio = load_ratio(chain, work)
        if ratio > SAFE_LOAD:
            chain.descend(chain, inputs, address(x), work, past, ratio)
            swept = False
    if not swept:
        chain.step(chain, inputs, address(x), work, past, bend)
        half_turns(chain, address(x), work)
    copy(address(x), bend, size)
    keep(x)
    return change
