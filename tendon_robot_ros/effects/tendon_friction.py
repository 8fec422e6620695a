"""Friction between tendons and eyelets: the paper's own effect."""

from .effect import Effect, Parameter


def law(passed, turning, friction_coefficient):
    """
    Tension behind an eyelet over tension before it, T_i+1 / T_i = (1 - b) / (1 + b).

    b = mu sin(turning angle / 2); Kato et al. 2015, eq. (8) to (10).
    """
    b = friction_coefficient * turning
    return passed * (1.0 - b) / (1.0 + b)


EFFECT = Effect(
    name='tendon_friction',
    title='friction between tendons and eyelets',
    stage='eyelet',
    # Kato et al. 2015 measured 0.31 and 0.33
    parameters=(
        Parameter(
            'friction_coefficient', '1', 0.0, 1.0, 0.0, 0.3, tolerance='friction_coefficient'
        ),
    ),
    law=law,
    divisible=True,
    takes_force=True,
)
