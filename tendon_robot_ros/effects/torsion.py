"""The backbone twists about its own axis under a moment about it."""

from .effect import Effect, Parameter


def law(twist, moment, stiffness, compliance):
    """
    Twist of the cell, compliance M / K: compliance = K / (torsional stiffness) of the cell.

    A round rod of one material has EI / GJ = 1 + Poisson's ratio.
    """
    return twist + compliance * moment / stiffness


EFFECT = Effect(
    name='torsion',
    title='the backbone twists about its own axis',
    stage='torsion',
    law=law,
    # typically 1, because a round rod of one material has EI / GJ = 1 + Poisson's ratio
    parameters=(Parameter('compliance', '1', 0.0, 100.0, 0.0, typical=1.0, per_section=True),),
    divisible=True,
)
