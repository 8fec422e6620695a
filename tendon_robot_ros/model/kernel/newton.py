"""
Newton on bends and twists, for shapes that repeated sweeps do not settle.

Above the buckling load: from an equilibrium on the ridge down to one that holds.
"""

import math

import numpy as np

from .bending import cell_stiffness
from .layout import (
    BEND_TOLERANCE,
    DESCEND,
    LENGTH,
    NEWTON,
    address,
    cell,
    compiled,
    copy,
    entry,
    floats,
    keep,
    newton_at,
    residual_at,
    respond_at,
    section_of,
    step_at,
)
from .linear import assign, dot, largest
from .loads import force_at_tip, weight
from .turning import unknowns

SAFE_LOAD_SHARE = 0.7  # [1] share of Euler's load below which no shape of the arm is unstable


@compiled
def residual(chain, inputs, bend, work, past, f):
    """Fill f [rad], `residual.residual` at the state; return its largest entry."""
    residual_at(chain.residual)(chain, inputs, bend, work, past, address(f))
    return largest(f)


@compiled
def newton_step(chain, inputs, bend, f, move, work, past, trial, trial_f, halvings):
    """
    Step the state by `move` (u,) with a line search; return the largest residual, or -1.

    Parameters
    ----------
    inputs : address
        (m,) [N]
    bend : address
        State [rad]; moves on where the step is taken.
    f : ndarray, shape (u,)
        Residual there [rad]; becomes that after the step.
    move : ndarray, shape (u,)
        Newton's step [rad].
    trial, trial_f : ndarray, shape (u,)
        Scratch.
    halvings : int
        How often the step is halved before it is given up.

    """
    before, x = dot(f, f), floats(bend)
    share = min(1.0, 1.0 / max(largest(move), 1e-300))
    for _ in range(halvings):
        for j in range(f.shape[0]):
            trial[j] = x[j] + share * move[j]
        change = residual(chain, inputs, address(trial), work, past, trial_f)
        if dot(trial_f, trial_f) < (1.0 - 1e-4 * share) * before or change < BEND_TOLERANCE:
            for j in range(f.shape[0]):
                x[j], f[j] = trial[j], trial_f[j]
            return change
        share *= 0.5
    return -1.0


@entry(NEWTON)
def newton(chain, inputs, bend, work, past, most):
    """
    Newton on the state with a line search; return the last residual [rad].

    Parameters
    ----------
    inputs, bend : address
        (m,) [N]; state [rad], guess and result.
    most : int
        Steps.

    """
    size = unknowns(chain)
    f, trial_f = np.empty(size), np.empty(size)
    trial, move = np.empty(size), np.empty(size)
    change = residual(chain, inputs, bend, work, past, f)
    for _ in range(most):
        if change < BEND_TOLERANCE or change == math.inf:
            return change
        respond_at(chain.respond)(chain, bend, address(f), 1, work, past, address(move), 0)
        if not largest(move) < math.inf:
            return change
        new = newton_step(chain, inputs, bend, f, move, work, past, trial, trial_f, 12)
        if new < 0.0:
            return change
        change = new
    return change


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


@entry(DESCEND)
def descend(chain, inputs, bend, work, past, ratio):
    """
    Leave an unstable equilibrium, the state in `bend`, for one that is better.

    The straight arm, pushed a little to the side that the loads prefer, sinks until it rests: the
    gradient of the energy is the stiffness times the residual.
    """
    size = unknowns(chain)
    f, moved, down, there = np.empty(size), np.empty(size), np.empty(size), np.zeros(size)
    step_at(chain.step)(chain, inputs, address(there), work, past, address(moved))
    assign(down, moved)
    residual(chain, inputs, bend, work, past, f)
    if respond_at(chain.respond)(chain, bend, 0, 0, work, past, address(down), 0) < 0:
        return
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
        copy(address(there), bend, size)
    keep(there)
