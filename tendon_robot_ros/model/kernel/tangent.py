"""
Derivatives of every cell's own laws: what the elimination of the chain is made of.

The residual of cell i depends on its own bend, on the tensions in it, on how the frame that it
starts from is turned, and on the torque of the loads beyond it. What it passes on, tensions and
turning towards the tip, travel and torque towards the base, depends on the same. The composed
laws are differentiated as they stand, by central differences of scalars.
"""

import math

from .cells import (
    bend_cell,
    cell_stiffness,
    follows_shape,
    half_turn,
    is_linear,
    leans,
    twist_in,
    twist_of,
)
from .geometry import moment_of_leaning, moment_of_tendons
from .layout import (
    BEFORE,
    BY_TENSION,
    BY_TORQUE,
    BY_TURN,
    HERE,
    LAGS,
    LEANING_SLOPES,
    OWN,
    PASSED,
    SIZE,
    SLIDES,
    TENDON,
    TRAVELS,
    YES,
    compiled,
    entry,
    floats,
    inlined,
    leaning_slopes_at,
    load_slopes_at,
    remembered_at,
    section_of,
    tangent_of,
    words,
)
from .load_tangent import BEND_STEP, TENSION_STEP, difference
from .loads import loaded, plus, scaled
from .residual import moment_arms_of, tendon_moment
from .stages import (
    eyelet,
    friction_travel,
    offset_scale,
    torsion_acts,
    wrap,
)
from .sweep import active_stages, smooth_sign, tendons_about

MOMENT_STEP = 1e-6  # [rad] over a cell's compliance
# of a step that meets a kink; how much of a difference its halves may differ by elsewhere [1]
NARROWINGS_MAX, NARROWING, UNEVEN_SHARE = 3, 1e-3, 1e-3
SINE_STEP = 1e-6  # [1]
TRAVEL_STEP = 1e-9  # [m]
SLIDING_FROM = 1.0 - 1e-9  # [1] square of a direction of friction that no more travel changes


@compiled
def bend_slope(chain, past, i, moment, toward, x, y):
    """
    Differentiate a cell's bend (x, y) along a step of what bends it.

    Friction in a hinge and laws alike have kinks: over one a difference is the slope of neither
    side, and Newton stalls beside it. So the step narrows until both its halves say the same.

    Parameters
    ----------
    moment : tuple of float
        Moment x and y [N·m] and sum of the tensions [N] on the cell.
    toward : tuple of float
        Step of them.
    x, y : float
        Bend there [rad].

    """
    zoom = 1.0
    for _ in range(NARROWINGS_MAX):
        up, down = plus(moment, scaled(zoom, toward)), plus(moment, scaled(-zoom, toward))
        ax, ay = bend_cell(chain, past, i, *up)
        bx, by = bend_cell(chain, past, i, *down)
        uneven = abs(ax + bx - 2.0 * x) + abs(ay + by - 2.0 * y)
        if not uneven > UNEVEN_SHARE * (abs(ax - bx) + abs(ay - by)):
            break
        zoom *= NARROWING
    return (ax - bx) / zoom, (ay - by) / zoom


@compiled
def compliances(chain, past, i, mx, my, total):
    """Differentiate a cell's bend (x, y) by moment x and y [rad/(N·m)] and tension [rad/N]."""
    stiffness = cell_stiffness(chain, i, section_of(chain, i))
    if is_linear(chain):
        return 1.0 / stiffness, 0.0, 0.0, 1.0 / stiffness, 0.0, 0.0
    h, ht, moment = MOMENT_STEP * stiffness, TENSION_STEP * (total + 0.01), (mx, my, total)
    x, y = bend_cell(chain, past, i, mx, my, total)
    a, b = bend_slope(chain, past, i, moment, (h, 0.0, 0.0), x, y)
    c, d = bend_slope(chain, past, i, moment, (0.0, h, 0.0), x, y)
    e, f = bend_slope(chain, past, i, moment, (0.0, 0.0, ht), x, y)
    h, ht = 0.5 / h, 0.5 / ht
    return a * h, b * h, c * h, d * h, e * ht, f * ht


@compiled
def twist_compliance(chain, i, about):
    """Differentiate a cell's twist by the moment about its axis [rad/(N·m)]."""
    h = MOMENT_STEP * cell_stiffness(chain, i, section_of(chain, i))
    return (twist_of(chain, i, about + h) - twist_of(chain, i, about - h)) / (2.0 * h)


@compiled
def moment_arm_slopes(chain, work, i, x, y, scale):
    """Differentiate the tendons' moment by the bend, tensions held: (xx, xy, yy) [N·m/rad]."""
    if not follows_shape(chain):
        return 0.0, 0.0, 0.0
    h, tensions = BEND_STEP, work.tensions + 8 * chain.k * i
    ax, ay = moment_of_tendons(chain, i, x + h, y, tensions, scale)
    bx, by = moment_of_tendons(chain, i, x - h, y, tensions, scale)
    _, cy = moment_of_tendons(chain, i, x, y + h, tensions, scale)
    _, dy = moment_of_tendons(chain, i, x, y - h, tensions, scale)
    return (ax - bx) / (2.0 * h), (ay - by) / (2.0 * h), (cy - dy) / (2.0 * h)


@entry(LEANING_SLOPES)
def leaning_slopes(chain, work, i, x, y, twist, scale, tangent):
    """Fill how the moment of leaning tendons follows x, y and twist [N·m/rad], into OWN."""
    h, tensions, row = BEND_STEP, work.tensions + 8 * chain.k * i, floats(tangent)
    for a in range(3):
        dx, dy, dz = h if a == 0 else 0.0, h if a == 1 else 0.0, h if a == 2 else 0.0
        up = moment_of_leaning(chain, i, x + dx, y + dy, twist + dz, tensions, scale)
        low = moment_of_leaning(chain, i, x - dx, y - dy, twist - dz, tensions, scale)
        by = difference(h, up, low)
        row[OWN + a], row[OWN + 3 + a], row[OWN + 6 + a] = by


@inlined
def slip_slopes(chain, work, past, at, section, here, slides, remembers):
    """
    Direction of friction at an eyelet, and its derivatives by travel here and beyond [1/m].

    Parameters
    ----------
    at : int
        Entry chain.k i + k of the arrays (n, k).
    here : float
        Travel of the tendon in cell i [m].
    slides, remembers : bool
        Whether the travel beyond counts, and whether friction remembers.

    """
    beyond = floats(work.beyond)[at] if slides else 0.0
    h = TRAVEL_STEP
    by_here, by_beyond = 1.0, 0.0
    if remembers:
        sign, last = floats(past.sign)[at], floats(past.travel)[at]
        if slides:
            by_here = friction_travel(here + h, beyond, chain, section)
            by_here = (by_here - friction_travel(here - h, beyond, chain, section)) / (2.0 * h)
            by_beyond = friction_travel(here, beyond + h, chain, section)
            by_beyond = (by_beyond - friction_travel(here, beyond - h, chain, section)) / (2.0 * h)
            here = friction_travel(here, beyond, chain, section)
        law = remembered_at(chain.remembered)
        s = law(chain, sign, here - last, section)
        rate = law(chain, sign, here - last + h, section)
        rate = (rate - law(chain, sign, here - last - h, section)) / (2.0 * h)
        return s, by_here * rate, by_beyond * rate
    rate = 1.0 / floats(work.slip)[0]
    s = smooth_sign(here, rate)
    by_here = rate * (1.0 - s * s)
    if slides:
        t, h = smooth_sign(beyond, rate), SINE_STEP
        share = friction_travel(s + h, t, chain, section)
        by_here *= (share - friction_travel(s - h, t, chain, section)) / (2.0 * h)
        share = friction_travel(s, t + h, chain, section)
        share = (share - friction_travel(s, t - h, chain, section)) / (2.0 * h)
        by_beyond = rate * (1.0 - t * t) * share if t * t < SLIDING_FROM else 0.0
        s = friction_travel(s, t, chain, section)
    return s, by_here, by_beyond


@compiled
def turning_slopes(chain, i, bx, by, next_x, next_y, wraps):
    """
    Return what passes the eyelet behind cell i, its derivatives by the bends on both sides.

    Parameters
    ----------
    bx, by, next_x, next_y : float
        Bends of the cells on both sides [rad].
    wraps : bool
        Whether the mean of both bends turns the tendon.

    """
    section, h = section_of(chain, i), SINE_STEP
    q = bx * bx + by * by
    s, c = half_turn(q)
    a = math.sqrt(q)
    turning, slope = a * s, 0.5 * c / max(a, 1e-300)
    ox, oy, nx, ny = slope * bx, slope * by, 0.0, 0.0
    if wraps:
        x, y = 0.5 * (bx + next_x), 0.5 * (by + next_y)
        q = x * x + y * y
        s, c = half_turn(q)
        a = math.sqrt(q)
        mean, slope = a * s, 0.25 * c / max(a, 1e-300)
        own = wrap(turning + h, mean, chain, section) - wrap(turning - h, mean, chain, section)
        share = wrap(turning, mean + h, chain, section) - wrap(turning, mean - h, chain, section)
        slope *= share / (2.0 * h)
        nx, ny = slope * x, slope * y
        own /= 2.0 * h
        ox, oy = own * ox + nx, own * oy + ny
        turning = wrap(turning, mean, chain, section)
    passed, low = eyelet(1.0, turning, chain, section), max(turning - h, 0.0)
    slope = eyelet(1.0, turning + h, chain, section) - eyelet(1.0, low, chain, section)
    slope /= turning + h - low
    return passed, slope * ox, slope * oy, slope * nx, slope * ny


@compiled
def eyelet_slopes(chain, bend, work, past, i, flags, tangent):
    """
    Fill what the tensions of cell i + 1 depend on: those of cell i, both bends, the travel.

    Parameters
    ----------
    bend : address
        State [rad].
    flags : tuple of bool
        `sweep.active_stages`.
    tangent : address
        Derivatives of all cells.

    """
    _, _, wraps, slides, remembers = flags
    bends, tendon, section = floats(bend), words(chain.tendon), section_of(chain, i)
    bx, by, next_x, next_y = bends[2 * i], bends[2 * i + 1], bends[2 * i + 2], bends[2 * i + 3]
    passed, ox, oy, nx, ny = turning_slopes(chain, i, bx, by, next_x, next_y, wraps)
    log_passed = math.log(max(passed, 1e-300))
    before = tangent_of(chain, tangent, i) + 8 * SIZE
    behind = tangent_of(chain, tangent, i + 1) + 8 * SIZE
    for k in range(chain.k):
        if i + 1 >= tendon[2 * k]:
            continue
        at = chain.k * i + k
        here = floats(work.travel)[at]
        s, by_here, by_beyond = slip_slopes(
            chain, work, past, at, section, here, slides, remembers
        )
        row, travels = floats(behind + 8 * TENDON * k), floats(before + 8 * (TENDON * k + TRAVELS))
        ratio = math.exp(s * log_passed)
        t = floats(work.tensions)[at] * ratio
        share, by_here = t * s / passed, t * log_passed * by_here
        row[PASSED] = ratio
        row[BEFORE] = share * ox + by_here * travels[0]
        row[BEFORE + 1] = share * oy + by_here * travels[1]
        row[BEFORE + 2] = by_here * travels[2]
        row[HERE], row[HERE + 1] = share * nx, share * ny
        row[SLIDES] = t * log_passed * by_beyond
        lag = floats(work.lag)
        row[LAGS] = by_here * lag[at] + row[SLIDES] * lag[at + chain.n * chain.k]


@compiled
def tendon_slopes(chain, bend, work, i, tangent):
    """Fill how the tendons' moment follows bend and twist of cell i, tensions held, into OWN."""
    x, y, scale = floats(bend)[2 * i], floats(bend)[2 * i + 1], offset_scale(1.0, chain, 0)
    row = floats(tangent)
    if leans(chain):
        twist = twist_in(chain, bend, i)
        leaning_slopes_at(chain.leaning_slopes)(chain, work, i, x, y, twist, scale, tangent)
    else:
        xx, xy, yy = moment_arm_slopes(chain, work, i, x, y, scale)
        row[OWN], row[OWN + 1], row[OWN + 3], row[OWN + 4] = xx, xy, xy, yy


@compiled
def cell_slopes(chain, bend, work, past, i, moment_arms, scale, tangent):
    """
    Fill the derivatives of the residual of cell i.

    Those of the moment come first, in the same places; then they meet the compliance.

    Parameters
    ----------
    bend : address
        State [rad].
    moment_arms, scale : address, float
        (n, k, 2) [m], and the factor on them [1].
    tangent : address
        Derivatives of this cell, SIZE + TENDON k floats that are zero.

    """
    row, loads = floats(tangent), loaded(chain)
    mx, my, total = tendon_moment(chain, work, i, moment_arms, scale)
    tendon_slopes(chain, bend, work, i, tangent)
    if loads:
        mx += floats(work.load)[2 * i]
        my += floats(work.load)[2 * i + 1]
        load_slopes_at(chain.load_slopes)(chain, bend, work, i, tangent, total)
    a, b, c, d, e, f = compliances(chain, past, i, mx, my, total)
    for q in range(9 if loads else 3):
        start = OWN + 9 * (q // 3) + q % 3  # of OWN, BY_TURN and BY_TORQUE
        u, v = row[start], row[start + 3]
        row[start], row[start + 3] = -(a * u + c * v), -(b * u + d * v)
    row[OWN] += 1.0
    row[OWN + 4] += 1.0
    lever, tendon = floats(moment_arms), words(chain.tendon)
    for k in range(chain.k):
        if i >= tendon[2 * k]:
            continue
        here, at = floats(tangent + 8 * (SIZE + TENDON * k)), 2 * (chain.k * i + k)
        u, v = scale * lever[at], scale * lever[at + 1]
        here[TRAVELS], here[TRAVELS + 1] = u, v
        u, v = u + here[BY_TENSION], v + here[BY_TENSION + 1]
        here[BY_TENSION], here[BY_TENSION + 1] = -(a * u + c * v + e), -(b * u + d * v + f)
    if torsion_acts(chain):
        fill_twist(chain, work, i, tangent, loads)


@compiled
def fill_twist(chain, work, i, tangent, loads):
    """Fill the derivatives of the residual of the twist of cell i, from those of its moment."""
    row, about = floats(tangent), tendons_about(chain, work, i)
    if loads:
        about += floats(work.torque)[i]
    yields = twist_compliance(chain, i, about)
    for b in range(3):
        row[OWN + 6 + b] *= -yields
        row[BY_TURN + 6 + b] *= -yields
        row[BY_TORQUE + 6 + b] *= -yields
    row[OWN + 8] += 1.0
    for k in range(chain.k):
        if i < words(chain.tendon)[2 * k]:
            here = floats(tangent + 8 * (SIZE + TENDON * k))
            here[TRAVELS + 2] = floats(work.axial)[chain.k * i + k]
            here[BY_TENSION + 2] = -yields * (here[TRAVELS + 2] + here[BY_TENSION + 2])


@compiled
def differentiate(chain, bend, work, past, tangent):
    """Fill the derivatives of all cells at bends (n, 2) whose states `work` holds."""
    moment_arms, scale = moment_arms_of(chain, work)
    flags = active_stages(chain, YES)
    for i in range(chain.n):
        cell_slopes(chain, bend, work, past, i, moment_arms, scale, tangent_of(chain, tangent, i))
    if flags[0]:
        for i in range(chain.n - 1):
            eyelet_slopes(chain, bend, work, past, i, flags, tangent)
