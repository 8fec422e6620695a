"""
Moments of the loads on every bend, by virtual work, from the tip to the base; how cells bow.

Under a force across a rod the curvature changes along a cell. The bend is the mean curvature of an
arc. The rest of it is linear along the cell, turns neither of its ends, and moves the far one
across the tangent m in its middle: by B (F - (F m) m), with B = L² / (12 K) and F the force of all
beyond the middle. The loads' energy falls by B (F² - (F m)²) / 2, and so there is a moment on the
bend. A hinge does not bow.
"""

import math

from . import layout, stages
from .cells import (
    arc_factor,
    axial_moment,
    bending_frame,
    frame_at,
    halved,
    is_general,
    turned_axes,
    twist_in,
)
from .layout import cell, compiled, contracted, entry, floats, fused


@compiled
def bows(chain):
    """Tell whether any cell is an arc."""
    for i in range(chain.n):
        if not cell(chain, i, layout.HINGE) > 0.5:
            return True
    return False


@compiled
def bow_compliance(chain, work, i):
    """How far the end of cell i moves per force across it [m/N]; 0 for a hinge."""
    if cell(chain, i, layout.HINGE) > 0.5:
        return 0.0
    reach = cell(chain, i, layout.LENGTH)
    return reach * reach * (floats(work.compliance)[i] * (1.0 / 12.0))


@compiled
def half_arc(x, y, s, c):
    """`cells.arc_factor` of half the bend (x, y)."""
    s2, c2 = halved(s, c)
    return arc_factor(0.25 * (x * x + y * y), s2, c2)


@contracted
def along_middle(x, y, s, c, part, f):
    """
    Part of a force along the tangent in the middle of an arc [N], its slopes by the bend [N/rad].

    Parameters
    ----------
    x, y : float
        Bend [rad].
    s, c : float
        sin(a / 2) / a [1/rad] and cos(a / 2) of its size a, see `cells`: m = (s x, s y, c).
    part : float
        `half_arc` [1].
    f : tuple of float
        Force (3,) [N], in the frame that bends; all that is returned is linear in it.

    """
    toward = f[0] * x + f[1] * y
    drop = 0.125 * part * toward + 0.5 * s * f[2]
    return s * toward + c * f[2], s * f[0] - drop * x, s * f[1] - drop * y


@contracted
def bowed(bow, x, y, s, c, part, f):
    """
    Moment (x, y) [N·m] on the bend of a cell that bows, and where that moves its end (3,) [m].

    Parameters
    ----------
    bow : float
        `bow_compliance` [m/N].
    x, y : float
        Bend [rad].
    s, c, part : float
        As in `along_middle`.
    f : tuple of float
        Force of all beyond the middle (3,) [N], in the frame that bends.

    """
    g, by_x, by_y = along_middle(x, y, s, c, part, f)
    over = (bow * (f[0] - g * s * x), bow * (f[1] - g * s * y), bow * (f[2] - g * c))
    return -bow * g * by_x, -bow * g * by_y, over


NO_LOAD = (0.0, 0.0, 0.0)  # [N], [N·m] or [m] a vector of zeros, so that sums have a beginning
# [1] frame of the base, row by row, because entry 0 of work.frames may lie elsewhere
BASE_FRAME = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


@compiled
def loaded(chain):
    """Tell whether any load acts."""
    return stages.load_acts(chain) or stages.tip_load_acts(chain) or stages.push_acts(chain)


@compiled
def weight(chain, i):
    """Force of the loads on cell i at its middle (x, y, z) [N]."""
    g = floats(chain.gravity)
    return stages.load(0.0, 0.0, 0.0, cell(chain, i, layout.MASS), g[0], g[1], g[2], chain, i)


@compiled
def at_tip(chain):
    """Force (3,) [N] and moment (3,) [N·m] at the tip."""
    wrench = stages.tip_load(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, chain, 0)
    return wrench[:3], wrench[3:]


@compiled
def push_at(chain, work, i, place, frame):
    """
    Force (3,) [N] and moment (3,) [N·m] on the end of cell i, were it at a place (3,) [m].

    Behind them how much of the force is friction (3,) [N], and how far the place is from that of
    the straight arm (3,) [m].
    """
    along, behind = 0.0, math.inf
    for j in range(i + 1):
        along += cell(chain, j, layout.LENGTH)
    if i + 1 < chain.n:
        behind = cell(chain, i + 1, layout.LENGTH)
    before = cell(chain, i, layout.LENGTH)
    held, apart = floats(work.held + 48 * i), (place[0], place[1], place[2] - along)
    friction = (held[0], held[1], held[2])
    moved = (apart[0] - held[3], apart[1] - held[4], apart[2] - held[5])
    force, moment, friction = stages.push(
        NO_LOAD, NO_LOAD, friction, place, frame, along, before, behind, moved, chain, 0
    )
    return force, moment, friction, apart


@compiled
def end_at(work, i):
    """Where cell i ends (3,) [m] before loads bow it, and its frame there (9,)."""
    o = floats(work.origins + 24 * (i + 1))
    return (o[0], o[1], o[2]), frame_at(work.frames + 72 * (i + 1))


@entry()
def pushes(chain, bend, work):
    """Fill work.push (n, 6) at frames and origins of `cells.chain_frames`."""
    for i in range(chain.n):
        place, frame = end_at(work, i)
        force, moment, _, _ = push_at(chain, work, i, place, frame)
        push = floats(work.push + 48 * i)
        push[0], push[1], push[2] = force
        push[3], push[4], push[5] = moment


@compiled
def pushed(chain, work, i):
    """Force (3,) [N] and moment (3,) [N·m] of work.push on the end of cell i."""
    if not stages.push_acts(chain):
        return NO_LOAD, NO_LOAD
    push = floats(work.push + 48 * i)
    return (push[0], push[1], push[2]), (push[3], push[4], push[5])


@contracted
def cross(r, f):
    """r x f of two triples."""
    return (r[1] * f[2] - r[2] * f[1], r[2] * f[0] - r[0] * f[2], r[0] * f[1] - r[1] * f[0])


@contracted
def plus(a, b):
    """Sum of two triples."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@contracted
def scaled(s, a):
    """Return a triple times a number."""
    return s * a[0], s * a[1], s * a[2]


@contracted
def local(f, v):
    """Components in a frame of a vector in the base frame."""
    return (
        f[0] * v[0] + f[3] * v[1] + f[6] * v[2],
        f[1] * v[0] + f[4] * v[1] + f[7] * v[2],
        f[2] * v[0] + f[5] * v[1] + f[8] * v[2],
    )


@contracted
def turned(f, v):
    """Components in the base frame of a vector in a frame."""
    return (
        f[0] * v[0] + f[1] * v[1] + f[2] * v[2],
        f[3] * v[0] + f[4] * v[1] + f[5] * v[2],
        f[6] * v[0] + f[7] * v[1] + f[8] * v[2],
    )


@contracted
def shift_moment(x, y, f, across, stretching, sinking):
    """
    Moment (x, y) on a bend of a force f at the end of its cell, in the cell's first frame.

    The end lies at rho u + zeta z: across = rho / a, stretching = (rho' - rho / a) / a²,
    sinking = zeta' / a.
    """
    along = stretching * (f[0] * x + f[1] * y) + sinking * f[2]
    return across * f[0] + along * x, across * f[1] + along * y


@contracted
def turn_moment(x, y, t, sinc, versine, own):
    """
    Moment (x, y) on a bend of a torque t at the end of its cell, in the cell's first frame.

    The frame there turns by the left Jacobian of exp(a z x u): sinc = sin(a) / a, versine =
    (1 - cos a) / a², own = (1 - sinc) / a².
    """
    along = own * (t[1] * x - t[0] * y)
    up = versine * t[2]
    return sinc * t[1] + along * x - up * y, -sinc * t[0] + along * y + up * x


@compiled
def beside_moment(x, y, s, c, own, beside):
    """Moment (x, y) on a bend of a weight beside the axis, which half the bend turns; its arm."""
    bx, by = 0.5 * x, 0.5 * y
    s, c = halved(s, c)
    sinc, versine, toward = 2.0 * s * c, 2.0 * s * s, bx * beside[0] + by * beside[1]
    arm = (beside[0] - versine * toward * bx, beside[1] - versine * toward * by, -sinc * toward)
    own_factor = versine - arc_factor(bx * bx + by * by, s, c)
    mx, my = turn_moment(bx, by, cross(arm, own), sinc, versine, own_factor)
    return 0.5 * mx, 0.5 * my, arm


@fused
def cell_moment(chain, i, x, y, s, c, loads, reach, bow, general):
    """
    Moment (x, y) on one bend of a force and a torque at the cell's end and of its own weight.

    All in the frame that bends; half an arc's bend moves its middle, a hinge's does not. Also
    returns where the weight lies (x, y, z) [m], and how far the cell's end bows (x, y, z) [m].

    Parameters
    ----------
    x, y : float
        Bend [rad].
    s, c : float
        sin(a / 2) / a [1/rad] and cos(a / 2) of its size a, see `cells`.
    loads : tuple
        Force and torque of everything beyond, at the cell's end, and the cell's own weight:
        (3,) [N], (3,) [N·m], (3,) [N].
    reach : float
        Length of the cell [m].
    bow : float
        `bow_compliance` [m/N]; without it all is linear in the loads.
    general : bool
        Whether the weight may lie beside the axis.

    """
    mx, my, middle, over = middle_moment(
        x, y, s, c, loads, reach, cell(chain, i, layout.HINGE), bow
    )
    if general:
        beside = (cell(chain, i, layout.MASS_X), cell(chain, i, layout.MASS_Y))
        ox, oy, arm = beside_moment(x, y, s, c, loads[2], beside)
        mx, my, middle = mx + ox, my + oy, plus(middle, arm)
    return mx, my, middle, over


@contracted
def middle_moment(x, y, s, c, loads, cell_length, hinge, bow):
    """Return the results of `cell_moment` for a weight on the axis."""
    (force, torque, own), q = loads, x * x + y * y
    sinc, versine = 2.0 * s * c, 2.0 * s * s
    whole = arc_factor(q, s, c)
    tx, ty = turn_moment(x, y, torque, sinc, versine, versine - whole)
    if hinge > 0.5:
        half = 0.5 * cell_length
        fx, fy = shift_moment(x, y, force, half * sinc, -half * whole, -half * sinc)
        return tx + fx, ty + fy, (0.0, 0.0, half), NO_LOAD
    s2, c2 = halved(s, c)
    s4, c4 = halved(s2, c2)
    part, quarter = arc_factor(0.25 * q, s2, c2), arc_factor(0.0625 * q, s4, c4)
    half, lean = 0.5 * cell_length, cell_length * s2 * s2
    fx, fy = shift_moment(
        x, y, force, cell_length * versine, -half * s * part, -cell_length * whole
    )
    ox, oy = shift_moment(0.5 * x, 0.5 * y, own, lean, -0.5 * half * s2 * quarter, -half * part)
    mx, my = tx + fx + 0.5 * ox, ty + fy + 0.5 * oy
    middle, over = (0.5 * lean * x, 0.5 * lean * y, cell_length * s), NO_LOAD
    if bow > 0.0:
        bx, by, over = bowed(bow, x, y, s, c, part, plus(force, scaled(0.5, own)))
        mx, my, middle = mx + bx, my + by, plus(middle, scaled(0.5, over))
    return mx, my, middle, over


@entry()
def bow_cells(chain, bend, work):
    """Move work.origins by how far cells bow; entry 0 of the frames need not be the base's."""
    general = is_general(chain)
    bends, half, origins = floats(bend), floats(work.half), floats(work.origins)
    scale, beyond, shift = floats(work.settings)[layout.LOAD_SCALE], at_tip(chain)[0], NO_LOAD
    if stages.push_acts(chain):
        chain.pushes(chain, bend, work)
    for i in range(chain.n):
        beyond = plus(beyond, plus(weight(chain, i), pushed(chain, work, i)[0]))
    for i in range(chain.n):
        own, f = weight(chain, i), BASE_FRAME
        across = scaled(scale, plus(beyond, scaled(-0.5, own)))
        if i > 0:
            f = bending_frame(chain, bend, work, i, general)
        elif general:
            f = turned_axes(BASE_FRAME, 0.5 * twist_in(chain, bend, i))
        x, y, s, c = bends[2 * i], bends[2 * i + 1], half[2 * i], half[2 * i + 1]
        part, bow = half_arc(x, y, s, c), bow_compliance(chain, work, i)
        _, _, over = bowed(bow, x, y, s, c, part, local(f, across))
        shift = plus(shift, turned(f, over))
        beyond = plus(beyond, scaled(-1.0, plus(own, pushed(chain, work, i)[0])))
        for r in range(3):
            origins[3 * i + 3 + r] += shift[r]


@entry()
def load_moments(chain, bend, work):
    """
    Fill work.load (n, 2) [N·m]: minus the gradient of the loads' potential energy by each bend.

    And work.torque (n,) that by each twist, where cells twist. work.half, work.frames and
    work.origins are those of these bends, by `cells.chain_frames`. work.wrench (n, 6) becomes
    the force [N] and the torque [N·m] at the end of each cell, of all beyond it.
    """
    general = is_general(chain)
    bends, moments, origins = floats(bend), floats(work.load), floats(work.origins)
    half, lengths = floats(work.half), floats(work.lengths)
    scale, (force, torque) = floats(work.settings)[layout.LOAD_SCALE], at_tip(chain)
    force, torque = scaled(scale, force), scaled(scale, torque)
    if stages.push_acts(chain):
        chain.pushes(chain, bend, work)
    for i in range(chain.n - 1, -1, -1):
        push, moment = pushed(chain, work, i)
        force, torque = plus(force, scaled(scale, push)), plus(torque, scaled(scale, moment))
        x, y, s, c = bends[2 * i], bends[2 * i + 1], half[2 * i], half[2 * i + 1]
        f = bending_frame(chain, bend, work, i, general)
        wrench = floats(work.wrench + 48 * i)
        wrench[0], wrench[1], wrench[2] = force
        wrench[3], wrench[4], wrench[5] = torque
        own, bow, o = scaled(scale, weight(chain, i)), bow_compliance(chain, work, i), 3 * i
        loads = (local(f, force), local(f, torque), local(f, own))
        mx, my, middle, over = cell_moment(chain, i, x, y, s, c, loads, lengths[i], bow, general)
        moments[2 * i], moments[2 * i + 1] = mx, my
        start = (origins[o], origins[o + 1], origins[o + 2])
        end = plus((origins[o + 3], origins[o + 4], origins[o + 5]), turned(f, over))
        reach = plus(end, scaled(-1.0, start))
        torque = plus(torque, plus(cross(reach, force), cross(turned(f, middle), own)))
        if general:
            floats(work.torque)[i] = axial_moment(
                x, y, 2.0 * s * c, 2.0 * s * s, loads[1], local(f, torque)
            )
        force = plus(force, own)
