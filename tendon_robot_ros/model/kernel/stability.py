"""Above the buckling load: from an equilibrium on the ridge down to one that holds."""

import math

import numpy as np

from .bending import cell_stiffness
from .layout import LENGTH, address, cell, compiled, section_of, step_at
from .loads import force_at_tip, weight
from .newton import TOLERANCE, dot, largest, newton, residual, slopes

SAFE = 0.7  # [1] share of Euler's load below which no shape of the arm is unstable


@compiled
def load_ratio(chain):
    """
    Return all loads together over Euler's load of the arm, one end free [1].

    The second variation of a load's potential is at most |F| times the integral of the tangent's
    change squared, whatever the shape: below 1 every equilibrium is stable.
    """
    x, y, z = force_at_tip(chain)
    force = math.sqrt(x * x + y * y + z * z)
    rigidity, total = math.inf, 0.0
    for i in range(chain.n):
        x, y, z = weight(chain, i)
        force += math.sqrt(x * x + y * y + z * z)
        reach = cell(chain, i, LENGTH)
        rigidity = min(rigidity, reach * cell_stiffness(chain, i, section_of(chain, i)))
        total += reach
    return force * total * total * 4.0 / (math.pi * math.pi * rigidity)


@compiled
def falls(a, down):
    """
    Tell whether a symmetric matrix (q, q), lost on the way, has a direction of descent.

    `down` (q,) then is one: where Cholesky's pivot j is negative, that of the first j unknowns.
    """
    down[:] = 0.0
    for j in range(a.shape[0]):
        for i in range(j):
            for r in range(i):
                a[j, i] -= a[j, r] * a[i, r]
            a[j, i] /= a[i, i]
            a[j, j] -= a[j, i] * a[j, i]
        if a[j, j] > 0.0:
            a[j, j] = math.sqrt(a[j, j])
            continue
        down[j] = 1.0
        for i in range(j - 1, -1, -1):
            down[i] = -a[j, i]
            for r in range(i + 1, j):
                down[i] -= a[r, i] * down[r]
            down[i] /= a[i, i]
        return True
    return False


@compiled
def is_unstable(chain, inputs, x, f, work, past, moved, down):
    """Tell whether the energy falls from the equilibrium x (2n,), and into which direction."""
    jacobian = slopes(chain, inputs, x, f, work, past, 1, moved)
    size = x.shape[0]
    tangent = np.empty((size, size))
    for r in range(size):
        stiff = cell_stiffness(chain, r // 2, section_of(chain, r // 2))
        for c in range(size):
            tangent[r, c] = stiff * jacobian[r, c]
    for r in range(size):
        for c in range(r):
            tangent[r, c] = 0.5 * (tangent[r, c] + tangent[c, r])
    return falls(tangent, down)


@compiled
def descend(chain, inputs, x, work, past, ratio):
    """
    Leave an unstable equilibrium x (2n,); tell whether it has moved to one that is better.

    The straight arm, pushed a little to the side that the loads prefer, sinks until it rests: the
    gradient of the energy is the stiffness times the residual.
    """
    size = x.shape[0]
    f, moved, down, there = np.empty(size), np.empty(size), np.empty(size), np.zeros(size)
    residual(chain, inputs, x, work, past, f)
    if not is_unstable(chain, inputs, x, f, work, past, moved, down):
        return False
    step_at(chain.step)(chain, inputs, address(there), work, past, address(moved))
    push = math.copysign(1e-3 / largest(down), dot(down, moved))
    for j in range(size):
        there[j] = push * down[j]
    for _ in range(5000):
        change = residual(chain, inputs, there, work, past, f)
        if change < 1e-6 or change == math.inf:
            break
        for j in range(size):
            there[j] -= f[j] / (1.0 + ratio)
    if newton(chain, inputs, there, work, past, 20) < TOLERANCE:
        x[:] = there
        return True
    return False
