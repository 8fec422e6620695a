"""Friction that remembers: from posture to posture, and the law by which it does."""

import math

import numpy as np

from .cells import unknowns
from .equilibrium import is_planar
from .geometry import tendon_travel, travel_beyond
from .layout import (
    BEND_TOLERANCE,
    RAMPED,
    REMEMBERED,
    YES,
    address,
    compiled,
    copy,
    entry,
    floats,
    keep,
    memory_in,
    memory_size,
    newton_at,
    section_of,
    words,
)
from .loads import loaded
from .newton import SAFE_LOAD_SHARE, load_ratio
from .shape import settle
from .stages import friction_travel_acts, memory, offset_scale
from .sweep import is_implicit, slip_direction

PARTS, SAME_RAD = 256, 1e-6  # of a way at most; a part is halved until it moves less
SAME_SIGN = 1e-2  # [1] by which the direction of friction may be off where an eyelet turns unseen
NEAR_STEPS_MAX = np.int64(8)  # of Newton, from a state that is near; no literal (see `layout`)


@entry(REMEMBERED)
def remembered(chain, sign, moved, section):
    """Direction of friction [1] that was `sign`, after a tendon moved on [m]."""
    return memory(0.0, sign, moved, chain, section)


@compiled
def remember(chain, inputs, bend, work, past, now):
    """Fill the friction memory `now` after a posture that came after `past`."""
    copy(bend, now.bend, unknowns(chain))
    copy(inputs, now.inputs, chain.m)
    tendon_travel(chain, bend, offset_scale(1.0, chain, 0), work)
    slides = friction_travel_acts(chain)
    if slides:
        travel_beyond(chain, work)
    sign, travel, tendon = floats(now.sign), floats(now.travel), words(chain.tendon)
    for k in range(chain.k):
        for i in range(tendon[2 * k] - 1):
            at = chain.k * i + k
            here = floats(work.travel)[at]
            sign[at], travel[at] = slip_direction(
                chain, work, past, at, section_of(chain, i), here, 0.0, slides, YES
            )


@compiled
def settle_near(chain, inputs, work, past, bend, before):
    """
    Find the equilibrium by Newton from a state that is near, else as `settle` does.

    A planar arm is quicker by sweeps, and a heavy load needs a look at what holds.
    """
    heavy = loaded(chain) and load_ratio(chain) > SAFE_LOAD_SHARE
    if is_implicit(chain) and not (heavy or is_planar(chain, floats(bend))):
        copy(bend, before, unknowns(chain))
        change = newton_at(chain.newton)(chain, inputs, bend, work, past, NEAR_STEPS_MAX)
        if change < BEND_TOLERANCE:
            return change
        copy(before, bend, unknowns(chain))
    return settle(chain, inputs, work, past, bend)


@compiled
def node(nodes, row):
    """Address of the memory at a node of the way."""
    return address(nodes) + 8 * nodes.shape[1] * row


@compiled
def guess(chain, nodes, known, row, reach, bend):
    """Fill a state at an address: that of a node, else between those beside it, else before it."""
    x, before, after = floats(bend), row - reach, min(row + reach, PARTS)
    for q in range(unknowns(chain)):
        if known[row] != 0:
            x[q] = nodes[row, q]
        elif known[after] != 0:
            x[q] = 0.5 * (nodes[before, q] + nodes[after, q])
        else:
            x[q] = nodes[before, q]


@compiled
def part(chain, inputs, work, past, now, nodes, known, row, reach, bend, before):
    """
    Go on from the memory `now`, which moves on, to a node of the way.

    Returns the last change [rad], and how far the state is from the one that the node had before
    [rad]; infinite where it is new or not reached.

    Parameters
    ----------
    inputs : address
        (m,) [N] where the way ends.
    past, now : Memory
        Of where the way begins, and of where the part does.
    nodes : ndarray, shape (PARTS + 1, memory_size)
        Memory at the nodes; takes that of this one.
    known : ndarray, shape (PARTS + 1,)
        Whether it is (1).
    row, reach : int
        The node, and how far from it there are others.
    bend : address
        Takes the state [rad].
    before : address
        Scratch (u,).

    """
    share, start, there = row / PARTS, floats(past.inputs), floats(now.inputs)
    for j in range(chain.m):
        there[j] = (1.0 - share) * start[j] + share * floats(inputs)[j]
    guess(chain, nodes, known, row, reach, bend)
    change, moved = settle_near(chain, now.inputs, work, now, bend, before), math.inf
    if not change < BEND_TOLERANCE:
        known[row] = 0
        return change, moved
    remember(chain, now.inputs, bend, work, now, now)
    if known[row] != 0:
        moved = apart(chain, node(nodes, row), now)
    copy(now.bend, node(nodes, row), nodes.shape[1])
    known[row] = 1
    return change, moved


@compiled
def apart(chain, old, now):
    """How far the state of a memory is from that of another, at an address [rad]."""
    most, other = 0.0, memory_in(chain, old)
    for q in range(unknowns(chain)):
        most = max(most, abs(floats(now.bend)[q] - floats(other.bend)[q]))
    return most


@compiled
def overshot(first, middle, last):
    """
    How far beyond one of its ends a parabola through three points in equal steps goes.

    Only where it turns in the first quarter or in the last: there both halves, and the whole, go
    the same way.
    """
    curve = 0.5 * (last + first) - middle
    slope = 0.5 * (last - first)
    if not (abs(curve) < abs(slope) and abs(slope) < 2.0 * abs(curve)):
        return 0.0
    beyond = 1.0 - abs(0.5 * slope / curve)
    return abs(curve) * beyond * beyond


@compiled
def missed(chain, nodes, at, half):
    """How far the direction of friction at an eyelet is off that turned unseen between nodes."""
    first, middle = memory_in(chain, node(nodes, at)), memory_in(chain, node(nodes, at + half))
    last, most = memory_in(chain, node(nodes, at + 2 * half)), 0.0
    tendon = words(chain.tendon)
    for k in range(chain.k):
        for i in range(tendon[2 * k] - 1):
            q = chain.k * i + k
            over = overshot(
                floats(first.travel)[q], floats(middle.travel)[q], floats(last.travel)[q]
            )
            if over > 0.0:
                most = max(most, memory(0.0, 0.0, 2.0 * over, chain, section_of(chain, i)))
    return most


@compiled
def whole(chain, inputs, work, past, now, nodes, known, at, length, bend, before):
    """Go on from a node by a part at once, see `part`; return the last change [rad]."""
    copy(node(nodes, at), now.bend, nodes.shape[1])
    end = at + length
    return part(chain, inputs, work, past, now, nodes, known, end, length, bend, before)[0]


@compiled
def halves(chain, inputs, work, past, now, nodes, known, at, half, bend, before):
    """Go on from a node by both halves of a part; see `part` for what is returned."""
    copy(node(nodes, at), now.bend, nodes.shape[1])
    row, end = at + half, at + 2 * half
    change, moved = part(chain, inputs, work, past, now, nodes, known, row, half, bend, before)
    if not change < BEND_TOLERANCE:
        return change, moved
    return part(chain, inputs, work, past, now, nodes, known, end, half, bend, before)


@entry(RAMPED)
def ramped(chain, inputs, work, past, now, bend, before):
    """
    Do what `shape.posture` does with friction memory, which it takes and returns.

    From the posture in `past`, in parts: each is halved until its halves lead to where it leads
    by itself and no eyelet turns unseen. The shortest may be a jump.
    """
    kept = memory_size(chain.n, chain.k, chain.m)
    nodes, known = np.empty((PARTS + 1, kept)), np.zeros(PARTS + 1, np.int64)
    at, length, alone, change = 0, PARTS, False, 0.0
    copy(past.bend, address(nodes), kept)
    while at < PARTS:
        half, end, moved = length // 2, at + length, math.inf
        if not alone:  # else it was a half of the one before
            change = whole(chain, inputs, work, past, now, nodes, known, at, length, bend, before)
        change, moved = halves(
            chain, inputs, work, past, now, nodes, known, at, half, bend, before
        )
        good = change < BEND_TOLERANCE
        if half == 1 and not good:
            change = whole(chain, inputs, work, past, now, nodes, known, at, length, bend, before)
            good = change < BEND_TOLERANCE
        if half == 1 and not good:
            break
        if half == 1 or (moved < SAME_RAD and missed(chain, nodes, at, half) < SAME_SIGN):
            at, length, alone = end, longest_from(end), False
        else:
            length, alone = half, known[at + half] != 0
    keep(nodes)
    keep(known)
    return change


@compiled
def longest_from(at):
    """Length of the longest part that begins at a node, as the way is halved."""
    length = PARTS
    while at % length != 0:
        length //= 2
    return length
