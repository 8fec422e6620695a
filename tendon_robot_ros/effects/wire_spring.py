"""Every wire ends in a spring: part of the pull goes into it, however long the wire is."""

from .effect import Effect, Parameter


def law(pull, tension, compliance):
    """Pull that is commanded: what the arm takes, and compliance times tension for the spring."""
    return pull + compliance * tension


EFFECT = Effect(
    name='wire_spring',
    title='the wires end in springs',
    stage='winding',
    law=law,
    # wire in the spring, in radii, at the tension that bends the arm by a radian: at most 30,
    # because springs may be far softer than the arm
    parameters=(
        Parameter('compliance', 'm/N', 0.0, 30.0, 0.0, typical=0.05, of='give', per_tendon=True),
    ),
    needs='pulls',
    divisible=True,
)
