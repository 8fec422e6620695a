"""Friction that remembers: from posture to posture, and the law by which it does."""

import numpy as np

from .geometry import tendon_travel, travel_beyond
from .layout import (
    BEND_TOLERANCE,
    RAMPED,
    REMEMBERED,
    YES,
    compiled,
    copy,
    entry,
    floats,
    memory_size,
    section_of,
    words,
)
from .shape import settle
from .stages import friction_travel_acts, memory, offset_scale
from .sweep import slip_direction
from .turning import unknowns


@entry(REMEMBERED)
def remembered(chain, sign, moved, section):
    """Direction of friction [1] that was `sign`, after a tendon moved on [m]."""
    return memory(0.0, sign, moved, chain, section)


@compiled
def remember(chain, inputs, bend, work, past, now):
    """Fill the friction memory `now` after a posture that came after `past`."""
    copy(bend, now.bend, unknowns(chain))
    copy(inputs, now.inputs, chain.m)
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


@entry(RAMPED)
def ramped(chain, inputs, work, past, now, bend, before):
    """
    Do what `shape.posture` does with friction memory, which it takes and returns.

    From the posture in `past`, in ever finer parts until the result stays.
    """
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
