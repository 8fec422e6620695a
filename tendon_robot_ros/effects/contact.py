"""A wall, a ball or a pole that the arm touches: it pushes, and never pulls."""

import math

from .effect import Effect, Parameter


def law(
    force,
    moment,
    friction,
    place,
    frame,
    along,
    before,
    behind,
    moved,
    stiffness,
    distance,
    azimuth,
    elevation,
    curvature,
    is_pole,
    axis,
    thickness,
    friction_coefficient,
):
    """
    Add the push on the end of a cell that lies deeper than the surface: Hooke, and Coulomb.

    The surface is a wall (curvature 0), a ball of radius 1 / curvature, or with `is_pole` a pole
    of that radius; with a negative curvature the arm is inside. It is nearest to the base at
    `distance`, and faces the base by its normal n of `azimuth` (about z, from x) and `elevation`
    (from x and y up). With r from that nearest point (of a pole without the part along its axis,
    which `axis` turns about n from the horizontal) and g = 2 r.n + c r.r, the depth is that of a
    circle, -g / (1 + sqrt(1 + c g)), which is -r.n for a wall; `thickness` is the arm's radius.

    Friction along the surface is that of the posture before, less stiffness times how far the end
    has `moved` along it since, as stiff as the surface (Mindlin 1949: two thirds of it to all);
    what exceeds `friction_coefficient` times the normal force slides.
    """
    flat = math.cos(elevation)
    nx, ny, nz = flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)
    x, y, z = place[0] + distance * nx, place[1] + distance * ny, place[2] + distance * nz
    if is_pole > 0.5:
        turn, up = math.cos(axis), math.sin(axis)
        ex = -turn * math.sin(azimuth) - up * nz * math.cos(azimuth)
        ey = turn * math.cos(azimuth) - up * nz * math.sin(azimuth)
        ez = up * flat
        part = ex * x + ey * y + ez * z
        x, y, z = x - part * ex, y - part * ey, z - part * ez
    gap = 2.0 * (nx * x + ny * y + nz * z) + curvature * (x * x + y * y + z * z)
    root = math.sqrt(max(1.0 + curvature * gap, 0.0))
    depth = thickness - gap / (1.0 + root)
    if depth <= 0.0 or root <= 0.0:
        return force, moment, (0.0, 0.0, 0.0)
    push = stiffness * depth / root
    x, y, z = nx + curvature * x, ny + curvature * y, nz + curvature * z
    tx, ty, tz = (
        friction[0] - stiffness * moved[0],
        friction[1] - stiffness * moved[1],
        friction[2] - stiffness * moved[2],
    )
    across = (tx * x + ty * y + tz * z) / (root * root)
    tx, ty, tz = tx - across * x, ty - across * y, tz - across * z
    size, most = math.sqrt(tx * tx + ty * ty + tz * tz), friction_coefficient * stiffness * depth
    held = 1.0 if size <= most else most / size
    tx, ty, tz = held * tx, held * ty, held * tz
    force = (force[0] + push * x + tx, force[1] + push * y + ty, force[2] + push * z + tz)
    return force, moment, (tx, ty, tz)


EFFECT = Effect(
    name='contact',
    title='a wall, a ball or a pole that the arm touches',
    stage='push',
    law=law,
    parameters=(
        # a hundred times the arm's own at the tip hold what would bend it by a radian at a
        # hundredth of its length
        Parameter('stiffness', 'N/m', 0.0, 1e6, 0.0, typical=100.0, of='tip_stiffness'),
        Parameter('distance', 'm', -10.0, 10.0, 0.0, typical=0.1, of='length'),
        # round bounds beyond a turn, because values are written with few digits
        Parameter('azimuth', 'rad', -7.0, 7.0, 0.0, typical=math.pi),
        Parameter('elevation', 'rad', -3.2, 3.2, 0.0, typical=0.1),
        Parameter(
            'curvature', '1/m', -100.0, 100.0, 0.0, 1.0, of='curvature', only_described=True
        ),
        Parameter('is_pole', '1', 0.0, 1.0, 0.0, typical=1.0, only_described=True),
        Parameter('axis', 'rad', -2.0 * math.pi, 2.0 * math.pi, 0.0, 0.2, only_described=True),
        Parameter('thickness', 'm', 0.0, 1.0, 0.0, 0.03, of='length', only_described=True),
        Parameter(
            'friction_coefficient', '1', 0.0, 2.0, 0.0, 0.3, only_described=True, remembers=True
        ),
    ),
    divisible=True,
    placed=True,
    finding='something that the arm touches in {postures} at {place}, {distance} from the base',
)
