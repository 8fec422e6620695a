"""
Derivatives of an equilibrium by the implicit function theorem.

The derivative of the residual by a parameter, at the same bends, is a difference of residuals; an
elimination with these as right-hand sides gives the derivatives of the bends. With friction, those
by tensions need no right-hand side: tensions enter at the base. (Of an explicit model, differences
of sweeps give them directly.) The outputs of a posture are then differentiated along parameter and
bends together, without solving again.
"""

import math

import numpy as np

from . import layout, stages
from .cells import half_turns, unknowns
from .layout import (
    address,
    assign,
    chain_at,
    compiled,
    copy,
    entry,
    floats,
    keep,
    largest,
    memory_in,
    memory_size,
    words,
)
from .linearisation import TRAVEL_STEP
from .shape import place, remember, settle_near, wire_pulls, work_in, workspace
from .sweep import is_implicit

AHEAD_RAD = layout.DIFFERENCE_STEP  # [rad] step of a state that shows to which side eyelets slide


@compiled
def span(tension):
    """Begin and width [N] of a difference by a tension: beyond zero, where laws may jump."""
    if tension < layout.LEAST_TENSION_N:
        return tension + layout.LEAST_TENSION_N, layout.LEAST_TENSION_N
    return tension - layout.LEAST_TENSION_N, 2.0 * layout.LEAST_TENSION_N


@compiled
def combine_tendons(chain, inputs, pulls, rows):
    """
    Fill the derivatives of a state by inputs, rows (m or more, u), from those by tendons (k, u).

    The actuation turns each input into the tension of its tendons, at inputs (m,) [N].
    """
    tendon, tension = words(chain.tendon), floats(inputs)
    for j in range(chain.m):
        for q in range(unknowns(chain)):
            rows[j, q] = 0.0
    for k in range(chain.k):
        j = tendon[2 * k + 1]
        begin, width = span(tension[j])
        rate = stages.actuation(begin + width, chain, k) - stages.actuation(begin, chain, k)
        rate /= width
        for q in range(unknowns(chain)):
            rows[j, q] += rate * pulls[k, q]


@compiled
def sweep_or_residual(chain, inputs, bend, work, past, out):
    """Fill `out` [rad] with the state of an explicit model, with the residual of another."""
    if is_implicit(chain):
        chain.residual(chain, inputs, bend, work, past, out)
    else:
        chain.step(chain, inputs, bend, work, past, out)


@compiled
def input_response(chain, inputs, bend, work, past, rows, central):
    """
    Fill the derivatives of the state by the input tensions, rows (m, unknowns) [rad/N].

    By `central` differences, or by differences to one side.
    """
    if is_implicit(chain) and stages.eyelet_acts(chain):
        pulls, f = np.empty((chain.k, unknowns(chain))), np.empty(unknowns(chain))
        chain.residual(chain, inputs, bend, work, past, address(f))
        chain.respond(chain, bend, 0, 0, work, past, 0, address(pulls))
        combine_tendons(chain, inputs, pulls, rows)
        keep(f)
        return
    m, size = chain.m, unknowns(chain)
    changes, low = np.empty((m, size)), np.empty(size)
    tension, implicit = floats(inputs), is_implicit(chain)
    filled = changes if implicit else rows
    if not central:
        sweep_or_residual(chain, inputs, bend, work, past, address(low))
    for j in range(m):
        was = tension[j]
        begin, width = span(was) if central else (was, layout.LEAST_TENSION_N)
        tension[j] = begin + width
        sweep_or_residual(chain, inputs, bend, work, past, address(filled) + 8 * size * j)
        if central:
            tension[j] = begin
            sweep_or_residual(chain, inputs, bend, work, past, address(low))
        tension[j] = was
        for q in range(size):
            filled[j, q] = (filled[j, q] - low[q]) / width
    if implicit:
        chain.residual(chain, inputs, bend, work, past, address(low))
        chain.respond(chain, bend, address(changes), m, work, past, address(rows), 0)
    keep(changes, low)


@compiled
def place_as(chain, inputs, bend, work, past):
    """Fill work.frames, work.origins and, where they matter, work.tensions at given bends."""
    if stages.length_acts(chain) or stages.stretch_acts(chain) or stages.winding_acts(chain):
        f = np.empty(unknowns(chain))
        chain.residual(chain, inputs, bend, work, past, address(f))
        keep(f)
    half_turns(chain, bend, work)
    place(chain, bend, work)


# Target (8,): x, y, z [m], direction x, y, z, weight of position [1], weight of direction [m/rad].


@compiled
def tip_error(chain, work, target, f):
    """Fill the weighted tip error (6,) [m] of the frames in `work`."""
    frames, origins, n = floats(work.frames), floats(work.origins), chain.n
    for r in range(3):
        f[r] = target[6] * (origins[3 * n + r] - target[r])
        f[3 + r] = target[7] * (frames[9 * n + 3 * r + 2] - target[3 + r])


@compiled
def tip_slopes(chain, inputs, solver, target, directions, f, slopes):
    """
    Fill the tip error (6,) [m] and its derivatives (6, d) along directions (d, u) of the state.

    At the state kept in the workspace, of inputs (m,). The first m directions are those of the
    state by an input, which itself moves with them.
    """
    bend, near = floats(solver.bend), floats(solver.near)
    up, down = np.empty(6), np.empty(6)
    for j in range(directions.shape[0]):
        step = layout.DIFFERENCE_STEP / max(largest(directions[j]), layout.DIFFERENCE_STEP)
        for side in range(2):
            h = step if side == 0 else -step
            for q in range(unknowns(chain)):
                near[q] = bend[q] + h * directions[j, q]
            was = inputs[j % chain.m]
            if j < chain.m:
                inputs[j] += h
            place_as(chain, address(inputs), solver.near, solver.work, solver.past)
            inputs[j % chain.m] = was
            tip_error(chain, solver.work, target, up if side == 0 else down)
        for r in range(6):
            slopes[r, j] = (up[r] - down[r]) / (2.0 * step)
            f[r] = 0.5 * (up[r] + down[r])


@compiled
def input_pulls(chain, inputs, bend, solver):
    """Return the wire pulls (m,) [m] of inputs at an address and a state, not settled."""
    place_as(chain, inputs, bend, solver.work, solver.past)
    wire_pulls(chain, bend, solver.work, solver.pulls, solver.means)
    return floats(solver.means)


@compiled
def pull_rates(chain, inputs, solver, state_slopes, slopes):
    """
    Fill slopes (m, m) [m/N] of the wire pulls by the inputs, and (m, u) [rad/N] of the state.

    By differences to one side: they only guide the steps of a search.
    """
    m, bend = chain.m, solver.bend
    input_response(chain, inputs, bend, solver.work, solver.past, state_slopes, False)
    pulls = input_pulls(chain, inputs, bend, solver)
    for j in range(m):
        for r in range(m):
            slopes[r, j] = -pulls[r] / layout.LEAST_TENSION_N
    for j in range(m):
        was = floats(inputs)[j]
        floats(inputs)[j] += layout.LEAST_TENSION_N
        for q in range(unknowns(chain)):
            floats(solver.near)[q] = floats(bend)[q] + layout.LEAST_TENSION_N * state_slopes[j, q]
        pulls = input_pulls(chain, inputs, solver.near, solver)
        floats(inputs)[j] = was
        for r in range(m):
            slopes[r, j] += pulls[r] / layout.LEAST_TENSION_N


@entry()
def jacobian(robot, inputs, bends, past, scratch, state_slopes, slopes):
    """
    Fill the derivatives by inputs (m,) at bends[0]: of the state (m, u) [rad/N], and of the tip.

    `slopes` (6, m): of tip position [m/N] and tip direction [1/N].
    """
    chain = chain_at(robot)
    solver, target, f = workspace(chain, bends, past, scratch), np.zeros(8), np.empty(6)
    target[6] = target[7] = 1.0
    tension, work, then = address(inputs), solver.work, solver.past
    input_response(chain, tension, solver.bend, work, then, state_slopes, True)
    tip_slopes(chain, inputs, solver, target, state_slopes, f, slopes)


@entry()
def take_sides(robot, inputs, bends, step, past, scratch):
    """
    Set eyelets at rest to the side to which they slide next; return how many change sides.

    The law of friction has a different slope on each side. An eyelet rests where the direction of
    its friction is nearly that in the memory `past`. The travel in that memory is offset a little,
    so that derivatives are those of the next side; an eyelet already on it does not count.

    Parameters
    ----------
    inputs : ndarray, shape (m,)
        [N]
    bends : ndarray, shape (2, 3n)
        The equilibrium [rad]; scratch.
    step : ndarray, shape (u,)
        Motion of the state [rad].
    past : ndarray
        Memory of the posture before; changed in place.

    """
    chain = chain_at(robot)
    solver = workspace(chain, bends, past, scratch)
    scale, tension = AHEAD_RAD / max(largest(step), AHEAD_RAD), address(inputs)
    for q in range(unknowns(chain)):
        floats(solver.near)[q] = floats(solver.bend)[q] + scale * step[q]
    kept, changed = np.zeros(memory_size(chain.n, chain.k, chain.m)), 0
    present, ahead, then = memory_in(chain, address(kept)), solver.now, solver.past
    remember(chain, tension, solver.near, solver.work, then, ahead)
    remember(chain, tension, solver.bend, solver.work, then, present)
    # so far that differences of the law stay on one side, and by far less than a presliding length
    tendon, aside = words(chain.tendon), 16.0 * TRAVEL_STEP * chain.radius
    for k in range(chain.k):
        for i in range(tendon[2 * k] - 1):
            at = chain.k * i + k
            slid = floats(present.travel)[at] - floats(then.travel)[at]
            motion = floats(ahead.travel)[at] - floats(present.travel)[at]
            since = slid if abs(slid) > 2.0 * aside else 0.0  # else it was offset, or rests
            side = math.copysign(1.0, scale * since + motion)
            rests = abs(floats(present.sign)[at] - floats(then.sign)[at]) < layout.SAME_SIGN
            if rests and slid * side < 0.5 * aside:
                floats(then.travel)[at] = floats(present.travel)[at] - aside * side
                changed += 1
    keep(kept)
    return changed


@entry()
def path_slopes(robot, inputs, states, past, scratch, answers, by_tension, pulls):
    """
    Fill the derivatives of equilibria that follow one another, each after the memory of the last.

    Parameters
    ----------
    robot : int
        Address of a Chain.
    inputs, states : ndarray, shapes (b, m) and (b, 3n)
        Equilibria [N], [rad]; where friction remembers states near them, which become these.
    past : ndarray
        Memory before the first; moves on.
    scratch : int
        Address of `KernelArrays.scratch`.
    answers, by_tension : ndarray, shapes (b, u, u) and (b, m, u)
        Take the derivatives of the state by its residual [1] and by the tensions [rad/N].
    pulls : ndarray, shape (b, m, m)
        Takes the derivatives of the wire pulls by the tensions [m/N]. With none of them (0, m, m)
        the latter are not asked for.

    """
    chain = chain_at(robot)
    size, m = unknowns(chain), chain.m
    bends = np.zeros((2, 3 * chain.n))
    solver, unit, f = workspace(chain, bends, past, scratch), np.eye(size), np.empty(size)
    for b in range(inputs.shape[0]):
        tension = address(inputs) + 8 * m * b
        bend = address(states) + 24 * chain.n * b
        if stages.memory_acts(chain):  # within a path the state is a guess
            settle_near(chain, tension, solver.work, solver.past, bend, solver.before)
        copy(bend, solver.bend, size)
        if pulls.shape[0] > 0:
            pull_rates(chain, tension, solver, by_tension[b], pulls[b])
        chain.residual(chain, tension, solver.bend, solver.work, solver.past, address(f))
        rows = address(answers) + 8 * size * size * b
        chain.respond(chain, solver.bend, address(unit), size, solver.work, solver.past, rows, 0)
        remember(chain, tension, solver.bend, solver.work, solver.past, solver.now)
        copy(solver.now.bend, solver.past.bend, memory_size(chain.n, chain.k, m))
    keep(bends, unit, f)


@entry()
def path_steps(robot, inputs, states, pulls, past, scratch, answers, by_tension, held):
    """
    Move equilibria that follow one another by a step of Newton each, memory included.

    Parameters
    ----------
    robot : int
        Address of a Chain, a little other than that of the equilibria.
    inputs, states : ndarray, shapes (b, m) and (b, 3n)
        [N], [rad]; moved in place.
    pulls : ndarray, shape (b, m)
        Requested wire pulls [m].
    past : ndarray
        Memory before the first; moves on.
    scratch : int
        Address of `KernelArrays.scratch`.
    answers, by_tension : ndarray, shapes (b, u, u) and (b, m, u)
        See `path_slopes`, of the equilibria before they move.
    held : ndarray, shape (b, m, m)
        Tensions by wire pulls [N/m] that the motors hold; (0, m, m) where they hold tensions.

    """
    chain = chain_at(robot)
    size, m, bends = unknowns(chain), chain.m, np.zeros((2, 3 * chain.n))
    solver, f, before = workspace(chain, bends, past, scratch), np.empty(size), np.empty(m)
    work, then = solver.work, solver.past
    for b in range(inputs.shape[0]):
        tension, bend = address(inputs) + 8 * m * b, address(states) + 24 * chain.n * b
        chain.residual(chain, tension, bend, work, then, address(f))
        for r in range(size):
            for q in range(size):
                states[b, r] += f[q] * answers[b, q, r]
        if held.shape[0] > 0:
            means = input_pulls(chain, tension, bend, solver)
            assign(before, inputs[b])
            for j in range(m):
                for r in range(m):
                    inputs[b, j] += held[b, j, r] * (pulls[b, r] - means[r])
                for q in range(size):
                    states[b, q] += (inputs[b, j] - before[j]) * by_tension[b, j, q]
        remember(chain, tension, bend, work, then, solver.now)
        copy(solver.now.bend, then.bend, memory_size(chain.n, chain.k, m))
    keep(f, bends)


@entry()
def responses(robot, inputs, bends, past, scratch, changes, rows):
    """
    Fill the derivatives of equilibria, rows (b, q, u), of rates of the residual (b, q, u).

    Parameters
    ----------
    robot : int
        Address of a Chain.
    inputs, bends : ndarray, shapes (b, m) and (b, n, 2)
        Equilibria [N], [rad].
    past : ndarray
        Memory of the posture before.
    scratch : int
        Address of `KernelArrays.scratch`.
    changes, rows : ndarray, shape (b, q, u)
        Rates of the residual by q quantities; takes those of the bends.

    """
    chain = chain_at(robot)
    work, then = work_in(chain, scratch), memory_in(chain, address(past))
    size, count = unknowns(chain), rows.shape[1]
    f = np.empty(size)
    for b in range(inputs.shape[0]):
        tension, bend = address(inputs) + 8 * chain.m * b, address(bends) + 24 * chain.n * b
        chain.residual(chain, tension, bend, work, then, address(f))
        at = 8 * size * count * b
        change, answers = address(changes) + at, address(rows) + at
        chain.respond(chain, bend, change, count, work, then, answers, 0)
