"""A constant force at the tip."""

from .effect import Effect, Parameter


def law(x, y, z, force_x, force_y, force_z):
    """Add a force in the base frame, whatever the posture."""
    return x + force_x, y + force_y, z + force_z


EFFECT = Effect(
    name='tip_load',
    title='a constant force at the tip',
    finding='a load of {size} at the tip, {direction}',
    stage='tip_load',
    law=law,
    parameters=(
        Parameter('force_x', 'N', -1e3, 1e3, 0.0, typical=0.2, of='force'),
        Parameter('force_y', 'N', -1e3, 1e3, 0.0, typical=0.2, of='force'),
        Parameter('force_z', 'N', -1e3, 1e3, 0.0, typical=0.2, of='force'),
    ),
    divisible=True,
)
