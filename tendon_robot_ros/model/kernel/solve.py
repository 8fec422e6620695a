"""Equilibrium: one sweep, else accelerated repetition, else Newton, else continuation."""

import math

import numpy as np

from .layout import SETTLE, SLIP_LENGTH, address, compiled, entry, floats, step_at
from .loads import loaded
from .newton import TOLERANCE, dot, largest, newton, solve_small
from .stability import SAFE, descend, load_ratio
from .stages import memory_acts
from .sweep import is_implicit
from .turning import half_turns

WIDTHS = (1000.0, 100.0, 30.0, 10.0, 3.0, 1.0)  # of the smoothing of friction's sign, on the way
DEPTH = 5  # guesses that the acceleration remembers


@compiled
def mix(x, f, steps, changes, used, gram, factor, weights):
    """Anderson's next guess: x + f - (steps + changes) weights, weights from least squares."""
    for p in range(used):
        for q in range(p + 1):
            factor[p, q] = gram[p, q]
        factor[p, p] = gram[p, p] * (1.0 + 1e-14) + 1e-300
        weights[p] = dot(changes[p], f)
    solve_small(factor, weights, used)
    for j in range(x.shape[0]):
        move = f[j]
        for p in range(used):
            move -= weights[p] * (steps[p, j] + changes[p, j])
        x[j] += move


@compiled
def repeat_sweeps(chain, inputs, x, work, past, most):
    """Repeat sweeps from x (2n,), accelerated (Anderson 1965); return the last change [rad]."""
    size = x.shape[0]
    flat = np.empty(size)
    f, old_x, old_f = np.empty(size), np.empty(size), np.empty(size)
    steps, changes = np.empty((DEPTH, size)), np.empty((DEPTH, size))
    gram, factor = np.empty((DEPTH, DEPTH)), np.empty((DEPTH, DEPTH))
    weights = np.empty(DEPTH)
    best, first = math.inf, math.inf
    for turn in range(most):
        step_at(chain.step)(chain, inputs, address(x), work, past, address(flat))
        for j in range(size):
            f[j] = flat[j] - x[j]
        change = largest(f)
        if change < TOLERANCE:
            x[:] = flat
            return change
        if change > 1e4 * best or change == math.inf or (turn == 9 and change > 1e-2 * first):
            return change  # too slow: Newton is quicker from where it began
        best = min(best, change)
        if turn == 0:
            first = change
        if turn > 0:
            slot = (turn - 1) % DEPTH
            for j in range(size):
                steps[slot, j] = x[j] - old_x[j]
                changes[slot, j] = f[j] - old_f[j]
            for p in range(min(turn, DEPTH)):
                gram[slot, p] = gram[p, slot] = dot(changes[slot], changes[p])
        old_x[:] = x
        old_f[:] = f
        mix(x, f, steps, changes, min(turn, DEPTH), gram, factor, weights)
    return change


@compiled
def sharpen(chain, inputs, x, work, past):
    """Newton while the sign of friction sharpens from wide to its own width."""
    slip = floats(work.slip)
    before = np.empty(x.shape[0])
    change = math.inf
    x[:] = 0.0
    for width in WIDTHS:
        slip[0] = width * SLIP_LENGTH
        before[:] = x
        change = repeat_sweeps(chain, inputs, x, work, past, 25)
        if not change < TOLERANCE:
            x[:] = before
            change = newton(chain, inputs, x, work, past, 15)
        if not change < TOLERANCE:
            break
    slip[0] = SLIP_LENGTH
    return change if change < TOLERANCE else max(change, 10.0 * TOLERANCE)


@compiled
def continuation(chain, inputs, x, work, past):
    """Newton along a path: loads and the sharpness of friction grow together from none."""
    slip = floats(work.slip)
    x[:] = 0.0
    done, stride = 0.0, 0.25
    last = x.copy()
    change = math.inf
    for _ in range(60):
        aim = min(1.0, done + stride)
        slip[0] = SLIP_LENGTH * 10.0 ** (3.0 * (1.0 - aim))
        slip[1] = aim
        x[:] = last
        change = newton(chain, inputs, x, work, past, 30)
        if change < TOLERANCE:
            if aim == 1.0:
                slip[0], slip[1] = SLIP_LENGTH, 1.0
                return change
            done = aim
            last[:] = x
            stride = min(0.5, 1.6 * stride)
        else:
            stride *= 0.4
            if stride < 1e-3:
                break
    slip[0], slip[1] = SLIP_LENGTH, 1.0
    return max(change, 10.0 * TOLERANCE)


@compiled
def is_zero(x):
    """Tell whether every entry is zero."""
    for value in x:
        if value != 0.0:
            return False
    return True


@entry(SETTLE)
def settle(chain, inputs, work, past, bend):
    """
    Find the equilibrium for input tensions (m,) [N] from the bends (n, 2) [rad] in `bend`.

    Returns the last change [rad]: above `TOLERANCE` there is no equilibrium and the bends mean
    nothing. work.tensions are those of the equilibrium.
    """
    size = 2 * chain.n
    bends = floats(bend)
    if not is_implicit(chain):
        step_at(chain.step)(chain, inputs, bend, work, past, bend)
        for j in range(size):
            if not abs(bends[j]) < 1e6:
                return math.inf
        return 0.0
    x = np.empty(size)
    for j in range(size):
        x[j] = bends[j]
    if is_zero(x) and not memory_acts(chain):  # nothing known: begin without the effects of shape
        floats(work.slip)[2] = 0.0
        step_at(chain.step)(chain, inputs, address(x), work, past, address(x))
        floats(work.slip)[2] = 1.0
    change = repeat_sweeps(chain, inputs, x, work, past, 25)
    swept = change < TOLERANCE
    if not swept:
        for j in range(size):
            x[j] = bends[j]
        change = newton(chain, inputs, x, work, past, 12)
        if change >= TOLERANCE:
            change = sharpen(chain, inputs, x, work, past)
        if change >= TOLERANCE:
            change = continuation(chain, inputs, x, work, past)
    if change < TOLERANCE and loaded(chain):
        ratio = load_ratio(chain)
        if ratio > SAFE:
            descend(chain, inputs, x, work, past, ratio)
            swept = False
    if not swept:
        step_at(chain.step)(chain, inputs, address(x), work, past, bend)
        half_turns(chain, address(x), work)
    for j in range(size):
        bends[j] = x[j]
    return change
