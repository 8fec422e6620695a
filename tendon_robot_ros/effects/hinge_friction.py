"""Coulomb friction between guides that the tendons press together: the paper's own suspect."""

from .effect import Effect, Parameter


def law(moment, total_tension, lever):
    """
    Moment that is left to bend a cell: |M| shrinks by lever S, never below zero.

    lever = hinge friction coefficient times hinge radius; Kato et al. 2015, section V.
    """
    return max(moment - lever * total_tension, 0.0)


EFFECT = Effect(
    name='hinge_friction',
    title='friction in the hinges of the pressed guides',
    stage='joint_friction',
    # at most half of the radius, because hinges lie between the tendons with friction below 1
    parameters=(Parameter('lever', 'm', 0.0, 0.5, 0.0, typical=0.05, of='radius'),),
    law=law,
    divisible=True,
    takes_force=True,
)
