"""From bends to cell lengths, tendon travel and the moment arms of the tendons."""

import math

from . import layout, stages
from .cells import follows_shape, half_turn, leans, twist_in
from .layout import cell, compiled, entry, floats, fused, inlined, words


@fused
def polar(x, y, s, c):
    """Size of a bend [rad], its direction (x, y), sine and cosine of half the size."""
    q = x * x + y * y
    if q < layout.TINY:
        return 0.0, 1.0, 0.0, 0.0, 1.0
    a = math.sqrt(q)
    over = 1.0 / a
    return a, x * over, y * over, s * a, c


@compiled
def scale_lengths(chain, work):
    """Fill work.lengths (n,) [m] under the tensions (n, k) that press the cells."""
    tensions, tendon = floats(work.tensions), words(chain.tendon)
    for i in range(chain.n if stages.length_acts(chain) else 0):
        total = 0.0
        for k in range(chain.k):
            if i < tendon[2 * k]:
                total += tensions[chain.k * i + k]
        shortened = stages.length(1.0, total, chain, i)
        floats(work.lengths)[i] = cell(chain, i, layout.LENGTH) * shortened


@compiled
def bent_path(chain, i, radial, bend, sin_half, cos_half):
    """Path lost by a bend [m], derivative by the bend [m], and factor on an offset across it."""
    return stages.tendon_path(
        radial * bend,
        radial,
        1.0,
        bend,
        sin_half,
        cos_half,
        radial,
        cell(chain, i, layout.LENGTH),
        cell(chain, i, layout.HINGE) > 0.5,
        chain,
        i,
    )


@compiled
def leaning_tendon(chain, i, k, turning, scale, twist):
    """
    Path lost by tendon k, which leans (see `cells`), in cell i, and its moment arms [m].

    The chord between its eyelets: what the bend leaves of the cell's length along the chord of
    the backbone, and across it the line from one offset to the other, seen from half the bend.
    `straight_tendon` says what it takes.
    """
    at, (bend, ux, uy, sin_half, cos_half) = chain.k * i + k, turning
    offset = floats(chain.offset + 16 * at)
    helix = floats(chain.helix)[at] if chain.helix != 0 else 0.0
    rx, ry = scale * offset[0], scale * offset[1]
    ahead, aside = rx * ux + ry * uy, ry * ux - rx * uy  # in the bend plane and across it
    co, si = math.cos(0.5 * (twist + helix)), math.sin(0.5 * (twist + helix))
    lost, along, across = bent_path(chain, i, co * ahead, bend, sin_half, cos_half)
    straight = cell(chain, i, layout.LENGTH)
    reach, shift, shift_aside = straight - lost, -2.0 * si * aside, 2.0 * si * ahead
    q = cos_half * cos_half
    over = 1.0 / math.sqrt(reach * reach + q * shift * shift + shift_aside * shift_aside)
    along = reach * along + 0.5 * shift * shift * sin_half * cos_half
    side = reach * across * co * aside
    if bend > 0.0:
        side += shift * shift_aside * sin_half * sin_half / bend
    about = -0.5 * reach * across * bend * si * ahead
    about += co * (q * shift * aside - shift_aside * ahead)
    si = 2.0 * math.sin(0.5 * helix)
    straight = math.sqrt(straight * straight + si * si * (rx * rx + ry * ry))
    return straight - 1.0 / over, over * along, over * side, over * about


@fused
def straight_tendon(chain, i, k, turning, scale, twist):
    """
    Path that tendon k loses in cell i [m], its moment arms along the bend, across it, about.

    Of a tendon that does not lean; `leaning_tendon` takes and returns the same.

    Parameters
    ----------
    turning : tuple of float
        The cell's bend as `polar` returns it.
    scale : float
        Factor on the tendon offsets [1].
    twist : float
        Of the cell [rad].

    """
    bend, ux, uy, sin_half, cos_half = turning
    offset = floats(chain.offset + 16 * (chain.k * i + k))
    radial = scale * (offset[0] * ux + offset[1] * uy)
    lost, along, across = bent_path(chain, i, radial, bend, sin_half, cos_half)
    return lost, along, scale * (offset[1] * ux - offset[0] * uy) * across, 0.0


@inlined
def add_moments(chain, i, x, y, twist, tensions, scale, path_lost):
    """Moment (x, y, about) [N·m] of tensions (k,) [N] on cell i with bend (x, y) and twist."""
    tendon = words(chain.tendon)
    s, c = half_turn(x * x + y * y)
    turning = polar(x, y, s, c)
    _, ux, uy, _, _ = turning
    mx, my, mz = 0.0, 0.0, 0.0
    for k in range(chain.k):
        t = floats(tensions)[k]
        if i < tendon[2 * k] and t != 0.0:
            _, along, side, about = path_lost(chain, i, k, turning, scale, twist)
            mx += t * (along * ux - side * uy)
            my += t * (along * uy + side * ux)
            mz += t * about
    return mx, my, mz


@fused
def fill_travel(chain, i, x, y, s, c, twist, scale, work, path_lost):
    """
    Fill travel, moment_arms and axial [m] of cell i, bent by (x, y) with half angles s, c.

    Parameters
    ----------
    x, y, twist : float
        Bend and twist [rad].
    s, c : float
        sin(a / 2) / a [1/rad] and cos(a / 2) of its size a, see `cells`.
    scale : float
        Factor on the tendon offsets [1].
    path_lost : function
        `straight_tendon`, or `leaning_tendon` where tendons may lean: each has code of its own.

    """
    travel, tendon = floats(work.travel), words(chain.tendon)
    moment_arms = floats(work.moment_arms)
    turning = polar(x, y, s, c)
    _, ux, uy, _, _ = turning
    for k in range(chain.k):
        at = chain.k * i + k
        if i >= tendon[2 * k]:
            travel[at] = 0.0
            continue
        travel[at], along, side, about = path_lost(chain, i, k, turning, scale, twist)
        floats(work.axial)[at] = about
        moment_arms[2 * at] = along * ux - side * uy
        moment_arms[2 * at + 1] = along * uy + side * ux
    x0, y0 = stages.rest(0.0, 0.0, chain, i)
    if x0 != 0.0 or y0 != 0.0:
        s, c = half_turn(x0 * x0 + y0 * y0)
        turning = polar(x0, y0, s, c)
        for k in range(chain.k):
            if turning[0] > 0.0 and i < tendon[2 * k]:
                travel[chain.k * i + k] -= path_lost(chain, i, k, turning, scale, 0.0)[0]


@entry()
def leaning_travel(chain, i, x, y, s, c, twist, scale, work):
    """Fill travel and moment arms of a cell (`fill_travel`) whose tendons may lean."""
    fill_travel(chain, i, x, y, s, c, twist, scale, work, leaning_tendon)


@compiled
def shaped_travel(chain, i, x, y, s, c, twist, scale, work):
    """Fill travel and moment arms of a cell (`fill_travel`), each kind by code of its own."""
    if leans(chain):
        chain.leaning_travel(chain, i, x, y, s, c, twist, scale, work)
    else:
        fill_travel(chain, i, x, y, s, c, 0.0, scale, work, straight_tendon)


@compiled
def tendon_travel(chain, bend, scale, work):
    """
    Fill work.travel (n, k) [m] since the rest shape and, where needed, moment_arms and axial [m].

    work.half is that of these bends.
    """
    bends, half = floats(bend), floats(work.half)
    if not follows_shape(chain):  # tendons follow the backbone
        travel, offsets, tendon = floats(work.travel), floats(chain.offset), words(chain.tendon)
        for i in range(chain.n):
            x0, y0 = stages.rest(0.0, 0.0, chain, i)
            x, y = scale * (bends[2 * i] - x0), scale * (bends[2 * i + 1] - y0)
            for k in range(chain.k):
                at = chain.k * i + k
                lost = offsets[2 * at] * x + offsets[2 * at + 1] * y
                travel[at] = lost if i < tendon[2 * k] else 0.0
        return
    for i in range(chain.n):
        x, y, s, c = bends[2 * i], bends[2 * i + 1], half[2 * i], half[2 * i + 1]
        shaped_travel(chain, i, x, y, s, c, twist_in(chain, bend, i), scale, work)


@compiled
def travel_beyond(chain, work):
    """Fill work.beyond (n, k) [m]: what every tendon travels at the eyelet behind a cell."""
    travel, beyond, tendon = floats(work.travel), floats(work.beyond), words(chain.tendon)
    for k in range(chain.k):
        total = 0.0
        for i in range(tendon[2 * k] - 1, -1, -1):
            at = chain.k * i + k
            beyond[at] = total
            total += travel[at]
