"""
Tensions for a tip target.

`aim`: bounded Levenberg-Marquardt on the model itself, from equilibrium to equilibrium.

`seek`: Newton on the equilibrium and the target together. Where tendons stick and slip, the tip
is a function of the tensions with many kinks, at which a search that solves for an equilibrium at
every trial stalls. Here the tensions are further unknowns of the primal-dual method of
`solve_sliding`: the same elimination gives the derivatives of the bends by the residual and by
every tension, the tip's error is then linear in the tensions, and bounded least squares gives
their step. The smoothing length shrinks from step to step: kinks appear when the target is already
near.
"""

import math

import numpy as np

from . import layout, stages
from .cells import unknowns
from .derivatives import combine_tendons, input_response, tip_error, tip_slopes
from .equilibrium import SHRINK_FACTORS, end_sliding, exchange, own_travel, take_over
from .layout import address, chain_at, compiled, entry, floats, largest, monotonic, solve_small
from .shape import accept, is_balanced, place, predict, workspace
from .sweep import is_implicit


@compiled
def tip_residual(chain, inputs, solver, bend, target, f):
    """
    Weighted tip error (6,) [m] at inputs (m,); infinite where there is no equilibrium.

    `bend` holds a guess and takes the equilibrium.
    """
    if not is_balanced(chain, inputs, solver, bend):
        f[:] = math.inf
        return
    place(chain, bend, solver.work)
    tip_error(chain, solver.work, target, f)


@compiled
def cost_of(f, inputs, low, price):
    """Half the squared error plus the cost of tension [m²], see `tension_price`."""
    total, above, (weight, pull, room, least) = 0.0, 0.0, price
    for r in range(6):
        total += f[r] * f[r]
    for j in range(inputs.shape[0]):
        above += inputs[j] - low[j]
        total += (weight * (inputs[j] - low[j])) ** 2
    return 0.5 * total - pull * math.log(max(1.0 - above / room, least))


@compiled
def tension_price(f, inputs, low, tension):
    """
    Return the cost of tension beside a tip error (6,): weight [m/N], price [m²], room [N], least.

    A search goes down half the squared error e² / 2, to which the weight adds, whose slope is that
    of ln e times e²: a price of `tension[1]` beside ln e is that times e². It is paid for minus
    the logarithm of what is left of the room. Beyond `tension[2]` [m] the price is one beside e
    itself: a place that is ten lengths away is no reason to do nothing. `least` of the room [1]
    counts as left where all tensions are at their limits.
    """
    weight, price, length, room, least, _ = tension
    square = 2.0 * cost_of(f, inputs, low, (weight, 0.0, room, least))
    return weight, price * min(square, math.sqrt(square) * length), room, least


@compiled
def normal_equations(jacobian, f, inputs, low, price, damping, normal, gradient):
    """
    Fill the damped normal matrix (m, m) and the gradient (m,) of the cost.

    Parameters
    ----------
    jacobian : ndarray, shape (6, m)
        Of the weighted tip error [m/N].
    f : ndarray, shape (6,)
        That error [m].
    inputs, low : ndarray, shape (m,)
        [N]
    price : tuple
        Of tension above the lowest, see `tension_price`.
    damping : float
        Of Levenberg and Marquardt [1].
    normal, gradient : ndarray, shapes (m, m) and (m,)
        Take the result [m²/N²], [m²/N].

    """
    m, remaining, (weight, pull, room, least) = inputs.shape[0], 1.0, price
    for j in range(m):
        remaining -= (inputs[j] - low[j]) / room
    pull /= room * max(remaining, least)
    for j in range(m):
        above = inputs[j] - low[j]
        gradient[j] = weight * weight * above + pull
        for r in range(6):
            gradient[j] += jacobian[r, j] * f[r]
        for q in range(m):
            normal[j, q] = 0.0
            for r in range(6):
                normal[j, q] += jacobian[r, j] * jacobian[r, q]
        # a sum has no curvature: that of the square that touches it from above
        normal[j, j] += weight * weight + pull / max(above, least * room / m)
        normal[j, j] += damping * (normal[j, j] + 1e-12)


@compiled
def gauss_newton_step(jacobian, f, inputs, low, high, price, damping, trial, free):
    """
    Damped Gauss-Newton step into `trial`; return the count of the inputs that could move.

    Linear least squares with bounds: where a step would violate limits, the input with the largest
    violation is set to its limit, and the step of the others is computed again.

    Parameters
    ----------
    jacobian : ndarray, shape (6, m)
        Of the weighted tip error [m/N].
    f : ndarray, shape (6,)
        That error [m].
    inputs, low, high : ndarray, shape (m,)
        Where the step begins, and limits [N].
    price : tuple
        Of tension above the lowest, see `tension_price`.
    damping : float
        Of Levenberg and Marquardt [1].
    trial : ndarray, shape (m,)
        Takes where it ends [N].
    free : ndarray, shape (m,)
        Scratch: indices of the inputs that move.

    """
    m = inputs.shape[0]
    normal, part, step = np.empty((m, m)), np.empty((m, m)), np.empty(m)
    gradient, move = np.empty(m), np.zeros(m)
    normal_equations(jacobian, f, inputs, low, price, damping, normal, gradient)
    count = 0
    for j in range(m):  # those not at a limit that the gradient pushes against
        free[count] = j
        at_low, at_high = inputs[j] <= low[j], inputs[j] >= high[j]
        pressed = (at_low and gradient[j] > 0.0) or (at_high and gradient[j] < 0.0)
        count += 0 if pressed else 1
    moving = count
    while moving > 0:
        for p in range(moving):
            step[p] = -gradient[free[p]]
            for j in range(m):
                step[p] -= normal[free[p], j] * move[j]
            for q in range(moving):
                part[p, q] = normal[free[p], free[q]]
        solve_small(part, step, moving)
        worst, excess_max = -1, 0.0
        for p in range(moving):
            value = inputs[free[p]] + step[p]
            excess = max(low[free[p]] - value, value - high[free[p]])
            if excess > excess_max:
                worst, excess_max = p, excess
        if worst < 0:
            for p in range(moving):
                move[free[p]] = step[p]
            break
        j = free[worst]
        move[j] = (low[j] if step[worst] < 0.0 else high[j]) - inputs[j]
        moving -= 1
        for p in range(worst, moving):
            free[p] = free[p + 1]
    for j in range(m):
        trial[j] = min(max(inputs[j] + move[j], low[j]), high[j])
    return count


@entry()
def aim(
    robot, inputs, bends, target, low, high, until, past, scratch, tension, trials_max, enough, far
):
    """
    Move inputs (m,) [N] within [low, high] so that the tip meets the target; return the cost.

    `bends` (2, 3n) holds a guess and takes the equilibrium in its first half. Once the tip has
    converged, the search ends with a step that gains less than `enough` of the cost. It ends at a
    time, too.

    Parameters
    ----------
    robot : int
        Address of a Chain.
    inputs : ndarray, shape (m,)
        [N], start and result.
    bends : ndarray, shape (2, 3n)
        [rad]
    target : ndarray, shape (8,)
        Position [m], direction, weight of the position [1], weight of the direction [m/rad].
    low, high : ndarray, shape (m,)
        [N]
    until : int
        Address of that time [s], see `layout.monotonic`.
    past : ndarray
        Memory of the posture before.
    scratch : int
        Address of `KernelArrays.scratch`.
    tension : tuple of float
        Cost of tension, see `tension_price`: weight of its squares [m/N], price [1], [m], room,
        the sum of all ranges [N], and its least part [1]; cost of a tip that has converged [m²].
    trials_max : int
        Equilibria that may be solved.
    enough, far : float
        [1]; cost [m²] from which on nothing is done.

    """
    chain = chain_at(robot)
    m, solver = chain.m, workspace(chain, bends, past, scratch)
    work, then, near = solver.work, solver.past, solver.near
    f, moved, jacobian = np.empty(6), np.empty(6), np.zeros((6, m))
    trial, free, state_slopes = np.empty(m), np.empty(m, np.int64), np.empty((m, unknowns(chain)))
    tip_residual(chain, inputs, solver, solver.bend, target, f)
    price, damping = tension_price(f, inputs, low, tension), 1e-9
    cost = cost_of(f, inputs, low, price)
    is_explicit = not (is_implicit(chain) or stages.memory_acts(chain))
    floats(work.settings)[layout.EVERY_METHOD] = 0.0
    while trials_max > 0 and cost < far and monotonic() < floats(until)[0]:
        if is_explicit:
            for j in range(m):  # a sweep of the model is exact
                was = inputs[j]
                step = layout.LEAST_TENSION_N
                step = step if was + step <= high[j] else -step
                inputs[j] = was + step
                chain.step(chain, address(inputs), near, work, then, near)
                inputs[j] = was
                place(chain, near, work)
                tip_error(chain, work, target, moved)
                for r in range(6):
                    jacobian[r, j] = (moved[r] - f[r]) / step
        else:
            input_response(chain, address(inputs), solver.bend, work, then, state_slopes, True)
            tip_slopes(chain, inputs, solver, target, state_slopes, moved, jacobian)
        gain = 0.0
        for _ in range(min(trials_max, layout.STEPS_MAX)):
            trials_max -= 1
            problem = (jacobian, f, inputs, low, high, price, damping)
            if gauss_newton_step(*problem, trial, free) == 0:
                break
            if not is_explicit:
                predict(chain, solver, state_slopes, inputs, trial)
            tip_residual(chain, trial, solver, solver.near, target, moved)
            new = cost_of(moved, trial, low, price)
            if new < cost:
                gain = cost - new
                break
            damping = max(10.0 * damping, 1e-6)
        if gain == 0.0:
            break
        damping = max(0.05 * damping, 1e-13)
        accept(chain, solver, trial, moved, inputs, f)
        price = tension_price(f, inputs, low, tension)
        cost = cost_of(f, inputs, low, price)
        reached = cost_of(f, low, low, price) < tension[5]
        least = max(enough, layout.DIFFERENCE_STEP) if reached else layout.DIFFERENCE_STEP
        if gain < least * cost or cost < layout.EPSILON:
            break
    return cost_of(f, inputs, low, (tension[0], 0.0, tension[3], tension[4]))


# [1] once friction is as sharp as it is: of the weight of tension, because all of it would keep
# the tip off its target, and damping, so that tensions do not go in circles
FINAL_FRACTION = 0.01


@entry()
def seek(
    robot, inputs, bends, target, low, high, until, past, scratch, preference, fraction, steps
):
    """
    Move inputs (m,) [N] within [low, high] and bends[0] (3n,) [rad] towards a tip target.

    The smoothing length starts as a fraction of the widest and shrinks after every short step.
    Returns the last step [rad]: where it is small, an equilibrium is near. The search ends after
    so many steps, and at the time [s] at the address `until`, see `layout.monotonic`.
    """
    chain = chain_at(robot)
    m, size, solver = chain.m, unknowns(chain), workspace(chain, bends, past, scratch)
    work, then, tensions = solver.work, solver.past, address(inputs)
    directions, pulls = np.empty((m + 1, size)), np.empty((chain.k, size))
    residual, balancing = np.empty(size), address(directions) + 8 * size * m
    f, slopes, move = np.empty(6), np.empty((6, m + 1)), np.empty(size)
    trial, free = np.empty(m), np.empty(m, np.int64)
    own, longest = own_travel(chain, solver.bend, work), math.inf
    width = fraction * layout.WIDE_SMOOTHING * layout.SMOOTHING_LENGTH
    for step in range(steps):
        if monotonic() > floats(until)[0]:
            break
        floats(work.settings)[layout.SMOOTHING] = width
        exchange(chain, work, own)
        chain.balance(chain, tensions, solver.bend, work, then, address(residual))
        # the derivatives of the bends by every tension, last their step to balance
        chain.respond(
            chain, solver.bend, address(residual), 1, work, then, balancing, address(pulls)
        )
        combine_tendons(chain, tensions, pulls, directions)
        tip_slopes(chain, inputs, solver, target, directions, f, slopes)
        for r in range(6):
            f[r] += slopes[r, m]  # after the step of the bends that balances these tensions
        # later tensions go in circles
        damping = 0.0 if step < layout.STEPS_MAX else FINAL_FRACTION
        weight = preference if width > layout.SMOOTHING_LENGTH else FINAL_FRACTION * preference
        gauss_newton_step(
            slopes, f, inputs, low, high, (weight, 0.0, 1.0, 1.0), damping, trial, free
        )
        for q in range(size):
            move[q] = directions[m, q]
            for j in range(m):
                move[q] += directions[j, q] * (trial[j] - inputs[j])
        longest = largest(move)
        if not longest < math.inf:
            break
        part = min(1.0, layout.LINEAR_STEP_RAD / max(longest, layout.TINY))
        for q in range(size):
            move[q] *= part
            floats(solver.bend)[q] += move[q]
        for j in range(m):
            inputs[j] += part * (trial[j] - inputs[j])
        if longest < layout.SETTLED_RAD and width == layout.SMOOTHING_LENGTH:
            break
        shrink = SHRINK_FACTORS[1]
        width = take_over(chain, solver.bend, work, move, own, width, longest, shrink)
    end_sliding(chain, work)
    return longest
