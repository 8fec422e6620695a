"""A constant force, and a constant moment, at the tip."""

from .effect import Effect, Parameter


def law(
    x,
    y,
    z,
    about_x,
    about_y,
    about_z,
    force_x,
    force_y,
    force_z,
    moment_x,
    moment_y,
    moment_z,
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
    parameters=(
        Parameter('force_x', 'N', -1e3, 1e3, 0.0, typical=0.2, of='force'),
        Parameter('force_y', 'N', -1e3, 1e3, 0.0, typical=0.2, of='force'),
        Parameter('force_z', 'N', -1e3, 1e3, 0.0, typical=0.2, of='force'),
        Parameter('moment_x', 'N·m', -1e3, 1e3, 0.0, 0.2, of='moment', only_described=True),
        Parameter('moment_y', 'N·m', -1e3, 1e3, 0.0, 0.2, of='moment', only_described=True),
        Parameter('moment_z', 'N·m', -1e3, 1e3, 0.0, 0.2, of='moment', only_described=True),
    ),
    divisible=True,
)
