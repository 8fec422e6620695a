"""
Tensions for wire lengths when the wires are springs: one answer where stiff wires have many.

Wires of exactly opposite lengths do not say how hard two of them pull against each other; wires
that stretch, however little, do: the loose one of them is slack.
"""

import math

import numpy as np

from .layout import chain_at, compiled, entry, workspace
from .linear import solve_rows
from .pulls import pull_residuals, pull_slopes
from .shape import accept, predict
from .twisting import unknowns

GAP_CLOSED = 1e-2  # largest gap, over the stretch of a wire by 1 N
STEP_MAX, STEP_MAX_N = 3.0, 0.01  # longest step, over the largest tension and this more [N]
SLOW_STEPS_MAX = 4  # steps that hardly help, then there is no answer this way


@compiled
def spring_step(slopes, f, inputs, target, stretch, move):
    """
    Newton step (m,) [N] of the taut wires; return the largest gap [m] among them.

    A wire is taut that pulls, or is longer than its spring at rest. The gap is negative where
    the slopes (m, m) [m/N] of the pulls determine no step.
    """
    m = inputs.shape[0]
    taut = np.empty(m, np.int64)
    count, top = 0, 0.0
    for j in range(m):
        move[j] = 0.0
        gap = f[j] + stretch * inputs[j]
        if not math.isnan(target[j]) and (inputs[j] > 0.0 or gap < 0.0):
            taut[count] = j
            count += 1
            top = max(top, abs(gap))
    if count == 0:
        return 0.0
    part, step, high = np.empty((count, count)), np.empty((count, 1)), 0.0
    for p in range(count):
        for q in range(count):
            part[p, q] = slopes[taut[p], taut[q]]
        part[p, p] += stretch
        step[p, 0] = f[taut[p]] + stretch * inputs[taut[p]]
        high = max(high, inputs[taut[p]])
    if not solve_rows(part, step, count):
        return -1.0
    longest = 0.0
    for p in range(count):
        move[taut[p]] = -step[p, 0]
        longest = max(longest, abs(step[p, 0]))
    share = min(1.0, STEP_MAX * (high + STEP_MAX_N) / max(longest, 1e-300))
    for p in range(count):
        move[taut[p]] *= share  # where pulls hardly change, no step is a leap
    return top


@compiled
def correct(slopes, change, step):
    """Let the slopes (m, m) [m/N] give the change (m,) [m] that a step (m,) [N] made (Broyden)."""
    m = step.shape[0]
    length = 1e-300
    for j in range(m):
        length += step[j] * step[j]
    for r in range(m):
        wrong = change[r]
        for j in range(m):
            wrong -= slopes[r, j] * step[j]
        for j in range(m):
            slopes[r, j] += wrong * step[j] / length


@compiled
def tried(inputs, move, share, trial):
    """Tensions `trial` (m,) [N] a share of the move away, none below zero."""
    for j in range(inputs.shape[0]):
        trial[j] = max(inputs[j] + share * move[j], 0.0)


@entry()
def solve_elastic_wires(robot, inputs, target, bends, past, scratch, stretch, most):
    """
    Find tensions (m,) [N] >= 0 of wires that stretch by `stretch` [m/N]; NaN: a slack wire.

    Arguments as in `pulls.solve_stiff_wires`. Returns the largest remaining gap [m], infinite
    where the model finds no equilibrium.

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
    stretch : float
        Compliance of a wire [m/N].
    most : int
        Steps.

    """
    chain = chain_at(robot)
    m, there = chain.m, workspace(chain, bends, past, scratch)
    ways = np.zeros((m, unknowns(chain)))
    f, moved, slopes = np.empty(m), np.empty(m), np.zeros((m, m))
    trial, move, ahead = np.empty(m), np.empty(m), np.empty(m)
    for j in range(m):
        inputs[j] = 0.0 if math.isnan(target[j]) else inputs[j]
    if not pull_residuals(chain, inputs, target, there, f, there.bend):
        return math.inf
    fresh, stale, top, slow = False, True, math.inf, 0
    for _ in range(most):
        if stale:
            pull_slopes(chain, inputs, target, there, ways, slopes)
            fresh, stale = True, False
            top = spring_step(slopes, f, inputs, target, stretch, move)
        if top < GAP_CLOSED * stretch or slow > SLOW_STEPS_MAX:
            break
        share, better = 1.0, False
        for _ in range(8 if fresh else 2):
            tried(inputs, move, share, trial)
            predict(chain, there, ways, inputs, trial)
            good = pull_residuals(chain, trial, target, there, moved, there.near)
            new = spring_step(slopes, moved, trial, target, stretch, ahead)
            better = good and 0.0 <= new < (1.0 - 1e-3 * share) * top
            if better:
                break
            share *= 0.5
        if not better and fresh:
            break
        stale = not better or new > 0.3 * top
        slow += 1 if not better or new > 0.7 * top else 0
        if better:
            correct(slopes, moved - f, trial - inputs)
            accept(chain, there, trial, moved, inputs, f)
            top = spring_step(slopes, f, inputs, target, stretch, move)
        fresh = False
    return top if top >= 0.0 else math.inf
