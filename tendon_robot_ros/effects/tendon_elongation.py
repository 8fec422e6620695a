"""The tendons stretch: part of the wire pull does not reach the arm."""

from .effect import Effect, Parameter


def law(stretch, tension, length, compliance):
    """Elongation of the tendon in a cell: strain per newton times tension times length."""
    return stretch + compliance * tension * length


EFFECT = Effect(
    name='tendon_elongation',
    title='the tendons stretch',
    stage='stretch',
    law=law,
    # strain at the tension that bends the arm by a radian: 0.06 %, at most a tenth because the
    # law is linear
    parameters=(Parameter('compliance', '1/N', 0.0, 0.1, 0.0, typical=6e-4, of='compliance'),),
    needs='pulls',
    divisible=True,
)
