"""
Tensions and bends for a tip target at once: Newton on the equilibrium and the target together.

Where tendons stick and slip, tensions to tip is full of kinks, and a search that asks for an
equilibrium at every trial stumbles over them. Here the tensions are further unknowns of the
primal-dual method of `stick`: the same elimination says how the bends follow the residual and
every tension, the tip's error is then linear in the tensions, and least squares with bounds says
how these move. The slip length shrinks on the way: the kinks come where the target is met.
"""

import math

import numpy as np

from .begin import workspace
from .derivatives import combine_tendons, place_as
from .inverse import gauss_newton_step, tip_error
from .layout import (
    SLIP_LENGTH,
    address,
    balance_at,
    chain_at,
    compiled,
    entry,
    floats,
    monotonic,
    place_travel_at,
    respond_at,
)
from .linear import largest
from .stick import exchange, own_travel, take_over
from .turning import unknowns

BEND_STEP = 1e-6  # [rad] of differences
STEP_SHRINKING_RAD = 0.3  # [rad] step after which the slip length shrinks
STEP_MAX_RAD = 0.2  # [rad] step of a bend
STEP_SETTLED_RAD = 1e-6  # [rad] step with which the search ends
LOW_TENSION_SHARE = 0.01  # [1] of its weight at the target, where all would keep the tip off it
UNDAMPED_STEPS, DAMPING = 15, 1e-2  # turns without damping; later tensions may go in circles


@compiled
def find_ways(chain, inputs, bend, work, past, residual, ways, pulls):
    """
    Fill the ways (m + 1, u) of the bends by every tension, and last the one that balances them.

    Parameters
    ----------
    inputs, bend : address
        (m,) [N]; state [rad], whose travel and moment arms `work` holds.
    residual, pulls : ndarray, shapes (u,) and (k, u)
        Scratch.
    ways : ndarray, shape (m + 1, u)
        Takes [rad/N], and [rad].

    """
    balance_at(chain.balance)(chain, inputs, bend, work, past, address(residual))
    balancing = address(ways) + 8 * unknowns(chain) * chain.m
    respond_at(chain.respond)(
        chain, bend, address(residual), 1, work, past, balancing, address(pulls)
    )
    combine_tendons(chain, inputs, pulls, ways)


@compiled
def tip_slopes(chain, inputs, there, target, ways, f, slopes):
    """
    Fill the tip error (6,) [m] and how it moves (6, m + 1) along the ways (m + 1, u).

    The first m are those of the bends by a tension, which itself moves with them.
    """
    tension, bend, near = floats(inputs), floats(there.bend), floats(there.near)
    up, down = np.empty(6), np.empty(6)
    for j in range(chain.m + 1):
        step = BEND_STEP / max(largest(ways[j]), 1e-9)
        for side in range(2):
            h = step if side == 0 else -step
            for q in range(unknowns(chain)):
                near[q] = bend[q] + h * ways[j, q]
            was = tension[j % chain.m]
            if j < chain.m:
                tension[j] += h
            place_as(chain, inputs, there.near, there.work, there.past)
            tension[j % chain.m] = was
            tip_error(chain, there.work, target, up if side == 0 else down)
        for r in range(6):
            slopes[r, j] = (up[r] - down[r]) / (2.0 * step)
            f[r] = 0.5 * (up[r] + down[r])


@compiled
def move_both(chain, inputs, there, ways, trial, move):
    """Move inputs (m,) to a trial and the bends with them by `move` (u,); return its length."""
    m, bend = chain.m, floats(there.bend)
    for q in range(unknowns(chain)):
        move[q] = ways[m, q]
        for j in range(m):
            move[q] += ways[j, q] * (trial[j] - inputs[j])
    longest = largest(move)
    if not longest < math.inf:
        return longest
    share = min(1.0, STEP_MAX_RAD / max(longest, 1e-300))
    for q in range(unknowns(chain)):
        move[q] *= share
        bend[q] += move[q]
    for j in range(m):
        inputs[j] += share * (trial[j] - inputs[j])
    return longest


@entry()
def seek(
    robot, inputs, bends, target, low, high, preference, wide, shrink, most, until, past, scratch
):
    """
    Move inputs (m,) [N] within [low, high] and bends[0] (3n,) [rad] towards a tip target.

    The slip length starts `wide` times its own and shrinks by a factor at every good step. Returns
    the last step [rad]: where it is small, an equilibrium is near. It ends at
    the time [s] at the address `until`, see `layout.monotonic`.
    """
    chain = chain_at(robot)
    m, size, there = chain.m, unknowns(chain), workspace(chain, bends, past, scratch)
    work, then, slip, tensions = there.work, there.past, floats(there.work.slip), address(inputs)
    ways, pulls, residual = np.empty((m + 1, size)), np.empty((chain.k, size)), np.empty(size)
    f, slopes, move = np.empty(6), np.empty((6, m + 1)), np.empty(size)
    trial, free = np.empty(m), np.empty(m, np.int64)
    own, width, longest = own_travel(chain, there.bend, work), wide * SLIP_LENGTH, math.inf
    for turn in range(most):
        if monotonic() > floats(until)[0]:
            break
        slip[0] = width
        exchange(chain, work, own)
        find_ways(chain, tensions, there.bend, work, then, residual, ways, pulls)
        tip_slopes(chain, tensions, there, target, ways, f, slopes)
        for r in range(6):
            f[r] += slopes[r, m]  # where the bends go that balance the tensions as they are
        damping = 0.0 if turn < UNDAMPED_STEPS else DAMPING
        weight = preference if width > SLIP_LENGTH else LOW_TENSION_SHARE * preference
        gauss_newton_step(slopes, f, inputs, low, high, (weight, 0.0, 1.0), damping, trial, free)
        longest = move_both(chain, inputs, there, ways, trial, move)
        if not longest < math.inf or (longest < STEP_SETTLED_RAD and width == SLIP_LENGTH):
            break
        new_width = max(shrink * width, SLIP_LENGTH) if longest < STEP_SHRINKING_RAD else width
        take_over(chain, work, move, own, width, new_width)
        width = new_width
        place_travel_at(chain.place_travel)(chain, there.bend, work)
    slip[0] = SLIP_LENGTH
    for j in range(2 * chain.n * chain.k):
        floats(work.lag)[j] = 0.0
    return longest
