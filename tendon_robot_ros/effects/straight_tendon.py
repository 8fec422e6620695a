"""Tendons run straight between eyelets (the paper's A3 lets them follow the backbone)."""

from .effect import Effect, fraction


def law(travel, along, across, bend, sin_half, cos_half, radial, length, hinge, fraction):
    """
    Blend the small-angle path with the chord between the eyelets of a cell.

    Path lost, hinge: L (1 - cos(a/2)) + 2 r sin(a/2); arc: L - 2 (L/a - r) sin(a/2), with r the
    offset in the bend plane. `along` is its derivative by a; across the plane r sin(a/2) / (a/2).
    """
    if bend < 1e-4:  # series: the closed forms lose digits
        sinc = 1.0 - bend * bend / 24.0
        lost_length = length * bend * bend / (8.0 if hinge else 24.0)
        lever = length * bend / (4.0 if hinge else 12.0)
    else:
        sinc = 2.0 * sin_half / bend
        lost_length = length * ((1.0 - cos_half) if hinge else (1.0 - sinc))
        lever = 0.5 * length * sin_half if hinge else length / bend * (sinc - cos_half)
    lost = lost_length + radial * sinc * bend
    arm = radial * cos_half + lever
    return (
        travel + fraction * (lost - travel),
        along + fraction * (arm - along),
        across + fraction * (sinc - across),
    )


EFFECT = Effect(
    name='straight_tendon',
    title='tendons run straight between eyelets',
    stage='tendon_path',
    parameters=(fraction(),),
    law=law,
)
