"""From bends to frames, positions, tendon travel and arms, and the moments of loads."""

import math

from .layout import HINGE, LENGTH, MASS, cell, compiled, floats, section_of, words
from .stages import (
    arm,
    arm_acts,
    length,
    length_acts,
    load,
    load_acts,
    rest,
    tip_load,
    tip_load_acts,
)


@compiled
def cell_end(bend, cell_length, hinge):
    """Where a cell ends: (towards the bend [m], along z [m]), and both derivatives by the bend."""
    if hinge > 0.5:
        half = 0.5 * cell_length
        s, c = math.sin(bend), math.cos(bend)
        return half * s, half * (1.0 + c), half * c, -half * s
    if bend < 1e-3:
        b2 = bend * bend
        return (
            cell_length * bend * (0.5 - b2 / 24.0),
            cell_length * (1.0 - b2 / 6.0),
            cell_length * (0.5 - b2 / 8.0),
            cell_length * bend * (-1.0 / 3.0 + b2 / 30.0),
        )
    s, c = math.sin(bend), math.cos(bend)
    across, along = cell_length * (1.0 - c) / bend, cell_length * s / bend
    return across, along, (cell_length * s - across) / bend, (cell_length * c - along) / bend


@compiled
def polar(bx, by):
    """Size of a bend [rad], its direction (x, y), sine and cosine of half the size."""
    a = math.sqrt(bx * bx + by * by)
    if a < 1e-300:
        return 0.0, 1.0, 0.0, 0.0, 1.0
    return a, bx / a, by / a, math.sin(0.5 * a), math.cos(0.5 * a)


@compiled
def end_of(polar_bend, cell_length, hinge):
    """Where a cell ends: (towards the bend [m], along z [m])."""
    a, _, _, sin_half, cos_half = polar_bend
    s, v = 2.0 * sin_half * cos_half, 2.0 * sin_half * sin_half
    if hinge > 0.5:
        return 0.5 * cell_length * s, cell_length * (1.0 - 0.5 * v)
    if a < 1e-4:
        return 0.5 * cell_length * a, cell_length * (1.0 - a * a / 6.0)
    return cell_length * v / a, cell_length * s / a


@compiled
def turn(frame, polar_bend, after):
    """`after` = `frame` exp(bend): rotation about z x u by |bend|, without twist."""
    _, ux, uy, sin_half, cos_half = polar_bend
    s, v = 2.0 * sin_half * cos_half, 2.0 * sin_half * sin_half
    old, new = floats(frame), floats(after)
    for r in range(3):
        fx, fy, fz = old[3 * r], old[3 * r + 1], old[3 * r + 2]
        fu = fx * ux + fy * uy
        w = v * fu + s * fz
        new[3 * r] = fx - ux * w
        new[3 * r + 1] = fy - uy * w
        new[3 * r + 2] = s * fu + (1.0 - v) * fz


@compiled
def chain_frames(chain, bend, work):
    """Fill work.frames (n + 1, 3, 3) and work.origins (n + 1, 3) [m]; index 0 is the base."""
    frames, origins, bends = floats(work.frames), floats(work.origins), floats(bend)
    for r in range(9):
        frames[r] = 1.0 if r % 4 == 0 else 0.0
    for r in range(3):
        origins[r] = 0.0
    for i in range(chain.n):
        bend_i = polar(bends[2 * i], bends[2 * i + 1])
        across, along = end_of(bend_i, floats(work.lengths)[i], cell(chain, i, HINGE))
        ex, ey = across * bend_i[1], across * bend_i[2]
        for r in range(3):
            f = 9 * i + 3 * r
            origins[3 * i + 3 + r] = (
                origins[3 * i + r] + frames[f] * ex + frames[f + 1] * ey + frames[f + 2] * along
            )
        turn(work.frames + 72 * i, bend_i, work.frames + 72 * (i + 1))


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
    """Path that tendon k loses in cell i [m], its arm along the bend [m], factor across [1]."""
    offset = floats(chain.offset + 16 * (chain.k * i + k))
    radial = scale * (offset[0] * ux + offset[1] * uy)
    return arm(
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
def tendon_travel(chain, bend, scale, work):
    """Fill work.travel (n, k) [m] since the rest shape and, if needed, work.arms (n, k, 2) [m]."""
    if not arm_acts(chain):
        plain_travel(chain, bend, scale, work)
        return
    travel, arms, tendon = floats(work.travel), floats(work.arms), words(chain.tendon)
    for i in range(chain.n):
        bends = floats(bend + 16 * i)
        a, ux, uy, sin_half, cos_half = polar(bends[0], bends[1])
        x0, y0 = rest(0.0, 0.0, chain, section_of(chain, i))
        a0, ux0, uy0, sin0, cos0 = polar(x0, y0)
        for k in range(chain.k):
            at = chain.k * i + k
            if i >= tendon[2 * k]:
                travel[at] = 0.0
                continue
            lost, along, across = path_lost(chain, i, k, a, ux, uy, sin_half, cos_half, scale)
            if a0 > 0.0:
                lost -= path_lost(chain, i, k, a0, ux0, uy0, sin0, cos0, scale)[0]
            travel[at] = lost
            offset = floats(chain.offset + 16 * at)
            side = scale * (offset[1] * ux - offset[0] * uy) * across
            arms[2 * at] = along * ux - side * uy
            arms[2 * at + 1] = along * uy + side * ux


@compiled
def loaded(chain):
    """Tell whether any load acts."""
    return load_acts(chain) or tip_load_acts(chain)


@compiled
def local(frame, x, y, z):
    """Components in a frame of a vector in the base frame."""
    f = floats(frame)
    return (
        f[0] * x + f[3] * y + f[6] * z,
        f[1] * x + f[4] * y + f[7] * z,
        f[2] * x + f[5] * y + f[8] * z,
    )


@compiled
def bend_moment(bx, by, frame, force, torque, rigid, cell_length, hinge):
    """
    Moment (x, y) on one bend of a force [N] and a torque [N·m] at the cell's end.

    Virtual work: the end lies at rho(a) u + zeta(a) z of the proximal `frame`, and the end's
    frame turns by the left Jacobian of exp(a z x u). `rigid` 0: the point does not turn with it.
    """
    a = math.sqrt(bx * bx + by * by)
    ux, uy = 1.0, 0.0
    if a > 1e-300:
        ux, uy = bx / a, by / a
    fx, fy, fz = local(frame, force[0], force[1], force[2])
    tx, ty, tz = local(frame, torque[0], torque[1], torque[2])
    rho, _, rho_a, zeta_a = cell_end(a, cell_length, hinge)
    if a < 1e-4:
        sinc, versine, rho_over = 1.0 - a * a / 6.0, 0.5 * a, rho_a
    else:
        sinc, versine, rho_over = math.sin(a) / a, (1.0 - math.cos(a)) / a, rho / a
    along = (fx * ux + fy * uy) * rho_a + fz * zeta_a + rigid * (ty * ux - tx * uy)
    across = (fy * ux - fx * uy) * rho_over + rigid * (-(tx * ux + ty * uy) * sinc + tz * versine)
    return along * ux - across * uy, along * uy + across * ux


@compiled
def weight(chain, i):
    """Force of the loads on cell i at its middle (x, y, z) [N]."""
    g = floats(chain.gravity)
    return load(0.0, 0.0, 0.0, cell(chain, i, MASS), g[0], g[1], g[2], chain, section_of(chain, i))


@compiled
def force_at_tip(chain):
    """Force at the tip (x, y, z) [N]."""
    return tip_load(0.0, 0.0, 0.0, chain, 0)
