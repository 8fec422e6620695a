"""Tendons resist bending, too (the paper's A7 ignores it)."""

from .effect import Effect, Parameter


def law(stiffness, tendons, per_tendon):
    """Add the bending stiffness of every tendon that runs through the cell."""
    return stiffness + per_tendon * tendons


EFFECT = Effect(
    name='tendon_stiffness',
    title='the tendons resist bending',
    finding='the tendons resist bending with {per_tendon} each',
    stage='stiffness',
    law=law,
    # of a cell: 2 % a tendon, because the six of Kato et al. 2015 make about 10 % (A7)
    parameters=(
        Parameter(
            'per_tendon', 'N·m/rad', 0.0, 4.0, 0.0, typical=0.02, of='stiffness', parts_power=1
        ),
    ),
    divisible=True,
    scales_bends=True,
)
