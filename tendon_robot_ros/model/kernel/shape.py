"""Everything a posture tells: bends, frames, wire pulls; friction memory; batches."""

from .geometry import scale_lengths, tendon_travel, travel_beyond
from .layout import (
    LENGTH,
    address,
    cell,
    compiled,
    entry,
    floats,
    memory_in,
    section_of,
    settle_at,
    words,
    work_in,
)
from .newton import TOLERANCE
from .stages import measurement, memory_acts, offset, slide_acts, stretch
from .sweep import slip_direction
from .turning import chain_frames


@compiled
def copy(source, target, count):
    """Copy floats between addresses."""
    old, new = floats(source), floats(target)
    for j in range(count):
        new[j] = old[j]


@compiled
def remember(chain, inputs, bend, work, past, now):
    """Fill the friction memory `now` after a posture that came after `past`."""
    copy(bend, now.bend, 2 * chain.n)
    copy(inputs, now.inputs, chain.m)
    if not memory_acts(chain):
        return
    tendon_travel(chain, bend, offset(1.0, chain, 0), work)
    slides = slide_acts(chain)
    if slides:
        travel_beyond(chain, work)
    sign, travel, tendon = floats(now.sign), floats(now.travel), words(chain.tendon)
    for k in range(chain.k):
        for i in range(tendon[2 * k] - 1):
            at = chain.k * i + k
            here = floats(work.travel)[at]
            sign[at], travel[at] = slip_direction(
                chain, work, past, at, section_of(chain, i), here, slides, True
            )


@compiled
def ramp(chain, inputs, work, past, now, bend, parts):
    """Go from the remembered tensions to new ones in equal parts; `now` is the memory then."""
    change = 0.0
    copy(past.bend, bend, 2 * chain.n)
    copy(past.bend, now.bend, 2 * chain.n + 2 * chain.n * chain.k + chain.m)
    aim, start, there = floats(inputs), floats(past.inputs), floats(now.inputs)
    for part in range(parts):
        for j in range(chain.m):
            share = (part + 1.0) / parts
            there[j] = (1.0 - share) * start[j] + share * aim[j]
        change = settle_at(chain.settle)(chain, now.inputs, work, now, bend)
        if not change < TOLERANCE:
            break
        remember(chain, now.inputs, bend, work, now, now)
    return change


@compiled
def posture(chain, inputs, work, past, now, bend, before):
    """
    Equilibrium bends (n, 2) in `bend` and the memory `now` after it; return the last change.

    With friction memory it is reached from the posture in `past`, in ever finer parts until the
    result stays; without, from the guess in `bend`. `before` (n, 2) is scratch.
    """
    if not memory_acts(chain):
        change = settle_at(chain.settle)(chain, inputs, work, past, bend)
        remember(chain, inputs, bend, work, past, now)
        return change
    parts = 1
    change = ramp(chain, inputs, work, past, now, bend, parts)
    while parts < 64:
        copy(bend, before, 2 * chain.n)
        parts *= 2
        change = ramp(chain, inputs, work, past, now, bend, parts)
        moved = 0.0
        for j in range(2 * chain.n):
            moved = max(moved, abs(floats(bend)[j] - floats(before)[j]))
        if change < TOLERANCE and moved < 1e-6:
            break
    return change


@compiled
def place(chain, bend, work):
    """Fill work.lengths, work.frames and work.origins for the equilibrium's tensions."""
    scale_lengths(chain, work)
    chain_frames(chain, bend, work)


@compiled
def wire_pulls(chain, bend, work, pulls):
    """Wire pull (k,) [m] of every tendon: travel of all its cells and its own stretch."""
    tendon_travel(chain, bend, offset(1.0, chain, 0), work)
    tendon, tensions, travel = words(chain.tendon), floats(work.tensions), floats(work.travel)
    for k in range(chain.k):
        total = 0.0
        for i in range(tendon[2 * k]):
            at = chain.k * i + k
            total += travel[at] + stretch(
                0.0, tensions[at], cell(chain, i, LENGTH), chain, section_of(chain, i)
            )
        floats(pulls)[k] = total


@entry()
def postures(
    chain, inputs, bends, tensions, frames, origins, pulls, changes, past, scratch, carry
):
    """
    Solve postures (b, m) [N] into bends (b, n, 2), which hold the guesses, and the rest.

    `carry` 1: each posture follows the one before and friction remembers (`past` moves on);
    0: every posture comes from the memory in `past`, which stays.
    """
    n, k = chain.n, chain.k
    work = work_in(chain, address(scratch))
    before = address(scratch) + 8 * (scratch.shape[0] - 2 * n)
    now = memory_in(chain, before - 8 * (2 * n + 2 * n * k + chain.m))
    then = memory_in(chain, address(past))
    for b in range(inputs.shape[0]):
        bend = address(bends) + 16 * n * b
        changes[b] = posture(
            chain, address(inputs) + 8 * chain.m * b, work, then, now, bend, before
        )
        if carry != 0:
            copy(now.bend, then.bend, 2 * n + 2 * n * k + chain.m)
        place(chain, bend, work)
        copy(work.tensions, address(tensions) + 8 * n * k * b, n * k)
        copy(work.frames + 72, address(frames) + 72 * n * b, 9 * n)
        copy(work.origins + 24, address(origins) + 24 * n * b, 3 * n)
        wire_pulls(chain, bend, work, address(pulls) + 8 * k * b)


@entry()
def measured(chain, points):
    """Move points (p, 3) [m] from the robot's base frame to the tracker's, in place."""
    for p in range(points.shape[0]):
        x, y, z = measurement(points[p, 0], points[p, 1], points[p, 2], chain, 0)
        points[p, 0], points[p, 1], points[p, 2] = x, y, z
