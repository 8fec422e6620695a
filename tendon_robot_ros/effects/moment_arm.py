"""The tendons run farther from, or closer to, the centroid than described."""

from .effect import Effect, relative_change


def law(scale, relative_change):
    """Offsets times (1 + change)."""
    return scale * (1.0 + relative_change)


EFFECT = Effect(
    name='moment_arm',
    title='the tendon offsets differ from the description',
    finding='the tendon offsets are {relative_change:larger/smaller} than described',
    stage='offset_scale',
    law=law,
    parameters=(relative_change(),),
    divisible=True,
    scales_bends=True,
)
