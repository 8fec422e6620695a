"""
Derivatives of what the loads say about a cell: of their moment, and of what it passes on.

Taken by central differences of the cell's own functions, in `loads`; see `tangent`.
"""

from .cells import arc_factor, axial_moment, bending_frame, end_of, half_turn, is_general
from .layout import (
    BY_TENSION,
    BY_TORQUE,
    BY_TURN,
    HINGE,
    LOAD_SLOPES,
    OWN,
    PULLS,
    SIZE,
    TENDON,
    TORQUE_BY_OWN,
    TORQUE_BY_TURN,
    TURNS,
    YES,
    cell,
    compiled,
    entry,
    floats,
    inlined,
    section_of,
    words,
)
from .loads import (
    NO_LOAD,
    along_middle,
    bow_compliance,
    cell_moment,
    cross,
    half_arc,
    local,
    plus,
    scaled,
    turn_moment,
    turned,
    weight,
)
from .stages import length, length_acts

BEND_STEP = 1e-5  # [rad] of central differences
TENSION_STEP = 1e-4  # [1], and of 10 mN


@inlined
def bend_cell_of(chain, work, i, x, y, force, torque, own, bow, general):
    """
    Moment (x, y, about) [N·m] on a cell bent by (x, y), where its end and its weight lie [m].

    Parameters
    ----------
    x, y : float
        Bend [rad].
    force, torque, own : tuple of float
        Of all beyond at the cell's end, and its weight, in the frame that bends: (3,) [N], [N·m],
        [N].
    bow : float
        `loads.bow_compliance` [m/N]; without it all is linear in the loads.
    general : bool
        Whether cells twist or weight lies beside the axis; a constant.

    """
    s, c = half_turn(x * x + y * y)
    reach = floats(work.lengths)[i]
    mx, my, middle, over = cell_moment(
        chain, i, x, y, s, c, force, torque, own, reach, bow, general
    )
    across, along = end_of(x * x + y * y, s, c, reach, cell(chain, i, HINGE))
    end, about = plus((across * x, across * y, along), over), 0.0
    if general:
        start = plus(torque, plus(cross(end, force), cross(middle, own)))
        about = axial_moment(x, y, 2.0 * s * c, 2.0 * s * s, torque, start)
    return (mx, my, about), end, middle


@compiled
def bent_cell(chain, work, i, x, y, force, torque, own, bow):
    """Return `bend_cell_of` where loads do no more than bend."""
    return bend_cell_of(chain, work, i, x, y, force, torque, own, bow, False)


@compiled
def general_cell(chain, work, i, x, y, force, torque, own, bow):
    """Return `bend_cell_of` where cells twist or weight lies beside the axis."""
    return bend_cell_of(chain, work, i, x, y, force, torque, own, bow, True)


@inlined
def loaded_cell(chain, work, i, x, y, force, torque, own, bow, general):
    """Return `bend_cell_of`, by code compiled once for each kind of loads."""
    if general:
        return general_cell(chain, work, i, x, y, force, torque, own, bow)
    return bent_cell(chain, work, i, x, y, force, torque, own, bow)


@compiled
def difference(h, a, b):
    """Return (a - b) / (2 h) of two triples."""
    return scaled(0.5 / h, (a[0] - b[0], a[1] - b[1], a[2] - b[2]))


@entry(LOAD_SLOPES)
def load_slopes(chain, bend, work, i, tangent, total):
    """
    Fill what the loads say about cell i, in which the tensions sum up to `total` [N].

    Of the derivatives of the cell, OWN, BY_TURN, BY_TORQUE and BY_TENSION take those of the
    moment, before they meet the compliance; what tendons say is added to in OWN.
    """
    row, general, h = floats(tangent), is_general(chain), BEND_STEP
    x, y = floats(bend)[2 * i], floats(bend)[2 * i + 1]
    f, wrench = bending_frame(chain, bend, work, i, general), floats(work.wrench + 48 * i)
    force, torque = (wrench[0], wrench[1], wrench[2]), (wrench[3], wrench[4], wrench[5])
    own = scaled(floats(work.slip)[1], weight(chain, i))
    loads, bow = (local(f, force), local(f, torque), local(f, own)), bow_compliance(chain, work, i)
    for a in range(2):
        dx, dy = (h, 0.0) if a == 0 else (0.0, h)
        m, up, mid = loaded_cell(chain, work, i, x + dx, y + dy, *loads, bow, general)
        n, low, lowmid = loaded_cell(chain, work, i, x - dx, y - dy, *loads, bow, general)
        add_column(row, a, difference(h, m, n))
        by_own = plus(
            cross(turned(f, difference(h, up, low)), force),
            cross(turned(f, difference(h, mid, lowmid)), own),
        )
        for r in range(3):
            row[TORQUE_BY_OWN + 3 * r + a] = by_own[r]
    turn_slopes(chain, f, work, i, x, y, force, torque, own, row, general)
    if bow > 0.0:
        bow_slopes(f, x, y, half_turn(x * x + y * y), bow, plus(force, scaled(0.5, own)), row)
    if general:
        add_column(row, 2, twist_slopes(f, row))
    if length_acts(chain):
        compression_slopes(chain, bend, work, i, total, tangent)


@inlined
def add_column(row, a, slopes):
    """Add the slopes (3,) of a cell's moment by its own bend (0, 1) or twist (2)."""
    for r in range(3):
        row[OWN + 3 * r + a] += slopes[r]


@compiled
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
    _, end, middle = loaded_cell(chain, work, i, x, y, *wrench, 0.0, general)
    end, middle = turned(f, end), turned(f, middle)
    for r in range(3):
        unit = (1.0 if r == 0 else 0.0, 1.0 if r == 1 else 0.0, 1.0 if r == 2 else 0.0)
        wrench = (cross(force, unit), cross(torque, unit), cross(own, unit))
        wrench = (local(f, wrench[0]), local(f, wrench[1]), local(f, wrench[2]))
        m, _, _ = loaded_cell(chain, work, i, x, y, *wrench, 0.0, general)
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
def bow_slopes(f, x, y, half, bow, force, row):
    """
    Add to what a turn of a cell's frame does that the cell bows, to its moment and its torque.

    Parameters
    ----------
    f : tuple of float
        Frame that bends (9,).
    x, y : float
        Bend [rad].
    half : tuple of float
        Its half angle, see `cells`.
    bow : float
        `loads.bow_compliance` [m/N].
    force : tuple of float
        Of all beyond the middle, base frame (3,) [N].
    row : pointer
        Derivatives of the cell.

    """
    s, c = half
    middle, own = (s * x, s * y, c), local(f, force)
    part = half_arc(x, y, s, c)
    g, gx, gy = along_middle(x, y, s, c, part, own)
    turning = cross(middle, own)
    for r in range(3):
        unit = (1.0 if r == 0 else 0.0, 1.0 if r == 1 else 0.0, 1.0 if r == 2 else 0.0)
        change = local(f, cross(force, unit))
        h, hx, hy = along_middle(x, y, s, c, part, change)
        row[BY_TURN + r] -= bow * (h * gx + g * hx)
        row[BY_TURN + 3 + r] -= bow * (h * gy + g * hy)
        # the torque is -B g m x F: that in the frame that bends, turned with it and by itself
        own_change = plus(scaled(h, turning), scaled(g, cross(middle, change)))
        row[BY_TURN + 6 + r] -= 0.5 * bow * own_change[2]
        torque = plus(turned(f, own_change), scaled(g, cross(unit, turned(f, turning))))
        for a in range(3):
            row[TORQUE_BY_TURN + 3 * a + r] -= bow * torque[a]


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
def compression_slopes(chain, bend, work, i, total, tangent):
    """Fill how the loads' moment (x, y, about) and the torque at the start follow tensions."""
    h, section = TENSION_STEP * (total + 0.01), section_of(chain, i)
    rate = length(1.0, total + h, chain, section) - length(1.0, total - h, chain, section)
    rate /= 2.0 * h * length(1.0, total, chain, section)
    x, y = floats(bend)[2 * i], floats(bend)[2 * i + 1]
    f, wrench = bending_frame(chain, bend, work, i, YES), floats(work.wrench + 48 * i)
    force = (wrench[0], wrench[1], wrench[2])
    own = scaled(floats(work.slip)[1], weight(chain, i))
    loads, lengths = (local(f, force), NO_LOAD, local(f, own)), floats(work.lengths)
    m, end, middle = general_cell(chain, work, i, x, y, *loads, 0.0)
    reach, lengths[i] = lengths[i], 0.0  # a weight beside the axis stays where it is
    rest, _, beside = general_cell(chain, work, i, x, y, *loads, 0.0)
    lengths[i] = reach
    m, middle = plus(m, scaled(-1.0, rest)), plus(middle, scaled(-1.0, beside))
    pull = plus(cross(turned(f, end), force), cross(turned(f, middle), own))
    for k in range(chain.k):
        if i < words(chain.tendon)[2 * k]:
            here = floats(tangent + 8 * (SIZE + TENDON * k))
            here[BY_TENSION], here[BY_TENSION + 1], here[BY_TENSION + 2] = scaled(rate, m)
            here[PULLS], here[PULLS + 1], here[PULLS + 2] = scaled(rate, pull)
