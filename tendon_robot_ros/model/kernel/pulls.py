"""Tensions for wire pulls: each commanded wire is either taut at its pull, or slack."""

import math
from collections import namedtuple

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
from .shape import copy, mean_pulls, posture, wire_pulls

SETTLED = 1e-10  # [m] largest difference between a wire's pull and what was asked
DIFFERENCE = 1e-5  # [N]


# Room: addresses; bends here and at a trial, memory after and before, and scratch.
Room = namedtuple('Room', 'work past now bend near before pulls')
Room.__name__ += '_' + __name__.partition('.')[0].rpartition('_')[2]


@compiled
def room(chain, bends, past, scratch):
    """Lay out what a search for tensions needs; `bends` (2, n, 2) are kept alive outside."""
    n, k = chain.n, chain.k
    now = memory_in(chain, scratch + 8 * work_size(n, k))
    before = now.bend + 8 * memory_size(n, k, chain.m)
    bend = address(bends)
    return Room(
        work_in(chain, scratch),
        memory_in(chain, address(past)),
        now,
        bend,
        bend + 16 * n,
        before,
        before + 16 * n,
    )


@compiled
def gaps(chain, inputs, target, there, f, here):
    """
    Wire pull minus what was asked (m,) [m], zero where nothing was; False: no equilibrium.

    The bends are those kept (`here`), or a trial that starts from them.
    """
    n = chain.n
    bend = there.bend if here else there.near
    if not here:
        copy(there.bend, bend, 2 * n)
    change = posture(chain, address(inputs), there.work, there.past, there.now, bend, there.before)
    if not change < TOLERANCE:
        return False
    wire_pulls(chain, bend, there.work, there.pulls)
    means = there.pulls + 8 * chain.k
    mean_pulls(chain, there.pulls, means)
    for j in range(inputs.shape[0]):
        f[j] = 0.0 if math.isnan(target[j]) else floats(means)[j] - target[j]
    return True


@compiled
def pull_slopes(chain, inputs, target, there, f, moved, slopes):
    """Fill the derivative (m, m) [m/N] of the gaps by the tensions, by differences."""
    for j in range(inputs.shape[0]):
        keep = inputs[j]
        inputs[j] = keep + DIFFERENCE
        good = gaps(chain, inputs, target, there, moved, False)
        inputs[j] = keep
        for r in range(inputs.shape[0]):
            slopes[r, j] = (moved[r] - f[r]) / DIFFERENCE if good else 0.0


@compiled
def accept(chain, there, trial, moved, inputs, f):
    """Go to where a trial was."""
    inputs[:] = trial
    f[:] = moved
    copy(there.near, there.bend, 2 * chain.n)


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
def pulled(robot, inputs, target, bends, past, scratch, most):
    """
    Find tensions (m,) [N] >= 0 whose wire pulls are `target` (m,) [m]; NaN: a slack wire.

    `inputs` holds the guess. Returns the largest remaining gap [m], infinite where the model
    finds no equilibrium.
    """
    chain = chain_at(robot)
    m, there = chain.m, room(chain, bends, past, scratch)
    f, moved, slopes, trial = np.empty(m), np.empty(m), np.zeros((m, m)), np.empty(m)
    for j in range(m):
        inputs[j] = 0.0 if math.isnan(target[j]) else inputs[j]
    if not gaps(chain, inputs, target, there, f, True):
        return math.inf
    damping = 1e-10
    for _ in range(most):
        wrong = violation(inputs, target, f)
        if wrong < SETTLED * SETTLED:
            break
        pull_slopes(chain, inputs, target, there, f, moved, slopes)
        new = math.inf
        for _ in range(14):
            taut_step(slopes, f, inputs, target, damping, trial)
            if gaps(chain, trial, target, there, moved, False):
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
