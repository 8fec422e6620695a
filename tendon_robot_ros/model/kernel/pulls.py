"""
Tensions for wire pulls: each commanded wire is either taut at its pull, or slack.

There are stiff wires and wires that are springs; springs have a unique solution where stiff wires
have many. The lengths of two exactly opposite stiff wires do not determine how hard these pull
against each other; those of wires that stretch, however little, do: the looser one is slack.
"""

import math

import numpy as np

from . import layout, stages
from .cells import unknowns
from .derivatives import pull_rates
from .layout import (
    address,
    assign,
    chain_at,
    compiled,
    copy,
    entry,
    floats,
    keep,
    memory_in,
    memory_size,
    solve_rows,
    solve_small,
    words,
)
from .shape import accept, is_balanced, predict, wire_pulls, workspace


@entry()
def transmit(robot, pulls, past, carry):
    """
    Replace commanded pulls (b, m) [m] by those that pass the transmission; NaN: a slack wire.

    `carry` 1: rows follow each other, and the memory in `past` moves on; 0: each comes from it.
    Of a group: the mean of its tendons.
    """
    chain = chain_at(robot)
    tendon, kept = words(chain.tendon), floats(memory_in(chain, address(past)).passed)
    for b in range(pulls.shape[0]):
        for j in range(chain.m):
            total, members = 0.0, 0
            for k in range(chain.k):
                if tendon[2 * k + 1] == j and not math.isnan(pulls[b, j]):
                    passed = stages.transmission(pulls[b, j], kept[k], chain, k)
                    kept[k] = passed if carry != 0 else kept[k]
                    total += passed
                    members += 1
            if members > 0:
                pulls[b, j] = total / members


@compiled
def pull_residuals(chain, inputs, target, solver, f, bend):
    """Wire pull minus the requested one (m,) [m], zero where none was; False: no equilibrium."""
    if not is_balanced(chain, inputs, solver, bend):
        return False
    wire_pulls(chain, bend, solver.work, solver.pulls, solver.means)
    for j in range(inputs.shape[0]):
        f[j] = 0.0 if math.isnan(target[j]) else floats(solver.means)[j] - target[j]
    return True


@compiled
def stretches(chain):
    """Tell whether every wire is a spring by itself: its pull grows with its tension."""
    if not stages.winding_acts(chain):
        return False
    for k in range(chain.k):
        if not stages.winding(0.0, 1.0, chain, k) > stages.winding(0.0, 0.0, chain, k):
            return False
    return True


@compiled
def pull_slopes(chain, inputs, target, solver, state_slopes, slopes):
    """Fill the derivative (m, m) [m/N] of the residuals by the tensions."""
    pull_rates(chain, address(inputs), solver, state_slopes, slopes)
    for r in range(inputs.shape[0]):
        if math.isnan(target[r]):
            slopes[r] = 0.0


@compiled
def violation(inputs, target, f):
    """Sum of squares of errors: taut wires off their pull, slack ones short of it [m²]."""
    total = 0.0
    for j in range(inputs.shape[0]):
        if not math.isnan(target[j]) and (inputs[j] > 0.0 or f[j] < 0.0):
            total += f[j] * f[j]
    return total


@compiled
def taut_step(jacobian, f, inputs, target, damping, trial):
    """Damped Newton step of the taut wires, tensions kept from below zero, into `trial`."""
    m = inputs.shape[0]
    free = np.empty(m, np.int64)
    count = layout.ZERO
    for j in range(m):
        trial[j] = inputs[j]
        if not math.isnan(target[j]) and (inputs[j] > 0.0 or f[j] < 0.0):
            free[count] = j
            count += 1
    normal, step = np.empty((count, count)), np.empty(count)
    for p in range(count):
        step[p] = 0.0
        for r in range(count):
            step[p] -= jacobian[free[r], free[p]] * f[free[r]]
        for q in range(count):
            normal[p, q] = 0.0
            for r in range(count):
                normal[p, q] += jacobian[free[r], free[p]] * jacobian[free[r], free[q]]
    for p in range(count):
        normal[p, p] += damping * (normal[p, p] + 1e-14)
    solve_small(normal, step, count)
    for p in range(count):
        trial[free[p]] = max(inputs[free[p]] + step[p], 0.0)


@compiled
def stiff_wires(chain, inputs, target, solver, slopes, state_slopes, steps_max):
    """
    Find tensions (m,) [N] >= 0 whose wire pulls are `target` (m,) [m]; NaN: a slack wire.

    Returns whether it finds them, at an equilibrium stable or not: see `held_gap`.

    Parameters
    ----------
    inputs : ndarray, shape (m,)
        [N], start and result; zero of a slack wire.
    target : ndarray, shape (m,)
        Wire pulls [m]; NaN: a slack wire.
    solver : Workspace
        Of a search by quick methods; its state is guess and result.
    slopes, state_slopes : ndarray, shape (m, m) and (m, unknowns)
        Derivatives by the tensions of pulls [m/N] and of the state [rad/N], as far as they are
        known at the guess, else NaN; at the result on return.
    steps_max : int
        Steps.

    """
    f, moved, trial = np.empty(chain.m), np.empty(chain.m), np.empty(chain.m)
    if not pull_residuals(chain, inputs, target, solver, f, solver.bend):
        return False
    damping, settled = 1e-10, layout.BEND_TOLERANCE * chain.n * chain.radius
    sprung = stretches(chain)  # so that slopes change little
    fresh, stale = False, not sprung or math.isnan(slopes[0, 0])
    for _ in range(steps_max):
        error = violation(inputs, target, f)
        if error < settled * settled:  # as far as bends are known
            return True
        if stale:
            pull_slopes(chain, inputs, target, solver, state_slopes, slopes)
            fresh, stale = True, False
        new, before = math.inf, damping
        for _ in range(layout.STEPS_MAX if fresh else 1):
            taut_step(slopes, f, inputs, target, damping, trial)
            predict(chain, solver, state_slopes, inputs, trial)
            if pull_residuals(chain, trial, target, solver, moved, solver.near):
                new = violation(trial, target, moved)
            if new < error:
                break
            damping = max(10.0 * damping, 1e-6)
        if not new < error and fresh:
            break
        if not new < error:
            stale, damping = True, before
            continue
        damping, stale, fresh = max(0.1 * damping, 1e-12), new > 0.1 * error or not sprung, False
        correct(slopes, moved - f, trial - inputs)
        accept(chain, solver, trial, moved, inputs, f)
    return False


@compiled
def held_gap(chain, inputs, target, solver):
    """
    Return the largest gap [m] of the wires at the equilibrium that these tensions (m,) [N] hold.

    A stable one, by all methods; infinite where the model finds none.
    """
    settings, f = floats(solver.work.settings), np.empty(chain.m)
    settings[layout.EVERY_METHOD] = settings[layout.STABLE] = 1.0
    found, gap = pull_residuals(chain, inputs, target, solver, f, solver.bend), 0.0
    settings[layout.EVERY_METHOD] = settings[layout.STABLE] = 0.0
    for j in range(inputs.shape[0]):
        if not math.isnan(target[j]) and (inputs[j] > 0.0 or f[j] < 0.0):
            gap = max(gap, abs(f[j]))
    return gap if found else math.inf


# [N] error of the tension of a wire that stretches, because stiffer springs would correct no more;
# slack wires count as much, else they would never become taut
STRETCH_ERROR_N = 0.1
STEP_MAX = 3.0  # [1] of the largest tension: a longer step would leap where pulls hardly change


@compiled
def spring_step(slopes, f, inputs, target, stretch, move):
    """
    Newton step (m,) [N] of the taut wires; return the largest gap [m] among them.

    A wire is taut if its tension is positive or its requested pull exceeds that of its spring at
    rest. The gap is negative where the slopes (m, m) [m/N] of the pulls determine no step.
    """
    m = inputs.shape[0]
    taut = np.empty(m, np.int64)
    count, top = layout.ZERO, 0.0
    for j in range(m):
        move[j] = 0.0
        gap = f[j] + stretch * inputs[j]
        if not math.isnan(target[j]) and (inputs[j] > 0.0 or gap < 0.0):
            taut[count] = j
            count += 1
            top = max(top, abs(gap))
    if count == 0:
        return 0.0
    part, step, high = np.empty((count, count)), np.empty((count, 1)), 0.0
    for p in range(count):
        for q in range(count):
            part[p, q] = slopes[taut[p], taut[q]]
        part[p, p] += stretch
        step[p, 0] = f[taut[p]] + stretch * inputs[taut[p]]
        high = max(high, inputs[taut[p]])
    solved = solve_rows(address(part), address(step), count, step.shape[1])
    keep(part)
    if not solved:
        return -1.0
    longest = 0.0
    for p in range(count):
        move[taut[p]] = -step[p, 0]
        longest = max(longest, abs(step[p, 0]))
    fraction = min(1.0, STEP_MAX * (high + STRETCH_ERROR_N) / max(longest, layout.TINY))
    for p in range(count):
        move[taut[p]] *= fraction
    return top


@compiled
def correct(slopes, change, step):
    """Let the slopes (m, m) [m/N] give the change (m,) [m] that a step (m,) [N] made (Broyden)."""
    m = step.shape[0]
    length = layout.TINY
    for j in range(m):
        length += step[j] * step[j]
    for r in range(m):
        error = change[r]
        for j in range(m):
            error -= slopes[r, j] * step[j]
        for j in range(m):
            slopes[r, j] += error * step[j] / length


@compiled
def elastic_wires(chain, inputs, target, solver, slopes, state_slopes, stretch, steps_max):
    """
    Find tensions (m,) [N] >= 0 of wires that stretch by `stretch` [m/N]; NaN: a slack wire.

    Arguments as in `stiff_wires`. Returns the largest remaining gap [m], infinite where the model
    finds no equilibrium.
    """
    m = chain.m
    f, moved = np.empty(m), np.empty(m)
    trial, move, ahead = np.empty(m), np.empty(m), np.empty(m)
    if not pull_residuals(chain, inputs, target, solver, f, solver.bend):
        return math.inf
    fresh, stale, top = False, True, math.inf
    for _ in range(steps_max):
        if stale:
            pull_slopes(chain, inputs, target, solver, state_slopes, slopes)
            fresh, stale = True, False
            top = spring_step(slopes, f, inputs, target, stretch, move)
        if top < STRETCH_ERROR_N * stretch:
            break
        fraction, better = 1.0, False
        for _ in range(8 if fresh else 2):
            for j in range(m):
                trial[j] = max(inputs[j] + fraction * move[j], 0.0)
            predict(chain, solver, state_slopes, inputs, trial)
            good = pull_residuals(chain, trial, target, solver, moved, solver.near)
            new = spring_step(slopes, moved, trial, target, stretch, ahead)
            better = good and 0.0 <= new < (1.0 - 1e-3 * fraction) * top
            if better:
                break
            fraction *= 0.5
        if not better and fresh:
            break
        stale = not better or new > 0.3 * top
        if better:
            correct(slopes, moved - f, trial - inputs)
            accept(chain, solver, trial, moved, inputs, f)
            top = spring_step(slopes, f, inputs, target, stretch, move)
        fresh = False
    return top if top >= 0.0 else math.inf


# [1] stretch of the wires over the arm's compliance: from so soft that each wire finds its tension
# to so stiff that only 1e-4 of the pulls stretches, each so that the next search begins near
SPRING_COMPLIANCES = (1e-1, 1e-2, 1e-3, 1e-4)
SPRINGS = len(SPRING_COMPLIANCES)
# Searches without a guess: tensions [N] of wires that are pulled and of those held at rest, share
# of the limits [1], first spring [1], whether stiff wires are tried after springs that have no
# equilibrium [1]. Springs that stretch by less than the travel over which friction changes sign
# (some µm) may have none; wires that do not stretch have one there all the same, if not always the
# same tensions. Measured of 980 postures of six robots: springs solve 906, wires that do not
# stretch 35, from more tension 15, both at last 14 and 4; 6 have no solution.
SEARCHES = (
    (0.1, 0.0, 0.0, 0.0, 0.0),
    (0.1, 0.0, 0.0, 4.0, 0.0),
    (0.3, 0.3, 0.0, 4.0, 0.0),
    (0.1, 0.0, 0.0, 0.0, 1.0),
    (0.0, 0.0, 0.25, 4.0, 0.0),
)


@compiled
def begin(search, inputs, target, bends, high):
    """Lay out the straight start (m,) [N] of one of `SEARCHES`."""
    pulled, rest, share = search[0], search[1], search[2]
    for q in range(bends.shape[1]):
        bends[0, q] = 0.0
    for j in range(inputs.shape[0]):
        tension = (pulled if target[j] > 0.0 else rest) + share * high[j]
        inputs[j] = 0.0 if math.isnan(target[j]) else tension


@compiled
def are_known(slopes, target, bends):
    """Tell whether slopes (m, m) of pulls are those of the pulled wires, near a bent guess."""
    for r in range(slopes.shape[0]):
        moves = False
        for j in range(slopes.shape[1]):
            moves = moves or slopes[r, j] != 0.0
        if moves == math.isnan(target[r]):
            return False
    for q in range(bends.shape[1]):
        if bends[0, q] != 0.0:
            return True
    return False


@entry()
def meet_pulls(
    robot, inputs, targets, states, past, slopes, rates, gaps, scratch, high, stretch, carry, steps
):
    """
    Find tensions whose wire pulls are `targets`, row by row; return how many rows are met.

    It ends at the first row that no search meets. Wires that stretch come first, from soft to
    stiff: lengths alone often do not determine how hard two wires pull against each other, springs
    do. Wires that are springs by themselves need no others near a guess.

    Parameters
    ----------
    robot : int
        Address of a Chain.
    inputs, states : ndarray, shapes (b, m) and (b, 3n)
        [N], [rad], guesses and results; states of NaN are none: of springs that `carry` it is the
        row before.
    targets : ndarray, shape (b, m)
        Wire pulls [m]; NaN: a slack wire.
    past : ndarray
        Memory of the posture before; moves on where `carry`.
    slopes, rates : ndarray, shapes (b, m, m) and (b, m, unknowns)
        Derivatives by the tensions of pulls [m/N] and of states [rad/N], as far as they are known
        at the guesses, else NaN; at the results on return. Unknown ones are those of the row
        before.
    gaps : ndarray, shape (b,)
        Takes the remaining gap [m] of each row; infinite where the model finds no equilibrium.
    scratch : int
        Address of `KernelArrays.scratch`.
    high : ndarray, shape (m,)
        Upper limits of the tensions [N].
    stretch : float
        Wire pull per tension [m/N] of the arm.
    carry : int
        1: rows follow each other; 0: each comes from `past`.
    steps : int
        Of a search, at most.

    """
    chain = chain_at(robot)
    m, sprung = chain.m, stretches(chain)
    bends, trial = np.zeros((2, 3 * chain.n)), np.empty(m)
    solver = workspace(chain, bends, past, scratch)
    settings = floats(solver.work.settings)
    # quick methods; unstable ones are kept: lengths may hold what tensions alone do not
    settings[layout.EVERY_METHOD] = settings[layout.STABLE] = 0.0
    for b in range(targets.shape[0]):
        target, own, rate = targets[b], slopes[b], rates[b]
        if b > 0 and math.isnan(own[0, 0]):
            copy(address(slopes[b - 1]), address(own), m * m)
            copy(address(rates[b - 1]), address(rate), m * unknowns(chain))
        guess = b - 1 if math.isnan(states[b, 0]) else b
        near = guess == b or (carry != 0 and sprung and b > 0)
        gaps[b] = math.inf
        for attempt in range(-1 if near else 0, len(SEARCHES)):
            spring, always = SPRINGS if sprung else SPRINGS - 1, False
            if attempt < 0:
                for j in range(m):
                    trial[j] = 0.0 if math.isnan(target[j]) else inputs[guess, j]
                assign(bends[0], states[guess])
            else:
                begin(SEARCHES[attempt], trial, target, bends, high)
                spring, always = int(SEARCHES[attempt][3]), SEARCHES[attempt][4] > 0.0
            if not are_known(own, target, bends):
                own[0, 0] = math.nan
            stretched = True
            while stretched and spring < SPRINGS:
                soft = SPRING_COMPLIANCES[spring] * stretch
                left = elastic_wires(chain, trial, target, solver, own, rate, soft, steps)
                stretched = left < STRETCH_ERROR_N * soft  # stiffer springs do no better
                spring += 1
            only = False  # springs have one solution
            if stretched or always:
                only = stiff_wires(chain, trial, target, solver, own, rate, steps) and sprung
                gaps[b] = min(gaps[b], held_gap(chain, trial, target, solver))
            if gaps[b] < layout.GAP_ACCEPTED_M or only:
                break
        if not gaps[b] < layout.GAP_ACCEPTED_M:
            return b
        assign(inputs[b], trial)
        assign(states[b], bends[0])
        if carry != 0:
            copy(solver.now.bend, solver.past.bend, memory_size(chain.n, chain.k, m))
    return targets.shape[0]
