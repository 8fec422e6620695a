"""The backbone holds part of its bend until it is bent back: sliding and internal friction."""

import math

from .effect import Effect, Parameter


def law(moment_x, moment_y, change_x, change_y, stiffness, lag, presliding_bend):
    """
    Moment that a cell holds against its bend, after the bend has changed in a straight line.

    dm = (K lag u - m) |db| / presliding_bend, u = db / |db|: the law of Dahl (1968) with exponent
    1 for both directions of a spatial arm, integrated. The moment tends to K lag along the motion,
    so that a cell without load is left bent by `lag` at most.
    """
    size = math.hypot(change_x, change_y)
    if size == 0.0:
        return moment_x, moment_y
    kept, slides = math.exp(-size / presliding_bend), stiffness * lag / size
    slides_x, slides_y = slides * change_x, slides * change_y
    return slides_x + (moment_x - slides_x) * kept, slides_y + (moment_y - slides_y) * kept


EFFECT = Effect(
    name='bending_hysteresis',
    title='the backbone keeps part of its bend until it is bent back',
    stage='hysteresis',
    needs='history',
    law=law,
    # `bend`: of a cell of an arm that bends by one radian. A lag as large leaves the whole arm so
    # bent; presliding over more than twice as much would be a spring
    parameters=(
        Parameter('lag', 'rad', 0.0, 1.0, 0.0, 0.1, of='bend', per_section=True, parts_power=-1),
        Parameter('presliding_bend', 'rad', 0.02, 2.0, 0.2, 0.2, of='bend', parts_power=-1),
    ),
    divisible=True,
)
