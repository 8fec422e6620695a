"""
Derivatives of every cell's own laws: what the elimination of the chain is made of.

The residual of cell i depends on its own bend, on the tensions in it, on how the frame that it
starts from is turned, and on the torque of the loads beyond it. What it passes on, tensions and
turning towards the tip, travel and torque towards the base, depends on the same. The composed
laws are differentiated as they stand, by central differences of scalars.
"""

import math

from .bending import bend_cell, cell_stiffness, is_linear, twist_of
from .geometry import moment_of_leaning, moment_of_tendons
from .layout import HINGE, cell, compiled, floats, inlined, section_of, words
from .loads import (
    NO_LOAD,
    cell_moment,
    cross,
    loaded,
    local,
    plus,
    scaled,
    turn_moment,
    turned,
    weight,
)
from .residual import moment_arms_of, tendon_moment
from .stages import (
    eyelet,
    friction_travel,
    length,
    length_acts,
    memory,
    offset_scale,
    torsion_acts,
    wrap,
)
from .sweep import active_stages, smooth_sign, tendons_about
from .turning import arc_factor, end_of, half_turn
from .twisting import axial_moment, bending_frame, follows_shape, is_general, leans, twist_in

# Floats of one cell, matrices of three by three: derivatives of the residual [rad] by the own
# bend and twist, by the turn of the first frame (rotation vector, base frame), by the torque
# [N·m] at the end; turn of the last frame by the own bend and twist; torque at the start by the
# turn of the first frame and by the own bend and twist. Then for every tendon: TENDON floats.
OWN, BY_TURN, BY_TORQUE, TURNS, TORQUE_BY_TURN, TORQUE_BY_OWN, SIZE = 0, 9, 18, 27, 36, 45, 54
# Residual by tension; tension behind the eyelet at the cell's start by that before it, by bends
# and twist before and in the cell, by the travel beyond; travel by the own bend and twist; torque
# by tension; tension behind the eyelet by what its travel lags.
BY_TENSION, PASSED, BEFORE, HERE, SLIDES = 0, 3, 4, 7, 10
TRAVELS, PULLS, LAGS, TENDON = 11, 14, 17, 18
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
def twist_compliance(chain, i, about):
    """Differentiate a cell's twist by the moment about its axis [rad/(N·m)]."""
    h = MOMENT_STEP * cell_stiffness(chain, i, section_of(chain, i))
    return (twist_of(chain, i, about + h) - twist_of(chain, i, about - h)) / (2.0 * h)


@compiled
def moment_arm_slopes(chain, work, i, x, y, scale):
    """Differentiate the tendons' moment by the bend, tensions held: (xx, xy, yy) [N·m/rad]."""
    if not follows_shape(chain):
        return 0.0, 0.0, 0.0
    h, tensions = BEND_STEP, work.tensions + 8 * chain.k * i
    ax, ay = moment_of_tendons(chain, i, x + h, y, tensions, scale)
    bx, by = moment_of_tendons(chain, i, x - h, y, tensions, scale)
    _, cy = moment_of_tendons(chain, i, x, y + h, tensions, scale)
    _, dy = moment_of_tendons(chain, i, x, y - h, tensions, scale)
    return (ax - bx) / (2.0 * h), (ay - by) / (2.0 * h), (cy - dy) / (2.0 * h)


@compiled
def leaning_slopes(chain, work, i, x, y, twist, scale):
    """Differentiate the moment (x, y, about) of leaning tendons by x, y, twist [N·m/rad]."""
    h, tensions = BEND_STEP, work.tensions + 8 * chain.k * i
    slopes = (NO_LOAD, NO_LOAD, NO_LOAD)
    for a in range(3):
        dx, dy, dz = h if a == 0 else 0.0, h if a == 1 else 0.0, h if a == 2 else 0.0
        up = moment_of_leaning(chain, i, x + dx, y + dy, twist + dz, tensions, scale)
        low = moment_of_leaning(chain, i, x - dx, y - dy, twist - dz, tensions, scale)
        slopes = (slopes[1], slopes[2], difference(h, up, low))
    return slopes


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
        State [rad].
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
        row[BEFORE + 2] = by_here * travels[2]
        row[HERE], row[HERE + 1] = share * nx, share * ny
        row[SLIDES] = t * log_passed * by_beyond
        lag = floats(work.lag)
        row[LAGS] = by_here * lag[at] + row[SLIDES] * lag[at + chain.n * chain.k]


@inlined
def bend_cell_of(chain, work, i, x, y, force, torque, own, general):
    """
    Moment (x, y, about) [N·m] on a cell bent by (x, y), where its end and its weight lie [m].

    Parameters
    ----------
    x, y : float
        Bend [rad].
    force, torque, own : tuple of float
        Of all beyond at the cell's end, and its weight, in the frame that bends: (3,) [N], [N·m],
        [N].
    general : bool
        Whether cells twist or weight lies beside the axis; a constant.

    """
    s, c = half_turn(x * x + y * y)
    reach = floats(work.lengths)[i]
    mx, my, middle = cell_moment(chain, i, x, y, s, c, force, torque, own, reach, general)
    across, along = end_of(x * x + y * y, s, c, reach, cell(chain, i, HINGE))
    end, about = (across * x, across * y, along), 0.0
    if general:
        start = plus(torque, plus(cross(end, force), cross(middle, own)))
        about = axial_moment(x, y, 2.0 * s * c, 2.0 * s * s, torque, start)
    return (mx, my, about), end, middle


@compiled
def bent_cell(chain, work, i, x, y, force, torque, own):
    """Return `bend_cell_of` where loads do no more than bend."""
    return bend_cell_of(chain, work, i, x, y, force, torque, own, False)


@compiled
def general_cell(chain, work, i, x, y, force, torque, own):
    """Return `bend_cell_of` where cells twist or weight lies beside the axis."""
    return bend_cell_of(chain, work, i, x, y, force, torque, own, True)


@inlined
def loaded_cell(chain, work, i, x, y, force, torque, own, general):
    """Return `bend_cell_of`, by code compiled once for each kind of loads."""
    if general:
        return general_cell(chain, work, i, x, y, force, torque, own)
    return bent_cell(chain, work, i, x, y, force, torque, own)


@compiled
def difference(h, a, b):
    """Return (a - b) / (2 h) of two triples."""
    return scaled(0.5 / h, (a[0] - b[0], a[1] - b[1], a[2] - b[2]))


@inlined
def load_slopes(chain, bend, work, i, row, general):
    """
    Fill what the loads say about cell i; differentiate their moment by x, y and the twist.

    In `row`, BY_TURN and BY_TORQUE take the moment's derivatives, before they meet the
    compliance.
    """
    x, y, h = floats(bend)[2 * i], floats(bend)[2 * i + 1], BEND_STEP
    f, wrench = bending_frame(chain, bend, work, i, general), floats(work.wrench + 48 * i)
    force, torque = (wrench[0], wrench[1], wrench[2]), (wrench[3], wrench[4], wrench[5])
    own = scaled(floats(work.slip)[1], weight(chain, i))
    loads = (local(f, force), local(f, torque), local(f, own))
    by_x = by_y = by_twist = NO_LOAD
    for a in range(2):
        dx, dy = (h, 0.0) if a == 0 else (0.0, h)
        m, up, mid = loaded_cell(chain, work, i, x + dx, y + dy, *loads, general)
        n, low, lowmid = loaded_cell(chain, work, i, x - dx, y - dy, *loads, general)
        by_x, by_y = by_y, difference(h, m, n)
        by_own = plus(
            cross(turned(f, difference(h, up, low)), force),
            cross(turned(f, difference(h, mid, lowmid)), own),
        )
        for r in range(3):
            row[TORQUE_BY_OWN + 3 * r + a] = by_own[r]
    turn_slopes(chain, f, work, i, x, y, force, torque, own, row, general)
    if general:
        by_twist = twist_slopes(f, row)
    return by_x, by_y, by_twist


@inlined
def turn_slopes(chain, f, work, i, x, y, force, torque, own, row, general):
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
    s, c = half_turn(x * x + y * y)
    sinc, versine = 2.0 * s * c, 2.0 * s * s
    leaning = versine - arc_factor(x * x + y * y, s, c)
    wrench = (local(f, force), local(f, torque), local(f, own))
    _, end, middle = loaded_cell(chain, work, i, x, y, *wrench, general)
    end, middle = turned(f, end), turned(f, middle)
    for r in range(3):
        unit = (1.0 if r == 0 else 0.0, 1.0 if r == 1 else 0.0, 1.0 if r == 2 else 0.0)
        wrench = (cross(force, unit), cross(torque, unit), cross(own, unit))
        wrench = (local(f, wrench[0]), local(f, wrench[1]), local(f, wrench[2]))
        m, _, _ = loaded_cell(chain, work, i, x, y, *wrench, general)
        unit_here = local(f, unit)
        tx, ty = turn_moment(x, y, unit_here, sinc, versine, leaning)
        row[BY_TURN + r], row[BY_TURN + 3 + r] = m[0], m[1]
        row[BY_TORQUE + r], row[BY_TORQUE + 3 + r] = tx, ty
        row[TURNS + 3 * r], row[TURNS + 3 * r + 1] = tx, ty
        if general:
            about = axial_moment(x, y, sinc, versine, unit_here, unit_here)
            row[BY_TURN + 6 + r] = m[2]
            row[BY_TORQUE + 6 + r] = row[TURNS + 3 * r + 2] = about
        by_turn = plus(cross(cross(unit, end), force), cross(cross(unit, middle), own))
        for a in range(3):
            row[TORQUE_BY_TURN + 3 * a + r] = by_turn[a]


@compiled
def twist_slopes(f, row):
    """
    Fill what the twist of a cell does to the torque at its start; return what to its moment.

    Half a twist turns the frame that bends about its z.
    """
    by_twist = (row[BY_TURN], row[BY_TURN + 3], row[BY_TURN + 6])
    by_twist = scaled(0.5 * f[2], by_twist)
    for r in range(1, 3):
        column = (row[BY_TURN + r], row[BY_TURN + 3 + r], row[BY_TURN + 6 + r])
        by_twist = plus(by_twist, scaled(0.5 * f[3 * r + 2], column))
    for a in range(3):
        turn = TORQUE_BY_TURN + 3 * a
        row[TORQUE_BY_OWN + 3 * a + 2] = 0.5 * (
            row[turn] * f[2] + row[turn + 1] * f[5] + row[turn + 2] * f[8]
        )
    return by_twist


@compiled
def compression_slopes(chain, bend, work, i, total):
    """Differentiate the loads' moment (x, y, about) and the torque at the start by tension."""
    h, section = TENSION_STEP * (total + 0.01), section_of(chain, i)
    rate = length(1.0, total + h, chain, section) - length(1.0, total - h, chain, section)
    rate /= 2.0 * h * length(1.0, total, chain, section)
    x, y = floats(bend)[2 * i], floats(bend)[2 * i + 1]
    f, wrench = bending_frame(chain, bend, work, i, True), floats(work.wrench + 48 * i)
    force = (wrench[0], wrench[1], wrench[2])
    own = scaled(floats(work.slip)[1], weight(chain, i))
    loads, lengths = (local(f, force), NO_LOAD, local(f, own)), floats(work.lengths)
    m, end, middle = general_cell(chain, work, i, x, y, *loads)
    reach, lengths[i] = lengths[i], 0.0  # a weight beside the axis stays where it is
    rest, _, beside = general_cell(chain, work, i, x, y, *loads)
    lengths[i] = reach
    m, middle = plus(m, scaled(-1.0, rest)), plus(middle, scaled(-1.0, beside))
    pull = plus(cross(turned(f, end), force), cross(turned(f, middle), own))
    return scaled(rate, m), scaled(rate, pull)


@compiled
def cell_slopes(chain, bend, work, past, i, moment_arms, scale, tangent):
    """
    Fill the derivatives of the residual of cell i.

    Parameters
    ----------
    bend : address
        State [rad].
    moment_arms, scale : address, float
        (n, k, 2) [m], and the factor on them [1].
    tangent : address
        Derivatives of this cell, SIZE + TENDON k floats.

    """
    if is_general(chain) or leans(chain):
        fill_slopes(chain, bend, work, past, i, moment_arms, scale, tangent, True)
    else:
        fill_slopes(chain, bend, work, past, i, moment_arms, scale, tangent, False)


@inlined
def tendon_slopes(chain, bend, work, i, general):
    """Differentiate the tendons' moment (x, y, about) by x, y and the twist, tensions held."""
    x, y, scale = floats(bend)[2 * i], floats(bend)[2 * i + 1], offset_scale(1.0, chain, 0)
    if general and leans(chain):
        return leaning_slopes(chain, work, i, x, y, twist_in(chain, bend, i), scale)
    xx, xy, yy = moment_arm_slopes(chain, work, i, x, y, scale)
    return (xx, xy, 0.0), (xy, yy, 0.0), NO_LOAD


@inlined
def fill_slopes(chain, bend, work, past, i, moment_arms, scale, tangent, general):
    """Fill the derivatives of the residual of cell i."""
    row, at, loads = floats(tangent), chain.k * i, loaded(chain)
    mx, my, total = tendon_moment(chain, work, i, moment_arms, scale)
    by_x, by_y, by_twist = tendon_slopes(chain, bend, work, i, general)
    press, pull = NO_LOAD, NO_LOAD
    if loads:
        mx += floats(work.load)[2 * i]
        my += floats(work.load)[2 * i + 1]
        load_x, load_y, load_twist = load_slopes(chain, bend, work, i, row, general)
        by_x, by_y, by_twist = plus(by_x, load_x), plus(by_y, load_y), plus(by_twist, load_twist)
        if length_acts(chain):
            press, pull = compression_slopes(chain, bend, work, i, total)
    a, b, c, d, e, f = compliances(chain, past, i, mx, my, total)
    row[OWN], row[OWN + 1] = 1.0 - (a * by_x[0] + c * by_x[1]), -(a * by_y[0] + c * by_y[1])
    row[OWN + 3], row[OWN + 4] = -(b * by_x[0] + d * by_x[1]), 1.0 - (b * by_y[0] + d * by_y[1])
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
        u, v = u + press[0], v + press[1]
        here[BY_TENSION], here[BY_TENSION + 1] = -(a * u + c * v + e), -(b * u + d * v + f)
        here[PULLS], here[PULLS + 1], here[PULLS + 2] = pull
    if general and torsion_acts(chain):
        row[OWN + 2] = -(a * by_twist[0] + c * by_twist[1])
        row[OWN + 5] = -(b * by_twist[0] + d * by_twist[1])
        fill_twist(chain, work, i, tangent, (by_x[2], by_y[2], by_twist[2]), press[2], loads)


@compiled
def fill_twist(chain, work, i, tangent, by_own, press, loads):
    """Fill the derivatives of the residual of the twist of cell i, from those of its moment."""
    row, about = floats(tangent), tendons_about(chain, work, i)
    if loads:
        about += floats(work.torque)[i]
    yields = twist_compliance(chain, i, about)
    for b in range(3):
        row[OWN + 6 + b] = -yields * by_own[b]
        row[BY_TURN + 6 + b] *= -yields
        row[BY_TORQUE + 6 + b] *= -yields
    row[OWN + 8] += 1.0
    for k in range(chain.k):
        if i < words(chain.tendon)[2 * k]:
            here = floats(tangent + 8 * (SIZE + TENDON * k))
            here[TRAVELS + 2] = floats(work.axial)[chain.k * i + k]
            here[BY_TENSION + 2] = -yields * (here[TRAVELS + 2] + press)


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
