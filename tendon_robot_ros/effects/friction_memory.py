"""Friction remembers: its direction follows the travel since the last posture (Dahl)."""

import math

from .effect import Effect, Parameter

# [1] of the radius. Below, the friction after a path depends on reversals that a path in 256 parts
# does not resolve (model/kernel/shape.py), so that a fit would follow noise.
SHORTEST = 4e-3


def law(sign, before, change, presliding_length, exponent):
    """
    Direction of friction after a change of travel: ds/d|d| = g (1 - g s)^exponent / length.

    g is the sign of d; Dahl 1968, integrated over a travel in one direction. Exponent 1 is
    s' = g - (g - s) exp(-|d| / length), 0 a spring up to where it slips (Prandtl 1928).
    """
    if change == 0.0:
        return before
    g = math.copysign(1.0, change)
    remaining, travel = 1.0 - g * before, abs(change) / presliding_length
    if exponent == 1.0:
        return g - (g - before) * math.exp(-travel)
    if remaining <= 0.0:  # it slips
        return g
    power = 1.0 - exponent
    part = power * travel * remaining**-power
    if part >= 1.0:
        return g
    return g * (1.0 - remaining * math.exp(math.log1p(-part) / power))


EFFECT = Effect(
    name='friction_memory',
    title='friction keeps its direction until the tendon slides back',
    stage='memory',
    always_on=True,
    acts_on='tendon_friction',
    needs='history',
    law=law,
    # at most 0.4 of the radius: a longer one would be a spring in all of the arm's bends
    parameters=(
        Parameter('presliding_length', 'm', SHORTEST, 0.4, SHORTEST, typical=0.02, of='radius'),
        Parameter('exponent', '1', 0.0, 2.0, 1.0, typical=0.5, has_default=True),
    ),
)
