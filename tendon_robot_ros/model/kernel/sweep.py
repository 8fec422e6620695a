"""One sweep from base to tip: tensions, moments and bends (Kato et al. 2015, eq. 2, 8, 9, 10)."""

import math

from .bending import bend_cell
from .geometry import chain_frames, loaded, scale_lengths, tendon_travel
from .layout import STEP, compiled, entry, floats, section_of, words
from .loads import load_moments
from .stages import (
    actuation,
    arm_acts,
    eyelet,
    eyelet_acts,
    length_acts,
    memory,
    memory_acts,
    offset,
    rest,
    slide,
    slide_acts,
    wrap,
    wrap_acts,
)


@compiled
def is_implicit(chain):
    """Tell whether an effect acts that needs the shape: one sweep is then not the answer."""
    shaped = wrap_acts(chain) or slide_acts(chain) or memory_acts(chain)
    return arm_acts(chain) or loaded(chain) or (eyelet_acts(chain) and shaped)


@compiled
def smooth_sign(travel, slip_length):
    """tanh(travel / slip length): a tendon that does not slide has no friction."""
    x = travel / slip_length
    if x > 20.0:
        return 1.0
    if x < -20.0:
        return -1.0
    return math.tanh(x)


@compiled
def slip_direction(chain, work, past, i, k, here):
    """Direction s of friction on tendon k at the eyelet behind cell i, and what it travelled."""
    at, section = chain.k * i + k, section_of(chain, i)
    slides = slide_acts(chain)
    beyond = floats(work.beyond)[at] if slides else 0.0
    if memory_acts(chain):
        travel = slide(here, beyond, chain, section)
        return memory(
            0.0, floats(past.sign)[at], travel - floats(past.travel)[at], chain, section
        ), travel
    slip = floats(work.slip)[0]
    if slides:
        return slide(smooth_sign(here, slip), smooth_sign(beyond, slip), chain, section), beyond
    return smooth_sign(here, slip), here


@compiled
def power(passed, s, inverse):
    """Return passed ** s, without the power where s is saturated."""
    if s == 1.0:
        return passed
    if s == -1.0:
        return inverse
    return passed**s


@compiled
def pass_eyelet(chain, work, past, i, bx, by, next_x, next_y, scale):
    """Take the tensions over the eyelet between cells i and i + 1 (eq. 10)."""
    tensions, tendon, at = floats(work.tensions), words(chain.tendon), chain.k * i
    if not eyelet_acts(chain):
        for k in range(chain.k):
            ends = i + 1 >= tendon[2 * k]
            tensions[at + chain.k + k] = 0.0 if ends else tensions[at + k]
        return
    section = section_of(chain, i)
    turning = math.sin(0.5 * math.sqrt(bx * bx + by * by))
    if wrap_acts(chain):
        x, y = bx + next_x, by + next_y
        turning = wrap(turning, math.sin(0.25 * math.sqrt(x * x + y * y)), chain, section)
    passed = eyelet(1.0, turning, chain, section)
    inverse = 1.0 / passed
    straight = arm_acts(chain)
    x0, y0 = rest(0.0, 0.0, chain, section)
    arms = floats(chain.offset)
    for k in range(chain.k):
        if i + 1 >= tendon[2 * k]:
            tensions[at + chain.k + k] = 0.0
            continue
        if straight:
            here = floats(work.travel)[at + k]
        else:
            here = scale * (arms[2 * (at + k)] * (bx - x0) + arms[2 * (at + k) + 1] * (by - y0))
        s, _ = slip_direction(chain, work, past, i, k, here)
        tensions[at + chain.k + k] = tensions[at + k] * power(passed, s, inverse)


@compiled
def sweep(chain, inputs, guess, work, past, out):
    """
    Bends (n, 2) [rad] into `out` and work.tensions (n, k) [N] for input tensions (m,) [N].

    Arms, loads, travel beyond and the neighbour's bend are those of the guess (`prepare`); all
    else is new, so that without implicit effects the result is exact after one sweep.
    """
    tensions, tendon, offsets = floats(work.tensions), words(chain.tendon), floats(chain.offset)
    load, bends, guesses = floats(work.load), floats(out), floats(guess)
    scale = offset(1.0, chain, 0)
    straight, loads = arm_acts(chain), loaded(chain)
    if straight:
        offsets = floats(work.arms)
    for k in range(chain.k):
        tensions[k] = actuation(floats(inputs)[tendon[2 * k + 1]], chain, 0)
    for i in range(chain.n):
        mx, my, total = 0.0, 0.0, 0.0
        for k in range(chain.k):
            if i < tendon[2 * k]:
                at = chain.k * i + k
                t = tensions[at]
                total += t
                mx += t * offsets[2 * at]
                my += t * offsets[2 * at + 1]
        if not straight:
            mx, my = mx * scale, my * scale
        if loads:  # else the scratch may still hold those of another model
            mx, my = mx + load[2 * i], my + load[2 * i + 1]
        bx, by = bend_cell(chain, past, i, mx, my, total)
        last_x, last_y = guesses[2 * i], guesses[2 * i + 1]
        bends[2 * i], bends[2 * i + 1] = bx, by
        if i + 1 < chain.n:
            # what this cell moved from its guess, its neighbour will have moved, too
            pass_eyelet(
                chain,
                work,
                past,
                i,
                bx,
                by,
                guesses[2 * i + 2] + bx - last_x,
                guesses[2 * i + 3] + by - last_y,
                scale,
            )


@compiled
def prepare(chain, inputs, guess, work, past):
    """Fill the arms, travel, travel beyond, and load moments that a guess of the bends gives."""
    scale = offset(1.0, chain, 0)
    tendon = words(chain.tendon)
    if arm_acts(chain) or (eyelet_acts(chain) and slide_acts(chain)):
        tendon_travel(chain, guess, scale, work)
        for k in range(chain.k):
            beyond = 0.0
            for i in range(tendon[2 * k] - 1, -1, -1):
                at = chain.k * i + k
                floats(work.beyond)[at] = beyond
                beyond += floats(work.travel)[at]
    if loaded(chain):
        if length_acts(chain):
            guesses = floats(guess)
            for k in range(chain.k):
                floats(work.tensions)[k] = actuation(floats(inputs)[tendon[2 * k + 1]], chain, 0)
            for i in range(chain.n - 1):
                pass_eyelet(
                    chain,
                    work,
                    past,
                    i,
                    guesses[2 * i],
                    guesses[2 * i + 1],
                    guesses[2 * i + 2],
                    guesses[2 * i + 3],
                    scale,
                )
        scale_lengths(chain, work)
        chain_frames(chain, guess, work)
        load_moments(chain, guess, work)


@entry(STEP)
def step(chain, inputs, guess, work, past, out):
    """One sweep with everything that the guess decides."""
    prepare(chain, inputs, guess, work, past)
    sweep(chain, inputs, guess, work, past, out)
