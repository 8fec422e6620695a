"""The whole backbone is stiffer or softer than described."""

from .effect import Effect, relative_change


def law(stiffness, tendons, relative_change):
    """Return K (1 + change)."""
    return stiffness * (1.0 + relative_change)


EFFECT = Effect(
    name='backbone_stiffness',
    title='the backbone is stiffer or softer than described',
    finding='the backbone is {relative_change:stiffer/softer} than described',
    stage='stiffness',
    law=law,
    parameters=(relative_change(tolerance='bending_stiffness'),),
    divisible=True,
    scales_bends=True,
)
