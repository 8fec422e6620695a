"""The wires are pulled more than commanded, by an offset: pretension, or slack."""

from .effect import Effect, Parameter


def law(pull, tension, offset):
    """Pull that is commanded: what the arm and the springs take, less the offset."""
    return pull - offset


EFFECT = Effect(
    name='pull_zero',
    title='the commanded pulls have an offset',
    finding='the commanded pulls have an offset of {offset}',
    stage='winding',
    law=law,
    # at most the wire of a bend of three radians, so that pretension and slack are within
    parameters=(
        Parameter('offset', 'm', -3.0, 3.0, 0.0, typical=0.05, of='radius', per_tendon=True),
    ),
    needs='pulls',
    divisible=True,
)
