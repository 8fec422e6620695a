"""A share of the tension is lost before the base."""

from .effect import Effect, Parameter


def law(tension, fraction):
    """Return (1 - fraction) T."""
    return tension * (1.0 - fraction)


EFFECT = Effect(
    name='transmission_loss',
    title='tension is lost before the base',
    stage='actuation',
    law=law,
    # less than 1, else no tension would reach the base
    parameters=(Parameter('fraction', '1', 0.0, 0.9, 0.0, typical=0.1, tolerance='tension_gain'),),
    divisible=True,
    takes_force=True,
    scales_bends=True,
)
