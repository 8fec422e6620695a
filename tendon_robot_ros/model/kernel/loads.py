"""Moments of the loads on every bend, by virtual work, from the tip to the base."""

import math

from .geometry import bend_moment, cell_end, force_at_tip, weight
from .layout import HINGE, cell, compiled, floats

NONE = (0.0, 0.0, 0.0)


@compiled
def cross(r, f):
    """r x f of two triples."""
    return (r[1] * f[2] - r[2] * f[1], r[2] * f[0] - r[0] * f[2], r[0] * f[1] - r[1] * f[0])


@compiled
def plus(a, b):
    """Sum of two triples."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def scaled(s, a):
    """Return a triple times a number."""
    return s * a[0], s * a[1], s * a[2]


@compiled
def middle_of(chain, i, bx, by, work):
    """From the proximal end of cell i to its middle (x, y, z) [m], base frame."""
    a = math.sqrt(bx * bx + by * by)
    cell_length = floats(work.lengths)[i]
    across, along = 0.0, 0.5 * cell_length
    if cell(chain, i, HINGE) < 0.5:
        across, along, _, _ = cell_end(0.5 * a, along, 0.0)
    x, y = 0.0, 0.0
    if a > 1e-300:
        x, y = across * bx / a, across * by / a
    f = floats(work.frames + 72 * i)
    return (
        f[0] * x + f[1] * y + f[2] * along,
        f[3] * x + f[4] * y + f[5] * along,
        f[6] * x + f[7] * y + f[8] * along,
    )


@compiled
def load_moments(chain, bend, work):
    """
    Fill work.load (n, 2) [N·m]: minus the gradient of the loads' potential energy by each bend.

    work.frames and work.origins are those of these bends. The weight of a cell acts at its
    middle: an arc's own bend moves it (half the arc), a hinge's does not.
    """
    bends, moments, origins = floats(bend), floats(work.load), floats(work.origins)
    scale = floats(work.slip)[1]
    force, torque = scaled(scale, force_at_tip(chain)), NONE
    for i in range(chain.n - 1, -1, -1):
        bx, by, hinge = bends[2 * i], bends[2 * i + 1], cell(chain, i, HINGE)
        frame, cell_length = work.frames + 72 * i, floats(work.lengths)[i]
        x, y = bend_moment(bx, by, frame, force, torque, 1.0, cell_length, hinge)
        own = scaled(scale, weight(chain, i))
        if hinge < 0.5:
            ox, oy = bend_moment(
                0.5 * bx, 0.5 * by, frame, own, NONE, 0.0, 0.5 * cell_length, hinge
            )
            x, y = x + 0.5 * ox, y + 0.5 * oy
        moments[2 * i], moments[2 * i + 1] = x, y
        at = 3 * i
        reach = (
            origins[at + 3] - origins[at],
            origins[at + 4] - origins[at + 1],
            origins[at + 5] - origins[at + 2],
        )
        torque = plus(torque, cross(reach, force))
        torque = plus(torque, cross(middle_of(chain, i, bx, by, work), own))
        force = plus(force, own)


@compiled
def potential(chain, bend, work):
    """Potential energy of the loads [J] for work.frames and work.origins of these bends."""
    bends, origins = floats(bend), floats(work.origins)
    energy = 0.0
    for i in range(chain.n):
        middle = middle_of(chain, i, bends[2 * i], bends[2 * i + 1], work)
        own = weight(chain, i)
        for r in range(3):
            energy -= own[r] * (origins[3 * i + r] + middle[r])
    tip = force_at_tip(chain)
    for r in range(3):
        energy -= tip[r] * origins[3 * chain.n + r]
    return energy
