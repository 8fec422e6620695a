"""The backbone keeps part of its bend until it is bent back: sliding and internal friction."""

import math

from .effect import Effect, Parameter


def law(moment_x, moment_y, change_x, change_y, stiffness, lag, presliding):
    """
    Moment that a cell holds against its bend, after the bend has changed in a straight line.

    dm = presliding (K lag u - m) / lag |db|, u = db / |db|: the law of Dahl (1968) with exponent
    1, for both directions of a spatial arm, integrated. Where the motion turns back the cell is
    stiffer by K presliding; then the moment tends to K lag along the motion, so that a cell
    without load is left bent by `lag`.
    """
    size = math.hypot(change_x, change_y)
    if lag <= 0.0 or size == 0.0:
        return (moment_x, moment_y) if lag > 0.0 else (0.0, 0.0)
    kept, slides = math.exp(-presliding * size / lag), stiffness * lag / size
    slides_x, slides_y = slides * change_x, slides * change_y
    return slides_x + (moment_x - slides_x) * kept, slides_y + (moment_y - slides_y) * kept


EFFECT = Effect(
    name='bending_hysteresis',
    title='the backbone keeps part of its bend until it is bent back',
    stage='hysteresis',
    needs='history',
    law=law,
    parameters=(
        # `bend`: of a cell of an arm that bends by one radian, the most that is left of it
        Parameter('lag', 'rad', 0.0, 1.0, 0.0, 0.1, of='bend', per_section=True, parts_power=-1),
        # a tenth would be a spring in ten lags; with ten, it turns back in a tenth of the lag
        Parameter('presliding', '1', 0.1, 10.0, 1.0, typical=1.0, has_default=True),
    ),
    divisible=True,
)
