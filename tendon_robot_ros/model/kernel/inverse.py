"""Tensions for a tip target: bounded Levenberg-Marquardt on the model itself."""

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
from .shape import place, posture

# Target: x, y, z [m], direction x, y, z, weight of position [1], weight of direction [m/rad].
DIFFERENCE = 1e-5  # [N]
THERE = 1e-14  # [m²] half the squared error of a tip that is where it should be: 0.14 µm


@compiled
def miss(chain, inputs, work, past, now, bend, before, target, f):
    """Weighted tip error (6,) [m] at inputs (m,); infinite where there is no equilibrium."""
    change = posture(chain, address(inputs), work, past, now, bend, before)
    if not change < TOLERANCE:
        f[:] = math.inf
        return
    place(chain, bend, work)
    frames, origins = floats(work.frames), floats(work.origins)
    for r in range(3):
        f[r] = target[6] * (origins[3 * chain.n + r] - target[r])
        f[3 + r] = target[7] * (frames[9 * chain.n + 3 * r + 2] - target[3 + r])


@compiled
def cost_of(f, inputs, low, preference):
    """Half the squared error plus the small preference for low tension [m²]."""
    total = 0.0
    for r in range(6):
        total += f[r] * f[r]
    for j in range(inputs.shape[0]):
        pull = preference * (inputs[j] - low[j])
        total += pull * pull
    return 0.5 * total


@compiled
def free_inputs(inputs, gradient, low, high, free):
    """Find the inputs that may move: not at a limit that the gradient pushes against."""
    count = 0
    for j in range(inputs.shape[0]):
        pressed = (inputs[j] <= low[j] and gradient[j] > 0.0) or (
            inputs[j] >= high[j] and gradient[j] < 0.0
        )
        if not pressed:
            free[count] = j
            count += 1
    return count


@compiled
def lower(jacobian, f, inputs, low, high, preference, damping, trial, normal, step, free):
    """Damped Gauss-Newton step within the limits into `trial`; return the free inputs' count."""
    m = inputs.shape[0]
    gradient = np.empty(m)
    for j in range(m):
        gradient[j] = preference * preference * (inputs[j] - low[j])
        for r in range(6):
            gradient[j] += jacobian[r, j] * f[r]
    count = free_inputs(inputs, gradient, low, high, free)
    for p in range(count):
        for q in range(count):
            total = 0.0
            for r in range(6):
                total += jacobian[r, free[p]] * jacobian[r, free[q]]
            normal[p, q] = total
    for p in range(count):
        normal[p, p] += preference * preference + damping * (normal[p, p] + 1e-12)
        step[p] = -gradient[free[p]]
    solve_small(normal, step, count)
    for j in range(m):
        trial[j] = inputs[j]
    for p in range(count):
        j = free[p]
        trial[j] = min(max(inputs[j] + step[p], low[j]), high[j])
    return count


@compiled
def tip_jacobian(
    chain, inputs, high, work, past, now, bend, near, before, target, f, moved, jacobian
):
    """Fill the derivative (6, m) of the weighted tip error by the inputs [m/N], by differences."""
    for j in range(inputs.shape[0]):
        h = DIFFERENCE if inputs[j] + DIFFERENCE <= high[j] else -DIFFERENCE
        keep = inputs[j]
        inputs[j] = keep + h
        for i in range(2 * chain.n):
            floats(near)[i] = floats(bend)[i]
        miss(chain, inputs, work, past, now, near, before, target, moved)
        inputs[j] = keep
        for r in range(6):
            jacobian[r, j] = (moved[r] - f[r]) / h


@entry()
def aim(robot, inputs, bends, target, low, high, preference, most, enough, past, scratch):
    """
    Move inputs (m,) [N] within [low, high] so that the tip meets the target; return the cost.

    `bends` (2, n, 2) holds a guess and takes the equilibrium in its first half. With the tip
    `THERE`, the search ends with a step that gains less than `enough` of the cost.
    """
    chain = chain_at(robot)
    n, m = chain.n, chain.m
    work = work_in(chain, scratch)
    now = memory_in(chain, scratch + 8 * work_size(n, chain.k))
    before = now.bend + 8 * memory_size(n, chain.k, m)
    then = memory_in(chain, address(past))
    bend, near = address(bends), address(bends) + 16 * n
    f, moved, jacobian = np.empty(6), np.empty(6), np.zeros((6, m))
    trial, step, normal = np.empty(m), np.empty(m), np.empty((m, m))
    free = np.empty(m, np.int64)
    miss(chain, inputs, work, then, now, bend, before, target, f)
    cost = cost_of(f, inputs, low, preference)
    damping = 1e-9
    for _ in range(most):
        if not cost < math.inf:
            return cost
        tip_jacobian(
            chain, inputs, high, work, then, now, bend, near, before, target, f, moved, jacobian
        )
        gain = 0.0
        for _ in range(12):
            if (
                lower(
                    jacobian, f, inputs, low, high, preference, damping, trial, normal, step, free
                )
                == 0
            ):
                return cost
            for i in range(2 * n):
                floats(near)[i] = floats(bend)[i]
            miss(chain, trial, work, then, now, near, before, target, moved)
            new = cost_of(moved, trial, low, preference)
            if new < cost:
                gain = cost - new
                break
            damping = max(4.0 * damping, 1e-6)
        if gain == 0.0:
            return cost
        damping = max(0.05 * damping, 1e-13)
        inputs[:] = trial
        f[:] = moved
        for i in range(2 * n):
            floats(bend)[i] = floats(near)[i]
        cost -= gain
        there = cost_of(f, low, low, preference) < THERE
        if gain < 1e-6 * cost or cost < 1e-16 or (there and gain < enough * cost):
            return cost
    return cost
