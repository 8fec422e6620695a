"""The paper's postures: all that hold one view angle, and the salient ones among them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..exceptions import InputError
from ..model.model import Model
from ..model.shape import ShapeBatch

Array = NDArray[np.float64]
LARGEST_CELL_BEND = np.radians(20.0)  # [rad] beyond it stacked guides would touch (assumed)


@dataclass(frozen=True)
class Posture:
    """A posture to go to."""

    name: str
    tensions: Array  # (m,) [N]
    position: Array  # (3,) [m] of the tip
    direction: Array  # (3,)


def salient(model: Model) -> list[Posture]:
    """
    Return the highest, the middle and the lowest tip at the 180° view, and an S at 45°.

    As in Kato et al. 2015, IV.B: one tendon of either section pulls and the others hold
    pretension, the lower limit; the tip's height is its z.
    """
    back = view(model, np.pi)
    order = np.argsort(back.tip_position[:, 2])
    chosen = [
        ('highest, 180° view', order[-1]),
        ('middle, 180° view', order[len(order) // 2]),
        ('lowest, 180° view', order[0]),
    ]
    found = [_posture(name, back, row) for name, row in chosen]
    s_shaped = view(model, np.pi / 4)
    first = model.robot.sections[0].cells
    opposite = np.flatnonzero(s_shaped.bend[:, :first, 0].sum(axis=1) < np.radians(-20.0))
    if len(opposite) == 0:
        raise InputError(f'{model.robot.name}: no S-shape at the 45° view within its limits')
    height = s_shaped.tip_position[opposite, 2]
    middle = opposite[np.argsort(height)[len(height) // 2]]
    return [*found, _posture('S-shape, 45° view', s_shaped, middle)]


def view(model: Model, angle: float, step: float = 0.1) -> ShapeBatch:
    """
    Return the postures whose tip has turned by an angle [rad] in the x-z plane.

    The tension of the first section goes through both directions in steps [N]; for each, that
    of the second section is bisected until the view is exact.
    """
    low, high = model.limits[:, 0], model.limits[:, 1]
    prox_left, prox_right, dist_right = _planar_inputs(model)
    steps = np.arange(-high[prox_left], high[prox_right] + 0.5 * step, step)

    def inputs(dist: Array) -> Array:
        tensions = np.tile(low, (len(steps), 1))
        tensions[:, prox_left] = np.clip(-steps, low[prox_left], high[prox_left])
        tensions[:, prox_right] = np.clip(steps, low[prox_right], high[prox_right])
        tensions[:, dist_right] = dist
        return tensions

    below, above = np.full(len(steps), low[dist_right]), np.full(len(steps), high[dist_right])
    for _ in range(40):
        middle = 0.5 * (below + above)
        under = model.shapes(inputs(middle)).bend[:, :, 0].sum(axis=1) < angle
        below, above = np.where(under, middle, below), np.where(under, above, middle)
    tensions = inputs(above)
    shapes = model.shapes(tensions)
    turned = shapes.bend[:, :, 0].sum(axis=1)
    good = (np.abs(turned - angle) < 1e-9) & (
        np.abs(shapes.bend).max(axis=(1, 2)) < LARGEST_CELL_BEND
    )
    if not good.any():
        raise InputError(
            f'{model.robot.name}: no posture at the {np.degrees(angle):.0f}° view '
            'within its limits'
        )
    return model.shapes(tensions[good])


def _planar_inputs(model: Model) -> tuple[int, int, int]:
    """Return the inputs of a planar two-section robot: prox left, prox right, dist right."""
    robot = model.robot
    sides = {}
    for index, members in enumerate(robot.input_tendons):
        tendon = robot.tendons[members[0]]
        sides[tendon.section, tendon.base[0] > 0.0] = index
    if len(robot.sections) != 2 or len(sides) != 4:
        raise InputError(f'{robot.name}: expected two sections with a tendon left and right each')
    first, second = (section.name for section in robot.sections)
    return sides[first, False], sides[first, True], sides[second, True]


def _posture(name: str, shapes: ShapeBatch, row: int) -> Posture:
    return Posture(name, shapes.inputs[row], shapes.tip_position[row], shapes.tip_direction[row])
