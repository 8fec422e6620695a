"""
What a state asks for: the residual of the equilibrium, and what a sweep takes from its guess.

The residual is the bends minus those that their own moments ask for. Tensions, moment arms, travel
and loads are all those of the bends given. (A `sweep` goes on with what it has just found, which
settles faster, but ties every cell to all before it.)
"""

from .cells import bend_cell, chain_frames, follows_shape, half_turns, twist_of
from .flat import lies_flat
from .geometry import scale_lengths, tendon_travel, travel_beyond
from .layout import (
    PLACE,
    STEP,
    YES,
    balance_at,
    compiled,
    entry,
    flat_moments_at,
    floats,
    load_moments_at,
    place_travel_at,
    residual_at,
    words,
)
from .loads import loaded
from .stages import eyelet_acts, friction_travel_acts, length_acts, offset_scale, torsion_acts
from .sweep import active_stages, carry_tensions, tendons_about


@compiled
def tendon_moment(chain, work, i, moment_arms, scale):
    """Moment (x, y) [N·m] of the tendons on cell i and the sum of their tensions [N]."""
    tensions, lever, tendon = floats(work.tensions), floats(moment_arms), words(chain.tendon)
    mx, my, total = 0.0, 0.0, 0.0
    for k in range(chain.k):
        if i < tendon[2 * k]:
            at = chain.k * i + k
            t = tensions[at]
            mx += t * lever[2 * at]
            my += t * lever[2 * at + 1]
            total += t
    return scale * mx, scale * my, total


@compiled
def moment_arms_of(chain, work):
    """Address of the tendons' moment arms (n, k, 2) [m], and the factor on them [1]."""
    if follows_shape(chain):
        return work.moment_arms, 1.0
    return chain.offset, offset_scale(1.0, chain, 0)


@entry(PLACE)
def place_travel(chain, bend, work):
    """Fill work with what the tendons travel at a state, and with their moment arms."""
    half_turns(chain, bend, work)
    if eyelet_acts(chain) or follows_shape(chain):
        tendon_travel(chain, bend, offset_scale(1.0, chain, 0), work)
    if eyelet_acts(chain) and friction_travel_acts(chain):
        travel_beyond(chain, work)


@compiled
def place_forces(chain, inputs, bend, work, past):
    """Fill work with tensions, frames and loads at a state; travel and moment arms are known."""
    friction, _, wraps, slides, remembers = active_stages(chain, YES)
    moment_arms, scale = moment_arms_of(chain, work)
    flags = (friction, YES, wraps, slides, remembers)  # travel is that of these bends
    carry_tensions(chain, inputs, bend, work, past, flags, moment_arms, scale)
    if loaded(chain):
        scale_lengths(chain, work)
        chain_frames(chain, bend, work)
        load_moments_at(chain.load_moments)(chain, bend, work)


@compiled
def imbalance(chain, bend, work, past, out):
    """Fill `out` [rad]: the state minus what its moments, known to `work`, ask for."""
    bends, load, f = floats(bend), floats(work.load), floats(out)
    moment_arms, scale = moment_arms_of(chain, work)
    loads = loaded(chain)
    for i in range(chain.n):
        mx, my, total = tendon_moment(chain, work, i, moment_arms, scale)
        if loads:
            mx += load[2 * i]
            my += load[2 * i + 1]
        bx, by = bend_cell(chain, past, i, mx, my, total)
        f[2 * i] = bends[2 * i] - bx
        f[2 * i + 1] = bends[2 * i + 1] - by
    if torsion_acts(chain):
        for j in range(chain.n):
            about = tendons_about(chain, work, j)
            if loads:
                about += floats(work.torque)[j]
            f[2 * chain.n + j] = bends[2 * chain.n + j] - twist_of(chain, j, about)


@entry(STEP)
def balance(chain, inputs, bend, work, past, out):
    """Fill `out` [rad], the residual at a state whose travel is known, and work with forces."""
    place_forces(chain, inputs, bend, work, past)
    imbalance(chain, bend, work, past, out)


@entry(STEP)
def residual(chain, inputs, bend, work, past, out):
    """Fill `out` [rad], the residual at a state, and work with all that the state gives."""
    place_travel_at(chain.place_travel)(chain, bend, work)
    balance_at(chain.balance)(chain, inputs, bend, work, past, out)


@entry(STEP)
def prepare(chain, inputs, guess, work, past, out):
    """Fill moment arms, travel, travel beyond and load moments at a guess; `out` is scratch."""
    if loaded(chain) and length_acts(chain):  # lengths follow the tensions there
        residual_at(chain.residual)(chain, inputs, guess, work, past, out)
        return
    friction, straight, wraps, slides, _ = active_stages(chain, YES)
    slides = friction and slides
    if straight or wraps or loaded(chain):
        half_turns(chain, guess, work)
    if straight or slides:
        tendon_travel(chain, guess, offset_scale(1.0, chain, 0), work)
    if slides:
        travel_beyond(chain, work)
    if loaded(chain):
        if lies_flat(chain, guess, work):
            flat_moments_at(chain.flat_moments)(chain, guess, work)
        else:
            chain_frames(chain, guess, work)
            load_moments_at(chain.load_moments)(chain, guess, work)
