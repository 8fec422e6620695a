"""The unloaded backbone is not straight."""

from .effect import Effect, Parameter


def law(rest_x, rest_y, angle_x, angle_y):
    """Bend of every cell at rest [rad]."""
    return rest_x + angle_x, rest_y + angle_y


EFFECT = Effect(
    name='pre_curvature',
    title='the unloaded backbone is curved',
    finding='the unloaded backbone is curved by {angle_x} and {angle_y} per cell',
    stage='rest',
    law=law,
    parameters=(
        Parameter('angle_x', 'rad', -0.5, 0.5, 0.0, typical=0.01, parts_power=-1),
        Parameter('angle_y', 'rad', -0.5, 0.5, 0.0, typical=0.01, parts_power=-1),
    ),
    divisible=True,
)
