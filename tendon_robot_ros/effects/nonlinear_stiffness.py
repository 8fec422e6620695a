"""The backbone stiffens (or softens) as it bends."""

from .effect import Effect, Parameter


def law(factor, bend_squared, cubic):
    """Return 1 + cubic |theta'|^2, theta' from the rest bend: K theta' (1 + cubic |theta'|^2)."""
    return factor + cubic * bend_squared


EFFECT = Effect(
    name='nonlinear_stiffness',
    title='the backbone stiffens as it bends',
    stage='stiffening',
    law=law,
    # at -0.5 the moment would be largest at a bend of 0.8 rad: 1 + 3 cubic bend² = 0
    parameters=(Parameter('cubic', '1/rad²', -0.5, 100.0, 0.0, typical=3.0, parts_power=2),),
    divisible=True,
)
