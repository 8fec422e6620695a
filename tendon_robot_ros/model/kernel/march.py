"""
Cell after cell from the base, where nothing beyond a cell decides about it.

Without loads and with friction that follows the bend of its own cell, all that cell i needs is
known once those before it are solved. Each is two equations; together they may be so stiff that no
solver of all cells at once ends: the sign of friction of a tendon across the bend turns with the
last digit of the bend.
"""

import numpy as np

from .bending import bend_cell, twist_of
from .geometry import shaped_travel
from .layout import MARCH, YES, address, compiled, entry, floats, residual_at
from .linear import largest
from .residual import moment_arms_of, tendon_moment
from .stages import offset_scale, torsion_acts
from .sweep import (
    active_stages,
    base_tensions,
    pass_eyelet,
    share_there,
    slip_rate_in,
    tendons_about,
)
from .turning import follows_shape, half_turn, twist_in, unknowns

RESIDUAL_STEP = 1e-7  # [rad] of the differences
RESIDUAL_SOLVED = 1e-13  # [rad] residual of a cell that is solved
STEPS_MAX = 30


@compiled
def twist_residual(chain, work, i, x, y, twist):
    """Residual [rad] of the twist of cell i, bent by (x, y), whose tensions are known."""
    s, c = floats(work.half)[2 * i], floats(work.half)[2 * i + 1]
    shaped_travel(chain, i, x, y, s, c, twist, offset_scale(1.0, chain, 0), work)
    return twist - twist_of(chain, i, tendons_about(chain, work, i))


@compiled
def solve_twist(chain, work, state, i, x, y):
    """Newton on the twist of cell i, kept in the state; leaves its moment arms behind."""
    twists = floats(state + 16 * chain.n)
    f = twist_residual(chain, work, i, x, y, twists[i])
    for _ in range(STEPS_MAX):
        if abs(f) < RESIDUAL_SOLVED:
            break
        slope = (
            twist_residual(chain, work, i, x, y, twists[i] + RESIDUAL_STEP) - f
        ) / RESIDUAL_STEP
        twists[i] -= f / slope
        f = twist_residual(chain, work, i, x, y, twists[i])


@compiled
def cell_residual(chain, work, past, state, i, last_x, last_y, x, y):
    """
    Residual (x, y) [rad] of cell i, bent by (x, y), behind a cell bent by the last ones.

    Parameters
    ----------
    last_x, last_y : float
        Bend of the cell before [rad], solved already.
    x, y : float
        Bend of this cell [rad].

    """
    half, scale = floats(work.half), offset_scale(1.0, chain, 0)
    half[2 * i], half[2 * i + 1] = half_turn(x * x + y * y)
    if follows_shape(chain):
        twist = twist_in(chain, state, i)
        shaped_travel(chain, i, x, y, half[2 * i], half[2 * i + 1], twist, scale, work)
    moment_arms, factor = moment_arms_of(chain, work)
    if i > 0:
        flags = active_stages(chain, YES)
        ahead = x - last_x, y - last_y
        before, rate = i - 1, slip_rate_in(work)
        passed = share_there(chain, work, before, last_x, last_y, *ahead, flags)
        pass_eyelet(
            chain, work, past, before, last_x, last_y, passed, rate, moment_arms, scale, flags
        )
    if torsion_acts(chain):
        solve_twist(chain, work, state, i, x, y)
    mx, my, total = tendon_moment(chain, work, i, moment_arms, factor)
    bx, by = bend_cell(chain, past, i, mx, my, total)
    return x - bx, y - by


@compiled
def solve_cell_alone(chain, work, past, state, i, last_x, last_y, x, y):
    """
    Newton on the two equations of cell i from (x, y); return its bend.

    Parameters
    ----------
    last_x, last_y : float
        Bend of the cell before [rad].
    x, y : float
        Where the search begins [rad].

    """
    fx, fy = cell_residual(chain, work, past, state, i, last_x, last_y, x, y)
    for _ in range(STEPS_MAX):
        if abs(fx) + abs(fy) < RESIDUAL_SOLVED:
            break
        ax, ay = cell_residual(chain, work, past, state, i, last_x, last_y, x + RESIDUAL_STEP, y)
        bx, by = cell_residual(chain, work, past, state, i, last_x, last_y, x, y + RESIDUAL_STEP)
        a, c = (ax - fx) / RESIDUAL_STEP, (ay - fy) / RESIDUAL_STEP
        b, d = (bx - fx) / RESIDUAL_STEP, (by - fy) / RESIDUAL_STEP
        over = 1.0 / (a * d - b * c)
        dx, dy = over * (d * fx - b * fy), over * (a * fy - c * fx)
        share, best = 1.0, abs(fx) + abs(fy)
        for _ in range(12):
            gx, gy = cell_residual(
                chain, work, past, state, i, last_x, last_y, x - share * dx, y - share * dy
            )
            if abs(gx) + abs(gy) < best:
                break
            share *= 0.5
        if not abs(gx) + abs(gy) < best:
            break
        x, y, fx, fy = x - share * dx, y - share * dy, gx, gy
    cell_residual(chain, work, past, state, i, last_x, last_y, x, y)  # leaves its tensions behind
    return x, y


@entry(MARCH)
def march(chain, inputs, bend, work, past):
    """Solve for the state in `bend` from the base to the tip; return the residual [rad]."""
    moment_arms, _ = moment_arms_of(chain, work)
    f, last_x, last_y, x = np.empty(unknowns(chain)), 0.0, 0.0, floats(bend)
    base_tensions(chain, inputs, work, moment_arms)
    for i in range(chain.n):
        last_x, last_y = solve_cell_alone(
            chain, work, past, bend, i, last_x, last_y, x[2 * i], x[2 * i + 1]
        )
        x[2 * i], x[2 * i + 1] = last_x, last_y
    residual_at(chain.residual)(chain, inputs, bend, work, past, address(f))
    return largest(f)
