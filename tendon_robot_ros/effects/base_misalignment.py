"""The tracker's frame is not the robot's base frame."""

import math

from .effect import Effect, Parameter, per_axis


def law(x, y, z, shift_x, shift_y, shift_z, rotation_x, rotation_y, rotation_z):
    """Rotate by a rotation vector (Rodrigues), then shift: measured = R model + shift."""
    angle = math.sqrt(rotation_x * rotation_x + rotation_y * rotation_y + rotation_z * rotation_z)
    if angle < 1e-12:
        a, b = 1.0, 0.5
    else:
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / (angle * angle)
    along = b * (rotation_x * x + rotation_y * y + rotation_z * z)
    c = math.cos(angle)
    return (
        c * x + a * (rotation_y * z - rotation_z * y) + along * rotation_x + shift_x,
        c * y + a * (rotation_z * x - rotation_x * z) + along * rotation_y + shift_y,
        c * z + a * (rotation_x * y - rotation_y * x) + along * rotation_z + shift_z,
    )


EFFECT = Effect(
    name='base_misalignment',
    title="the tracker's frame is off the robot's base frame",
    stage='measurement',
    law=law,
    parameters=per_axis(
        Parameter('shift', 'm', -1.0, 1.0, 0.0, typical=0.01, of='length', tolerance='position'),
        Parameter('rotation', 'rad', -1.0, 1.0, 0.0, typical=1e-2, tolerance='rotation'),
    ),
    divisible=True,
)
