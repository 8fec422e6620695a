"""
Derivatives of every cell's own laws: what the elimination of the chain is made of.

The residual of cell i depends on its own bend, on the tensions in it, on how the frame that it
starts from is turned, and on the torque of the loads beyond it. What it passes on, tensions and
turning towards the tip, travel and torque towards the base, depends on the same. The composed
laws are differentiated as they stand, by central differences of scalars.
"""

import math
from itertools import accumulate

from . import layout, stages
from .cells import (
    acting_moment,
    arc_factor,
    axial_moment,
    bend_cell,
    bending_frame,
    cell_stiffness,
    end_of,
    follows_shape,
    half_turn,
    is_general,
    leans,
    needed_moment,
    twist_in,
    twist_of,
)
from .geometry import add_moments, leaning_tendon, straight_tendon
from .layout import cell, compiled, entry, floats, inlined, words
from .loads import (
    NO_LOAD,
    along_middle,
    bow_compliance,
    cell_moment,
    cross,
    end_at,
    half_arc,
    loaded,
    local,
    plus,
    push_at,
    scaled,
    turn_moment,
    turned,
    weight,
)
from .sweep import (
    active_stages,
    axial_moment_on,
    moment_arms_of,
    moment_on,
    slip_rate_in,
    smooth_sign,
)


def _starts(*sizes):
    """Return the starts of parts of these sizes in a row, and last their total size."""
    return accumulate(sizes, initial=0)


# Derivatives of a cell, in their order. The residual of bend (x, y) and twist [rad], a row of
# ACROSS entries for each: by the own bend and twist, by the rotation of the first frame (rotation
# vector, base frame), by the torque [N·m] and by the force [N] at the end.
XYZ = len(NO_LOAD)
MATRIX = XYZ * XYZ
OWN, BY_ROTATION, BY_TORQUE, BY_FORCE, ACROSS = _starts(XYZ, XYZ, XYZ, XYZ)
# Behind it matrices. How the last frame turns and where it goes [m] by the own bend and twist; the
# torque at the start by the rotation of the first frame and by the own bend and twist.
_, ROTATIONS, SHIFTS, TORQUE_BY_ROTATION, TORQUE_BY_OWN, SIZE = _starts(
    XYZ * ACROSS, MATRIX, MATRIX, MATRIX, MATRIX
)
# Then of every tendon: the residual by its tension; its tension behind the eyelet at the cell's
# start by that before it, by bend and twist before and within the cell, by the travel beyond; its
# travel by the own bend and twist; the torque by its tension; its tension behind the eyelet by
# what the eyelet's travel lags.
BY_TENSION, PASSED, BEFORE, WITHIN, SLIDES, TRAVELS, PULLS, LAGS, TENDON = _starts(
    3, 1, 3, 3, 1, 3, 3, 1
)
# Last, if something pushes at a place: the torque at the start by the force at the end; where the
# cell ends, from its start (3,) [m]; torque [N·m] and force [N] of the push by rotation and place
# of the end; how much the cell grows per tension [1/N].
TORQUE_BY_FORCE, REACH, PUSH_TORQUE, PUSH_FORCE, GROWS = _starts(
    MATRIX, XYZ, MATRIX + MATRIX, MATRIX + MATRIX
)


@compiled
def tangent_width(chain):
    """Floats that the derivatives of a cell take."""
    return SIZE + TENDON * chain.k + (GROWS + 1 if stages.push_acts(chain) else 0)


@compiled
def tangent_of(chain, tangent, i):
    """Address of the derivatives of cell i."""
    return tangent + 8 * i * tangent_width(chain)


@compiled
def tendon_part(row, k):
    """Return the derivatives of tendon k among those of a cell at an address."""
    return floats(row + 8 * (SIZE + TENDON * k))


@compiled
def pushed_part(chain, row):
    """Return the last part of the derivatives of a cell at an address."""
    return tendon_part(row, chain.k)


NARROWINGS = (1.0, 1e-3, 1e-6)  # [1] of a difference at a kink: a narrower one would be rounding
# [1] of the radius, of differences of the memory of friction: far less than the least presliding
# length, 4e-3, because the law has another slope on its other side
TRAVEL_STEP = 2e-7


@compiled
def loaded_cell(chain, work, i, x, y, loads, bow, general):
    """
    Moment (x, y, about) [N·m] on a cell bent by (x, y), where its end and its weight lie [m].

    Parameters
    ----------
    x, y : float
        Bend [rad].
    loads : tuple
        Force and torque of all beyond at the cell's end, and its weight, in the frame that bends:
        (3,) [N], (3,) [N·m], (3,) [N].
    bow : float
        `bow_compliance` [m/N]; without it all is linear in the loads.
    general : bool
        Whether cells twist or weight lies beside the axis.

    """
    s, c = half_turn(x * x + y * y)
    reach, (force, torque, own) = floats(work.lengths)[i], loads
    mx, my, middle, over = cell_moment(chain, i, x, y, s, c, loads, reach, bow, general)
    across, along = end_of(x * x + y * y, s, c, reach, cell(chain, i, layout.HINGE))
    end, about = plus((across * x, across * y, along), over), 0.0
    if general:
        start = plus(torque, plus(cross(end, force), cross(middle, own)))
        about = axial_moment(x, y, 2.0 * s * c, 2.0 * s * s, torque, start)
    return (mx, my, about), end, middle


@inlined
def put(row, at, width, column):
    """Put a triple as a column into three rows of a width, from an entry on."""
    row[at], row[at + width], row[at + 2 * width] = column


@compiled
def difference(h, a, b):
    """Return (a - b) / (2 h) of two triples."""
    return scaled(0.5 / h, (a[0] - b[0], a[1] - b[1], a[2] - b[2]))


@entry()
def load_slopes(chain, bend, work, i, tangent, total):
    """
    Fill what the loads say about cell i, in which the tensions sum up to `total` [N].

    Of the derivatives of the cell, OWN, BY_ROTATION, BY_TORQUE and BY_TENSION take those of the
    moment, before they meet the compliance; what tendons say is added to in OWN.
    """
    row, general, h = floats(tangent), is_general(chain), layout.DIFFERENCE_STEP
    x, y = floats(bend)[2 * i], floats(bend)[2 * i + 1]
    f, wrench = bending_frame(chain, bend, work, i, general), floats(work.wrench + 48 * i)
    force, torque = (wrench[0], wrench[1], wrench[2]), (wrench[3], wrench[4], wrench[5])
    own = scaled(floats(work.settings)[layout.LOAD_SCALE], weight(chain, i))
    loads, bow = (local(f, force), local(f, torque), local(f, own)), bow_compliance(chain, work, i)
    for a in range(2):
        dx, dy = (h, 0.0) if a == 0 else (0.0, h)
        m, up, mid = loaded_cell(chain, work, i, x + dx, y + dy, loads, bow, general)
        n, low, lowmid = loaded_cell(chain, work, i, x - dx, y - dy, loads, bow, general)
        by_bend = difference(h, m, n)
        by_own = plus(
            cross(turned(f, difference(h, up, low)), force),
            cross(turned(f, difference(h, mid, lowmid)), own),
        )
        for r in range(3):
            row[OWN + ACROSS * r + a] += by_bend[r]
        put(row, TORQUE_BY_OWN + a, 3, by_own)
    rotation_slopes(chain, f, work, i, x, y, (force, torque, own), bow, row, general)
    if general:  # half a twist turns the frame that bends about its z
        z = (0.5 * f[2], 0.5 * f[5], 0.5 * f[8])
        for a in range(3):
            by, of = BY_ROTATION + ACROSS * a, TORQUE_BY_ROTATION + 3 * a
            row[OWN + ACROSS * a + 2] += z[0] * row[by] + z[1] * row[by + 1] + z[2] * row[by + 2]
            turn = z[0] * row[of] + z[1] * row[of + 1] + z[2] * row[of + 2]
            row[TORQUE_BY_OWN + 3 * a + 2] = turn
    if stages.push_acts(chain):
        chain.push_slopes(chain, bend, work, i, tangent)
    if stages.length_acts(chain):
        compression_slopes(chain, bend, work, i, total, tangent)


@entry()
def push_slopes(chain, bend, work, i, tangent):
    """Fill what a push on the ends of the cells adds to the derivatives of cell i."""
    row, more = floats(tangent), pushed_part(chain, tangent)
    general, h = is_general(chain), layout.DIFFERENCE_STEP
    x, y = floats(bend)[2 * i], floats(bend)[2 * i + 1]
    scale = floats(work.settings)[layout.LOAD_SCALE]
    f, wrench = bending_frame(chain, bend, work, i, general), floats(work.wrench + 48 * i)
    force, torque = (wrench[0], wrench[1], wrench[2]), (wrench[3], wrench[4], wrench[5])
    own, bow = local(f, scaled(scale, weight(chain, i))), bow_compliance(chain, work, i)
    torque = local(f, torque)
    (place, frame), reach = end_at(work, i), cell(chain, i, layout.LENGTH)
    unloaded = (NO_LOAD, NO_LOAD, NO_LOAD)
    _, end, _ = loaded_cell(chain, work, i, x, y, unloaded, 0.0, general)
    whole = turned(f, end)
    put(more, REACH, 1, whole)
    for r in range(3):
        unit = (1.0 if r == 0 else 0.0, 1.0 if r == 1 else 0.0, 1.0 if r == 2 else 0.0)
        # moments and torque are squares of the force: a difference over any step is their slope
        up, low = local(f, plus(force, unit)), local(f, plus(force, scaled(-1.0, unit)))
        m, end, middle = loaded_cell(chain, work, i, x, y, (up, torque, own), bow, general)
        n, far, behind = loaded_cell(chain, work, i, x, y, (low, torque, own), bow, general)
        put(row, BY_FORCE + r, ACROSS, difference(1.0, m, n))
        after = plus(cross(end, up), cross(middle, own))
        by = turned(f, difference(1.0, after, plus(cross(far, low), cross(behind, own))))
        put(more, TORQUE_BY_FORCE + r, 3, by)
        if r < 2:
            dx, dy = (h, 0.0) if r == 0 else (0.0, h)
            _, end, _ = loaded_cell(chain, work, i, x + dx, y + dy, unloaded, 0.0, general)
            _, far, _ = loaded_cell(chain, work, i, x - dx, y - dy, unloaded, 0.0, general)
            by = turned(f, difference(h, end, far))
        else:  # half the twist turns the end about the axis of the frame that bends
            by = cross((0.5 * f[2], 0.5 * f[5], 0.5 * f[8]), whole)
        put(row, SHIFTS + r, 3, by)
        a, b = turned_by(frame, scaled(h, unit)), turned_by(frame, scaled(-h, unit))
        fill_push(chain, work, i, place, a, place, b, scale / (2.0 * h), more, r)
        step = h * reach
        a, b = plus(place, scaled(step, unit)), plus(place, scaled(-step, unit))
        fill_push(chain, work, i, a, frame, b, frame, scale / (2.0 * step), more, 3 + r)


@compiled
def turned_by(frame, rotation):
    """Frame (9,) after a small rotation (3,) [rad] in the base frame."""
    x = plus((frame[0], frame[3], frame[6]), cross(rotation, (frame[0], frame[3], frame[6])))
    y = plus((frame[1], frame[4], frame[7]), cross(rotation, (frame[1], frame[4], frame[7])))
    z = plus((frame[2], frame[5], frame[8]), cross(rotation, (frame[2], frame[5], frame[8])))
    return x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2]


@compiled
def fill_push(chain, work, i, place_up, frame_up, place_low, frame_low, per_step, row, column):
    """Fill a column of both slopes from the push on the end of cell i at two places."""
    force, moment, _, _ = push_at(chain, work, i, place_up, frame_up)
    less, slack, _, _ = push_at(chain, work, i, place_low, frame_low)
    for r in range(3):
        row[PUSH_TORQUE + 6 * r + column] = per_step * (moment[r] - slack[r])
        row[PUSH_FORCE + 6 * r + column] = per_step * (force[r] - less[r])


@compiled
def rotation_slopes(chain, f, work, i, x, y, beyond, bow, row, general):
    """
    Fill derivatives by the rotation of the frame of cell i, and that of the next by its bend.

    Parameters
    ----------
    f : tuple of float
        Frame that bends (9,).
    x, y : float
        Bend [rad].
    beyond : tuple
        Force and torque of all beyond at the cell's end, and its weight, base frame: (3,) [N],
        (3,) [N·m], (3,) [N].
    bow : float
        `bow_compliance` [m/N].
    row : pointer
        Derivatives of the cell.

    """
    (force, torque, own), (s, c) = beyond, half_turn(x * x + y * y)
    sinc, versine = 2.0 * s * c, 2.0 * s * s
    leaning = versine - arc_factor(x * x + y * y, s, c)
    wrench = (local(f, force), local(f, torque), local(f, own))
    _, end, middle = loaded_cell(chain, work, i, x, y, wrench, 0.0, general)
    end, middle, tangent = turned(f, end), turned(f, middle), (s * x, s * y, c)
    half, part = plus(force, scaled(0.5, own)), half_arc(x, y, s, c)  # that bows the cell
    g, gx, gy = along_middle(x, y, s, c, part, local(f, half))
    turning = cross(tangent, local(f, half))
    for r in range(3):
        unit = (1.0 if r == 0 else 0.0, 1.0 if r == 1 else 0.0, 1.0 if r == 2 else 0.0)
        wrench = (cross(force, unit), cross(torque, unit), cross(own, unit))
        wrench = (local(f, wrench[0]), local(f, wrench[1]), local(f, wrench[2]))
        m, _, _ = loaded_cell(chain, work, i, x, y, wrench, 0.0, general)
        local_unit = local(f, unit)
        tx, ty = turn_moment(x, y, local_unit, sinc, versine, leaning)
        about = axial_moment(x, y, sinc, versine, local_unit, local_unit) if general else 0.0
        put(row, BY_ROTATION + r, ACROSS, m)
        put(row, BY_TORQUE + r, ACROSS, (tx, ty, about))
        put(row, ROTATIONS + 3 * r, 1, (tx, ty, about))
        by_rotation = plus(cross(cross(unit, end), force), cross(cross(unit, middle), own))
        if bow > 0.0:
            change = local(f, cross(half, unit))
            h, hx, hy = along_middle(x, y, s, c, part, change)
            row[BY_ROTATION + r] -= bow * (h * gx + g * hx)
            row[BY_ROTATION + ACROSS + r] -= bow * (h * gy + g * hy)
            # the torque is -B g m x F: that in the frame that bends, turned with it and by itself
            change = plus(scaled(h, turning), scaled(g, cross(tangent, change)))
            row[BY_ROTATION + 2 * ACROSS + r] -= 0.5 * bow * change[2]
            bowed = plus(turned(f, change), scaled(g, cross(unit, turned(f, turning))))
            by_rotation = plus(by_rotation, scaled(-bow, bowed))
        put(row, TORQUE_BY_ROTATION + r, 3, by_rotation)


@compiled
def compression_slopes(chain, bend, work, i, total, tangent):
    """Fill the derivatives of the loads' moment and of the torque at the start by tensions."""
    h = layout.DIFFERENCE_STEP * (1.0 + total)
    rate = stages.length(1.0, total + h, chain, i)
    rate -= stages.length(1.0, total - h, chain, i)
    rate /= 2.0 * h * stages.length(1.0, total, chain, i)
    if stages.push_acts(chain):
        pushed_part(chain, tangent)[GROWS] = rate
    x, y = floats(bend)[2 * i], floats(bend)[2 * i + 1]
    f, wrench = bending_frame(chain, bend, work, i, layout.YES), floats(work.wrench + 48 * i)
    force = (wrench[0], wrench[1], wrench[2])
    own = scaled(floats(work.settings)[layout.LOAD_SCALE], weight(chain, i))
    loads, lengths = (local(f, force), NO_LOAD, local(f, own)), floats(work.lengths)
    m, end, middle = loaded_cell(chain, work, i, x, y, loads, 0.0, layout.YES)
    reach, lengths[i] = lengths[i], 0.0  # a weight beside the axis stays where it is
    rest, _, beside = loaded_cell(chain, work, i, x, y, loads, 0.0, layout.YES)
    lengths[i] = reach
    m, middle = plus(m, scaled(-1.0, rest)), plus(middle, scaled(-1.0, beside))
    pull = plus(cross(turned(f, end), force), cross(turned(f, middle), own))
    for k in range(chain.k):
        if i < words(chain.tendon)[2 * k]:
            slopes = tendon_part(tangent, k)
            put(slopes, BY_TENSION, 1, scaled(rate, m))
            put(slopes, PULLS, 1, scaled(rate, pull))


@inlined
def law_slope(law, chain, past, i, at, toward):
    """
    Differentiate a moment (x, y) [N·m] on a cell along a step of what decides about it.

    Friction in a hinge and similar laws have kinks: over one a difference is the slope of neither
    side, and Newton stalls beside it. So the step narrows until both its halves agree.

    Parameters
    ----------
    law : function
        `acting_moment` or `needed_moment`.
    at, toward : tuple of float
        Moment x and y [N·m] or bend x and y [rad], and sum of the tensions [N]; step of them.

    """
    x, y = law(chain, past, i, *at)
    ax, ay, bx, by, width = x, y, x, y, 1.0
    for zoom in NARROWINGS:
        ax, ay = law(chain, past, i, *plus(at, scaled(zoom, toward)))
        bx, by = law(chain, past, i, *plus(at, scaled(-zoom, toward)))
        width = zoom
        uneven = abs(ax + bx - 2.0 * x) + abs(ay + by - 2.0 * y)
        # curvature makes 1e-3, a kink 1
        if not uneven > layout.SAME_SIGN * (abs(ax - bx) + abs(ay - by)):
            break
    return 0.5 * (ax - bx) / width, 0.5 * (ay - by) / width


@compiled
def compliances(chain, past, i, moment, x, y):
    """
    Differentiate a cell's bend by moment x and y [rad/(N·m)] and tension [rad/N], x and y of each.

    Parameters
    ----------
    moment : tuple of float
        Moment x and y [N·m] and sum of the tensions [N] on the cell.
    x, y : float
        Bend near that of the cell [rad].

    """
    stiffness, h = cell_stiffness(chain, i), layout.DIFFERENCE_STEP
    a, b, c, d = 1.0 / stiffness, 0.0, 0.0, 1.0 / stiffness
    if stages.stiffening_acts(chain) or stages.hysteresis_acts(chain):
        x, y = bend_cell(chain, past, i, *moment, x, y)
        at = (x, y, moment[2])
        xx, yx = law_slope(needed_moment, chain, past, i, at, (h, 0.0, 0.0))
        xy, yy = law_slope(needed_moment, chain, past, i, at, (0.0, h, 0.0))
        over = h / (xx * yy - xy * yx)
        a, b, c, d = over * yy, -over * yx, -over * xy, over * xx
    if not (stages.moment_acts(chain) or stages.joint_friction_acts(chain)):
        return a, b, c, d, 0.0, 0.0
    hm, ht = h * stiffness, h * (1.0 + moment[2])
    xx, yx = law_slope(acting_moment, chain, past, i, moment, (hm, 0.0, 0.0))
    xy, yy = law_slope(acting_moment, chain, past, i, moment, (0.0, hm, 0.0))
    xt, yt = law_slope(acting_moment, chain, past, i, moment, (0.0, 0.0, ht))
    e, f = (a * xt + c * yt) / ht, (b * xt + d * yt) / ht
    xx, xy, yx, yy = xx / hm, xy / hm, yx / hm, yy / hm
    return a * xx + c * yx, b * xx + d * yx, a * xy + c * yy, b * xy + d * yy, e, f


@inlined
def moment_slopes(chain, work, i, x, y, twist, scale, tangent, path_lost):
    """
    Fill OWN with derivatives of the tendons' moment by bend and twist, tensions held [N·m/rad].

    `path_lost`: `straight_tendon`, or `leaning_tendon` where tendons may lean.
    """
    h, tensions, row = layout.DIFFERENCE_STEP, work.tensions + 8 * chain.k * i, floats(tangent)
    for a in range(3 if leans(chain) else 2):
        dx, dy, dz = h if a == 0 else 0.0, h if a == 1 else 0.0, h if a == 2 else 0.0
        up = add_moments(chain, i, x + dx, y + dy, twist + dz, tensions, scale, path_lost)
        low = add_moments(chain, i, x - dx, y - dy, twist - dz, tensions, scale, path_lost)
        put(row, OWN + a, ACROSS, difference(h, up, low))


@entry()
def leaning_slopes(chain, work, i, x, y, twist, scale, tangent):
    """Fill OWN with derivatives of the moment of tendons that may lean (`moment_slopes`)."""
    moment_slopes(chain, work, i, x, y, twist, scale, tangent, leaning_tendon)


@inlined
def travel_slopes(here, beyond, h, chain, i):
    """Differentiate the travel that decides friction by that here and by that beyond."""
    up, low = here + h, here - h
    by_here = stages.friction_travel(up, beyond, chain, i)
    by_here -= stages.friction_travel(low, beyond, chain, i)
    by_beyond = stages.friction_travel(here, beyond + h, chain, i)
    by_beyond -= stages.friction_travel(here, beyond - h, chain, i)
    return by_here / (2.0 * h), by_beyond / (2.0 * h)


@inlined
def slip_slopes(chain, work, past, at, i, slides, remembers):
    """
    Direction of friction at an eyelet, and its derivatives by travel in the cell and beyond [1/m].

    Parameters
    ----------
    at : int
        Entry chain.k i + k of the arrays (n, k).
    slides, remembers : bool
        Whether the travel beyond counts, and whether friction remembers.

    """
    slip, beyond = floats(work.travel)[at], floats(work.beyond)[at] if slides else 0.0
    by_slip, by_beyond = 1.0, 0.0
    if remembers:
        sign, last, h = floats(past.sign)[at], floats(past.travel)[at], TRAVEL_STEP * chain.radius
        if slides:
            by_slip, by_beyond = travel_slopes(slip, beyond, h, chain, i)
            slip = stages.friction_travel(slip, beyond, chain, i)
        law = chain.remembered
        s = law(chain, sign, slip - last, i)
        rate = law(chain, sign, slip - last + h, i)
        rate = (rate - law(chain, sign, slip - last - h, i)) / (2.0 * h)
        return s, by_slip * rate, by_beyond * rate
    rate = slip_rate_in(work)
    s = smooth_sign(slip, rate)
    by_slip = rate * (1.0 - s * s)
    if slides:
        t = smooth_sign(beyond, rate)
        here, slope = travel_slopes(s, t, layout.DIFFERENCE_STEP, chain, i)
        by_slip *= here
        # else every eyelet that slips would join the equations of those that stick
        by_beyond = rate * (1.0 - t * t) * slope if abs(t) < layout.SLIPPING_FROM else 0.0
        s = stages.friction_travel(s, t, chain, i)
    return s, by_slip, by_beyond


@compiled
def eyelet_slopes(chain, bend, work, past, i, flags, tangent):
    """
    Fill the derivatives of the tensions of cell i + 1 by those of cell i, bends and travel.

    Parameters
    ----------
    bend : address
        State [rad].
    flags : tuple of bool
        `active_stages`.
    tangent : address
        Derivatives of all cells.

    """
    _, _, wraps, slides, remembers = flags
    bends, tendon = floats(bend), words(chain.tendon)
    # the ratio that passes, by the bend before the eyelet (ox, oy) and by that behind it (nx, ny)
    bx, by, h = bends[2 * i], bends[2 * i + 1], layout.DIFFERENCE_STEP
    s, c = half_turn(bx * bx + by * by)
    a = math.sqrt(bx * bx + by * by)
    turning, slope = a * s, 0.5 * c / max(a, layout.TINY)
    ox, oy, nx, ny = slope * bx, slope * by, 0.0, 0.0
    if wraps:  # the mean of both bends turns the tendon
        x, y = 0.5 * (bx + bends[2 * i + 2]), 0.5 * (by + bends[2 * i + 3])
        s, c = half_turn(x * x + y * y)
        a = math.sqrt(x * x + y * y)
        mean, slope = a * s, 0.25 * c / max(a, layout.TINY)
        up, low = turning + h, turning - h
        own = stages.wrap(up, mean, chain, i) - stages.wrap(low, mean, chain, i)
        up, low = mean + h, mean - h
        by_mean = stages.wrap(turning, up, chain, i)
        by_mean -= stages.wrap(turning, low, chain, i)
        slope *= by_mean / (2.0 * h)
        nx, ny = slope * x, slope * y
        own /= 2.0 * h
        ox, oy = own * ox + nx, own * oy + ny
        turning = stages.wrap(turning, mean, chain, i)
    passed = stages.eyelet(1.0, turning, chain, i)
    up, low = turning + h, max(turning - h, 0.0)
    slope = stages.eyelet(1.0, up, chain, i) - stages.eyelet(1.0, low, chain, i)
    slope /= up - low
    log_passed = math.log(max(passed, layout.TINY))
    before, behind = tangent_of(chain, tangent, i), tangent_of(chain, tangent, i + 1)
    for k in range(chain.k):
        if i + 1 >= tendon[2 * k]:
            continue
        at = chain.k * i + k
        s, by_travel, by_beyond = slip_slopes(chain, work, past, at, i, slides, remembers)
        row, row_before = tendon_part(behind, k), tendon_part(before, k)
        ratio = math.exp(s * log_passed)
        t = floats(work.tensions)[at] * ratio
        by_turning, by_travel = slope * t * s / passed, t * log_passed * by_travel
        row[PASSED] = ratio
        row[BEFORE] = by_turning * ox + by_travel * row_before[TRAVELS]
        row[BEFORE + 1] = by_turning * oy + by_travel * row_before[TRAVELS + 1]
        row[BEFORE + 2] = by_travel * row_before[TRAVELS + 2]
        row[WITHIN], row[WITHIN + 1] = by_turning * nx, by_turning * ny
        row[SLIDES] = t * log_passed * by_beyond
        lag = floats(work.lag)
        row[LAGS] = by_travel * lag[at] + row[SLIDES] * lag[at + chain.n * chain.k]


@compiled
def cell_slopes(chain, bend, work, past, i, moment_arms, scale, tangent):
    """
    Fill the derivatives of the residual of cell i.

    Those of the moment come first, at the same entries; the compliance then multiplies them.

    Parameters
    ----------
    bend : address
        State [rad].
    moment_arms, scale : address, float
        (n, k, 2) [m], and the factor on them [1].
    tangent : address
        Derivatives of this cell, SIZE + TENDON k floats that are zero.

    """
    row, loads = floats(tangent), loaded(chain)
    mx, my, total = moment_on(chain, work, i, moment_arms, scale, loads)
    x, y, factor = floats(bend)[2 * i], floats(bend)[2 * i + 1], stages.offset_scale(1.0, chain, 0)
    if leans(chain):
        twist = twist_in(chain, bend, i)
        chain.leaning_slopes(chain, work, i, x, y, twist, factor, tangent)
    elif follows_shape(chain):
        moment_slopes(chain, work, i, x, y, 0.0, factor, tangent, straight_tendon)
    if loads:
        chain.load_slopes(chain, bend, work, i, tangent, total)
    a, b, c, d, e, f = compliances(chain, past, i, (mx, my, total), x, y)
    for q in range(ACROSS if loads else 3):
        u, v = row[q], row[ACROSS + q]
        row[q], row[ACROSS + q] = -(a * u + c * v), -(b * u + d * v)
    row[OWN] += 1.0
    row[OWN + ACROSS + 1] += 1.0
    lever, tendon = floats(moment_arms), words(chain.tendon)
    for k in range(chain.k):
        if i >= tendon[2 * k]:
            continue
        slopes, at = tendon_part(tangent, k), 2 * (chain.k * i + k)
        u, v = scale * lever[at], scale * lever[at + 1]
        slopes[TRAVELS], slopes[TRAVELS + 1] = u, v
        u, v = u + slopes[BY_TENSION], v + slopes[BY_TENSION + 1]
        slopes[BY_TENSION], slopes[BY_TENSION + 1] = -(a * u + c * v + e), -(b * u + d * v + f)
    if stages.torsion_acts(chain):
        fill_twist(chain, work, i, tangent, loads)


@compiled
def fill_twist(chain, work, i, tangent, loads):
    """Fill the derivatives of the residual of the twist of cell i, from those of its moment."""
    row, about = floats(tangent), axial_moment_on(chain, work, i, loads)
    h = layout.DIFFERENCE_STEP * cell_stiffness(chain, i)  # [N·m]
    yields = (twist_of(chain, i, about + h) - twist_of(chain, i, about - h)) / (2.0 * h)
    for q in range(ACROSS):
        row[2 * ACROSS + q] *= -yields
    row[OWN + 2 * ACROSS + 2] += 1.0
    for k in range(chain.k):
        if i < words(chain.tendon)[2 * k]:
            slopes = tendon_part(tangent, k)
            slopes[TRAVELS + 2] = floats(work.axial)[chain.k * i + k]
            slopes[BY_TENSION + 2] = -yields * (slopes[TRAVELS + 2] + slopes[BY_TENSION + 2])


@compiled
def differentiate(chain, bend, work, past, tangent):
    """Fill the derivatives of all cells at bends (n, 2) whose states `work` holds."""
    moment_arms, scale = moment_arms_of(chain, work)
    flags = active_stages(chain, layout.YES)
    for i in range(chain.n):
        cell_slopes(chain, bend, work, past, i, moment_arms, scale, tangent_of(chain, tangent, i))
    if flags[0]:
        for i in range(chain.n - 1):
            eyelet_slopes(chain, bend, work, past, i, flags, tangent)
