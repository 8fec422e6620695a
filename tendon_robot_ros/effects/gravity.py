"""The arm's own weight (the paper's A6 ignores it)."""

from .effect import Effect, Parameter


def law(force_x, force_y, force_z, mass_length, gravity_x, gravity_y, gravity_z, linear_density):
    """Add the weight of the cell, linear_density mass_profile L times the gravity vector."""
    mass = linear_density * mass_length
    return force_x + mass * gravity_x, force_y + mass * gravity_y, force_z + mass * gravity_z


EFFECT = Effect(
    name='gravity',
    title="the arm's own weight",
    stage='load',
    law=law,
    # three times the density whose weight at the tip bends the arm by a radian, because the moment
    # of a weight that is spread along the arm is a third of that on average
    parameters=(Parameter('linear_density', 'kg/m', 0.0, 1e3, 0.0, typical=3.0, of='density'),),
    needs='gravity',
    divisible=True,
)
