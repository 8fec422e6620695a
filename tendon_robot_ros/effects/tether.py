"""A string or a spring from a place along the arm to a fixed point; it pulls, and never pushes."""

import math

from .effect import Effect, Parameter, per_axis


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
    point_x,
    point_y,
    point_z,
    slack_length,
    stiffness,
    tension,
):
    """
    Add the share of a pull towards a fixed point that acts on the end of a cell.

    A string that is longer than `slack_length` pulls with `tension` (a weight over a pulley), and
    with `stiffness` per metre more (Hooke); a shorter one is slack.
    """
    share = min(1.0 - (along - arc_length) / before, 1.0 - (arc_length - along) / behind)
    x, y, z = point_x - place[0], point_y - place[1], point_z - place[2]
    distance = math.sqrt(x * x + y * y + z * z)
    if share <= 0.0 or distance <= slack_length:
        return force, moment, friction
    pull = share * (tension + stiffness * (distance - slack_length)) / distance
    return (force[0] + pull * x, force[1] + pull * y, force[2] + pull * z), moment, friction


EFFECT = Effect(
    name='tether',
    title='a string from a place along the arm to a fixed point',
    stage='push',
    law=law,
    parameters=(
        Parameter('arc_length', 'm', 0.0, 1.0, 0.0, typical=0.7, of='length'),
        *per_axis(Parameter('point', 'm', -1e3, 1e3, 0.0, typical=0.2, of='length')),
        Parameter('slack_length', 'm', 0.0, 1e3, 0.0, typical=0.2, of='length'),
        Parameter('stiffness', 'N/m', 0.0, 1e6, 0.0, typical=1.0, of='tip_stiffness'),
        Parameter('tension', 'N', 0.0, 1e3, 0.0, typical=0.2, of='force'),
    ),
    divisible=True,
    placed=True,
)
