"""A force and a moment at a place along the arm, constant or turning with it."""

from .effect import Effect, Parameter, wrench


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
    arc_length,
    force_x,
    force_y,
    force_z,
    moment_x,
    moment_y,
    moment_z,
    follows,
):
    """
    Add the share of a wrench that acts on the end of a cell.

    Statically the same: of a force within a cell, either end carries as much as it is near.
    `follows` blends a wrench in the base frame (0) with one in the frame of the arm there (1).
    """
    share = min(1.0 - (along - arc_length) / before, 1.0 - (arc_length - along) / behind)
    if share <= 0.0:
        return force, moment, friction
    held, turns = share * (1.0 - follows), share * follows
    xx, xy, xz, yx, yy, yz, zx, zy, zz = frame
    fx, fy, fz, mx, my, mz = force_x, force_y, force_z, moment_x, moment_y, moment_z
    force = (
        force[0] + held * fx + turns * (xx * fx + xy * fy + xz * fz),
        force[1] + held * fy + turns * (yx * fx + yy * fy + yz * fz),
        force[2] + held * fz + turns * (zx * fx + zy * fy + zz * fz),
    )
    moment = (
        moment[0] + held * mx + turns * (xx * mx + xy * my + xz * mz),
        moment[1] + held * my + turns * (yx * mx + yy * my + yz * mz),
        moment[2] + held * mz + turns * (zx * mx + zy * my + zz * mz),
    )
    return force, moment, friction


EFFECT = Effect(
    name='point_load',
    title='a force or a moment at a place along the arm',
    stage='push',
    law=law,
    parameters=(
        Parameter('arc_length', 'm', 0.0, 1.0, 0.0, typical=0.7, of='length'),
        *wrench(),
        Parameter('follows', '1', 0.0, 1.0, 0.0, typical=1.0, only_described=True),
    ),
    divisible=True,
    placed=True,
    # farther than a diagnosis looks for a string: `diagnosis.placed.DISTANCES`
    finding='a force at {place}, or a string tied farther than four arm lengths away',
)
