"""Above the buckling load: from an equilibrium on the ridge down to one that holds."""

import math

import numpy as np

from .bending import cell_stiffness
from .layout import (
    BEND_TOLERANCE,
    LENGTH,
    address,
    cell,
    compiled,
    newton_at,
    respond_at,
    section_of,
    step_at,
)
from .linear import assign, dot, largest
from .loads import force_at_tip, weight
from .newton import residual

SAFE_LOAD_SHARE = 0.7  # [1] share of Euler's load below which no shape of the arm is unstable


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
def descend(chain, inputs, x, work, past, ratio):
    """
    Leave an unstable equilibrium x; tell whether it has moved to one that is better.

    The straight arm, pushed a little to the side that the loads prefer, sinks until it rests: the
    gradient of the energy is the stiffness times the residual.
    """
    size = x.shape[0]
    f, moved, down, there = np.empty(size), np.empty(size), np.empty(size), np.zeros(size)
    step_at(chain.step)(chain, inputs, address(there), work, past, address(moved))
    assign(down, moved)
    residual(chain, inputs, address(x), work, past, f)
    if respond_at(chain.respond)(chain, address(x), 0, 0, work, past, address(down), 0) < 0:
        return False
    push = math.copysign(1e-3 / largest(down), dot(down, moved))
    for j in range(size):
        there[j] = push * down[j]
    for _ in range(5000):
        change = residual(chain, inputs, address(there), work, past, f)
        if change < 1e-6 or change == math.inf:
            break
        for j in range(size):
            there[j] -= f[j] / (1.0 + ratio)
    if newton_at(chain.newton)(chain, inputs, address(there), work, past, 20) < BEND_TOLERANCE:
        assign(x, there)
        return True
    return False
