"""The tendons run farther from, or closer to, the centroid than described."""

from .effect import Effect, Parameter


def law(scale, relative_change):
    """Offsets times (1 + change)."""
    return scale * (1.0 + relative_change)


EFFECT = Effect(
    name='moment_arm',
    title='the tendon offsets differ from the description',
    stage='offset_scale',
    law=law,
    parameters=(Parameter('relative_change', '1', -0.8, 4.0, 0.0, typical=0.1),),
    divisible=True,
    scales_bends=True,
)
