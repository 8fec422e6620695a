"""
Derivatives of every cell's own laws: what the elimination of the chain is made of.

The residual of cell i depends on its own bend, on the tensions in it, on how the frame that it
starts from is turned, and on the torque of the loads beyond it. What it passes on, tensions and
turning towards the tip, travel and torque towards the base, depends on the same. The composed
laws are differentiated as they stand, by central differences of scalars.
"""

import math

from .bending import bend_cell, cell_stiffness, is_linear
from .geometry import moment_of_tendons
from .layout import HINGE, cell, compiled, floats, inlined, section_of, words
from .loads import cell_moment, cross, loaded, local, plus, scaled, turn_moment, weight
from .residual import moment_arms_of, tendon_moment
from .stages import (
    eyelet,
    friction_travel,
    length,
    length_acts,
    memory,
    offset_scale,
    tendon_path_acts,
    wrap,
)
from .sweep import active_stages, smooth_sign
from .turning import arc_factor, end_of, half_turn

# Floats of one cell: derivatives of the residual [rad] by the own bend, by the turn of the first
# frame (rotation vector, base frame), by the torque [N·m] at the end; turn of the last frame by
# the own bend; torque at the start by the turn of the first frame and by the own bend. Then for
# every tendon: TENDON floats.
OWN, BY_TURN, BY_TORQUE, TURNS, TORQUE_BY_TURN, TORQUE_BY_OWN, SIZE = 0, 4, 10, 16, 22, 31, 37
# Residual by tension; tension behind the eyelet at the cell's start by that before it, by the
# bends before and in the cell, by the travel beyond; travel by the own bend; torque by tension;
# tension behind the eyelet by what its travel lags.
BY_TENSION, PASSED, BEFORE, HERE, SLIDES = 0, 2, 3, 5, 7
TRAVELS, PULLS, LAGS, TENDON = 8, 10, 13, 14
BEND_STEP = 1e-5  # [rad] of central differences
MOMENT_STEP = 1e-6  # [rad] over a cell's compliance
TENSION_STEP = 1e-4  # [1], and of 10 mN
SINE_STEP = 1e-6  # [1]
TRAVEL_STEP = 1e-9  # [m]
SLIDING_FROM = 1.0 - 1e-9  # [1] square of a direction of friction that no more travel changes


@compiled
def tangent_size(n, k):
    """Floats that the derivatives of a chain take."""
    return n * (SIZE + TENDON * k)


@compiled
def tangent_of(chain, tangent, i):
    """Address of the derivatives of cell i."""
    return tangent + 8 * i * (SIZE + TENDON * chain.k)


@compiled
def compliances(chain, past, i, mx, my, total):
    """Differentiate a cell's bend (x, y) by moment x and y [rad/(N·m)] and tension [rad/N]."""
    stiffness = cell_stiffness(chain, i, section_of(chain, i))
    if is_linear(chain):
        return 1.0 / stiffness, 0.0, 0.0, 1.0 / stiffness, 0.0, 0.0
    h, ht = MOMENT_STEP * stiffness, TENSION_STEP * (total + 0.01)
    ax, ay = bend_cell(chain, past, i, mx + h, my, total)
    bx, by = bend_cell(chain, past, i, mx - h, my, total)
    cx, cy = bend_cell(chain, past, i, mx, my + h, total)
    dx, dy = bend_cell(chain, past, i, mx, my - h, total)
    ex, ey = bend_cell(chain, past, i, mx, my, total + ht)
    fx, fy = bend_cell(chain, past, i, mx, my, total - ht)
    h, ht = 0.5 / h, 0.5 / ht
    return (
        (ax - bx) * h,
        (ay - by) * h,
        (cx - dx) * h,
        (cy - dy) * h,
        (ex - fx) * ht,
        (ey - fy) * ht,
    )


@compiled
def moment_arm_slopes(chain, work, i, x, y, scale):
    """Differentiate the tendons' moment by the bend, tensions held: (xx, xy, yy) [N·m/rad]."""
    if not tendon_path_acts(chain):
        return 0.0, 0.0, 0.0
    h, tensions = BEND_STEP, work.tensions + 8 * chain.k * i
    ax, ay = moment_of_tendons(chain, i, x + h, y, tensions, scale)
    bx, by = moment_of_tendons(chain, i, x - h, y, tensions, scale)
    _, cy = moment_of_tendons(chain, i, x, y + h, tensions, scale)
    _, dy = moment_of_tendons(chain, i, x, y - h, tensions, scale)
    return (ax - bx) / (2.0 * h), (ay - by) / (2.0 * h), (cy - dy) / (2.0 * h)


@inlined
def slip_slopes(chain, work, past, at, section, here, slides, remembers):
    """
    Direction of friction at an eyelet, and its derivatives by travel here and beyond [1/m].

    Parameters
    ----------
    at : int
        Entry chain.k i + k of the arrays (n, k).
    here : float
        Travel of the tendon in cell i [m].
    slides, remembers : bool
        Whether the travel beyond counts, and whether friction remembers.

    """
    beyond = floats(work.beyond)[at] if slides else 0.0
    h = TRAVEL_STEP
    by_here, by_beyond = 1.0, 0.0
    if remembers:
        sign, last = floats(past.sign)[at], floats(past.travel)[at]
        if slides:
            by_here = friction_travel(here + h, beyond, chain, section)
            by_here = (by_here - friction_travel(here - h, beyond, chain, section)) / (2.0 * h)
            by_beyond = friction_travel(here, beyond + h, chain, section)
            by_beyond = (by_beyond - friction_travel(here, beyond - h, chain, section)) / (2.0 * h)
            here = friction_travel(here, beyond, chain, section)
        s = memory(0.0, sign, here - last, chain, section)
        rate = memory(0.0, sign, here - last + h, chain, section)
        rate = (rate - memory(0.0, sign, here - last - h, chain, section)) / (2.0 * h)
        return s, by_here * rate, by_beyond * rate
    rate = 1.0 / floats(work.slip)[0]
    s = smooth_sign(here, rate)
    by_here = rate * (1.0 - s * s)
    if slides:
        t, h = smooth_sign(beyond, rate), SINE_STEP
        share = friction_travel(s + h, t, chain, section)
        by_here *= (share - friction_travel(s - h, t, chain, section)) / (2.0 * h)
        share = friction_travel(s, t + h, chain, section)
        share = (share - friction_travel(s, t - h, chain, section)) / (2.0 * h)
        by_beyond = rate * (1.0 - t * t) * share if t * t < SLIDING_FROM else 0.0
        s = friction_travel(s, t, chain, section)
    return s, by_here, by_beyond


@compiled
def turning_slopes(chain, i, bx, by, next_x, next_y, wraps):
    """
    Return what passes the eyelet behind cell i, its derivatives by the bends on both sides.

    Parameters
    ----------
    bx, by, next_x, next_y : float
        Bends of the cells on both sides [rad].
    wraps : bool
        Whether the mean of both bends turns the tendon.

    """
    section, h = section_of(chain, i), SINE_STEP
    q = bx * bx + by * by
    s, c = half_turn(q)
    a = math.sqrt(q)
    turning, slope = a * s, 0.5 * c / max(a, 1e-300)
    ox, oy, nx, ny = slope * bx, slope * by, 0.0, 0.0
    if wraps:
        x, y = 0.5 * (bx + next_x), 0.5 * (by + next_y)
        q = x * x + y * y
        s, c = half_turn(q)
        a = math.sqrt(q)
        mean, slope = a * s, 0.25 * c / max(a, 1e-300)
        own = wrap(turning + h, mean, chain, section) - wrap(turning - h, mean, chain, section)
        share = wrap(turning, mean + h, chain, section) - wrap(turning, mean - h, chain, section)
        slope *= share / (2.0 * h)
        nx, ny = slope * x, slope * y
        own /= 2.0 * h
        ox, oy = own * ox + nx, own * oy + ny
        turning = wrap(turning, mean, chain, section)
    passed, low = eyelet(1.0, turning, chain, section), max(turning - h, 0.0)
    slope = eyelet(1.0, turning + h, chain, section) - eyelet(1.0, low, chain, section)
    slope /= turning + h - low
    return passed, slope * ox, slope * oy, slope * nx, slope * ny


@compiled
def eyelet_slopes(chain, bend, work, past, i, flags, tangent):
    """
    Fill what the tensions of cell i + 1 depend on: those of cell i, both bends, the travel.

    Parameters
    ----------
    bend : address
        (n, 2) [rad]
    flags : tuple of bool
        `sweep.active_stages`.
    tangent : address
        Derivatives of all cells.

    """
    _, _, wraps, slides, remembers = flags
    bends, tendon, section = floats(bend), words(chain.tendon), section_of(chain, i)
    bx, by, next_x, next_y = bends[2 * i], bends[2 * i + 1], bends[2 * i + 2], bends[2 * i + 3]
    passed, ox, oy, nx, ny = turning_slopes(chain, i, bx, by, next_x, next_y, wraps)
    log_passed = math.log(max(passed, 1e-300))
    before = tangent_of(chain, tangent, i) + 8 * SIZE
    behind = tangent_of(chain, tangent, i + 1) + 8 * SIZE
    for k in range(chain.k):
        if i + 1 >= tendon[2 * k]:
            continue
        at = chain.k * i + k
        here = floats(work.travel)[at]
        s, by_here, by_beyond = slip_slopes(
            chain, work, past, at, section, here, slides, remembers
        )
        row, travels = floats(behind + 8 * TENDON * k), floats(before + 8 * (TENDON * k + TRAVELS))
        ratio = math.exp(s * log_passed)
        t = floats(work.tensions)[at] * ratio
        share, by_here = t * s / passed, t * log_passed * by_here
        row[PASSED] = ratio
        row[BEFORE] = share * ox + by_here * travels[0]
        row[BEFORE + 1] = share * oy + by_here * travels[1]
        row[HERE], row[HERE + 1] = share * nx, share * ny
        row[SLIDES] = t * log_passed * by_beyond
        lag = floats(work.lag)
        row[LAGS] = by_here * lag[at] + row[SLIDES] * lag[at + chain.n * chain.k]


@compiled
def bent_cell(chain, work, i, x, y, force, torque, own):
    """
    Moment (x, y) [N·m] on a cell bent by (x, y), where its end and its middle lie [m].

    Parameters
    ----------
    x, y : float
        Bend [rad].
    force, torque, own : tuple of float
        Of all beyond at the cell's end, and its weight, in its first frame: (3,) [N], [N·m], [N].

    """
    s, c = half_turn(x * x + y * y)
    reach, hinge = floats(work.lengths)[i], cell(chain, i, HINGE)
    mx, my, lean, rise = cell_moment(x, y, s, c, force, torque, own, reach, hinge)
    across, along = end_of(x * x + y * y, s, c, reach, hinge)
    return mx, my, (across * x, across * y, along), (lean * x, lean * y, rise)


@compiled
def turned(f, v):
    """Components in the base frame of a vector in a frame."""
    return (
        f[0] * v[0] + f[1] * v[1] + f[2] * v[2],
        f[3] * v[0] + f[4] * v[1] + f[5] * v[2],
        f[6] * v[0] + f[7] * v[1] + f[8] * v[2],
    )


@compiled
def difference(h, a, b):
    """Return (a - b) / (2 h) of two triples."""
    return scaled(0.5 / h, (a[0] - b[0], a[1] - b[1], a[2] - b[2]))


@compiled
def load_slopes(chain, bend, work, i, row):
    """
    Fill what the loads say about cell i; return the derivative of their moment by its bend.

    In `row`, BY_TURN and BY_TORQUE take the moment's derivatives, before they meet the
    compliance.
    """
    x, y, h = floats(bend)[2 * i], floats(bend)[2 * i + 1], BEND_STEP
    f, wrench = floats(work.frames + 72 * i), floats(work.wrench + 48 * i)
    force, torque = (wrench[0], wrench[1], wrench[2]), (wrench[3], wrench[4], wrench[5])
    own = scaled(floats(work.slip)[1], weight(chain, i))
    loads = (local(f, force), local(f, torque), local(f, own))
    slopes = (0.0, 0.0, 0.0, 0.0)
    for a in range(2):
        dx, dy = (h, 0.0) if a == 0 else (0.0, h)
        mx, my, up, mid = bent_cell(chain, work, i, x + dx, y + dy, *loads)
        nx, ny, low, lowmid = bent_cell(chain, work, i, x - dx, y - dy, *loads)
        slopes = (slopes[2], slopes[3], (mx - nx) / (2.0 * h), (my - ny) / (2.0 * h))
        by_own = plus(
            cross(turned(f, difference(h, up, low)), force),
            cross(turned(f, difference(h, mid, lowmid)), own),
        )
        for r in range(3):
            row[TORQUE_BY_OWN + 2 * r + a] = by_own[r]
    turn_slopes(chain, work, i, x, y, force, torque, own, row)
    return slopes


@compiled
def turn_slopes(chain, work, i, x, y, force, torque, own, row):
    """
    Fill what a turn of the frame of cell i does, and how its own bend turns the next one.

    Parameters
    ----------
    x, y : float
        Bend [rad].
    force, torque, own : tuple of float
        Of all beyond at the cell's end, and its weight, base frame: (3,) [N], [N·m], [N].
    row : pointer
        Derivatives of the cell.

    """
    f = floats(work.frames + 72 * i)
    s, c = half_turn(x * x + y * y)
    sinc, versine = 2.0 * s * c, 2.0 * s * s
    leaning = versine - arc_factor(x * x + y * y, s, c)
    wrench = (local(f, force), local(f, torque), local(f, own))
    _, _, end, middle = bent_cell(chain, work, i, x, y, *wrench)
    end, middle = turned(f, end), turned(f, middle)
    for r in range(3):
        unit = (1.0 if r == 0 else 0.0, 1.0 if r == 1 else 0.0, 1.0 if r == 2 else 0.0)
        wrench = (cross(force, unit), cross(torque, unit), cross(own, unit))
        wrench = (local(f, wrench[0]), local(f, wrench[1]), local(f, wrench[2]))
        mx, my, _, _ = bent_cell(chain, work, i, x, y, *wrench)
        row[BY_TURN + r], row[BY_TURN + 3 + r] = mx, my
        tx, ty = turn_moment(x, y, local(f, unit), sinc, versine, leaning)
        row[BY_TORQUE + r], row[BY_TORQUE + 3 + r] = tx, ty
        row[TURNS + 2 * r], row[TURNS + 2 * r + 1] = tx, ty
        by_turn = plus(cross(cross(unit, end), force), cross(cross(unit, middle), own))
        for a in range(3):
            row[TORQUE_BY_TURN + 3 * a + r] = by_turn[a]


@compiled
def compression_slopes(chain, bend, work, i, total):
    """Differentiate the loads' moment (x, y) and the torque at the start by every tension."""
    h, section = TENSION_STEP * (total + 0.01), section_of(chain, i)
    rate = length(1.0, total + h, chain, section) - length(1.0, total - h, chain, section)
    rate /= 2.0 * h * length(1.0, total, chain, section)
    x, y = floats(bend)[2 * i], floats(bend)[2 * i + 1]
    f, wrench = floats(work.frames + 72 * i), floats(work.wrench + 48 * i)
    force = (wrench[0], wrench[1], wrench[2])
    own = scaled(floats(work.slip)[1], weight(chain, i))
    mx, my, end, middle = bent_cell(
        chain, work, i, x, y, local(f, force), (0.0, 0.0, 0.0), local(f, own)
    )
    pull = plus(cross(turned(f, end), force), cross(turned(f, middle), own))
    return rate * mx, rate * my, scaled(rate, pull)


@compiled
def cell_slopes(chain, bend, work, past, i, moment_arms, scale, tangent):
    """
    Fill the derivatives of the residual of cell i.

    Parameters
    ----------
    bend : address
        (n, 2) [rad]
    moment_arms, scale : address, float
        (n, k, 2) [m], and the factor on them [1].
    tangent : address
        Derivatives of this cell, SIZE + TENDON k floats.

    """
    row, at = floats(tangent), chain.k * i
    x, y = floats(bend)[2 * i], floats(bend)[2 * i + 1]
    mx, my, total = tendon_moment(chain, work, i, moment_arms, scale)
    xx, xy, yy = moment_arm_slopes(chain, work, i, x, y, offset_scale(1.0, chain, 0))
    yx, px, py, pull = xy, 0.0, 0.0, (0.0, 0.0, 0.0)
    loads = loaded(chain)
    if loads:
        mx += floats(work.load)[2 * i]
        my += floats(work.load)[2 * i + 1]
        # columns of the Hessian: x, then y
        hxx, hyx, hxy, hyy = load_slopes(chain, bend, work, i, row)
        xx, yx, xy, yy = xx + hxx, yx + hyx, xy + hxy, yy + hyy
        if length_acts(chain):
            px, py, pull = compression_slopes(chain, bend, work, i, total)
    a, b, c, d, e, f = compliances(chain, past, i, mx, my, total)
    row[OWN], row[OWN + 1] = 1.0 - (a * xx + c * yx), -(a * xy + c * yy)
    row[OWN + 2], row[OWN + 3] = -(b * xx + d * yx), 1.0 - (b * xy + d * yy)
    if loads:
        for r in range(3):
            for start in (BY_TURN, BY_TORQUE):
                u, v = row[start + r], row[start + 3 + r]
                row[start + r], row[start + 3 + r] = -(a * u + c * v), -(b * u + d * v)
    lever, tendon = floats(moment_arms), words(chain.tendon)
    for k in range(chain.k):
        if i >= tendon[2 * k]:
            continue
        here = floats(tangent + 8 * (SIZE + TENDON * k))
        u, v = scale * lever[2 * (at + k)], scale * lever[2 * (at + k) + 1]
        here[TRAVELS], here[TRAVELS + 1] = u, v
        u, v = u + px, v + py
        here[BY_TENSION], here[BY_TENSION + 1] = -(a * u + c * v + e), -(b * u + d * v + f)
        here[PULLS], here[PULLS + 1], here[PULLS + 2] = pull


@compiled
def differentiate(chain, bend, work, past, tangent):
    """Fill the derivatives of all cells at bends (n, 2) whose states `work` holds."""
    moment_arms, scale = moment_arms_of(chain, work)
    flags = active_stages(chain, True)
    for i in range(chain.n):
        cell_slopes(chain, bend, work, past, i, moment_arms, scale, tangent_of(chain, tangent, i))
    if flags[0]:
        for i in range(chain.n - 1):
            eyelet_slopes(chain, bend, work, past, i, flags, tangent)
