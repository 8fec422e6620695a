"""Each section is stiffer or softer than described, by an amount of its own."""

from .effect import Effect, Parameter


def law(stiffness, tendons, relative_change):
    """Return K (1 + change of the section)."""
    return stiffness * (1.0 + relative_change)


EFFECT = Effect(
    name='section_stiffness',
    title='each section is stiffer or softer by its own amount',
    stage='stiffness',
    law=law,
    parameters=(Parameter('relative_change', '1', -0.8, 4.0, 0.0, typical=0.1, per_section=True),),
    contains=('backbone_stiffness',),
    divisible=True,
    scales_bends=True,
)
