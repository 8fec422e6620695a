"""Every pulled tendon carries a constant tension more (or less) than stated."""

from .effect import Effect, Parameter


def law(tension, offset):
    """Return T + offset where T > 0, never below zero: a tendon cannot push."""
    if tension > 0.0:
        return max(tension + offset, 0.0)
    return tension


EFFECT = Effect(
    name='tension_offset',
    title='the tension reading has an offset',
    finding='the tension reading has an offset of {offset}',
    stage='actuation',
    law=law,
    # in tensions that bend the arm by a radian, so that an offset of the size of all is within
    parameters=(Parameter('offset', 'N', -6.0, 6.0, 0.0, typical=0.15, of='tension'),),
    divisible=True,
)
