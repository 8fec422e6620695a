"""Everything a posture tells: bends, frames, wire pulls; friction memory; batches."""

import math

import numpy as np

from .geometry import scale_lengths, tendon_travel, travel_beyond
from .layout import (
    BEND_TOLERANCE,
    LENGTH,
    YES,
    address,
    cell,
    chain_at,
    compiled,
    copy,
    entry,
    floats,
    memory_in,
    memory_size,
    residual_at,
    section_of,
    settle_at,
    step_at,
    with_results,
    words,
    work_in,
    work_size,
)
from .linear import assign
from .loads import place_cells
from .stages import (
    friction_travel_acts,
    measurement,
    memory_acts,
    offset_scale,
    stretch,
    stretch_acts,
    winding,
    winding_acts,
)
from .sweep import is_implicit, slip_direction
from .turning import unknowns

GUESS_STEP_MAX = 0.3  # [rad] step of a bend over which a derivative is no guess


@compiled
def remember(chain, inputs, bend, work, past, now):
    """Fill the friction memory `now` after a posture that came after `past`."""
    copy(bend, now.bend, unknowns(chain))
    copy(inputs, now.inputs, chain.m)
    if not memory_acts(chain):
        return
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
def settle(chain, inputs, work, past, bend):
    """Find the equilibrium (`solve_equilibrium`); an explicit model needs one sweep for it."""
    if is_implicit(chain):
        return settle_at(chain.settle)(chain, inputs, work, past, bend)
    step_at(chain.step)(chain, inputs, bend, work, past, bend)
    for j in range(unknowns(chain)):
        if not abs(floats(bend)[j]) < 1e6:
            return math.inf
    return 0.0


@compiled
def ramp(chain, inputs, work, past, now, bend, parts, found):
    """
    Go from the remembered tensions to new ones in equal parts; `now` is the memory then.

    Every part is looked for on the straight way from the last one to the state found before.

    Parameters
    ----------
    inputs : address
        (m,) [N] to go to.
    past, now : Memory
        Of the posture before; takes that after the last part.
    bend : address
        Takes the state [rad].
    parts : int
    found : address
        State [rad] that fewer parts led to; 0: none did.

    """
    change = 0.0
    copy(past.bend, bend, unknowns(chain))
    copy(past.bend, now.bend, memory_size(chain.n, chain.k, chain.m))
    aim, start, there = floats(inputs), floats(past.inputs), floats(now.inputs)
    for part in range(parts):
        for j in range(chain.m):
            share = (part + 1.0) / parts
            there[j] = (1.0 - share) * start[j] + share * aim[j]
        for q in range(unknowns(chain) if found != 0 else 0):
            floats(bend)[q] += (floats(found)[q] - floats(bend)[q]) / (parts - part)
        change = settle(chain, now.inputs, work, now, bend)
        if not change < BEND_TOLERANCE:
            break
        remember(chain, now.inputs, bend, work, now, now)
    return change


@compiled
def posture(chain, inputs, work, past, now, bend, before):
    """
    Equilibrium state in `bend` and the memory `now` after it; return the last change.

    With friction memory it is reached from the posture in `past`, in ever finer parts until the
    result stays; without, from the guess in `bend`. `before` (3n,) is scratch.

    Parameters
    ----------
    inputs : address
        (m,) [N]
    past, now : Memory
        Of the posture before; takes that after this one.
    bend : address
        State [rad], guess and result.
    before : address
        Scratch (3n,).

    """
    if not memory_acts(chain):
        change = settle(chain, inputs, work, past, bend)
        remember(chain, inputs, bend, work, past, now)
        return change
    parts, none = np.int64(1), np.int64(0)
    change = ramp(chain, inputs, work, past, now, bend, parts, none)
    while parts < 64:
        found = before if change < BEND_TOLERANCE else none
        copy(bend, before, unknowns(chain))
        parts *= 2
        change = ramp(chain, inputs, work, past, now, bend, parts, found)
        moved = 0.0
        for j in range(unknowns(chain)):
            moved = max(moved, abs(floats(bend)[j] - floats(before)[j]))
        if change < BEND_TOLERANCE and moved < 1e-6:
            break
    return change


@compiled
def place(chain, bend, work):
    """Fill work.lengths, work.frames and work.origins for the equilibrium's tensions."""
    scale_lengths(chain, work)
    place_cells(chain, bend, work)


@compiled
def wire_pulls(chain, bend, work, pulls):
    """Wire pull (k,) [m] of every tendon, as commanded: its travel, stretch and winding."""
    tendon, tensions = words(chain.tendon), floats(work.tensions)
    totals, k = floats(pulls), chain.k
    tendon_travel(chain, bend, offset_scale(1.0, chain, 0), work)
    for j in range(k):
        total = 0.0
        for i in range(tendon[2 * j]):
            total += floats(work.travel)[k * i + j]
        totals[j] = total
    if stretch_acts(chain):
        for j in range(k):
            for i in range(tendon[2 * j]):
                totals[j] += stretch(
                    0.0, tensions[k * i + j], cell(chain, i, LENGTH), chain, section_of(chain, i)
                )
    if winding_acts(chain):
        for j in range(k):
            totals[j] = winding(totals[j], tensions[j], chain, j)


@compiled
def mean_pulls(chain, pulls, means):
    """Mean wire pull (m,) [m] over the tendons of every input."""
    tendon = words(chain.tendon)
    for j in range(chain.m):
        total, members = 0.0, 0
        for k in range(chain.k):
            if tendon[2 * k + 1] == j:
                total += floats(pulls)[k]
                members += 1
        floats(means)[j] = total / max(members, 1)


@compiled
def balance(chain, inputs, there, bend):
    """Solve for the bends at an address from what is there; tell whether they balance."""
    change = posture(chain, address(inputs), there.work, there.past, there.now, bend, there.before)
    return change < BEND_TOLERANCE


@compiled
def predict(chain, there, ways, inputs, trial):
    """Guess the state of a trial: that kept, and how it follows the inputs (m, ...) [rad/N]."""
    near, longest = floats(there.near), 0.0
    size = unknowns(chain)
    copy(there.bend, there.near, size)
    for q in range(size):
        move = 0.0
        for j in range(chain.m):
            move += ways[j, q] * (trial[j] - inputs[j])
        near[q] += move
        longest = max(longest, abs(move)) if move == move else math.inf
    if not longest < GUESS_STEP_MAX:
        copy(there.bend, there.near, size)


@compiled
def accept(chain, there, trial, moved, inputs, f):
    """Go to where a trial was: its tensions, residuals and bends."""
    assign(inputs, trial)
    assign(f, moved)
    copy(there.near, there.bend, unknowns(chain))


@compiled
def results_at(chain, block, count, b, work):
    """
    Where posture b of a block (see `model.form`) lies.

    Returns inputs, bends, pulls of the tendons, pulls of the inputs, the last change, and scratch
    whose tensions, frames and origins are those of the block.
    """
    n, k, m = chain.n, chain.k, chain.m
    bends = block + 8 * m * count
    tensions = bends + 24 * n * count
    frames = tensions + 8 * n * k * count
    origins = frames + 72 * n * count
    pulls = origins + 24 * n * count
    means = pulls + 8 * k * count
    changes = means + 8 * m * count
    here = with_results(
        work, tensions + 8 * n * k * b, frames + 72 * (n * b - 1), origins + 24 * (n * b - 1)
    )
    row = (block + 8 * m * b, bends + 24 * n * b, pulls + 8 * k * b, means + 8 * m * b)
    return row, changes + 8 * b, here


@compiled
def show(chain, row, here):
    """Fill frames, positions and wire pulls of a posture whose bends and tensions are there."""
    place(chain, row[1], here)
    wire_pulls(chain, row[1], here, row[2])
    mean_pulls(chain, row[2], row[3])


@entry()
def postures(robot, block, count, begin, end, past, scratch, carry):
    """
    Solve postures `begin` to `end` of a block; return the worst of their last changes [rad].

    The block holds inputs (count, m) [N] and guesses of the bends and takes the rest. `carry` 1:
    each posture follows the one before and friction remembers (`past` moves on); 0: every
    posture comes from the memory in `past`, which stays. `past` and `scratch` are addresses;
    `past` 0: it lies in the block behind the results.

    Parameters
    ----------
    robot : int
        Address of a Chain.
    block : ndarray
        Results of `count` postures, see `model.shape.ResultLayout`.
    count, begin, end : int
    past : int
        Address of the memory of the posture before.
    scratch : int
        Address of `KernelArrays.scratch`.
    carry : int

    """
    chain = chain_at(robot)
    n, k, m = chain.n, chain.k, chain.m
    work = work_in(scratch)
    now = memory_in(chain, scratch + 8 * work_size(n, k))
    before = now.bend + 8 * memory_size(n, k, m)
    start = address(block)
    behind = results_at(chain, start, count, count, work)[1]
    then = memory_in(chain, past if past != 0 else behind)
    worst = 0.0
    for b in range(begin, end):
        row, change_at, here = results_at(chain, start, count, b, work)
        solving = with_results(work, here.tensions, work.frames, work.origins)
        change = posture(chain, row[0], solving, then, now, row[1], before)
        floats(change_at)[0] = change
        if not change <= worst:
            worst = change
        if carry != 0:
            copy(now.bend, then.bend, memory_size(n, k, m))
        show(chain, row, here)
    return worst


@entry()
def show_postures(robot, block, count, past, scratch):
    """Fill a block from its inputs and bends as they are, without solving."""
    chain = chain_at(robot)
    work, then = work_in(scratch), memory_in(chain, past)
    f = np.empty(unknowns(chain))
    for b in range(count):
        row, _, here = results_at(chain, address(block), count, b, work)
        solving = with_results(work, here.tensions, work.frames, work.origins)
        residual_at(chain.residual)(chain, row[0], row[1], solving, then, address(f))
        show(chain, row, here)


@entry()
def measured(robot, points):
    """Move points (p, 3) [m] from the robot's base frame to the tracker's, in place."""
    chain = chain_at(robot)
    for p in range(points.shape[0]):
        x, y, z = measurement(points[p, 0], points[p, 1], points[p, 2], chain, 0)
        points[p, 0], points[p, 1], points[p, 2] = x, y, z
