"""
How a loaded cell bows: under a force across a rod the curvature changes along a cell.

The bend is the mean curvature of an arc. What is left is linear along the cell, turns neither of
its ends, and moves the far one across the tangent m in its middle: by B (F - (F m) m), with
B = L² / (12 K) and F the force of all beyond the middle. The loads' energy falls by
B (F² - (F m)²) / 2, and so there is a moment on the bend. A hinge does not bow.
"""

from .layout import HINGE, LENGTH, cell, compiled, contracted, floats
from .turning import arc_factor, halved


@compiled
def bows(chain):
    """Tell whether any cell is an arc."""
    for i in range(chain.n):
        if not cell(chain, i, HINGE) > 0.5:
            return True
    return False


@compiled
def bow_compliance(chain, work, i):
    """How far the end of cell i moves per force across it [m/N]; 0 for a hinge."""
    if cell(chain, i, HINGE) > 0.5:
        return 0.0
    reach = cell(chain, i, LENGTH)
    return reach * reach * (floats(work.compliance)[i] * (1.0 / 12.0))


@compiled
def half_arc(x, y, s, c):
    """`turning.arc_factor` of half the bend (x, y)."""
    s2, c2 = halved(s, c)
    return arc_factor(0.25 * (x * x + y * y), s2, c2)


@contracted
def along_middle(x, y, s, c, part, f):
    """
    Part of a force along the tangent in the middle of an arc [N], its slopes by the bend [N/rad].

    Parameters
    ----------
    x, y : float
        Bend [rad].
    s, c : float
        sin(a / 2) / a [1/rad] and cos(a / 2) of its size a, see `turning`: m = (s x, s y, c).
    part : float
        `half_arc` [1].
    f : tuple of float
        Force (3,) [N], in the frame that bends; all that is returned is linear in it.

    """
    toward = f[0] * x + f[1] * y
    drop = 0.125 * part * toward + 0.5 * s * f[2]
    return s * toward + c * f[2], s * f[0] - drop * x, s * f[1] - drop * y


@contracted
def bowed(bow, x, y, s, c, part, f):
    """
    Moment (x, y) [N·m] on the bend of a cell that bows, and where that moves its end (3,) [m].

    Parameters
    ----------
    bow : float
        `bow_compliance` [m/N].
    x, y : float
        Bend [rad].
    s, c, part : float
        As in `along_middle`.
    f : tuple of float
        Force of all beyond the middle (3,) [N], in the frame that bends.

    """
    g, by_x, by_y = along_middle(x, y, s, c, part, f)
    over = (bow * (f[0] - g * s * x), bow * (f[1] - g * s * y), bow * (f[2] - g * c))
    return -bow * g * by_x, -bow * g * by_y, over
