"""
Stick and slip: Newton on the bends and, apart from them, on every eyelet's direction of friction.

The direction of friction is tanh(travel / slip length): between slipping one way and the other
lie 2 µm, and Newton on the bends alone jumps over them and back. In a spatial arm half of the
eyelets stick: tendons pull against each other, and friction there is what the balance asks for.

So every eyelet has a travel of its own, from which its friction follows, and which may lag behind
that of the bends; a step solves the linear equations of both. An eyelet that sticks takes over the
friction that the step says, not the travel; one that would need more than all friction begins to
slip; one that would slip against its friction sticks. That is a primal-dual method, with the slip
length as its barrier: it starts wide and shrinks at every good step, while sticking eyelets keep
their friction and slipping ones their travel.
"""

import math

import numpy as np

from .layout import (
    SLIP_LENGTH,
    address,
    balance_at,
    compiled,
    floats,
    newton_at,
    place_travel_at,
    respond_at,
    words,
)
from .linear import largest
from .residual import moment_arms_of
from .stages import torsion_acts

SLIPPING_FROM = 0.9999  # [1] direction of friction that counts as slipping
SLIP_START_TRAVEL = 3.0  # [1] travel, over the slip length, of a tendon that begins to slip
SLIP_CLEAR_TRAVEL = 8.0  # [1] and of one whose direction of friction no travel nearby changes
STEP_SETTLED_RAD = 1e-4  # [rad] step after which plain Newton ends the search
STEP_SHRINKING_RAD = 0.1  # [rad] step after which the slip length shrinks


@compiled
def next_travel(z, travel, width, new_width):
    """Travel [m] that an eyelet takes over, from its last one and what the step says it is."""
    if abs(z) > SLIP_CLEAR_TRAVEL * width:
        s = math.copysign(1.0, z)
    else:
        s = math.tanh(z / width)
        s += (1.0 - s * s) * (travel - z) / width
        if abs(s) < SLIPPING_FROM:
            return new_width * math.atanh(s)
    if s * travel <= 0.0:
        return 0.0
    return math.copysign(max(abs(travel), SLIP_START_TRAVEL * new_width), s)


@compiled
def take_over(chain, work, move, own, width, new_width):
    """
    Move the travel of the eyelets with a step of the bends, and change the slip length.

    Parameters
    ----------
    move : ndarray, shape (u,)
        Step of the bends [rad].
    own : ndarray, shape (4, n, k)
        Travel [m]: the eyelets' own, here and beyond, then the real one, here and beyond.
    width, new_width : float
        Slip length now and next [m].

    """
    tendon, (moment_arms, scale) = words(chain.tendon), moment_arms_of(chain, work)
    lever, twists = floats(moment_arms), torsion_acts(chain)
    for k in range(chain.k):
        total = 0.0
        for i in range(tendon[2 * k] - 1, -1, -1):
            at = 2 * (chain.k * i + k)
            step = scale * (lever[at] * move[2 * i] + lever[at + 1] * move[2 * i + 1])
            if twists:
                step += floats(work.axial)[at // 2] * move[2 * chain.n + i]
            own[0, i, k] = next_travel(own[0, i, k], own[2, i, k] + step, width, new_width)
            own[1, i, k] = next_travel(own[1, i, k], own[3, i, k] + total, width, new_width)
            total += step


@compiled
def exchange(chain, work, own):
    """Let the eyelets' own travel stand in `work`; keep the real one in own[2:], note the lag."""
    here, beyond, lag = floats(work.travel), floats(work.beyond), floats(work.lag)
    count = chain.n * chain.k
    for i in range(chain.n):
        for k in range(chain.k):
            at = chain.k * i + k
            own[2, i, k], own[3, i, k] = here[at], beyond[at]
            lag[at], lag[at + count] = here[at] - own[0, i, k], beyond[at] - own[1, i, k]
            here[at], beyond[at] = own[0, i, k], own[1, i, k]


@compiled
def own_travel(chain, bend, work):
    """Start with the travel that a state gives: (4, n, k) [m], see `take_over`."""
    own = np.zeros((4, chain.n, chain.k))
    place_travel_at(chain.place_travel)(chain, bend, work)
    for i in range(chain.n):
        for k in range(chain.k):
            own[0, i, k] = floats(work.travel)[chain.k * i + k]
            own[1, i, k] = floats(work.beyond)[chain.k * i + k]
    return own


@compiled
def solve_sliding(chain, inputs, x, work, past, wide, shrink, most):
    """
    Newton with a state of every eyelet, from x (u,); return the last residual [rad].

    The slip length starts `wide` times its own and shrinks by a factor at every good step.

    Parameters
    ----------
    inputs : address
        (m,) [N]
    x : ndarray, shape (u,)
        Bends [rad], guess and result.
    wide : float
        Slip length at the start, over SLIP_LENGTH [1].
    shrink : float
        Factor on it at every good step [1].
    most : int
        Steps.

    """
    size, slip = x.shape[0], floats(work.slip)
    f, move = np.empty(size), np.empty(size)
    own, width, long = own_travel(chain, address(x), work), wide * SLIP_LENGTH, math.inf
    for _ in range(most):
        slip[0] = width
        exchange(chain, work, own)
        balance_at(chain.balance)(chain, inputs, address(x), work, past, address(f))
        respond_at(chain.respond)(chain, address(x), address(f), 1, work, past, address(move), 0)
        long = largest(move)
        if not long < math.inf:
            break
        share = min(1.0, 1.0 / max(long, 1e-300))
        for j in range(size):
            move[j] *= share
            x[j] += move[j]
        if long < STEP_SETTLED_RAD and width == SLIP_LENGTH:
            break
        new_width = max(shrink * width, SLIP_LENGTH) if long < STEP_SHRINKING_RAD else width
        take_over(chain, work, move, own, width, new_width)
        width = new_width
        place_travel_at(chain.place_travel)(chain, address(x), work)
    slip[0] = SLIP_LENGTH
    for j in range(2 * chain.n * chain.k):
        floats(work.lag)[j] = 0.0
    if not long < STEP_SETTLED_RAD:
        return math.inf
    return newton_at(chain.newton)(chain, inputs, address(x), work, past, 12)
