"""Friction remembers: its direction follows the travel since the last posture (Dahl)."""

import math

from .effect import Effect, Parameter


def law(sign, before, change, presliding_length):
    """
    Direction of friction after a change of travel: s' = g - (g - s) exp(-|d| / length).

    g is the sign of d; Dahl 1968, integrated over a travel in one direction.
    """
    if change == 0.0:
        return before
    g = math.copysign(1.0, change)
    return g - (g - before) * math.exp(-abs(change) / presliding_length)


EFFECT = Effect(
    name='friction_memory',
    title='friction keeps its direction until the tendon slides back',
    stage='memory',
    always_on=True,
    acts_on='tendon_friction',
    needs='history',
    law=law,
    parameters=(Parameter('presliding_length', 'm', 2e-4, 0.4, 2e-4, typical=0.02, of='radius'),),
)
