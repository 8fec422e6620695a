"""
Postures, one or many, one after another: state, frames, wire pulls, memory of friction; scratch.

Friction that remembers follows the path of the tensions from one posture to the next (`ramped`).
"""

import math

import numpy as np
from numba import types

from . import layout, stages
from .cells import cell_stiffness, chain_frames, half_turns, moment_held, unknowns
from .equilibrium import SAFE_LOAD, is_planar, load_ratio
from .geometry import scale_lengths, tendon_travel, travel_beyond
from .layout import (
    FLOAT,
    WORD,
    Workspace,
    address,
    assign,
    cell,
    chain_at,
    compiled,
    copy,
    entry,
    exchange,
    floats,
    keep,
    memory_in,
    memory_size,
    words,
    work_from,
    work_size,
)
from .loads import bows, end_at, loaded, push_at
from .sweep import is_implicit, slip_direction


@compiled
def work_in(chain, start):
    """Scratch of a posture at an address, laid out by `lay_out_work`; ready for a new search."""
    laid = words(start)
    work = work_from(start, laid[5], laid[6], laid[7])
    settings = floats(work.settings)
    settings[layout.SMOOTHING], settings[layout.LOAD_SCALE] = layout.SMOOTHING_LENGTH, 1.0
    settings[layout.SHAPED] = settings[layout.EVERY_METHOD] = settings[layout.STABLE] = 1.0
    for r in range(3):
        floats(work.frames)[4 * r] = 1.0
    for i in range(chain.n):
        floats(work.lengths)[i] = cell(chain, i, layout.LENGTH)
        floats(work.compliance)[i] = 1.0 / cell_stiffness(chain, i)
    return work


@compiled
def workspace(chain, bends, past, scratch):
    """Lay out the workspace of a search; the caller keeps `bends` (2, 3n) and `past` alive."""
    n, k = chain.n, chain.k
    now = memory_in(chain, scratch + 8 * work_size(n, k))
    before = now.bend + 8 * memory_size(n, k, chain.m)
    pulls, bend = before + 24 * n, address(bends)
    then = memory_in(chain, address(past))
    work = work_in(chain, scratch)
    return Workspace(work, then, now, bend, bend + 24 * n, before, pulls, pulls + 8 * k)


@compiled
def settle(chain, inputs, work, past, bend):
    """Find the equilibrium (`solve_equilibrium`); an explicit model needs one sweep for it."""
    if is_implicit(chain):
        return chain.solve_equilibrium(chain, inputs, work, past, bend)
    chain.step(chain, inputs, bend, work, past, bend)
    for j in range(unknowns(chain)):
        if not abs(floats(bend)[j]) < 1e6:
            return math.inf
    return 0.0


@compiled
def posture(chain, inputs, work, past, now, bend, before):
    """
    Equilibrium state in `bend` and the memory `now` after it; return the last change.

    With friction memory it is reached from the posture in `past` (`ramped`); without, from the
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
    if stages.memory_acts(chain):
        return chain.ramped(chain, inputs, work, past, now, bend, before, 0)
    change = settle(chain, inputs, work, past, bend)
    remember_bends(chain, inputs, bend, work, past, now)
    return change


@compiled
def remember_bends(chain, inputs, bend, work, past, now):
    """Fill what the memory `now` has besides friction, after a posture that came after `past`."""
    if stages.hysteresis_acts(chain):
        for i in range(chain.n):
            x, y = moment_held(chain, past, i, floats(bend)[2 * i], floats(bend)[2 * i + 1])
            floats(now.moment)[2 * i], floats(now.moment)[2 * i + 1] = x, y
    if stages.push_acts(chain):  # what surfaces hold of the arm
        half_turns(chain, bend, work)
        chain_frames(chain, bend, work)
        copy(past.held, work.held, 6 * chain.n)
        for i in range(chain.n):
            end, frame = end_at(work, i)
            _, _, friction, apart = push_at(chain, work, i, end, frame)
            held = floats(now.held + 48 * i)
            held[0], held[1], held[2] = friction
            held[3], held[4], held[5] = apart
    copy(bend, now.bend, unknowns(chain))
    copy(inputs, now.inputs, chain.m)
    copy(past.passed, now.passed, chain.k)


@compiled
def place(chain, bend, work):
    """Fill work.lengths, frames and origins, of loaded cells as they bow, for known tensions."""
    scale_lengths(chain, work)
    chain_frames(chain, bend, work)
    if loaded(chain) and bows(chain):
        chain.bow_cells(chain, bend, work)


@compiled
def wire_pulls(chain, bend, work, pulls, means):
    """
    Fill the wire pulls [m], as commanded: of tendons (k,) and, their means, of inputs (m,).

    Of a tendon it is its travel, stretch and winding.
    """
    tendon, tensions = words(chain.tendon), floats(work.tensions)
    totals, k = floats(pulls), chain.k
    tendon_travel(chain, bend, stages.offset_scale(1.0, chain, 0), work)
    for j in range(k):
        totals[j] = 0.0
    for i in range(chain.n):  # no tendon waits for the sum of another
        for j in range(k):
            totals[j] += floats(work.travel)[k * i + j]
    if stages.stretch_acts(chain):
        for j in range(k):
            for i in range(tendon[2 * j]):
                totals[j] += stages.stretch(
                    0.0, tensions[k * i + j], cell(chain, i, layout.LENGTH), chain, i
                )
    if stages.winding_acts(chain):
        for j in range(k):
            totals[j] = stages.winding(totals[j], tensions[j], chain, j)
    for j in range(chain.m):
        total, members = 0.0, 0
        for q in range(k):
            if tendon[2 * q + 1] == j:
                total += totals[q]
                members += 1
        floats(means)[j] = total / max(members, 1)


@compiled
def is_balanced(chain, inputs, solver, bend):
    """Solve for the bends at an address, which hold the guess; return whether they balance."""
    change = posture(
        chain, address(inputs), solver.work, solver.past, solver.now, bend, solver.before
    )
    return change < layout.BEND_TOLERANCE


@compiled
def predict(chain, solver, slopes, inputs, trial):
    """Predict the state of a trial from the kept one by slopes (m, u) [rad/N] of the inputs."""
    near, longest = floats(solver.near), 0.0
    size = unknowns(chain)
    copy(solver.bend, solver.near, size)
    for q in range(size):
        move = 0.0
        for j in range(chain.m):
            move += slopes[j, q] * (trial[j] - inputs[j])
        near[q] += move
        longest = max(longest, abs(move)) if move == move else math.inf
    if not longest < layout.LINEAR_STEP_RAD:
        copy(solver.bend, solver.near, size)


@compiled
def accept(chain, solver, trial, moved, inputs, f):
    """Make a trial the present state: its tensions, residuals and bends."""
    assign(inputs, trial)
    assign(f, moved)
    copy(solver.near, solver.bend, unknowns(chain))


@compiled
def results_at(chain, block, count, b, work):
    """
    Return the addresses of posture b of a block (see `model.form`).

    Returns inputs, bends, pulls of the tendons, pulls of the inputs, the last change, and scratch
    whose tensions, and scratch whose frames and origins, too, are those of the block.
    """
    n, k, m = chain.n, chain.k, chain.m
    bends = block + 8 * m * count
    tensions = bends + 24 * n * count
    frames = tensions + 8 * n * k * count
    origins = frames + 72 * n * count
    pulls = origins + 24 * n * count
    means = pulls + 8 * k * count
    changes = means + 8 * m * count
    output = work_from(
        work.at, tensions + 8 * n * k * b, frames + 72 * (n * b - 1), origins + 24 * (n * b - 1)
    )
    row = (block + 8 * m * b, bends + 24 * n * b, pulls + 8 * k * b, means + 8 * m * b)
    solving = work_from(work.at, output.tensions, work.frames, work.origins)
    return row, changes + 8 * b, solving, output


@entry(FLOAT(WORD, types.float64[::1], WORD, WORD, WORD, WORD, WORD, WORD, WORD))
def postures(robot, block, count, begin, end, past, scratch, carry, solves):
    """
    Solve postures `begin` to `end` of a block; return the worst of their last changes [rad].

    The block holds inputs (count, m) [N] and guesses of the bends and takes the rest. `carry` 1:
    each posture follows the one before and friction remembers (`past` moves on); 0: every
    posture comes from the memory in `past`, which stays. `past` and `scratch` are addresses;
    `past` 0: it lies in the block behind the results. `solves` 0: inputs and bends are shown as
    they are.

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
    carry, solves : int

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
        row, change_at, solving, output = results_at(chain, start, count, b, work)
        change = 0.0
        if solves != 0:
            change = posture(chain, row[0], solving, then, now, row[1], before)
        else:
            chain.residual(chain, row[0], row[1], solving, then, before)
            if carry != 0:
                remember(chain, row[0], row[1], solving, then, now)
        floats(change_at)[0] = change
        if not change <= worst:
            worst = change
        if carry != 0:
            copy(now.bend, then.bend, memory_size(n, k, m))
        place(chain, row[1], output)
        wire_pulls(chain, row[1], output, row[2], row[3])
    return worst


@entry()
def variants(robot, block, past, scratch, acting, starts, places, values, out, shows):
    """
    Fill the residuals `out` (count, 3n) [rad] of postures of a block, as many of each variant.

    Those of the twists are 0 where cells do not twist, because a row is as wide as a state. With
    `shows` 1 the postures are also shown, as by `postures` without solving.

    Parameters
    ----------
    robot, block, scratch
        See `postures`.
    past : ndarray
        Memory of the posture before all of them.
    acting, starts, places, values : ndarray
        Variants of the chain, see `exchange`.

    """
    chain = chain_at(robot)
    then, count = memory_in(chain, address(past)), out.shape[0]
    each = count // acting.shape[0]
    for v in range(acting.shape[0]):
        exchange(chain, acting, starts, places, values, v)
        work = work_in(chain, scratch)  # of the variant: stiffness is kept there
        for b in range(v * each, (v + 1) * each):
            row, _, solving, output = results_at(chain, address(block), count, b, work)
            for q in range(unknowns(chain), 3 * chain.n):
                out[b, q] = 0.0
            chain.residual(chain, row[0], row[1], solving, then, address(out[b]))
            if shows != 0:
                place(chain, row[1], output)
                wire_pulls(chain, row[1], output, row[2], row[3])
        exchange(chain, acting, starts, places, values, v)


@entry()
def measured(robot, points):
    """Move points (p, 3) [m] from the robot's base frame to the tracker's, in place."""
    chain = chain_at(robot)
    for p in range(points.shape[0]):
        x, y, z = stages.measurement(points[p, 0], points[p, 1], points[p, 2], chain, 0)
        points[p, 0], points[p, 1], points[p, 2] = x, y, z


@entry()
def remembered(chain, sign, moved, i):
    """Direction of friction [1], from `sign` before a tendon moved [m]."""
    return stages.memory(0.0, sign, moved, chain, i)


@compiled
def remember(chain, inputs, bend, work, past, now):
    """Fill the memory `now` after a posture that came after `past`, that of friction, too."""
    remember_bends(chain, inputs, bend, work, past, now)
    if not stages.memory_acts(chain):
        return
    tendon_travel(chain, bend, stages.offset_scale(1.0, chain, 0), work)
    slides = stages.friction_travel_acts(chain)
    if slides:
        travel_beyond(chain, work)
    sign, travel, tendon = floats(now.sign), floats(now.travel), words(chain.tendon)
    for k in range(chain.k):
        for i in range(tendon[2 * k] - 1):
            at = chain.k * i + k
            travelled = floats(work.travel)[at]
            sign[at], travel[at] = slip_direction(
                chain, work, past, at, i, travelled, 0.0, slides, layout.YES
            )


@compiled
def settle_near(chain, inputs, work, past, bend, before):
    """
    Find the equilibrium near the state in `bend`; return the last change [rad].

    By Newton; for a planar arm sweeps are quicker, and under a heavy load stability has to be
    checked. `before` is the address of scratch (u,).
    """
    change, heavy = math.inf, loaded(chain) and load_ratio(chain, work) > SAFE_LOAD
    if is_implicit(chain) and not (heavy or is_planar(chain, floats(bend))):
        copy(bend, before, unknowns(chain))
        change = chain.newton(chain, inputs, bend, work, past)
        if not change < layout.BEND_TOLERANCE:
            copy(before, bend, unknowns(chain))
    if not change < layout.BEND_TOLERANCE:
        change = settle(chain, inputs, work, past, bend)
    return change


@compiled
def continue_path(chain, inputs, work, past, now, nodes, reached, bend, before, start, row):
    """
    Continue along a path from one node to another.

    Returns the last change [rad], and the difference of the state from the previous one of the
    node [rad]; infinite where the node is new or not reached.

    Parameters
    ----------
    inputs : address
        (m,) [N] where the path ends.
    past, now : Memory
        Memory at the start of the path; scratch, takes that of the node.
    nodes : ndarray, shape (PARTS + 1, memory_size)
        Memory at the nodes; takes that of this one.
    reached : ndarray, shape (PARTS + 1,)
        Whether it is there (1).
    bend, before : address
        Takes the state (u,) [rad]; scratch (u,).
    start, row : int
        Both nodes.

    """
    size, moved = nodes.shape[1], math.inf
    copy(address(nodes) + 8 * size * start, now.bend, size)
    fraction, first, tensions = row / layout.PARTS, floats(past.inputs), floats(now.inputs)
    for j in range(chain.m):
        tensions[j] = (1.0 - fraction) * first[j] + fraction * floats(inputs)[j]
    x, after = floats(bend), min(2 * row - start, layout.PARTS)
    for q in range(unknowns(chain)):  # the node itself, the middle of its neighbours, or `start`
        x[q] = nodes[start, q]
        if reached[row] != 0:
            x[q] = nodes[row, q]
        elif reached[after] != 0:
            x[q] = 0.5 * (nodes[start, q] + nodes[after, q])
    change = settle_near(chain, now.inputs, work, now, bend, before)
    if not change < layout.BEND_TOLERANCE:
        reached[row] = 0
        return change, moved
    remember(chain, now.inputs, bend, work, now, now)
    if reached[row] != 0:
        moved = 0.0
        for q in range(unknowns(chain)):
            moved = max(moved, abs(floats(bend)[q] - nodes[row, q]))
    copy(now.bend, address(nodes) + 8 * size * row, size)
    reached[row] = 1
    return change, moved


@compiled
def sign_error(chain, nodes, at, middle, end):
    """
    Error of the direction of friction [1] where travel changes sign unseen between nodes.

    By how much a parabola through three points in equal steps exceeds its ends, where its vertex
    is in the first quarter or in the last: there both halves, and the whole, have the same sign.
    """
    size, error, tendon = 8 * nodes.shape[1], 0.0, words(chain.tendon)
    first, last = memory_in(chain, address(nodes) + size * at), address(nodes) + size * end
    half, last = memory_in(chain, address(nodes) + size * middle), memory_in(chain, last)
    for k in range(chain.k):
        for i in range(tendon[2 * k] - 1):
            q = chain.k * i + k
            a, b, c = floats(first.travel)[q], floats(half.travel)[q], floats(last.travel)[q]
            curve, slope = 0.5 * (c + a) - b, 0.5 * (c - a)
            if abs(curve) < abs(slope) and abs(slope) < 2.0 * abs(curve):
                beyond = 1.0 - abs(0.5 * slope / curve)
                beyond = 2.0 * abs(curve) * beyond * beyond
                sign = stages.memory(0.0, 0.0, beyond, chain, i)
                error = max(error, sign)
    return error


@entry()
def ramped(chain, inputs, work, past, now, bend, before, ends):
    """
    Solve a posture with friction memory, see `posture`.

    Tensions change in a straight line from the posture in `past`, in parts: each is halved until
    its halves lead to the same state as the whole and no travel changes sign unseen. The shortest
    part may be a jump. `ends` is the address of words (PARTS,) of which those where a part ends
    become 1; 0: they are not asked for.
    """
    kept = memory_size(chain.n, chain.k, chain.m)
    nodes, reached = np.empty((layout.PARTS + 1, kept)), np.zeros(layout.PARTS + 1, np.int64)
    path = (chain, inputs, work, past, now, nodes, reached, bend, before)
    at, length, known, change = 0, layout.PARTS, False, 0.0
    copy(past.bend, address(nodes), kept)
    while at < layout.PARTS:
        middle, end, shortest, moved = at + length // 2, at + length, length == 2, math.inf
        if not known:  # else it was a half of the part before
            change, _ = continue_path(*path, at, end)
        change, _ = continue_path(*path, at, middle)
        if change < layout.BEND_TOLERANCE:
            change, moved = continue_path(*path, middle, end)
        if shortest and not change < layout.BEND_TOLERANCE:
            change, _ = continue_path(*path, at, end)
            if not change < layout.BEND_TOLERANCE:
                break
        # ten times as much would save 5 to 30 % of the time and move tips by up to 10 µm
        same = moved < layout.SETTLED_RAD
        same = same and sign_error(chain, nodes, at, middle, end) < layout.SAME_SIGN
        if shortest or same:
            at, length, known = end, end & -end, False  # the longest part that begins there
            if ends != 0:
                words(ends)[middle - 1] = words(ends)[end - 1] = 1
        else:
            length, known = length // 2, reached[middle] != 0
    keep(nodes, reached)
    return change


@entry()
def parts(robot, inputs, past, scratch, ends):
    """
    Fill `ends` (b, PARTS), see `ramped`, of postures that follow one another, inputs (b, m) [N].

    `past` is the memory before the first; it moves on.
    """
    chain, bends = chain_at(robot), np.zeros((2, 3 * chain_at(robot).n))
    solver = workspace(chain, bends, past, scratch)
    for b in range(inputs.shape[0]):
        chain.ramped(
            chain,
            address(inputs) + 8 * chain.m * b,
            solver.work,
            solver.past,
            solver.now,
            solver.bend,
            solver.before,
            address(ends[b]),
        )
        copy(solver.now.bend, solver.past.bend, memory_size(chain.n, chain.k, chain.m))
    keep(bends)
