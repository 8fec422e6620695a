"""Play in the eyelets: every tendon lies on the inner side of its eyelet."""

import math

from .effect import Effect, Parameter


def law(moment, total_tension, radius, clearance):
    """
    Add clearance S along the moment, smoothed where the moment vanishes.

    |M| + clearance S |M| / sqrt(|M|^2 + (0.03 S r)^2), r the largest offset [m].
    """
    smooth = 0.03 * total_tension * radius
    size = math.sqrt(moment * moment + smooth * smooth)
    if size == 0.0:
        return moment
    return moment + clearance * total_tension * moment / size


EFFECT = Effect(
    name='eyelet_clearance',
    title='tendons lie on the inner side of their eyelets',
    stage='moment',
    law=law,
    # at most 0.4 of the radius, because a tendon would no longer lie near its offset
    parameters=(Parameter('clearance', 'm', 0.0, 0.4, 0.0, typical=0.04, of='radius'),),
    divisible=True,
)
