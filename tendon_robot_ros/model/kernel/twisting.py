"""
Cells that twist about their own axis, and tendons that wind about it.

Half of a cell's twist lies before its bend and half behind it. Tendons lean then: between the
eyelets at the ends of a cell their offset turns by the twist and by what they wind, and the chord
between these eyelets is longer than the one that the bend alone asks for.
"""

import math

from .layout import compiled, floats, inlined
from .stages import tendon_path_acts, torsion_acts


@compiled
def coordinates(chain):
    """Unknowns of a cell: its bend, and its twist where cells twist."""
    return 3 if torsion_acts(chain) else 2


@compiled
def unknowns(chain):
    """Entries of the state that count: bends (n, 2), and behind them twists (n,)."""
    return coordinates(chain) * chain.n


@compiled
def leans(chain):
    """Tell whether tendons may lean: they wind, or cells twist."""
    return chain.helix != 0 or torsion_acts(chain)


@compiled
def follows_shape(chain):
    """Tell whether the moment arms of the tendons follow the shape."""
    return tendon_path_acts(chain) or leans(chain)


@compiled
def is_general(chain):
    """Tell whether loads do more than bend: cells twist, or weight lies beside the axis."""
    return torsion_acts(chain) or chain.beside != 0


@compiled
def twist_in(chain, state, i):
    """Twist of cell i [rad] in a state at an address; zero where cells do not twist."""
    return floats(state)[2 * chain.n + i] if torsion_acts(chain) else 0.0


@compiled
def turned_axes(f, angle):
    """Frame (9,) turned about its own z."""
    c, s = math.cos(angle), math.sin(angle)
    return (
        c * f[0] + s * f[1],
        c * f[1] - s * f[0],
        f[2],
        c * f[3] + s * f[4],
        c * f[4] - s * f[3],
        f[5],
        c * f[6] + s * f[7],
        c * f[7] - s * f[6],
        f[8],
    )


@inlined
def bending_frame(chain, state, work, i, general):
    """Frame (9,) in which cell i bends: where it begins, turned by half its twist."""
    f = floats(work.frames + 72 * i)
    frame = (f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8])
    if general:
        return turned_axes(frame, 0.5 * twist_in(chain, state, i))
    return frame


@compiled
def axial_moment(x, y, sinc, versine, torque, start):
    """
    Moment on a twist [N·m] of the torques at both ends of its cell, in the frame that bends.

    A twist turns what lies beyond by a half about each end of the axis.
    """
    end = sinc * (x * torque[0] + y * torque[1]) + (1.0 - versine * (x * x + y * y)) * torque[2]
    return 0.5 * (start[2] + end)
