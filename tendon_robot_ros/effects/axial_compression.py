"""The tendons shorten the backbone (the paper's A1 does not let them)."""

from .effect import Effect, Parameter


def law(scale, total_tension, compliance):
    """Length of a cell over its length at rest, 1 - compliance S."""
    return scale * (1.0 - compliance * total_tension)


EFFECT = Effect(
    name='axial_compression',
    title='the tendons shorten the backbone',
    stage='length',
    law=law,
    # of the length at the tension that bends the arm by a radian: 0.1 %, at most a tenth because
    # the law is linear
    parameters=(Parameter('compliance', '1/N', 0.0, 0.1, 0.0, typical=1e-3, of='compliance'),),
    divisible=True,
)
