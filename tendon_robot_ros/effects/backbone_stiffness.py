"""The whole backbone is stiffer or softer than described."""

from .effect import Effect, Parameter


def law(stiffness, tendons, relative_change):
    """Return K (1 + change)."""
    return stiffness * (1.0 + relative_change)


EFFECT = Effect(
    name='backbone_stiffness',
    title='the backbone is stiffer or softer than described',
    stage='stiffness',
    law=law,
    parameters=(
        Parameter(
            'relative_change', '1', -0.8, 4.0, 0.0, typical=0.1, tolerance='bending_stiffness'
        ),
    ),
    divisible=True,
    scales_bends=True,
)
