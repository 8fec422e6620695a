"""From the moment on a cell to its bend: clearance, friction in the hinge, elasticity."""

import math

from .layout import PRESENT, STIFFNESS, cell, compiled, floats, fused, section_of
from .stages import (
    joint_friction,
    joint_friction_acts,
    memory_acts,
    moment,
    moment_acts,
    offset_scale,
    rest,
    stiffening,
    stiffening_acts,
    stiffness,
    torsion,
)


@compiled
def cell_stiffness(chain, i, section):
    """Bending stiffness of cell i with the tendons in it [N·m/rad]."""
    return stiffness(cell(chain, i, STIFFNESS), cell(chain, i, PRESENT), chain, section)


@compiled
def twist_of(chain, i, about):
    """Twist [rad] of cell i under a moment about its axis [N·m]."""
    section = section_of(chain, i)
    return torsion(0.0, about, cell_stiffness(chain, i, section), chain, section)


@compiled
def elastic_moment(chain, i, bx, by):
    """Moment (x, y) [N·m] that holds a bend against the backbone's elasticity."""
    section = section_of(chain, i)
    x0, y0 = rest(0.0, 0.0, chain, section)
    x, y = bx - x0, by - y0
    k = cell_stiffness(chain, i, section) * stiffening(1.0, x * x + y * y, chain, section)
    return k * x, k * y


@compiled
def bend_of(chain, k, size, section):
    """Solve K t stiffening(t²) = size for the bend t >= 0; NaN when there is none."""
    t = size / k
    if not stiffening_acts(chain):
        return t
    t = min(t, 1.0)
    for _ in range(60):
        g = stiffening(1.0, t * t, chain, section)
        h = 1e-6 * (1.0 + t)
        slope = (
            stiffening(1.0, (t + h) * (t + h), chain, section)
            - stiffening(1.0, (t - h) * (t - h), chain, section)
        ) / (2.0 * h)
        step = (k * t * g - size) / (k * (g + t * slope))
        t -= step
        if abs(step) < 1e-14 * (1.0 + t):
            return t
    return math.nan


@compiled
def is_linear(chain):
    """Tell whether every cell bends in proportion to the moment on it."""
    return not (moment_acts(chain) or joint_friction_acts(chain) or stiffening_acts(chain))


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
    x0, y0 = rest(0.0, 0.0, chain, section_of(chain, i))
    compliance = floats(work.compliance)[i]
    slope = scale * compliance
    return x0 + compliance * load_x + slope * mx, y0 + compliance * load_y + slope * my


@compiled
def bend_cell(chain, past, i, mx, my, total):
    """Bend (x, y) of a cell under a moment [N·m] and the sum of tensions [N] that press it."""
    section = section_of(chain, i)
    size = math.sqrt(mx * mx + my * my)
    if moment_acts(chain) and size > 0.0:
        radius = chain.radius * offset_scale(1.0, chain, 0)
        factor = moment(size, total, radius, chain, section) / size
        mx, my = mx * factor, my * factor
    if joint_friction_acts(chain):
        hx, hy = 0.0, 0.0
        if memory_acts(chain):
            before = floats(past.bend + 16 * i)
            hx, hy = elastic_moment(chain, i, before[0], before[1])
        dx, dy = mx - hx, my - hy
        size = math.sqrt(dx * dx + dy * dy)
        if size > 0.0:
            factor = joint_friction(size, total, chain, section) / size
            mx, my = hx + dx * factor, hy + dy * factor
    size = math.sqrt(mx * mx + my * my)
    x0, y0 = rest(0.0, 0.0, chain, section)
    if size == 0.0:
        return x0, y0
    t = bend_of(chain, cell_stiffness(chain, i, section), size, section) / size
    return x0 + t * mx, y0 + t * my
