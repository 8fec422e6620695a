"""A constant force, and a constant moment, at the tip."""

from .effect import Effect, wrench


def law(
    x, y, z, about_x, about_y, about_z, force_x, force_y, force_z, moment_x, moment_y, moment_z
):
    """Add a force and a moment in the base frame, whatever the posture."""
    return (
        x + force_x,
        y + force_y,
        z + force_z,
        about_x + moment_x,
        about_y + moment_y,
        about_z + moment_z,
    )


EFFECT = Effect(
    name='tip_load',
    title='a constant force at the tip',
    finding='a load of {size} at the tip, {direction}',
    stage='tip_load',
    law=law,
    parameters=wrench(),
    divisible=True,
)
