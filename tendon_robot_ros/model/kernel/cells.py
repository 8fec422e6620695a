"""
One cell: from the moment on it to its bend, how it turns and where it ends.

For a bend b of size a, q = a² and h = a / 2: S = sin(h) / a and C = cos(h) are smooth at zero,
sin(a) / a = 2 S C, (1 - cos a) / a² = 2 S². No division by the bend.

Half of a cell's twist lies before its bend and half behind it. Tendons lean then, as those do that
wind about the axis: between the eyelets at the ends of a cell their offset turns by the twist and
by what they wind, and the chord between these eyelets is longer than the one that the bend alone
asks for.
"""

import math

from . import layout, stages
from .layout import cell, compiled, floats, fused, inlined


@compiled
def coordinates(chain):
    """Unknowns of a cell: its bend, and its twist where cells twist."""
    return 3 if stages.torsion_acts(chain) else 2


@compiled
def unknowns(chain):
    """Entries of the state that count: bends (n, 2), and behind them twists (n,)."""
    return coordinates(chain) * chain.n


@compiled
def leans(chain):
    """Tell whether tendons may lean: they wind, or cells twist."""
    return chain.helix != 0 or stages.torsion_acts(chain)


@compiled
def follows_shape(chain):
    """Tell whether the moment arms of the tendons follow the shape."""
    return stages.tendon_path_acts(chain) or leans(chain)


@compiled
def is_general(chain):
    """Tell whether loads do more than bend: cells twist, or weight lies beside the axis."""
    return stages.torsion_acts(chain) or chain.beside != 0


@compiled
def twist_in(chain, state, i):
    """Twist of cell i [rad] in a state at an address; zero where cells do not twist."""
    return floats(state)[2 * chain.n + i] if stages.torsion_acts(chain) else 0.0


@compiled
def turned_axes(f, angle):
    """Frame (9,) turned about its own z."""
    c, s = math.cos(angle), math.sin(angle)
    ax, ay, az, _ = twist_row((f[0], f[1], f[2], 0.0), c, s)
    bx, by, bz, _ = twist_row((f[3], f[4], f[5], 0.0), c, s)
    cx, cy, cz, _ = twist_row((f[6], f[7], f[8], 0.0), c, s)
    return ax, ay, az, bx, by, bz, cx, cy, cz


@inlined
def frame_at(start):
    """Frame (9,) at an address."""
    f = floats(start)
    return f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8]


@inlined
def bending_frame(chain, state, work, i, general):
    """Frame (9,) in which cell i bends: where it begins, turned by half its twist."""
    frame = frame_at(work.frames + 72 * i)
    if general:
        return turned_axes(frame, 0.5 * twist_in(chain, state, i))
    return frame


@compiled
def axial_moment(x, y, sinc, versine, torque, start):
    """
    Moment on a twist [N·m] of the torques at both ends of its cell, in the frame that bends.

    A twist turns what lies beyond by a half about each end of the axis.
    """
    end = sinc * (x * torque[0] + y * torque[1]) + (1.0 - versine * (x * x + y * y)) * torque[2]
    return 0.5 * (start[2] + end)


ARC_SERIES_BELOW = 0.25  # [rad²] so that the next term of the series in `arc_factor` is rounding
SERIES_BELOW = 2.4  # [rad²] so that half the bend is below pi / 4: polynomials then round only


@fused
def half_turn(q):
    """(S, C) of a bend whose square is q [rad²]."""
    if not q < SERIES_BELOW:
        a = math.sqrt(q)
        return math.sin(0.5 * a) / a, math.cos(0.5 * a)
    return gentle_turn(q)


@fused
def gentle_turn(q):
    """(S, C) of a bend whose square q [rad²] is below `SERIES_BELOW`."""
    z = 0.25 * q
    z2 = z * z
    z4 = z2 * z2
    s = (
        (0.5 + z * -8.33333333333333079e-02)
        + z2 * (4.16666666661244655e-03 + z * -9.92063491492804210e-05)
        + z4
        * ((1.37786568478473840e-06 + z * -1.25253701223364065e-08) + z2 * 7.94845778886159700e-11)
    )
    c = 1.0 - (
        z * (0.5 + z * -4.16666666666666019e-02)
        + z2
        * (
            z * (1.38888888888741096e-03 + z * -2.48015872894767294e-05)
            + z2
            * (
                z * (2.75573143513906633e-07 + z * -2.08757232129817483e-09)
                + z2 * (z * 1.13596475577881948e-11)
            )
        )
    )
    return s, c


@compiled
def halved(s, c):
    """(S, C) of half a bend from those of the whole (of less than a full turn)."""
    half_c = math.sqrt(0.5 * (1.0 + c))
    return s / half_c, half_c


@fused
def arc_factor(q, s, c):
    """(sin(a)/a - cos(a)) / a² for S and C of a bend whose square is q [rad²]."""
    if not q < ARC_SERIES_BELOW:
        return (2.0 * s * c - 1.0 + 2.0 * s * s * q) / q
    q2 = q * q
    return (
        (1.0 / 3.0 + q * (-1.0 / 30.0))
        + q2 * (1.0 / 840.0 + q * (-1.0 / 45360.0))
        + q2 * q2 * (1.0 / 3991680.0 + q * (-1.0 / 518918400.0) + q2 * (1.0 / 93405312000.0))
    )


@compiled
def half_turns(chain, bend, work):
    """Fill work.half (n, 2): S and C of every cell."""
    half, bends, far = floats(work.half), floats(bend), 0
    for i in range(chain.n):  # without a branch, so that several cells are computed at once
        x, y = bends[2 * i], bends[2 * i + 1]
        q = x * x + y * y
        half[2 * i], half[2 * i + 1] = gentle_turn(q)
        far += 0 if q < SERIES_BELOW else 1
    for i in range(chain.n if far > 0 else 0):
        x, y = bends[2 * i], bends[2 * i + 1]
        half[2 * i], half[2 * i + 1] = half_turn(x * x + y * y)


@fused
def end_of(q, s, c, cell_length, hinge):
    """Where a cell ends: (towards the bend over the bend [m/rad], along z [m])."""
    if hinge > 0.5:
        return cell_length * s * c, cell_length * (1.0 - s * s * q)
    return 2.0 * cell_length * s * s, 2.0 * cell_length * s * c


@fused
def turn_row(row, x, y, sinc, versine, cosine, across, along):
    """
    One row of a frame, and of the place where it is, taken over a cell that bends by (x, y).

    Parameters
    ----------
    row : tuple of float
        Row (3,) of the frame, and that coordinate of its origin [m].
    x, y : float
        Bend [rad].
    sinc, versine, cosine : float
        sin(a) / a, (1 - cos a) / a² [1/rad²] and cos a of its size a.
    across, along : float
        Where the cell ends, see `end_of` [m/rad], [m].

    """
    fx, fy, fz, place = row
    toward = fx * x + fy * y
    turned = versine * toward + sinc * fz
    place += across * toward + along * fz
    return fx - x * turned, fy - y * turned, sinc * toward + cosine * fz, place


@fused
def twist_row(row, c, s):
    """One row of a frame that turns about its own z by an angle of cosine c and sine s."""
    fx, fy, fz, place = row
    return c * fx + s * fy, c * fy - s * fx, fz, place


@compiled
def chain_frames(chain, bend, work):
    """
    Fill work.frames (n + 1, 3, 3) and work.origins (n + 1, 3) [m] from work.half.

    Entry 0 is the base and stays as it is. A cell twists by a half before and behind its bend.
    """
    twists, co, si = stages.torsion_acts(chain), 1.0, 0.0
    frames, origins, bends = floats(work.frames), floats(work.origins), floats(bend)
    half, lengths = floats(work.half), floats(work.lengths)
    a, b, c = (1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)
    for i in range(chain.n):
        x, y, sine, cosine = bends[2 * i], bends[2 * i + 1], half[2 * i], half[2 * i + 1]
        q = x * x + y * y
        across, along = end_of(q, sine, cosine, lengths[i], cell(chain, i, layout.HINGE))
        sinc, versine = 2.0 * sine * cosine, 2.0 * sine * sine
        cosine = 1.0 - versine * q
        if twists:
            half_twist = 0.5 * bends[2 * chain.n + i]
            co, si = math.cos(half_twist), math.sin(half_twist)
            a, b, c = twist_row(a, co, si), twist_row(b, co, si), twist_row(c, co, si)
        a = turn_row(a, x, y, sinc, versine, cosine, across, along)
        b = turn_row(b, x, y, sinc, versine, cosine, across, along)
        c = turn_row(c, x, y, sinc, versine, cosine, across, along)
        if twists:
            a, b, c = twist_row(a, co, si), twist_row(b, co, si), twist_row(c, co, si)
        f, o = 9 * i + 9, 3 * i + 3
        frames[f], frames[f + 1], frames[f + 2], origins[o] = a
        frames[f + 3], frames[f + 4], frames[f + 5], origins[o + 1] = b
        frames[f + 6], frames[f + 7], frames[f + 8], origins[o + 2] = c


@compiled
def cell_stiffness(chain, i):
    """Bending stiffness of cell i with the tendons in it [N·m/rad]."""
    return stages.stiffness(
        cell(chain, i, layout.STIFFNESS), cell(chain, i, layout.PRESENT), chain, i
    )


@compiled
def twist_of(chain, i, about):
    """Twist [rad] of cell i under a moment about its axis [N·m]."""
    return stages.torsion(0.0, about, cell_stiffness(chain, i), chain, i)


@compiled
def elastic_moment(chain, i, bx, by):
    """Moment (x, y) [N·m] that holds a bend against the backbone's elasticity."""
    x0, y0 = stages.rest(0.0, 0.0, chain, i)
    x, y = bx - x0, by - y0
    k = cell_stiffness(chain, i) * stages.stiffening(1.0, x * x + y * y, chain, i)
    return k * x, k * y


@compiled
def bend_of(chain, k, size, i):
    """Solve K t stiffening(t²) = size for the bend t >= 0; NaN when there is none."""
    t = size / k
    if not stages.stiffening_acts(chain):
        return t
    t = min(t, 1.0)
    for _ in range(60):
        g = stages.stiffening(1.0, t * t, chain, i)
        h = layout.DIFFERENCE_STEP * (1.0 + t)
        slope = (
            stages.stiffening(1.0, (t + h) * (t + h), chain, i)
            - stages.stiffening(1.0, (t - h) * (t - h), chain, i)
        ) / (2.0 * h)
        step = (k * t * g - size) / (k * (g + t * slope))
        t -= step
        if abs(step) < 50.0 * layout.EPSILON * (1.0 + t):
            return t
    return math.nan


@compiled
def is_linear(chain):
    """Tell whether every cell bends in proportion to the moment on it."""
    return not (
        stages.moment_acts(chain)
        or stages.joint_friction_acts(chain)
        or stages.stiffening_acts(chain)
        or stages.hysteresis_acts(chain)
    )


@fused
def bend_linear(chain, work, i, mx, my, load_x, load_y, scale):
    """
    Bend (x, y) of a cell that bends in proportion to load plus scale times moment [N·m].

    Parameters
    ----------
    mx, my : float
        Moment of the tendons [N·m], to be scaled.
    load_x, load_y : float
        Moment of the loads [N·m].
    scale : float
        Factor on the tendon offsets, and so on their moment [1].

    """
    x0, y0 = stages.rest(0.0, 0.0, chain, i)
    compliance = floats(work.compliance)[i]
    slope = scale * compliance
    return x0 + compliance * load_x + slope * mx, y0 + compliance * load_y + slope * my


@compiled
def moment_held(chain, past, i, bx, by):
    """Moment (x, y) [N·m] that cell i holds against its bend after it has moved to (bx, by)."""
    held, before = floats(past.moment), floats(past.bend)
    return stages.hysteresis(
        held[2 * i],
        held[2 * i + 1],
        bx - before[2 * i],
        by - before[2 * i + 1],
        cell_stiffness(chain, i),
        chain,
        i,
    )


@compiled
def needed_moment(chain, past, i, bx, by, total):
    """Moment (x, y) [N·m] that a bend of cell i needs, whatever the sum of tensions, `total`."""
    ex, ey = elastic_moment(chain, i, bx, by)
    hx, hy = moment_held(chain, past, i, bx, by)
    return ex + hx, ey + hy


@compiled
def unbalanced(chain, past, i, bx, by, mx, my):
    """Moment (x, y) [N·m] by which a bend needs more than acts on the cell."""
    x, y = needed_moment(chain, past, i, bx, by, 0.0)
    return x - mx, y - my


@compiled
def bend_against(chain, past, i, mx, my, x, y):
    """
    Bend (x, y) of a cell whose hysteresis takes part of the moment on it.

    By Broyden's method from a bend near it, with slopes (xx, xy; yx, yy) of which the first are
    the cell's stiffness; NaN where there is none.
    """
    stiffness = cell_stiffness(chain, i)
    fx, fy = unbalanced(chain, past, i, x, y, mx, my)
    xx, yx, xy, yy = stiffness, 0.0, 0.0, stiffness
    for _ in range(60):
        size, over, part = fx * fx + fy * fy, 1.0 / (xx * yy - xy * yx), 1.0
        if size < (layout.EPSILON * stiffness) ** 2:
            return x, y
        to_x, to_y = over * (xy * fy - yy * fx), over * (yx * fx - xx * fy)
        gx, gy = unbalanced(chain, past, i, x + to_x, y + to_y, mx, my)
        while not gx * gx + gy * gy < size and part > 1e-3:
            part *= 0.5
            gx, gy = unbalanced(chain, past, i, x + part * to_x, y + part * to_y, mx, my)
        to_x, to_y = part * to_x, part * to_y
        moved = to_x * to_x + to_y * to_y
        if moved < (10.0 * layout.EPSILON) ** 2:
            return x, y
        x, y = x + to_x, y + to_y
        ex = (gx - fx - xx * to_x - xy * to_y) / moved
        ey = (gy - fy - yx * to_x - yy * to_y) / moved
        xx, xy, yx, yy = xx + ex * to_x, xy + ex * to_y, yx + ey * to_x, yy + ey * to_y
        fx, fy = gx, gy
    return math.nan, math.nan


@compiled
def acting_moment(chain, past, i, mx, my, total):
    """Moment (x, y) [N·m] that bends a cell, of one on it, pressed by a sum of tensions [N]."""
    size = math.sqrt(mx * mx + my * my)
    if stages.moment_acts(chain) and size > 0.0:
        radius = chain.radius * stages.offset_scale(1.0, chain, 0)
        factor = stages.moment(size, total, radius, chain, i) / size
        mx, my = mx * factor, my * factor
    if stages.joint_friction_acts(chain):
        hx, hy = 0.0, 0.0
        if stages.memory_acts(chain):
            before = floats(past.bend + 16 * i)
            hx, hy = elastic_moment(chain, i, before[0], before[1])
        dx, dy = mx - hx, my - hy
        size = math.sqrt(dx * dx + dy * dy)
        if size > 0.0:
            factor = stages.joint_friction(size, total, chain, i) / size
            mx, my = hx + dx * factor, hy + dy * factor
    return mx, my


@compiled
def bend_cell(chain, past, i, mx, my, total, near_x, near_y):
    """
    Bend (x, y) of a cell under a moment [N·m] and the sum of tensions [N] that press it.

    It is looked for from a bend near it.
    """
    mx, my = acting_moment(chain, past, i, mx, my, total)
    if stages.hysteresis_acts(chain):
        return bend_against(chain, past, i, mx, my, near_x, near_y)
    size = math.sqrt(mx * mx + my * my)
    x0, y0 = stages.rest(0.0, 0.0, chain, i)
    if size == 0.0:
        return x0, y0
    t = bend_of(chain, cell_stiffness(chain, i), size, i) / size
    return x0 + t * mx, y0 + t * my
