"""Each section is stiffer or softer than described, by an amount of its own."""

from .effect import Effect, relative_change


def law(stiffness, tendons, relative_change):
    """Return K (1 + change of the section)."""
    return stiffness * (1.0 + relative_change)


EFFECT = Effect(
    name='section_stiffness',
    title='each section is stiffer or softer by its own amount',
    finding='sections are {relative_change:stiffer/softer} than described',
    stage='stiffness',
    law=law,
    parameters=(relative_change(per_section=True),),
    contains=('backbone_stiffness',),
    divisible=True,
    scales_bends=True,
)
