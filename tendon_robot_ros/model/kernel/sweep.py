"""
From tensions at the base to moments and bends: one sweep, and the residual of a state.

A sweep goes from the base to the tip (Kato et al. 2015, eq. 2, 8, 9, 10): tensions pass the
eyelets and every cell bends by the moment that it meets. What needs the shape itself, moment arms,
travel beyond an eyelet, loads, is that of a guess (`prepare`).

The residual is the bends minus those that their own moments ask for. Tensions, moment arms, travel
and loads are all those of the bends given. (A sweep goes on with the bend that it has just found,
which converges faster, but ties every cell to all before it.)
"""

import math

from . import layout, stages
from .cells import (
    bend_cell,
    bend_linear,
    chain_frames,
    follows_shape,
    half_turn,
    half_turns,
    is_linear,
    twist_of,
)
from .geometry import scale_lengths, tendon_travel, travel_beyond
from .layout import compiled, copy, entry, floats, fused, inlined, words
from .loads import loaded


@compiled
def is_implicit(chain):
    """Tell whether an effect acts that needs the shape: one sweep is then no equilibrium."""
    shaped = stages.wrap_acts(chain) or stages.friction_travel_acts(chain)
    shaped = shaped or stages.memory_acts(chain)
    return follows_shape(chain) or loaded(chain) or (stages.eyelet_acts(chain) and shaped)


@inlined
def smooth_sign(travel, slip_rate):
    """tanh(travel / smoothing length): a tendon that does not slide has no friction."""
    x = travel * slip_rate
    if x > 20.0:
        return 1.0
    if x < -20.0:
        return -1.0
    decayed = math.exp(-2.0 * abs(x))
    return math.copysign((1.0 - decayed) / (1.0 + decayed), x)


@inlined
def slip_rate_in(work):
    """One over the smoothing length [1/m]."""
    return 1.0 / floats(work.settings)[layout.SMOOTHING]


@inlined
def slip_direction(chain, work, past, at, i, travel, slip_rate, slides, remembers):
    """
    Direction s of friction at entry `at` of the travel (n, k), and the travel that counts [m].

    Parameters
    ----------
    at : int
        Entry chain.k i + k of the arrays (n, k).
    travel : float
        Travel of the tendon in cell i [m].
    slip_rate : float
        One over the smoothing length [1/m]; not used where friction remembers.
    slides, remembers : bool
        Whether the travel beyond counts, and whether friction remembers.

    """
    beyond = floats(work.beyond)[at] if slides else 0.0
    if remembers:
        travelled = stages.friction_travel(travel, beyond, chain, i)
        moved = travelled - floats(past.travel)[at]
        before = floats(past.sign)[at]
        return stages.memory(0.0, before, moved, chain, i), travelled
    if slides:
        return stages.friction_travel(
            smooth_sign(travel, slip_rate), smooth_sign(beyond, slip_rate), chain, i
        ), beyond
    return smooth_sign(travel, slip_rate), travel


@fused
def fast_log(x):
    """log(x), by a series where x is near 1: no second division behind that of the law."""
    u = 1.0 - x
    if not abs(u) < 0.04:
        return math.log(x)
    u2 = u * u
    u4 = u2 * u2
    low = (1.0 + u * (1.0 / 2.0)) + u2 * (1.0 / 3.0 + u * (1.0 / 4.0))
    middle = (1.0 / 5.0 + u * (1.0 / 6.0)) + u2 * (1.0 / 7.0 + u * (1.0 / 8.0))
    high = (1.0 / 9.0 + u * (1.0 / 10.0)) + u2 * (1.0 / 11.0)
    return -u * (low + u4 * (middle + u4 * high))


@fused
def fast_exp(x):
    """exp(x), by a series where x is near 0."""
    if not abs(x) < 0.06:
        return math.exp(x)
    x2 = x * x
    x4 = x2 * x2
    low = (1.0 + x) + x2 * (1.0 / 2.0 + x * (1.0 / 6.0))
    high = (1.0 / 24.0 + x * (1.0 / 120.0)) + x2 * (1.0 / 720.0 + x * (1.0 / 5040.0))
    return low + x4 * (high + x4 * (1.0 / 40320.0))


@inlined
def times_power(t, passed, s, log_passed, passed_at):
    """
    t passed ** s, without the power where s is saturated; log(passed) once it is known.

    `passed_at` is the address of `passed`, else LLVM would compute the logarithm every time.
    """
    if s == 1.0:
        return t * passed, log_passed
    if s == -1.0:
        return t / passed, log_passed
    if not passed > 0.0:
        return t * passed**s, log_passed
    if log_passed == 0.0:
        log_passed = fast_log(floats(passed_at)[0])
    return t * fast_exp(s * log_passed), log_passed


@inlined
def size_of(x, y):
    """Size of a bend [rad]; no root where it is along x."""
    return abs(x) if y == 0.0 else math.sqrt(x * x + y * y)


@inlined
def base_tensions(chain, inputs, work, moment_arms):
    """Tensions of the first cell, their moment (x, y) [N·m] and sum [N]."""
    tensions, tendon = floats(work.tensions), words(chain.tendon)
    mx, my, total = 0.0, 0.0, 0.0
    for k in range(chain.k):
        t = stages.actuation(floats(inputs)[tendon[2 * k + 1]], chain, k)
        tensions[k] = t
        mx += t * floats(moment_arms)[2 * k]
        my += t * floats(moment_arms)[2 * k + 1]
        total += t
    return mx, my, total


@compiled
def active_stages(chain, shaped):
    """Which act: friction, straight tendons, wrap, travel, memory; `shaped`: a guess counts."""
    return (
        stages.eyelet_acts(chain),
        shaped and follows_shape(chain),
        shaped and stages.wrap_acts(chain),
        shaped and stages.friction_travel_acts(chain),
        stages.memory_acts(chain),
    )


@inlined
def sine_between(bx, by, ahead_x, ahead_y):
    """S, see `cells`, of the mean of a bend and of one that bends more by (ahead_x, ahead_y)."""
    x, y = bx + 0.5 * ahead_x, by + 0.5 * ahead_y
    return half_turn(x * x + y * y)[0]


@inlined
def passed_ratio(chain, i, bx, by, ahead_x, ahead_y, sine, sine_mean, flags):
    """
    Tension behind the eyelet of cell i over that before it, for a tendon that slides.

    Parameters
    ----------
    bx, by, ahead_x, ahead_y : float
        Bend of that cell, and by how much the next one bends more [rad].
    sine, sine_mean : float
        S, see `cells`, of that bend, and `sine_between`, where it wraps [1/rad].
    flags : tuple of bool
        `active_stages`.

    """
    friction, _, wraps, _, _ = flags
    if not friction:
        return 1.0
    turning = size_of(bx, by) * sine
    if wraps:
        mean = size_of(bx + 0.5 * ahead_x, by + 0.5 * ahead_y) * sine_mean
        turning = stages.wrap(turning, mean, chain, i)
    return stages.eyelet(1.0, turning, chain, i)


@inlined
def ratio_at(chain, work, i, bx, by, ahead_x, ahead_y, flags):
    """Return `passed_ratio` at these bends; work.half holds the half angle of cell i."""
    sine_mean = sine_between(bx, by, ahead_x, ahead_y) if flags[2] else 0.0
    sine = floats(work.half)[2 * i]
    return passed_ratio(chain, i, bx, by, ahead_x, ahead_y, sine, sine_mean, flags)


@inlined
def pass_eyelet(chain, work, past, i, bx, by, passed, slip_rate, moment_arms, scale, flags):
    """
    Take the tensions over the eyelet between cells i and i + 1 (eq. 10).

    Returns moment (x, y) [N·m] and sum [N] of the next cell.

    Parameters
    ----------
    i : int
        The cell before the eyelet.
    bx, by : float
        Its bend [rad].
    passed, slip_rate : float
        `passed_ratio` [1]; one over the smoothing length [1/m].
    moment_arms : address
        (n, k, 2) [m], see `moment_arms_of`.
    scale : float
        Factor on the tendon offsets, from which travel follows [1].
    flags : tuple of bool
        `active_stages`.

    """
    friction, straight, _, slides, remembers = flags
    tensions, tendon, at = floats(work.tensions), words(chain.tendon), chain.k * i
    x0, y0, log_passed, passed_at = 0.0, 0.0, 0.0, work.passed + 8 * i
    floats(passed_at)[0] = passed
    last, last_sign = -1.0, 0.0  # kept, because tendons on opposite sides travel alike
    if friction:
        x0, y0 = stages.rest(0.0, 0.0, chain, i)
        x0, y0 = scale * (bx - x0), scale * (by - y0)
    offsets, lever = floats(chain.offset), floats(moment_arms)
    mx, my, total = 0.0, 0.0, 0.0
    for k in range(chain.k):
        j = at + chain.k + k
        t = 0.0
        if i + 1 < tendon[2 * k]:
            t = tensions[at + k]
            if friction:
                if straight:
                    travel = floats(work.travel)[at + k]
                else:
                    travel = offsets[2 * (at + k)] * x0 + offsets[2 * (at + k) + 1] * y0
                if slides or remembers:
                    s, _ = slip_direction(
                        chain, work, past, at + k, i, travel, slip_rate, slides, remembers
                    )
                else:
                    if abs(travel) != last:
                        last = abs(travel)
                        last_sign = smooth_sign(last, slip_rate)
                    s = math.copysign(last_sign, travel)
                t, log_passed = times_power(t, passed, s, log_passed, passed_at)
            mx += t * lever[2 * j]
            my += t * lever[2 * j + 1]
            total += t
        tensions[j] = t
    return mx, my, total


@compiled
def axial_moment_on(chain, work, i, loads):
    """Moment [N·m] of the tendons and, with `loads`, of these on cell i about its own axis."""
    about, at = 0.0, chain.k * i
    for k in range(chain.k):
        if i < words(chain.tendon)[2 * k]:
            about += floats(work.tensions)[at + k] * floats(work.axial)[at + k]
    return about + floats(work.torque)[i] if loads else about


@entry()
def step(chain, inputs, guess, work, past, out):
    """
    One sweep: state [rad] into `out`, work.tensions (n, k) [N] for input tensions (m,) [N].

    Moment arms, loads, travel beyond and the neighbour's bend are those of the guess (`prepare`);
    all else is new, so that without implicit effects the result is exact after one sweep. With the
    setting `SHAPED` 0 it goes as if no effect needed the shape. work.half becomes that of the new
    bends.

    Parameters
    ----------
    inputs, guess : address
        (m,) [N]; state [rad].
    out : address
        Takes the state [rad]; may be that of the guess.

    """
    shaped = floats(work.settings)[layout.SHAPED] != 0.0
    if shaped and is_implicit(chain):
        chain.prepare(chain, inputs, guess, work, past, out)
    load, bends, guesses, half = floats(work.load), floats(out), floats(guess), floats(work.half)
    flags = active_stages(chain, shaped)
    loads, linear, slip_rate = shaped and loaded(chain), is_linear(chain), slip_rate_in(work)
    friction_scale = stages.offset_scale(1.0, chain, 0)
    moment_arms, scale = chain.offset, friction_scale
    if flags[1]:
        moment_arms, scale = work.moment_arms, 1.0
    mx, my, total = base_tensions(chain, inputs, work, moment_arms)
    for i in range(chain.n):
        load_x, load_y = 0.0, 0.0
        if loads:  # else the scratch may still hold those of another model
            load_x, load_y = load[2 * i], load[2 * i + 1]
        last_x, last_y = guesses[2 * i], guesses[2 * i + 1]
        if linear:
            bx, by = bend_linear(chain, work, i, mx, my, load_x, load_y, scale)
        else:
            x, y = scale * mx + load_x, scale * my + load_y
            bx, by = bend_cell(chain, past, i, x, y, total, last_x, last_y)
        bends[2 * i], bends[2 * i + 1] = bx, by
        s, c = half_turn(bx * bx + by * by)
        if i + 1 < chain.n:
            # what this cell moved from its guess, its neighbour will have moved, too
            ahead_x, ahead_y = guesses[2 * i + 2] - last_x, guesses[2 * i + 3] - last_y
            sine, sine_mean = s, 0.0
            if flags[2]:  # S of the guess: it hardly changes, and no cell waits for it
                sine, sine_mean = half[2 * i], sine_between(last_x, last_y, ahead_x, ahead_y)
            passed = passed_ratio(chain, i, bx, by, ahead_x, ahead_y, sine, sine_mean, flags)
            mx, my, total = pass_eyelet(
                chain, work, past, i, bx, by, passed, slip_rate, moment_arms, friction_scale, flags
            )
        half[2 * i], half[2 * i + 1] = s, c
    if stages.torsion_acts(chain):
        for i in range(chain.n):  # as if no effect needed the shape no tendon leans
            about = axial_moment_on(chain, work, i, loads) if shaped else 0.0
            floats(out)[2 * chain.n + i] = twist_of(chain, i, about)


@compiled
def moment_on(chain, work, i, moment_arms, scale, loads):
    """
    Moment (x, y) [N·m] on cell i and the sum of the tensions [N] in it.

    Of the tendons, whose moment arms [m] at an address count `scale` times, and with `loads` of
    these.
    """
    tensions, lever, tendon = floats(work.tensions), floats(moment_arms), words(chain.tendon)
    mx, my, total = 0.0, 0.0, 0.0
    for k in range(chain.k):
        if i < tendon[2 * k]:
            at = chain.k * i + k
            t = tensions[at]
            mx += t * lever[2 * at]
            my += t * lever[2 * at + 1]
            total += t
    mx, my = scale * mx, scale * my
    if loads:
        mx += floats(work.load)[2 * i]
        my += floats(work.load)[2 * i + 1]
    return mx, my, total


@compiled
def moment_arms_of(chain, work):
    """Address of the tendons' moment arms (n, k, 2) [m], and the factor on them [1]."""
    if follows_shape(chain):
        return work.moment_arms, 1.0
    return chain.offset, stages.offset_scale(1.0, chain, 0)


@entry()
def place_travel(chain, bend, work):
    """Fill work with what the tendons travel at a state, and with their moment arms."""
    half_turns(chain, bend, work)
    if stages.eyelet_acts(chain) or follows_shape(chain):
        tendon_travel(chain, bend, stages.offset_scale(1.0, chain, 0), work)
    if stages.eyelet_acts(chain) and stages.friction_travel_acts(chain):
        travel_beyond(chain, work)


@compiled
def place_loads(chain, bend, work, past):
    """Fill work with frames and the moments of the loads at a state, after the posture `past`."""
    chain_frames(chain, bend, work)
    if stages.push_acts(chain):
        copy(past.held, work.held, 6 * chain.n)
    chain.load_moments(chain, bend, work)


@entry()
def balance(chain, inputs, bend, work, past, out):
    """
    Fill `out` [rad]: the state minus what its moments ask for; and work with forces.

    Travel and moment arms, which work holds, are those of the state.
    """
    bends, f, rate = floats(bend), floats(out), slip_rate_in(work)
    moment_arms, scale = moment_arms_of(chain, work)
    friction, _, wraps, slides, remembers = active_stages(chain, layout.YES)
    flags = (friction, layout.YES, wraps, slides, remembers)  # travel is that of these bends
    base_tensions(chain, inputs, work, moment_arms)
    for i in range(chain.n - 1):
        x, y = bends[2 * i], bends[2 * i + 1]
        ahead_x, ahead_y = bends[2 * i + 2] - x, bends[2 * i + 3] - y
        passed = ratio_at(chain, work, i, x, y, ahead_x, ahead_y, flags)
        pass_eyelet(chain, work, past, i, x, y, passed, rate, moment_arms, scale, flags)
    loads = loaded(chain)
    if loads:
        scale_lengths(chain, work)
        place_loads(chain, bend, work, past)
    for i in range(chain.n):
        mx, my, total = moment_on(chain, work, i, moment_arms, scale, loads)
        x, y = bends[2 * i], bends[2 * i + 1]
        bx, by = bend_cell(chain, past, i, mx, my, total, x, y)
        f[2 * i], f[2 * i + 1] = x - bx, y - by
    if stages.torsion_acts(chain):
        for j in range(chain.n):
            about = axial_moment_on(chain, work, j, loads)
            f[2 * chain.n + j] = bends[2 * chain.n + j] - twist_of(chain, j, about)


@entry()
def residual(chain, inputs, bend, work, past, out):
    """Fill `out` [rad], the residual at a state, and work with all that the state gives."""
    chain.place_travel(chain, bend, work)
    chain.balance(chain, inputs, bend, work, past, out)


@entry()
def prepare(chain, inputs, guess, work, past, out):
    """Fill moment arms, travel, travel beyond and load moments at a guess; `out` is scratch."""
    if loaded(chain) and stages.length_acts(chain):  # lengths follow the tensions there
        chain.residual(chain, inputs, guess, work, past, out)
        return
    friction, straight, wraps, slides, _ = active_stages(chain, layout.YES)
    slides = friction and slides
    if straight or wraps or loaded(chain):
        half_turns(chain, guess, work)
    if straight or slides:
        tendon_travel(chain, guess, stages.offset_scale(1.0, chain, 0), work)
    if slides:
        travel_beyond(chain, work)
    if loaded(chain):
        place_loads(chain, guess, work, past)
