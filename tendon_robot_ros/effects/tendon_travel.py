"""Friction opposes the real travel of the tendon, which all cells beyond the eyelet decide."""

from .effect import Effect, fraction


def law(here, beyond, fraction):
    """
    Blend what this cell says with what all cells beyond the eyelet say.

    Works alike on the travel [m] and on its sign [1]; replaces sgn(d) sgn(M) of eq. (10).
    """
    return (1.0 - fraction) * here + fraction * beyond


EFFECT = Effect(
    name='tendon_travel',
    title="friction opposes the tendon's real travel",
    stage='friction_travel',
    parameters=(fraction(),),
    law=law,
    acts_on='tendon_friction',
    divisible=True,
)
