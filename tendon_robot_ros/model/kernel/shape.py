"""Everything a posture tells: bends, frames, wire pulls; friction memory; batches; scratch."""

import math

import numpy as np

from .cells import cell_stiffness, is_general, unknowns
from .geometry import scale_lengths, tendon_travel
from .layout import (
    BEND_TOLERANCE,
    LENGTH,
    POSTURES,
    SLIP_LENGTH,
    Workspace,
    address,
    cell,
    chain_at,
    compiled,
    copy,
    entry,
    floats,
    memory_in,
    memory_size,
    ramped_at,
    residual_at,
    section_of,
    settle_at,
    step_at,
    with_results,
    words,
    work_from,
    work_size,
)
from .linear import assign
from .loads import force_at_tip, place_cells, weight
from .stages import (
    measurement,
    memory_acts,
    offset_scale,
    stretch,
    stretch_acts,
    winding,
    winding_acts,
)
from .sweep import is_implicit


@compiled
def work_in(chain, start):
    """Scratch of a posture at an address, laid out by `lay_out_work`; ready for a new search."""
    at = words(start)
    work = work_from(start, at[5], at[6], at[7])
    slip = floats(work.slip)
    slip[0], slip[1], slip[2], slip[3] = SLIP_LENGTH, 1.0, 1.0, 1.0
    for r in range(3):
        floats(work.frames)[4 * r] = 1.0
    note_cells(chain, work)
    return work


@compiled
def note_cells(chain, work):
    """Fill work with what it holds of cells and loads that no search changes."""
    slip, flat = floats(work.slip), not is_general(chain) and force_at_tip(chain)[1] == 0.0
    for i in range(chain.n):
        floats(work.lengths)[i] = cell(chain, i, LENGTH)
        floats(work.compliance)[i] = 1.0 / cell_stiffness(chain, i, section_of(chain, i))
        flat = flat and weight(chain, i)[1] == 0.0
    slip[4] = 1.0 if flat else 0.0


@compiled
def workspace(chain, bends, past, scratch):
    """Lay out what a search needs; `bends` (2, 3n) and `past` are kept alive outside."""
    n, k = chain.n, chain.k
    now = memory_in(chain, scratch + 8 * work_size(n, k))
    before = now.bend + 8 * memory_size(n, k, chain.m)
    pulls, bend = before + 24 * n, address(bends)
    then = memory_in(chain, address(past))
    work = work_in(chain, scratch)
    return Workspace(work, then, now, bend, bend + 24 * n, before, pulls, pulls + 8 * k)


GUESS_STEP_MAX = 0.3  # [rad] step of a bend over which a derivative is no guess


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
def posture(chain, inputs, work, past, now, bend, before):
    """
    Equilibrium state in `bend` and the memory `now` after it; return the last change.

    With friction memory it is reached from the posture in `past` (`history`); without, from the
    guess in `bend`.

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
    if memory_acts(chain):
        return ramped_at(chain.ramped)(chain, inputs, work, past, now, bend, before)
    change = settle(chain, inputs, work, past, bend)
    copy(bend, now.bend, unknowns(chain))
    copy(inputs, now.inputs, chain.m)
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
        totals[j] = 0.0
    for i in range(chain.n):  # no tendon waits for the sum of another
        for j in range(k):
            totals[j] += floats(work.travel)[k * i + j]
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


@entry(POSTURES)
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
    work = work_in(chain, scratch)
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
    work, then = work_in(chain, scratch), memory_in(chain, past)
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
