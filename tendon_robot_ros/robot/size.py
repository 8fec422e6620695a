"""What is large and what is small for a robot: its length, stiffness and limits decide."""

from __future__ import annotations

import math

from ..common.units import STANDARD_GRAVITY
from .description import Robot


def natural_sizes(robot: Robot) -> dict[str, float]:
    """
    Return natural sizes of a robot, in SI units; a robot scaled in length or force scales them.

    They say what matters for it, not what it can bear: radius [m] of the outermost tendon, length
    [m], stiffness [N·m/rad] of a cell, tension [N] of one tendon that bends the arm by one radian
    (at most the limit), force [N] across the tip that does about the same, density [kg/m] whose
    weight is such a force, and the inverse of the tension per unit of length, compliance [1/N],
    and per radius, give [m/N].
    """
    stiffness = [k for section in robot.sections for k in section.bending_stiffness]
    softness = sum(1.0 / k for k in stiffness)
    radius = max(
        (math.hypot(*offset) for tendon in robot.tendons for offset in (tendon.base, tendon.end)),
        default=0.0,
    )
    radius = radius or 0.03 * robot.length  # tendons along the centroid
    per_newton = max(
        0.5 * (math.hypot(*t.base) + math.hypot(*t.end)) * sum(1.0 / k for k in stiffness[:cells])
        for t, cells in zip(robot.tendons, robot.tendon_cells, strict=True)
    )
    tension = min(1.0 / (per_newton or radius * softness), robot.tension_limits[1])
    force = 1.0 / (softness * robot.length)
    return {
        'radius': radius,
        'length': robot.length,
        'stiffness': len(stiffness) / softness,
        'tension': tension,
        'force': force,
        'density': force / (STANDARD_GRAVITY * robot.length),
        'compliance': 1.0 / tension,
        'give': radius / tension,
    }
