"""Tensions for wire pulls: each commanded wire is either taut at its pull, or slack."""

import math

import numpy as np

from .layout import (
    address,
    chain_at,
    compiled,
    entry,
    floats,
    memory_in,
    memory_size,
    work_in,
    work_size,
)
from .newton import TOLERANCE, solve_small
from .shape import posture, wire_pulls

SETTLED = 1e-10  # [m] largest difference between a wire's pull and what was asked
DIFFERENCE = 1e-5  # [N]


@compiled
def gaps(chain, inputs, shares, target, work, past, now, bend, before, pulls, f):
    """Wire pull minus what was asked (m,) [m], zero where nothing was; False: no equilibrium."""
    change = posture(chain, address(inputs), work, past, now, bend, before)
    if not change < TOLERANCE:
        return False
    wire_pulls(chain, bend, work, address(pulls))
    for j in range(inputs.shape[0]):
        f[j] = -target[j]
        for k in range(pulls.shape[0]):
            f[j] += shares[j, k] * pulls[k]
        if math.isnan(target[j]):
            f[j] = 0.0
    return True


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
def pulled(robot, inputs, shares, target, bends, past, scratch, most):
    """
    Find tensions (m,) [N] >= 0 whose wire pulls are `target` (m,) [m]; NaN: a slack wire.

    `inputs` holds the guess; shares (m, k) average the tendons of an input. Returns the largest
    remaining gap [m], infinite where the model finds no equilibrium.
    """
    chain = chain_at(robot)
    n, m = chain.n, chain.m
    work = work_in(chain, scratch)
    now = memory_in(chain, scratch + 8 * work_size(n, chain.k))
    before = now.bend + 8 * memory_size(n, chain.k, m)
    then = memory_in(chain, address(past))
    bend, near = address(bends), address(bends) + 16 * n
    f, moved, pulls = np.empty(m), np.empty(m), np.empty(chain.k)
    jacobian, trial = np.zeros((m, m)), np.empty(m)
    for j in range(m):
        if math.isnan(target[j]):
            inputs[j] = 0.0
    if not gaps(chain, inputs, shares, target, work, then, now, bend, before, pulls, f):
        return math.inf
    damping = 1e-10
    for _ in range(most):
        wrong = violation(inputs, target, f)
        if wrong < SETTLED * SETTLED:
            break
        for j in range(m):
            keep = inputs[j]
            inputs[j] = keep + DIFFERENCE
            for i in range(2 * n):
                floats(near)[i] = floats(bend)[i]
            good = gaps(chain, inputs, shares, target, work, then, now, near, before, pulls, moved)
            inputs[j] = keep
            for r in range(m):
                jacobian[r, j] = (moved[r] - f[r]) / DIFFERENCE if good else 0.0
        better = False
        for _ in range(14):
            taut_step(jacobian, f, inputs, target, damping, trial)
            for i in range(2 * n):
                floats(near)[i] = floats(bend)[i]
            good = gaps(chain, trial, shares, target, work, then, now, near, before, pulls, moved)
            if good and violation(trial, target, moved) < wrong:
                better = True
                break
            damping = max(10.0 * damping, 1e-6)
        if not better:
            break
        damping = max(0.1 * damping, 1e-12)
        inputs[:] = trial
        f[:] = moved
        for i in range(2 * n):
            floats(bend)[i] = floats(near)[i]
    gap = 0.0
    for j in range(m):
        if not math.isnan(target[j]) and (inputs[j] > 0.0 or f[j] < 0.0):
            gap = max(gap, abs(f[j]))
    return gap
