"""Tensions for wire pulls: each commanded wire is either taut at its pull, or slack."""

import math

import numpy as np

from .derivatives import output_slopes
from .layout import address, chain_at, compiled, entry, floats, workspace
from .linear import solve_small
from .shape import accept, balance, mean_pulls, predict, wire_pulls
from .twisting import unknowns

GAP_SETTLED = 1e-10  # [m] largest difference between a wire's pull and what was asked


@compiled
def pull_residuals(chain, inputs, target, there, f, bend):
    """Wire pull minus what was asked (m,) [m], zero where nothing was; False: no equilibrium."""
    if not balance(chain, inputs, there, bend):
        return False
    wire_pulls(chain, bend, there.work, there.pulls)
    mean_pulls(chain, there.pulls, there.means)
    for j in range(inputs.shape[0]):
        f[j] = 0.0 if math.isnan(target[j]) else floats(there.means)[j] - target[j]
    return True


@compiled
def pull_slopes(chain, inputs, target, there, ways, slopes):
    """Fill the derivative (m, m) [m/N] of the residuals by the tensions."""
    m = inputs.shape[0]
    both = np.empty((6 + m, m))
    output_slopes(chain, address(inputs), there, ways, both)
    for r in range(m):
        for j in range(m):
            slopes[r, j] = 0.0 if math.isnan(target[r]) else both[6 + r, j]


@compiled
def violation(inputs, target, f):
    """Sum of squares of what is wrong: taut wires off their pull, slack ones short of it [m²]."""
    total = 0.0
    for j in range(inputs.shape[0]):
        if not math.isnan(target[j]) and (inputs[j] > 0.0 or f[j] < 0.0):
            total += f[j] * f[j]
    return total


@compiled
def taut_step(jacobian, f, inputs, target, damping, trial):
    """Damped Newton step of the taut wires, tensions kept from below zero, into `trial`."""
    m = inputs.shape[0]
    free = np.empty(m, np.int64)
    count = 0
    for j in range(m):
        trial[j] = inputs[j]
        if not math.isnan(target[j]) and (inputs[j] > 0.0 or f[j] < 0.0):
            free[count] = j
            count += 1
    normal, step = np.empty((count, count)), np.empty(count)
    for p in range(count):
        step[p] = 0.0
        for r in range(count):
            step[p] -= jacobian[free[r], free[p]] * f[free[r]]
        for q in range(count):
            normal[p, q] = 0.0
            for r in range(count):
                normal[p, q] += jacobian[free[r], free[p]] * jacobian[free[r], free[q]]
    for p in range(count):
        normal[p, p] += damping * (normal[p, p] + 1e-14)
    solve_small(normal, step, count)
    for p in range(count):
        trial[free[p]] = max(inputs[free[p]] + step[p], 0.0)


@entry()
def solve_stiff_wires(robot, inputs, target, bends, past, scratch, most):
    """
    Find tensions (m,) [N] >= 0 whose wire pulls are `target` (m,) [m]; NaN: a slack wire.

    `inputs` holds the guess. Returns the largest remaining gap [m], infinite where the model
    finds no equilibrium.

    Parameters
    ----------
    robot : int
        Address of a Chain.
    inputs : ndarray, shape (m,)
        [N], start and result.
    target : ndarray, shape (m,)
        Wire pulls [m]; NaN: a slack wire.
    bends : ndarray, shape (2, 3n)
        [rad], guess and result in its first half.
    past : ndarray
        Memory of the posture before.
    scratch : int
        Address of `KernelArrays.scratch`.
    most : int
        Steps.

    """
    chain = chain_at(robot)
    m, there = chain.m, workspace(chain, bends, past, scratch)
    ways = np.zeros((m, unknowns(chain)))
    f, moved, slopes, trial = np.empty(m), np.empty(m), np.zeros((m, m)), np.empty(m)
    for j in range(m):
        inputs[j] = 0.0 if math.isnan(target[j]) else inputs[j]
    if not pull_residuals(chain, inputs, target, there, f, there.bend):
        return math.inf
    damping = 1e-10
    for _ in range(most):
        wrong = violation(inputs, target, f)
        if wrong < GAP_SETTLED * GAP_SETTLED:
            break
        pull_slopes(chain, inputs, target, there, ways, slopes)
        new = math.inf
        for _ in range(14):
            taut_step(slopes, f, inputs, target, damping, trial)
            predict(chain, there, ways, inputs, trial)
            if pull_residuals(chain, trial, target, there, moved, there.near):
                new = violation(trial, target, moved)
            if new < wrong:
                break
            damping = max(10.0 * damping, 1e-6)
        if not new < wrong:
            break
        damping = max(0.1 * damping, 1e-12)
        accept(chain, there, trial, moved, inputs, f)
    gap = 0.0
    for j in range(m):
        if not math.isnan(target[j]) and (inputs[j] > 0.0 or f[j] < 0.0):
            gap = max(gap, abs(f[j]))
    return gap
