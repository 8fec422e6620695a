"""From bends to cell lengths, tendon travel and the moment arms of the tendons."""

import math

from .layout import HINGE, LENGTH, cell, compiled, floats, section_of, words
from .stages import length, length_acts, rest, tendon_path, tendon_path_acts
from .turning import half_turn


@compiled
def polar(x, y, s, c):
    """Size of a bend [rad], its direction (x, y), sine and cosine of half the size."""
    a = math.sqrt(x * x + y * y)
    if a < 1e-150:
        return 0.0, 1.0, 0.0, 0.0, 1.0
    over = 1.0 / a
    return a, x * over, y * over, s * a, c


@compiled
def scale_lengths(chain, work):
    """Fill work.lengths (n,) [m] under the tensions (n, k) that press the cells."""
    tensions, lengths, tendon = floats(work.tensions), floats(work.lengths), words(chain.tendon)
    shortens = length_acts(chain)
    for i in range(chain.n):
        lengths[i] = cell(chain, i, LENGTH)
        if not shortens:
            continue
        total = 0.0
        for k in range(chain.k):
            if i < tendon[2 * k]:
                total += tensions[chain.k * i + k]
        lengths[i] *= length(1.0, total, chain, section_of(chain, i))


@compiled
def path_lost(chain, i, k, bend, ux, uy, sin_half, cos_half, scale):
    """
    Path that tendon k loses in cell i [m], its moment arm along the bend and across it [m].

    Parameters
    ----------
    bend : float
        Size of the cell's bend [rad].
    ux, uy : float
        Its direction, of length one.
    sin_half, cos_half : float
        Of half the bend.
    scale : float
        Factor on the tendon offsets [1].

    """
    offset = floats(chain.offset + 16 * (chain.k * i + k))
    radial = scale * (offset[0] * ux + offset[1] * uy)
    lost, along, across = tendon_path(
        radial * bend,
        radial,
        1.0,
        bend,
        sin_half,
        cos_half,
        radial,
        cell(chain, i, LENGTH),
        cell(chain, i, HINGE) > 0.5,
        chain,
        section_of(chain, i),
    )
    return lost, along, scale * (offset[1] * ux - offset[0] * uy) * across


@compiled
def moment_of_tendons(chain, i, x, y, tensions, scale):
    """Moment (x, y) [N·m] of tensions (k,) [N] on cell i bent by (x, y), tendons straight."""
    tendon = words(chain.tendon)
    s, c = half_turn(x * x + y * y)
    a, ux, uy, sin_half, cos_half = polar(x, y, s, c)
    mx, my = 0.0, 0.0
    for k in range(chain.k):
        t = floats(tensions)[k]
        if i < tendon[2 * k] and t != 0.0:
            _, along, side = path_lost(chain, i, k, a, ux, uy, sin_half, cos_half, scale)
            mx += t * (along * ux - side * uy)
            my += t * (along * uy + side * ux)
    return mx, my


@compiled
def plain_travel(chain, bend, scale, work):
    """Fill work.travel (n, k) [m] since the rest shape where tendons follow the backbone."""
    travel, offsets, bends = floats(work.travel), floats(chain.offset), floats(bend)
    tendon = words(chain.tendon)
    for i in range(chain.n):
        x0, y0 = rest(0.0, 0.0, chain, section_of(chain, i))
        x, y = scale * (bends[2 * i] - x0), scale * (bends[2 * i + 1] - y0)
        for k in range(chain.k):
            at = chain.k * i + k
            lost = offsets[2 * at] * x + offsets[2 * at + 1] * y
            travel[at] = lost if i < tendon[2 * k] else 0.0


@compiled
def straight_travel(chain, i, x, y, s, c, scale, work):
    """
    Fill travel and moment_arms [m] of cell i, bent by (x, y) with half angles s, c.

    Parameters
    ----------
    x, y : float
        Bend [rad].
    s, c : float
        sin(a / 2) / a [1/rad] and cos(a / 2) of its size a, see `turning`.
    scale : float
        Factor on the tendon offsets [1].

    """
    travel, tendon = floats(work.travel), words(chain.tendon)
    moment_arms = floats(work.moment_arms)
    a, ux, uy, sin_half, cos_half = polar(x, y, s, c)
    x0, y0 = rest(0.0, 0.0, chain, section_of(chain, i))
    s0, c0 = half_turn(x0 * x0 + y0 * y0)
    a0, ux0, uy0, sin0, cos0 = polar(x0, y0, s0, c0)
    for k in range(chain.k):
        at = chain.k * i + k
        if i >= tendon[2 * k]:
            travel[at] = 0.0
            continue
        lost, along, side = path_lost(chain, i, k, a, ux, uy, sin_half, cos_half, scale)
        if a0 > 0.0:
            lost -= path_lost(chain, i, k, a0, ux0, uy0, sin0, cos0, scale)[0]
        travel[at] = lost
        moment_arms[2 * at] = along * ux - side * uy
        moment_arms[2 * at + 1] = along * uy + side * ux


@compiled
def tendon_travel(chain, bend, scale, work):
    """
    Fill work.travel (n, k) [m] since the rest shape and, where needed, work.moment_arms [m].

    work.half is that of these bends.
    """
    if not tendon_path_acts(chain):
        plain_travel(chain, bend, scale, work)
        return
    bends, half = floats(bend), floats(work.half)
    for i in range(chain.n):
        x, y, s, c = bends[2 * i], bends[2 * i + 1], half[2 * i], half[2 * i + 1]
        straight_travel(chain, i, x, y, s, c, scale, work)


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
