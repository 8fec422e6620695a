"""
Newton on bends and twists, for shapes that repeated sweeps do not settle; where tendons stick.

Above the buckling load: from an equilibrium on the ridge down to one that holds.

Stick and slip: the direction of friction is tanh(travel / slip length): between slipping one way
and the other lie 2 µm, and Newton on the bends alone jumps over them and back. In a spatial arm
half of the eyelets stick: tendons pull against each other, and friction there is what the balance
asks for. So every eyelet has a travel of its own, from which its friction follows, and which may
lag behind that of the bends; a step solves the linear equations of both. An eyelet that sticks
takes over the friction that the step says, not the travel; one that would need more than all
friction begins to slip; one that would slip against its friction sticks. That is a primal-dual
method, with the slip length as its barrier: it starts wide and shrinks at every good step, while
sticking eyelets keep their friction and slipping ones their travel.
"""

import math

import numpy as np

from .cells import cell_stiffness, unknowns
from .layout import (
    BEND_TOLERANCE,
    DESCEND,
    LENGTH,
    NEWTON,
    SLIP_LENGTH,
    address,
    balance_at,
    cell,
    compiled,
    copy,
    entry,
    floats,
    keep,
    newton_at,
    place_travel_at,
    residual_at,
    respond_at,
    section_of,
    step_at,
    words,
)
from .linear import assign, dot, largest
from .loads import force_at_tip, weight
from .residual import moment_arms_of
from .stages import torsion_acts

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
