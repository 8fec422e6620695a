"""Moments of the loads on an arm that bends in one plane, x and z: angles instead of frames."""

from .cells import ARC_SERIES_BELOW, arc_factor, end_of, gentle_arc, halved
from .layout import HINGE, PLACE, cell, compiled, contracted, entry, floats
from .loads import bow_compliance, bows, force_at_tip, weight


@compiled
def lies_flat(chain, bend, work):
    """Tell whether bends and loads lie in that plane, and loads do no more than bend."""
    if floats(work.slip)[4] == 0.0:
        return False
    for i in range(chain.n):
        if floats(bend)[2 * i + 1] != 0.0:
            return False
    return True


@contracted
def across_and_along(c, s, force):
    """Components (x, z) of a force (3,) in a frame that is turned by an angle of cosine c."""
    return c * force[0] - s * force[2], s * force[0] + c * force[2]


@contracted
def flat_moment(x, s, c, factors, force, own, reach, hinge, bow):
    """
    Moment on one bend of a force at the cell's end and of its own weight, as `loads.cell_moment`.

    All (x, z), in the frame that bends. Also returns where the weight lies [m], and how far the
    cell's end bows [m].

    Parameters
    ----------
    x : float
        Bend a [rad].
    s, c : float
        sin(a / 2) / a [1/rad] and cos(a / 2), see `cells`.
    factors : tuple of float
        What `fill_factors` says of an arc.
    force, own : tuple of float
        Of everything beyond, at the cell's end, and the cell's weight: (2,) [N].
    reach, hinge : float
        Length of the cell [m]; whether it is a hinge.
    bow : float
        `loads.bow_compliance` [m/N].

    """
    half, sinc, versine = 0.5 * reach, 2.0 * s * c, 2.0 * s * s
    if hinge > 0.5:
        moment = half * ((1.0 - versine * x * x) * force[0] - sinc * x * force[1])
        return moment, (0.0, half), (0.0, 0.0)
    s2, c2, whole, part = factors
    moment = reach * ((sinc - versine) * force[0] - whole * x * force[1])
    moment += 0.5 * half * (2.0 * s2 * (c2 - s2) * own[0] - 0.5 * part * x * own[1])
    beyond = (force[0] + 0.5 * own[0], force[1] + 0.5 * own[1])
    along, across = s * x * beyond[0] + c * beyond[1], c * beyond[0] - s * x * beyond[1]
    moment -= 0.5 * bow * along * across
    over = (bow * across * c, -bow * across * s * x)
    return moment, (half * s2 * s2 * x + 0.5 * over[0], reach * s + 0.5 * over[1]), over


@entry(PLACE)
def flat_moments(chain, bend, work):
    """
    Fill work.load (n, 2) [N·m] as `loads.load_moments` does, of an arm that lies flat.

    work.half is that of these bends. Frames are left alone, work.wrench is scratch.
    """
    bends, half, moments = floats(bend), floats(work.half), floats(work.load)
    turn_along(chain, bends, half, moments)
    if bows(chain):
        fill_factors(chain, bends, half, work.wrench)
    factors, n = floats(work.wrench), chain.n
    scale, tip, torque = floats(work.slip)[1], force_at_tip(chain), 0.0
    total = (scale * tip[0], 0.0, scale * tip[2])
    for i in range(n - 1, -1, -1):
        x, s, c, reach = bends[2 * i], half[2 * i], half[2 * i + 1], floats(work.lengths)[i]
        own, hinge = weight(chain, i), cell(chain, i, HINGE)
        own = (scale * own[0], 0.0, scale * own[2])
        here = across_and_along(moments[2 * i], moments[2 * i + 1], own)
        force = across_and_along(moments[2 * i], moments[2 * i + 1], total)
        arc, bow = (factors[i], factors[n + i], factors[2 * n + i], factors[3 * n + i]), 0.0
        if not hinge > 0.5:
            bow = bow_compliance(chain, work, i)
        moment, middle, over = flat_moment(x, s, c, arc, force, here, reach, hinge, bow)
        moments[2 * i], moments[2 * i + 1] = torque + moment, 0.0
        across, along = end_of(x * x, s, c, reach, hinge)
        torque += (along + over[1]) * force[0] - (across * x + over[0]) * force[1]
        torque += middle[1] * here[0] - middle[0] * here[1]
        total = (total[0] + own[0], 0.0, total[2] + own[2])


@contracted
def fill_factors(chain, bends, half, factors):
    """
    Fill S and C of half the bend, and `arc_factor` of the whole and of half of it: (4, n).

    In a loop without a branch, so that several cells are computed at once.
    """
    n, far = chain.n, 0
    s2, c2 = floats(factors), floats(factors + 8 * n)
    whole, part = floats(factors + 16 * n), floats(factors + 24 * n)
    for i in range(n):
        q = bends[2 * i] * bends[2 * i]
        s2[i], c2[i] = halved(half[2 * i], half[2 * i + 1])
        whole[i], part[i] = gentle_arc(q), gentle_arc(0.25 * q)
        far += 0 if q < ARC_SERIES_BELOW else 1
    for i in range(n if far > 0 else 0):
        q = bends[2 * i] * bends[2 * i]
        whole[i] = arc_factor(q, half[2 * i], half[2 * i + 1])
        part[i] = arc_factor(0.25 * q, s2[i], c2[i])


@contracted
def turn_along(chain, bends, half, turns):
    """Fill turns (n, 2): cosine and sine of the angle by which the start of a cell is turned."""
    cosine, sine = 1.0, 0.0
    for i in range(chain.n):
        turns[2 * i], turns[2 * i + 1] = cosine, sine
        x, s, c = bends[2 * i], half[2 * i], half[2 * i + 1]
        across, along = 2.0 * s * c * x, 1.0 - 2.0 * s * s * x * x
        cosine, sine = cosine * along - sine * across, sine * along + cosine * across
